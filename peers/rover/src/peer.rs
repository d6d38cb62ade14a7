//! The robot as a peer: its contexts, and the channel in which robots tell each other where they are.

use std::future::{Future, pending};
use std::pin::pin;
use std::time::Duration;

use mom_client::{Channel, Client, ClientError, Delivery, Event, Events, Family, Parcel, Path, Value};
use mom_device::{DevicePeer, Machine as _, Outlet, State, sender};
use mom_fleet::{StatusTeller, ensure_session, enter, enter_status};
use mom_wheels::pilot::Point;
use tokio::time::{Instant, sleep_until};

use crate::Rover;

/// The message by which a robot tells where it is: `{x, y, heading}`, mm, mm, degrees.
pub const POSE: &str = "pose";
/// So often it tells while it moves, and while it stands: who follows it has to know that it does.
const MOVING: Duration = Duration::from_millis(100);
const STANDING: Duration = Duration::from_millis(250);

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
}

/// Has a robot obey at the hub, until `shutdown` is done. Then it stands.
///
/// What is missing of its contexts is made first; a robot with a number is told of in the fleet's channel of all states, too.
///
/// # Errors
///
/// A context that cannot be made or joined, or a connection that is closed for good.
pub async fn run(
    client: Client,
    rover: Rover,
    options: RoverOptions,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let path = options.path.as_str();
    let above = path.rsplit_once('/').map_or("", |(above, _)| above);
    if !above.is_empty() {
        ensure_session(&client, above).await?;
    }
    let token = format!("{path}/token");
    let channel = enter(&client, path, &token, options.manager.as_deref()).await?;
    // Joined for as long as these live.
    let status = match options.unit() {
        Some(unit) => Some((enter_status(&client, &format!("{above}/status")).await?, unit)),
        None => None,
    };
    let tell = match &options.tell {
        Some(path) => Some(client.channel(path).await?),
        None => None,
    };
    let mut hear = match &options.hear {
        Some(path) => Some(client.channel(path).await?.events()),
        None => None,
    };
    let begin = Instant::now();
    let device = DevicePeer::start(&client, &channel, rover, begin);
    let mut device = match options.pull {
        Some(wait) => device.pulling(wait),
        None => device,
    };
    let mut teller = Teller {
        pose: tell.as_ref().map(|channel| (channel.path().clone(), begin)),
        status: status
            .as_ref()
            .map(|(channel, unit)| StatusTeller::new(channel.path().clone(), *unit, None)),
        told: device.state(),
        out: Vec::new(),
    };
    let mut outlet = Outlet::new(sender(&client));
    tracing::info!(peer = client.name(), channel = %channel.path(), "the robot is ready");
    let mut shutdown = pin!(shutdown);
    loop {
        if device.machine().has_failed() {
            let mut failure = None;
            device.note(|rover| failure = rover.take_failure());
            if let Some(error) = failure {
                tracing::warn!(%error, "the robot stands");
                device.fail(&error);
            }
        }
        let pose = teller.tell(&mut device);
        let status = teller.tell_status(&device, &channel);
        let due = pose.into_iter().chain(status).min();
        outlet.set_down(device.is_down());
        outlet.push(&mut teller.out);
        tokio::select! {
            biased;
            () = &mut shutdown => break,
            more = device.step() => if !more { break },
            event = next(&mut hear) => match event {
                Some(event) => hear_pose(&client, &mut device, &event),
                None => hear = None,
            },
            () = outlet.work() => {}
            () = sleep_or_wait(due) => {}
        }
    }
    device.end("its program ends").await;
    client.close().await;
    Ok(())
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

async fn next(events: &mut Option<Events>) -> Option<Event> {
    match events {
        Some(events) => events.next().await,
        None => pending().await,
    }
}

async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => pending().await,
    }
}
