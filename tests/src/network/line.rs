//! What a packet goes through in one direction of a link: no clock and no socket, so that tests can say what time it is.

use std::collections::VecDeque;
use std::time::Duration;

/// What one direction of a link is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Bits per second, of whole IP packets.
    pub rate: f64,
    /// From the end of the bottleneck to the other side.
    pub delay: Duration,
    /// Up to so much more, evenly distributed; packets keep their order.
    pub jitter: Duration,
    /// The share of packets that are lost.
    pub loss: f64,
    /// What may wait at the bottleneck, as the time in which it leaves; a packet that finds more is dropped.
    pub queue: Duration,
}

impl Shape {
    /// A link of so many Mbit/s that loses nothing, with a queue of half a second.
    pub fn mbit(rate: f64, delay: Duration) -> Shape {
        Shape {
            rate: rate * 1e6,
            delay,
            jitter: Duration::ZERO,
            loss: 0.0,
            queue: Duration::from_millis(500),
        }
    }
}

/// What has passed one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Passed {
    /// Packets that were delivered.
    pub packets: u64,
    /// Their bytes, with IP headers.
    pub bytes: u64,
    /// Packets that were lost on the way.
    pub lost: u64,
    /// Packets for which the queue was full.
    pub dropped: u64,
    /// The longest time that a packet waited at the bottleneck for those before it.
    pub longest_wait: Duration,
}

/// One direction, with the packets that are under way. Times count from any beginning.
#[derive(Debug)]
pub struct Line {
    shape: Shape,
    random: fastrand::Rng,
    /// When the bottleneck has sent what it has.
    free_at: Duration,
    /// When the last packet arrives.
    last: Duration,
    under_way: VecDeque<(Duration, Vec<u8>)>,
    passed: Passed,
}

impl Line {
    /// A direction with nothing in it; the same seed loses the same packets.
    pub fn new(shape: Shape, seed: u64) -> Line {
        Line {
            shape,
            random: fastrand::Rng::with_seed(seed),
            free_at: Duration::ZERO,
            last: Duration::ZERO,
            under_way: VecDeque::new(),
            passed: Passed::default(),
        }
    }

    /// Changes what it is like, for packets that come from now on; what waits at the bottleneck leaves at the new rate.
    pub fn reshape(&mut self, shape: Shape, now: Duration) {
        let waits = self.free_at.saturating_sub(now);
        self.free_at = now + waits.mul_f64(self.shape.rate / shape.rate);
        self.shape = shape;
    }

    /// Takes a packet in.
    pub fn offer(&mut self, packet: Vec<u8>, now: Duration) {
        let waits = self.free_at.saturating_sub(now);
        if waits > self.shape.queue {
            self.passed.dropped += 1;
            return;
        }
        self.passed.longest_wait = self.passed.longest_wait.max(waits);
        let sends = Duration::from_secs_f64(packet.len() as f64 * 8.0 / self.shape.rate);
        self.free_at = now + waits + sends;
        if self.shape.loss > 0.0 && self.random.f64() < self.shape.loss {
            self.passed.lost += 1;
            return;
        }
        let jitter = self.shape.jitter.mul_f64(self.random.f64());
        self.last = self.last.max(self.free_at + self.shape.delay + jitter);
        self.under_way.push_back((self.last, packet));
    }

    /// When the next packet arrives.
    pub fn due(&self) -> Option<Duration> {
        self.under_way.front().map(|(at, _)| *at)
    }

    /// A packet that has arrived.
    pub fn arrived(&mut self, now: Duration) -> Option<Vec<u8>> {
        self.due().filter(|due| *due <= now)?;
        let (_, packet) = self.under_way.pop_front()?;
        self.passed.packets += 1;
        self.passed.bytes += packet.len() as u64;
        Some(packet)
    }

    /// What has passed since the last call.
    pub fn take_passed(&mut self) -> Passed {
        std::mem::take(&mut self.passed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn arrivals(line: &mut Line) -> Vec<Duration> {
        let mut arrivals = Vec::new();
        while let Some(due) = line.due() {
            assert!(line.arrived(due - Duration::from_nanos(1)).is_none());
            assert!(line.arrived(due).is_some());
            arrivals.push(due);
        }
        arrivals
    }

    #[test]
    fn packets_leave_at_the_rate_and_arrive_after_the_delay() {
        // 1000 bytes take a millisecond.
        let mut line = Line::new(Shape::mbit(8.0, 5 * MS), 1);
        for _ in 0..3 {
            line.offer(vec![0; 1000], 10 * MS);
        }
        line.offer(vec![0; 2000], 20 * MS);
        assert_eq!(arrivals(&mut line), [16 * MS, 17 * MS, 18 * MS, 27 * MS]);
        let passed = line.take_passed();
        assert_eq!(
            (passed.packets, passed.bytes, passed.longest_wait),
            (4, 5000, 2 * MS)
        );
        assert_eq!(line.take_passed(), Passed::default());
    }

    #[test]
    fn a_full_queue_drops_and_a_new_rate_holds_for_what_waits() {
        let shape = Shape {
            queue: 2 * MS,
            ..Shape::mbit(8.0, Duration::ZERO)
        };
        let mut line = Line::new(shape, 1);
        for _ in 0..10 {
            line.offer(vec![0; 1000], Duration::ZERO);
        }
        assert_eq!(line.take_passed().dropped, 7);
        line.reshape(
            Shape {
                rate: 0.8e6,
                queue: 50 * MS,
                ..shape
            },
            MS,
        );
        line.offer(vec![0; 100], MS);
        assert_eq!(line.take_passed().longest_wait, 20 * MS);
    }

    #[test]
    fn the_same_seed_loses_the_same_and_jitter_keeps_the_order() {
        let shape = Shape {
            loss: 0.2,
            jitter: 20 * MS,
            ..Shape::mbit(100.0, MS)
        };
        let run = |seed| {
            let mut line = Line::new(shape, seed);
            for number in 0..1000 {
                line.offer(vec![0; 100], number * MS);
            }
            let arrivals = arrivals(&mut line);
            assert!(arrivals.is_sorted());
            (arrivals, line.take_passed().lost)
        };
        assert_eq!(run(7), run(7));
        assert_ne!(run(7), run(8));
        assert!((150..250).contains(&run(7).1), "{}", run(7).1);
    }
}
