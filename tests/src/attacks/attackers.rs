//! The peers that attack, and what the hub tells them.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value, WireError};
use tokio::task::JoinSet;
use tokio::time::sleep;

use super::Attack;
use crate::raw::{Raw, at};

/// Peers of the user `bob`, and others that only listen or sleep.
#[derive(Debug)]
pub struct Attackers {
    pub(super) attack: Attack,
    pub(super) address: SocketAddr,
    pub(super) peers: Vec<Raw>,
    /// Connections that read nothing.
    pub(super) sleepers: Vec<Raw>,
    listeners: JoinSet<()>,
    /// How often which code or event was heard.
    heard: BTreeMap<String, u64>,
    pub(super) rounds: u64,
}

impl Attackers {
    /// Connects what this attack needs.
    pub async fn connect(attack: Attack, address: SocketAddr) -> Attackers {
        let mut attackers = Attackers {
            attack,
            address,
            peers: Vec::new(),
            sleepers: Vec::new(),
            listeners: JoinSet::new(),
            heard: BTreeMap::new(),
            rounds: 0,
        };
        attackers.prepare().await;
        attackers
    }

    /// How often which code or event was heard.
    pub fn heard(&self) -> &BTreeMap<String, u64> {
        &self.heard
    }

    /// How many rounds were begun.
    pub fn rounds(&self) -> u64 {
        self.rounds
    }

    /// How often this was heard.
    pub fn times(&self, word: &str) -> u64 {
        self.heard.get(word).copied().unwrap_or_default()
    }

    pub(super) fn note(&mut self, word: &str) {
        *self.heard.entry(word.to_owned()).or_default() += 1;
    }

    /// One more peer that takes part.
    pub(super) async fn enter(&mut self, form: Form, paths: &[&str]) {
        let mut peer = Raw::login(self.address, form, "bob").await;
        peer.join(paths).await;
        self.peers.push(peer);
    }

    /// One that reads all, and does nothing.
    pub(super) async fn listen(&mut self, form: Form, paths: &[&str]) {
        let mut peer = Raw::login(self.address, form, "carol").await;
        for path in paths {
            while let Err(error) = peer.ask(about("join", path)).await {
                let wait = error.retry_in().expect("it may join, if later");
                sleep(wait).await; // tidy: as long as the hub says
            }
        }
        self.listeners.spawn(async move {
            // Its pings are not answered: the broker under test waits long enough.
            while peer
                .next_within(Duration::from_secs(600))
                .await
                .flatten()
                .is_some()
            {}
        });
    }

    /// Asks as this peer, and notes the answer; waits as long as the hub says if it is to come later.
    pub(super) async fn ask(&mut self, peer: usize, parcel: Parcel) -> Option<Value> {
        let id = self.peers[peer].post(parcel).await;
        self.answers(peer, id, 1).await.pop()
    }

    /// Reads until so many requests from this one on are answered, and notes the answers; gives those that went well.
    pub(super) async fn answers(&mut self, peer: usize, first: u64, count: u64) -> Vec<Value> {
        let mut done = Vec::new();
        let (mut left, mut wait) = (count, Duration::ZERO);
        while left > 0 {
            let Some(parcel) = self.peers[peer].next().await else {
                self.note("closed");
                break;
            };
            let answers = parcel
                .reference
                .is_some_and(|id| id >= first && id < first + count);
            match parcel.family {
                Family::Error => {
                    let error = WireError::from_parcel(&parcel);
                    self.note(error.code.word());
                    wait = wait.max(error.retry_in().unwrap_or_default());
                }
                Family::Event if parcel.name() == "dropped" => self.note_dropped(&parcel),
                Family::Time if parcel.name() == "ping" => {
                    let mut pong = Parcel::new(Family::Time, "pong");
                    pong.reference = parcel.id;
                    self.peers[peer].send_parcel(&pong).await;
                }
                _ if answers => done.push(parcel.value()),
                _ => {}
            }
            left -= u64::from(answers);
        }
        sleep(wait).await; // tidy: as long as the hub says
        done
    }

    fn note_dropped(&mut self, parcel: &Parcel) {
        let content = parcel.value();
        let reason = content.get("reason").and_then(Value::as_str).unwrap_or_default();
        self.note(&format!("dropped: {reason}"));
    }
}

/// A request about a context.
pub(super) fn about(name: &str, path: &str) -> Parcel {
    Parcel::new(Family::Context, name).context(at(path))
}

/// A request that makes one.
pub(super) fn make(path: &str, kind: &str) -> Parcel {
    about("create", path).content(Map::new().with("kind", kind))
}
