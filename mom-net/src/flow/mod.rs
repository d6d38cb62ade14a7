//! How much may be on its way to a peer, so that the network's queue stays short.
//!
//! What the kernel or a bottleneck holds can be overtaken by nobody. So no more is given to the link than it
//! delivers in its round trip and [`AHEAD`] more: an urgent parcel waits for that at most. How fast the link is, is
//! [probed](probe) by bursts that double, and then [measured](known) from what the other side acknowledges
//! (`docs/performance.md` derives the bounds).

mod known;
mod pause;
mod probe;
#[cfg(test)]
mod tests;

use std::time::{Duration, Instant};

pub use pause::Pause;

use crate::{TcpState, Writer};
use known::Known;
use probe::{Probe, Probed};

/// What may wait in the network beyond what fills it: enough to bridge a turn of the timer and keep a saturated
/// link busy.
const AHEAD: Duration = Duration::from_micros(2200);

/// Segments that are always allowed: with fewer a receiver delays its acknowledgement.
const LEAST_SEGMENTS: u64 = 2;

/// Bytes of stops that may be under way beyond what fills the network: ten or more. Others wait in the queue, where a newer one takes their
/// place; in the kernel they would be a long queue that nothing can overtake.
const STOPS: usize = 4096;

/// Bytes to which the budget of a link that is faster than it can be looked at may grow.
const MOST: u64 = 16 << 20;

/// What was known of a link that was idle for so long is known no more.
const FORGOTTEN: Duration = Duration::from_secs(10);

/// The account of one connection: what it was given, what the other side has of it, and so what it may be given now.
#[derive(Debug, Default)]
pub struct Flow {
    /// Bytes given to the link, and acknowledged when we last looked.
    written: u64,
    acknowledged: u64,
    /// Bytes that may be under way; none before the first look.
    budget: Option<u64>,
    /// What is known of the link; nothing for one that has never been given much, as most are.
    known: Option<Box<Observed>>,
    /// The network below does not say.
    blind: bool,
}

/// What is known of a link that has been looked at.
#[derive(Debug)]
struct Observed {
    measure: Measure,
    /// What is left of the last allowance.
    left: usize,
    /// What was written beyond allowances since all was acknowledged that was written by then.
    beyond: usize,
    beyond_from: u64,
}

#[derive(Debug)]
enum Measure {
    Probing(Probe),
    Known(Known),
}

/// The link at one moment.
#[derive(Clone, Copy, Debug)]
struct Look {
    now: Instant,
    written: u64,
    acknowledged: u64,
    /// The least round trip seen.
    round_trip: Duration,
    segment: u64,
    /// The congestion window, in bytes.
    window: u64,
    /// The rate at which the kernel may pace, in bytes per second.
    pace: f64,
}

/// What a link may be given now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allowance {
    /// All together.
    pub bytes: usize,
    /// At once, so that something urgent can go in between.
    pub piece: usize,
    /// Of stops, which may leave also where nothing else may.
    pub stops: usize,
}

impl Flow {
    /// What the link behind a writer may be given now.
    pub fn allowance(&mut self, writer: &Writer) -> Allowance {
        let bytes = self.room(|| writer.link());
        Allowance {
            bytes,
            piece: self.piece(),
            stops: self.stops(bytes),
        }
    }

    /// The bytes of stops that may leave where the link may be given so many bytes of anything.
    fn stops(&mut self, room: usize) -> usize {
        let Some(known) = self.known.as_deref_mut() else {
            return usize::MAX;
        };
        if self.acknowledged >= known.beyond_from {
            known.beyond = 0;
        }
        room.max(STOPS.saturating_sub(known.beyond))
    }

    fn measure(&self) -> Option<&Measure> {
        self.known.as_deref().map(|known| &known.measure)
    }

    /// How many bytes the link may be given now. `look` asks for its state ([`Writer::link`]) and is called
    /// only where that is needed.
    fn room(&mut self, look: impl FnOnce() -> Option<TcpState>) -> usize {
        self.room_at(look, Instant::now)
    }

    fn room_at(&mut self, look: impl FnOnce() -> Option<TcpState>, now: impl FnOnce() -> Instant) -> usize {
        let room = self.room_by(look, now);
        if let Some(known) = self.known.as_deref_mut() {
            known.left = room;
        }
        room
    }

    fn room_by(&mut self, look: impl FnOnce() -> Option<TcpState>, now: impl FnOnce() -> Instant) -> usize {
        if self.blind {
            return usize::MAX;
        }
        let under_way = self.written - self.acknowledged;
        // What was acknowledged since we looked is left out, which is cheap and on the safe side.
        if let Some(budget) = self.budget
            && under_way < budget
        {
            return clamp(budget - under_way);
        }
        match look() {
            Some(link) => self.observe(&link, now()),
            None => self.blind = true,
        }
        clamp(
            self.budget
                .unwrap_or(u64::MAX)
                .saturating_sub(self.written - self.acknowledged),
        )
    }

    /// The most that is given at once, so that something urgent can go in between.
    fn piece(&self) -> usize {
        let ahead = match self.measure() {
            _ if self.blind => return usize::MAX,
            Some(Measure::Known(known)) => known.ahead(),
            Some(Measure::Probing(probe)) => probe.burst(),
            None => self.budget.unwrap_or_default(),
        };
        clamp(ahead / 6).max(1024)
    }

    /// Notes what the link took.
    pub fn wrote(&mut self, bytes: usize) {
        if let Some(known) = self.known.as_deref_mut() {
            known.wrote(self.written, bytes);
        }
        self.written += bytes as u64;
    }

    /// The bytes that the link took since it began.
    pub fn written(&self) -> u64 {
        self.written
    }

    /// Nothing waits any more, so the time from now on says nothing about the link.
    pub fn rest(&mut self) {
        let Some(known) = self.known.as_deref_mut() else {
            return;
        };
        match &mut known.measure {
            Measure::Known(known) => known.rest(self.written),
            // The budget stays, so that who talks little is not looked at each time.
            Measure::Probing(probe) if probe.is_new() && known.beyond == 0 => self.known = None,
            Measure::Probing(probe) => probe.rest(),
        }
    }

    fn observe(&mut self, link: &TcpState, now: Instant) {
        // Some kernels count the handshake.
        self.acknowledged = link.acknowledged.clamp(self.acknowledged, self.written);
        let segment = u64::from(link.segment).max(512);
        let look = Look {
            now,
            written: self.written,
            acknowledged: self.acknowledged,
            round_trip: match link.least_round_trip {
                u32::MAX => Duration::ZERO,
                micros => Duration::from_micros(u64::from(micros)),
            },
            segment,
            window: segment * u64::from(link.window),
            pace: link.pace as f64,
        };
        let begin = || Measure::Probing(Probe::new(&look));
        let known = self.known.get_or_insert_with(|| Box::new(Observed::new(begin())));
        let measure = &mut known.measure;
        if let Measure::Known(known) = measure
            && known.is_forgotten(now)
        {
            *measure = begin();
        }
        let budget = match measure {
            Measure::Known(known) => known.look(&look, self.budget.unwrap_or_default()),
            Measure::Probing(probe) => match probe.look(&look) {
                Probed::Budget(budget) => budget,
                Probed::Rate(rate) => {
                    let mut known = Known::new(rate, &look);
                    let budget = known.look(&look, 0);
                    *measure = Measure::Known(known);
                    budget
                }
            },
        };
        self.budget = Some(budget);
    }

    /// For how long it may be normal that nothing more is acknowledged.
    fn quiet(&self) -> Duration {
        match self.measure() {
            Some(Measure::Known(known)) => known.quiet(),
            Some(Measure::Probing(probe)) => probe.quiet(),
            None => Duration::ZERO,
        }
    }
}

impl Observed {
    fn new(measure: Measure) -> Observed {
        Observed {
            measure,
            left: 0,
            beyond: 0,
            beyond_from: 0,
        }
    }

    /// Notes that the link took so many bytes behind those that it had.
    fn wrote(&mut self, written: u64, bytes: usize) {
        let within = bytes.min(self.left);
        self.left -= within;
        if within < bytes && self.beyond == 0 {
            self.beyond_from = written + within as u64;
        }
        self.beyond += bytes - within;
    }
}

impl Look {
    fn under_way(&self) -> u64 {
        self.written - self.acknowledged
    }

    /// What may be under way in any case.
    fn least(&self) -> u64 {
        LEAST_SEGMENTS * self.segment
    }
}

fn clamp(bytes: u64) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}
