//! The lab for an operator behind a narrow link: what becomes of images, of states and of stops when four cameras send more than it
//! carries.

use std::array::from_fn;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, anyhow, ensure};
use mom_client::{Channel, Client, Content, Event, HubClock, Value, event};
use tempfile::TempDir;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout, timeout_at};

use super::far_hub::{FarHub, shape};
use super::{Section, Settings};
use mom_benches::Process;

mod figures;

/// The cameras, by the last part of their channels.
const VIEWS: [&str; 4] = ["x", "y", "top", "wrist"];
const ARM: &str = "/robot/arm";
/// What alice has the arm do, again and again.
const SCRIPT: &str =
    "move 150 100 250 0 0; move -150 100 250 90 0; move -150 -100 150 0 0; move 150 -100 250 -90 0";
/// An answer that takes longer is lost.
const PATIENCE: Duration = Duration::from_secs(60);
/// A command that nothing was heard of is sent again after so long.
const AGAIN: Duration = Duration::from_millis(500);
/// The link has been full for so long when the figures begin.
const BEGUN: Duration = Duration::from_secs(5);

/// How the operator is connected; all of it is an input.
#[derive(Clone, Copy, Debug)]
struct Way {
    name: &'static str,
    /// Bits per second; none on loopback.
    rate: Option<f64>,
    /// From one end to the other.
    delay: Duration,
}

const WAYS: [Way; 3] = [
    Way {
        name: "loopback",
        rate: None,
        delay: Duration::ZERO,
    },
    Way {
        name: "1 Mbit/s, 150 ms",
        rate: Some(1e6),
        delay: Duration::from_millis(150),
    },
    Way {
        name: "1 Mbit/s, 300 ms",
        rate: Some(1e6),
        delay: Duration::from_millis(300),
    },
];

/// What the operator had while it was joined in one way. Ages and times are in s.
#[derive(Clone, Debug, Default)]
struct Seen {
    /// For how long images and states were counted.
    seconds: f64,
    /// The ages of each camera's images, in the order of arrival; of none where the operator has not joined the cameras.
    images: [Vec<f64>; 4],
    states: Vec<f64>,
    /// How old the newest state that the operator knew had become whenever another came.
    known: Vec<f64>,
    /// What was sent meanwhile, as seen beside the broker.
    images_sent: [usize; 4],
    image_bytes: usize,
    states_sent: usize,
    /// From each stop until the arm stands, as seen beside the broker, and until the operator hears so.
    stood: Vec<f64>,
    heard: Vec<f64>,
}

/// What was seen on one way: with images, and without.
#[derive(Debug)]
struct Both {
    with: Seen,
    without: Seen,
}

/// What the observer beside the broker says to the operator's side of the experiment, not over the link.
#[derive(Debug)]
struct Observed {
    counting: AtomicBool,
    images: [AtomicUsize; 4],
    bytes: AtomicUsize,
    states: AtomicUsize,
    motion: watch::Sender<Motion>,
}

/// The newest state of the arm.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    moving: bool,
    stopped: bool,
    /// Since when it has stood after a stop.
    stands: Option<Instant>,
}

/// Something that the operator hears.
#[derive(Debug)]
struct Heard {
    /// Which camera; none for the arm.
    camera: Option<usize>,
    at: Instant,
    age: f64,
    motion: Option<Motion>,
}

pub(super) fn run(settings: &Settings) -> Result<Section> {
    let ways = if settings.quick { &WAYS[..1] } else { &WAYS[..] };
    // One after the other: four cameras keep the machine busy.
    let each = ways.iter().map(|way| {
        let seen = measure(*way, settings).with_context(|| format!("over {}", way.name))?;
        Ok((*way, seen))
    });
    let seen = each.collect::<Result<Vec<(Way, Both)>>>()?;
    Ok(Section {
        markdown: figures::markdown(&seen),
        plots: vec![("experiment-lab-link.svg", figures::plot(&seen))],
    })
}

/// The lab as it is, but for what it says of an address that is not loopback.
fn lab_folder() -> Result<TempDir> {
    let folder = tempfile::tempdir()?;
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    std::fs::copy(
        config.join("lab-users.toml"),
        folder.path().join("lab-users.toml"),
    )?;
    let lab = std::fs::read_to_string(config.join("lab.toml"))?;
    let lab = lab.replace(
        "users = \"lab-users.toml\"",
        "log = \"error\"\nusers = \"lab-users.toml\"",
    );
    std::fs::write(folder.path().join("mom.toml"), lab)?;
    Ok(folder)
}

fn measure(way: Way, settings: &Settings) -> Result<Both> {
    let shape = way.rate.map(|rate| shape(rate, way.delay));
    let hub = FarHub::new(shape, lab_folder()?, settings)?;
    let _devices = devices(&hub, settings)?;
    let address = hub.address("bins");
    let observed = Observed {
        counting: AtomicBool::new(false),
        images: from_fn(|_| AtomicUsize::new(0)),
        bytes: AtomicUsize::new(0),
        states: AtomicUsize::new(0),
        motion: watch::channel(Motion::default()).0,
    };
    let (over, end) = oneshot::channel();
    let near = async {
        tokio::select! {
            failed = drive(&address) => failed,
            failed = observe(&address, &observed) => failed,
            _ = end => Ok(()),
        }
    };
    let both = async {
        let with = operate(&address, true, &observed, settings).await?;
        let without = operate(&address, false, &observed, settings).await?;
        Ok(Both { with, without })
    };
    let far = async {
        let both = both.await;
        // The other side may have failed before.
        let _ = over.send(());
        both
    };
    Ok(hub.at_both(near, far)?.1)
}

/// The arm and its cameras, each a process beside the broker.
fn devices(hub: &FarHub, settings: &Settings) -> Result<Vec<Process>> {
    let program = settings.broker.with_file_name("mom-device");
    ensure!(
        program.is_file(),
        "there is no {}; `cargo xtask experiments` builds it",
        program.display()
    );
    let start = |password, args: &[&str], ready| hub.start_near(&program, password, args, ready);
    let mut devices = vec![start("arm", &["arm"], "the arm is ready")?];
    for view in VIEWS {
        devices.push(start(
            "camera",
            &["camera", "--view", view],
            "the camera is ready",
        )?);
    }
    Ok(devices)
}

async fn login(address: &str, user: &str) -> Result<Client> {
    let builder = Client::builder(address).user(user).password(user);
    let connected = builder.no_reconnect().request_timeout(PATIENCE).connect().await;
    connected.with_context(|| format!("{user} cannot log in"))
}

/// Alice: has the arm move whenever it may.
async fn drive(address: &str) -> Result<()> {
    let client = login(address, "alice").await?;
    let token = client.token("/robot/token").await?;
    let arm = client.channel(ARM).await?;
    let mut events = arm.events();
    let _owning = token.grab().await?;
    let mut motion = Motion::default();
    loop {
        if !motion.moving && !motion.stopped {
            arm.send("command", SCRIPT).await?;
        }
        let again = tokio::time::Instant::now() + AGAIN;
        while let Ok(event) = timeout_at(again, events.next()).await {
            match event.context("the arm's channel ended")? {
                Event::Message(parcel) if parcel.name() == "state" => motion = Motion::read(&parcel.value()),
                _ => {}
            }
        }
    }
}

/// Bob, beside the broker: what is sent at all, and how the arm moves.
async fn observe(address: &str, observed: &Observed) -> Result<()> {
    let client = login(address, "bob").await?;
    let (sender, mut heard) = mpsc::unbounded_channel();
    let mut tasks = JoinSet::new();
    for (camera, channel) in join(&client, true).await? {
        let (sender, mut events) = (sender.clone(), channel.events());
        tasks.spawn(async move {
            while let Some(event) = events.next().await {
                if let Event::Message(parcel) = event
                    && sender.send((camera, Instant::now(), parcel)).is_err()
                {
                    break;
                }
            }
        });
    }
    while let Some((camera, at, parcel)) = heard.recv().await {
        let counting = observed.counting.load(Ordering::Relaxed);
        match (camera, parcel.name()) {
            (Some(camera), "image") if counting => {
                let bytes = parcel.content.as_ref().map_or(0, Content::size);
                observed.bytes.fetch_add(bytes, Ordering::Relaxed);
                observed.images[camera].fetch_add(1, Ordering::Relaxed);
            }
            (None, "state") => {
                observed
                    .states
                    .fetch_add(usize::from(counting), Ordering::Relaxed);
                let motion = Motion::read(&parcel.value());
                observed.motion.send_modify(|before| {
                    let stands = motion.stopped && !motion.moving;
                    let stands = stands.then(|| before.stands.unwrap_or(at));
                    *before = Motion { stands, ..motion };
                });
            }
            _ => {}
        }
    }
    Err(anyhow!("the observer's connection ended"))
}

/// The channels of the cameras, where they are wanted, and that of the arm.
async fn join(client: &Client, cameras: bool) -> Result<Vec<(Option<usize>, Channel)>> {
    let mut channels = vec![(None, client.channel(ARM).await?)];
    for (at, view) in VIEWS.iter().enumerate().filter(|_| cameras) {
        channels.push((Some(at), client.channel(&format!("/camera/{view}")).await?));
    }
    Ok(channels)
}

/// Carol, at the other end of the link: looks on, then stops the arm.
async fn operate(address: &str, cameras: bool, observed: &Observed, settings: &Settings) -> Result<Seen> {
    let (seconds, stops) = match (settings.quick, cameras) {
        (true, _) => (5, 3),
        (false, true) => (30, 20),
        (false, false) => (15, 20),
    };
    let client = login(address, "carol").await?;
    let channels = join(&client, cameras).await?;
    let arm = channels[0].1.clone();
    let (sender, mut heard) = mpsc::unbounded_channel();
    let mut tasks = JoinSet::new();
    for (camera, channel) in channels {
        tasks.spawn(listen(camera, channel, client.clock(), sender.clone()));
    }
    drop(sender);
    sleep(BEGUN).await;
    while heard.try_recv().is_ok() {}
    let mut seen = count(&mut heard, Duration::from_secs(seconds), observed).await?;
    let mut random = fastrand::Rng::with_seed(settings.seed);
    for _ in 0..stops {
        let (stood, stop_heard) = stop(&client, &arm, &mut heard, observed, &mut random).await?;
        seen.stood.push(stood);
        seen.heard.push(stop_heard);
    }
    client.close().await;
    Ok(seen)
}

async fn listen(
    camera: Option<usize>,
    channel: Channel,
    clock: HubClock,
    sender: mpsc::UnboundedSender<Heard>,
) {
    let mut events = channel.events();
    while let Some(event) = events.next().await {
        let Event::Message(parcel) = event else { continue };
        if !matches!(parcel.name(), "image" | "state") {
            continue;
        }
        let heard = Heard {
            camera,
            at: Instant::now(),
            age: clock
                .age(&parcel)
                .map_or(f64::NAN, |age| age.duration().as_secs_f64()),
            motion: camera.is_none().then(|| Motion::read(&parcel.value())),
        };
        if sender.send(heard).is_err() {
            return;
        }
    }
}

/// Counts what comes for so long, at both ends of the link.
async fn count(
    heard: &mut mpsc::UnboundedReceiver<Heard>,
    time: Duration,
    observed: &Observed,
) -> Result<Seen> {
    let mut seen = Seen {
        seconds: time.as_secs_f64(),
        ..Seen::default()
    };
    observed.reset();
    let end = tokio::time::Instant::now() + time;
    let mut newest: Option<(Instant, f64)> = None;
    while let Ok(heard) = timeout_at(end, heard.recv()).await {
        let heard = heard.context("the link ended")?;
        if let Some(camera) = heard.camera {
            seen.images[camera].push(heard.age);
            continue;
        }
        if let Some((at, age)) = newest.replace((heard.at, heard.age)) {
            seen.known.push(age + (heard.at - at).as_secs_f64());
        }
        seen.states.push(heard.age);
    }
    observed.counting.store(false, Ordering::Relaxed);
    seen.images_sent = observed
        .images
        .each_ref()
        .map(|sent| sent.load(Ordering::Relaxed));
    seen.image_bytes = observed.bytes.load(Ordering::Relaxed);
    seen.states_sent = observed.states.load(Ordering::Relaxed);
    Ok(seen)
}

/// One stop in a random moment of a motion, and the end of it: until the arm stands, and until that is heard.
async fn stop(
    client: &Client,
    arm: &Channel,
    heard: &mut mpsc::UnboundedReceiver<Heard>,
    observed: &Observed,
    random: &mut fastrand::Rng,
) -> Result<(f64, f64)> {
    let mut motion = observed.motion.subscribe();
    timeout(
        PATIENCE,
        motion.wait_for(|motion| motion.moving && !motion.stopped),
    )
    .await
    .context("the arm does not move")??;
    sleep(Duration::from_secs_f64(0.2 + random.f64())).await;
    while heard.try_recv().is_ok() {}
    let begin = Instant::now();
    arm.message(event::STOP).no_echo().send().await?;
    let at = loop {
        let state = timeout(PATIENCE, heard.recv()).await;
        let state = state
            .context("nobody says that the arm stands")?
            .context("the link ended")?;
        // Since the last one the arm has moved, and all of what it said then has been heard or replaced.
        if state
            .motion
            .is_some_and(|motion| motion.stopped && !motion.moving)
        {
            break state.at;
        }
    };
    // On loopback the operator may hear it first.
    timeout(PATIENCE, motion.wait_for(|motion| motion.stands.is_some()))
        .await
        .context("nobody beside the arm sees it stand")??;
    let stands = motion.borrow().stands.unwrap_or(at);
    let newest = i64::try_from(client.stops(ARM).await?.number)?;
    let unstop = arm.message(event::UNSTOP).slot("stop", newest);
    unstop.no_echo().send().await?;
    timeout(PATIENCE, motion.wait_for(|motion| !motion.stopped))
        .await
        .context("the arm stays stopped")??;
    // What was sent before has come by then.
    while let Ok(Some(state)) = timeout(PATIENCE, heard.recv()).await {
        if state.motion.is_some_and(|motion| !motion.stopped) {
            break;
        }
    }
    Ok(((stands - begin).as_secs_f64(), (at - begin).as_secs_f64()))
}

impl Observed {
    fn reset(&self) {
        self.images
            .iter()
            .for_each(|sent| sent.store(0, Ordering::Relaxed));
        self.bytes.store(0, Ordering::Relaxed);
        self.states.store(0, Ordering::Relaxed);
        self.counting.store(true, Ordering::Relaxed);
    }
}

impl Motion {
    /// Of the content of a state.
    fn read(state: &Value) -> Motion {
        let is = |key: &str| state.get(key).and_then(Value::as_bool).unwrap_or_default();
        Motion {
            moving: is("moving"),
            stopped: is("stopped"),
            stands: None,
        }
    }
}
