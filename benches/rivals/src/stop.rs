//! The saturated stop: a camera sends more than the link to a subscriber carries, a peer says stop to it now and
//! then. How long does that take, and do all arrive?

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use mom_benches::listen::{Listener, Listening, Sink, join};
use mom_benches::{Delays, Error, Hub, Link, Message, Template, Topic};
use mom_tests::network::Namespaces;

use crate::metric::{Metric, Sample};
use crate::network::LINK_RATE;

/// The load.
#[derive(Clone, Copy, Debug)]
pub struct SaturatedStop {
    /// Bytes of a camera's frame.
    pub frame: usize,
    /// What the camera sends, in bits per second.
    pub load: f64,
    /// From the first frame to the first stop; until then nothing is measured.
    pub warm_up: Duration,
    /// The camera sends for so long, pauses for so long, and so on; none: it never pauses.
    pub pauses: Option<(Duration, Duration)>,
    /// How many stops.
    pub stops: u32,
    /// From one stop to the next.
    pub every: Duration,
    /// Stops that have not arrived so long after the last was sent do not.
    pub late: Duration,
}

/// Bytes of a stop's payload.
const STOP: usize = 16;
/// Frames are numbered from here on, stops from 0.
const FRAMES: u32 = 1 << 31;
/// A hub may hold a sender back for so long.
const HELD: Duration = Duration::from_secs(30);

struct Shared {
    start: Instant,
    /// When each stop left, in ns since the start, and how long it took; 0 = not yet.
    left: Vec<AtomicU64>,
    took: Vec<AtomicU64>,
    frame_bytes: AtomicU64,
    told: AtomicU64,
    over: AtomicBool,
    failure: Mutex<Option<String>>,
}

impl Shared {
    fn now(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    fn arrived(&self) -> usize {
        let stops = self.took.iter();
        stops.filter(|took| took.load(Ordering::Relaxed) > 0).count()
    }

    fn has_failed(&self) -> bool {
        self.failure
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .is_some()
    }
}

/// What was seen.
#[derive(Debug)]
pub struct Observed {
    /// Of each stop that was sent: when, since the first frame, and how long it took; none: it did not arrive.
    pub stops: Vec<(Duration, Option<Duration>)>,
    /// Bytes of the camera's frames that arrived while stops were sent, and how long that was.
    pub frames: (u64, Duration),
    /// Dropped parcels that the senders heard of.
    pub told: u64,
    /// Processor time of the hub while stops were sent.
    pub cpu: Option<Duration>,
    /// A subscriber that was cut off: its last words.
    pub failure: Option<String>,
}

impl SaturatedStop {
    /// Runs it between the ends of a slow link; `before` is told of each stop that is about to be sent. A hub that cuts the
    /// subscriber off still has figures, the stops that arrived until then, and with them the subscriber's last words.
    ///
    /// # Errors
    /// A hub that refuses at the start.
    pub fn run(&self, hub: &Hub, ends: &Namespaces, before: impl FnMut(u32)) -> Result<Observed, Error> {
        let connect = |network: &mom_tests::network::Network, hears: &[Topic], says: &[Topic]| {
            let link = network.within(|| hub.driver.connect(hears, says));
            link.map_err(Error::io("a network"))?
        };
        let subscriber = connect(&ends.far, &[Topic::Image, Topic::Stop], &[])?;
        let camera = connect(&ends.hub, &[], &[Topic::Image])?;
        let stopper = connect(&ends.hub, &[], &[Topic::Stop])?;
        let zeros = || (0..self.stops).map(|_| AtomicU64::new(0)).collect();
        let shared = Arc::new(Shared {
            start: Instant::now(),
            left: zeros(),
            took: zeros(),
            frame_bytes: AtomicU64::new(0),
            told: AtomicU64::new(0),
            over: AtomicBool::new(false),
            failure: Mutex::new(None),
        });
        let listener = |link, subscriber| Listener {
            link,
            scanner: hub.driver.scanner(),
            sink: Ear {
                shared: Arc::clone(&shared),
                frame: self.frame as u64,
                subscriber,
                now: 0,
            },
        };
        let listeners = vec![
            listener(subscriber, true),
            listener(camera.second()?, false),
            listener(stopper.second()?, false),
        ];
        let listening = Listening::start(listeners)?;
        let filming = self.film(hub, &shared, camera)?;
        thread::sleep(self.warm_up);
        let figures = || {
            (
                Instant::now(),
                shared.frame_bytes.load(Ordering::Relaxed),
                hub.cpu(),
            )
        };
        let began = figures();
        self.say_stop(hub, &shared, stopper, before)?;
        let ended = figures();
        self.settle(&shared);
        shared.over.store(true, Ordering::Relaxed);
        // The far end first: a hub that holds the camera back lets it go then.
        listening.end()?;
        join(filming)?;
        let nanos = |nanos: &AtomicU64| Some(nanos.load(Ordering::Relaxed)).filter(|nanos| *nanos > 0);
        let stops = shared.left.iter().zip(&shared.took);
        let stops = stops.filter_map(|(left, took)| {
            let took = nanos(took).map(Duration::from_nanos);
            Some((Duration::from_nanos(nanos(left)?), took))
        });
        let failure = shared
            .failure
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        Ok(Observed {
            stops: stops.collect(),
            frames: (ended.1 - began.1, ended.0 - began.0),
            told: shared.told.load(Ordering::Relaxed),
            cpu: began
                .2
                .zip(ended.2)
                .map(|(began, ended)| ended.saturating_sub(began)),
            failure,
        })
    }

    /// The figures of the tables, and the subscriber's last words.
    pub fn sample(&self, observed: Observed) -> (Sample, Option<String>) {
        let delays = Delays::of(observed.stops.iter().filter_map(|(_, took)| *took).collect());
        let (bytes, time) = (observed.frames.0 as f64, observed.frames.1.as_secs_f64());
        let frames = bytes / self.frame as f64;
        let mut sample = Sample::from([
            (Metric::P50, delays.quantile(0.5)),
            (Metric::P99, delays.quantile(0.99)),
            (Metric::Arrived, delays.count() as f64),
            (Metric::Frames, frames),
            (Metric::Link, bytes * 8.0 / time / LINK_RATE),
            (Metric::Told, observed.told as f64),
        ]);
        if let Some(used) = observed.cpu {
            let deliveries = (frames + delays.count() as f64) / 1e6;
            sample.insert(Metric::Cpu, used.as_secs_f64() / deliveries.max(1e-9));
        }
        (sample, observed.failure)
    }

    /// The camera's thread: a frame at each step, or as soon as the hub takes it.
    fn film(
        &self,
        hub: &Hub,
        shared: &Arc<Shared>,
        mut camera: Link,
    ) -> Result<thread::JoinHandle<()>, Error> {
        let template = template(hub, Topic::Image, self.frame)?;
        let step = Duration::from_secs_f64(self.frame as f64 * 8.0 / self.load);
        let pauses = self.pauses;
        let patient = camera.stream.set_write_timeout(Some(HELD));
        patient.map_err(Error::io("socket options"))?;
        let shared = Arc::clone(shared);
        Ok(thread::spawn(move || {
            let mut bytes = Vec::new();
            let mut due = Instant::now();
            for number in FRAMES.. {
                if let Some((on, off)) = pauses {
                    let at = shared.start.elapsed().as_nanos() % (on + off).as_nanos();
                    let at = Duration::from_nanos(u64::try_from(at).unwrap_or_default());
                    if at >= on {
                        thread::sleep(on + off - at);
                    }
                }
                if shared.over.load(Ordering::Relaxed) {
                    return;
                }
                bytes.clear();
                template.append_all(number..number + 1, &mut bytes);
                if camera.write(&bytes).is_err() {
                    return;
                }
                // A camera that was held up does not make up for it.
                due = (due + step).max(Instant::now() - step);
                thread::sleep(due.saturating_duration_since(Instant::now()));
            }
        }))
    }

    fn say_stop(
        &self,
        hub: &Hub,
        shared: &Shared,
        mut stopper: Link,
        mut before: impl FnMut(u32),
    ) -> Result<(), Error> {
        let template = template(hub, Topic::Stop, STOP)?;
        let start = Instant::now();
        let mut bytes = Vec::new();
        for number in 0..self.stops {
            let due = start + self.every * number;
            thread::sleep(due.saturating_duration_since(Instant::now()));
            if shared.has_failed() {
                break;
            }
            before(number);
            bytes.clear();
            template.append_all(number..number + 1, &mut bytes);
            shared.left[number as usize].store(shared.now(), Ordering::Relaxed);
            stopper.write(&bytes)?;
        }
        Ok(())
    }

    /// Waits for stops that are still on their way.
    fn settle(&self, shared: &Shared) {
        let end = Instant::now() + self.late;
        while shared.arrived() < self.stops as usize && !shared.has_failed() && Instant::now() < end {
            thread::sleep(Duration::from_millis(10));
        }
    }
}

pub(crate) fn template(hub: &Hub, topic: Topic, payload: usize) -> Result<Template, Error> {
    hub.driver.template(Message {
        topic,
        payload,
        echo: false,
    })
}

struct Ear {
    shared: Arc<Shared>,
    frame: u64,
    /// Or one of those who send.
    subscriber: bool,
    now: u64,
}

impl Sink for Ear {
    fn begin(&mut self) {
        self.now = self.shared.now();
    }

    fn parcel(&mut self, number: u32) -> Result<(), Error> {
        if number >= FRAMES {
            self.shared.frame_bytes.fetch_add(self.frame, Ordering::Relaxed);
            return Ok(());
        }
        let stop = number as usize;
        let (left, took) = (&self.shared.left[stop], &self.shared.took[stop]);
        let delay = self.now.saturating_sub(left.load(Ordering::Relaxed)).max(1);
        match took.swap(delay, Ordering::Relaxed) {
            0 => Ok(()),
            _ => Err(Error::Unexpected(format!("stop {number} twice"))),
        }
    }

    fn dropped(&mut self, count: u64) -> Result<(), Error> {
        if !self.subscriber {
            self.shared.told.fetch_add(count, Ordering::Relaxed);
        }
        Ok(())
    }

    fn failed(&mut self, error: Error) {
        // One who only sends may be cut off for not reading; what counts is who listens.
        if self.subscriber && !self.shared.over.load(Ordering::Relaxed) {
            let mut failure = self.shared.failure.lock().unwrap_or_else(PoisonError::into_inner);
            failure.get_or_insert(error.to_string());
        }
    }
}
