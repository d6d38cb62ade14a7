//! The robot on its socket.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use mom_rsp::robot::Settings;
use mom_rsp::{Dropped, Header, Type};
use parking_lot::Mutex;
use tokio::net::UdpSocket;
use tokio::time::{Instant, sleep_until, timeout};

use crate::model::LAYOUT;
use crate::model::robot::{Dispatch, PACKET};
use crate::{Cubo, End, Glance, Touch};

/// A datagram is at most so long.
const LONGEST: usize = 65_536;
/// Datagrams that are read before something is sent again.
const AT_ONCE: usize = 64;
/// So often the body is asked what it senses while there is no session.
const IDLE: Duration = Duration::from_millis(500);
/// So long it waits for the middle's word that it has heard of the session's end.
const FAREWELL: Duration = Duration::from_millis(300);

/// A robot that can be touched and looked at from outside while it is served. Clones are of the same robot.
#[derive(Clone)]
pub struct CuboHandle(Arc<Mutex<Whole>>);

struct Whole {
    body: Cubo,
    end: End,
    begin: Instant,
    /// From where the newest authentic packet came: packets go there.
    middle: Option<SocketAddr>,
    /// From where the newest hello came that is refused: the refusal goes there.
    asker: Option<SocketAddr>,
}

impl CuboHandle {
    /// A robot with this body, whose end has these settings.
    ///
    /// # Errors
    ///
    /// Settings that are out of their range.
    pub fn new(body: Cubo, settings: Settings) -> Result<Self, mom_rsp::robot::RobotFault> {
        Ok(Self(Arc::new(Mutex::new(Whole {
            body,
            end: End::new(&LAYOUT, settings)?,
            begin: Instant::now(),
            middle: None,
            asker: None,
        }))))
    }

    /// A person touches it.
    pub fn touch(&self, touch: Touch) {
        self.0.lock().body.touch(touch);
    }

    /// What its body looks like now, also while nothing is done with it.
    #[must_use]
    pub fn glance(&self) -> Glance {
        let whole = &mut *self.0.lock();
        let now = whole.now();
        whole.body.advance(i64::try_from(now).unwrap_or(i64::MAX));
        whole.body.glance()
    }

    /// Whether it has a session.
    #[must_use]
    pub fn is_up(&self) -> bool {
        self.0.lock().end.is_up()
    }

    /// Looks at its body and its end.
    pub fn look<T>(&self, what: impl FnOnce(&mut Cubo, &End) -> T) -> T {
        let whole = &mut *self.0.lock();
        what(&mut whole.body, &whole.end)
    }
}

impl Whole {
    fn now(&self) -> u64 {
        u64::try_from(self.begin.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    fn receive(&mut self, datagram: &mut [u8], from: SocketAddr) {
        if from.port() == 0 {
            // Nobody can be answered there.
            return;
        }
        let now = self.now();
        // What its body did by itself meanwhile comes before what it is told now.
        self.body.advance(i64::try_from(now).unwrap_or(i64::MAX));
        match self.end.receive(now, datagram, &mut Dispatch(&mut self.body)) {
            Ok(()) => {
                self.middle = Some(from);
                let until = self.end.deadline().and_then(|until| i64::try_from(until).ok());
                self.body.hold(until.unwrap_or(i64::MAX));
            }
            Err(why @ (Dropped::Busy | Dropped::Model | Dropped::Version)) => {
                tracing::debug!(%from, %why, "a hello was refused");
                self.asker = Some(from);
            }
            // Who has not the key is not answered (S13).
            Err(why) => tracing::debug!(%from, %why, "a datagram was dropped"),
        }
    }

    /// What is to be sent next.
    fn next(&mut self, into: &mut [u8]) -> Option<usize> {
        let now = self.now();
        self.body.advance(i64::try_from(now).unwrap_or(i64::MAX));
        self.body.tell(&mut self.end);
        self.end.poll(now, into, &mut Dispatch(&mut self.body))
    }

    /// Where a datagram of the robot goes.
    fn receiver(&mut self, datagram: &[u8]) -> Option<SocketAddr> {
        let is_refusal = Header::decode(datagram).is_ok_and(|header| header.kind == Type::Refusal);
        match is_refusal {
            true => self.asker.take(),
            false => self.middle,
        }
    }
}

/// Serves a robot on this socket, until `shutdown` is done. Then its session is ended.
///
/// # Errors
///
/// A socket that fails for good. The robot rests then, too.
pub async fn serve(
    socket: UdpSocket,
    robot: CuboHandle,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let served = tokio::select! {
        failed = exchange(&socket, &robot, |_| false) => failed,
        () = shutdown => Ok(()),
    };
    {
        let whole = &mut *robot.0.lock();
        let now = whole.now();
        whole.end.end(now, &mut Dispatch(&mut whole.body));
    }
    if served.is_ok() {
        // An end without a session has nothing to do any more.
        let over = exchange(&socket, &robot, |end| end.wake().is_none());
        let _ = timeout(FAREWELL, over).await;
    }
    served
}

/// Sends and receives until the robot's end is in a state in which it is over.
async fn exchange(socket: &UdpSocket, robot: &CuboHandle, over: impl Fn(&End) -> bool) -> io::Result<()> {
    let mut buffer = vec![0; LONGEST];
    let mut out = vec![0; PACKET];
    let mut was_up = robot.0.lock().end.is_up();
    loop {
        let wake = {
            let whole = &mut *robot.0.lock();
            while let Some(length) = whole.next(&mut out) {
                let datagram = out.get(..length).unwrap_or_default();
                if let Some(to) = whole.receiver(datagram) {
                    send(socket, datagram, to);
                }
            }
            if was_up != whole.end.is_up() {
                was_up = !was_up;
                match was_up {
                    true => tracing::info!("a session began"),
                    false => tracing::info!("the session is over, and the robot rests"),
                }
            }
            if over(&whole.end) {
                return Ok(());
            }
            let wake = whole
                .end
                .wake()
                .map(|wake| whole.begin + Duration::from_micros(wake));
            wake.unwrap_or_else(|| Instant::now() + IDLE)
        };
        tokio::select! {
            ready = socket.readable() => ready?,
            () = sleep_until(wake) => {}
        }
        for _ in 0..AT_ONCE {
            match socket.try_recv_from(&mut buffer) {
                Ok((length, from)) => {
                    if let Some(datagram) = buffer.get_mut(..length) {
                        robot.0.lock().receive(datagram, from);
                    }
                }
                Err(error) if is_passing(&error) => break,
                Err(error) => return Err(error),
            }
        }
    }
}

/// What is not taken is lost, as in the network: an address that cannot be reached ends nothing.
fn send(socket: &UdpSocket, datagram: &[u8], to: SocketAddr) {
    if let Err(error) = socket.try_send_to(datagram, to)
        && error.kind() != io::ErrorKind::WouldBlock
    {
        tracing::debug!(%to, %error, "a datagram was not sent");
    }
}

/// What a socket says of a moment, such as that nobody listens there.
fn is_passing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock
            | io::ErrorKind::ConnectionRefused
            | io::ErrorKind::HostUnreachable
            | io::ErrorKind::NetworkUnreachable
            | io::ErrorKind::NetworkDown
            | io::ErrorKind::PermissionDenied
            | io::ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use mom_rsp::middle::{Middle, Settings as Ends};
    use mom_wheels::Pose;

    use super::*;

    #[tokio::test]
    async fn who_cannot_be_answered_is_not_heard() {
        let body = Cubo::new(Pose::new(2500.0, 2500.0, 0.0)).unwrap();
        let robot = CuboHandle::new(body, Settings::default()).unwrap();
        let mut middle = Middle::new(&LAYOUT, Ends::default(), |bytes: &mut [u8]| bytes.fill(3)).unwrap();
        middle.start(0);
        let mut hello = middle.poll(0).unwrap().to_vec();
        let whole = &mut *robot.0.lock();
        whole.receive(&mut hello.clone(), "127.0.0.1:0".parse().unwrap());
        assert_eq!(whole.middle, None);
        let from = "127.0.0.1:7700".parse().unwrap();
        whole.receive(&mut hello, from);
        assert_eq!(whole.middle, Some(from));
    }
}
