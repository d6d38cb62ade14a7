//! What is known of the peer of one connection, for `context stats` and for what HTTP asks.

use std::net::IpAddr;
use std::sync::Arc;

use mom_net::Door;
use mom_proto::codec::Form;
use mom_proto::{Map, Micros, Time};

use super::Outbox;
use crate::traffic::memory::Account;
use mom_system::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// What was heard of a peer. Its reader writes it, with plain stores, once for all that has arrived together.
#[derive(Debug, Default)]
pub(crate) struct Heard {
    /// Whole frames were, since the heartbeat last looked.
    pub(crate) lately: AtomicBool,
    /// When any byte was, µs.
    at: AtomicU64,
    bytes: AtomicU64,
    /// How long the last answer to a ping of the hub took, µs; 0 = there was none.
    round_trip: AtomicU64,
}

impl Heard {
    /// Notes that a ping was answered.
    pub(crate) fn note_round_trip(&self, micros: Micros) {
        self.round_trip.store(micros.max(1), Ordering::Relaxed);
    }
}

/// How a peer has come, and when: noted at its login.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LoginFacts {
    /// Where its connection comes from, none inside this process.
    pub(crate) from: Option<IpAddr>,
    /// Nobody between can read along, as the hub or a proxy that it trusts knows.
    pub(crate) tls: bool,
    pub(crate) since: Time,
    /// By HTTP, through a peer inside this process.
    pub(crate) visit: bool,
}

/// One peer that has logged in, at one moment.
#[derive(Clone, Debug)]
pub(crate) struct PeerStatistics {
    pub(crate) name: Arc<str>,
    account: Arc<Account>,
    /// None inside this process.
    pub(crate) form: Option<Form>,
    pub(crate) door: Option<Door>,
    pub(crate) login: LoginFacts,
    /// The time since anything was heard, µs.
    pub(crate) heard: Micros,
    /// Of the hub's last ping that was answered, µs.
    pub(crate) round_trip: Option<Micros>,
    /// Bytes that wait for it.
    pub(crate) queued: usize,
    /// Bytes that its link has taken and brought; none counted inside this process.
    pub(crate) sent: u64,
    pub(crate) received: u64,
    /// Parcels dropped on their way to it.
    pub(crate) dropped: u64,
}

impl PeerStatistics {
    pub(crate) fn user(&self) -> &str {
        self.account.user()
    }

    /// The word for the wire form.
    pub(crate) fn form(&self) -> &'static str {
        self.form.map_or("none", Form::word)
    }

    /// The word for what carries it.
    pub(crate) fn door(&self) -> &'static str {
        match self.login.visit {
            true => "http",
            false => self.door.map_or("local", Door::word),
        }
    }

    pub(crate) fn to_map(&self) -> Map {
        let int = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
        let mut map = Map::new()
            .with("peer", &*self.name)
            .with("user", self.user())
            .with("form", self.form())
            .with("door", self.door())
            .with("tls", self.login.tls)
            .with("since", self.login.since)
            .with("heard", int(self.heard))
            .with("queued", int(self.queued as u64))
            .with("sent", int(self.sent))
            .with("received", int(self.received))
            .with("dropped", int(self.dropped));
        if let Some(from) = self.login.from {
            map.set("from", from.to_canonical().to_string());
        }
        if let Some(round_trip) = self.round_trip {
            map.set("round-trip", int(round_trip));
        }
        map
    }
}

impl Outbox {
    /// Notes that something has arrived, in the time slice that has begun, and how many bytes that are since the connection began.
    pub(crate) fn note_heard(&self, bytes: u64) {
        let now = self.slice_began.load(Ordering::Relaxed);
        self.heard.at.store(now, Ordering::Relaxed);
        self.heard.bytes.store(bytes, Ordering::Relaxed);
    }

    /// Notes that its peer has come back from there.
    pub(crate) fn note_move(&self, from: Option<IpAddr>, tls: bool) {
        if let Some(login) = &mut self.who.lock().login {
            (login.from, login.tls) = (from, tls);
        }
    }

    /// What is known of its peer, none before login.
    pub(crate) fn figures(&self) -> Option<PeerStatistics> {
        let (name, account, login) = {
            let who = self.who.lock();
            let login = **who.login.as_ref()?;
            (Arc::clone(&who.name), who.account.clone()?, login)
        };
        let (queued, dropped) = {
            let mut queue = self.queue.lock();
            (queue.bytes(), queue.dropped())
        };
        let round_trip = self.heard.round_trip.load(Ordering::Relaxed);
        let at = self.heard.at.load(Ordering::Relaxed);
        Some(PeerStatistics {
            name,
            account,
            form: self.form(),
            door: self.writer().and_then(|writer| writer.door()),
            login,
            heard: self.clock.now().saturating_sub(at),
            round_trip: (round_trip > 0).then_some(round_trip),
            queued,
            // A writer never waits for the link.
            sent: {
                let way = self.way();
                let saved = way.writer.as_ref().map_or(0, |writer| writer.saved());
                way.flow.written().saturating_add_signed(-saved)
            },
            received: self.heard.bytes.load(Ordering::Relaxed),
            dropped,
        })
    }
}
