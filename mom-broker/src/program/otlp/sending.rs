//! The thread's work: spans are gathered, sent, and counted where nobody takes them.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use bytes::Bytes;
use mom_net::ClientTls;
use opentelemetry_http::{HttpClient, HttpError, Request, Response};
use opentelemetry_otlp::SpanExporter;
use opentelemetry_sdk::trace::{SpanData, SpanExporter as _};
use parking_lot::Mutex;
use tokio::sync::{Notify, mpsc};
use tokio::time::timeout;

/// Spans in one request.
const TOGETHER: usize = 512;

/// How long the first of them waits for others.
const GATHER: Duration = Duration::from_millis(500);

/// How often the log says how many spans were lost to a collector that is too slow.
const TELL: Duration = Duration::from_secs(60);

/// What the thread has.
pub(super) struct Sending {
    pub(super) waiting: mpsc::Receiver<SpanData>,
    /// Spans that no line of the log reports yet.
    pub(super) lost: Arc<AtomicU64>,
    pub(super) ending: Arc<Notify>,
    pub(super) exporter: SpanExporter,
    pub(super) server: Server,
    /// The last request was in vain.
    pub(super) failing: bool,
    /// When losses were last reported.
    pub(super) told: Option<Instant>,
}

impl Sending {
    /// Sends until it is time to end and nothing waits.
    pub(super) async fn run(mut self) {
        let mut spans = Vec::new();
        loop {
            self.gather(&mut spans).await;
            if spans.is_empty() {
                if self.waiting.is_closed() {
                    break;
                }
                continue;
            }
            let number = spans.len() as u64;
            let sent = self.exporter.export(std::mem::take(&mut spans)).await;
            self.note(number, sent.map_err(|error| error.to_string()));
        }
        let lost = self.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            tracing::warn!(lost, "OTLP: the collector rejected these spans");
        }
    }

    async fn gather(&mut self, spans: &mut Vec<SpanData>) {
        let waiting = &mut self.waiting;
        let gathered = async {
            if waiting.recv_many(spans, TOGETHER).await == 0 {
                return;
            }
            let others = async {
                while spans.len() < TOGETHER {
                    let most = TOGETHER - spans.len();
                    if waiting.recv_many(spans, most).await == 0 {
                        return;
                    }
                }
            };
            // With those that have come by then.
            let _ = timeout(GATHER, others).await;
        };
        tokio::select! {
            () = gathered => {}
            () = self.ending.notified() => self.waiting.close(),
        }
    }

    /// Notes what has become of so many spans. The log has one line when a collector takes no more, and one when it does again.
    fn note(&mut self, number: u64, sent: Result<(), String>) {
        match sent {
            Err(error) => {
                self.lost.fetch_add(number, Ordering::Relaxed);
                let error = self.server.take_error().unwrap_or(error);
                if !self.failing {
                    tracing::warn!(
                        "OTLP: the collector does not accept spans: {error}; they are lost until it does; \
                         OTEL_EXPORTER_OTLP_ENDPOINT says where it is"
                    );
                }
                self.failing = true;
            }
            Ok(()) => {
                let tell = self.failing || self.told.is_none_or(|told| told.elapsed() >= TELL);
                let lost = if tell {
                    self.lost.swap(0, Ordering::Relaxed)
                } else {
                    0
                };
                if lost > 0 {
                    tracing::warn!(lost, "OTLP: the collector accepts spans again; these were lost");
                    self.told = Some(Instant::now());
                }
                self.failing = false;
            }
        }
    }
}

/// Sends requests to the collector by mom-net's own connections.
#[derive(Clone, Debug)]
pub(super) struct Server {
    tls: Option<ClientTls>,
    /// Why the last request has failed: OpenTelemetry's exporter says only that it has.
    error: Arc<Mutex<Option<String>>>,
}

impl Server {
    /// Without TLS there is HTTP alone.
    pub(super) fn new(tls: Option<ClientTls>) -> Server {
        let error = Arc::default();
        Server { tls, error }
    }

    fn take_error(&self) -> Option<String> {
        self.error.lock().take()
    }
}

#[async_trait]
impl HttpClient for Server {
    async fn send_bytes(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let authority = request
            .uri()
            .authority()
            .map_or("", |authority| authority.as_str());
        // Without a password, as this is for the log.
        let server = authority.rsplit('@').next().unwrap_or_default().to_owned();
        let answer = mom_net::ask(self.tls.as_ref(), request).await;
        *self.error.lock() = match &answer {
            Ok(answer) if answer.status().is_success() => None,
            Ok(answer) => Some(format!("{server} answers {}", answer.status())),
            Err(error) => Some(format!("{server}: {error}")),
        };
        Ok(answer?)
    }
}
