//! Makes spans of OpenTelemetry of those of the target `mom::trace`.

use std::fmt;
use std::time::SystemTime;

use opentelemetry::trace::{SpanContext, SpanId, SpanKind, Status, TraceFlags, TraceId, TraceState};
use opentelemetry::{InstrumentationScope, KeyValue, Value};
use opentelemetry_sdk::trace::{IdGenerator as _, RandomIdGenerator, SpanData, SpanEvents, SpanLinks};
use tracing::field::{Field, Visit};
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id};
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

use super::WaitingSpans;

/// The target of all spans of messages that are part of a trace.
const TARGET: &str = "mom::trace";

/// What the hub's span says in the end of a message that nobody gets.
const REFUSED: &str = "refused";

/// Takes the spans of traced messages, whatever the log shows.
#[derive(Debug)]
pub(crate) struct Spans {
    queue: WaitingSpans,
    ids: RandomIdGenerator,
    scope: InstrumentationScope,
}

impl Spans {
    pub(super) fn new(queue: WaitingSpans) -> Spans {
        Spans {
            queue,
            ids: RandomIdGenerator::default(),
            scope: InstrumentationScope::builder("mom-broker")
                .with_version(env!("CARGO_PKG_VERSION"))
                .build(),
        }
    }

    /// What it is to be given.
    pub(crate) fn filter() -> Targets {
        Targets::new().with_target(TARGET, LevelFilter::DEBUG)
    }

    fn span(&self, name: &'static str, draft: Draft) -> Option<SpanData> {
        let flags = TraceFlags::SAMPLED;
        let id = self.ids.new_span_id();
        Some(SpanData {
            span_context: SpanContext::new(draft.trace?, id, flags, false, TraceState::NONE),
            parent_span_id: draft.parent?,
            parent_span_is_remote: true,
            span_kind: SpanKind::Internal,
            name: name.into(),
            start_time: draft.begin,
            end_time: SystemTime::now(),
            attributes: draft.attributes,
            dropped_attributes_count: 0,
            events: SpanEvents::default(),
            links: SpanLinks::default(),
            status: draft.status,
            instrumentation_scope: self.scope.clone(),
        })
    }
}

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Spans {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        let mut draft = Draft::new();
        attributes.record(&mut draft);
        if let Some(span) = context.span(id).filter(|_| draft.sampled) {
            span.extensions_mut().insert(draft);
        }
    }

    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        if let Some(span) = context.event_span(event)
            && let Some(draft) = span.extensions_mut().get_mut::<Draft>()
        {
            event.record(&mut Outcome(draft));
        }
    }

    fn on_close(&self, id: Id, context: Context<'_, S>) {
        let Some(span) = context.span(&id) else { return };
        let draft = span.extensions_mut().remove::<Draft>();
        if let Some(span) = draft.and_then(|draft| self.span(span.name(), draft)) {
            self.queue.put(span);
        }
    }
}

/// A span that has not ended.
#[derive(Debug)]
struct Draft {
    begin: SystemTime,
    trace: Option<TraceId>,
    parent: Option<SpanId>,
    /// Whether the sender records the trace; one that does not wants nobody to.
    sampled: bool,
    attributes: Vec<KeyValue>,
    status: Status,
}

impl Draft {
    fn new() -> Draft {
        Draft {
            begin: SystemTime::now(),
            trace: None,
            parent: None,
            sampled: false,
            attributes: Vec::new(),
            status: Status::Unset,
        }
    }

    /// Attributes have our name in front, as others have theirs.
    fn put(&mut self, name: &str, value: impl Into<Value>) {
        self.attributes.push(KeyValue::new(format!("mom.{name}"), value));
    }
}

impl Visit for Draft {
    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "trace" => self.trace = TraceId::from_hex(value).ok(),
            "parent" => self.parent = SpanId::from_hex(value).ok(),
            name => self.put(name, value.to_owned()),
        }
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        match field.name() {
            "sampled" => self.sampled = value,
            name => self.put(name, value),
        }
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.put(field.name(), value);
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.put(field.name(), i64::try_from(value).unwrap_or(i64::MAX));
    }

    fn record_f64(&mut self, field: &Field, value: f64) {
        self.put(field.name(), value);
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        self.put(field.name(), format!("{value:?}"));
    }
}

/// Reads from the event in a span how it ends.
struct Outcome<'a>(&'a mut Draft);

impl Visit for Outcome<'_> {
    fn record_u64(&mut self, field: &Field, value: u64) {
        self.0.record_u64(field, value);
    }

    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        let (name, text) = (field.name(), format!("{value:?}"));
        if name == "error" || text == REFUSED {
            self.0.status = Status::error(text.clone());
        }
        // The span's own field of this name is the name of a message.
        let name = if name == "message" { "result" } else { name };
        self.0.put(name, text);
    }
}
