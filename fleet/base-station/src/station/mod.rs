//! The circuits of a fleet on real connections: a task for each robot, which sleeps until something happens.

mod clock;
mod robot;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use mom_brs::{Frame, Table};
use parking_lot::{Mutex, RwLock};
use tokio::sync::{broadcast, watch};
use tokio::task::JoinSet;
use tokio::time::timeout;

use self::clock::Clock;
use self::robot::Seat;
use crate::circuit::{Circuit, End, Faults, Input, Options, Refusal, State, Taken};
use crate::fleet::{Fleet, Robot, Unit};
use crate::log::{Entry, Log};

/// How long robots may take to be stopped, connections to be closed, and commands to find a place.
const PATIENCE: Duration = Duration::from_secs(1);

/// How a station behaves.
#[derive(Debug)]
pub struct Settings {
    /// How each circuit behaves.
    pub circuit: Options,
    /// What the pauses between attempts are drawn from.
    pub seed: u64,
    /// How many entries a subscriber may be behind before it misses some.
    pub behind: usize,
    /// Where all entries go.
    pub log: Log,
}

/// The circuits' own; any seed; 4096 entries behind; the latest 1000 entries remembered, and no file.
impl Default for Settings {
    fn default() -> Settings {
        Settings {
            circuit: Options::default(),
            seed: fastrand::u64(..),
            behind: 4096,
            log: Log::new(1000),
        }
    }
}

/// Why a command is not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SendError {
    /// The fleet has no such unit.
    #[error("there is no unit {0} in the fleet")]
    NoUnit(Unit),
    /// The circuit does not take it.
    #[error("unit {unit}: {refusal}")]
    Refused {
        /// The robot.
        unit: Unit,
        /// Why.
        refusal: Refusal,
    },
}

/// What is known of one robot.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Snapshot {
    /// Its entry in the fleet.
    pub robot: Arc<Robot>,
    /// The state of its connection (W11).
    pub state: State,
    /// The last round trip of a NULL on this connection, in µs (W8).
    pub round_trip: Option<i64>,
    /// The bits of the last STATUS reply on this connection.
    pub status: Option<i32>,
    /// How many commands wait.
    pub waiting: usize,
    /// What was wrong with what it said.
    pub faults: Faults,
    /// Whether the base station has set it in motion.
    pub in_motion: bool,
    /// Why the last attempt failed or the last connection ended.
    pub last_end: Option<End>,
}

/// The base station: all connections of a fleet. It is cheap to clone; the last one dropped ends the connections.
#[derive(Clone, Debug)]
pub struct Station {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    shared: Arc<Shared>,
    /// The commands that robots know, how circuits behave, and what their pauses are drawn from: for robots that come later.
    table: &'static Table,
    circuit: Options,
    seed: u64,
    seats: RwLock<BTreeMap<Unit, Arc<Seat>>>,
    /// Dropping them ends them.
    tasks: Mutex<JoinSet<()>>,
}

/// What all robots' tasks use.
#[derive(Debug)]
struct Shared {
    clock: Clock,
    changes: broadcast::Sender<Entry>,
    log: Mutex<Log>,
    closing: AtomicBool,
}

impl Station {
    /// A station for the robots of a fleet, none of them connected (W14). It has to be made within a tokio runtime.
    #[must_use]
    pub fn new(fleet: &Fleet, table: &'static Table, settings: Settings) -> Station {
        let (changes, _) = broadcast::channel(settings.behind.max(1));
        let shared = Arc::new(Shared {
            clock: Clock::start(),
            changes,
            log: Mutex::new(settings.log),
            closing: AtomicBool::new(false),
        });
        let station = Station {
            inner: Arc::new(Inner {
                shared,
                table,
                circuit: settings.circuit,
                seed: settings.seed,
                seats: RwLock::new(BTreeMap::new()),
                tasks: Mutex::new(JoinSet::new()),
            }),
        };
        for robot in fleet.robots() {
            station.add(robot);
        }
        station
    }

    /// Takes one robot more, which is not connected. The others are not touched. Nothing is done where there is such a unit, which
    /// [`remove`](Station::remove) takes out before; false then.
    pub fn add(&self, robot: &Robot) -> bool {
        let inner = &self.inner;
        let mut seats = inner.seats.write();
        if seats.contains_key(&robot.unit) {
            return false;
        }
        let seed = inner.seed ^ u64::from(robot.unit);
        let circuit = Circuit::new(inner.table, inner.circuit, seed);
        let seat = Arc::new(Seat::new(robot.clone(), circuit));
        seats.insert(robot.unit, Arc::clone(&seat));
        let mut tasks = inner.tasks.lock();
        // Those of robots that were taken out.
        while tasks.try_join_next().is_some() {}
        tasks.spawn(robot::drive(Arc::clone(&inner.shared), seat));
        true
    }

    /// Takes a robot out: stops its motors, if it may be in motion, and ends its connection; it waits for both, a second at most each.
    /// The others are not touched. False if it may be in motion: the stop was not written.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub async fn remove(&self, unit: Unit) -> Result<bool, SendError> {
        let taken = self.inner.seats.write().remove(&unit);
        let seat = taken.ok_or(SendError::NoUnit(unit))?;
        let stands = !seat.halt() || timeout(PATIENCE, seat.halted()).await.unwrap_or(false);
        seat.leave(&self.inner.shared);
        // It ends by itself all the same.
        let _ = timeout(PATIENCE, seat.left()).await;
        Ok(stands)
    }

    /// Tries all (W14), and keeps trying.
    pub fn connect_all(&self) {
        for seat in self.inner.seats.read().values() {
            seat.take(&self.inner.shared, Input::Connect);
        }
    }

    /// Ends all connections.
    pub fn disconnect_all(&self) {
        for seat in self.inner.seats.read().values() {
            seat.take(&self.inner.shared, Input::Disconnect);
        }
    }

    /// Tries one robot, and keeps trying.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub fn connect(&self, unit: Unit) -> Result<(), SendError> {
        self.seat(unit)?.take(&self.inner.shared, Input::Connect);
        Ok(())
    }

    /// Stops the motors of one robot, if it may be in motion, waits until it has read that, a second at most, and ends the connection.
    /// False if it may be in motion still.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub async fn part(&self, unit: Unit) -> Result<bool, SendError> {
        let seat = self.seat(unit)?;
        let stands = !seat.halt() || timeout(PATIENCE, seat.halted()).await.unwrap_or(false);
        seat.take(&self.inner.shared, Input::Disconnect);
        Ok(stands)
    }

    /// Ends the connection to one robot, which goes on with what it does: [`part`](Station::part) stops it before.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub fn disconnect(&self, unit: Unit) -> Result<(), SendError> {
        self.seat(unit)?.take(&self.inner.shared, Input::Disconnect);
        Ok(())
    }

    /// Gives up the connection to a robot that does not answer, and all that is under way on it, and tries it anew.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub fn give_up(&self, unit: Unit) -> Result<(), SendError> {
        self.seat(unit)?.take(&self.inner.shared, Input::GiveUp);
        Ok(())
    }

    /// Sends a command to a robot. It does not wait: what cannot be written yet waits, up to
    /// [`MOST_WAITING`](crate::circuit::MOST_WAITING) commands. A stop always has its place, and overrides the motion that waits.
    ///
    /// # Errors
    ///
    /// It is not sent, and why.
    pub fn send(&self, unit: Unit, frame: Frame) -> Result<Taken, SendError> {
        self.seat(unit)?
            .send(frame)
            .map_err(|refusal| SendError::Refused { unit, refusal })
    }

    /// Sends a command to a robot, and waits for a place among those that wait, a second at most.
    ///
    /// # Errors
    ///
    /// It is not sent, and why.
    pub async fn send_in_turn(&self, unit: Unit, frame: Frame) -> Result<Taken, SendError> {
        let seat = self.seat(unit)?;
        match timeout(PATIENCE, seat.send_in_turn(frame)).await {
            Ok(sent) => sent.map_err(|refusal| SendError::Refused { unit, refusal }),
            Err(_) => self.send(unit, frame),
        }
    }

    /// All that happens from now on: frames of both directions, states, ends.
    #[must_use]
    pub fn subscribe(&self) -> broadcast::Receiver<Entry> {
        self.inner.shared.changes.subscribe()
    }

    /// All that happens with one robot from now on.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub fn subscribe_to(&self, unit: Unit) -> Result<broadcast::Receiver<Entry>, SendError> {
        Ok(self.seat(unit)?.subscribe())
    }

    /// What is known of one robot, as it changes.
    ///
    /// # Errors
    ///
    /// There is no such unit.
    pub fn watch(&self, unit: Unit) -> Result<watch::Receiver<Snapshot>, SendError> {
        Ok(self.seat(unit)?.watch())
    }

    /// What is known of all robots, by unit number.
    #[must_use]
    pub fn snapshot(&self) -> Vec<Snapshot> {
        self.inner
            .seats
            .read()
            .values()
            .map(|seat| seat.snapshot())
            .collect()
    }

    /// Reads the log.
    pub fn log<T>(&self, read: impl FnOnce(&Log) -> T) -> T {
        read(&self.inner.shared.log.lock())
    }

    /// The time of the entries: µs since 1970, UTC, on a clock that never goes back.
    #[must_use]
    pub fn now(&self) -> i64 {
        self.inner.shared.clock.now()
    }

    /// Waits until a time as [`now`](Station::now) tells it.
    pub async fn sleep_until(&self, time: i64) {
        match self.inner.shared.clock.instant(time) {
            Some(instant) => tokio::time::sleep_until(instant).await,
            None => std::future::pending().await,
        }
    }

    /// Stops the motors of all robots that the base station has set in motion, of which it is not known that they have read a stop
    /// since, or for which commands wait, and drops what waits. It waits until they have read it, a second at most; gives the units of
    /// which that is not known.
    pub async fn halt(&self) -> Vec<Unit> {
        let moving: Vec<Arc<Seat>> = self
            .inner
            .seats
            .read()
            .values()
            .filter(|seat| seat.halt())
            .cloned()
            .collect();
        let mut left = Vec::new();
        let until = tokio::time::Instant::now() + PATIENCE;
        for seat in moving {
            if !tokio::time::timeout_at(until, seat.halted())
                .await
                .unwrap_or(false)
            {
                left.push(seat.unit());
            }
        }
        left
    }

    /// Ends all connections and the tasks, and waits for that, a second at most. Motors are not stopped by it:
    /// [`halt`](Station::halt) before.
    pub async fn close(&self) {
        // Before: a task that wakes by itself and sees `closing` ends, and may not have been told to part from its robot.
        self.disconnect_all();
        self.inner.shared.closing.store(true, Ordering::Release);
        for seat in self.inner.seats.read().values() {
            seat.wake();
        }
        let mut tasks = std::mem::take(&mut *self.inner.tasks.lock());
        let ended = timeout(PATIENCE, async { while tasks.join_next().await.is_some() {} }).await;
        if ended.is_err() {
            tasks.shutdown().await;
        }
    }

    fn seat(&self, unit: Unit) -> Result<Arc<Seat>, SendError> {
        self.inner
            .seats
            .read()
            .get(&unit)
            .cloned()
            .ok_or(SendError::NoUnit(unit))
    }
}
