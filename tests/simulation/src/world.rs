//! The machines, and the turns in which they go on.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context as _, Result};
use mom_broker::{Broker, Clock, Config};
use mom_proto::Time;
use tokio::runtime::{Builder, Runtime};
use tokio::time::{advance, sleep};

use crate::log::{Instant, Log};
use crate::network::Door;

/// µs of a turn.
pub const TURN: Instant = 5000;

/// A machine with one program, which runs, stands still, or is off.
#[derive(Debug, Default)]
pub struct Host {
    runtime: Option<Runtime>,
    /// It stands still until then.
    frozen_until: Instant,
    /// Time that has passed while it stood still.
    missed: Duration,
}

impl Host {
    /// Starts it anew, with nothing of what it was.
    ///
    /// # Errors
    /// No runtime.
    pub fn start(&mut self, seed: u64) -> Result<&Runtime> {
        self.kill();
        (self.frozen_until, self.missed) = (0, Duration::ZERO);
        Ok(self.runtime.insert(runtime(seed)?))
    }

    /// Ends it as SIGKILL does.
    pub fn kill(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }

    /// Has it stand still until then, as SIGSTOP does.
    pub fn freeze(&mut self, until: Instant) {
        self.frozen_until = self.frozen_until.max(until);
    }

    /// Where its tasks go.
    #[must_use]
    pub fn handle(&self) -> Option<tokio::runtime::Handle> {
        self.runtime.as_ref().map(|runtime| runtime.handle().clone())
    }

    /// Whether it runs or stands still.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.runtime.is_some()
    }

    /// Goes on for a turn.
    fn turn(&mut self, now: Instant) {
        let Some(runtime) = &self.runtime else { return };
        let turn = Duration::from_micros(TURN);
        if now < self.frozen_until {
            self.missed += turn;
            return;
        }
        let missed = std::mem::take(&mut self.missed);
        runtime.block_on(async {
            if !missed.is_zero() {
                advance(missed).await;
            }
            sleep(turn).await; // tidy: the clock that this moves is virtual
        });
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        self.kill();
    }
}

fn runtime(seed: u64) -> Result<Runtime> {
    let mut builder = Builder::new_current_thread();
    // What `select!` chooses by; without it a seed says less (`cargo xtask simulate` has it).
    #[cfg(tokio_unstable)]
    builder.rng_seed(tokio::runtime::RngSeed::from_bytes(&seed.to_le_bytes()));
    #[cfg(not(tokio_unstable))]
    let _ = seed;
    builder
        .enable_all()
        .start_paused(true)
        .build()
        .context("a runtime")
}

/// All machines.
pub struct World {
    /// What has happened.
    pub log: Log,
    /// Where the hub is.
    pub door: Door,
    /// The hub's machine.
    pub hub: Host,
    /// The cables.
    pub net: Host,
    /// The machines of the peers.
    pub hosts: Vec<Host>,
    random: fastrand::Rng,
    now: Instant,
}

impl World {
    /// A world with so many machines of peers, all of them off but the network.
    ///
    /// # Errors
    /// No runtime.
    pub fn new(hosts: usize, seed: u64) -> Result<World> {
        let mut net = Host::default();
        net.start(seed)?;
        Ok(World {
            log: Log::default(),
            door: Door::default(),
            hub: Host::default(),
            net,
            hosts: (0..hosts).map(|_| Host::default()).collect(),
            random: fastrand::Rng::with_seed(!seed),
            now: 0,
        })
    }

    /// µs since the beginning.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.now
    }

    /// The time of day of who has the right one.
    #[must_use]
    pub fn time_of_day(now: Instant) -> Time {
        // 2026-11-30.
        let morning = 1_796_000_000_000_000;
        Time::from_micros(morning + i64::try_from(now).unwrap_or(i64::MAX - morning)).unwrap_or_default()
    }

    /// Starts the hub, which knows nothing of before.
    ///
    /// # Errors
    /// A hub that does not start.
    pub fn start_hub(&mut self, config: &Config, seed: u64) -> Result<()> {
        let anchor = World::time_of_day(self.now);
        let runtime = self.hub.start(seed)?;
        let config = config.clone();
        let broker = runtime.block_on(async { Broker::start_at(config, Clock::of_runtime(anchor)).await })?;
        let door = Some((Arc::new(broker), runtime.handle().clone()));
        *self.door.lock().unwrap_or_else(PoisonError::into_inner) = door;
        Ok(())
    }

    /// Ends the hub as SIGKILL does.
    pub fn kill_hub(&mut self) {
        let door = self.door.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some((broker, handle)) = door {
            let _entered = handle.enter();
            drop(broker);
        }
        self.hub.kill();
    }

    /// Lets everything go on for a turn, in some order.
    pub fn turn(&mut self) {
        self.now += TURN;
        self.log.set_now(self.now);
        self.net.turn(self.now);
        let mut order: Vec<usize> = (0..=self.hosts.len()).collect();
        self.random.shuffle(&mut order);
        for host in order {
            match self.hosts.get_mut(host) {
                Some(host) => host.turn(self.now),
                None => self.hub.turn(self.now),
            }
        }
        // What holds in the hub always holds now.
        let door = self.door.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some((broker, _)) = door {
            broker.check();
        }
    }
}

/// Notes panics of tasks, which end nothing else.
#[derive(Clone, Debug, Default)]
pub struct Panics(Arc<Mutex<Vec<String>>>);

impl Panics {
    /// Listens from now on, for the whole program.
    #[must_use]
    pub fn listen() -> Panics {
        let panics = Panics::default();
        let heard = panics.clone();
        std::panic::set_hook(Box::new(move |panic| {
            let mut heard = heard.0.lock().unwrap_or_else(PoisonError::into_inner);
            heard.push(panic.to_string());
        }));
        panics
    }

    /// Those that were since the last call.
    #[must_use]
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
