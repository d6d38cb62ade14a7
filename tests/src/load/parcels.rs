//! Parcels of every verb, with the content that it takes or with any.

use std::sync::Arc;

use mom_proto::codec::Form;
use mom_proto::{ContextKind, Delivery, Family, Map, Parcel, Path, Value, Verb};

use super::Mind;
use super::chance::{one_in, size};
use crate::raw::{at, message};

/// Names of contexts are few, so that peers meet.
const NAMES: [&str; 6] = ["a", "b", "c", "d", "e", "f"];

/// What the load may make and delete lies below this, so that one deletion at the end takes all of it.
pub const OWN: &str = "/free/load";

/// Channels of the configuration.
pub(super) const CHANNELS: [&str; 5] = ["/chat", "/bulk", "/newest", "/waiting", "/kept"];

impl Mind {
    /// Any parcel, and its verb.
    pub(super) fn parcel(&mut self, id: u64, form: Form) -> (Parcel, Verb) {
        let verb = match self.rng.u8(..8) {
            0..3 => Verb::Send,
            3 => Verb::Join,
            _ => self.verbs.draw(&mut self.rng),
        };
        // Who logs in and out all the time does little else.
        let verb = match verb {
            Verb::Logout if !one_in(&mut self.rng, 8) => Verb::Ping,
            _ => verb,
        };
        let parcel = self.parcel_of(verb, form);
        (
            if one_in(&mut self.rng, 30) {
                parcel
            } else {
                parcel.id(id)
            },
            verb,
        )
    }

    /// What a peer joins at first, so that it has something to say somewhere.
    pub(super) fn joins(&mut self) -> Vec<Parcel> {
        let own = NAMES.map(|name| format!("{OWN}/{name}"));
        let paths = CHANNELS.into_iter().chain(own.iter().map(String::as_str));
        let some = paths.filter(|_| self.rng.u8(..3) > 0).map(str::to_owned);
        let paths = ["/free", OWN]
            .map(str::to_owned)
            .into_iter()
            .chain(some.collect::<Vec<_>>());
        paths
            .map(|path| Parcel::new(Family::Context, "join").context(at(&path)))
            .collect()
    }

    /// A large message that nothing may drop.
    pub(super) fn large(&mut self) -> Parcel {
        let path = ["/chat", "/waiting", "/kept"][self.rng.usize(..3)];
        let size = self.rng.usize(1 << 12..1 << 19);
        let mut parcel = message("large", path, Value::Binary(vec![7; size].into()));
        parcel.delivery = Some(Delivery::Reliable);
        parcel.echo = Some(false);
        parcel
    }

    fn parcel_of(&mut self, verb: Verb, form: Form) -> Parcel {
        let (family, name) = self.class(verb);
        let mut parcel = Parcel::new(family, name);
        if !matches!(family, Family::Login | Family::Time) || one_in(&mut self.rng, 20) {
            let path = self.path(verb);
            parcel = parcel.context(path);
        }
        match self.rng.u8(..16) {
            0 => parcel.content = Some(self.content(form)),
            1 => {}
            _ if family == Family::Message => {
                parcel.content = one_in(&mut self.rng, 8)
                    .then_some(())
                    .map_or_else(|| Some(self.content(form)), |()| None);
            }
            _ => parcel.content = self.asked(verb).map(Into::into),
        }
        match family {
            Family::Message => self.message_slots(&mut parcel),
            Family::Time => parcel.reference = self.known_ping(),
            _ if one_in(&mut self.rng, 12) => self.message_slots(&mut parcel),
            _ => {}
        }
        if verb == Verb::Release && self.rng.bool() {
            parcel.fence = self.known_fence();
        }
        if verb == Verb::Unstop {
            parcel.extra.set("stop", self.known_stop());
        }
        parcel
    }

    /// What a verb is asked by; some are asked by more than one family, and some parcels are of none.
    fn class(&mut self, verb: Verb) -> (Family, Arc<str>) {
        let family = match verb {
            Verb::Info if self.rng.bool() => Family::Token,
            Verb::Stop | Verb::Unstop if self.rng.bool() => Family::Context,
            _ if one_in(&mut self.rng, 40) => self.families.draw(&mut self.rng),
            _ => verb.family(),
        };
        let name: Arc<str> = match verb {
            Verb::Send => {
                ["command", "state", "image", "say", "chat", "halt", "é"][self.rng.usize(..7)].into()
            }
            _ => verb.word().into(),
        };
        match self.rng.u8(..60) {
            0 => (family, "relaese".into()),
            1 => (family, "x".repeat(self.rng.usize(..200)).into()),
            _ => (family, name),
        }
    }

    fn name(&mut self) -> &'static str {
        NAMES[self.rng.usize(..NAMES.len())]
    }

    /// Where it is asked. What is made or deleted is the load's own.
    fn path(&mut self, verb: Verb) -> Path {
        let own = matches!(verb, Verb::Create | Verb::Delete);
        let path = match self.rng.u8(..16) {
            0 if !own => "/".to_owned(),
            1 if !own => {
                ["/robot", "/robot/arm", "/robot/token", "/reports", "/free"][self.rng.usize(..5)].to_owned()
            }
            2..7 if !own => CHANNELS[self.rng.usize(..CHANNELS.len())].to_owned(),
            7 if !own => OWN.to_owned(),
            8 => format!("{OWN}/{}", "deep/".repeat(self.rng.usize(..20)) + self.name()),
            9..12 => format!("{OWN}/{}/{}", self.name(), self.name()),
            _ => format!("{OWN}/{}", self.name()),
        };
        at(&path)
    }

    /// The path of something of the load's own.
    fn own(&mut self) -> String {
        format!("{OWN}/{}", self.name())
    }

    fn peer(&mut self) -> String {
        match self.rng.u8(..6) {
            0 => "nobody".to_owned(),
            1 => ["bob", "carol", "guest", "bob~2"][self.rng.usize(..4)].to_owned(),
            _ => {
                let peer = self.rng.choice(&self.known.peers).cloned();
                peer.unwrap_or_else(|| "bob".to_owned())
            }
        }
    }

    fn known_ping(&mut self) -> Option<u64> {
        self.rng.choice(&self.known.pings).copied()
    }

    fn known_fence(&mut self) -> Option<u64> {
        let fence = self.rng.choice(&self.known.fences).copied();
        fence.and_then(|fence| u64::try_from(fence).ok())
    }

    /// The newest stop, or an older one, or one that there never was.
    fn known_stop(&mut self) -> i64 {
        let known = match self.rng.bool() {
            true => self.known.stops.back().copied(),
            false => self.rng.choice(&self.known.stops).copied(),
        };
        match one_in(&mut self.rng, 8) {
            true => self.int(),
            false => known.unwrap_or_default(),
        }
    }

    fn known_consult(&mut self) -> i64 {
        let known = self.rng.choice(&self.known.consults).copied();
        known.unwrap_or_else(|| self.rng.i64(0..10))
    }

    /// The content that a verb takes. A new verb gets any.
    fn asked(&mut self, verb: Verb) -> Option<Value> {
        let ms = self.rng.i64(0..3000);
        let map = match verb {
            Verb::Login => self.login_again(),
            Verb::Answer => Map::new().with("signature", Value::Binary(vec![7; 64].into())),
            Verb::Resume => {
                let link = self.rng.choice(&self.known.links).map(|link| link.id.clone());
                Map::new().with("link", link.unwrap_or_else(|| "0".repeat(32)))
            }
            Verb::Create => return Some(self.creation().into()),
            Verb::Join | Verb::Device => self.joining(),
            Verb::List | Verb::Members => Map::new().with("after", self.name()),
            Verb::Stats | Verb::Lookup | Verb::Info | Verb::Leave | Verb::Delete | Verb::Logout => {
                return None;
            }
            Verb::Audit => self.audit(),
            Verb::Explain => self.explanation(),
            Verb::WhatIf => match self.rng.bool() {
                true => Map::new(),
                false => Map::new().with("config", "root = \"open\"\n").with("rules", true),
            },
            Verb::Invite => Map::new().with("peer", self.peer()),
            // Its user cannot log in for that time.
            Verb::Expel => Map::new().with("peer", self.peer()).with("for", ms / 10),
            Verb::Grab => Map::new().with("wait", ms),
            Verb::Give => self.gift(ms),
            Verb::Request => Map::new().with("within", ms + 1).with("text", "please"),
            Verb::Accept | Verb::Decline => match self.rng.bool() {
                true => return None,
                false => Map::new().with("peer", self.peer()),
            },
            Verb::Stop => Map::new().with("reason", self.text(300)).with("within", ms / 10),
            Verb::Unstop => {
                let (stop, path) = (self.known_stop(), self.path(Verb::Send));
                let stops = Map::new().with(path.as_str(), stop);
                Map::new()
                    .with("stop", stop)
                    .with("stops", stops)
                    .with("within", ms / 10)
            }
            Verb::Verdict => {
                let verdict = Map::new().with("consult", self.known_consult());
                verdict
                    .with("allow", self.rng.bool())
                    .with("stands", self.rng.bool())
            }
            Verb::Ping | Verb::Pong => {
                let stamps = Map::new().with("sent", self.time());
                stamps.with("received", self.time())
            }
            Verb::Ack => Map::new().with("read", self.rng.i64(0..50)),
            Verb::Release | Verb::Renew | Verb::Break | Verb::Inhibit | Verb::Uninhibit => return None,
            _ => return Some(self.content(Form::Xml).to_value().unwrap_or_default()),
        };
        Some(map.into())
    }

    fn gift(&mut self, ms: i64) -> Map {
        let gift = Map::new().with("to", self.peer()).with("within", ms + 1);
        match self.rng.bool() {
            true => gift,
            false => gift.with("for", ms + 1).with("commands", self.rng.i64(1..5)),
        }
    }

    fn joining(&mut self) -> Map {
        let mut joining = Map::new();
        if self.rng.bool() {
            joining.set("newest", self.rng.bool());
        }
        match self.rng.u8(..4) {
            0 => joining.set("rate", self.rng.i64(0..1100)),
            1 => joining.set("rate", "5/s"),
            _ => {}
        }
        match self.rng.u8(..4) {
            0 => joining.set("device", true),
            1 => {
                let heard = Map::new().with("stop", self.known_stop());
                joining.set("device", heard.with("stopped", self.rng.bool()));
            }
            _ => {}
        }
        joining
    }

    fn audit(&mut self) -> Map {
        let wanted = Map::new().with("most", self.rng.i64(1..200));
        match self.rng.u8(..4) {
            0 => wanted.with("peer", self.peer()),
            1 => wanted.with("text", "B").with("verb", "join"),
            2 => wanted.with("before", self.int()).with("since", self.time()),
            _ => wanted,
        }
    }

    fn explanation(&mut self) -> Map {
        let verb = self.rng.choice(&Verb::ALL).copied().unwrap_or(Verb::Send);
        match self.rng.u8(..4) {
            0 => Map::new(),
            1 => Map::new().with("user", "bob").with("verb", verb.word()),
            2 => Map::new().with("peer", self.peer()),
            _ => {
                let users = (0..self.rng.usize(..40)).map(|_| self.peer().into());
                let users: Vec<Value> = users.collect();
                Map::new()
                    .with("users", users)
                    .with("message", "command")
                    .with("verb", "send")
            }
        }
    }

    fn creation(&mut self) -> Map {
        let kind = *self.rng.choice(&ContextKind::ALL).expect("there are kinds");
        let mut content = Map::new().with("kind", kind.word());
        if one_in(&mut self.rng, 3) {
            content.set("manager", self.manager(1));
        }
        if one_in(&mut self.rng, 3) {
            content.set("transient", true);
        }
        if one_in(&mut self.rng, 4) {
            content.set("presence", ["all", "counts", "none"][self.rng.usize(..3)]);
        }
        match kind {
            ContextKind::Channel => self.channel(&mut content),
            ContextKind::Token => {
                content.set("lease", self.rng.i64(10..5000));
                content.set("expiry", ["lazy", "eager"][self.rng.usize(..2)]);
                if self.rng.bool() {
                    content.set("deadman", self.rng.i64(10..2000));
                    content.set("stop-ends-grant", self.rng.bool());
                }
                if one_in(&mut self.rng, 3) {
                    let safe = Map::new().with("channel", self.own()).with("name", "safe");
                    content.set("safe", safe.with("content", self.text(300)));
                }
            }
            ContextKind::Session => {}
        }
        content
    }

    fn channel(&mut self, content: &mut Map) {
        content.set("delivery", self.delivery().word());
        match self.rng.u8(..4) {
            0 => {
                let keep = Map::new().with("parcels", 1000).with("latest", self.rng.bool());
                content.set("keep", keep.with("bytes", self.rng.i64(1..1 << 24)));
            }
            1 => content.set("overflow", "wait"),
            2 => {
                let guard = Map::new().with("token", self.own());
                content.set("guard", guard.with("names", vec![Value::from("*")]));
            }
            _ => {}
        }
    }

    /// A manager of every kind that a peer may name.
    fn manager(&mut self, depth: usize) -> Value {
        let kind = |kind: &str| Map::new().with("kind", kind);
        let ms = self.rng.i64(1..5000);
        let map = match self.rng.u8(..11) {
            0 => return "open".into(),
            1 => return "closed".into(),
            2 => return "self".into(),
            3 => return "members".into(),
            4 => kind("first-come").with("lease", ms),
            5 => kind("queue").with("lease", ms).with("hold", ms).with("notice", 0),
            6 => kind("level-or-lease").with("lease", ms).with("deadman", ms),
            7 => {
                let chairs = Map::new().with("users", vec![Value::from("carol")]);
                kind("moderated")
                    .with("chairs", chairs)
                    .with("within", ms)
                    .with("verbs", vec!["*".into()])
            }
            8 => {
                let slot = Map::new().with("from", "00:00").with("to", "12:00");
                kind("schedule").with("slots", vec![slot.into()])
            }
            9 if depth > 0 => {
                let of = (0..self.rng.usize(0..18)).map(|_| self.manager(depth - 1));
                let of: Vec<Value> = of.collect();
                kind("chain").with("of", of)
            }
            9 => {
                let limit = Map::new()
                    .with("parcels", 20)
                    .with("bytes", self.rng.i64(1..100_000));
                kind("quota").with("limits", vec![limit.into()])
            }
            _ => {
                let rules = (0..self.rng.usize(1..20)).map(|number| {
                    let rule = Map::new().with("name", format!("rule {number}"));
                    let rule = rule.with("allow", vec![Value::from("*")]);
                    Value::Map(rule.with("min-level", self.rng.i64(0..4)))
                });
                let rules: Vec<Value> = rules.collect();
                kind("roles").with("rules", rules)
            }
        };
        map.into()
    }

    fn delivery(&mut self) -> Delivery {
        *self.rng.choice(&Delivery::ALL).expect("there are classes")
    }

    /// Slots of messages, those of the hub among them, and such as nobody knows.
    fn message_slots(&mut self, parcel: &mut Parcel) {
        parcel.delivery = self.rng.bool().then(|| self.delivery());
        parcel.priority = self.rng.bool().then(|| self.rng.i32(-150..150));
        parcel.receipt = self.rng.bool().then(|| self.rng.bool());
        parcel.echo = self.rng.bool().then(|| self.rng.bool());
        parcel.expires = one_in(&mut self.rng, 4).then(|| self.rng.u64(0..1000));
        parcel.timestamp = one_in(&mut self.rng, 4).then(|| self.time());
        if one_in(&mut self.rng, 6) {
            let many = if one_in(&mut self.rng, 10) { 500 } else { 4 };
            let peers = (0..self.rng.usize(1..many)).map(|_| self.peer().into());
            parcel.address = Some(peers.collect());
        }
        match self.rng.u8(..24) {
            0 => parcel.sender = Some("hub".into()),
            1 => parcel.fence = self.known_fence(),
            2 => parcel.fence = Some(self.rng.u64(0..1 << 53)),
            3 => parcel.received = Some(self.time()),
            4 => parcel.age = Some(self.int()),
            5 => parcel.extra.set("history", true),
            6 => parcel
                .extra
                .set("trace", "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"),
            7 => parcel.extra.set("stop", self.known_stop()),
            8..11 => {
                let key = self.key();
                parcel
                    .extra
                    .set(&key, self.content(Form::Xml).to_value().unwrap_or_default());
            }
            11 => parcel.extra.set("note", "x".repeat(size(&mut self.rng))),
            _ => {}
        }
    }
}
