//! Spans of messages that are part of a trace, for the log: `log = "info,mom::trace=debug"`.

use mom_hub::PeerId;
use mom_proto::{Parcel, TraceParent};
use tracing::Span;

/// The span in which a message is admitted and put into the outboxes of its receivers; none without a slot `trace`, as
/// nearly all are.
pub(crate) fn span(parcel: &Parcel, sender: PeerId) -> Span {
    let Some(trace) = TraceParent::of(parcel) else {
        return Span::none();
    };
    tracing::debug_span!(
        target: "mom::trace",
        parent: None,
        "pass",
        trace = trace.trace_id(),
        parent = trace.span_id(),
        sampled = trace.is_sampled(),
        context = parcel.context.as_ref().map(tracing::field::display),
        number = parcel.number.map(|number| number.0),
        message = %mom_proto::visible(parcel.name()),
        peer = sender.0,
    )
}

/// Notes how the span ends, and how long it took.
pub(crate) fn end(span: &Span, result: &'static str, micros: u64) {
    span.in_scope(|| tracing::debug!(target: "mom::trace", micros, "{result}"));
}
