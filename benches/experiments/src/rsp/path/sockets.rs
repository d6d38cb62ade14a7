//! Drives in real time over the kernel's own TCP: two network namespaces with a packet relay between them, for each robot its own.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpListener as Listener, TcpStream as Stream, UdpSocket as Datagrams};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, anyhow};
use mom_cubo::model::LAYOUT;
use mom_rsp::robot;
use mom_tests::network::{Namespaces, Network, RelayedLink};
use tokio::net::{TcpStream, UdpSocket};
use tokio::time::{Instant, sleep_until};

use super::super::world::{Scene, cubo, middle};
use super::follower::{Drove, Follower};
use super::{Arm, BASE, LANES, Link, Row, Track, Transport};
use crate::runtime;

/// The longest datagram, and what is read at once.
const LONGEST: usize = 4096;
const READ: usize = 65_536;
/// A drive that has not begun by then never does.
const PATIENCE: Duration = Duration::from_secs(240);

/// One drive that is to be made, and where it belongs.
struct Job {
    track: usize,
    row: usize,
    arm: Arm,
    link: Link,
    seed: u64,
}

/// Makes the drives in real time, several at once, and adds them to the tables: those over TCP over all links, all else over the
/// base alone.
///
/// # Errors
/// How many could not be made, and why the first of them; the others are added.
pub(super) fn drive_all(
    tracks: &[Track],
    tables: &mut [Vec<Row>],
    arms: &[Arm],
    seeds: Range<u64>,
) -> Result<()> {
    let mut jobs = VecDeque::new();
    for seed in seeds {
        for (track, rows) in tables.iter().enumerate() {
            for (row, of) in rows.iter().enumerate() {
                let is_made = |arm: &&Arm| of.link == BASE || arm.transport != Transport::Udp;
                jobs.extend(arms.iter().filter(is_made).map(|arm| Job {
                    track,
                    row,
                    arm: *arm,
                    link: of.link,
                    seed,
                }));
            }
        }
    }
    let (jobs, made) = (Mutex::new(jobs), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..LANES {
            scope.spawn(|| {
                loop {
                    let job = jobs.lock().unwrap_or_else(PoisonError::into_inner).pop_front();
                    let Some(job) = job else { return };
                    let drove = tracks
                        .get(job.track)
                        .context("no such path")
                        .and_then(|track| drive(job.arm, track, job.link, job.seed));
                    made.lock()
                        .unwrap_or_else(PoisonError::into_inner)
                        .push((job, drove));
                }
            });
        }
    });
    let mut made = made.into_inner().unwrap_or_else(PoisonError::into_inner);
    let place = |arm: Arm| arms.iter().position(|of| *of == arm);
    made.sort_by_key(|(job, _)| (place(job.arm), job.seed));
    let (all, mut failed) = (made.len(), Vec::new());
    for (job, drove) in made {
        let row = tables.get_mut(job.track).and_then(|rows| rows.get_mut(job.row));
        match (drove, row) {
            (Ok(drove), Some(row)) => row.add(job.arm, drove),
            (Ok(_), None) => {}
            (Err(error), _) => failed.push(error.context(format!("{} over {:?}", job.arm.name, job.link))),
        }
    }
    let count = failed.len();
    match failed.into_iter().next() {
        None => Ok(()),
        Some(first) => Err(first.context(format!(
            "{count} of {all} drives in real time could not be made; the first"
        ))),
    }
}

/// One drive; the namespaces are gone when it ends.
fn drive(arm: Arm, track: &Track, link: Link, seed: u64) -> Result<Drove> {
    let relayed = RelayedLink::new(link.shape(), link.shape(), seed, "cubic")
        .context("no network namespaces here: only root may make them")?;
    let follower = Follower::new(track, arm.filter, arm.fixed, seed)?;
    let runtime = runtime()?;
    let _inside = runtime.enter();
    let [hub, far] = match arm.transport {
        Transport::Udp => datagrams(&relayed)?,
        Transport::Tcp(nagle) => streams(&relayed, nagle)?,
    };
    runtime.block_on(run(arm, follower, hub, far, seed))
}

fn datagrams(link: &RelayedLink) -> Result<[Pipe; 2]> {
    let bind = |network: &Network| network.within(|| Datagrams::bind((network.host(), 0))).flatten();
    let [hub, far] = [bind(&link.ends.hub)?, bind(&link.ends.far)?];
    let (at_hub, at_far) = (hub.local_addr()?, far.local_addr()?);
    let pipe = |socket: Datagrams, to: SocketAddr| -> Result<Pipe> {
        socket.set_nonblocking(true)?;
        Ok(Pipe::Udp(UdpSocket::from_std(socket)?, to))
    };
    Ok([pipe(hub, at_far)?, pipe(far, at_hub)?])
}

fn streams(link: &RelayedLink, nagle: bool) -> Result<[Pipe; 2]> {
    let Namespaces { hub, far } = &link.ends;
    let listener = far.within(|| Listener::bind((far.host(), 0))).flatten()?;
    let to = listener.local_addr()?;
    // The first packets may be lost.
    let at_hub = hub
        .within(|| Stream::connect_timeout(&to, Duration::from_secs(60)))
        .flatten()?;
    let (at_far, _) = listener.accept()?;
    let pipe = |stream: Stream| -> Result<Pipe> {
        stream.set_nodelay(!nagle)?;
        stream.set_nonblocking(true)?;
        Ok(Pipe::Tcp {
            stream: TcpStream::from_std(stream)?,
            heard: Vec::new(),
            waiting: Vec::new(),
        })
    };
    Ok([pipe(at_hub)?, pipe(at_far)?])
}

/// One end's socket. Over TCP a datagram goes behind its length, and what the kernel does not take yet waits.
enum Pipe {
    Udp(UdpSocket, SocketAddr),
    Tcp {
        stream: TcpStream,
        heard: Vec<u8>,
        waiting: Vec<u8>,
    },
}

impl Pipe {
    async fn readable(&self) -> io::Result<()> {
        match self {
            Pipe::Udp(socket, _) => socket.readable().await,
            Pipe::Tcp { stream, waiting, .. } if waiting.is_empty() => stream.readable().await,
            Pipe::Tcp { stream, .. } => {
                let both = tokio::io::Interest::READABLE | tokio::io::Interest::WRITABLE;
                stream.ready(both).await.map(|_| ())
            }
        }
    }

    fn send(&mut self, datagram: &[u8]) -> io::Result<()> {
        match self {
            Pipe::Udp(socket, to) => match socket.try_send_to(datagram, *to) {
                // What the system has no room for is lost, as in the network.
                Err(error) if error.kind() != ErrorKind::WouldBlock => Err(error),
                _ => Ok(()),
            },
            Pipe::Tcp { waiting, .. } => {
                waiting.extend_from_slice(&(datagram.len() as u16).to_be_bytes());
                waiting.extend_from_slice(datagram);
                self.flush()
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        let Pipe::Tcp { stream, waiting, .. } = self else {
            return Ok(());
        };
        while !waiting.is_empty() {
            match stream.try_write(waiting) {
                Ok(length) => drop(waiting.drain(..length)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// The datagrams that have arrived.
    fn receive(&mut self) -> io::Result<Vec<Vec<u8>>> {
        let mut all = Vec::new();
        let mut buffer = [0; READ];
        loop {
            let read = match self {
                Pipe::Udp(socket, _) => socket.try_recv(&mut buffer),
                Pipe::Tcp { stream, .. } => stream.try_read(&mut buffer),
            };
            let read = match read {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(length) => buffer.get(..length).unwrap_or_default(),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            };
            match self {
                Pipe::Udp(..) => all.push(read.to_vec()),
                Pipe::Tcp { heard, .. } => heard.extend_from_slice(read),
            }
        }
        if let Pipe::Tcp { heard, .. } = self {
            while let Some(([high, low], rest)) = heard.split_first_chunk() {
                let length = usize::from(u16::from_be_bytes([*high, *low]));
                let Some(datagram) = rest.get(..length) else { break };
                all.push(datagram.to_vec());
                heard.drain(..2 + length);
            }
        }
        Ok(all)
    }
}

/// Both ends in one loop, as in virtual time, until the drive is over.
async fn run(arm: Arm, mut scene: Follower, mut hub: Pipe, mut far: Pipe, seed: u64) -> Result<Drove> {
    let begin = Instant::now();
    let mut middle = middle(&LAYOUT, arm.ends(), seed)?;
    let mut end = cubo(robot::Settings::default())?;
    let mut out = vec![0; LONGEST];
    let now = || begin.elapsed().as_micros() as u64;
    middle.start(now());
    while !scene.is_over() && begin.elapsed() < PATIENCE {
        for mut datagram in far.receive()? {
            scene.reaches_robot(now(), &datagram);
            // What it drops it counts.
            let _ = end.receive(now(), &mut datagram, &mut scene);
        }
        for mut datagram in hub.receive()? {
            let _ = middle.receive(now(), &mut datagram);
        }
        scene.at_middle(now(), &mut middle);
        while let Some(datagram) = middle.poll(now()) {
            hub.send(datagram)?;
        }
        scene.at_robot(now(), &mut end);
        while let Some(length) = end.poll(now(), &mut out, &mut scene) {
            far.send(
                out.get(..length)
                    .ok_or_else(|| anyhow!("a packet is longer than its buffer"))?,
            )?;
        }
        hub.flush()?;
        far.flush()?;
        let wake = [middle.wake(), end.wake(), scene.wake()]
            .into_iter()
            .flatten()
            .min();
        let wake = begin + Duration::from_micros(wake.unwrap_or_default());
        tokio::select! {
            ready = hub.readable() => ready?,
            ready = far.readable() => ready?,
            () = sleep_until(wake) => {}
        }
    }
    Ok(scene.drove())
}
