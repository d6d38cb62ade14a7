//! Two users and an agent want two arms over one table (M40, M41): 200 random tasks on a clock twenty times as fast. Nobody's statement
//! begins but the owner's, no zone is shared, and every task is done, or refused with a reason.

use std::collections::BTreeMap;
use std::time::Duration;

use mom_arm::{ArmState, Block, Mount, Pose, Zones};
use mom_client::{Client, Event, Events, Family, Map, Parcel, Path, Time, TokenGuard, Value, from_value};
use mom_drive::{Commander, DeviceChannel, How, VerbFailure, lost_words};
use mom_tests::programs::{PATIENCE, Running, project};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::timeout;

const ZONES: [&str; 4] = ["/zone/left", "/zone/middle", "/zone/right", "/zone/table"];
const TASKS: usize = 100;
const PACE: &str = "20";

/// An arm of the lab: user, session, mount, and its own part of the table.
struct Arm {
    user: &'static str,
    session: &'static str,
    mount: &'static str,
    own: &'static str,
}

const ARMS: [Arm; 2] = [
    Arm {
        user: "arm",
        session: "/robot",
        mount: "0,0,0",
        own: "/zone/left",
    },
    Arm {
        user: "arm-2",
        session: "/robot-2",
        mount: "500,0,180",
        own: "/zone/right",
    },
];

impl Arm {
    fn channel(&self) -> String {
        format!("{}/arm", self.session)
    }

    fn token(&self) -> String {
        format!("{}/token", self.session)
    }
}

async fn arrive(hub: &str, name: &str) -> Client {
    let client = Client::builder(hub).user(name).password(name).connect().await;
    client.expect("the lab knows its users")
}

/// What a task came to.
#[derive(Debug)]
enum Outcome {
    Done,
    Refused(String),
}

impl<T: ToString> From<T> for Outcome {
    fn from(why: T) -> Outcome {
        Outcome::Refused(why.to_string())
    }
}

/// Work that the agent is to do with what it is given.
struct Job {
    arm: usize,
    zones: Vec<String>,
    script: String,
    done: oneshot::Sender<Outcome>,
}

/// A peer with tasks.
struct Worker {
    client: Client,
    random: fastrand::Rng,
    agent: mpsc::UnboundedSender<Job>,
    states: [watch::Receiver<Option<ArmState>>; 2],
}

impl Worker {
    async fn task(&mut self) -> Outcome {
        let arm = self.random.usize(0..2);
        let Some(state) = self.states[arm].borrow().clone() else {
            return "the arm has not told its state".into();
        };
        let (script, poses) = self.plan(&state);
        let zones = self.zones(arm, &poses);
        match self.try_task(arm, &zones, script).await {
            Ok(outcome) => outcome,
            Err(failure) => failure.into(),
        }
    }

    /// Stacks a block on another, puts it beside one, or moves it anywhere.
    fn plan(&mut self, state: &ArmState) -> (String, Vec<Pose>) {
        if self.random.u8(0..10) == 0 {
            return (
                "reset".to_owned(),
                vec![state.pose, Pose::new(0.0, 0.0, 300.0, 0.0, 0.0)],
            );
        }
        let (first, second) = (self.random.usize(0..3), self.random.usize(1..3));
        let (block, other) = (&state.blocks[first], &state.blocks[(first + second) % 3]);
        let (x, y, z) = match self.random.u8(0..3) {
            0 => (other.x, other.y, other.z + Block::lab()[0].size),
            1 => (other.x, other.y + 60.0, other.z),
            _ => {
                let along = self.random.f64() * 560.0 - 280.0;
                (along, self.random.f64() * 400.0 - 150.0, 20.0)
            }
        };
        let spin = (block.yaw + 45.0).rem_euclid(90.0) - 45.0;
        let high = 220.0;
        let script = format!(
            "grip open; move {0} {1} {high} {spin} 0; move {0} {1} {2} {spin} 0; grip close; \
             move {0} {1} {high} {spin} 0; move {x} {y} {z} 0 0; grip open; move {x} {y} {high} 0 0",
            block.x, block.y, block.z
        );
        let poses = [(block.x, block.y), (x, y)].map(|(x, y)| Pose::new(x, y, high, 0.0, 0.0));
        (script, [&[state.pose], &poses[..]].concat())
    }

    /// The zones of a way, sometimes all of the table.
    fn zones(&mut self, arm: usize, poses: &[Pose]) -> Vec<String> {
        if self.random.u8(0..8) == 0 {
            return vec!["/zone/table".to_owned()];
        }
        let mut zones = vec![ARMS[arm].own.to_owned()];
        if poses.iter().any(|pose| pose.x > -5.0) {
            zones.push("/zone/middle".to_owned());
        }
        zones
    }

    async fn try_task(
        &mut self,
        arm: usize,
        zones: &[String],
        script: String,
    ) -> Result<Outcome, VerbFailure> {
        let plain = |error: mom_client::ClientError| VerbFailure::plain(error.to_string());
        let wait = Duration::from_millis(self.random.u64(1..1500));
        let token = self.client.token(&ARMS[arm].token()).await.map_err(plain)?;
        let mut guard = token.grab().wait(wait).await.map_err(plain)?;
        let mut held = Vec::new();
        for zone in zones {
            let zone = self.client.token(zone).await.map_err(plain)?;
            held.push(zone.grab().wait(wait).await.map_err(plain)?);
        }
        let outcome = match self.random.u8(0..3) {
            0 => return self.lend(arm, guard, held, script).await,
            _ => drive(&self.client, arm, &mut guard, &script).await,
        };
        guard.release().await.map_err(plain)?;
        for zone in held {
            zone.release().await.map_err(plain)?;
        }
        Ok(outcome)
    }

    /// Gives robot and zones to the agent for a while, and has it do the task.
    async fn lend(
        &self,
        arm: usize,
        guard: TokenGuard,
        held: Vec<TokenGuard>,
        script: String,
    ) -> Result<Outcome, VerbFailure> {
        let plain = |error: mom_client::ClientError| VerbFailure::plain(error.to_string());
        let mut given = Vec::new();
        let zones = held.iter().map(|zone| zone.path().to_string()).collect();
        for guard in std::iter::once(&guard).chain(&held) {
            let scope = Duration::from_secs(10);
            given.push(guard.give("assistant").time(scope).await.map_err(plain)?);
        }
        let (done, outcome) = oneshot::channel();
        let job = Job {
            arm,
            zones,
            script,
            done,
        };
        self.agent.send(job).expect("the agent is there");
        let outcome = outcome.await.expect("it says what came of it");
        for given in given {
            // It comes back, unless a peer took it, or it was not accepted at all.
            if let Ok(Ok(back)) = timeout(PATIENCE, given.returned()).await {
                back.release().await.map_err(plain)?;
            }
        }
        Ok(outcome)
    }
}

async fn drive(client: &Client, arm: usize, guard: &mut TokenGuard, script: &str) -> Outcome {
    let channel = match DeviceChannel::join(client, &ARMS[arm].channel()).await {
        Ok(channel) => channel,
        Err(failure) => return failure.into(),
    };
    let mut robot = Commander::new(channel, guard.fence());
    tokio::select! {
        lost = guard.lost() => lost_words(&ARMS[arm].token(), &lost).into(),
        end = robot.carry_out(script) => match end {
            end if end.is_finished() => Outcome::Done,
            end => match end.how {
                How::Failed(report) => report.wire_error().text.into(),
                _ => end.text.into(),
            },
        },
    }
}

/// The agent: does what it is given the tokens for, and gives them back.
async fn serve(client: Client, ready: oneshot::Sender<()>, mut jobs: mpsc::UnboundedReceiver<Job>) {
    // Tokens are given to members.
    let mut tokens = Vec::new();
    for token in ["/robot/token", "/robot-2/token"].iter().chain(&ZONES) {
        tokens.push(client.token(token).await.expect("it may look"));
    }
    ready.send(()).expect("it is waited for");
    while let Some(job) = jobs.recv().await {
        let client = client.clone();
        tokio::spawn(async move {
            let outcome = match serve_one(&client, &job).await {
                Ok(outcome) => outcome,
                Err(error) => error.into(),
            };
            let _ = job.done.send(outcome);
        });
    }
}

async fn serve_one(client: &Client, job: &Job) -> Result<Outcome, mom_client::ClientError> {
    let mut guard = client.token(&ARMS[job.arm].token()).await?.accept().await?;
    let mut held = Vec::new();
    for zone in &job.zones {
        held.push(client.token(zone).await?.accept().await?);
    }
    let outcome = drive(client, job.arm, &mut guard, &job.script).await;
    guard.release().await?;
    for zone in held {
        zone.release().await?;
    }
    Ok(outcome)
}

/// Hears everything, and keeps what must not be.
struct Watcher {
    /// The zones: box, and who owns them.
    owners: BTreeMap<Path, Option<String>>,
    overlaps: Vec<(Path, Path)>,
    arms: [Watched; 2],
    states: [watch::Sender<Option<ArmState>>; 2],
    wrong: Vec<String>,
}

/// What was heard of an arm.
struct Watched {
    /// By the fences of its token.
    owners: BTreeMap<u64, String>,
    told: Vec<Told>,
    /// When a statement began, by the hub's clock, and whose.
    begun: Vec<(Time, String)>,
    zones: Zones,
}

/// A state that an arm has told.
struct Told {
    /// When the hub had it. A state takes the place of an older one that still waits for the watcher, so the order in which they are heard
    /// is not the order in which they were told.
    at: Time,
    seq: u64,
    /// The newest fence under which it stands.
    fence: u64,
    in_middle: bool,
}

impl Watched {
    /// The state before a time, and the first after it if others between them may not have been heard.
    fn around(&self, at: Time) -> (Option<&Told>, Option<&Told>) {
        let next = self.told.partition_point(|told| told.at <= at);
        let before = next.checked_sub(1).map(|before| &self.told[before]);
        let after = self.told.get(next);
        let follows = |after: &&Told| before.is_some_and(|before| after.seq <= before.seq + 1);
        (before, after.filter(|after| !follows(after)))
    }
}

impl Watcher {
    fn hear(&mut self, event: &Event) {
        match event {
            Event::Message(parcel) => {
                let place = parcel.context.as_ref().map(Path::as_str).unwrap_or_default();
                let Some(arm) = ARMS.iter().position(|arm| arm.channel() == place) else {
                    return;
                };
                match parcel.name() {
                    "state" => self.state(arm, parcel),
                    "status" => self.status(arm, parcel),
                    _ => {}
                }
            }
            Event::Grabbed {
                owner, fence, path, ..
            } => {
                if let Some(arm) = ARMS.iter().position(|arm| arm.token() == path.as_str()) {
                    self.arms[arm].owners.insert(*fence, owner.clone());
                }
                if self.owners.contains_key(path) {
                    self.owners.insert(path.clone(), Some(owner.clone()));
                    self.check_zones();
                }
            }
            Event::Released { path, .. } => {
                if let Some(zone) = self.owners.get_mut(path) {
                    *zone = None;
                }
            }
            Event::Lagged(count) => self.wrong.push(format!("{count} events were not heard")),
            _ => {}
        }
    }

    /// No two zones that overlap have different owners.
    fn check_zones(&mut self) {
        for (a, b) in &self.overlaps {
            if let (Some(one), Some(other)) = (&self.owners[a], &self.owners[b])
                && one != other
            {
                self.wrong.push(format!("{one} owns {a}, and {other} {b}"));
            }
        }
    }

    fn state(&mut self, arm: usize, parcel: &Parcel) {
        let state: ArmState = from_value(parcel.value()).expect("a state");
        let middle = Path::parse("/zone/middle").expect("a path");
        let watched = &mut self.arms[arm];
        watched.told.push(Told {
            at: received(parcel),
            seq: state.seq,
            fence: state.fence.unwrap_or_default(),
            in_middle: watched.zones.check_grant(&middle, &state.pose).is_err(),
        });
        self.states[arm].send_replace(Some(state));
    }

    fn status(&mut self, arm: usize, parcel: &Parcel) {
        let content = parcel.value();
        let word = |key: &str| content.get(key).and_then(Value::as_str).unwrap_or_default();
        if word("state") == "executing" {
            let begun = (received(parcel), word("peer").to_owned());
            self.arms[arm].begun.push(begun);
        }
    }

    /// What was wrong in all that was heard, and how many statements have begun.
    fn judge(mut self) -> (Vec<String>, usize) {
        for arm in &mut self.arms {
            arm.told.sort_by_key(|told| told.at);
            let mut stood = 0;
            for told in &mut arm.told {
                stood = told.fence.max(stood);
                told.fence = stood;
            }
        }
        let [first, second] = &self.arms;
        for (watched, other) in [(first, second), (second, first)] {
            self.wrong
                .extend(watched.begun.iter().filter_map(|begun| strange(watched, begun)));
            let meets = |told: &&Told| told.in_middle && is_surely_in_middle(other, told.at);
            let met = watched.told.iter().filter(meets);
            self.wrong
                .extend(met.map(|told| format!("both arms are in the middle, {}", told.at)));
        }
        (self.wrong, first.begun.len() + second.begun.len())
    }
}

/// Who begins a statement is the owner under whom the arm has stood.
fn strange(watched: &Watched, (at, peer): &(Time, String)) -> Option<String> {
    let (before, after) = watched.around(*at);
    let stood = before.map_or(0, |told| told.fence);
    let owners = watched
        .owners
        .range(stood..=after.map_or(stood, |told| told.fence));
    let owners: Vec<_> = owners.collect();
    let is_owner = owners.iter().any(|(_, owner)| *owner == peer);
    (!is_owner).then(|| format!("{peer} begins a statement at {at} under fence {stood}: {owners:?}"))
}

/// Both arms are never in the middle.
fn is_surely_in_middle(watched: &Watched, at: Time) -> bool {
    let (before, after) = watched.around(at);
    before.is_some_and(|told| told.in_middle) && after.is_none_or(|told| told.in_middle)
}

/// When the hub had it.
fn received(parcel: &Parcel) -> Time {
    parcel.received.expect("the hub says when it had a message")
}

/// Joins everything, so that all is heard in one order, and gives the zones as the hub tells them.
async fn watch_all(client: &Client) -> Watcher {
    let join = async |path: &str| {
        let join = Parcel::new(Family::Context, "join").context(Path::parse(path).expect("a path"));
        client.request(join).await.expect("they may look");
    };
    for session in ["/robot", "/robot-2", "/zone"] {
        join(session).await;
    }
    for arm in &ARMS {
        join(&arm.token()).await;
        join(&arm.channel()).await;
    }
    let mut boxes: BTreeMap<Path, Map> = BTreeMap::new();
    for zone in ZONES {
        join(zone).await;
        let info = client.info(zone).await.expect("they may look");
        boxes.insert(Path::parse(zone).expect("a path"), info);
    }
    let watched = |arm: &Arm| {
        let mut zones = Zones::new(arm.mount.parse::<Mount>().expect("a mount"));
        for (path, info) in &boxes {
            zones.add(path.clone());
            zones.told(path, info);
        }
        Watched {
            owners: BTreeMap::new(),
            told: Vec::new(),
            begun: Vec::new(),
            zones,
        }
    };
    let table = Path::parse("/zone/table").expect("a path");
    Watcher {
        owners: boxes.keys().map(|path| (path.clone(), None)).collect(),
        overlaps: boxes
            .keys()
            .filter(|path| **path != table)
            .map(|path| (path.clone(), table.clone()))
            .collect(),
        arms: [watched(&ARMS[0]), watched(&ARMS[1])],
        states: [watch::Sender::new(None), watch::Sender::new(None)],
        wrong: Vec::new(),
    }
}

/// The program of an arm, on the fast clock.
fn start_arm(hub: &str, arm: &Arm) -> Running {
    let options = ["--hub", hub, "--user", arm.user, "--channel", &arm.channel()];
    let zones = ["--zones", "/zone", "--mount", arm.mount, "--pace", PACE];
    let environment = [("MOM_PASSWORD", arm.user), ("RUST_LOG", "warn")];
    Running::start("mom-arm", &[&options[..], &zones].concat(), &environment)
}

/// Hears all until it is told to stop.
async fn hear_all(mut watcher: Watcher, mut events: Events, mut stopping: oneshot::Receiver<()>) -> Watcher {
    loop {
        tokio::select! {
            event = events.next() => watcher.hear(&event.expect("the hub is there")),
            _ = &mut stopping => return watcher,
        }
    }
}

/// Two users do their tasks, themselves or by the agent; what came of each.
async fn work(hub: &str, seed: u64, states: &[watch::Receiver<Option<ArmState>>; 2]) -> Vec<Outcome> {
    let (agent, jobs) = mpsc::unbounded_channel();
    let (ready, serves) = oneshot::channel();
    let serving = tokio::spawn(serve(arrive(hub, "assistant").await, ready, jobs));
    serves.await.expect("the agent is there");
    let mut working = Vec::new();
    for (name, seed) in [("alice", seed), ("carol", seed.wrapping_add(1))] {
        let mut worker = Worker {
            client: arrive(hub, name).await,
            random: fastrand::Rng::with_seed(seed),
            agent: agent.clone(),
            states: states.clone(),
        };
        working.push(tokio::spawn(async move {
            let mut outcomes = Vec::new();
            for _ in 0..TASKS {
                outcomes.push(worker.task().await);
            }
            outcomes
        }));
    }
    drop(agent);
    let mut outcomes = Vec::new();
    for worker in working {
        outcomes.extend(worker.await.expect("every task ends"));
    }
    serving.await.expect("the agent ends");
    outcomes
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_hundred_tasks_of_two_users_and_an_agent() {
    let (_broker, address) = Running::broker(&project().join("config/two-arms.toml"));
    let hub = format!("bin://{address}");
    let bob = arrive(&hub, "bob").await;
    let events = bob.unaddressed();
    let watcher = watch_all(&bob).await;
    let _arms = ARMS.map(|arm| start_arm(&hub, &arm));
    let states = [watcher.states[0].subscribe(), watcher.states[1].subscribe()];
    let (stop, stopping) = oneshot::channel::<()>();
    let watching = tokio::spawn(hear_all(watcher, events, stopping));
    for state in &mut states.clone() {
        let told = timeout(PATIENCE, state.wait_for(Option::is_some)).await;
        told.expect("the arms come").expect("and tell their states");
    }
    let seed = fastrand::u64(..);
    let outcomes = work(&hub, seed, &states).await;
    stop.send(()).expect("it watches");
    let (wrong, begun) = watching.await.expect("it watches").judge();
    let all = outcomes.len();
    let reasons: Vec<String> = outcomes
        .into_iter()
        .filter_map(|outcome| match outcome {
            Outcome::Done => None,
            Outcome::Refused(why) => Some(why),
        })
        .collect();
    let done = all - reasons.len();
    println!("seed {seed}: {done} of {all} done, {begun} statements; {reasons:#?}");
    assert!(wrong.is_empty(), "seed {seed}: {wrong:?}");
    assert_eq!(all, 2 * TASKS);
    assert!(reasons.iter().all(|why| !why.is_empty()), "each says why");
    assert!(
        done >= TASKS / 5 && begun > 2 * done,
        "too little was done: {done}, {reasons:#?}"
    );
    let met = |words: &str| reasons.iter().any(|why| why.contains(words));
    assert!(
        met("/zone/") && met("held"),
        "nobody was in anybody's way: {reasons:#?}"
    );
}
