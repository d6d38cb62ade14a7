//! One life of a world: its peers at work, faults by chance, and at last none any more.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use anyhow::{Context as _, Result};
use mom_broker::Config;
use mom_client::{Client, Key, Reconnect};
use mom_proto::Time;
use mom_proto::codec::Form;
use tokio::time::sleep;

use crate::chance;
use crate::device::Cart;
use crate::log::{Fact, Instant};
use crate::network::Way;
use crate::operator::{Numbers, Operator, channel_of, token_of};
use crate::oracle;
use crate::world::{Panics, TURN, World};

const SECOND: Instant = 1_000_000;

/// How long a world without faults may take until everybody has what it wants.
const REST: Instant = 1800 * SECOND;

/// How often a link says that it is there.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// What is simulated.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// All chance.
    pub seed: u64,
    /// How long faults happen.
    pub time: Duration,
    /// Devices and operators.
    pub devices: usize,
    /// How many drive.
    pub operators: usize,
    /// Between two faults, on average; none = no faults.
    pub fault_each: Option<Duration>,
}

/// What has come of it.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Promises that were broken, in words.
    pub broken: Vec<String>,
    /// A number that two runs share which went alike.
    pub fingerprint: u64,
    /// How much of what has happened.
    pub counts: BTreeMap<&'static str, usize>,
    /// The last of what has happened before the end, for who looks for a cause.
    pub facts: Vec<(Instant, Fact)>,
    /// All of the time that has passed in it.
    pub time: Duration,
}

/// What is to be done at a time.
#[derive(Clone, Copy, Debug)]
enum Due {
    Start(usize),
    StartHub,
    Open(usize),
    Flow(usize),
}

struct Life {
    plan: Plan,
    world: World,
    config: Config,
    random: fastrand::Rng,
    ways: Vec<Arc<Way>>,
    keys: Vec<String>,
    numbers: Numbers,
    is_healed: Arc<AtomicBool>,
    due: BTreeMap<Instant, Vec<Due>>,
    starts: u64,
}

/// Runs a plan to its end, on a thread of its own: how tables are hashed is a thread's.
///
/// # Errors
/// A world that cannot be made.
pub fn run(plan: Plan, panics: &Panics) -> Result<Outcome> {
    chance::seed(plan.seed);
    let lived = std::thread::scope(|scope| scope.spawn(|| live(plan, panics)).join());
    lived.map_err(|_| anyhow::anyhow!("the world has ended by a fault: {:?}", panics.take()))?
}

fn live(plan: Plan, panics: &Panics) -> Result<Outcome> {
    let mut life = Life::new(plan)?;
    life.start_hub()?;
    for host in 0..life.ways.len() {
        life.start(host)?;
    }
    let end = Instant::try_from(plan.time.as_micros())?;
    while life.world.now() < end {
        life.turn()?;
        life.fault();
    }
    life.heal()?;
    let wanted = plan.operators * plan.devices;
    let over = life.world.now() + REST;
    while life.served() < wanted && life.world.now() < over {
        for _ in 0..200 {
            life.turn()?;
        }
    }
    let facts = life.world.log.facts();
    let mut broken = oracle::broken(&facts);
    let served = life.served();
    if served < wanted {
        broken.push(format!(
            "{served} of {wanted} drives came about in {} s without faults",
            REST / SECOND
        ));
    }
    broken.extend(panics.take());
    Ok(Outcome {
        broken,
        fingerprint: life.world.log.fingerprint(),
        counts: oracle::counts(&facts),
        facts,
        time: Duration::from_micros(life.world.now()),
    })
}

impl Life {
    fn new(plan: Plan) -> Result<Life> {
        let peers = plan.devices + plan.operators;
        let world = World::new(peers, plan.seed)?;
        let mut random = fastrand::Rng::with_seed(plan.seed);
        let keys: Result<Vec<Key>, _> = (0..peers).map(|_| Key::generate()).collect();
        let keys = keys?;
        let config = configured(&plan, &keys, &mut random)?;
        let net = world.net.handle().context("the network is on")?;
        let ways = (0..peers).map(|_| Way::new(&world.door, &net, Duration::from_millis(random.u64(1..40))));
        Ok(Life {
            plan,
            ways: ways.collect(),
            config,
            random,
            keys: keys.iter().map(Key::to_pem).map(|pem| pem.to_string()).collect(),
            numbers: Arc::new(AtomicU64::new(1)),
            is_healed: Arc::default(),
            due: BTreeMap::new(),
            starts: 0,
            world,
        })
    }

    fn seed(&mut self) -> u64 {
        self.starts += 1;
        self.plan.seed.wrapping_mul(1000).wrapping_add(self.starts)
    }

    fn start_hub(&mut self) -> Result<()> {
        let seed = self.seed();
        self.world.start_hub(&self.config, seed)
    }

    /// Starts the program of a peer.
    fn start(&mut self, host: usize) -> Result<()> {
        let seed = self.seed();
        let (way, log) = (Arc::clone(&self.ways[host]), self.world.log.clone());
        let key = self.keys[host].clone();
        let devices = self.plan.devices;
        let (numbers, is_healed) = (Arc::clone(&self.numbers), Arc::clone(&self.is_healed));
        let runtime = self.world.hosts[host].start(seed)?;
        runtime.spawn(async move {
            let clock = log.clone();
            let connect = || {
                let (way, clock) = (Arc::clone(&way), clock.clone());
                let key = Key::from_pem(&key);
                Client::builder_line(Form::Binary, move || way.connect())
                    .user(name_of(host, devices))
                    .key(key.expect("it was made so"))
                    .installation(&name_of(host, devices))
                    .heartbeat(HEARTBEAT)
                    .link(Duration::from_secs(10))
                    .reconnect(Reconnect {
                        first: Duration::from_millis(100),
                        most: Duration::from_secs(2),
                        give_up_after: None,
                    })
                    .wall_clock(move || -> Time { World::time_of_day(clock.now()) })
                    .wait_for_hub()
                    .connect()
            };
            let mut random = fastrand::Rng::with_seed(seed);
            loop {
                let Ok(client) = connect().await else {
                    sleep(Duration::from_secs(1)).await; // tidy: its time is virtual, and who restarts it waits
                    continue;
                };
                if host < devices {
                    let cart = Cart::new(host, &log);
                    // Its service starts it again.
                    let ended =
                        mom_device::obey(&client, &channel_of(host), cart, std::future::pending()).await;
                    log.note(Fact::Fault(format!("d{host} ended: {ended:?}")));
                    sleep(Duration::from_secs(1)).await; // tidy: its time is virtual, and who restarts it waits
                } else {
                    let operator = Operator {
                        name: name_of(host, devices),
                        client,
                        log: log.clone(),
                        random: random.fork(),
                        numbers: Arc::clone(&numbers),
                        devices,
                        is_healed: Arc::clone(&is_healed),
                    };
                    operator.work().await;
                    std::future::pending::<()>().await;
                }
            }
        });
        Ok(())
    }

    fn turn(&mut self) -> Result<()> {
        self.world.turn();
        let now = self.world.now();
        while let Some(entry) = self.due.first_entry().filter(|entry| *entry.key() <= now) {
            for due in entry.remove() {
                self.carry_out(due)?;
            }
        }
        Ok(())
    }

    fn carry_out(&mut self, due: Due) -> Result<()> {
        match due {
            Due::Start(host) if !self.world.hosts[host].is_on() => self.start(host),
            Due::StartHub if !self.world.hub.is_on() => self.start_hub(),
            Due::Open(host) => {
                self.ways[host].set_reachable(true);
                Ok(())
            }
            Due::Flow(host) => {
                self.ways[host].shape(|shape| (shape.stalls, shape.rate) = ([false; 2], [None; 2]));
                Ok(())
            }
            Due::Start(_) | Due::StartHub => Ok(()),
        }
    }

    fn later(&mut self, most: u64, due: Due) -> Instant {
        let at = self.world.now() + self.random.u64(SECOND / 10..most * SECOND);
        self.due.entry(at).or_default().push(due);
        at
    }

    /// Something goes wrong, or nothing.
    fn fault(&mut self) {
        let Some(each) = self.plan.fault_each else { return };
        let each = u64::try_from(each.as_micros()).unwrap_or(u64::MAX);
        if self.random.u64(..each) >= TURN {
            return;
        }
        let host = self.random.usize(..self.ways.len());
        let name = name_of(host, self.plan.devices);
        let now = self.world.now();
        let what = match self.random.u32(..100) {
            0..25 => {
                self.ways[host].cut();
                format!("{name}: cut")
            }
            25..35 => {
                self.ways[host].set_reachable(false);
                self.ways[host].cut();
                let until = self.later(20, Due::Open(host));
                format!("{name}: away until {until}")
            }
            35..55 => {
                let stalls = [[true, true], [true, false], [false, true]][self.random.usize(..3)];
                self.ways[host].shape(|shape| shape.stalls = stalls);
                let until = self.later(20, Due::Flow(host));
                format!("{name}: stalls {stalls:?} until {until}")
            }
            55..68 => {
                let delay = Duration::from_millis(self.random.u64(1..400));
                let rate = self.random.bool().then(|| self.random.u64(2000..200_000));
                self.ways[host].shape(|shape| (shape.delay, shape.rate) = ([delay; 2], [rate; 2]));
                format!("{name}: delay {delay:?} rate {rate:?}")
            }
            68..82 => {
                let until = now + self.random.u64(SECOND / 10..15 * SECOND);
                self.world.hosts[host].freeze(until);
                format!("{name}: frozen until {until}")
            }
            82..92 => {
                self.world.hosts[host].kill();
                let until = self.later(10, Due::Start(host));
                format!("{name}: killed until {until}")
            }
            92..96 => {
                let until = now + self.random.u64(SECOND / 10..6 * SECOND);
                self.world.hub.freeze(until);
                format!("hub: frozen until {until}")
            }
            _ => {
                self.world.kill_hub();
                self.world.log.note(Fact::HubKilled);
                let until = self.later(5, Due::StartHub);
                format!("hub: killed until {until}")
            }
        };
        self.world.log.note(Fact::Fault(what));
    }

    /// Nothing is wrong any more, and nothing will be.
    fn heal(&mut self) -> Result<()> {
        for due in std::mem::take(&mut self.due).into_values().flatten() {
            self.carry_out(due)?;
        }
        if !self.world.hub.is_on() {
            self.start_hub()?;
        }
        for host in 0..self.ways.len() {
            self.ways[host].set_reachable(true);
            self.ways[host].shape(|shape| {
                (shape.stalls, shape.rate) = ([false; 2], [None; 2]);
                shape.delay = [Duration::from_millis(5); 2];
            });
            if !self.world.hosts[host].is_on() {
                self.start(host)?;
            }
        }
        self.world.log.note(Fact::Healed);
        self.is_healed.store(true, Ordering::Relaxed);
        Ok(())
    }

    fn served(&self) -> usize {
        let facts = self.world.log.facts();
        facts
            .iter()
            .filter(|(_, fact)| matches!(fact, Fact::Served { .. }))
            .count()
    }
}

/// What a peer's user is called.
fn name_of(host: usize, devices: usize) -> String {
    match host.checked_sub(devices) {
        None => format!("d{host}"),
        Some(operator) => format!("op{operator}"),
    }
}

/// The hub's configuration: who may do what, and the terms of each token, as chance has it.
fn configured(plan: &Plan, keys: &[Key], random: &mut fastrand::Rng) -> Result<Config> {
    let mut users = String::new();
    for (host, key) in keys.iter().enumerate() {
        let name = name_of(host, plan.devices);
        let level = match host {
            _ if host < plan.devices => 0,
            // One of them is above the others.
            _ if host == keys.len() - 1 => 3,
            _ => 1,
        };
        let group = if host < plan.devices { "device" } else { "person" };
        writeln!(
            users,
            "[[users]]\nname = {name:?}\nkeys = [{:?}]\nlevel = {level}\ngroups = [{group:?}]",
            key.public()
        )?;
    }
    let mut text = "listen = [\"127.0.0.1:0\"]\nusers = \"users.toml\"\nroot = \"house\"\n\
        [managers.house]\nkind = \"roles\"\n\
        [[managers.house.rules]]\nname = \"devices\"\ngroups = [\"device\"]\nallow = [\"join\", \"lookup\", \"list\", \"info\", \"members\", \"send\", \"device\"]\n\
        [[managers.house.rules]]\nname = \"nobody else is a device\"\ndeny = [\"device\"]\n\
        [[managers.house.rules]]\nname = \"people\"\ngroups = [\"person\"]\nallow = [\"*\"]\n"
        .to_owned();
    for device in 0..plan.devices {
        let lease = random.u64(5..60) * 1000;
        let kind = ["level-or-lease", "queue"][random.usize(..2)];
        let deadman = match random.bool() {
            true => format!(", deadman = {}", random.u64(3..20) * 1000),
            false => String::new(),
        };
        let ends = random.bool();
        let (token, channel) = (token_of(device), channel_of(device));
        writeln!(
            text,
            "[managers.t{device}]\nkind = \"chain\"\nof = [\"house\", {{ kind = {kind:?}, lease = {lease}{deadman} }}]\n\
             [[contexts]]\npath = \"/d{device}\"\nkind = \"session\"\n\
             [[contexts]]\npath = {token:?}\nkind = \"token\"\nmanager = \"t{device}\"\nstop-ends-grant = {ends}\n\
             [[contexts]]\npath = {channel:?}\nkind = \"channel\"\nguard = {{ token = {token:?}, names = [\"command\"] }}"
        )?;
    }
    let folder = tempfile::tempdir()?;
    std::fs::write(folder.path().join("users.toml"), users)?;
    let file = folder.path().join("hub.toml");
    std::fs::write(&file, &text)?;
    Config::load(&file).map_err(|errors| anyhow::anyhow!("{errors}\n{text}"))
}
