//! The robot as a peer: its contexts, and the channel in which robots tell each other where they are.

use std::future::Future;
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_client::{Boxed, Card, Channel, Client, ClientError, Delivery, Event, Family, Parcel, Path, Value};
use mom_device::{
    DevicePeer, Machine as _, Outlet, State, card, instant_of, sender, sleep_or_wait, time_since,
};
use mom_wheeled::{Rover, StatusTeller, come_back, ensure_session, enter, enter_status, stand, stay};
use mom_wheels::pilot::Point;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::Instant;

/// The message by which a robot tells where it is: `{x, y, heading}`, mm, mm, degrees.
pub const POSE: &str = "pose";
/// So often it tells while it moves, and while it stands: who follows it has to know that it does.
const MOVING: Duration = Duration::from_millis(100);
const STANDING: Duration = Duration::from_millis(250);
/// The most poses of others that wait.
const MOST_POSES: usize = 64;

/// Where a robot is at the hub.
#[derive(Debug, Clone, Default)]
pub struct RoverOptions {
    /// Its session, such as `/rover/a`, with a channel `robot` and a token `token`.
    pub path: String,
    /// The manager of its token, if that has to be made; none: that of the session.
    pub manager: Option<String>,
    /// The channel in which it tells where it is.
    pub tell: Option<String>,
    /// The channel in which it hears where its leader is.
    pub hear: Option<String>,
    /// It asks for its commands, for so long each time.
    pub pull: Option<Duration>,
}

impl RoverOptions {
    /// Its number, where its session has one as its name, as those of a gateway's robots.
    #[must_use]
    pub fn unit(&self) -> Option<u32> {
        self.path.rsplit('/').next()?.parse().ok()
    }

    /// The session in which its own is.
    fn above(&self) -> &str {
        self.path.rsplit_once('/').map_or("", |(above, _)| above)
    }

    /// The channel of all robots' states, if it has a number.
    fn status(&self) -> Option<String> {
        self.unit().map(|_| format!("{}/status", self.above()))
    }
}

/// Has a robot obey at the hub, until `shutdown` is done. Then it stands, and its driver is waited for, a second at most.
///
/// What is missing of its contexts is made first; a robot with a number is told of in the fleet's channel of all states, too. When its
/// channel is gone, as it was deleted or the hub began anew, the robot stands until that is back, and makes it if it can.
///
/// # Errors
///
/// A context that cannot be made or joined at the beginning, or a connection that is closed for good. The robot stands then, too.
pub fn run(
    client: Client,
    rover: Rover,
    options: RoverOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    Box::pin(run_until(client, rover, options, Box::pin(shutdown)))
}

async fn run_until(
    client: Client,
    rover: Rover,
    options: RoverOptions,
    shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let begin = Instant::now();
    let mut rover = rover;
    let ended = live(&client, &mut rover, &options, begin, pin!(shutdown)).await;
    stand(&mut rover, begin).await;
    client.close().await;
    ended
}

async fn live(
    client: &Client,
    rover: &mut Rover,
    options: &RoverOptions,
    begin: Instant,
    mut shutdown: Pin<&mut impl Future<Output = ()>>,
) -> Result<(), ClientError> {
    let card = card(rover);
    let mut channel = enter_robot(client, options, &card).await?;
    // The contexts that it speaks to, and hears, stay joined for as long as these live.
    let mut joined = JoinSet::new();
    let (hand, mut hear) = mpsc::channel(MOST_POSES);
    for (path, kind, hand) in [
        (options.status(), Kind::Status, None),
        (options.tell.clone(), Kind::Channel, None),
        (options.hear.clone(), Kind::Channel, Some(hand)),
    ] {
        if let Some(path) = path {
            let first = join(client.clone(), path.clone(), kind).await?;
            let client = client.clone();
            let hand_on = move |event| {
                if let Some(hand) = &hand {
                    // Poses that nobody looks at in time are old.
                    let _ = hand.try_send(event);
                }
            };
            joined.spawn(stay(
                first,
                move || join(client.clone(), path.clone(), kind),
                hand_on,
            ));
        }
    }
    loop {
        let ended = obey(
            client,
            &channel,
            rover,
            options,
            begin,
            &mut hear,
            shutdown.as_mut(),
        )
        .await;
        let Ended::Gone(why) = ended else {
            return Ok(());
        };
        tracing::warn!(
            path = options.path,
            why,
            "the robot could not join its channel as a device; it stands until it has joined"
        );
        let back = come_back(|| enter_robot(client, options, &card));
        let mut back = pin!(back);
        channel = loop {
            let wake = rover.next_wake().map(|due| instant_of(begin, due));
            tokio::select! {
                biased;
                () = &mut shutdown => return Ok(()),
                () = sleep_or_wait(wake) => rover.advance(time_since(begin)),
                entered = &mut back => break entered?,
            }
        };
    }
}

/// Why a robot obeys no more.
enum Ended {
    Shutdown,
    /// It was put out, or its channel is gone.
    Gone(String),
}

/// Has it obey in its channel; afterwards it was told to stand.
async fn obey(
    client: &Client,
    channel: &Channel,
    rover: &mut Rover,
    options: &RoverOptions,
    begin: Instant,
    hear: &mut mpsc::Receiver<Event>,
    mut shutdown: Pin<&mut impl Future<Output = ()>>,
) -> Ended {
    let device = DevicePeer::start(client, channel, rover.again(), begin);
    let mut device = match options.pull {
        Some(wait) => device.pulling(wait),
        None => device,
    };
    let mut teller = Teller::new(options, device.state(), begin);
    let mut outlet = Outlet::new(sender(client));
    tracing::info!(peer = client.name(), channel = %channel.path(), "the robot is ready");
    let ended = loop {
        if device.machine().has_failed() {
            let mut failure = None;
            device.note(|rover| failure = rover.take_failure());
            if let Some(error) = failure {
                tracing::warn!(%error, "the robot stands");
                device.fail(&error);
            }
        }
        let pose = teller.tell(&mut device);
        let status = teller.tell_status(&device, channel);
        let due = pose.into_iter().chain(status).min();
        outlet.set_down(device.is_down());
        outlet.push(&mut teller.out);
        tokio::select! {
            biased;
            () = &mut shutdown => break Ended::Shutdown,
            more = device.step() => if !more { break Ended::Gone(device.why_gone()) },
            Some(event) = hear.recv() => hear_pose(client, &mut device, &event),
            () = outlet.work() => {}
            () = sleep_or_wait(due) => {}
        }
    };
    let why = match &ended {
        Ended::Shutdown => "its program ends",
        Ended::Gone(why) => why,
    };
    device.halt(why);
    *rover = device.machine().again();
    stand(rover, begin).await;
    if matches!(ended, Ended::Shutdown) {
        device.end(why).await;
    }
    ended
}

/// Makes what is missing of the robot's own contexts, and joins its channel as its device.
async fn enter_robot(client: &Client, options: &RoverOptions, card: &Card) -> Result<Channel, ClientError> {
    let above = options.above();
    if !above.is_empty() {
        ensure_session(client, above).await?;
    }
    let token = format!("{}/token", options.path);
    enter(client, &options.path, &token, options.manager.as_deref(), card).await
}

/// Who makes a channel beside its own.
#[derive(Debug, Clone, Copy)]
enum Kind {
    /// The first that comes.
    Status,
    /// Another peer.
    Channel,
}

async fn join(client: Client, path: String, kind: Kind) -> Result<Channel, ClientError> {
    match kind {
        Kind::Status => enter_status(&client, &path).await,
        Kind::Channel => client.channel(&path).await,
    }
}

/// What it says beside its device's answers.
struct Teller {
    /// Where it tells its pose, and when next.
    pose: Option<(Path, Instant)>,
    status: Option<StatusTeller>,
    /// The state at rest that it told last.
    told: State,
    out: Vec<Parcel>,
}

impl Teller {
    fn new(options: &RoverOptions, state: State, begin: Instant) -> Self {
        let path = |text: &String| Path::parse(text).ok();
        let status = options.status().as_ref().and_then(path).zip(options.unit());
        Self {
            pose: options
                .tell
                .as_ref()
                .and_then(path)
                .map(|channel| (channel, begin)),
            status: status.map(|(channel, unit)| StatusTeller::new(channel, unit, None)),
            told: state,
            out: Vec::new(),
        }
    }

    /// Tells the fleet of it; when to look again.
    fn tell_status(&mut self, device: &DevicePeer<Rover>, channel: &Channel) -> Option<Instant> {
        let status = self.status.as_mut()?;
        let told = status.tell(|| device.state(), || channel.gate().guard(), Instant::now());
        self.out.extend(told);
        status.due(device.machine().is_moving())
    }

    /// Tells what is due; when to look again.
    fn tell(&mut self, device: &mut DevicePeer<Rover>) -> Option<Instant> {
        let state = device.state();
        // While it moves it is told of by itself.
        let differs = self.told.position != state.position || self.told.report != state.report;
        if state.moving != self.told.moving || (differs && !state.moving) {
            device.report();
            self.told = state.clone();
        }
        let now = Instant::now();
        let (channel, due) = self.pose.as_mut()?;
        if *due <= now {
            // Where it is now, and not when it steered last.
            device.note(|_| {});
            if let Some(pose) = device.machine().pose() {
                let mut parcel = Parcel::new(Family::Message, POSE)
                    .context(channel.clone())
                    .content(pose);
                (parcel.delivery, parcel.echo) = (Some(Delivery::Latest), Some(false));
                self.out.push(parcel);
            }
            *due = now + if state.moving { MOVING } else { STANDING };
        }
        // One that begins to move tells it more often at once.
        if state.moving {
            *due = (*due).min(now + MOVING);
        }
        Some(*due)
    }
}

/// Hands on where another robot says that it is.
fn hear_pose(client: &Client, device: &mut DevicePeer<Rover>, event: &Event) {
    let Event::Message(parcel) = event else { return };
    let (POSE, Some(peer)) = (parcel.name(), parcel.sender.as_deref()) else {
        return;
    };
    let content = parcel.value();
    let number = |key| content.get(key).and_then(Value::as_int);
    if let (Some(x), Some(y)) = (number("x"), number("y")) {
        let age = client.clock().age(parcel);
        device.note(|rover| rover.heard(peer, Point::new(x as f64, y as f64), age));
    }
}
