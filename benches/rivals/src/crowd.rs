//! Many peers in one channel, each sending at a steady rate and hearing everybody: robots that tell their state.

use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use mom_benches::listen::{Listener, Listening, Sink, join};
use mom_benches::{Delays, Error, Hub, Link, Message, Template, Topic};

use crate::metric::{Metric, Sample};

/// Peers that all talk and all listen.
#[derive(Clone, Copy, Debug)]
pub struct Crowd {
    /// How many.
    pub peers: usize,
    /// What each sends in a second.
    pub rate: usize,
    /// Bytes of each payload.
    pub payload: usize,
    /// Not measured at first.
    pub warm_up: Duration,
    /// Measured.
    pub time: Duration,
}

/// What arrives later than so long after the last was sent counts as not delivered.
const LATE: Duration = Duration::from_millis(500);

/// What the sending thread and the receivers share; times are ns since the start.
struct Shared {
    start: Instant,
    sent_at: Vec<AtomicU64>,
    measured: std::ops::Range<u32>,
    delivered: AtomicU64,
    failure: Mutex<Option<Error>>,
    failed: AtomicBool,
}

impl Shared {
    fn now(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    fn fail(&self, error: Error) {
        let mut failure = self
            .failure
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        failure.get_or_insert(error);
        self.failed.store(true, Ordering::Relaxed);
    }
}

impl Crowd {
    /// Runs it. What is asked for is one delivery of each parcel to each peer, the sender too.
    ///
    /// # Errors
    /// Parcels doubled or out of their sender's order; a hub that refuses. Lost ones only lower the share.
    pub fn run(&self, hub: &Hub) -> Result<Sample, Error> {
        let count = |time: Duration| (time.as_secs_f64() * (self.peers * self.rate) as f64).round() as u32;
        let all = count(self.warm_up) + count(self.time);
        let topics = [Topic::Forth];
        let connect = |_| hub.driver.connect(&topics, &topics);
        let links: Vec<Link> = (0..self.peers).map(connect).collect::<Result<_, _>>()?;
        let template = hub.driver.template(Message {
            echo: true,
            ..Message::forth(self.payload)
        })?;
        let shared = Arc::new(Shared {
            start: Instant::now(),
            sent_at: (0..all).map(|_| AtomicU64::new(0)).collect(),
            measured: count(self.warm_up)..all,
            delivered: AtomicU64::new(0),
            failure: Mutex::new(None),
            failed: AtomicBool::new(false),
        });
        let senders: Vec<Link> = links.iter().map(Link::second).collect::<Result<_, _>>()?;
        let delays = Arc::new(Mutex::new(Vec::new()));
        let listener = |link| Listener {
            link,
            scanner: hub.driver.scanner(),
            sink: Ear {
                shared: Arc::clone(&shared),
                next: vec![0; self.peers],
                now: 0,
                delays: Vec::new(),
                all: Arc::clone(&delays),
            },
        };
        let listening = Listening::start(links.into_iter().map(listener).collect())?;
        let sending = thread::spawn({
            let (shared, crowd) = (Arc::clone(&shared), *self);
            move || crowd.send(&shared, senders, &template)
        });
        thread::sleep(self.warm_up);
        let (start, cpu) = (Instant::now(), hub.cpu());
        let sent = join(sending)?;
        // All of it counts if it is there by now; the hub's time ends with what it delivers.
        Crowd::settle(self.asked(hub), &shared);
        let (time, cpu_after) = (start.elapsed(), hub.cpu());
        listening.end()?;
        let failure = shared
            .failure
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
            .take();
        failure.map_or(Ok(()), Err)?;
        sent?;
        let delivered = shared.delivered.load(Ordering::Relaxed);
        let delays = std::mem::take(&mut *delays.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
        Ok(self.sample(self.asked(hub), delivered, time, delays, cpu.zip(cpu_after)))
    }

    /// Deliveries in the measured time: to everybody, the sender too where the hub does that.
    fn asked(&self, hub: &Hub) -> u64 {
        let sent = (self.time.as_secs_f64() * (self.peers * self.rate) as f64).round() as u64;
        let hear = match hub.driver.echoes() {
            true => self.peers,
            false => self.peers - 1,
        };
        sent * hear as u64
    }

    fn sample(
        &self,
        asked: u64,
        delivered: u64,
        time: Duration,
        delays: Vec<Duration>,
        cpu: Option<(Duration, Duration)>,
    ) -> Sample {
        let delays = Delays::of(delays);
        let mut sample = Sample::from([
            (Metric::Rate, delivered as f64 / self.time.max(time).as_secs_f64()),
            (Metric::Share, delivered as f64 / asked as f64),
            (Metric::P50, delays.quantile(0.5)),
            (Metric::P99, delays.quantile(0.99)),
        ]);
        if let Some((before, after)) = cpu {
            let used = after.saturating_sub(before).as_secs_f64();
            sample.insert(Metric::Cpu, used / (delivered as f64 / 1e6).max(1e-9));
        }
        sample
    }

    /// Waits for what is still on its way.
    fn settle(asked: u64, shared: &Shared) {
        let end = Instant::now() + LATE;
        while shared.delivered.load(Ordering::Relaxed) < asked && Instant::now() < end {
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Sends in turn, each parcel when it is due, or at once where that is past.
    fn send(&self, shared: &Shared, mut links: Vec<Link>, template: &Template) -> Result<(), Error> {
        let step = Duration::from_secs(1) / (self.peers * self.rate) as u32;
        let mut bytes = Vec::new();
        // A hub that does not keep up is not asked for ever.
        let deadline = shared.start + 3 * (self.warm_up + self.time);
        for (number, sent_at) in (0u32..).zip(&shared.sent_at) {
            let due = shared.start + step * number;
            let wait = due.saturating_duration_since(Instant::now());
            if !wait.is_zero() {
                thread::sleep(wait);
            }
            if shared.failed.load(Ordering::Relaxed) || Instant::now() > deadline {
                break;
            }
            bytes.clear();
            template.append_all(number..number + 1, &mut bytes);
            sent_at.store(shared.now(), Ordering::Relaxed);
            links[number as usize % self.peers].write(&bytes)?;
        }
        Ok(())
    }
}

/// One who hears everybody.
struct Ear {
    shared: Arc<Shared>,
    /// The least number of a sender's that has not come yet, divided by the senders.
    next: Vec<u32>,
    now: u64,
    delays: Vec<Duration>,
    all: Arc<Mutex<Vec<Duration>>>,
}

impl Sink for Ear {
    fn begin(&mut self) {
        self.now = self.shared.now();
    }

    fn parcel(&mut self, number: u32) -> Result<(), Error> {
        let peers = self.next.len() as u32;
        let next = &mut self.next[(number % peers) as usize];
        let turn = number / peers;
        if turn < *next {
            return Err(Error::Order {
                expected: *next * peers + number % peers,
                got: number,
            });
        }
        *next = turn + 1;
        if self.shared.measured.contains(&number) {
            let sent = self.shared.sent_at[number as usize].load(Ordering::Relaxed);
            self.delays
                .push(Duration::from_nanos(self.now.saturating_sub(sent)));
        }
        Ok(())
    }

    /// Lost ones lower the share.
    fn dropped(&mut self, _count: u64) -> Result<(), Error> {
        Ok(())
    }

    fn end(&mut self) {
        if !self.delays.is_empty() {
            let count = self.delays.len() as u64;
            self.shared.delivered.fetch_add(count, Ordering::Relaxed);
            let mut all = self.all.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            all.append(&mut self.delays);
        }
    }

    fn failed(&mut self, error: Error) {
        self.shared.fail(error);
    }
}
