//! Goes through a door, as far as it gets, and measures what it is like behind it.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::time::{Duration, Instant};

use mom_client::{Address, ClockOffset, Fingerprint, Probe, Trust};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpStream, lookup_host};
use tokio::time::{timeout, timeout_at};

use super::blocked::Blocked;
use super::doors::DoorTried;

/// The sizes of pings, in bytes of padding: M60's range, closer together where packets become two.
const SIZES: [usize; 13] = [1, 3, 10, 30, 100, 300, 500, 1000, 1500, 2000, 3000, 5000, 10_000];

/// The most bytes of a foreign answer that are looked at.
const ANSWER: usize = 2048;

/// How much is measured, and how long anything may take.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Effort {
    /// For each step on the way in.
    pub(crate) patience: Duration,
    /// How often a door is gone through to measure that.
    pub(crate) entries: usize,
    /// Pings of each size, as far as the time suffices.
    pub(crate) rounds: usize,
    /// For all pings of a door: less than a hub gives to those who do not log in.
    pub(crate) time: Duration,
}

impl Effort {
    /// As the paper: 50 packets of one size.
    pub(crate) const FULL: Effort = Effort {
        patience: Duration::from_secs(5),
        entries: 5,
        rounds: 50,
        time: Duration::from_secs(6),
    };
    /// A first impression.
    pub(crate) const QUICK: Effort = Effort {
        patience: Duration::from_secs(2),
        entries: 1,
        rounds: 5,
        time: Duration::from_secs(1),
    };
}

/// What the way in took, step by step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry {
    /// Where the host is, or the proxy before it.
    pub(crate) at: IpAddr,
    /// Looking its name up.
    pub(crate) name: Duration,
    /// A connection of TCP.
    pub(crate) tcp: Duration,
    /// A connection on which one can speak: the same with TLS, if the door has it.
    pub(crate) open: Duration,
    /// From the first words of this side to those of the hub.
    pub(crate) answer: Duration,
}

/// Round trips of one size.
#[derive(Clone, Debug)]
pub(crate) struct Trips {
    /// Bytes of padding in each ping; the pong is short.
    pub(crate) size: usize,
    /// Sorted.
    pub(crate) times: Vec<Duration>,
}

/// What it is like behind a door.
#[derive(Clone, Debug, Default)]
pub(crate) struct Measured {
    /// All ways in.
    pub(crate) entries: Vec<Entry>,
    /// By size.
    pub(crate) trips: Vec<Trips>,
    /// The hub's clock against this machine's.
    pub(crate) clock: Option<ClockOffset>,
}

/// Goes through a door and says one word to the hub.
pub(crate) async fn enter(door: &DoorTried, address: &Address, effort: Effort) -> Result<Entry, Blocked> {
    let within = effort.patience;
    let proxy = address.proxy().map_err(|error| Blocked::of(&error))?;
    // Behind a proxy nothing else may be reached, and names may be known to it alone.
    let reached = match &proxy {
        Some(proxy) => reach(lookup_host(proxy), within)
            .await
            .map_err(|blocked| Blocked::Proxy(format!("the proxy {proxy}: {}", blocked.text())))?,
        None => reach(lookup_host((address.host.as_str(), address.port)), within).await?,
    };
    let Reached { at, name, tcp } = reached;
    let straight = proxy.is_none().then_some(at);
    let start = Instant::now();
    let probe = timeout(within, Probe::connect(address, None)).await;
    let probe = probe.map_err(|_| Blocked::TimedOut("the handshake"))?;
    let mut probe = match probe {
        Ok(probe) => probe,
        Err(error) => return Err(diagnose(door, address, straight, Blocked::of(&error), effort).await),
    };
    let open = start.elapsed();
    let answer = timeout(within, probe.ping(0)).await;
    match answer.map_err(|_| Blocked::TimedOut("the hub's first answer"))? {
        Ok(answer) => Ok(Entry {
            at: at.ip(),
            name,
            tcp,
            open,
            answer,
        }),
        Err(error) => Err(diagnose(door, address, straight, Blocked::of(&error), effort).await),
    }
}

/// The nearer end of a way in.
struct Reached {
    at: SocketAddr,
    /// What looking it up took.
    name: Duration,
    /// What connecting took.
    tcp: Duration,
}

/// Looks a host up and connects to it.
async fn reach<A>(lookup: impl Future<Output = io::Result<A>>, within: Duration) -> Result<Reached, Blocked>
where
    A: Iterator<Item = SocketAddr>,
{
    let start = Instant::now();
    let found = timeout(within, lookup).await;
    let found = found.map_err(|_| Blocked::TimedOut("looking the name up"))?;
    let found: Vec<SocketAddr> = found
        .map_err(|error| Blocked::UnknownName(error.to_string()))?
        .collect();
    let name = start.elapsed();
    let (at, tcp) = timeout(within, connect(&found))
        .await
        .map_err(|_| Blocked::TimedOut("the connection"))??;
    Ok(Reached { at, name, tcp })
}

/// The first of these that takes a connection, and how long that took.
async fn connect(found: &[SocketAddr]) -> Result<(SocketAddr, Duration), Blocked> {
    let mut blocked = Blocked::UnknownName("the name has no address".to_owned());
    for at in found {
        let start = Instant::now();
        match TcpStream::connect(at).await {
            Ok(_) => return Ok((*at, start.elapsed())),
            Err(error) => blocked = Blocked::of_io(&error),
        }
    }
    Err(blocked)
}

/// Finds out more of what is in the way, where something answers there and no proxy is between.
async fn diagnose(
    door: &DoorTried,
    address: &Address,
    straight: Option<SocketAddr>,
    blocked: Blocked,
    effort: Effort,
) -> Blocked {
    match (blocked, straight) {
        (Blocked::Untrusted(why, None), _) if address.pin.is_none() => {
            let shown = timeout(effort.patience, shown_certificate(address)).await;
            Blocked::Untrusted(why, shown.ok().flatten())
        }
        (blocked @ (Blocked::Tls(_) | Blocked::NoHub(_) | Blocked::Closed | Blocked::Reset), Some(at)) => {
            let said = listen(at, door.hello, effort.patience).await;
            Blocked::of_answer(&said).unwrap_or(blocked)
        }
        (other, _) => other,
    }
}

/// The fingerprint of the certificate that a hub shows.
async fn shown_certificate(address: &Address) -> Option<String> {
    // No certificate has this one, so the refusal names the one that was shown.
    let none: Fingerprint = "0".repeat(64).parse().ok()?;
    let refused = Probe::connect(address, Some(Trust::Pinned(none))).await.err()?;
    let text = refused.to_string();
    let at = text.find(FINGERPRINT)?;
    let shown = text.get(at..at + FINGERPRINT.len() + 64)?;
    shown.parse::<Fingerprint>().ok().map(|shown| shown.to_string())
}

/// How a fingerprint begins.
const FINGERPRINT: &str = "sha256:";

/// What is said there to these first bytes, as far as it comes at once.
async fn listen(at: SocketAddr, hello: &[u8], patience: Duration) -> Vec<u8> {
    let mut said = Vec::new();
    let until = tokio::time::Instant::now() + patience;
    let Ok(Ok(mut stream)) = timeout_at(until, TcpStream::connect(at)).await else {
        return said;
    };
    // It may be closed already, and have said why.
    let _ = stream.write_all(hello).await;
    let mut bytes = [0; ANSWER];
    while said.len() < ANSWER {
        match timeout_at(until, stream.read(&mut bytes)).await {
            Ok(Ok(count @ 1..)) => said.extend_from_slice(&bytes[..count]),
            _ => break,
        }
        // A banner is over with its line, and a head with an empty one.
        if !said.starts_with(b"HTTP/") && !said.starts_with(b"Content-") && said.contains(&b'\n') {
            break;
        }
    }
    said
}

/// Measures a door that is open, alone. What ends early gives what there is until then.
pub(crate) async fn measure(door: &DoorTried, address: &Address, effort: Effort) -> Measured {
    let mut measured = Measured::default();
    for _ in 0..effort.entries {
        if let Ok(entry) = enter(door, address, effort).await {
            measured.entries.push(entry);
        }
    }
    let Ok(Ok(mut probe)) = timeout(effort.patience, Probe::connect(address, None)).await else {
        return measured;
    };
    let mut trips = SIZES.map(|size| Trips {
        size,
        times: Vec::new(),
    });
    // One size after the other in each round, so that a disturbance befalls all sizes.
    let pings = async {
        for _ in 0..effort.rounds {
            for trips in &mut trips {
                match probe.ping(trips.size).await {
                    Ok(took) => trips.times.push(took),
                    Err(_) => return,
                }
            }
        }
    };
    // Over time is not over: what was measured counts.
    let _ = timeout(effort.time, pings).await;
    for trips in &mut trips {
        trips.times.sort_unstable();
    }
    measured.trips = trips
        .into_iter()
        .filter(|trips| !trips.times.is_empty())
        .collect();
    measured.clock = probe.offset();
    measured
}

impl Measured {
    /// The middle one of a step of all ways in.
    pub(crate) fn step(&self, step: impl Fn(&Entry) -> Duration) -> Option<Duration> {
        let mut steps: Vec<Duration> = self.entries.iter().map(step).collect();
        steps.sort_unstable();
        steps.get(steps.len() / 2).copied()
    }

    /// The round trips of the size next to this one.
    pub(crate) fn near(&self, size: usize) -> Option<&Trips> {
        self.trips.iter().min_by_key(|trips| trips.size.abs_diff(size))
    }
}

impl Trips {
    /// As the paper: the mean.
    pub(crate) fn mean(&self) -> Duration {
        let count = u32::try_from(self.times.len()).unwrap_or(u32::MAX);
        self.times
            .iter()
            .sum::<Duration>()
            .checked_div(count)
            .unwrap_or_default()
    }

    /// That which half of them do not exceed.
    pub(crate) fn median(&self) -> Duration {
        self.times.get(self.times.len() / 2).copied().unwrap_or_default()
    }
}
