//! Export of spans by OTLP: a collector gets the spans of messages that are part of a trace, over HTTP.
//!
//! A span that ends goes into a bounded queue, or is counted as lost; a thread of its own sends what is in there. So
//! the task of a connection never waits for a collector, and one that does not answer costs that thread alone.

mod layer;
mod sending;

use std::env::var_os;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc as std_mpsc;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result};
use mom_net::{ClientTls, Trust};
use opentelemetry_otlp::{Protocol, SpanExporter, WithExportConfig as _, WithHttpConfig as _};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{SpanData, SpanExporter as _};
use tokio::sync::{Notify, mpsc};
use tracing_subscriber::{Layer, Registry};

use layer::Spans;
use sending::{Sending, Server};

const ENDPOINT: &str = "OTEL_EXPORTER_OTLP_ENDPOINT";
const TRACES_ENDPOINT: &str = "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT";
const PROTOCOLS: [&str; 2] = [
    "OTEL_EXPORTER_OTLP_PROTOCOL",
    "OTEL_EXPORTER_OTLP_TRACES_PROTOCOL",
];
const CERTIFICATES: [&str; 2] = [
    "OTEL_EXPORTER_OTLP_TRACES_CERTIFICATE",
    "OTEL_EXPORTER_OTLP_CERTIFICATE",
];
const SERVICE_NAMES: [&str; 2] = ["OTEL_SERVICE_NAME", "OTEL_RESOURCE_ATTRIBUTES"];

/// Spans that may wait to be sent, as many as OpenTelemetry's own libraries keep.
const WAITING: usize = 2048;

/// Makes spans of what is traced.
type SpanLayer = Box<dyn Layer<Registry> + Send + Sync>;

/// The thread that sends spans.
pub(super) struct Export {
    ending: Arc<Notify>,
    /// Is closed when the thread has ended.
    ended: std_mpsc::Receiver<()>,
}

/// Starts the thread if the environment names a collector; gives the layer for it, too.
///
/// # Errors
/// An environment that is wrong; no thread.
pub(super) fn start() -> Result<Option<(SpanLayer, Export)>> {
    if is_unset(&[ENDPOINT, TRACES_ENDPOINT]) {
        return Ok(None);
    }
    let (server, exporter) = exporter().context("OTLP")?;
    let (queue, waiting) = mpsc::channel(WAITING);
    let lost = Arc::new(AtomicU64::new(0));
    let ending = Arc::new(Notify::new());
    let (end, ended) = std_mpsc::channel();
    let sending = Sending {
        waiting,
        lost: Arc::clone(&lost),
        ending: Arc::clone(&ending),
        exporter,
        server,
        failing: false,
        told: None,
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("cannot start the runtime for OTLP")?;
    thread::Builder::new()
        .name("otlp".to_owned())
        .spawn(move || {
            let _end: std_mpsc::Sender<()> = end;
            runtime.block_on(sending.run());
        })
        .context("cannot start the thread for OTLP")?;
    let spans = Spans::new(WaitingSpans { spans: queue, lost }).with_filter(Spans::filter());
    Ok(Some((spans.boxed(), Export { ending, ended })))
}

impl Export {
    /// Sends what waits, for so long at most.
    pub(super) fn finish(&self, patience: Duration) {
        self.ending.notify_one();
        // It gives nothing: either the thread has ended, or the time is over.
        let _ = self.ended.recv_timeout(patience);
    }
}

/// The way to the thread.
#[derive(Debug)]
struct WaitingSpans {
    spans: mpsc::Sender<SpanData>,
    /// Spans that no line of the log reports yet.
    lost: Arc<AtomicU64>,
}

impl WaitingSpans {
    /// Never waits.
    fn put(&self, span: SpanData) {
        if self.spans.try_send(span).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Whether none of these variables says anything.
fn is_unset(names: &[&str]) -> bool {
    names
        .iter()
        .all(|name| var_os(name).is_none_or(|value| value.is_empty()))
}

fn exporter() -> Result<(Server, SpanExporter)> {
    let secure = |name| std::env::var(name).is_ok_and(|url| url.starts_with("https:"));
    let tls = if secure(ENDPOINT) || secure(TRACES_ENDPOINT) {
        let named = CERTIFICATES.iter().find_map(var_os).map(PathBuf::from);
        let trust = named.map_or(Trust::System, Trust::Authorities);
        Some(ClientTls::new(&trust, None)?)
    } else {
        None
    };
    let server = Server::new(tls);
    let mut builder = SpanExporter::builder()
        .with_http()
        .with_http_client(server.clone());
    // The library's own default is JSON, the specification's is not.
    if is_unset(&PROTOCOLS) {
        builder = builder.with_protocol(Protocol::HttpBinary);
    }
    let mut exporter = builder.build()?;
    let mut resource = Resource::builder();
    if is_unset(&SERVICE_NAMES) {
        resource = resource.with_service_name("mom-broker");
    }
    exporter.set_resource(&resource.build());
    Ok((server, exporter))
}

#[cfg(test)]
mod tests {
    use tracing_subscriber::layer::SubscriberExt as _;

    use super::*;

    /// Nobody takes what is in the queue.
    #[test]
    fn a_full_queue_loses_spans_and_counts_them() {
        let (spans, waiting) = mpsc::channel(2);
        let lost = Arc::new(AtomicU64::new(0));
        let queue = WaitingSpans {
            spans,
            lost: Arc::clone(&lost),
        };
        let layer = Spans::new(queue).with_filter(Spans::filter());
        let subscriber = tracing_subscriber::registry().with(layer);
        tracing::subscriber::with_default(subscriber, || {
            for _ in 0..5 {
                let (trace, parent) = ("0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331");
                tracing::debug_span!(target: "mom::trace", "pass", trace, parent, sampled = true);
                tracing::debug_span!(target: "mom::trace", "pass", trace, parent, sampled = false);
                tracing::debug_span!("other", trace, parent, sampled = true);
            }
        });
        assert_eq!((waiting.len(), lost.load(Ordering::Relaxed)), (2, 3));
    }
}
