//! How fast a link is that is busy, and so how much it may be given.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::{AHEAD, FORGOTTEN, Look, MOST};

/// Shorter measurements say more about bursts and the grid of acknowledgements than about the link.
const LEAST_SAMPLE: Duration = Duration::from_millis(12);

/// Sooner acknowledgements are a burst that some device lets pass.
const LEAST_LOOK: Duration = Duration::from_micros(800);

/// The best rate of so long a time counts, and of three round trips at least.
const MEMORY: Duration = Duration::from_millis(300);

/// How much faster than its rate a link with a long round trip is filled: for a whole round trip nothing says that it is
/// slower.
const FILL: f64 = 1.05;
const FILL_GROWING: f64 = 1.15;

/// While the measured rate still grows so much of a round trip more may be under way, or a long link would be used
/// better by 2 % with each round trip only.
const GROWTH: f64 = 0.15;
const MOST_GROWTH: Duration = Duration::from_millis(15);

/// A link whose rate was measured.
#[derive(Debug)]
pub(super) struct Known {
    /// Bytes per second, newest last.
    rates: VecDeque<(Instant, f64)>,
    /// Where the present measurement began.
    since: Option<(Instant, u64)>,
    /// A measurement begins once more than this has been acknowledged: before, the link was empty.
    mark: u64,
    /// The last measurement was less than half of the best.
    low: bool,
    /// As much was under way as may be, for as long as the present measurement goes on.
    full: bool,
    /// So many measurements since one was better than all before.
    ungrown: u32,
    /// When we last looked, and what had been written then.
    looked: (Instant, u64),
    /// Bytes that may be given at once to a link with a long round trip.
    tokens: f64,
    round_trip: Duration,
}

impl Known {
    /// A link that has just been found to carry so many bytes a second.
    pub(super) fn new(rate: f64, look: &Look) -> Known {
        Known {
            rates: VecDeque::from([(look.now, rate)]),
            since: None,
            mark: look.written,
            low: false,
            full: true,
            ungrown: 0,
            looked: (look.now, look.written),
            tokens: rate * AHEAD.as_secs_f64(),
            round_trip: look.round_trip,
        }
    }

    /// Whether it was idle for so long that it may have become another.
    pub(super) fn is_forgotten(&self, now: Instant) -> bool {
        self.since.is_none() && now - self.looked.0 > FORGOTTEN
    }

    /// Bytes that may wait in the network beyond what fills it.
    pub(super) fn ahead(&self) -> u64 {
        (self.rate() * (AHEAD + self.round_trip.min(AHEAD)).as_secs_f64()) as u64
    }

    pub(super) fn quiet(&self) -> Duration {
        self.round_trip * 2
    }

    /// Nothing waits any more, so the time from now on says nothing about the link.
    pub(super) fn rest(&mut self, written: u64) {
        (self.since, self.mark) = (None, written);
        (self.low, self.full) = (false, true);
    }

    /// The bytes that may be under way now; `budget` is what was said before.
    pub(super) fn look(&mut self, look: &Look, budget: u64) -> u64 {
        self.round_trip = look.round_trip;
        // A stop, or the end of a run, is not a load.
        let dry = look.under_way() < look.segment;
        let more = if dry { self.grown(look, budget) } else { 0 };
        self.measure(look, dry);
        let rate = self.rate();
        let most_growth = look.round_trip.mul_f64(GROWTH).min(MOST_GROWTH);
        let growth = if self.is_growing() {
            most_growth
        } else {
            Duration::ZERO
        };
        let bytes = |time: Duration| (rate * time.as_secs_f64()) as u64;
        // On a slow link the least is more than can be looked ahead.
        let ahead = bytes(AHEAD + growth).max(look.least());
        let target = bytes(look.round_trip) + ahead;
        if look.round_trip > AHEAD {
            return self.paced(look, rate, target);
        }
        self.looked = (look.now, look.written);
        target.max(more)
    }

    /// The budget for a link that had delivered all before we looked: it may take more than it was given.
    fn grown(&mut self, look: &Look, budget: u64) -> u64 {
        let (before, written) = self.looked;
        let (time, known) = (look.now - before, self.rate());
        // Written and acknowledged since we last looked: it is that fast at least.
        let least = look.acknowledged.saturating_sub(written) as f64 / time.as_secs_f64();
        if time >= LEAST_LOOK && least > known {
            self.note(least.min(known * 2.0), look.now);
        }
        // A slow one delivers the least, and is dry then.
        match self.since.is_some() && budget > look.least() {
            true => (budget / 4 * 5).min(MOST),
            false => 0,
        }
    }

    /// A long link is filled at its rate: what it holds when it is full would be a long queue at once. Nor is the kernel given
    /// what it may not send, since that can be overtaken by nobody either.
    fn paced(&mut self, look: &Look, rate: f64, target: u64) -> u64 {
        let (before, written) = std::mem::replace(&mut self.looked, (look.now, look.written));
        let spent = (look.written - written) as f64;
        let fill = if self.is_growing() { FILL_GROWING } else { FILL };
        let earned = fill * rate * (look.now - before).as_secs_f64();
        // A turn of the timer is a millisecond or two.
        let most = (rate * (AHEAD * 2).as_secs_f64()).max(look.least() as f64);
        self.tokens = ((self.tokens - spent).max(0.0) + earned).min(most);
        // What the kernel or the pace holds back says nothing about the link.
        self.full &= look.under_way() >= target / 4 * 3;
        let target = target.min(look.window.saturating_sub(look.least()).max(look.least()));
        let room = target.saturating_sub(look.under_way()).min(self.tokens as u64);
        // Less than a segment is better written later.
        match room >= look.segment {
            true => look.under_way() + room,
            false => look.under_way(),
        }
    }

    fn measure(&mut self, look: &Look, dry: bool) {
        let Some((start, acknowledged)) = self.since else {
            if look.acknowledged > self.mark {
                self.since = Some((look.now, look.acknowledged));
            }
            return;
        };
        if look.now - start < LEAST_SAMPLE.max(look.round_trip) {
            return;
        }
        self.since = Some((look.now, look.acknowledged));
        let full = std::mem::replace(&mut self.full, true);
        let rate = (look.acknowledged - acknowledged) as f64 / (look.now - start).as_secs_f64();
        let known = self.rate();
        // A link that ran dry, or was never full, could have carried more.
        if (dry || !full) && rate <= known {
            return;
        }
        self.ungrown = if rate > known * 1.02 { 0 } else { self.ungrown + 1 };
        let low = rate < known / 2.0;
        if low && self.low {
            // Twice in a row: it has become slower.
            self.rates.clear();
        }
        self.low = low;
        self.note(rate, look.now);
    }

    fn is_growing(&self) -> bool {
        self.ungrown < 2
    }

    fn rate(&self) -> f64 {
        let rates = self.rates.iter().map(|(_, rate)| *rate);
        rates.reduce(f64::max).unwrap_or_default()
    }

    fn note(&mut self, rate: f64, now: Instant) {
        let memory = MEMORY.max(self.round_trip * 3);
        while self.rates.front().is_some_and(|(at, _)| now - *at > memory) {
            self.rates.pop_front();
        }
        // Slower ones before a faster one will never count.
        while self.rates.back().is_some_and(|(_, older)| *older <= rate) {
            self.rates.pop_back();
        }
        self.rates.push_back((now, rate));
    }
}
