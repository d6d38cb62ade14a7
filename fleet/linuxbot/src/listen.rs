//! The robot's server: listens, and lets one base station at a time drive (W9).

use std::future::{Future, pending};
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use mom_brs::file::EXTENDED;
use mom_brs::{Code, Frame, Table};
use mom_wheels::WheelTime;
use tokio::io::{AsyncReadExt, AsyncWriteExt, Interest};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, sleep_until, timeout};

use crate::hearing::Hearing;
use crate::refusals::Refusals;
use crate::{Access, Glance, Observed, Robot};

/// Bytes that are read at once; then others have their turn.
const PIECE: usize = 512;
/// The most pieces that are read before another base station is told that this one drives.
const AT_ONCE: usize = 16;
/// Bytes of replies that wait for a slow base station. While there are more, nothing is read from it.
const MOST_UNSENT: usize = 4096;
/// So long one that is refused may take to read why, and so many may do so at once.
const FAREWELL: Duration = Duration::from_secs(1);
const FAREWELLS: usize = 8;
/// So long a driver may take to take the last stop before the program ends all the same.
const LAST_STOP: Duration = Duration::from_secs(1);

/// How a robot lets base stations in.
#[derive(Debug, Clone)]
pub struct Options {
    /// Which base stations it takes.
    pub access: Access,
    /// The commands that it knows.
    pub table: &'static Table,
    /// A base station that says nothing for so long that is understood is held for dead, and others may drive; none:
    /// never, as the paper has it.
    pub patience: Option<Duration>,
    /// Whether a second base station is told who drives, rather than just closed.
    pub tells_holder: bool,
}

impl Default for Options {
    /// Base stations of the robot's own machine, all commands of ours, and three and a half of the NULLs that come every 10 s (W8).
    fn default() -> Self {
        Self {
            access: Access::default(),
            table: &EXTENDED,
            patience: Some(Duration::from_secs(35)),
            tells_holder: true,
        }
    }
}

impl Options {
    /// As the paper has it: a second base station is just closed, and the first stays however long it is silent.
    #[must_use]
    pub fn paper(access: Access) -> Self {
        Self {
            access,
            patience: None,
            tells_holder: false,
            ..Self::default()
        }
    }
}

/// Serves base stations until `shutdown` is done, one after the other. Then the motors stop, and it waits a second at most until
/// their driver has taken that.
///
/// A base station of which more cannot be read than can ([`mom_brs::MOST_ASTRAY`]) is closed, and the motors stop, also
/// as the paper has it: what it says may be a stop.
///
/// # Errors
///
/// The listener is broken.
pub async fn serve(
    listener: TcpListener,
    robot: Robot,
    options: Options,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    serve_observed(listener, robot, options, None, shutdown).await
}

/// The same, while a client may look at the robot.
///
/// # Errors
///
/// As [`serve`].
pub async fn serve_observed(
    listener: TcpListener,
    mut robot: Robot,
    options: Options,
    mut observed: Option<Observed>,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let begin = Instant::now();
    let mut shutdown = pin!(shutdown);
    let mut session: Option<Driving> = None;
    let farewells = Arc::new(Semaphore::new(FAREWELLS));
    let result = loop {
        let wake = robot.next_wake().map(|due| at(begin, due));
        let dead = session.as_ref().and_then(|session| session.dead(&options, begin));
        tokio::select! {
            () = &mut shutdown => break Ok(()),
            accepted = listener.accept() => match accepted {
                Ok((stream, from)) => {
                    // Who comes back at once has closed its old connection before.
                    if let Some(why) = catch_up(&mut session, &mut robot, begin) {
                        leave(&mut session, &mut robot, now(begin), &why);
                    }
                    admit(stream, from, &mut session, &options, &farewells, now(begin));
                }
                // What one connection has broken is not a fault of the listener.
                Err(error) if is_passing(&error) => tracing::debug!(%error, "a connection could not be accepted"),
                Err(error) => break Err(error),
            },
            ended = work(&mut session, &mut robot, begin) => {
                if let Some(why) = ended {
                    leave(&mut session, &mut robot, now(begin), &why);
                }
            }
            () = sleep_or_wait(wake) => robot.advance(now(begin)),
            () = sleep_or_wait(dead) => {
                leave(&mut session, &mut robot, now(begin), "nothing was heard of it");
            }
            observed = wanted(&mut observed) => {
                let station = session.as_ref().map(|session| session.from);
                observed.show(robot.glance(now(begin)).map(|glance| Glance { station, ..glance }));
            }
        }
        if let Some(error) = robot.fault() {
            tracing::warn!(%error, "the driver failed");
        }
    };
    robot.halt(now(begin));
    stand(&mut robot, begin).await;
    result
}

/// Waits until the driver has taken the stop, which is given again and again.
async fn stand(robot: &mut Robot, begin: Instant) {
    let until = Instant::now() + LAST_STOP;
    while !robot.stands() {
        let due = robot.next_wake().map(|due| at(begin, due));
        let Some(due) = due.filter(|due| *due <= until) else {
            tracing::error!(
                fault = robot.fault().map(tracing::field::display),
                "the motors may be running: the driver did not accept the stop"
            );
            return;
        };
        sleep_until(due).await;
        robot.advance(now(begin));
    }
}

/// Those of all robots of this program: base stations that are not listed, and those that come second.
static UNLISTED: Mutex<Refusals> = Mutex::new(Refusals::NONE);
static SECOND: Mutex<Refusals> = Mutex::new(Refusals::NONE);

/// Whether a refusal is worth a line, and how many before it were not.
fn folded(refusals: &Mutex<Refusals>) -> Option<u64> {
    let mut refusals = refusals.lock().unwrap_or_else(PoisonError::into_inner);
    refusals.count(Instant::now())
}

/// Takes a connection, if its base station may drive and no other does.
fn admit(
    stream: TcpStream,
    from: SocketAddr,
    session: &mut Option<Driving>,
    options: &Options,
    farewells: &Arc<Semaphore>,
    now: WheelTime,
) {
    if !options.access.admits(from.ip()) {
        if let Some(untold) = folded(&UNLISTED) {
            tracing::warn!(%from, untold, "refused: this base station is not listed");
        }
        return;
    }
    if let Some(held) = session {
        if let Some(untold) = folded(&SECOND) {
            tracing::info!(%from, by = %held.from, untold, "refused: another base station drives");
        }
        if options.tells_holder
            && let Some(frame) = holder(options.table, held.from.ip())
        {
            // A socket that has just been opened takes it; who does not read it is none the wiser.
            let _ = stream.try_write(frame.encode().as_bytes());
            if let Ok(place) = Arc::clone(farewells).try_acquire_owned() {
                tokio::spawn(part(stream, place));
            }
        }
        return;
    }
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "replies may be late");
    }
    tracing::info!(%from, "a base station drives");
    *session = Some(Driving {
        stream,
        from,
        hearing: Hearing::new(options.table, now),
        unsent: Vec::new(),
    });
}

/// Closes a connection so that its last word arrives: one that is closed with unread bytes is reset, and what was said is lost.
async fn part(mut stream: TcpStream, _place: OwnedSemaphorePermit) {
    let _ = timeout(FAREWELL, async {
        stream.shutdown().await?;
        let mut piece = [0; PIECE];
        while stream.read(&mut piece).await? > 0 {}
        io::Result::Ok(())
    })
    .await;
}

fn leave(session: &mut Option<Driving>, robot: &mut Robot, now: WheelTime, why: &str) {
    if let Some(gone) = session.take() {
        let faults = gone.hearing.faults();
        tracing::info!(from = %gone.from, why, ?faults, "the base station is gone");
        match gone.hearing.check() {
            Ok(()) => robot.lost(now),
            Err(_) => robot.halt(now),
        }
    }
}

/// Who drives, as far as an address of IPv4 says it.
fn holder(table: &'static Table, by: IpAddr) -> Option<Frame> {
    let address = match by.to_canonical() {
        IpAddr::V4(address) => address,
        IpAddr::V6(_) => Ipv4Addr::BROADCAST,
    };
    let bytes = address.octets().map(i32::from);
    Frame::reply(table.get(Code::HOLDER)?, &bytes).ok()
}

/// A base station that drives.
struct Driving {
    stream: TcpStream,
    from: SocketAddr,
    hearing: Hearing,
    unsent: Vec<u8>,
}

impl Driving {
    /// When it is to be held for dead.
    fn dead(&self, options: &Options, begin: Instant) -> Option<Instant> {
        let understood = at(begin, self.hearing.understood());
        options.patience.map(|patience| understood + patience)
    }
}

/// Reads and writes once; why the session ended, if it has. May be dropped at any time.
async fn work(session: &mut Option<Driving>, robot: &mut Robot, begin: Instant) -> Option<String> {
    let Some(session) = session else {
        return pending().await;
    };
    // Who does not take replies is not heard either, so that they stay bounded.
    let interest = match (session.unsent.is_empty(), session.unsent.len() < MOST_UNSENT) {
        (true, _) => Interest::READABLE,
        (false, true) => Interest::READABLE | Interest::WRITABLE,
        (false, false) => Interest::WRITABLE,
    };
    // While nothing is read its silence says nothing.
    let hears = session.unsent.len() < MOST_UNSENT;
    let silent = session.hearing.silent_at().filter(|_| hears);
    let ready = tokio::select! {
        ready = session.stream.ready(interest) => ready,
        () = sleep_or_wait(silent.map(|silent| at(begin, silent))) => {
            let passed = session.hearing.advance(now(begin));
            return passed.err().map(|garbled| garbled.to_string());
        }
    };
    if !hears {
        session.hearing.was_not_read(now(begin));
    }
    let done = ready.and_then(|ready| {
        if ready.is_writable() {
            write(session)?;
        }
        if ready.is_readable() && session.unsent.len() < MOST_UNSENT {
            read(session, robot, begin)?;
        }
        Ok(())
    });
    done.err().map(|error| error.to_string())
}

/// Reads what has come already, as long as its replies stay bounded; why the session ended, if it has.
fn catch_up(session: &mut Option<Driving>, robot: &mut Robot, begin: Instant) -> Option<String> {
    let session = session.as_mut()?;
    for _ in 0..AT_ONCE {
        if session.unsent.len() >= MOST_UNSENT {
            break;
        }
        let before = session.hearing.heard();
        if let Err(error) = read(session, robot, begin) {
            return Some(error.to_string());
        }
        if session.hearing.heard() == before {
            break;
        }
    }
    None
}

fn write(session: &mut Driving) -> io::Result<()> {
    match session.stream.try_write(&session.unsent) {
        Ok(written) => {
            session.unsent.drain(..written);
            Ok(())
        }
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
        Err(error) => Err(error),
    }
}

fn read(session: &mut Driving, robot: &mut Robot, begin: Instant) -> io::Result<()> {
    let mut piece = [0; PIECE];
    let read = match session.stream.try_read(&mut piece) {
        Ok(0) => return Err(io::Error::other("it closed the connection")),
        Ok(read) => read,
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
        Err(error) => return Err(error),
    };
    let piece = piece.get(..read).unwrap_or_default();
    let heard = session
        .hearing
        .hear(piece, robot, now(begin), &mut session.unsent);
    heard.map_err(io::Error::other)?;
    if session.unsent.is_empty() {
        return Ok(());
    }
    // At once: waiting for the socket to say that it can be written costs a round.
    write(session)
}

/// What a connection may break before it is accepted.
fn is_passing(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionReset, Interrupted};
    matches!(error.kind(), ConnectionAborted | ConnectionReset | Interrupted)
}

fn now(begin: Instant) -> WheelTime {
    WheelTime::try_from(begin.elapsed().as_micros()).unwrap_or(WheelTime::MAX)
}

fn at(begin: Instant, due: WheelTime) -> Instant {
    begin + Duration::from_micros(u64::try_from(due).unwrap_or(0))
}

/// Waits until a client looks.
async fn wanted(observed: &mut Option<Observed>) -> &mut Observed {
    match observed {
        Some(observed) => {
            observed.wanted().await;
            observed
        }
        None => pending().await,
    }
}

async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => pending().await,
    }
}

#[cfg(test)]
mod tests {
    use mom_wheels::{Chassis, Simulated};

    use super::*;
    use crate::Rules;

    /// Each connection of another client has the robot catch up.
    #[tokio::test]
    async fn replies_that_nobody_reads_stay_bounded_however_many_others_connect() {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("it has one");
        let station = TcpStream::connect(address).await.expect("it listens");
        let (stream, from) = listener.accept().await.expect("it has come");
        let mut session = Some(Driving {
            stream,
            from,
            hearing: Hearing::new(&EXTENDED, 0),
            unsent: Vec::new(),
        });
        let mut robot = Robot::new(
            Box::new(Simulated::linuxbot()),
            Chassis::LINUXBOT,
            Rules::default(),
        );
        let begin = Instant::now();
        let poses = "12".repeat(PIECE * AT_ONCE / 2);
        // Until the sockets between them are full, and then as often again.
        let mut rounds = 0;
        while rounds < 20 {
            let full = session
                .as_ref()
                .is_some_and(|session| session.unsent.len() >= MOST_UNSENT);
            rounds += usize::from(full);
            match station.try_write(poses.as_bytes()) {
                Err(error) if error.kind() != io::ErrorKind::WouldBlock => panic!("{error}"),
                _ => {}
            }
            let ready = session
                .as_ref()
                .map(|session| session.stream.ready(Interest::READABLE));
            ready.expect("it drives").await.expect("it stands");
            assert_eq!(catch_up(&mut session, &mut robot, begin), None);
            let unsent = session.as_ref().map_or(0, |session| session.unsent.len());
            // The last piece that is read may have so many replies of 20 bytes.
            assert!(unsent < MOST_UNSENT + (PIECE / 2 + 1) * 20, "{unsent} bytes");
        }
    }
}
