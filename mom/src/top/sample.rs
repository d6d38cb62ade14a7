//! What the hub tells of its peers, what follows from two such answers, who owns which token, and what is stopped.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use mom_client::{
    Client, ClientError, ConnectedPeer, ContextInfo, ContextKind, Path, Stats, StopState, Value,
};

/// Contexts that one walk looks at, at most.
const LOOKS: usize = 1000;

/// Tokens whose owners are asked for, at most.
const TOKENS: usize = 256;

/// Sessions whose channels are looked at for stops, at most.
const SESSIONS: usize = 256;

/// Owners and stops are asked for so many times before the tree is walked again for new contexts.
const ROUNDS: u32 = 10;

/// One answer of the hub.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub(super) stats: Stats,
    at: Instant,
}

/// What happened between two answers, per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Rates {
    /// Messages, and what became of them.
    pub(super) messages: f64,
    pub(super) delivered: f64,
    pub(super) dropped: f64,
    /// Bytes from peers and to them.
    pub(super) received: f64,
    pub(super) sent: f64,
}

impl Sample {
    pub(super) async fn ask(client: &Client) -> Result<Sample, ClientError> {
        let stats = client.stats("/").await?;
        Ok(Sample::new(stats, Instant::now()))
    }

    pub(super) fn new(stats: Stats, at: Instant) -> Sample {
        Sample { stats, at }
    }

    pub(super) fn connections(&self) -> u64 {
        self.stats.peers.len() as u64 + self.stats.more_peers
    }

    /// What happened since an earlier answer. Peers that came or went meanwhile are left out: their counts are not known at both ends.
    pub(super) fn rates_since(&self, before: &Sample) -> Rates {
        let time = self.at.duration_since(before.at).max(Duration::from_millis(1));
        let rate = |count: u64| count as f64 / time.as_secs_f64();
        let mut rates = Rates::default();
        let earlier: BTreeMap<&Path, _> = before
            .stats
            .channels
            .iter()
            .map(|channel| (&channel.path, &channel.all))
            .collect();
        for channel in &self.stats.channels {
            if let Some(earlier) = earlier.get(&channel.path) {
                let now = &channel.all;
                rates.messages += rate(now.sent.saturating_sub(earlier.sent));
                rates.delivered += rate(now.delivered.saturating_sub(earlier.delivered));
                rates.dropped += rate(now.lost().saturating_sub(earlier.lost()));
            }
        }
        let earlier: BTreeMap<_, _> = before.stats.peers.iter().map(|peer| (key(peer), peer)).collect();
        for peer in &self.stats.peers {
            if let Some(earlier) = earlier.get(&key(peer)) {
                rates.received += rate(peer.received.saturating_sub(earlier.received));
                rates.sent += rate(peer.sent.saturating_sub(earlier.sent));
            }
        }
        rates
    }
}

/// A name may be another connection's a moment later.
fn key(peer: &ConnectedPeer) -> (&str, i64) {
    (&peer.peer, peer.since.micros())
}

/// The tokens that each peer owns, by the peer's name.
pub(super) type Owned = BTreeMap<String, Vec<Path>>;

/// Channels in which a stop holds.
pub(super) type Stopped = BTreeMap<Path, StopState>;

/// What the contexts of the tree tell.
#[derive(Clone, Debug, Default)]
pub(super) struct Holds {
    pub(super) owned: Owned,
    pub(super) stopped: Stopped,
}

/// Looks for tokens and their owners and for stops, below some contexts.
#[derive(Debug)]
pub(super) struct TreeWalk {
    tops: Vec<ContextInfo>,
    tokens: Vec<Path>,
    /// Those that have channels.
    sessions: Vec<Path>,
    rounds: u32,
}

impl TreeWalk {
    pub(super) fn new(tops: Vec<ContextInfo>) -> TreeWalk {
        TreeWalk {
            tops,
            tokens: Vec::new(),
            sessions: Vec::new(),
            rounds: 0,
        }
    }

    /// Asks who owns what and what is stopped now. What this user may not know is left out.
    pub(super) async fn holds(&mut self, client: &Client) -> Holds {
        if self.rounds == 0 {
            self.look(client).await;
            self.rounds = ROUNDS;
        }
        self.rounds -= 1;
        Holds {
            owned: self.owned(client).await,
            stopped: self.stopped(client).await,
        }
    }

    async fn owned(&self, client: &Client) -> Owned {
        let mut owned = Owned::new();
        for path in &self.tokens {
            let Ok(facts) = client.info(path.as_str()).await else {
                continue;
            };
            let holders = facts.get("holders").and_then(Value::as_list).unwrap_or_default();
            let owner = facts.get("owner").into_iter().chain(holders);
            for owner in owner.filter_map(Value::as_str) {
                let tokens = owned.entry(owner.to_owned()).or_default();
                if tokens.last() != Some(path) {
                    tokens.push(path.clone());
                }
            }
        }
        owned
    }

    async fn stopped(&self, client: &Client) -> Stopped {
        let mut stopped = Stopped::new();
        for session in &self.sessions {
            let below = client.list(session.as_str()).await.unwrap_or_default();
            stopped.extend(below.into_iter().filter_map(|info| Some((info.path, info.stop?))));
        }
        for top in self.tops.iter().filter(|top| top.kind == ContextKind::Channel) {
            let state = client.stops(top.path.as_str()).await;
            stopped.extend(state.map(|state| (top.path.clone(), state)));
        }
        stopped.retain(|_, state| state.stopped);
        stopped
    }

    async fn look(&mut self, client: &Client) {
        self.tokens.clear();
        self.sessions.clear();
        let mut looks = 0;
        let mut next: Vec<ContextInfo> = self.tops.clone();
        while let Some(info) = next.pop() {
            looks += 1;
            if looks > LOOKS || self.tokens.len() == TOKENS {
                break;
            }
            match info.kind {
                ContextKind::Token => self.tokens.push(info.path),
                ContextKind::Session => {
                    let below = client.list(info.path.as_str()).await.unwrap_or_default();
                    let has_channels = below.iter().any(|info| info.kind == ContextKind::Channel);
                    if has_channels && self.sessions.len() < SESSIONS {
                        self.sessions.push(info.path);
                    }
                    next.extend(below.into_iter().rev());
                }
                ContextKind::Channel => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{peer, stats};
    use super::*;

    #[test]
    fn rates_are_of_those_that_were_here_before() {
        let begin = Instant::now();
        let old = stats(vec![peer("alice", |peer| peer.received = 1000)]);
        let mut new = stats(vec![
            peer("alice", |peer| (peer.received, peer.sent) = (3000, 500)),
            peer("bob", |peer| peer.received = 1 << 30),
        ]);
        new.channels[0].all.sent += 20;
        let before = Sample::new(old, begin);
        let now = Sample::new(new, begin + Duration::from_secs(2));
        let rates = now.rates_since(&before);
        assert_eq!(
            (rates.received, rates.sent, rates.messages),
            (1000.0, 250.0, 10.0)
        );
        assert_eq!((rates.dropped, now.connections()), (0.0, 2));
    }
}
