//! One robot: its circuit, and the task that carries out what the circuit asks for.

use std::future::{Future, pending};
use std::io;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use mom_brs::Frame;
use parking_lot::Mutex;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, Interest};
use tokio::net::TcpStream;
use tokio::sync::{Notify, broadcast, watch};
use tokio::time::{sleep_until, timeout};

use super::{Shared, Snapshot};
use crate::circuit::{Circuit, End, Input, Output, Refusal, State, Taken};
use crate::fleet::{Robot, Unit};
use crate::log::Entry;

/// The most that is read at once: enough for a busy robot, and little enough to leave the others their turn.
const CHUNK: usize = 512;

/// How many entries of one robot a subscriber may be behind before it misses some: more than one turn's, in which all that
/// waits is written.
const BEHIND: usize = 256;

/// How long a robot may take to see that it is left, before the connection is dropped.
const FAREWELL: Duration = Duration::from_millis(300);

/// The most that is read of a robot that is left.
const FAREWELL_BYTES: u64 = 65_536;

/// A robot as the station and its task share it.
#[derive(Debug)]
pub(super) struct Seat {
    robot: Arc<Robot>,
    circuit: Mutex<Circuit>,
    /// Wakes the task when the circuit has something to do.
    wake: Notify,
    /// Wakes who waits for the task to have done something.
    done: Notify,
    snapshot: watch::Sender<Snapshot>,
    /// Whether the robot is taken out, and whether its task has ended.
    leaving: AtomicBool,
    ended: AtomicBool,
    /// What happens with this robot.
    changes: broadcast::Sender<Entry>,
}

impl Seat {
    pub(super) fn new(robot: Robot, circuit: Circuit) -> Seat {
        let robot = Arc::new(robot);
        let (snapshot, _) = watch::channel(snapshot(&robot, &circuit));
        let (changes, _) = broadcast::channel(BEHIND);
        Seat {
            robot,
            circuit: Mutex::new(circuit),
            wake: Notify::new(),
            done: Notify::new(),
            snapshot,
            leaving: AtomicBool::new(false),
            ended: AtomicBool::new(false),
            changes,
        }
    }

    /// Parts from the robot, and ends its task.
    pub(super) fn leave(&self, shared: &Shared) {
        // Before: a task that wakes by itself and sees `leaving` ends.
        self.take(shared, Input::Disconnect);
        self.leaving.store(true, Ordering::Release);
        self.wake();
    }

    /// Waits until its task has ended.
    pub(super) async fn left(&self) {
        self.until(|| self.ended.load(Ordering::Acquire).then_some(()))
            .await;
    }

    pub(super) fn subscribe(&self) -> broadcast::Receiver<Entry> {
        self.changes.subscribe()
    }

    pub(super) fn unit(&self) -> Unit {
        self.robot.unit
    }

    pub(super) fn take(&self, shared: &Shared, input: Input<'_>) {
        self.circuit.lock().take(shared.clock.now(), input);
        self.wake.notify_one();
    }

    /// Has the task look at what is to be done.
    pub(super) fn wake(&self) {
        self.wake.notify_one();
    }

    pub(super) fn send(&self, frame: Frame) -> Result<Taken, Refusal> {
        let taken = self.circuit.lock().send(frame)?;
        self.wake.notify_one();
        Ok(taken)
    }

    /// Stops the motors, if the robot may move or soon would; whether that is so. A stop that it may not have read is said again.
    pub(super) fn halt(&self) -> bool {
        let mut circuit = self.circuit.lock();
        let moving = circuit.may_move() || circuit.waiting() > 0;
        if moving {
            // Without a connection it is said on the next one, which is tried at once.
            let _ = circuit.halt();
            self.wake.notify_one();
        }
        moving
    }

    /// Waits until the robot has read its stop; false if it never will.
    pub(super) async fn halted(&self) -> bool {
        self.until(|| {
            let circuit = self.circuit.lock();
            match circuit.state() {
                State::Writable if circuit.waiting() == 0 && circuit.is_in_motion() => Some(false),
                State::Writable if circuit.is_stop_heard() => Some(true),
                State::Writable | State::Connected | State::Trying => None,
                State::Disconnected => Some(false),
            }
        })
        .await
    }

    /// Sends as soon as there is a place for it.
    pub(super) async fn send_in_turn(&self, frame: Frame) -> Result<Taken, Refusal> {
        self.until(|| match self.send(frame) {
            Err(Refusal::Full | Refusal::Unanswered) => None,
            sent => Some(sent),
        })
        .await
    }

    /// Asks again whenever the task has done something, until there is an answer.
    async fn until<T>(&self, mut answer: impl FnMut() -> Option<T>) -> T {
        loop {
            // It has to be waiting before it asks, or it would miss what is done in between.
            let mut done = pin!(self.done.notified());
            done.as_mut().enable();
            if let Some(answer) = answer() {
                return answer;
            }
            done.await;
        }
    }

    pub(super) fn watch(&self) -> watch::Receiver<Snapshot> {
        self.snapshot.subscribe()
    }

    pub(super) fn snapshot(&self) -> Snapshot {
        snapshot(&self.robot, &self.circuit.lock())
    }
}

fn snapshot(robot: &Arc<Robot>, circuit: &Circuit) -> Snapshot {
    Snapshot {
        robot: Arc::clone(robot),
        state: circuit.state(),
        round_trip: circuit.round_trip(),
        status: circuit.status(),
        waiting: circuit.waiting(),
        faults: circuit.faults(),
        in_motion: circuit.is_in_motion(),
        last_end: circuit.last_end().cloned(),
    }
}

type Attempt = Pin<Box<dyn Future<Output = io::Result<TcpStream>> + Send>>;

/// What the task has of the network.
enum Socket {
    None,
    Attempt(Attempt),
    Open {
        stream: TcpStream,
        /// What is not written yet.
        unwritten: Vec<u8>,
        /// Whether some of it was not tried yet.
        is_new: bool,
    },
}

/// What has happened to a socket.
enum Happened {
    Woken,
    Connected(TcpStream),
    Ended(End),
    Ready { read: bool, write: bool },
}

/// Drives one robot until the station closes.
pub(super) async fn drive(shared: Arc<Shared>, seat: Arc<Seat>) {
    let mut socket = Socket::None;
    loop {
        while let Some(output) = next_output(&shared, &seat) {
            carry_out(&shared, &seat, &mut socket, output).await;
        }
        // What has come together goes together: a robot that reads it at once answers it at once.
        if socket.has_new() {
            match socket.write() {
                // A robot that takes no more is told nothing more until it does.
                Ok(true) => {}
                Ok(false) => {
                    seat.circuit.lock().take(shared.clock.now(), Input::Blocked);
                    continue;
                }
                Err(error) => {
                    broken(&shared, &seat, &mut socket, &error);
                    continue;
                }
            }
        }
        if shared.closing.load(Ordering::Acquire) || seat.leaving.load(Ordering::Acquire) {
            seat.ended.store(true, Ordering::Release);
            seat.done.notify_waiters();
            return;
        }
        let (wake, may_read) = {
            let mut circuit = seat.circuit.lock();
            let may_read = circuit.may_read(shared.clock.now());
            let new = snapshot(&seat.robot, &circuit);
            seat.snapshot.send_if_modified(|old| {
                let modified = *old != new;
                *old = new;
                modified
            });
            (circuit.next_wake(), may_read)
        };
        seat.done.notify_waiters();
        let wake = async {
            match wake.and_then(|wake| shared.clock.instant(wake)) {
                Some(wake) => sleep_until(wake).await,
                None => pending().await,
            }
        };
        let happened = tokio::select! {
            () = seat.wake.notified() => Happened::Woken,
            () = wake => Happened::Woken,
            happened = socket.happens(may_read > 0) => happened,
        };
        match happened {
            Happened::Woken => seat.circuit.lock().take(shared.clock.now(), Input::Time),
            Happened::Connected(stream) => {
                socket = Socket::Open {
                    stream,
                    unwritten: Vec::new(),
                    is_new: false,
                };
                seat.circuit.lock().take(shared.clock.now(), Input::Connected);
            }
            Happened::Ended(end) => {
                socket = Socket::None;
                seat.circuit.lock().take(shared.clock.now(), Input::Ended(end));
            }
            Happened::Ready { read, write } => {
                ready(&shared, &seat, &mut socket, read.then_some(may_read), write);
            }
        }
    }
}

fn next_output(shared: &Shared, seat: &Seat) -> Option<Output> {
    seat.circuit.lock().poll(shared.clock.now())
}

async fn carry_out(shared: &Shared, seat: &Seat, socket: &mut Socket, output: Output) {
    match output {
        Output::Connect => *socket = Socket::Attempt(attempt(&seat.robot)),
        Output::Close => {
            // What was said to be sent may be what stops the robot. More than one try would be late.
            let _ = socket.write();
            if let Socket::Open { stream, .. } = std::mem::replace(socket, Socket::None) {
                farewell(stream).await;
            }
        }
        Output::Abort => {
            if let Socket::Open { stream, .. } = std::mem::replace(socket, Socket::None) {
                // Without it the system would go on to deliver what was written, however late.
                let _ = stream.set_zero_linger();
            }
        }
        Output::Write(bytes) => {
            if let Socket::Open {
                unwritten, is_new, ..
            } = socket
            {
                unwritten.extend_from_slice(bytes.as_bytes());
                *is_new = true;
            }
        }
        Output::Note(note) => {
            let entry = Entry {
                time: shared.clock.now(),
                unit: seat.unit(),
                note,
            };
            shared.log.lock().push(entry.clone());
            // Nobody has to look on.
            let _ = seat.changes.send(entry.clone());
            let _ = shared.changes.send(entry);
        }
    }
}

fn attempt(robot: &Arc<Robot>) -> Attempt {
    let robot = Arc::clone(robot);
    Box::pin(async move {
        let address = &robot.address;
        let stream = TcpStream::connect((address.host(), address.port())).await?;
        // Each frame is small and wants to be there now.
        stream.set_nodelay(true)?;
        Ok(stream)
    })
}

/// Says that no more comes, and reads until the robot has seen it: to drop a connection while bytes of the robot are
/// unread may take back what was written last, which may be what stops it.
async fn farewell(mut stream: TcpStream) {
    let _ = stream.shutdown().await;
    let (mut rest, mut nowhere) = (stream.take(FAREWELL_BYTES), tokio::io::sink());
    let _ = timeout(FAREWELL, tokio::io::copy(&mut rest, &mut nowhere)).await;
}

/// Reads and writes as much as is possible without waiting.
fn ready(shared: &Shared, seat: &Seat, socket: &mut Socket, may_read: Option<usize>, write: bool) {
    if write {
        match socket.write() {
            Ok(true) => seat.circuit.lock().take(shared.clock.now(), Input::Unblocked),
            Ok(false) => {}
            Err(error) => return broken(shared, seat, socket, &error),
        }
    }
    let (Some(may_read), Socket::Open { stream, .. }) = (may_read, &socket) else {
        return;
    };
    let mut buffer = [0; CHUNK];
    let chunk = buffer.get_mut(..may_read.min(CHUNK)).unwrap_or_default();
    match stream.try_read(chunk) {
        Ok(0) => {
            *socket = Socket::None;
            seat.circuit
                .lock()
                .take(shared.clock.now(), Input::Ended(End::Closed));
        }
        Ok(length) => {
            let bytes = chunk.get(..length).unwrap_or_default();
            seat.circuit.lock().take(shared.clock.now(), Input::Bytes(bytes));
        }
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
        Err(error) => broken(shared, seat, socket, &error),
    }
}

fn broken(shared: &Shared, seat: &Seat, socket: &mut Socket, error: &io::Error) {
    *socket = Socket::None;
    let end = End::Broken(error.to_string().into());
    seat.circuit.lock().take(shared.clock.now(), Input::Ended(end));
}

impl Socket {
    async fn happens(&mut self, may_read: bool) -> Happened {
        match self {
            Socket::None => pending().await,
            Socket::Attempt(attempt) => match attempt.await {
                Ok(stream) => Happened::Connected(stream),
                Err(error) => Happened::Ended(End::Unreachable(error.to_string().into())),
            },
            Socket::Open {
                stream, unwritten, ..
            } => {
                let interest = match (may_read, unwritten.is_empty()) {
                    (true, true) => Interest::READABLE,
                    (true, false) => Interest::READABLE | Interest::WRITABLE,
                    (false, false) => Interest::WRITABLE,
                    (false, true) => return pending().await,
                };
                match stream.ready(interest).await {
                    Ok(ready) => Happened::Ready {
                        read: may_read && ready.is_readable(),
                        write: !unwritten.is_empty() && ready.is_writable(),
                    },
                    Err(error) => Happened::Ended(End::Broken(error.to_string().into())),
                }
            }
        }
    }

    /// Whether there is something that was not tried to be written.
    fn has_new(&self) -> bool {
        matches!(self, Socket::Open { is_new: true, .. })
    }

    /// Writes what is unwritten; whether nothing is left.
    fn write(&mut self) -> io::Result<bool> {
        let Socket::Open {
            stream,
            unwritten,
            is_new,
        } = self
        else {
            return Ok(true);
        };
        *is_new = false;
        while !unwritten.is_empty() {
            match stream.try_write(unwritten) {
                Ok(length) => drop(unwritten.drain(..length)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(false),
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use mom_brs::{Command, PAPER};
    use tokio::net::TcpListener;

    use super::*;
    use crate::circuit::Options;
    use crate::fleet::Fleet;
    use crate::station::{Clock, Settings, Station};

    /// Longer than anything takes, however busy the machine is.
    const PATIENCE: Duration = Duration::from_secs(30);

    async fn listen() -> (TcpListener, u16) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        (listener, port)
    }

    fn robot(unit: Unit, port: u16) -> Robot {
        let text = format!("[[robot]]\nunit = {unit}\naddress = \"127.0.0.1:{port}\"\n");
        Fleet::parse(&text).unwrap().robots()[0].clone()
    }

    fn seat(robot: Robot) -> Seat {
        Seat::new(robot, Circuit::new(&PAPER, Options::default(), 1))
    }

    /// A task that ends before its circuit was told to part from its robot drops what it has to say.
    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn no_task_ends_while_the_station_still_parts_from_other_robots() {
        let (one, three) = (listen().await, listen().await);
        let fleet = format!(
            "[[robot]]\nunit = 1\naddress = \"127.0.0.1:{}\"\n[[robot]]\nunit = 3\naddress = \"127.0.0.1:{}\"\n",
            one.1, three.1
        );
        let mut station = Station::new(&Fleet::parse(&fleet).unwrap(), &PAPER, Settings::default());
        // To close gets no further than to this one, whose circuit is taken. It has no task that would wait for it.
        let second = Arc::new(seat(robot(2, one.1)));
        let inner = Arc::get_mut(&mut station.inner).unwrap();
        inner.seats.get_mut().insert(2, Arc::clone(&second));
        station.connect(1).unwrap();
        station.connect(3).unwrap();
        let (mut first, _) = one.0.accept().await.unwrap();
        let (mut third, _) = three.0.accept().await.unwrap();
        first.read_exact(&mut [0; 2]).await.unwrap();
        third.read_exact(&mut [0; 2]).await.unwrap();
        let (taken, is_taken) = tokio::sync::oneshot::channel();
        let (release, released) = std::sync::mpsc::channel::<()>();
        let holder = std::thread::spawn(move || {
            let _circuit = second.circuit.lock();
            let _ = taken.send(());
            let _ = released.recv();
        });
        is_taken.await.unwrap();
        let mut seen = station.watch(3).unwrap();
        // On a thread of its own: the tasks that it wakes would wait for the thread of a task.
        let runtime = tokio::runtime::Handle::current();
        let closing = std::thread::spawn(move || runtime.block_on(station.close()));
        let parted = timeout(PATIENCE, first.read_to_end(&mut Vec::new())).await;
        // The third robot wakes its task by what it says, and that goes on.
        third.write_all(b"00").await.unwrap();
        let is_heard = timeout(PATIENCE, seen.wait_for(|seen| seen.state == State::Writable));
        let is_heard = is_heard.await.is_ok_and(|heard| heard.is_ok());
        drop(release);
        holder.join().unwrap();
        closing.join().unwrap();
        parted.expect("the first is parted from").unwrap();
        assert!(is_heard, "the task of the third robot has ended");
    }

    /// A connection is closed in the same turn in which its last frames were taken, as by a thread that halts all.
    #[tokio::test]
    async fn what_was_taken_before_the_close_arrives() {
        let (listener, port) = listen().await;
        let seat = seat(robot(1, port));
        let (changes, _) = broadcast::channel(1);
        let shared = Shared {
            clock: Clock::start(),
            changes,
            log: Mutex::new(Settings::default().log),
            closing: false.into(),
        };
        let mut socket = Socket::Open {
            stream: TcpStream::connect(("127.0.0.1", port)).await.unwrap(),
            unwritten: Vec::new(),
            is_new: false,
        };
        let (mut robot, _) = listener.accept().await.unwrap();
        let frames =
            [[100, -100], [0, 0]].map(|speeds| Frame::new(&Command::MOTOR, &speeds).unwrap().encode());
        let written = frames.iter().flat_map(|frame| frame.as_bytes().to_vec());
        let written: Vec<u8> = written.collect();
        for frame in frames {
            carry_out(&shared, &seat, &mut socket, Output::Write(frame)).await;
        }
        let mut heard = Vec::new();
        let reading = robot.read_to_end(&mut heard);
        let (_, read) = tokio::join!(carry_out(&shared, &seat, &mut socket, Output::Close), reading);
        read.unwrap();
        assert_eq!(heard, written);
    }
}
