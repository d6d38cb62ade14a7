//! A base station and its robots, the programs' own, over TCP on loopback: each side on a thread of its own.

use std::collections::HashMap;
use std::fs;
use std::future::pending;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use fastrand::Rng;
use mom_base_station::circuit::{Note, Options, State};
use mom_base_station::fleet::{Fleet, Unit};
use mom_base_station::log::Entry;
use mom_base_station::station::{Settings, Station};
use mom_brs::file::EXTENDED;
use mom_brs::{Code, Command, Frame};
use mom_linuxbot::{Robot, Rules, serve};
use mom_wheels::{Chassis, Simulated};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::net::TcpListener;
use tokio::sync::broadcast::error::TryRecvError;
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::Times;
use super::air::PERIOD;
use crate::runtime;

/// For connections to be there.
const PATIENCE: Duration = Duration::from_secs(30);
/// What is still awaited after the last command.
const REST: Duration = Duration::from_millis(500);

/// What came of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Measured {
    pub(super) robots: u16,
    /// Commands that were due, and those without a reply 100 ms later.
    pub(super) due: u64,
    pub(super) missed: u64,
    /// Commands/s for each robot that had a reply.
    pub(super) rate: f64,
    /// ms from when a command was due until its reply.
    pub(super) took: Times,
    /// ms from writing its NULL until the reply.
    pub(super) trips: Times,
    /// ms of processor for each second and robot; none where the system does not tell.
    pub(super) base_cpu: Option<f64>,
    pub(super) robot_cpu: Option<f64>,
}

/// What robots' thread says.
struct Serving {
    addresses: Vec<std::net::SocketAddr>,
    stop: oneshot::Sender<()>,
    thread: thread::JoinHandle<Result<()>>,
    /// Its number, by which the system tells what it takes.
    id: String,
}

/// Commands so many robots ten times a second each, for a time.
pub(super) fn measure(robots: u16, time: Duration, seed: u64) -> Result<Measured> {
    raise_descriptors();
    let serving = start(robots)?;
    let measured = runtime()?.block_on(command(&serving, time, seed));
    // Robots that have ended are told by their thread.
    let _ = serving.stop.send(());
    match serving.thread.join() {
        Ok(ended) => ended?,
        Err(_) => bail!("the robots' thread broke down"),
    }
    measured
}

fn start(robots: u16) -> Result<Serving> {
    let (stop, stopped) = oneshot::channel();
    let (said, heard) = mpsc::channel();
    let thread = thread::spawn(move || {
        runtime()?.block_on(async move {
            let mut serving = JoinSet::new();
            let mut addresses = Vec::new();
            for wheels in Simulated::fleet(robots) {
                let listener = TcpListener::bind("127.0.0.1:0").await?;
                addresses.push(listener.local_addr()?);
                let robot = Robot::new(Box::new(wheels), Chassis::LINUXBOT, Rules::default());
                serving.spawn(serve(
                    listener,
                    robot,
                    mom_linuxbot::Options::default(),
                    pending(),
                ));
            }
            let id = fs::read_link("/proc/thread-self").unwrap_or_default();
            said.send((addresses, id.display().to_string()))?;
            // Dropping what serves ends it.
            let _ = stopped.await;
            Ok(())
        })
    });
    let (addresses, id) = heard.recv().context("the robots do not listen")?;
    Ok(Serving {
        addresses,
        stop,
        thread,
        id,
    })
}

async fn command(serving: &Serving, time: Duration, seed: u64) -> Result<Measured> {
    let lines = serving.addresses.iter().zip(1..);
    let text: String = lines
        .map(|(address, unit)| format!("[[robot]]\nunit = {unit}\naddress = \"{address}\"\n"))
        .collect();
    let fleet = Fleet::parse(&text)?;
    let circuit = Options {
        // Each command is followed by a NULL of its own.
        null_period: 3_600_000_000,
        ..Options::default()
    };
    let settings = Settings {
        circuit,
        seed,
        behind: 1 << 18,
        ..Settings::default()
    };
    let station = Station::new(&fleet, &EXTENDED, settings);
    station.connect_all();
    for unit in fleet.units() {
        let mut watch = station.watch(unit)?;
        let writable = watch.wait_for(|robot| robot.state == State::Writable);
        timeout(PATIENCE, writable)
            .await
            .context("a robot is not reached")??;
    }
    let own = fs::read_link("/proc/thread-self").unwrap_or_default();
    let own = own.display().to_string();
    let before = [cpu(&own), cpu(&serving.id)];
    let mut measured = drive(&station, fleet.units(), time, seed).await?;
    let after = [cpu(&own), cpu(&serving.id)];
    let each = |index: usize| {
        let used = after[index]?.checked_sub(before[index]?)?;
        Some(used.as_secs_f64() * 1000.0 / time.as_secs_f64() / f64::from(measured.robots))
    };
    (measured.base_cpu, measured.robot_cpu) = (each(0), each(1));
    station.halt().await;
    station.close().await;
    Ok(measured)
}

/// The commands of a run.
#[derive(Default)]
struct Tally {
    /// When those without a reply were due, by unit.
    open: HashMap<Unit, i64>,
    took: Vec<f64>,
    trips: Vec<f64>,
    in_time: u64,
}

impl Tally {
    fn hear(&mut self, entry: &Entry) {
        if let Note::Received(frame, Some(trip)) = entry.note
            && frame.code() == Code::NULL
            && let Some(due) = self.open.remove(&entry.unit)
        {
            self.took.push((entry.time - due) as f64 / 1000.0);
            self.trips.push(trip as f64 / 1000.0);
            self.in_time += u64::from(entry.time - due <= PERIOD);
        }
    }
}

async fn drive(station: &Station, units: Vec<Unit>, time: Duration, seed: u64) -> Result<Measured> {
    let mut random = Rng::with_seed(seed);
    let phases = units.iter().map(|unit| (random.i64(0..PERIOD), *unit));
    let mut phases: Vec<(i64, Unit)> = phases.collect();
    phases.sort_unstable();
    let periods = i64::try_from(time.as_micros())? / PERIOD;
    let motor = Frame::new(&Command::MOTOR, &[100, -100])?;
    let null = Frame::new(&Command::NULL, &[])?;
    let mut entries = station.subscribe();
    let mut tally = Tally::default();
    let begin = station.now() + PERIOD;
    let all = (0..periods).flat_map(|period| {
        let at = begin + period * PERIOD;
        phases.iter().map(move |(phase, unit)| (at + phase, *unit))
    });
    for (due, unit) in all {
        while station.now() < due {
            tokio::select! {
                () = station.sleep_until(due) => {}
                entry = entries.recv() => tally.hear(&entry?),
            }
        }
        loop {
            match entries.try_recv() {
                Ok(entry) => tally.hear(&entry),
                Err(TryRecvError::Empty) => break,
                Err(error) => bail!("{error}"),
            }
        }
        // As over the radio model: a robot that has not answered gets no other command.
        if tally.open.contains_key(&unit) {
            continue;
        }
        // A command that is refused is one that is missed.
        if station.send(unit, motor).is_ok() && station.send(unit, null).is_ok() {
            tally.open.insert(unit, due);
        }
        // The robots' connections have their turn, also where this is behind.
        tokio::task::yield_now().await;
    }
    let rest = timeout(REST, async {
        while !tally.open.is_empty() {
            match entries.recv().await {
                Ok(entry) => tally.hear(&entry),
                Err(_) => break,
            }
        }
    });
    // Who has not answered by then has missed its command.
    let _ = rest.await;
    let due = periods as u64 * units.len() as u64;
    Ok(Measured {
        robots: u16::try_from(units.len())?,
        due,
        missed: due - tally.in_time,
        rate: tally.took.len() as f64 / time.as_secs_f64() / units.len() as f64,
        took: Times::new(tally.took),
        trips: Times::new(tally.trips),
        base_cpu: None,
        robot_cpu: None,
    })
}

/// What a thread of this program has used of a processor; none where the system does not tell.
fn cpu(thread: &str) -> Option<Duration> {
    let text = fs::read_to_string(format!("/proc/{thread}/schedstat")).ok()?;
    Some(Duration::from_nanos(
        text.split_whitespace().next()?.parse().ok()?,
    ))
}

/// A thousand robots are three thousand sockets.
fn raise_descriptors() {
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    let current = maximum;
    // Where it stays low, the sockets that cannot be opened say so.
    let _ = setrlimit(Resource::Nofile, Rlimit { current, maximum });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_on_loopback_have_their_commands_confirmed() {
        let measured = measure(3, Duration::from_secs(1), 1).expect("loopback is there");
        assert_eq!((measured.robots, measured.due), (3, 30));
        assert!(measured.rate > 9.0 && measured.took.0.len() >= 27, "{measured:?}");
        assert!(measured.trips.at(0.5) <= measured.took.at(0.5), "{measured:?}");
        let cpu = measured.base_cpu.zip(measured.robot_cpu);
        assert!(
            cpu.is_none_or(|(base, robot)| base > 0.0 && robot > 0.0),
            "{cpu:?}"
        );
    }
}
