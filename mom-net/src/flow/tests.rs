use std::collections::VecDeque;

use super::*;

const MS: Duration = Duration::from_millis(1);
const SEGMENT: u64 = 1448;

/// A bottleneck of so many bytes per second with a round trip, a kernel in slow start, a receiver that acknowledges every
/// second segment, and a writer that looks every 1.2 ms.
struct Simulated {
    rate: f64,
    round_trip: Duration,
    now: Instant,
    flow: Flow,
    /// Given to the kernel and not to the link.
    unsent: u64,
    sent: u64,
    window: u64,
    grows: bool,
    /// When each segment has left the bottleneck, and its end.
    left: VecDeque<(Instant, u64)>,
    /// When acknowledgements arrive, and of what.
    returning: VecDeque<(Instant, u64)>,
    acknowledged: u64,
    free_at: Instant,
    next_write: Instant,
}

/// The longest that a stop would have waited.
#[derive(Clone, Copy, Debug, Default)]
struct Longest {
    /// Behind what the bottleneck holds.
    queue: Duration,
    /// Bytes that the kernel could not send.
    unsent: u64,
}

impl Simulated {
    fn new(rate: f64, round_trip: Duration) -> Simulated {
        let start = Instant::now();
        Simulated {
            rate,
            round_trip,
            now: start,
            flow: Flow::default(),
            unsent: 0,
            sent: 0,
            window: 10,
            grows: true,
            left: VecDeque::new(),
            returning: VecDeque::new(),
            acknowledged: 0,
            free_at: start,
            next_write: start,
        }
    }

    fn of_mbit(rate: f64, round_trip: u64) -> Simulated {
        Simulated::new(rate * 125e3, MS * u32::try_from(round_trip).unwrap())
    }

    /// Lets time pass, and writes whenever there is room.
    fn saturate(&mut self, time: Duration) -> Longest {
        self.run(time, true)
    }

    fn idle(&mut self, time: Duration) {
        self.flow.rest();
        self.run(time, false);
    }

    fn run(&mut self, time: Duration, writes: bool) -> Longest {
        let (end, mut longest) = (self.now + time, Longest::default());
        while self.now < end {
            self.acknowledge();
            if writes && self.now >= self.next_write {
                self.write();
                self.next_write = self.now + Duration::from_micros(1200);
            }
            self.send();
            longest.queue = longest
                .queue
                .max(self.free_at.saturating_duration_since(self.now));
            longest.unsent = longest.unsent.max(self.unsent);
            self.now += Duration::from_micros(100);
        }
        longest
    }

    fn acknowledge(&mut self) {
        while let Some((at, end)) = self.left.front().copied() {
            let pair = self.left.get(1).copied();
            let (at, end, count) = match pair {
                Some((at, end)) => (at, end, 2),
                None => (at + 40 * MS, end, 1),
            };
            if at > self.now {
                break;
            }
            self.left.drain(..count);
            self.returning.push_back((at + self.round_trip, end));
        }
        while let Some((_, end)) = self.returning.front().copied().filter(|(at, _)| *at <= self.now) {
            self.returning.pop_front();
            let under_way = (self.sent - self.acknowledged).div_ceil(SEGMENT);
            if self.grows && under_way * 2 > self.window {
                self.window += (end - self.acknowledged).div_ceil(SEGMENT);
            }
            self.acknowledged = end;
        }
    }

    fn write(&mut self) {
        let link = TcpState {
            acknowledged: self.acknowledged,
            segment: u32::try_from(SEGMENT).unwrap(),
            window: u32::try_from(self.window).unwrap(),
            pace: u64::MAX,
            least_round_trip: u32::try_from(self.round_trip.as_micros()).unwrap(),
        };
        loop {
            let room = self.flow.room_at(|| Some(link), || self.now);
            if room == 0 {
                return;
            }
            let piece = room.min(self.flow.piece());
            self.flow.wrote(piece);
            self.unsent += piece as u64;
        }
    }

    fn send(&mut self) {
        while self.unsent > 0 && self.sent - self.acknowledged < self.window * SEGMENT {
            let segment = self.unsent.min(SEGMENT);
            self.unsent -= segment;
            self.sent += segment;
            self.free_at = self.free_at.max(self.now) + Duration::from_secs_f64(segment as f64 / self.rate);
            self.left.push_back((self.free_at, self.sent));
        }
    }

    /// The share of the link that was used for so long.
    fn share(&mut self, time: Duration) -> f64 {
        let before = self.acknowledged;
        self.saturate(time);
        (self.acknowledged - before) as f64 / (self.rate * time.as_secs_f64())
    }
}

/// So long the queue of a link of so many Mbit/s may be at first: the last burst that probes it, the second burst of a slow one,
/// or what more may be under way while the rate of a long one grows.
fn first_queue(rate: f64, round_trip: u64) -> Duration {
    let growth = (MS * u32::try_from(round_trip).unwrap()).mul_f64(0.2);
    let segments = Duration::from_secs_f64(5.0 * 1448.0 * 8.0 / (rate * 1e6));
    (MS * 9).max(growth).max(segments)
}

const LINKS: [(f64, u64); 9] = [
    (1.0, 1),
    (1.0, 5),
    (1.0, 100),
    (20.0, 0),
    (20.0, 5),
    (20.0, 100),
    (100.0, 0),
    (100.0, 5),
    (100.0, 100),
];

#[test]
fn the_queue_is_short_from_the_first_byte_on_and_the_link_is_used_after_a_second() {
    for (rate, round_trip) in LINKS {
        let mut link = Simulated::of_mbit(rate, round_trip);
        let longest = link.saturate(1000 * MS);
        let name = format!("{rate} Mbit/s, {round_trip} ms: {longest:?}");
        assert!(longest.queue <= first_queue(rate, round_trip), "{name}");
        assert!(longest.unsent <= 4 * SEGMENT || round_trip == 0, "{name}");
        // The kernel's window of ten segments has to grow to 863.
        let settles = if rate * (round_trip as f64) > 5000.0 {
            1000 * MS
        } else {
            Duration::ZERO
        };
        link.saturate(settles);
        let share = link.share(1000 * MS);
        assert!(share >= 0.9, "{name} {share}");
        // Two segments are always allowed: on a slow link they are the bound.
        let most = (AHEAD * 5 / 3).max(Duration::from_secs_f64(2.75 * 1448.0 * 8.0 / (rate * 1e6)));
        let later = link.saturate(2000 * MS).queue;
        assert!(
            later <= most.max(first_queue(rate, round_trip) * 3 / 4),
            "{name} {later:?}"
        );
    }
}

/// A kernel that has left slow start sends no more than its window, however much of it is used.
#[test]
fn a_window_that_does_not_grow_is_used() {
    let mut link = Simulated::of_mbit(100.0, 1);
    link.window = 16;
    link.grows = false;
    link.saturate(500 * MS);
    let share = link.share(500 * MS);
    assert!(share > 0.9, "{share}");
}

/// However much is under way some stops leave, and never so many that they are a long queue themselves.
#[test]
fn stops_are_under_way_up_to_a_bound() {
    let mut link = Simulated::of_mbit(0.5, 5);
    link.saturate(2000 * MS);
    let mut longest = Duration::ZERO;
    for _ in 0..5000 {
        link.write();
        while link.flow.stops(0) > 0 {
            link.flow.wrote(300);
            link.unsent += 300;
        }
        longest = longest.max(link.run(MS / 2, false).queue);
    }
    // STOPS and what is under way of others, at 62.5 kB/s.
    assert!(longest > 60 * MS && longest < 150 * MS, "{longest:?}");
}

/// Also where there is nothing else to say, and the link rests after each.
#[test]
fn stops_alone_are_bounded_on_a_link_that_takes_nothing() {
    let mut flow = Flow::default();
    let link = TcpState {
        segment: 1448,
        window: 10,
        ..TcpState::default()
    };
    let now = Instant::now();
    for _ in 0..1000 {
        let room = flow.room_at(|| Some(link), || now);
        if flow.stops(room) > 0 {
            flow.wrote(300);
            flow.rest();
        }
    }
    assert!((7000..8000).contains(&flow.written()), "{}", flow.written());
}

#[test]
fn after_a_pause_it_begins_as_gently() {
    for pause in [100, 1000, 15_000] {
        for (rate, round_trip) in LINKS {
            let mut link = Simulated::of_mbit(rate, round_trip);
            link.saturate(2000 * MS);
            link.idle(pause * MS);
            let longest = link.saturate(500 * MS);
            let name = format!("{rate} Mbit/s, {round_trip} ms, {pause} ms: {longest:?}");
            assert!(longest.queue <= first_queue(rate, round_trip), "{name}");
        }
    }
}

#[test]
fn a_link_that_becomes_slower_or_faster_is_followed() {
    for round_trip in [1, 5, 50] {
        let mut link = Simulated::of_mbit(100.0, round_trip);
        link.saturate(2000 * MS);
        link.rate /= 10.0;
        // What is under way when it becomes slower takes ten times as long.
        let under_way = 10 * (MS * u32::try_from(round_trip).unwrap() + AHEAD);
        let longest = link.saturate(under_way * 2 + 100 * MS).queue;
        assert!(longest <= under_way + 15 * MS, "{round_trip} ms: {longest:?}");
        let longest = link.saturate(1000 * MS).queue;
        assert!(longest <= 12 * MS, "{round_trip} ms: {longest:?}");
        link.rate *= 10.0;
        link.saturate(3000 * MS);
        let share = link.share(1000 * MS);
        assert!(share > 0.9, "{round_trip} ms: {share}");
    }
}

/// What is written now and then says nothing about the link, and does not make the burst grow.
#[test]
fn small_talk_is_no_probe() {
    let mut link = Simulated::of_mbit(20.0, 0);
    for _ in 0..1000 {
        let state = TcpState {
            acknowledged: link.flow.written,
            segment: 1448,
            window: 10,
            pace: u64::MAX,
            least_round_trip: 100,
        };
        link.now += 5 * MS;
        let room = link.flow.room_at(|| Some(state), || link.now);
        assert!(room <= 2 * 1448, "{room}");
        link.flow.wrote(room.min(500));
        link.flow.rest();
    }
}

/// Who has nothing to send for a moment in the middle of a burst does not get another burst beside it.
#[test]
fn a_burst_with_a_gap_bounds_what_is_under_way() {
    let mut link = Simulated::of_mbit(20.0, 100);
    for _ in 0..200 {
        link.saturate(Duration::from_micros(1300));
        link.flow.rest();
        let under_way = link.flow.written - link.flow.acknowledged;
        assert!(under_way <= 20 * SEGMENT, "{under_way}");
    }
}

#[test]
fn a_peer_that_talks_little_keeps_nothing() {
    let mut flow = Flow::default();
    let link = TcpState {
        segment: 1448,
        window: 10,
        ..TcpState::default()
    };
    flow.room(|| Some(link));
    flow.wrote(900);
    flow.rest();
    assert!(flow.measure().is_none());
}

#[test]
fn who_says_nothing_is_not_held_back() {
    let mut flow = Flow::default();
    assert_eq!(flow.room(|| None), usize::MAX);
    flow.wrote(1 << 30);
    assert_eq!(flow.room(|| unreachable!("asked once")), usize::MAX);
    assert_eq!(flow.piece(), usize::MAX);
}

#[test]
fn who_takes_nothing_is_looked_at_less_often() {
    let mut link = Simulated::of_mbit(20.0, 100);
    link.saturate(2000 * MS);
    let mut pause = Pause::default();
    pause.look(&link.flow);
    let looks = std::iter::from_fn(|| {
        pause.look(&link.flow);
        Some(pause.time())
    });
    let usual = looks.take(1000).take_while(|time| *time < MS).count();
    assert!((795..810).contains(&usual), "two round trips: {usual}");
    assert!(pause.time() < 3 * MS, "{pause:?}");
}

#[test]
fn trace() {
    let mut link = Simulated::of_mbit(100.0, 100);
    for step in 0..20 {
        let before = link.acknowledged;
        let longest = link.saturate(100 * MS);
        let measure = match link.flow.measure() {
            Some(Measure::Known(known)) => format!("{known:?}"),
            other => format!("{other:?}"),
        };
        eprintln!(
            "{step} {} window {} under way {} {longest:?} {}",
            link.acknowledged - before,
            link.window,
            link.flow.written - link.acknowledged,
            &measure[..measure.len().min(250)]
        );
    }
}
