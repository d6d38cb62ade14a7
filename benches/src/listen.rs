//! Receivers: all of a measurement's are polled by one thread, in the same way for every hub.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

use tokio::io::AsyncReadExt;
use tokio::sync::watch;
use tokio::task::JoinSet;

use crate::{Error, Link, Scan, Scanner};

/// Room for what arrives at once, over all receivers; grows to the largest frame.
const ROOM: usize = 4 * 1024 * 1024;
const MOST: usize = 256 * 1024;
const LEAST: usize = 16 * 1024;

/// Takes what one receiver finds.
pub trait Sink: Send + 'static {
    /// Something has been read and is about to be looked through.
    fn begin(&mut self) {}

    /// A parcel of this number is there.
    ///
    /// # Errors
    /// A number that should not come now.
    fn parcel(&mut self, number: u32) -> Result<(), Error>;

    /// The hub says that it dropped so many.
    ///
    /// # Errors
    /// Where nothing may be dropped.
    fn dropped(&mut self, count: u64) -> Result<(), Error> {
        Err(Error::Unexpected(format!("dropped: {count}")))
    }

    /// No further frame is in the read buffer.
    fn end(&mut self) {}

    /// This receiver is at its end.
    fn failed(&mut self, error: Error);
}

/// One receiver.
pub struct Listener<S> {
    /// Where it hears.
    pub link: Link,
    /// Finds parcels in what it hears.
    pub scanner: Box<dyn Scanner>,
    /// Takes them.
    pub sink: S,
}

/// The thread in which all receivers are polled.
pub struct Listening {
    stop: watch::Sender<bool>,
    thread: JoinHandle<()>,
}

impl Listening {
    /// Starts it.
    ///
    /// # Errors
    /// A runtime that cannot be had.
    pub fn start<S: Sink>(listeners: Vec<Listener<S>>) -> Result<Listening, Error> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .build()
            .map_err(Error::io("a runtime"))?;
        let (stop, mut stopped) = watch::channel(false);
        let room = (ROOM / listeners.len().max(1)).clamp(LEAST, MOST);
        let thread = thread::spawn(move || {
            runtime.block_on(async {
                let mut tasks = JoinSet::new();
                for listener in listeners {
                    tasks.spawn(listener.run(room));
                }
                // The receivers end with this, wherever they are: all is there, or something failed.
                let _ = stopped.changed().await;
            });
        });
        Ok(Listening { stop, thread })
    }

    /// Ends it, wherever the receivers are.
    ///
    /// # Errors
    /// A panic in it.
    pub fn end(self) -> Result<(), Error> {
        let _ = self.stop.send(true);
        join(self.thread)
    }
}

impl<S: Sink> Listener<S> {
    async fn run(mut self, room: usize) {
        if let Err(error) = self.listen(room).await {
            self.sink.failed(error);
        }
    }

    async fn listen(&mut self, room: usize) -> Result<(), Error> {
        let stream = self
            .link
            .stream
            .try_clone()
            .map_err(Error::io("a second handle"))?;
        stream
            .set_nonblocking(true)
            .map_err(Error::io("socket options"))?;
        let mut stream = tokio::net::TcpStream::from_std(stream).map_err(Error::io("a socket"))?;
        let mut buffer = std::mem::take(&mut self.link.received);
        let mut filled = buffer.len();
        buffer.resize(room.max(filled), 0);
        loop {
            self.sink.begin();
            let used = scan_all(&mut *self.scanner, &buffer[..filled], &mut self.sink)?;
            self.sink.end();
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
pub(crate) fn scan_all<S: Sink>(
    scanner: &mut dyn Scanner,
    bytes: &[u8],
    sink: &mut S,
) -> Result<usize, Error> {
    let mut used = 0;
    loop {
        match scanner.scan(&bytes[used..])? {
            Scan::Incomplete => return Ok(used),
            Scan::Other(length) => used += length,
            Scan::Parcel(length, number) => {
                used += length;
                sink.parcel(number)?;
            }
            Scan::Dropped(length, count) => {
                used += length;
                sink.dropped(count)?;
            }
        }
    }
}

/// Reads a link and throws away what it says, for a hub that tells a sender what it said itself.
pub(crate) struct Drain {
    link: Link,
    thread: JoinHandle<()>,
    done: std::sync::Arc<AtomicBool>,
}

impl Drain {
    pub(crate) fn start(link: Link) -> Result<Drain, Error> {
        let mut other = link.second()?;
        let done = std::sync::Arc::new(AtomicBool::new(false));
        let thread = thread::spawn({
            let done = std::sync::Arc::clone(&done);
            move || {
                // Its end is the shutdown below; a hub that closes it fails the sender too.
                while !done.load(Ordering::Relaxed) && other.receive().is_ok() {
                    other.received.clear();
                }
            }
        });
        Ok(Drain { link, thread, done })
    }

    pub(crate) fn end(self) -> Result<(), Error> {
        self.done.store(true, Ordering::Relaxed);
        let _ = self.link.stream.shutdown(std::net::Shutdown::Both);
        join(self.thread)
    }
}

/// Waits for the end of a thread of the measurement; gives what it came to.
///
/// # Errors
/// A panic in it.
pub fn join<T>(thread: JoinHandle<T>) -> Result<T, Error> {
    thread.join().map_err(|_| panicked())
}

pub(crate) fn panicked() -> Error {
    Error::Unexpected("a panic in a thread of the measurement".to_owned())
}
