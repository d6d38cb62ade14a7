//! What is drawn by chance, from a seed.

use std::collections::VecDeque;

use fastrand::Rng;
use mom_proto::{Family, Parcel, ReadCount, Value};

/// The most bytes of anything: what a parcel may have.
pub(super) const MOST: usize = 8 << 20;

/// Facts of each kind that are remembered.
const REMEMBERED: usize = 32;

/// Draws each of its things once before it draws one again: so a short load has everything, too.
#[derive(Debug)]
pub(super) struct Deck<T> {
    all: Vec<T>,
    left: Vec<T>,
}

impl<T: Copy> Deck<T> {
    pub(super) fn new(all: impl Into<Vec<T>>) -> Deck<T> {
        let all = all.into();
        Deck {
            all,
            left: Vec::new(),
        }
    }

    /// The next one.
    ///
    /// # Panics
    /// If it never had any.
    pub(super) fn draw(&mut self, rng: &mut Rng) -> T {
        if self.left.is_empty() {
            self.left.clone_from(&self.all);
            rng.shuffle(&mut self.left);
        }
        self.left.pop().expect("a deck has something")
    }
}

/// Sizes of every order, from nothing to [`MOST`]; large ones are few, or nothing else would be sent.
pub(super) fn size(rng: &mut Rng) -> usize {
    let orders = match rng.u8(..16) {
        0 => 24,
        1..4 => 18,
        _ => 13,
    };
    match rng.u32(0..orders) {
        0 => 0,
        order => rng.usize(1 << (order - 1)..=1 << order).min(MOST),
    }
}

/// One in so many.
pub(super) fn one_in(rng: &mut Rng, many: u32) -> bool {
    rng.u32(..many) == 0
}

/// What one of the hub's peers needs to come back.
#[derive(Clone, Debug)]
pub(super) struct Link {
    pub(super) id: String,
    pub(super) secret: Vec<u8>,
    /// Parcels of the hub that it has read.
    pub(super) read: ReadCount,
}

/// What the load has heard of the hub: some of what it says is true for that, and some was once.
#[derive(Debug, Default)]
pub(super) struct Known {
    pub(super) stops: VecDeque<i64>,
    pub(super) fences: VecDeque<i64>,
    pub(super) consults: VecDeque<i64>,
    pub(super) peers: VecDeque<String>,
    pub(super) links: VecDeque<Link>,
    pub(super) nonces: VecDeque<Vec<u8>>,
    pub(super) pings: VecDeque<u64>,
}

/// Adds one and forgets the oldest.
pub(super) fn remember<T>(known: &mut VecDeque<T>, fact: T) {
    if known.len() >= REMEMBERED {
        known.pop_front();
    }
    known.push_back(fact);
}

impl Known {
    /// Takes what a parcel of the hub says.
    pub(super) fn hear(&mut self, parcel: &Parcel) {
        if parcel.is(Family::Time, "ping") {
            parcel.id.into_iter().for_each(|id| remember(&mut self.pings, id));
        }
        if parcel.is(Family::Manager, "consult") {
            let number = parcel.id.and_then(|id| i64::try_from(id).ok());
            number
                .into_iter()
                .for_each(|number| remember(&mut self.consults, number));
        }
        if let Some(number) = parcel.extra.get("stop").and_then(Value::as_int) {
            remember(&mut self.stops, number);
        }
        // What others say may be large.
        if parcel.family == Family::Message {
            return;
        }
        let content = parcel.value();
        if let Some(fence) = content.get("fence").and_then(Value::as_int) {
            remember(&mut self.fences, fence);
        }
        if let Some(number) = content.get("stop").and_then(|stop| stop.get("number")?.as_int()) {
            remember(&mut self.stops, number);
        }
        if let Some(peer) = content.get("peer").and_then(Value::as_str) {
            // A peer that is thrown out would notice.
            if !["alice", "arm"].iter().any(|canary| peer.starts_with(canary)) {
                remember(&mut self.peers, peer.to_owned());
            }
        }
        if let Some(nonce) = content.get("nonce").and_then(Value::as_binary) {
            remember(&mut self.nonces, nonce.to_vec());
        }
    }
}
