//! Random load of the well-formed kind: whatever permitted peers may do, in any order, from a seed.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use fastrand::Rng;
use mom_proto::codec::Form;
use mom_proto::{Delivery, Family, Map, Parcel, Value};

use crate::raw::{Raw, at};

/// Peers of the load, of these users.
const PEERS: usize = 8;
const USERS: [&str; 2] = ["bob", "carol"];

/// Names of contexts are few, so that peers meet.
const NAMES: [&str; 6] = ["a", "b", "c", "d", "e", "f"];

/// Steps that one peer does before another has its turn.
const TURN: usize = 20;

/// Peers that do at random what they may.
#[derive(Debug)]
pub struct Load {
    address: SocketAddr,
    rng: Rng,
    peers: Vec<Option<Raw>>,
    /// Steps done.
    pub steps: u64,
}

impl Load {
    /// The load of this seed.
    pub fn new(address: SocketAddr, seed: u64) -> Load {
        Load {
            address,
            rng: Rng::with_seed(seed),
            peers: (0..PEERS).map(|_| None).collect(),
            steps: 0,
        }
    }

    /// Goes on for so long.
    pub async fn run(&mut self, time: Duration) {
        let end = Instant::now() + time;
        while Instant::now() < end {
            let peer = self.rng.usize(..PEERS);
            self.turn(peer).await;
        }
    }

    /// One peer does a few things, and reads what came for it, or does not.
    async fn turn(&mut self, peer: usize) {
        let mut raw = match self.peers[peer].take() {
            Some(raw) => raw,
            None => match self.login().await {
                Some(raw) => raw,
                None => return,
            },
        };
        let mut frames = Vec::new();
        for _ in 0..self.rng.usize(1..TURN) {
            self.steps += 1;
            let parcel = self.parcel(self.steps);
            // What has no form on the wire is not well-formed.
            if let Ok(encoded) = raw.form().encode(&parcel) {
                frames.extend(encoded.to_vec());
            }
        }
        // The hub may hold a sender back that reads nothing itself.
        let sent = tokio::time::timeout(Duration::from_millis(500), raw.send_patiently(&frames)).await;
        if !matches!(sent, Ok(Ok(()))) {
            return self.leave(raw);
        }
        // Some read seldom.
        if self.rng.u8(..4) > 0 {
            let ends = loop {
                match raw.next_within(Duration::ZERO).await {
                    None => break false,
                    Some(None) => break true,
                    Some(Some(parcel)) if parcel.is(Family::Time, "ping") => {
                        let mut pong = Parcel::new(Family::Time, "pong");
                        pong.reference = parcel.id;
                        raw.send_parcel(&pong).await;
                    }
                    Some(Some(_)) => {}
                }
            };
            if ends {
                return;
            }
        }
        match self.rng.u8(..40) {
            0 => self.leave(raw),
            _ => self.peers[peer] = Some(raw),
        }
    }

    fn leave(&mut self, raw: Raw) {
        match self.rng.bool() {
            true => raw.reset(),
            false => drop(raw),
        }
    }

    async fn login(&mut self) -> Option<Raw> {
        let form = *self.rng.choice(&Form::ALL)?;
        let user = *self.rng.choice(&USERS)?;
        let mut raw = match self.rng.bool() {
            true => Raw::connect(self.address, form).await,
            false => Raw::connect_small(self.address, form).await,
        };
        // Too many may have come from one place.
        raw.try_log_in(user).await.ok()?;
        Some(raw)
    }

    fn name(&mut self) -> &'static str {
        NAMES[self.rng.usize(..NAMES.len())]
    }

    fn path(&mut self) -> String {
        match self.rng.u8(..12) {
            0 => "/".to_owned(),
            1 => "/chat".to_owned(),
            2 => "/kept".to_owned(),
            3 => "/bulk".to_owned(),
            4 => "/free".to_owned(),
            5..9 => format!("/free/{}", self.name()),
            _ => format!("/free/{}/{}", self.name(), self.name()),
        }
    }

    fn parcel(&mut self, id: u64) -> Parcel {
        let path = self.path();
        let parcel = match self.rng.u8(..10) {
            0 | 1 => self.creation(&path),
            2..5 => self.request(&path),
            _ => self.message(&path),
        };
        parcel.id(id)
    }

    fn request(&mut self, path: &str) -> Parcel {
        let context = [
            "join", "join", "join", "leave", "list", "members", "info", "lookup", "stats", "delete",
        ];
        let token = [
            "grab",
            "release",
            "renew",
            "give",
            "accept",
            "decline",
            "request",
            "inhibit",
            "uninhibit",
        ];
        let (family, names) = match self.rng.u8(..3) {
            0 => (Family::Token, &token[..]),
            _ => (Family::Context, &context[..]),
        };
        let name = names[self.rng.usize(..names.len())];
        let parcel = Parcel::new(family, name).context(at(path));
        match name {
            "grab" => parcel.content(Map::new().with("wait", self.rng.i64(0..2000))),
            "give" => parcel.content(Map::new().with("to", "bob")),
            "join" if self.rng.u8(..4) == 0 => {
                parcel.content(Map::new().with("rate", 10).with("newest", true))
            }
            _ => parcel,
        }
    }

    fn creation(&mut self, path: &str) -> Parcel {
        let kind = ["session", "channel", "token"][self.rng.usize(..3)];
        let mut content = Map::new().with("kind", kind);
        if self.rng.u8(..3) == 0 {
            content.set("manager", self.manager());
        }
        if self.rng.u8(..3) == 0 {
            content.set("transient", true);
        }
        match kind {
            "channel" => {
                content.set("delivery", self.delivery().word());
                match self.rng.u8(..4) {
                    0 => content.set(
                        "keep",
                        Map::new().with("parcels", 100).with("latest", self.rng.bool()),
                    ),
                    1 => content.set("overflow", "wait"),
                    2 => {
                        let token = format!("/free/{}/{}", self.name(), self.name());
                        let guard = Map::new().with("token", token);
                        content.set("guard", guard.with("names", vec![Value::from("*")]));
                    }
                    _ => {}
                }
            }
            "token" => content.set("lease", self.rng.i64(10..5000)),
            _ => {}
        }
        Parcel::new(Family::Context, "create")
            .context(at(path))
            .content(content)
    }

    fn manager(&mut self) -> Value {
        let rules = (0..self.rng.usize(1..20)).map(|number| {
            let rule = Map::new()
                .with("name", format!("rule {number}"))
                .with("allow", vec![Value::from("*")]);
            Value::Map(rule.with("min-level", self.rng.i64(0..4)))
        });
        let rules: Vec<Value> = rules.collect();
        match self.rng.u8(..5) {
            0 => "open".into(),
            1 => "first-come".into(),
            2 => "queue".into(),
            3 => "self".into(),
            _ => Map::new().with("kind", "roles").with("rules", rules).into(),
        }
    }

    fn delivery(&mut self) -> Delivery {
        [Delivery::Reliable, Delivery::Latest, Delivery::Fleeting][self.rng.usize(..3)]
    }

    fn message(&mut self, path: &str) -> Parcel {
        let name = ["say", "state", "image", "stop", "unstop"][self.rng.usize(..5)];
        let mut parcel = Parcel::new(Family::Message, name).context(at(path));
        if self.rng.bool() {
            parcel = parcel.content(self.value(3));
        }
        parcel.delivery = self.rng.bool().then(|| self.delivery());
        parcel.priority = self.rng.bool().then(|| self.rng.i32(-50..50));
        parcel.receipt = self.rng.bool().then_some(true);
        parcel.echo = self.rng.bool().then_some(false);
        parcel.expires = (self.rng.u8(..4) == 0).then(|| self.rng.u64(1..1000));
        if self.rng.u8(..8) == 0 {
            parcel.extra = Map::new().with("note", "x".repeat(self.size() / 32));
        }
        parcel
    }

    /// Sizes of every order: as many up to 10 bytes as up to a mebibyte.
    fn size(&mut self) -> usize {
        let most = 1_usize << self.rng.u32(0..20);
        self.rng.usize(0..=most)
    }

    fn value(&mut self, depth: usize) -> Value {
        match self.rng.u8(..8) {
            0 => Value::Null,
            1 => self.rng.i64(..).into(),
            2 => Value::Double(self.rng.f64()),
            3 => "é<&>".repeat(self.size() / 5).into(),
            4 => Value::Binary(vec![self.rng.u8(..); self.size()].into()),
            5 => vec![Value::Int(7); self.size() / 64].into(),
            6 if depth > 0 => (0..self.rng.usize(0..8))
                .map(|_| self.value(depth - 1))
                .collect::<Vec<_>>()
                .into(),
            _ if depth > 0 => {
                let mut map = Map::new();
                for _ in 0..self.rng.usize(0..8) {
                    map.set(self.name(), self.value(depth - 1));
                }
                map.into()
            }
            _ => true.into(),
        }
    }
}
