//! The robot on its socket.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use mom_rsp::Dropped;
use mom_rsp::robot::Settings;
use parking_lot::Mutex;
use tokio::net::UdpSocket;
use tokio::time::{Instant, sleep_until};

use crate::model::LAYOUT;
use crate::model::robot::{Dispatch, PACKET};
use crate::{Cubo, End, Touch};

/// A datagram is at most so long.
const LONGEST: usize = 65_536;
/// Datagrams that are read before something is sent again.
const AT_ONCE: usize = 64;
/// So often the body is asked what it senses while there is no session.
const IDLE: Duration = Duration::from_millis(500);

/// A robot that can be touched and looked at from outside while it is served. Clones are of the same robot.
#[derive(Clone)]
pub struct CuboHandle(Arc<Mutex<Whole>>);

struct Whole {
    body: Cubo,
    end: End,
    begin: Instant,
    /// From where the newest authentic packet came: packets go there.
    middle: Option<SocketAddr>,
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
        }))))
    }

    /// Somebody touches it.
    pub fn touch(&self, touch: Touch) {
        self.0.lock().body.touch(touch);
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
        let now = self.now();
        match self.end.receive(now, datagram, &mut Dispatch(&mut self.body)) {
            Ok(()) => self.middle = Some(from),
            Err(Dropped::Busy) => tracing::debug!(%from, "a hello was refused: there is a session"),
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
}

/// Serves a robot on this socket, until `shutdown` is done. Then its session is ended.
///
/// # Errors
///
/// A socket that fails for good.
pub async fn serve(
    socket: UdpSocket,
    robot: CuboHandle,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let mut shutdown = std::pin::pin!(shutdown);
    let mut buffer = vec![0; LONGEST];
    let mut out = vec![0; PACKET];
    let mut was_up = false;
    loop {
        let wake = {
            let whole = &mut *robot.0.lock();
            while let Some(length) = whole.next(&mut out) {
                if let (Some(to), Some(datagram)) = (whole.middle, out.get(..length)) {
                    send(&socket, datagram, to)?;
                }
            }
            if was_up != whole.end.is_up() {
                was_up = !was_up;
                match was_up {
                    true => tracing::info!("a session began"),
                    false => tracing::info!("the session is over, and the robot rests"),
                }
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
            () = &mut shutdown => break,
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
    let whole = &mut *robot.0.lock();
    let now = whole.now();
    whole.end.end(now, &mut Dispatch(&mut whole.body));
    while let Some(length) = whole.next(&mut out) {
        if let (Some(to), Some(datagram)) = (whole.middle, out.get(..length)) {
            send(&socket, datagram, to)?;
        }
    }
    Ok(())
}

/// What the system has no room for is lost, as in the network.
fn send(socket: &UdpSocket, datagram: &[u8], to: SocketAddr) -> io::Result<()> {
    match socket.try_send_to(datagram, to) {
        Err(error) if !is_passing(&error) => Err(error),
        _ => Ok(()),
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
