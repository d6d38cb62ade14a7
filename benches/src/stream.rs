//! One sender, one or many receivers, as fast as the hub carries.

use std::io::{ErrorKind, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use tokio::io::AsyncReadExt;
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::window::Window;
use crate::{Error, Hub, Link, Rate, Scan, Scanner, Template};

/// Written at once at most, if the window allows: the flush policy for all hubs.
const FLUSH: usize = 64 * 1024;
/// Room for what arrives at once; grows to the largest frame.
const ROOM: usize = 256 * 1024;

/// Parcels from one sender to all receivers.
#[derive(Clone, Copy, Debug)]
pub struct Stream {
    /// Bytes of each parcel's payload.
    pub payload: usize,
    /// How many hear them.
    pub receivers: usize,
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
        let template = hub.driver.template(self.payload)?;
        let sender = hub.driver.connect()?;
        let receivers = connect_all(hub, self.receivers)?;
        let shared = Arc::new(Shared {
            window: Window::new(template.size()),
            arrived: (0..self.receivers).map(|_| AtomicU32::new(0)).collect(),
            stop: AtomicBool::new(false),
        });
        let listening = Listening::start(self.listeners(hub, &shared, receivers))?;
        let sending = thread::spawn({
            let shared = Arc::clone(&shared);
            let stream = sender.stream.try_clone().map_err(Error::io("a second handle"))?;
            move || send(&shared, stream, &template)
        });
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
        hear(sender, &mut *hub.driver.scanner(self.payload))?;
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

    fn listeners(&self, hub: &Hub, shared: &Arc<Shared>, receivers: Vec<Link>) -> Vec<Listener> {
        let listener = |(index, link)| Listener {
            shared: Arc::clone(shared),
            index,
            scanner: hub.driver.scanner(self.payload),
            link,
        };
        receivers.into_iter().enumerate().map(listener).collect()
    }
}

/// Connects many at once: a broker that hashes passwords does so on several cores.
fn connect_all(hub: &Hub, count: usize) -> Result<Vec<Link>, Error> {
    let one = |_| hub.driver.connect();
    thread::scope(|scope| {
        let half = scope.spawn(|| (0..count / 2).map(one).collect::<Result<Vec<_>, _>>());
        let mut links: Vec<Link> = (count / 2..count).map(one).collect::<Result<_, _>>()?;
        links.extend(half.join().map_err(|_| panicked())??);
        Ok(links)
    })
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
            (sent..sent + count).for_each(|number| template.append(number, &mut bytes));
            stream.write_all(&bytes).map_err(Error::io("send"))?;
            sent += count;
        }
        if shared.stop.load(Ordering::Relaxed) {
            break;
        }
    }
    Ok(sent)
}

/// The thread in which all receivers are polled.
struct Listening {
    stop: watch::Sender<bool>,
    thread: JoinHandle<()>,
}

impl Listening {
    fn start(listeners: Vec<Listener>) -> Result<Listening, Error> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .build()
            .map_err(Error::io("a runtime"))?;
        let (stop, mut stopped) = watch::channel(false);
        let thread = thread::spawn(move || {
            runtime.block_on(async {
                let mut tasks = JoinSet::new();
                for listener in listeners {
                    tasks.spawn(listener.run());
                }
                // The receivers end with this, wherever they are: all is there, or something failed.
                let _ = stopped.changed().await;
            });
        });
        Ok(Listening { stop, thread })
    }

    fn end(self) -> Result<(), Error> {
        let _ = self.stop.send(true);
        join(self.thread)
    }
}

struct Listener {
    shared: Arc<Shared>,
    index: usize,
    scanner: Box<dyn Scanner>,
    link: Link,
}

impl Listener {
    async fn run(self) {
        let shared = Arc::clone(&self.shared);
        if let Err(error) = self.listen().await {
            shared.window.fail(error);
        }
    }

    async fn listen(mut self) -> Result<(), Error> {
        let Link { stream, received } = self.link;
        stream
            .set_nonblocking(true)
            .map_err(Error::io("socket options"))?;
        let mut stream = tokio::net::TcpStream::from_std(stream).map_err(Error::io("a socket"))?;
        let mut filled = received.len();
        let mut buffer = received;
        buffer.resize(ROOM.max(filled), 0);
        let mut expected = 0;
        loop {
            let before = expected;
            let used = scan_all(&mut *self.scanner, &buffer[..filled], &mut expected)?;
            if expected != before {
                self.shared.arrived[self.index].store(expected, Ordering::Relaxed);
                self.shared.window.advance(self.shared.slowest());
            }
            buffer.copy_within(used..filled, 0);
            filled -= used;
            if filled == buffer.len() {
                buffer.resize(2 * filled, 0);
            }
            let length = stream.read(&mut buffer[filled..]).await;
            match length.map_err(Error::io("receive"))? {
                0 => return Err(Error::Unexpected("the end of a connection".to_owned())),
                length => filled += length,
            }
        }
    }
}

/// Takes all whole frames; gives their length.
fn scan_all(scanner: &mut dyn Scanner, bytes: &[u8], expected: &mut u32) -> Result<usize, Error> {
    let mut used = 0;
    loop {
        match scanner.scan(&bytes[used..])? {
            Scan::Incomplete => return Ok(used),
            Scan::Other(length) => used += length,
            Scan::Parcel(length, got) if got == *expected => {
                used += length;
                *expected += 1;
            }
            Scan::Parcel(_, got) => {
                return Err(Error::Order {
                    expected: *expected,
                    got,
                });
            }
        }
    }
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
    match scan_all(scanner, &sender.received, &mut 0)? {
        all if all == sender.received.len() => Ok(()),
        _ => Err(Error::Unexpected("its own parcels, at the sender".to_owned())),
    }
}

fn join<T>(thread: JoinHandle<T>) -> Result<T, Error> {
    thread.join().map_err(|_| panicked())
}

fn panicked() -> Error {
    Error::Unexpected("a panic in a thread of the measurement".to_owned())
}
