//! A network of datagrams between two ends that loses, doubles, delays and is cut, as it is told.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::net::UdpSocket;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until};

/// What the network does to each datagram.
#[derive(Clone, Copy, Debug, Default)]
pub struct Weather {
    /// Nothing passes.
    pub cut: bool,
    /// The share that is lost.
    pub loss: f64,
    /// The share that arrives twice.
    pub doubled: f64,
    /// How long each takes at least.
    pub delay: Duration,
    /// How much longer at most, so that they overtake each other.
    pub jitter: Duration,
}

/// A network before a server. Its end ends it.
#[derive(Debug)]
pub struct Datagrams {
    address: SocketAddr,
    weather: Arc<Mutex<Weather>>,
    task: JoinHandle<io::Result<()>>,
}

impl Datagrams {
    /// One that hands what is sent to its own address on to `server`, and the answers back.
    ///
    /// # Errors
    ///
    /// No socket.
    ///
    /// # Panics
    ///
    /// Outside a runtime.
    pub fn before(server: SocketAddr, seed: u64) -> io::Result<Self> {
        let any = || std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0));
        let far = any()?;
        far.connect(server)?;
        Self::between(any()?, far, seed)
    }

    /// One that hands on what `near` receives to where `far` is connected to, and the answers back; either may be in a network of its own.
    ///
    /// # Errors
    ///
    /// Sockets that cannot be used.
    ///
    /// # Panics
    ///
    /// Outside a runtime.
    pub fn between(near: std::net::UdpSocket, far: std::net::UdpSocket, seed: u64) -> io::Result<Self> {
        near.set_nonblocking(true)?;
        far.set_nonblocking(true)?;
        let (near, far) = (UdpSocket::from_std(near)?, UdpSocket::from_std(far)?);
        let address = near.local_addr()?;
        let weather = Arc::new(Mutex::new(Weather::default()));
        let task = tokio::spawn(carry(near, far, Arc::clone(&weather), seed));
        Ok(Self {
            address,
            weather,
            task,
        })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What it does from now on.
    pub fn set(&self, weather: Weather) {
        *self.weather.lock().unwrap_or_else(PoisonError::into_inner) = weather;
    }
}

impl Drop for Datagrams {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A datagram under way: when it arrives, its number among all, whether it goes to the server, and its bytes.
type UnderWay = Reverse<(Instant, u64, bool, Vec<u8>)>;

async fn carry(near: UdpSocket, far: UdpSocket, weather: Arc<Mutex<Weather>>, seed: u64) -> io::Result<()> {
    let mut chance = fastrand::Rng::with_seed(seed);
    let mut under_way: BinaryHeap<UnderWay> = BinaryHeap::new();
    let mut client = None;
    let mut number = 0;
    let (mut one, mut other) = (vec![0; 65_536], vec![0; 65_536]);
    loop {
        let due = under_way.peek().map(|Reverse((due, ..))| *due);
        let (out, bytes) = tokio::select! {
            () = sleep_until(due.unwrap_or_else(Instant::now)), if due.is_some() => { // tidy: the network takes its time
                if let Some(Reverse((_, _, out, bytes))) = under_way.pop() {
                    // Who is not there does not get it.
                    let _ = match (out, client) {
                        (true, _) => far.send(&bytes).await,
                        (false, Some(client)) => near.send_to(&bytes, client).await,
                        (false, None) => Ok(0),
                    };
                }
                continue;
            }
            received = near.recv_from(&mut one) => match received {
                Ok((length, from)) => {
                    client = Some(from);
                    (true, one.get(..length).unwrap_or_default().to_vec())
                }
                Err(_) => continue,
            },
            received = far.recv(&mut other) => match received {
                Ok(length) => (false, other.get(..length).unwrap_or_default().to_vec()),
                Err(_) => continue,
            },
        };
        let now = *weather.lock().unwrap_or_else(PoisonError::into_inner);
        if now.cut || chance.f64() < now.loss {
            continue;
        }
        let times = if chance.f64() < now.doubled { 2 } else { 1 };
        for _ in 0..times {
            number += 1;
            let due = Instant::now() + now.delay + now.jitter.mul_f64(chance.f64());
            under_way.push(Reverse((due, number, out, bytes.clone())));
        }
    }
}
