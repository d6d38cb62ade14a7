//! The contexts that this client is in, with the number of their users.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_proto::{ContextNumber, Map, Path, Thinning, Value};
use tokio::sync::oneshot;

use crate::device::installation::Installation;
use crate::words::number;
use crate::{ClientError, Event, FenceGate, Latch, StopState};

pub(crate) type Joined = Result<Arc<Map>, ClientError>;

/// Of so many channels that are gone it is remembered what devices had heard of stops there.
const MOST_LEFT: usize = 4096;

/// The contexts by path, so that parents come before what is in them.
#[derive(Debug, Default)]
pub(crate) struct WantedContexts {
    places: BTreeMap<Path, WantedContext>,
    serial: u64,
    /// What devices had heard of stops in channels that are gone, for when these are back: a hub that began anew without them knows no stop
    /// there.
    left: BTreeMap<Path, Latch>,
}

/// One context that a proxy wants.
#[derive(Debug)]
pub(crate) struct WantedContext {
    /// Distinguishes it from later ones at the same path.
    pub(crate) serial: u64,
    pub(crate) phase: JoinPhase,
    pub(crate) gate: FenceGate,
    /// What a device has heard of stops, for when it joins again.
    pub(crate) latch: Latch,
    /// What it asked for there, restored after a lost link.
    pub(crate) terms: Terms,
    wanted: usize,
}

/// On what terms a client is in a context.
#[derive(Clone, Debug, Default)]
pub(crate) struct Terms {
    pub(crate) thinning: Thinning,
    /// It obeys stops there, and says so.
    pub(crate) device: bool,
    /// What it can do there as a device.
    pub(crate) card: Option<Arc<Value>>,
}

impl Terms {
    /// For the hub; none where there is nothing to say. A device says what it has heard of stops, and shows its card to a hub that
    /// takes it.
    pub(crate) fn content(&self, latch: &Latch, installation: &Installation, cards: bool) -> Option<Map> {
        (self.thinning.thins() || self.device).then(|| self.map(latch, installation, cards))
    }

    /// The same, also where there is nothing to say any more.
    pub(crate) fn map(&self, latch: &Latch, installation: &Installation, cards: bool) -> Map {
        let mut map = Map::new();
        self.thinning.describe(&mut map);
        if self.device {
            let mut word = latch.word();
            installation.describe(&mut word);
            if let Some(card) = self.card.as_deref().filter(|_| cards) {
                word.set("card", card.clone());
            }
            map.set("device", word);
        }
        map
    }
}

#[derive(Debug)]
pub(crate) enum JoinPhase {
    /// Asked for; again, after a lost link, or for the first time.
    Joining {
        again: bool,
        waiters: Vec<oneshot::Sender<Joined>>,
    },
    /// A member, with what the hub said.
    Joined(Arc<Map>),
    /// Not a member, as there is no link.
    Away,
}

/// The next step for a caller that wants a context.
#[derive(Debug)]
pub(crate) enum Want {
    /// Send the join.
    Join(oneshot::Receiver<Joined>),
    /// Wait for another caller's join.
    Wait(oneshot::Receiver<Joined>),
    /// Nothing.
    Have(Arc<Map>),
}

impl WantedContexts {
    /// Counts another user of a context.
    pub(crate) fn want(&mut self, path: &Path) -> (u64, Want) {
        let serial = &mut self.serial;
        let place = self.places.entry(path.clone()).or_insert_with(|| {
            *serial += 1;
            WantedContext {
                serial: *serial,
                phase: JoinPhase::Away,
                gate: FenceGate::new(),
                latch: self.left.remove(path).unwrap_or_default(),
                terms: Terms::default(),
                wanted: 0,
            }
        });
        place.wanted += 1;
        let want = match &mut place.phase {
            JoinPhase::Joined(info) => Want::Have(Arc::clone(info)),
            JoinPhase::Joining { waiters, .. } => {
                let (sender, receiver) = oneshot::channel();
                waiters.push(sender);
                Want::Wait(receiver)
            }
            JoinPhase::Away => {
                let (sender, receiver) = oneshot::channel();
                place.phase = JoinPhase::Joining {
                    again: false,
                    waiters: vec![sender],
                };
                Want::Join(receiver)
            }
        };
        (place.serial, want)
    }

    /// Counts one user less; returns whether there are none left.
    pub(crate) fn unwant(&mut self, path: &Path, serial: u64) -> bool {
        let Some(place) = self.get(path, serial) else {
            return false;
        };
        place.wanted -= 1;
        if place.wanted > 0 {
            return false;
        }
        self.remove(path);
        true
    }

    /// The context of this serial, unless it is gone.
    pub(crate) fn get(&mut self, path: &Path, serial: u64) -> Option<&mut WantedContext> {
        self.places.get_mut(path).filter(|place| place.serial == serial)
    }

    /// Remembers the terms for the next link.
    pub(crate) fn set_terms(&mut self, path: &Path, terms: Terms) {
        if let Some(place) = self.places.get_mut(path) {
            place.terms = terms;
        }
    }

    /// On what terms this client is in a context.
    pub(crate) fn terms(&self, path: &Path) -> Terms {
        self.places
            .get(path)
            .map(|place| place.terms.clone())
            .unwrap_or_default()
    }

    /// The numbers of the contexts that this peer is in.
    pub(crate) fn numbers(&self) -> Vec<(ContextNumber, Path)> {
        let number = |(path, place): (&Path, &WantedContext)| match &place.phase {
            JoinPhase::Joined(info) => Some((ContextNumber(number(info, "number")?), path.clone())),
            _ => None,
        };
        self.places.iter().filter_map(number).collect()
    }

    /// The gate of a channel.
    pub(crate) fn gate(&self, path: &Path) -> FenceGate {
        self.places
            .get(path)
            .map(|place| place.gate.clone())
            .unwrap_or_default()
    }

    /// What this client has heard of stops in a channel.
    pub(crate) fn latch(&self, path: &Path) -> Latch {
        let place = self.places.get(path);
        place.map(|place| place.latch.clone()).unwrap_or_default()
    }

    /// Notes that another token guards a channel from now on, or none, as the hub's `halt` says.
    pub(crate) fn note_guard(&mut self, path: &Path, halt: &Map) {
        if let Some(place) = self.places.get(path).filter(|_| halt.get("guard").is_some()) {
            place.gate.joined(halt);
        }
    }

    /// Notes what a channel has told of stops.
    pub(crate) fn note_stops(&mut self, path: &Path, event: &Event) {
        if let Some(place) = self.places.get_mut(path).filter(|place| place.terms.device) {
            place.latch.observe(event);
        }
    }

    /// What a device hears first when it has joined: how it stands.
    pub(crate) fn first_word(&mut self, path: &Path, reply: &Map) -> Option<Event> {
        let place = self.places.get_mut(path).filter(|place| place.terms.device)?;
        let event = Event::Stops(StopState::from_reply(reply));
        place.latch.observe(&event);
        Some(event)
    }

    /// Whether the answer to a join is awaited.
    pub(crate) fn is_joining(&self, path: &Path) -> bool {
        let phase = self.places.get(path).map(|place| &place.phase);
        matches!(phase, Some(JoinPhase::Joining { .. }))
    }

    /// The channels which this token guards, with their gates.
    pub(crate) fn guarded_by<'a>(
        &'a self,
        token: &'a Path,
    ) -> impl Iterator<Item = (&'a Path, &'a FenceGate)> {
        let guarded = move |place: &&WantedContext| place.gate.token().as_ref() == Some(token);
        self.places
            .iter()
            .filter(move |(_, place)| guarded(place))
            .map(|(path, place)| (path, &place.gate))
    }

    /// Forgets a context.
    pub(crate) fn remove(&mut self, path: &Path) {
        if let Some(place) = self.places.remove(path)
            && place.terms.device
            && self.left.len() < MOST_LEFT
        {
            self.left.insert(path.clone(), place.latch);
        }
    }

    /// Forgets a context and all below it, as the hub did.
    pub(crate) fn remove_within(&mut self, top: &Path) {
        let within: Vec<Path> = self
            .places
            .keys()
            .filter(|path| path.is_within(top))
            .cloned()
            .collect();
        within.iter().for_each(|path| self.remove(path));
    }

    /// The link is gone; returns the waiting callers.
    pub(crate) fn lose_link(&mut self) -> Vec<oneshot::Sender<Joined>> {
        let mut waiting = Vec::new();
        for place in self.places.values_mut() {
            place.gate.forget_owner();
            if let JoinPhase::Joining { waiters, .. } = std::mem::replace(&mut place.phase, JoinPhase::Away) {
                waiting.extend(waiters);
            }
        }
        waiting
    }

    /// The link is back: returns all contexts, parents first, to be joined again.
    pub(crate) fn rejoin(
        &mut self,
        installation: &Installation,
        cards: bool,
    ) -> Vec<(Path, u64, Option<Map>)> {
        let again = |(path, place): (&Path, &mut WantedContext)| {
            place.phase = JoinPhase::Joining {
                again: true,
                waiters: Vec::new(),
            };
            (
                path.clone(),
                place.serial,
                place.terms.content(&place.latch, installation, cards),
            )
        };
        self.places.iter_mut().map(again).collect()
    }
}
