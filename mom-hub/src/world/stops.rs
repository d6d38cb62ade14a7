//! What the hub knows of stops: the latch of each channel, what waits to be kept, and who waits for devices.
//!
//! Latches stand by path, not in the tree: deleting a channel and making it anew frees no device.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_proto::{Code, ContextNumber, Fence, HUB, Micros, Parcel, Path, Time, Verb};

use crate::tree::latch::{Latch, Newer, Stop, StopRecord};
use crate::{PeerId, Ticket};

/// Latches of channels that are no more, beyond which some are forgotten.
const ORPHANS: usize = 4096;

/// All stops.
#[derive(Debug, Default)]
pub(crate) struct Stops {
    known: BTreeMap<Path, Known>,
    /// The highest number of what was forgotten.
    floor: Fence,
    /// What holds where nothing is known, because what was kept could not be read.
    unread: Option<Arc<Stop>>,
    /// What waits until it is kept.
    pub(crate) storing: BTreeMap<Ticket, Storing>,
    /// Who waits for devices.
    pub(crate) calls: BTreeMap<u64, Call>,
    pub(crate) last_call: u64,
}

#[derive(Debug, Default)]
struct Known {
    latch: Latch,
    /// When the audit log was last told.
    noted: Option<Micros>,
}

/// What waits for its record.
#[derive(Debug)]
pub(crate) enum Storing {
    /// An unstop: no device may move before a restart would know of it.
    Unstop(Box<Unstop>),
    /// A stop of a call, which was handed out already.
    Stop { call: u64, channel: ContextNumber },
    /// One of a channel that is not there.
    Away { call: u64, channel: Path },
}

/// An unstop that is being kept.
#[derive(Debug)]
pub(crate) struct Unstop {
    pub(crate) peer: PeerId,
    pub(crate) channel: ContextNumber,
    /// The newest stop that its user has seen.
    pub(crate) up_to: Fence,
    /// The message, stamped.
    pub(crate) parcel: Parcel,
    /// The call that it is part of; none = the peer's own message.
    pub(crate) call: Option<u64>,
}

/// A request to stop or unstop a channel or all of a session, whose user waits for the devices' word.
#[derive(Debug)]
pub(crate) struct Call {
    pub(crate) peer: PeerId,
    pub(crate) id: Option<u64>,
    pub(crate) path: Path,
    pub(crate) verb: Verb,
    pub(crate) until: Micros,
    /// Not all channels are told yet.
    pub(crate) walks: bool,
    /// What it says to channels that are made below its session before it is answered; none = nothing.
    pub(crate) order: Option<Order>,
    /// Channels with a guard or devices.
    pub(crate) channels: BTreeMap<ContextNumber, Called>,
    /// Channels that had devices and are not there, with the numbers of their stops.
    pub(crate) away: BTreeMap<Path, (Fence, Kept)>,
    /// How many others were told.
    pub(crate) others: usize,
    /// Channels with a guard or devices that the peer may see and not stop.
    pub(crate) denied: Vec<Path>,
}

/// What a call says to each channel.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    pub(crate) call: u64,
    pub(crate) peer: PeerId,
    pub(crate) verb: Verb,
    pub(crate) reason: Option<Arc<str>>,
    pub(crate) only: Option<Arc<[Arc<str>]>>,
    /// What an unstop lifts, by channel.
    pub(crate) stops: Arc<BTreeMap<Path, Fence>>,
}

/// One channel of a call.
#[derive(Clone, Debug)]
pub(crate) struct Called {
    pub(crate) path: Path,
    /// The stop, or the newest one that the unstop lifts.
    pub(crate) number: Fence,
    pub(crate) guarded: bool,
    pub(crate) devices: BTreeMap<Arc<str>, Word>,
    pub(crate) kept: Kept,
    pub(crate) newer: Vec<Newer>,
    /// Why the unstop was not handed out.
    pub(crate) failed: Option<Code>,
}

/// What a device has said to a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Word {
    /// Nothing yet.
    Silent,
    /// That it obeys, and whether it stands.
    Obeys(Standing),
    /// Its connection was lost before.
    Lost,
}

/// How a device says that it stands that obeys. One that says none of it is taken at its word that it obeys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Standing {
    /// It says that it moves.
    pub(crate) moving: bool,
    /// Whether it can tell its mechanism what to do, if it says so: then it also says when it rests.
    pub(crate) reached: Option<bool>,
    /// How it knows that it rests.
    pub(crate) rest: Option<Rest>,
    /// An emergency stop at the device itself is pressed: an `unstop` does not let it go.
    pub(crate) estop: bool,
}

/// How a device knows that it rests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rest {
    /// By measurements since it was stopped.
    Measured,
    /// It does not measure, and the time has passed in which it stops.
    NotMeasured,
}

/// Whether a restart of the hub would know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kept {
    Waits,
    Yes,
    No,
}

impl Stops {
    /// From what was kept; `unread` says why it could not be read.
    pub(crate) fn new(records: Vec<StopRecord>, unread: bool, epoch: u64, since: Time) -> Stops {
        let number = Fence::floor(epoch).next();
        let unread = unread.then(|| {
            Arc::new(Stop {
                number,
                by: HUB.into(),
                user: HUB.into(),
                since,
                reason: Some("the stops from before the hub's start could not be read".into()),
            })
        });
        let known = records.into_iter().map(|record| {
            let known = Known {
                latch: record.latch,
                noted: None,
            };
            (record.path, known)
        });
        Stops {
            known: known.collect(),
            unread,
            ..Stops::default()
        }
    }

    /// The latch of a channel.
    pub(crate) fn latch(&self, path: &Path) -> Latch {
        match self.known.get(path) {
            Some(known) => known.latch.clone(),
            None => self.unknown(),
        }
    }

    pub(crate) fn latch_mut(&mut self, path: &Path) -> &mut Latch {
        &mut self.known_mut(path).latch
    }

    fn known_mut(&mut self, path: &Path) -> &mut Known {
        let latch = self.unknown();
        let known = || Known { latch, noted: None };
        self.known.entry(path.clone()).or_insert_with(known)
    }

    fn unknown(&self) -> Latch {
        let newest = self.unread.as_ref().map(|stop| stop.number).unwrap_or_default();
        Latch {
            newest,
            all: self.unread.clone(),
            ..Latch::default()
        }
    }

    /// What is to be kept of a channel.
    pub(crate) fn record(&self, path: &Path) -> StopRecord {
        StopRecord {
            path: path.clone(),
            latch: self.latch(path),
        }
    }

    /// The number of the next stop of a channel.
    pub(crate) fn next(&self, path: &Path, epoch: u64) -> Fence {
        let newest = self.latch(path).newest;
        newest.max(self.floor).max(Fence::floor(epoch)).next()
    }

    /// Whether the audit log is to be told of a stop that stops nobody new: once a second at most.
    pub(crate) fn is_noteworthy(&mut self, path: &Path, new: bool, now: Micros) -> bool {
        let known = self.known_mut(path);
        let due = known
            .noted
            .is_none_or(|noted| now.saturating_sub(noted) >= 1_000_000);
        if new || due {
            known.noted = Some(now);
        }
        new || due
    }

    /// Forgets latches of channels that are no more, if there are too many of them: first those that hold nothing, then the oldest of
    /// the user who has stopped most of them, so that nobody's stops push out another's.
    pub(crate) fn bound(&mut self, contexts: usize, exists: impl Fn(&Path) -> bool) -> Vec<Path> {
        if self.known.len() <= contexts + ORPHANS {
            return Vec::new();
        }
        let orphans = self.known.iter().filter(|(path, _)| !exists(path));
        let mut orphans: Vec<(Option<Arc<str>>, Fence, Path)> = orphans
            .map(|(path, known)| {
                let holding = known.latch.newest_holding();
                let user = holding.map(|stop| Arc::clone(&stop.user));
                (user, known.latch.newest, path.clone())
            })
            .collect();
        orphans.sort_by_key(|(_, number, _)| std::cmp::Reverse(*number));
        // How many newer ones its user has.
        let mut newer: BTreeMap<Arc<str>, usize> = BTreeMap::new();
        let mut ranked: Vec<(usize, Fence, Path)> = orphans
            .into_iter()
            .map(|(user, number, path)| {
                let rank = user.map_or(usize::MAX, |user| {
                    let newer = newer.entry(user).or_default();
                    *newer += 1;
                    *newer
                });
                (rank, number, path)
            })
            .collect();
        ranked.sort_by_key(|(rank, number, _)| (std::cmp::Reverse(*rank), *number));
        ranked.truncate(ranked.len().saturating_sub(ORPHANS / 2));
        for (_, number, path) in &ranked {
            self.floor = self.floor.max(*number);
            self.known.remove(path);
        }
        ranked.into_iter().map(|(_, _, path)| path).collect()
    }

    /// The channels below a session that had devices and are not there.
    pub(crate) fn away_below(&self, top: &Path, exists: impl Fn(&Path) -> bool) -> Vec<Path> {
        let known = self.known.iter().filter(|(_, known)| known.latch.device);
        let away = known.filter(|(path, _)| path.is_within(top) && !exists(path));
        away.map(|(path, _)| path.clone()).collect()
    }

    /// Whether a peer waits for the word of this channel's devices.
    pub(crate) fn is_awaited(&self, channel: ContextNumber) -> bool {
        let awaits = |call: &Call| call.channels.get(&channel).is_some_and(Called::awaits_devices);
        self.calls.values().any(awaits)
    }
}

impl Call {
    /// Whether all that can be known is known.
    pub(crate) fn is_complete(&self) -> bool {
        let complete = |called: &Called| !called.awaits_devices() && called.kept != Kept::Waits;
        !self.walks
            && self.channels.values().all(complete)
            && self.away.values().all(|(_, kept)| *kept != Kept::Waits)
    }
}

impl Standing {
    /// Whether its rest is still to come.
    pub(crate) fn is_awaited(self) -> bool {
        self.moving || (self.reached.is_some() && self.rest.is_none())
    }

    /// What it says now, after another word: who spoke of its rest before, and does so no more, is not known to stand.
    pub(crate) fn after(self, before: Word) -> Standing {
        let speaks = |standing: Standing| {
            let rest = Standing {
                estop: false,
                ..standing
            };
            rest != Standing::default()
        };
        let spoke = matches!(before, Word::Obeys(standing) if speaks(standing));
        Standing {
            moving: self.moving || (spoke && !speaks(self)),
            ..self
        }
    }
}

impl Rest {
    /// The word in states and replies.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Rest::Measured => "measured",
            Rest::NotMeasured => "not-measured",
        }
    }
}

impl Called {
    fn awaits_devices(&self) -> bool {
        self.devices.values().any(|word| match word {
            Word::Silent => true,
            Word::Obeys(standing) => standing.is_awaited(),
            Word::Lost => false,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(text: &str) -> Path {
        Path::parse(text).expect("a path")
    }

    #[test]
    fn nobodys_stops_push_out_another_ones() {
        let mut stops = Stops::default();
        let mut number = 0;
        let mut stop = |stops: &mut Stops, user: &str, channel: &str| {
            number += 1;
            let stop = Stop {
                number: number.into(),
                by: user.into(),
                user: user.into(),
                since: Time::default(),
                reason: None,
            };
            stops.latch_mut(&path(channel)).stop(stop, None);
        };
        stop(&mut stops, "carol", "/t/arm");
        stop(&mut stops, "bob", "/free");
        stops.latch_mut(&path("/free")).lift(Fence::from(2), None);
        for made in 0..ORPHANS {
            stop(&mut stops, "alice", &format!("/s/{made}"));
        }
        let nobody = |_: &Path| false;
        assert_eq!(
            stops.bound(2, nobody),
            [],
            "there may be more where there are contexts"
        );
        let forgotten = stops.bound(0, nobody);
        assert_eq!(forgotten.len(), ORPHANS / 2 + 2);
        assert_eq!(
            forgotten[..2],
            [path("/free"), path("/s/0")],
            "what holds nothing, then the oldest"
        );
        assert!(stops.latch(&path("/t/arm")).is_stopped());
        let newest = path(&format!("/s/{}", ORPHANS - 1));
        assert!(stops.latch(&newest).is_stopped());
        // A channel that was forgotten begins above the number that it had.
        let next: u64 = stops.next(&path("/s/0"), 0).into();
        assert!(next > 3 && !stops.latch(&path("/s/0")).is_stopped());
    }
}
