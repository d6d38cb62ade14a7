//! The canary: a peer says stop to a receiver while a publisher floods it, or a receiver beside it that reads
//! nothing. How long does that take beside an idle hub, and what does the flood cost the hub?

use std::io::{ErrorKind, Read};
use std::net::Shutdown;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use mom_benches::listen::join;
use mom_benches::{Delays, Error, Hub, Link, Scan, Scanner, Topic};
use socket2::SockRef;

use crate::metric::{Metric, Sample};
use crate::stop::template;

/// The load.
#[derive(Clone, Copy, Debug)]
pub struct Canary {
    /// Bytes of a published parcel.
    pub payload: usize,
    /// Bytes that the publisher offers in a second.
    pub offered: f64,
    /// Of which the receiver of a flood takes one in so many.
    pub times: f64,
    /// How many stops, beside an idle hub and again under load.
    pub stops: u32,
    /// From one stop to the next.
    pub every: Duration,
    /// Stops that have not arrived so long after the last was sent do not.
    pub late: Duration,
}

/// What hinders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hindrance {
    /// The receiver takes a part of what is published, and of that all there is to be had: where a hub can hold the
    /// publisher back, it shall.
    Flood,
    /// Another receiver reads nothing; this one reads all.
    Sleeper,
}

/// Bytes of a stop's payload.
const STOP: usize = 16;
/// What is published is numbered from here on, stops from 0.
const PUBLISHED: u32 = 1 << 31;
/// Not measured at first: the queues fill.
const WARM_UP: Duration = Duration::from_millis(500);
/// What the system may keep for a receiver that does not read: the queue under measurement is the hub's.
const RECEIVE_BUFFER: usize = 32 * 1024;
/// Read at once by a receiver that takes its time.
const BITE: usize = 8 * 1024;
/// How long a read or a pause may last before the end is checked.
const LOOK: Duration = Duration::from_millis(50);

struct Shared {
    start: Instant,
    /// When each stop left, in ns since the start, and how long it took; 0 = not yet. First those of the idle hub.
    left: Vec<AtomicU64>,
    took: Vec<AtomicU64>,
    published: AtomicU64,
    flooded: AtomicBool,
    over: AtomicBool,
    failure: Mutex<Option<String>>,
}

impl Shared {
    fn new(stops: u32) -> Arc<Shared> {
        let zeros = || (0..2 * stops).map(|_| AtomicU64::new(0)).collect();
        Arc::new(Shared {
            start: Instant::now(),
            left: zeros(),
            took: zeros(),
            published: AtomicU64::new(0),
            flooded: AtomicBool::new(false),
            over: AtomicBool::new(false),
            failure: Mutex::new(None),
        })
    }

    fn now(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    fn has_failed(&self) -> bool {
        self.failure
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .is_some()
    }

    fn delays(&self, stops: std::ops::Range<u32>) -> Delays {
        let took = stops.map(|stop| self.took[stop as usize].load(Ordering::Relaxed));
        Delays::of(took.filter(|took| *took > 0).map(Duration::from_nanos).collect())
    }
}

impl Canary {
    /// Runs it; with the last words of a hub that cuts the receiver off.
    ///
    /// # Errors
    /// A hub that refuses at the start.
    pub fn run(&self, hub: &Hub, hindrance: Hindrance) -> Result<(Sample, Option<String>), Error> {
        let topic = match hindrance {
            Hindrance::Flood => Topic::Bulk,
            Hindrance::Sleeper => Topic::Forth,
        };
        let robot = listener(hub, &[topic, Topic::Stop])?;
        let sleeper = match hindrance {
            Hindrance::Flood => None,
            Hindrance::Sleeper => Some(listener(hub, &[topic])?),
        };
        let publisher = hub.driver.connect(&[], &[topic])?;
        let mut operator = hub.driver.connect(&[], &[Topic::Stop])?;
        let shared = Shared::new(self.stops);
        let listens = self.listen(hub, &shared, robot, hindrance);
        self.say_stop(hub, &shared, &mut operator, 0)?;
        self.settle(&shared, 0..self.stops);
        let memory = || hub.process.as_ref().and_then(|process| process.memory());
        let (memory_before, end_of_flood) = (memory(), publisher.second()?);
        shared.flooded.store(true, Ordering::Relaxed);
        let publishes = self.publish(hub, &shared, publisher, topic)?;
        thread::sleep(WARM_UP);
        let published = || shared.published.load(Ordering::Relaxed);
        let before = (Instant::now(), published(), hub.cpu());
        let said = self.say_stop(hub, &shared, &mut operator, self.stops);
        let after = (Instant::now(), published(), hub.cpu());
        let memory_after = memory();
        if said.is_ok() {
            self.settle(&shared, self.stops..2 * self.stops);
        }
        shared.over.store(true, Ordering::Relaxed);
        // A publisher that is held back would wait for the receiver.
        let _ = end_of_flood.stream.shutdown(Shutdown::Both);
        join(publishes)?;
        join(listens)?;
        drop(sleeper);
        let seconds = (after.0 - before.0).as_secs_f64();
        let count = after.1 - before.1;
        let mut sample = self.sample(&shared, count as f64 / seconds);
        if let Some((before, after)) = before.2.zip(after.2) {
            sample.insert(
                Metric::Cores,
                after.saturating_sub(before).as_secs_f64() / seconds,
            );
        }
        if let Some((before, after)) = memory_before.zip(memory_after) {
            let grown = after.saturating_sub(before) as f64;
            sample.insert(Metric::Grown, grown / f64::from(1 << 20));
        }
        let mut failure = shared.failure.lock().unwrap_or_else(PoisonError::into_inner);
        Ok((sample, failure.take()))
    }

    fn sample(&self, shared: &Shared, rate: f64) -> Sample {
        let (idle, loaded) = (
            shared.delays(0..self.stops),
            shared.delays(self.stops..2 * self.stops),
        );
        let mut sample = Sample::from([(Metric::Arrived, loaded.count() as f64), (Metric::Rate, rate)]);
        for (delays, p50, p99) in [
            (idle, Metric::IdleP50, Metric::IdleP99),
            (loaded, Metric::P50, Metric::P99),
        ] {
            if delays.count() > 0 {
                sample.extend([(p50, delays.quantile(0.5)), (p99, delays.quantile(0.99))]);
            }
        }
        sample
    }

    /// The publisher's thread: a parcel at each step, or as soon as the hub takes it.
    fn publish(
        &self,
        hub: &Hub,
        shared: &Arc<Shared>,
        mut publisher: Link,
        topic: Topic,
    ) -> Result<JoinHandle<()>, Error> {
        let template = template(hub, topic, self.payload)?;
        let step = Duration::from_secs_f64(self.payload as f64 / self.offered);
        let forever = publisher.stream.set_write_timeout(None);
        forever.map_err(Error::io("socket options"))?;
        let shared = Arc::clone(shared);
        Ok(thread::spawn(move || {
            let (start, mut bytes) = (Instant::now(), Vec::new());
            for number in PUBLISHED.. {
                if shared.is_over() {
                    return;
                }
                bytes.clear();
                template.append_all(number..number + 1, &mut bytes);
                if publisher.write(&bytes).is_err() {
                    return;
                }
                let due = start + step * (number - PUBLISHED + 1);
                thread::sleep(due.saturating_duration_since(Instant::now()));
            }
        }))
    }

    fn say_stop(&self, hub: &Hub, shared: &Shared, operator: &mut Link, first: u32) -> Result<(), Error> {
        let template = template(hub, Topic::Stop, STOP)?;
        let start = Instant::now();
        let mut bytes = Vec::new();
        for number in 0..self.stops {
            let due = start + self.every * number;
            thread::sleep(due.saturating_duration_since(Instant::now()));
            if shared.has_failed() {
                break;
            }
            bytes.clear();
            template.append_all(first + number..first + number + 1, &mut bytes);
            shared.left[(first + number) as usize].store(shared.now(), Ordering::Relaxed);
            operator.write(&bytes)?;
        }
        Ok(())
    }

    /// Waits for stops that are still on their way.
    fn settle(&self, shared: &Shared, stops: std::ops::Range<u32>) {
        let (end, all) = (Instant::now() + self.late, stops.len());
        while shared.delays(stops.clone()).count() < all && !shared.has_failed() && Instant::now() < end {
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// The receiver's thread. Under a flood it takes its part of what is offered and rests in between.
    fn listen(&self, hub: &Hub, shared: &Arc<Shared>, link: Link, hindrance: Hindrance) -> JoinHandle<()> {
        let rate = (hindrance == Hindrance::Flood).then_some(self.offered / self.times);
        let mut ear = Ear {
            shared: Arc::clone(shared),
            scanner: hub.driver.scanner(),
            link,
        };
        thread::spawn(move || {
            if let Err(error) = ear.listen(rate) {
                let mut failure = ear.shared.failure.lock().unwrap_or_else(PoisonError::into_inner);
                failure.get_or_insert(error.to_string());
            }
        })
    }
}

fn listener(hub: &Hub, hears: &[Topic]) -> Result<Link, Error> {
    let link = hub.driver.connect(hears, &[])?;
    let small = SockRef::from(&link.stream).set_recv_buffer_size(RECEIVE_BUFFER);
    small.map_err(Error::io("socket options"))?;
    let look = link.stream.set_read_timeout(Some(LOOK));
    look.map_err(Error::io("socket options"))?;
    Ok(link)
}

struct Ear {
    shared: Arc<Shared>,
    scanner: Box<dyn Scanner>,
    link: Link,
}

impl Ear {
    fn listen(&mut self, rate: Option<f64>) -> Result<(), Error> {
        let mut chunk = [0; BITE];
        let mut since: Option<(Instant, f64)> = None;
        while !self.shared.is_over() {
            let length = match self.link.stream.read(&mut chunk) {
                Ok(0) if self.shared.is_over() => return Ok(()),
                Ok(0) => return Err(Error::Unexpected("the end of the connection".to_owned())),
                Ok(length) => length,
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
                Err(error) => return Err(Error::io("read")(error)),
            };
            self.link.received.extend_from_slice(&chunk[..length]);
            self.scan()?;
            let Some(rate) = rate.filter(|_| self.shared.flooded.load(Ordering::Relaxed)) else {
                continue;
            };
            let (start, taken) = since.get_or_insert((Instant::now(), 0.0));
            *taken += length as f64;
            let due = *start + Duration::from_secs_f64(*taken / rate);
            thread::sleep(due.saturating_duration_since(Instant::now()).min(LOOK));
        }
        Ok(())
    }

    fn scan(&mut self) -> Result<(), Error> {
        let (now, mut at) = (self.shared.now(), 0);
        loop {
            match self.scanner.scan(&self.link.received[at..])? {
                Scan::Incomplete => break,
                Scan::Other(length) | Scan::Dropped(length, _) => at += length,
                Scan::Parcel(length, number) => {
                    at += length;
                    self.note(number, now);
                }
            }
        }
        self.link.received.drain(..at);
        Ok(())
    }

    fn note(&self, number: u32, now: u64) {
        if number >= PUBLISHED {
            self.shared.published.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let left = self.shared.left[number as usize].load(Ordering::Relaxed);
        self.shared.took[number as usize].store(now.saturating_sub(left).max(1), Ordering::Relaxed);
    }
}
