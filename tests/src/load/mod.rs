//! Random load: whatever peers may do, and what they may not, through every door, in every form, in any order, from a seed.

mod chance;
mod contents;
mod doors;
mod frames;
mod logins;
mod parcels;
mod peer;
mod pipe;

use std::collections::BTreeSet;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::{Duration, Instant};

use fastrand::Rng;
use mom_proto::codec::Form;
use mom_proto::{Family, Verb};
use tokio::time::timeout;

use crate::bridge::Way;
use chance::{Deck, Known};
use contents::Kind;
use frames::Shape;
use peer::{Habit, Peer};
use pipe::Route;

/// What the load makes lies below this: the caller makes it, and deletes it at the end.
pub use parcels::OWN;

/// Peers of the load.
const PEERS: usize = 8;

/// How long one tries to come in.
const ARRIVAL: Duration = Duration::from_secs(5);

/// After so many steps everything has been done.
const ENOUGH: u64 = 6000;

/// Peers that do at random what they may, and what they may not.
#[derive(Debug)]
pub struct Load {
    hub: SocketAddr,
    mind: Mind,
    peers: Vec<Option<Peer>>,
}

/// What the peers of a load have in common.
#[derive(Debug)]
struct Mind {
    rng: Rng,
    known: Known,
    verbs: Deck<Verb>,
    families: Deck<Family>,
    kinds: Deck<Kind>,
    /// Of the text forms, and of the binary ones.
    shapes: [Deck<Shape>; 2],
    ways: Deck<(Form, Way)>,
    habits: Deck<Habit>,
    leaves: Deck<peer::Way>,
    steps: u64,
    done: BTreeSet<String>,
}

impl Load {
    /// The load of this seed.
    pub fn new(hub: SocketAddr, seed: u64) -> Load {
        Load {
            hub,
            mind: Mind {
                rng: Rng::with_seed(seed),
                known: Known::default(),
                verbs: Deck::new(Verb::ALL),
                families: Deck::new(Family::ALL),
                kinds: Deck::new(Kind::ALL),
                shapes: [Form::Xml, Form::Binary].map(|form| Deck::new(Shape::of(form))),
                ways: Deck::new(doors::ways()),
                habits: Deck::new(Habit::ALL),
                leaves: Deck::new(peer::Way::ALL),
                steps: 0,
                done: BTreeSet::new(),
            },
            peers: (0..PEERS).map(|_| None).collect(),
        }
    }

    /// Goes on for so long, and leaves.
    pub async fn run(&mut self, time: Duration) {
        let end = Instant::now() + time;
        while Instant::now() < end {
            let at = self.mind.rng.usize(..PEERS);
            self.turn(at).await;
        }
        for peer in self.peers.iter_mut().filter_map(Option::take) {
            let way = self.mind.leaves.draw(&mut self.mind.rng);
            peer.leave(&mut self.mind, way).await;
        }
    }

    /// Steps done.
    pub fn steps(&self) -> u64 {
        self.mind.steps
    }

    /// What loads of enough steps together have not done: nothing, unless one of the lists has gaps.
    pub fn missing(loads: &[Load]) -> Vec<String> {
        let steps: u64 = loads.iter().map(Load::steps).sum();
        let mut missing = wanted();
        missing.retain(|what| !loads.iter().any(|load| load.mind.done.contains(what)));
        match steps < ENOUGH {
            true => Vec::new(),
            false => missing.into_iter().collect(),
        }
    }

    /// One peer does a few things, and reads what came for it, or does not.
    async fn turn(&mut self, at: usize) {
        let mind = &mut self.mind;
        let mut peer = match self.peers[at].take() {
            Some(peer) => peer,
            None => match arrival(self.hub, mind, false).await {
                Some(peer) => peer,
                None => return,
            },
        };
        match peer.turn(mind).await {
            true => self.peers[at] = Some(peer),
            false => {
                let way = mind.leaves.draw(&mut mind.rng);
                mind.done(&format!("leave {way:?}"));
                let comes_back = peer.link.is_some()
                    && matches!(way, peer::Way::End | peer::Way::Reset | peer::Way::InFrame);
                peer.leave(mind, way).await;
                if comes_back {
                    self.peers[at] = arrival(self.hub, mind, true).await;
                }
            }
        }
    }
}

impl Mind {
    fn done(&mut self, what: &str) {
        if !self.done.contains(what) {
            self.done.insert(what.to_owned());
        }
    }

    fn said(&mut self, family: Family, verb: Verb, shape: Shape) {
        self.done(&format!("family {family}"));
        self.done(&format!("verb {verb}"));
        self.done(&format!("shape {shape:?}"));
    }
}

/// A new peer, through a door and in a form that have not had their turn yet; some are back.
async fn arrival(hub: SocketAddr, mind: &mut Mind, back: bool) -> Option<Peer> {
    let (form, way) = mind.ways.draw(&mut mind.rng);
    let habit = mind.habits.draw(&mut mind.rng);
    // The hub counts what fails by address.
    let from = Ipv4Addr::new(127, mind.rng.u8(1..), mind.rng.u8(..), mind.rng.u8(1..255));
    let route = Route {
        hub,
        from: IpAddr::V4(from),
        tls: way.tls,
        small: habit == Habit::Nothing || mind.rng.bool(),
    };
    let come = timeout(ARRIVAL, Peer::come(route, form, way.door, habit)).await;
    let mut peer = come.ok()?.ok()?;
    if !peer.settle(mind, back).await {
        peer.give_up(mind);
        return None;
    }
    mind.done(&format!("{} by {way}", form.word()));
    mind.done(&format!("habit {habit:?}"));
    Some(peer)
}

/// Everything that a load does.
fn wanted() -> BTreeSet<String> {
    let ways = doors::ways()
        .into_iter()
        .map(|(form, way)| format!("{} by {way}", form.word()));
    let mut wanted: BTreeSet<String> = ways.collect();
    wanted.extend(Verb::ALL.map(|verb| format!("verb {verb}")));
    wanted.extend(Family::ALL.map(|family| format!("family {family}")));
    wanted.extend(Shape::ALL.map(|shape| format!("shape {shape:?}")));
    wanted.extend(Habit::ALL.map(|habit| format!("habit {habit:?}")));
    wanted.extend(peer::Way::ALL.map(|way| format!("leave {way:?}")));
    wanted.extend(["stranger", "stray", "resume", "storm"].map(str::to_owned));
    wanted
}
