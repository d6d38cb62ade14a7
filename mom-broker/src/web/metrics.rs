//! Health and figures, for programs that watch the hub.

use std::sync::atomic::AtomicU64;

use http::header::{AUTHORIZATION, HeaderMap};
use http::{Request, Response, StatusCode};
use hyper::body::Incoming;
use mom_proto::Delivery;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::{ConstCounter, Counter};
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::{ConstGauge, Gauge};
use prometheus_client::registry::{Registry, Unit};
use sha2::{Digest, Sha256};

use super::HttpConnection;
use super::answers::{self, Body, refuse};
use crate::traffic::switchboard::Totals;

/// How Prometheus names the format.
const FORMAT: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Labels of one line.
type Labels = Vec<(&'static str, String)>;

impl HttpConnection {
    /// Whether the hub takes peers.
    pub(super) fn readiness(&self) -> Response<Body> {
        let full = self.web.doors.is_full();
        match (self.services.board.is_stopping(), full) {
            (true, _) => refuse(StatusCode::SERVICE_UNAVAILABLE, "shutdown", "this hub stops"),
            (_, true) => refuse(
                StatusCode::SERVICE_UNAVAILABLE,
                "too-many-connections",
                "this hub has reached its connection limit",
            ),
            _ => answers::text(StatusCode::OK, "ready\n"),
        }
    }

    /// The figures of the hub: for the token of the configuration, and for users who may ask for its statistics.
    pub(super) async fn metrics(&self, request: &Request<Incoming>) -> Response<Body> {
        if !self.has_metrics_token(request.headers()) {
            let stats = match self.visitor(request.headers()).await {
                Ok(visitor) => visitor.stats().await.map(drop),
                Err(refusal) => Err(refusal),
            };
            if let Err(refusal) = stats {
                return refusal;
            }
        }
        let mut registry = Registry::with_prefix("mom");
        let named = request.uri().query() == Some("peers=1");
        self.register_peers(&mut registry, named);
        self.register_traffic(&mut registry);
        self.register_broker(&mut registry);
        let mut text = String::new();
        match encode(&mut text, &registry) {
            Ok(()) => answers::bytes(StatusCode::OK, FORMAT, text),
            Err(_) => refuse(
                StatusCode::INTERNAL_SERVER_ERROR,
                "internal",
                "cannot format the metrics",
            ),
        }
    }

    fn has_metrics_token(&self, headers: &HeaderMap) -> bool {
        let rules = self.web.rules();
        let Some(token) = &rules.metrics_token else {
            return false;
        };
        let shown = headers.get(AUTHORIZATION).and_then(|shown| shown.to_str().ok());
        let shown = shown.and_then(|shown| shown.strip_prefix("Bearer "));
        // Digests, so that the time of the comparison tells nothing of the token.
        shown.is_some_and(|shown| Sha256::digest(shown) == Sha256::digest(token.text()))
    }

    /// How many peers there are of each kind; each of them by name only if asked, because peers choose their names.
    fn register_peers(&self, registry: &mut Registry, named: bool) {
        let (peers, _) = self.services.board.peers(usize::MAX);
        let kinds = Family::<Labels, Gauge>::default();
        let [queued, dropped, round_trip] =
            [(); 3].map(|()| Family::<Labels, Gauge<f64, AtomicU64>>::default());
        for peer in &peers {
            let kind = vec![
                ("form", peer.form().to_owned()),
                ("door", peer.door().to_owned()),
                ("tls", peer.login.tls.to_string()),
            ];
            kinds.get_or_create(&kind).inc();
            if !named {
                continue;
            }
            let name = vec![("peer", peer.name.to_string()), ("user", peer.user().to_owned())];
            queued.get_or_create(&name).set(peer.queued as f64);
            dropped.get_or_create(&name).set(peer.dropped as f64);
            if let Some(micros) = peer.round_trip {
                round_trip.get_or_create(&name).set(micros as f64 / 1e6);
            }
        }
        registry.register("peers", "Peers that have logged in", kinds);
        if named {
            registry.register_with_unit("peer_queued", "Bytes queued for a peer", Unit::Bytes, queued);
            registry.register("peer_dropped", "Parcels dropped on their way to a peer", dropped);
            registry.register_with_unit(
                "peer_round_trip",
                "Round-trip time to a peer",
                Unit::Seconds,
                round_trip,
            );
        }
    }

    fn register_traffic(&self, registry: &mut Registry) {
        let Totals {
            channels,
            counts,
            queued,
        } = self.services.board.totals();
        registry.register("channels", "Channels", ConstGauge::new(whole(channels)));
        let counted = [
            ("messages", "Messages accepted by channels", counts.sent),
            ("deliveries", "Messages queued for receivers", counts.delivered),
        ];
        for (name, help, count) in counted {
            registry.register(name, help, ConstCounter::new(count));
        }
        let bytes = ConstCounter::new(counts.bytes);
        registry.register_with_unit(
            "message",
            "Content bytes of the messages accepted",
            Unit::Bytes,
            bytes,
        );
        let dropped = Family::<Labels, Counter>::default();
        for class in [Delivery::Reliable, Delivery::Latest, Delivery::Fleeting] {
            for ((reason, _), count) in counts.dropped.iter().filter(|((_, of), _)| *of == class) {
                let labels = vec![
                    ("class", class.word().to_owned()),
                    ("reason", reason.word().to_owned()),
                ];
                dropped.get_or_create(&labels).inc_by(*count);
            }
        }
        registry.register("dropped", "Messages dropped for a receiver", dropped);
        let waiting = ConstGauge::new(whole(queued));
        registry.register_with_unit("queued", "Bytes queued for receivers", Unit::Bytes, waiting);
        let ages = Family::<Labels, Gauge<f64, AtomicU64>>::default();
        for (quantile, percent) in [("0.5", 50), ("0.99", 99)] {
            let age = counts.ages.as_ref().and_then(|ages| ages.percentile(percent));
            if let Some(micros) = age {
                let labels = vec![("quantile", quantile.to_owned())];
                ages.get_or_create(&labels).set(micros as f64 / 1e6);
            }
        }
        registry.register_with_unit(
            "message_age",
            "How old messages were when the hub took them in, since its start",
            Unit::Seconds,
            ages,
        );
    }

    fn register_broker(&self, registry: &mut Registry) {
        let info = Family::<Labels, Gauge>::default();
        let version = env!("CARGO_PKG_VERSION").to_owned();
        info.get_or_create(&vec![("version", version)]).set(1);
        registry.register("build", "The version of the broker", info);
        let up = ConstGauge::new(self.web.begun.elapsed().as_secs_f64());
        registry.register_with_unit("up", "Time since the broker was started", Unit::Seconds, up);
        let (used, bound) = self.services.board.memory.used_and_bound();
        let memory = "Memory charged to users";
        registry.register_with_unit("memory", memory, Unit::Bytes, ConstGauge::new(whole(used)));
        if let Some(bound) = bound {
            let bound = ConstGauge::new(whole(bound));
            registry.register_with_unit(
                "memory_bound",
                "Limit of the memory charged to users",
                Unit::Bytes,
                bound,
            );
        }
        let (here, strangers) = self.web.doors.counts();
        registry.register("places", "Connections from outside", ConstGauge::new(whole(here)));
        let strangers = ConstGauge::new(whole(strangers));
        registry.register("strangers", "Connections that have not logged in", strangers);
        let logins = self.services.logins.stats();
        registry.register("passwords", "Passwords hashed", ConstCounter::new(logins.hashed));
        let waiting = ConstGauge::new(whole(logins.waiting));
        registry.register(
            "passwords_waiting",
            "Logins whose password is being hashed or is queued for hashing",
            waiting,
        );
        for (name, help, count) in own_process() {
            registry.register(name, help, ConstGauge::new(count));
        }
    }
}

/// Memory and open files of this process, where the system tells.
fn own_process() -> Vec<(&'static str, &'static str, i64)> {
    let mut found = Vec::new();
    let resident = std::fs::read_to_string("/proc/self/statm").ok();
    let pages = resident.and_then(|text| text.split(' ').nth(1)?.parse::<usize>().ok());
    if let Some(pages) = pages {
        let bytes = whole(pages.saturating_mul(rustix::param::page_size()));
        found.push((
            "process_resident_memory_bytes",
            "Resident memory of the broker",
            bytes,
        ));
    }
    if let Ok(files) = std::fs::read_dir("/proc/self/fd") {
        found.push((
            "process_open_fds",
            "Open files and connections",
            whole(files.count()),
        ));
    }
    found
}

fn whole(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}
