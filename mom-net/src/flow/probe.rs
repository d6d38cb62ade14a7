//! How fast a link is of which nothing is known.
//!
//! A burst of two segments goes out, and when all of it has been acknowledged one of twice as much, until one takes the
//! link so long that its rate can be told from how its acknowledgements follow each other. The last burst is the
//! longest queue that this makes: about twice [`LONG`]. A congestion window would grow until the queue
//! overflows, and a stop would wait behind all of it.

use std::time::{Duration, Instant};

use super::{Look, MOST};

/// A burst whose acknowledgements take so long says how fast the link is: they are looked at each millisecond or two.
const LONG: Duration = Duration::from_millis(4);

/// A rate within these parts of the kernel's own pace says only that the link is not slower, which is believed of a burst of so
/// many times the least.
const PACED: [f64; 2] = [0.8, 1.3];
const PACED_MOST: u64 = 32;

/// As late as that beyond the round trip, all at once: the link is so slow that two segments are one acknowledgement.
const LATE: Duration = Duration::from_millis(10);

/// A burst after the other.
#[derive(Debug)]
pub(super) struct Probe {
    burst: u64,
    /// Whether no burst was acknowledged yet.
    new: bool,
    /// Whether the burst goes out at once.
    whole: bool,
    began: Instant,
    /// What had been written before it.
    start: u64,
    /// When we last looked.
    looked: Instant,
    /// When we looked before acknowledgements of it were first seen, with these, and when they were seen last.
    first: Option<(Instant, u64)>,
    last: (Instant, u64),
    round_trip: Duration,
    least: u64,
    /// The kernel's pace when it began.
    pace: f64,
}

/// What a look at a probe says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Probed {
    /// So many bytes may be under way.
    Budget(u64),
    /// The link carries so many bytes a second.
    Rate(f64),
}

impl Probe {
    pub(super) fn new(look: &Look) -> Probe {
        Probe {
            burst: look.least(),
            new: true,
            whole: true,
            began: look.now,
            start: look.written,
            looked: look.now,
            first: None,
            last: (look.now, look.acknowledged),
            round_trip: look.round_trip,
            least: look.least(),
            pace: look.pace,
        }
    }

    /// Whether it has found out nothing yet.
    pub(super) fn is_new(&self) -> bool {
        self.new
    }

    pub(super) fn burst(&self) -> u64 {
        self.burst
    }

    /// Nothing waits any more: what the burst has not is not the link's fault.
    pub(super) fn rest(&mut self) {
        self.whole = false;
    }

    pub(super) fn quiet(&self) -> Duration {
        self.round_trip * 2 + LATE
    }

    pub(super) fn look(&mut self, look: &Look) -> Probed {
        self.round_trip = look.round_trip;
        let before = std::mem::replace(&mut self.looked, look.now);
        // What is urgent does not wait for budgets: stops that follow the burst are no part of it.
        let end = look.written.min(self.start + self.burst);
        let acknowledged = look.acknowledged.min(end);
        // What was sent before is acknowledged sooner, and a few bytes that are not counted as written, as the preface, with it.
        if acknowledged > self.last.1.max(self.start + look.segment / 2) {
            self.last = (look.now, acknowledged);
            self.first.get_or_insert((before, acknowledged));
        }
        if look.written == self.start {
            return Probed::Budget(self.burst);
        }
        if !self.whole {
            // Who sends it was waited for: it tells nothing, and the next begins.
            *self = Probe {
                burst: self.burst,
                new: self.new,
                ..Probe::new(look)
            };
            return Probed::Budget(self.burst);
        }
        // The acknowledgement of a last segment that is alone comes late.
        let settled = look.now - self.last.0 > LATE && acknowledged + look.segment >= end;
        if acknowledged < end && !settled {
            return Probed::Budget(look.under_way());
        }
        if let Some(rate) = self.rate() {
            return Probed::Rate(rate);
        }
        // What the kernel holds back leaves when something else is acknowledged, and makes the link look slow. Its window
        // counts packets, and each stop is one.
        let next = (self.burst * 2).min((look.window / 4 * 3).max(look.least()));
        if next > MOST || next <= self.burst {
            // It carries that at least, and no larger burst can tell.
            let took = (self.last.0 - self.began).max(Duration::from_micros(100));
            return Probed::Rate(self.burst as f64 / took.as_secs_f64());
        }
        *self = Probe {
            burst: next,
            new: false,
            ..Probe::new(look)
        };
        Probed::Budget(look.under_way() + self.burst)
    }

    /// The link's rate, if the burst took long enough to tell.
    fn rate(&self) -> Option<f64> {
        // Rather too slow than too fast: a long link would be filled with the difference.
        let (before, acknowledged) = self.first?;
        let (spread, bytes) = (self.last.0 - before, self.last.1 - acknowledged);
        if spread >= LONG && self.burst > self.least && bytes >= self.burst / 2 {
            let rate = bytes as f64 / spread.as_secs_f64();
            let [least, most] = PACED.map(|part| self.pace * part);
            let is_pace = (least..most).contains(&rate) && self.burst < PACED_MOST * self.least;
            return Some(rate).filter(|_| !is_pace);
        }
        let beyond = (self.last.0 - self.began).saturating_sub(self.round_trip);
        let late = beyond >= LATE.max(self.round_trip / 2);
        late.then(|| self.burst as f64 / beyond.as_secs_f64())
    }
}
