//! One sender, one or many receivers, as fast as the hub carries.

use std::io::{ErrorKind, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use crate::driver::Topic;
use crate::listen::{Drain, Listener, Listening, Sink, join, panicked, scan_all};
use crate::window::Window;
use crate::{Error, Hub, Link, Message, Rate, Scanner, Template};

/// Written at once at most, if the window allows: the flush policy for all hubs.
const FLUSH: usize = 64 * 1024;

/// Parcels from one sender to all receivers.
#[derive(Clone, Copy, Debug)]
pub struct Stream {
    /// Bytes of each parcel's payload.
    pub payload: usize,
    /// What they are about.
    pub topic: Topic,
    /// How many hear them.
    pub receivers: usize,
    /// So many are on their way at most; none: as many as no hub has to drop.
    pub window: Option<u32>,
    /// Not measured at first.
    pub warm_up: Duration,
    /// Measured.
    pub time: Duration,
}

/// What a stream came to.
#[derive(Clone, Copy, Debug)]
pub struct Streamed {
    /// Deliveries: one for each receiver of a parcel, in the measured time.
    pub deliveries: Rate,
    /// Processor time of the hub in the measured time.
    pub cpu: Option<Duration>,
    /// Parcels sent in all; every receiver got them all in order.
    pub sent: u32,
}

impl Stream {
    /// Runs it through a hub.
    ///
    /// # Errors
    /// A parcel lost, doubled or out of order; a hub that refuses or stands still.
    pub fn run(&self, hub: &Hub) -> Result<Streamed, Error> {
        let template = hub.driver.template(Message {
            topic: self.topic,
            ..Message::forth(self.payload)
        })?;
        let receivers = connect_all(hub, self.topic, self.receivers)?;
        let sender = hub.driver.connect(&[], &[self.topic])?;
        let shared = Arc::new(Shared {
            window: match self.window {
                Some(size) => Window::of(size),
                None => Window::new(template.size(), self.receivers),
            },
            arrived: (0..self.receivers).map(|_| AtomicU32::new(0)).collect(),
            stop: AtomicBool::new(false),
        });
        let listening = Listening::start(self.listeners(hub, &shared, receivers))?;
        let sending = thread::spawn({
            let shared = Arc::clone(&shared);
            let stream = sender.stream.try_clone().map_err(Error::io("a second handle"))?;
            move || send(&shared, stream, &template)
        });
        let drain = match hub.driver.reflects() {
            true => Some(Drain::start(sender.second()?)?),
            false => None,
        };
        thread::sleep(self.warm_up);
        let (start, before, cpu) = (Instant::now(), shared.deliveries(), hub.cpu());
        thread::sleep(self.time);
        let (time, after, cpu_after) = (start.elapsed(), shared.deliveries(), hub.cpu());
        shared.stop.store(true, Ordering::Relaxed);
        let sent = join(sending)?;
        let drained = sent.and_then(|sent| shared.window.drained(sent).map(|()| sent));
        listening.end()?;
        // What a receiver found, or the hub told the sender, says more than that nothing moved.
        shared.window.result()?;
        match drain {
            Some(drain) => drain.end()?,
            None => hear(sender, &mut *hub.driver.scanner())?,
        }
        Ok(Streamed {
            deliveries: Rate {
                count: after - before,
                time,
            },
            cpu: cpu
                .zip(cpu_after)
                .map(|(before, after)| after.saturating_sub(before)),
            sent: drained?,
        })
    }

    fn listeners(&self, hub: &Hub, shared: &Arc<Shared>, receivers: Vec<Link>) -> Vec<Listener<InOrder>> {
        let listener = |(index, link)| Listener {
            link,
            scanner: hub.driver.scanner(),
            sink: InOrder {
                shared: Arc::clone(shared),
                index,
                expected: 0,
                before: 0,
            },
        };
        receivers.into_iter().enumerate().map(listener).collect()
    }
}

/// Connects so many that hear a topic, two at once: a hub that has much to do for one may do it on several cores.
///
/// # Errors
/// As [`Driver::connect`](crate::Driver::connect).
pub fn connect_all(hub: &Hub, topic: Topic, count: usize) -> Result<Vec<Link>, Error> {
    let one = |_| hub.driver.connect(&[topic], &[]);
    thread::scope(|scope| {
        let half = scope.spawn(|| (0..count / 2).map(one).collect::<Result<Vec<_>, _>>());
        let mut links: Vec<Link> = (count / 2..count).map(one).collect::<Result<_, _>>()?;
        links.extend(half.join().map_err(|_| panicked())??);
        Ok(links)
    })
}

/// A receiver that must get every number in order.
struct InOrder {
    shared: Arc<Shared>,
    index: usize,
    expected: u32,
    before: u32,
}

impl Sink for InOrder {
    fn parcel(&mut self, number: u32) -> Result<(), Error> {
        if number != self.expected {
            return Err(Error::Order {
                expected: self.expected,
                got: number,
            });
        }
        self.expected += 1;
        Ok(())
    }

    fn end(&mut self) {
        if self.expected != self.before {
            self.before = self.expected;
            self.shared.arrived[self.index].store(self.expected, Ordering::Relaxed);
            self.shared.window.advance(self.shared.slowest());
        }
    }

    fn failed(&mut self, error: Error) {
        self.shared.window.fail(error);
    }
}

struct Shared {
    window: Window,
    /// What each receiver has.
    arrived: Vec<AtomicU32>,
    stop: AtomicBool,
}

impl Shared {
    fn deliveries(&self) -> u64 {
        let counts = self.arrived.iter();
        counts.map(|count| u64::from(count.load(Ordering::Relaxed))).sum()
    }

    fn slowest(&self) -> u32 {
        let counts = self.arrived.iter();
        counts
            .map(|count| count.load(Ordering::Relaxed))
            .min()
            .unwrap_or_default()
    }
}

/// Sends until it is stopped, one window at least; gives how many.
fn send(shared: &Shared, mut stream: TcpStream, template: &Template) -> Result<u32, Error> {
    let batch = u32::try_from(FLUSH / template.size()).unwrap_or(1).max(1);
    let mut bytes = Vec::with_capacity(FLUSH + template.size());
    let mut sent = 0;
    while let Some(room) = shared.window.open(sent)? {
        let end = sent + room;
        while sent < end {
            let count = batch.min(end - sent);
            bytes.clear();
            template.append_all(sent..sent + count, &mut bytes);
            stream.write_all(&bytes).map_err(Error::io("send"))?;
            sent += count;
        }
        if shared.stop.load(Ordering::Relaxed) {
            break;
        }
    }
    Ok(sent)
}

/// The sender of a stream hears no parcels.
struct Silence;

impl Sink for Silence {
    fn parcel(&mut self, _number: u32) -> Result<(), Error> {
        Err(Error::Unexpected("its own parcels, at the sender".to_owned()))
    }

    fn failed(&mut self, _error: Error) {}
}

/// What the hub said to the sender: nothing, or there was trouble.
fn hear(mut sender: Link, scanner: &mut dyn Scanner) -> Result<(), Error> {
    sender
        .stream
        .set_nonblocking(true)
        .map_err(Error::io("socket options"))?;
    match sender.receive() {
        Err(Error::Io { error, .. }) if error.kind() == ErrorKind::WouldBlock => {}
        heard => drop(heard?),
    }
    scan_all(scanner, &sender.received, &mut Silence).map(drop)
}
