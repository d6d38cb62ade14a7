//! Mirrored robots as devices of the hub.

use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use mom_client::{
    Boxed, Card, Channel, Client, ClientError, Delivery, Event, Events, Family, Map, Parcel, Time, Value,
};
use mom_device::{DevicePeer, Machine as _, Outlet, State, card, sender, time_since};
use mom_rsp::Kind;
use mom_rsp::middle::Notice;
use mom_wheeled::{StatusTeller, come_back, ensure_session, enter, enter_status};
use mom_wheels::Chassis;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, sleep_until};

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
/// What is missing of their contexts is made first. A robot one of whose channels is gone, as it was deleted or the hub began anew, stands
/// until that is back, and the others go on.
///
/// # Errors
///
/// A context that cannot be made or joined at the beginning, or a connection that is closed for good.
pub fn run(
    client: Client,
    lines: Vec<RobotLine>,
    options: SimulacrumOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    Box::pin(run_until(client, lines, options, Box::pin(shutdown)))
}

async fn run_until(
    client: Client,
    lines: Vec<RobotLine>,
    options: SimulacrumOptions,
    shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let (stop, stopping) = watch::channel(false);
    let begin = Instant::now();
    let mut robots = JoinSet::new();
    for line in lines {
        let machine = Mirror::new(line.robot.clone(), line.chassis, line.unit());
        let site = RobotSite {
            client: client.clone(),
            line,
            options: options.clone(),
            begin,
            card: card(&machine),
        };
        let robot = Robot::enter(&site, machine).await?;
        robots.spawn(live(site, robot, stopping.clone()));
    }
    tracing::info!(
        peer = client.name(),
        robots = robots.len(),
        "the robots are devices of the hub"
    );
    let mut result = Ok(());
    let mut shutdown = pin!(shutdown);
    while result.is_ok() || !robots.is_empty() {
        tokio::select! {
            () = &mut shutdown => break,
            ended = robots.join_next(), if !robots.is_empty() => match ended {
                Some(Ok(Err(error))) => result = Err(error),
                Some(Err(error)) => tracing::error!(%error, "a robot's task has failed"),
                Some(Ok(Ok(()))) | None => {}
            },
        }
    }
    let _ = stop.send(true);
    while robots.join_next().await.is_some() {}
    client.close().await;
    result
}

impl RobotLine {
    /// Its number in a fleet, if its session has one for a name.
    fn unit(&self) -> Option<u32> {
        self.path.rsplit_once('/')?.1.parse().ok()
    }
}

/// One robot for as long as its gateway lives, in its channels and without them.
async fn live(
    site: RobotSite,
    mut robot: Robot,
    mut stopping: watch::Receiver<bool>,
) -> Result<(), ClientError> {
    loop {
        let machine = match robot.drive(&mut stopping).await {
            Some(machine) => machine,
            None => return Ok(()),
        };
        tracing::warn!(robot = site.line.robot.name(), path = %site.line.path, "a channel of the robot is gone; it stands until that is back");
        match site.come_back(machine, &mut stopping).await? {
            Some(back) => robot = back,
            None => return Ok(()),
        }
    }
}

/// Where a robot is at the hub.
struct RobotSite {
    client: Client,
    line: RobotLine,
    options: SimulacrumOptions,
    /// When the time of its machine began.
    begin: Instant,
    card: Card,
}

impl RobotSite {
    /// Makes what is missing of the robot's contexts, and joins its channel as its device.
    async fn enter(&self) -> Result<Channel, ClientError> {
        let path = &self.line.path;
        if let Some((above, _)) = path.rsplit_once('/').filter(|(above, _)| !above.is_empty()) {
            ensure_session(&self.client, above).await?;
        }
        let token = format!("{path}/token");
        enter(
            &self.client,
            path,
            &token,
            self.options.manager.as_deref(),
            &self.card,
        )
        .await
    }

    /// Keeps the robot standing until its channels are back; none if the program stops before.
    async fn come_back(
        &self,
        mut machine: Mirror,
        stopping: &mut watch::Receiver<bool>,
    ) -> Result<Option<Robot>, ClientError> {
        let mut notices = self.line.robot.notices();
        loop {
            let mut back = pin!(come_back(|| self.enter()));
            let entered = loop {
                tokio::select! {
                    biased;
                    _ = stopping.wait_for(|stop| *stop) => return Ok(None),
                    notice = notices.recv() => if let Ok(notice) = notice {
                        // Nothing is under way that could fail.
                        let _ = machine.heard(&notice);
                    },
                    entered = &mut back => break entered,
                    () = sleep(LOOK) => {}
                }
                machine.advance(time_since(self.begin));
            };
            entered?;
            match Robot::enter(self, machine.again()).await {
                Ok(robot) => return Ok(Some(robot)),
                Err(ClientError::Closed(why)) => return Err(ClientError::Closed(why)),
                Err(error) => tracing::debug!(%error, "a channel is not back"),
            }
        }
    }
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
    async fn enter(site: &RobotSite, machine: Mirror) -> Result<Robot, ClientError> {
        let RobotSite { client, line, .. } = site;
        let (robot, path, unit) = (line.robot.clone(), &line.path, line.unit());
        let channel = site.enter().await?;
        let mirror = enter_status(client, &format!("{path}/simulacrum")).await?;
        let mut blobs = Vec::new();
        for (place, element) in (0..).zip(robot.model().elements()) {
            if element.kind == Kind::Sensor && matches!(element.payload, mom_rsp::Payload::Bytes(_)) {
                let channel = enter_status(client, &format!("{path}/{}", element.name)).await?;
                blobs.push((place, channel));
            }
        }
        let above = path.rsplit_once('/').unwrap_or_default().0;
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
        let device = DevicePeer::start(client, &channel, machine, site.begin);
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

    /// Obeys until the program stops, or a channel is gone: then the robot as it is, told to stand.
    async fn drive(mut self, stopping: &mut watch::Receiver<bool>) -> Option<Mirror> {
        let mut outlet = Outlet::new(sender(&self.client));
        let trouble = self.robot.trouble();
        let session = trouble.as_deref().unwrap_or("up");
        tracing::info!(robot = self.robot.name(), channel = %self.channel.path(), mirror = %self.mirror.path(), session, "a robot has joined the hub");
        // Its session may be older than its place at the hub.
        if self.robot.is_up() {
            self.hear(&Notice::Up);
        }
        let is_gone = loop {
            self.fail_if_failed();
            let due = self.tell();
            // What cannot be sent is not tried again and again.
            outlet.set_down(self.device.is_down());
            outlet.push(&mut self.out);
            tokio::select! {
                biased;
                _ = stopping.wait_for(|stop| *stop) => break false,
                more = self.device.step() => if !more { break true },
                notice = self.notices.recv() => match notice {
                    Ok(notice) => self.hear(&notice),
                    // What was heard is in the mirror; a command whose end was missed is not known to be done.
                    Err(RecvError::Lagged(missed)) => {
                        let text = format!("{missed} notices of the robot were missed");
                        self.device.fail(&mom_device::DeviceError::new(mom_device::ErrorName::Link, text));
                    }
                    Err(RecvError::Closed) => break false,
                },
                // One at a time: what takes long must not take all.
                event = self.asked.next(), if self.made.is_empty() => match event {
                    Some(event) => self.make(event),
                    None => break true,
                },
                Some(Ok(answer)) = self.made.join_next() => self.out.push(answer),
                () = outlet.work() => {}
                () = sleep_until(due) => {}
            }
        };
        // It takes its safe values, whatever becomes of its gateway.
        let why = if is_gone {
            "its channel is gone"
        } else {
            "its gateway ends"
        };
        self.device.halt(why);
        let machine = is_gone.then(|| self.device.machine().again());
        self.device.end(why).await;
        machine
    }

    fn hear(&mut self, notice: &Notice) {
        match notice {
            Notice::Up => tracing::info!(robot = self.robot.name(), "the robot has a session"),
            Notice::Lost => tracing::warn!(robot = self.robot.name(), "the robot is lost"),
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
        if !self.device.machine().has_failed() {
            return;
        }
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
