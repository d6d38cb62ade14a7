//! Mirrored robots as devices of the hub.

use std::future::Future;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use mom_client::{Channel, Client, ClientError, Delivery, Event, Events, Family, Map, Parcel, Time, Value};
use mom_device::{DevicePeer, Outlet, State, sender, time_since};
use mom_fleet::{StatusTeller, ensure_session, enter, enter_status};
use mom_rsp::Kind;
use mom_rsp::middle::Notice;
use mom_wheels::Chassis;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until};

use crate::generator::{GENERATE, answer};
use crate::{Mirror, Simulacrum, Teller};

/// So often the mirror is looked at for what is to be told; packets come more often.
const LOOK: Duration = Duration::from_millis(50);

/// Where mirrored robots are at the hub.
#[derive(Debug, Clone, Default)]
pub struct SimulacrumOptions {
    /// The manager of tokens that are made, by its name in the hub's configuration; none: that of the session.
    pub manager: Option<String>,
}

/// One robot, and where it is at the hub.
#[derive(Debug, Clone)]
pub struct RobotLine {
    /// Its mirror, which [`serve`](crate::serve) connects to it.
    pub robot: Simulacrum,
    /// Its session, such as `/cubo`, with the channels `robot` and `simulacrum`, the token `token`, and a channel for each sensor of type
    /// bytes. One whose name is a number, such as `/fleet/12`, is told of in the fleet's channel of all states, too.
    pub path: String,
    /// Of what make its wheels are, if it has some.
    pub chassis: Chassis,
}

/// Has robots obey at the hub, until `shutdown` is done. Then they take their safe values.
///
/// What is missing of their contexts is made first.
///
/// # Errors
///
/// A context that cannot be made or joined, or a connection that is closed for good.
pub async fn run(
    client: Client,
    lines: Vec<RobotLine>,
    options: SimulacrumOptions,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let (stop, stopping) = watch::channel(false);
    let mut robots = JoinSet::new();
    for line in lines {
        let robot = Robot::enter(&client, line, &options).await?;
        robots.spawn(robot.drive(stopping.clone()));
    }
    tracing::info!(
        peer = client.name(),
        robots = robots.len(),
        "the robots are devices of the hub"
    );
    tokio::select! {
        () = shutdown => {}
        // None ends by itself while the hub has its channel.
        Some(_) = robots.join_next() => tracing::warn!("a robot's channel is gone"),
    }
    let _ = stop.send(true);
    while robots.join_next().await.is_some() {}
    client.close().await;
    Ok(())
}

/// A robot between its channels and its middle.
struct Robot {
    client: Client,
    robot: Simulacrum,
    notices: Receiver<Arc<Notice>>,
    device: DevicePeer<Mirror>,
    channel: Channel,
    /// Joined for as long as this lives.
    mirror: Channel,
    /// Who asks for code in it, one after the other.
    asked: Events,
    made: JoinSet<Parcel>,
    teller: Teller,
    status: Option<(Channel, StatusTeller)>,
    /// Where blobs of these elements go.
    blobs: Vec<(u8, Channel)>,
    told: State,
    /// When the mirror is looked at next.
    look: Instant,
    out: Vec<Parcel>,
}

impl Robot {
    async fn enter(
        client: &Client,
        line: RobotLine,
        options: &SimulacrumOptions,
    ) -> Result<Robot, ClientError> {
        let RobotLine { robot, path, chassis } = line;
        let (above, name) = path.rsplit_once('/').unwrap_or_default();
        let unit: Option<u32> = name.parse().ok();
        if !above.is_empty() {
            ensure_session(client, above).await?;
        }
        let token = format!("{path}/token");
        let channel = enter(client, &path, &token, options.manager.as_deref()).await?;
        let mirror = enter_status(client, &format!("{path}/simulacrum")).await?;
        let mut blobs = Vec::new();
        for (place, element) in (0..).zip(robot.model().elements()) {
            if element.kind == Kind::Sensor && matches!(element.payload, mom_rsp::Payload::Bytes(_)) {
                let channel = enter_status(client, &format!("{path}/{}", element.name)).await?;
                blobs.push((place, channel));
            }
        }
        let status = match unit {
            Some(unit) => {
                let channel = enter_status(client, &format!("{above}/status")).await?;
                let teller = StatusTeller::new(channel.path().clone(), unit, None);
                Some((channel, teller))
            }
            None => None,
        };
        // Before the first notice.
        let notices = robot.notices();
        let begin = Instant::now();
        let machine = Mirror::new(robot.clone(), chassis, unit).with_clock(move || time_since(begin));
        let device = DevicePeer::start(client, &channel, machine, begin);
        Ok(Robot {
            teller: Teller::new(mirror.path().clone()),
            told: device.state(),
            look: Instant::now(),
            client: client.clone(),
            robot,
            notices,
            device,
            channel,
            asked: mirror.events(),
            made: JoinSet::new(),
            mirror,
            status,
            blobs,
            out: Vec::new(),
        })
    }

    async fn drive(mut self, mut stopping: watch::Receiver<bool>) {
        let mut outlet = Outlet::new(sender(&self.client));
        tracing::info!(robot = self.robot.name(), channel = %self.channel.path(), mirror = %self.mirror.path(), "a robot is ready");
        // Its session may be older than its place at the hub.
        if self.robot.is_up() {
            self.hear(&Notice::Up);
        }
        loop {
            self.fail_if_failed();
            let due = self.tell();
            // What cannot be sent is not tried again and again.
            outlet.set_down(self.device.is_down());
            outlet.push(&mut self.out);
            tokio::select! {
                biased;
                _ = stopping.wait_for(|stop| *stop) => break,
                more = self.device.step() => if !more { break },
                notice = self.notices.recv() => match notice {
                    Ok(notice) => self.hear(&notice),
                    // What was heard is in the mirror; a command whose end was missed is not known to be done.
                    Err(RecvError::Lagged(missed)) => {
                        let text = format!("{missed} notices of the robot were missed");
                        self.device.fail(&mom_device::DeviceError::new(mom_device::ErrorName::Link, text));
                    }
                    Err(RecvError::Closed) => break,
                },
                // One at a time: what takes long must not take all.
                event = self.asked.next(), if self.made.is_empty() => match event {
                    Some(event) => self.make(event),
                    None => break,
                },
                Some(Ok(answer)) = self.made.join_next() => self.out.push(answer),
                () = outlet.work() => {}
                () = sleep_until(due) => {}
            }
        }
        // It takes its safe values, whatever becomes of its gateway.
        self.device.end("its gateway ends").await;
    }

    fn hear(&mut self, notice: &Notice) {
        match notice {
            Notice::Up => tracing::info!(robot = self.robot.name(), "the robot has a session"),
            Notice::Lost => tracing::warn!(robot = self.robot.name(), "the robot is lost"),
            Notice::Refused(refusal) => {
                tracing::warn!(robot = self.robot.name(), %refusal, "the robot refuses a session");
            }
            Notice::Raised { element, .. } => self.teller.raised(*element),
            Notice::Blob { element, bytes, .. } => self.hand_on(*element, bytes),
            _ => {}
        }
        let mut heard = Ok(());
        self.device.note(|mirror| heard = mirror.heard(notice));
        if let Err(error) = heard {
            self.device.fail(&error);
        }
        if matches!(notice, Notice::Up | Notice::Lost | Notice::Ended) {
            self.device.report();
        }
    }

    /// Has code made for who asks for it.
    fn make(&mut self, event: Event) {
        let Event::Message(ask) = event else { return };
        if ask.name() == GENERATE {
            let robot = self.robot.clone();
            self.made.spawn_blocking(move || answer(&ask, robot.model()));
        }
    }

    /// A picture is a message `image`, as a camera's is.
    fn hand_on(&mut self, element: u8, bytes: &[u8]) {
        let Some((_, channel)) = self.blobs.iter().find(|(place, _)| *place == element) else {
            return;
        };
        let (name, media) = match bytes.starts_with(&[0xff, 0xd8]) {
            true => ("image", "image/jpeg"),
            false => ("bytes", "application/octet-stream"),
        };
        let content = Map::new()
            .with("media-type", media)
            .with("image", Value::Binary(bytes.to_vec().into()));
        let mut parcel = Parcel::new(Family::Message, name)
            .context(channel.path().clone())
            .content(content);
        (parcel.priority, parcel.delivery) = (Some(-10), Some(Delivery::Latest));
        parcel.echo = Some(false);
        parcel.timestamp = self.robot.age().and_then(before_now);
        self.out.push(parcel);
    }

    fn fail_if_failed(&mut self) {
        let mut failure = None;
        self.device.note(|mirror| failure = mirror.take_failure());
        if let Some(error) = failure {
            tracing::warn!(robot = self.robot.name(), %error, "the robot rests");
            self.device.fail(&error);
        }
    }

    /// Tells what is due; when to look again.
    fn tell(&mut self) -> Instant {
        let now = Instant::now();
        let state = self.device.state();
        let differs = self.told.position != state.position || self.told.report != state.report;
        if state.moving != self.told.moving || (differs && !state.moving) {
            self.device.report();
            self.told = state.clone();
        }
        if self.look <= now {
            self.look = now + LOOK;
            let told = self.teller.tell(&self.robot, before_now, now);
            self.out.extend(told);
        }
        if let Some((_, teller)) = &mut self.status {
            let told = teller.tell(|| state, || self.channel.gate().guard(), now);
            if let Some(mut parcel) = told {
                parcel.timestamp = self.device.known_time();
                self.out.push(parcel);
            }
        }
        self.look
    }
}

/// The time so long ago.
fn before_now(age: Duration) -> Option<Time> {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).ok()?;
    let micros = since.checked_sub(age)?.as_micros();
    Time::from_micros(i64::try_from(micros).ok()?)
}
