//! How much may be on its way to a peer, so that the network's queue stays short.
//!
//! What the kernel or a bottleneck holds can be overtaken by nobody. So no more is given to the link than it
//! delivers in its round trip and [`AHEAD`] more: an urgent parcel waits for that at most. The rate is measured
//! from what the other side acknowledges (`docs/performance.md` derives the bound).

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::{TcpState, Writer};

/// What may wait in the network beyond what fills it: enough to bridge a turn of the timer and keep a saturated
/// link busy.
const AHEAD: Duration = Duration::from_micros(2200);

/// Shorter measurements say more about bursts and the grid of acknowledgements than about the link.
const LEAST_SAMPLE: Duration = Duration::from_millis(12);

/// The best rate of so long a time counts.
const MEMORY: Duration = Duration::from_millis(300);

/// Segments that are always allowed: with fewer a receiver delays its acknowledgement.
const LEAST_SEGMENTS: u64 = 2;

/// Bytes to which the budget of a link that is faster than it can be looked at may grow.
const MOST: u64 = 16 << 20;

/// The account of one connection: what it was given, what the other side has of it, and so what it may be given now.
#[derive(Debug, Default)]
pub struct Flow {
    /// Bytes given to the link, and acknowledged when we last looked.
    written: u64,
    acknowledged: u64,
    /// Bytes that may be under way; none before the first look.
    budget: Option<u64>,
    /// Where the present measurement began.
    since: Option<(Instant, u64)>,
    /// Bytes per second, newest last.
    rates: VecDeque<(Instant, f64)>,
    /// The network below does not say.
    blind: bool,
}

/// What a link may be given now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allowance {
    /// All together.
    pub bytes: usize,
    /// At once, so that something urgent can go in between.
    pub piece: usize,
}

impl Flow {
    /// What the link behind a writer may be given now.
    pub fn allowance(&mut self, writer: &Writer) -> Allowance {
        Allowance {
            bytes: self.room(|| writer.link()),
            piece: self.piece(),
        }
    }

    /// How many bytes the link may be given now. `look` asks for its state ([`Writer::link`]) and is called
    /// only where that is needed.
    fn room(&mut self, look: impl FnOnce() -> Option<TcpState>) -> usize {
        self.room_at(look, Instant::now)
    }

    fn room_at(&mut self, look: impl FnOnce() -> Option<TcpState>, now: impl FnOnce() -> Instant) -> usize {
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
        if self.blind {
            return usize::MAX;
        }
        clamp(self.budget.unwrap_or_default() / 6).max(1024)
    }

    /// Notes what the link took.
    pub fn wrote(&mut self, bytes: usize) {
        self.written += bytes as u64;
    }

    /// Bytes that the other side had acknowledged when we last looked.
    fn taken(&self) -> u64 {
        self.acknowledged
    }

    /// Nothing waits any more, so the time from now on says nothing about the link.
    pub fn rest(&mut self) {
        self.since = None;
    }

    fn observe(&mut self, link: &TcpState, now: Instant) {
        // Some kernels count the handshake.
        self.acknowledged = link.acknowledged.clamp(self.acknowledged, self.written);
        let round_trip = match link.least_round_trip {
            u32::MAX => Duration::ZERO,
            micros => Duration::from_micros(u64::from(micros)),
        };
        let dry = self.acknowledged == self.written;
        let mut least = LEAST_SEGMENTS * u64::from(link.segment).max(512);
        if dry && self.since.is_some() {
            // All was delivered before we looked: the network took more than it was given.
            least = least.max(self.budget.unwrap_or_default().saturating_mul(2).min(MOST));
        }
        match self.since {
            Some((start, acknowledged)) if now - start >= LEAST_SAMPLE.max(round_trip) => {
                let seconds = (now - start).as_secs_f64();
                let rate = (self.acknowledged - acknowledged) as f64 / seconds;
                // A link that ran dry could have carried more.
                if !dry || self.rate().is_none_or(|known| rate > known) {
                    self.note(rate, now);
                }
                self.since = Some((now, self.acknowledged));
            }
            Some(_) => {}
            None => self.since = Some((now, self.acknowledged)),
        }
        let budget = match self.rate() {
            Some(rate) => (rate * (round_trip + AHEAD).as_secs_f64()) as u64,
            None => u64::from(link.segment) * u64::from(link.window),
        };
        self.budget = Some(budget.max(least));
    }

    fn rate(&self) -> Option<f64> {
        self.rates.iter().map(|(_, rate)| *rate).reduce(f64::max)
    }

    fn note(&mut self, rate: f64, now: Instant) {
        while self.rates.front().is_some_and(|(at, _)| now - *at > MEMORY) {
            self.rates.pop_front();
        }
        // Slower ones before a faster one will never count.
        while self.rates.back().is_some_and(|(_, older)| *older <= rate) {
            self.rates.pop_back();
        }
        self.rates.push_back((now, rate));
    }
}

fn clamp(bytes: u64) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}

/// How long a writer waits before it looks again whether the network has room.
#[derive(Debug)]
pub struct Pause {
    time: Duration,
    /// What the other side had taken when we last looked.
    taken: u64,
}

impl Pause {
    /// While the other side takes something.
    const USUAL: Duration = Duration::from_millis(1);
    /// For one that takes nothing.
    const LONGEST: Duration = Duration::from_millis(16);

    /// The time to wait.
    pub fn time(&self) -> Duration {
        self.time
    }

    /// Looks after a wait: a receiver that takes nothing is looked at less and less often.
    pub fn look(&mut self, flow: &Flow) {
        self.time = match flow.taken() == self.taken {
            true => (self.time * 2).min(Pause::LONGEST),
            false => Pause::USUAL,
        };
        self.taken = flow.taken();
    }
}

impl Default for Pause {
    fn default() -> Pause {
        Pause {
            time: Pause::USUAL,
            taken: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bottleneck of so many bytes per second behind a delay; a writer that looks every millisecond.
    struct Simulated {
        rate: f64,
        delay: Duration,
        now: Instant,
        flow: Flow,
        /// When each written byte range has left the bottleneck, and its end.
        left: VecDeque<(Instant, u64)>,
        acknowledged: u64,
        free_at: Instant,
    }

    impl Simulated {
        fn new(rate: f64, delay: Duration) -> Simulated {
            let start = Instant::now();
            Simulated {
                rate,
                delay,
                now: start,
                flow: Flow::default(),
                left: VecDeque::new(),
                acknowledged: 0,
                free_at: start,
            }
        }

        /// Writes for this long whenever there is room; gives the longest queue seen at the bottleneck after `settle`.
        fn saturate(&mut self, time: Duration, settle: Duration) -> Duration {
            let end = self.now + time;
            let begin = self.now;
            let mut longest = Duration::ZERO;
            while self.now < end {
                while self
                    .left
                    .front()
                    .is_some_and(|(at, _)| *at + self.delay <= self.now)
                {
                    self.acknowledged = self.left.pop_front().map_or(0, |(_, end)| end);
                }
                let link = TcpState {
                    acknowledged: self.acknowledged,
                    segment: 1448,
                    window: 10,
                    least_round_trip: u32::try_from(self.delay.as_micros()).unwrap(),
                };
                let mut room = self.flow.room_at(|| Some(link), || self.now);
                while room > 0 {
                    let piece = room.min(self.flow.piece()).min(1448);
                    room -= piece;
                    self.flow.wrote(piece);
                    self.free_at =
                        self.free_at.max(self.now) + Duration::from_secs_f64(piece as f64 / self.rate);
                    self.left.push_back((self.free_at, self.flow.written));
                }
                if self.now - begin >= settle {
                    longest = longest.max(self.free_at.saturating_duration_since(self.now));
                }
                self.now += Duration::from_micros(1200);
            }
            longest
        }
    }

    #[test]
    fn a_saturated_link_is_used_and_its_queue_stays_short() {
        for (rate, delay) in [(2.5e6, 100), (2.5e6, 20_000), (125e6, 200), (250e3, 1000)] {
            let mut link = Simulated::new(rate, Duration::from_micros(delay));
            link.saturate(Duration::from_millis(500), Duration::ZERO);
            let before = link.acknowledged;
            let queue = link.saturate(Duration::from_secs(2), Duration::ZERO);
            let used = (link.acknowledged - before) as f64 / (2.0 * rate);
            // Two segments are always allowed: on a slow link they are the bound.
            let most = (AHEAD * 5 / 3).max(Duration::from_secs_f64(2.5 * 1448.0 / rate));
            assert!(queue <= most, "{rate} B/s, {delay} µs: {queue:?}");
            assert!(used > 0.9, "{rate} B/s, {delay} µs: {used}");
        }
    }

    #[test]
    fn a_link_that_becomes_slower_or_faster_is_followed() {
        let mut link = Simulated::new(12.5e6, Duration::from_millis(1));
        link.saturate(Duration::from_secs(1), Duration::ZERO);
        link.rate = 1.25e6;
        let queue = link.saturate(Duration::from_secs(3), Duration::from_secs(1));
        assert!(queue <= Duration::from_millis(6), "{queue:?}");
        link.rate = 12.5e6;
        let before = link.acknowledged;
        link.saturate(Duration::from_secs(1), Duration::ZERO);
        assert!((link.acknowledged - before) as f64 > 0.9 * 12.5e6);
    }

    #[test]
    fn who_says_nothing_is_not_held_back() {
        let mut flow = Flow::default();
        assert_eq!(flow.room(|| None), usize::MAX);
        flow.wrote(1 << 30);
        assert_eq!(flow.room(|| unreachable!("asked once")), usize::MAX);
        assert_eq!(flow.piece(), usize::MAX);
    }
}
