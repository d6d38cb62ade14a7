//! The gateway as a peer: each robot's contexts, and the robot between its channel and its wire.

use std::future::{Future, pending};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use mom_brs::file::EXTENDED;
use mom_brs::{Code, Frame, Table};
use mom_client::{Channel, Client, ClientError, Parcel};
use mom_device::{DeviceError, DevicePeer, ErrorName, Machine as _, Outlet, sender};
use mom_fleet::{StatusTeller, ensure_session, enter, enter_status};
use tokio::sync::watch;
use tokio::task::{JoinSet, yield_now};
use tokio::time::{Instant, sleep_until};

use crate::Unit;
use crate::station::Heard;

/// Robots of one connection. Each of them has its peer join a session, a token and a channel, and a peer joins 1024 contexts, unless
/// the hub's file says otherwise.
const ROBOTS_PER_CONNECTION: usize = 256;

/// How many connections to the hub so many robots need.
#[must_use]
pub fn connections(robots: usize) -> usize {
    robots.div_ceil(ROBOTS_PER_CONNECTION).max(1)
}

/// What a gateway makes of its robots at the hub.
#[derive(Debug, Clone)]
pub struct GatewayOptions {
    /// The session of the fleet: robot 7 is `/fleet/7`, with a channel `robot` and a token `token`; the token of a group is `/fleet/GROUP/token`.
    pub session: String,
    /// One token for all robots of this gateway, which are driven together; none: each group and each robot of none has its own.
    /// A token guards 256 channels at most.
    pub together: Option<String>,
    /// The manager of tokens that are made, by its name in the hub's configuration; none: that of the session.
    pub manager: Option<String>,
    /// The commands that the robots know.
    pub table: &'static Table,
}

impl Default for GatewayOptions {
    /// `/fleet`, a token for each robot with the manager of the session, and all commands of ours.
    fn default() -> Self {
        Self {
            session: "/fleet".to_owned(),
            together: None,
            manager: None,
            table: &EXTENDED,
        }
    }
}

impl GatewayOptions {
    /// The channel of a robot's commands and states.
    #[must_use]
    pub fn channel(&self, unit: u32) -> String {
        format!("{}/{unit}/robot", self.session)
    }

    /// The token of a robot: that of all, that of its group, or its own.
    #[must_use]
    pub fn token(&self, unit: u32, group: Option<&str>) -> String {
        match (&self.together, group) {
            (Some(token), _) => token.clone(),
            (None, Some(group)) => format!("{}/{group}/token", self.session),
            (None, None) => format!("{}/{unit}/token", self.session),
        }
    }

    /// The channel in which every robot's newest state is.
    #[must_use]
    pub fn status(&self) -> String {
        format!("{}/status", self.session)
    }
}

/// What is heard of a robot over its wire.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum News {
    /// It takes commands.
    Linked,
    /// It does not any more, for this reason.
    Lost(String),
    /// It has said this.
    Reply(Frame),
}

/// The wire to one robot.
pub struct RobotWire {
    /// The robot's number.
    pub unit: u32,
    /// With whom it is driven together.
    pub group: Option<String>,
    /// What is heard of it, in order.
    pub(crate) heard: Heard,
    /// Sends it a frame; why it was not sent.
    pub send: Box<dyn Fn(Frame) -> Result<(), String> + Send + Sync>,
    /// Ends its connection, and drops what is under way on it.
    pub give_up: Box<dyn Fn() + Send + Sync>,
}

/// Has the robots of these lines obey at the hub, until `shutdown` is done. Then they stand.
///
/// What is missing of their contexts is made first. There are as many clients as [`connections`] says; they share the robots.
///
/// # Errors
///
/// A context that cannot be made or joined, or a connection that is closed for good.
pub async fn run(
    clients: Vec<Client>,
    lines: Vec<RobotWire>,
    options: GatewayOptions,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let Some(first) = clients.first() else {
        return Err(ClientError::Connection(
            "the gateway has no connection".to_owned(),
        ));
    };
    ensure_session(first, &options.session).await?;
    // Each stays in it for as long as this is kept.
    let mut statuses = Vec::with_capacity(clients.len());
    for client in &clients {
        statuses.push(enter_status(client, &options.status()).await?);
    }
    let (stop, stopping) = watch::channel(false);
    let mut robots = JoinSet::new();
    let begin = Instant::now();
    let missing = Arc::new(AtomicUsize::new(lines.len()));
    let share = lines.len().div_ceil(clients.len()).max(1);
    for (line, number) in lines.into_iter().zip(0..) {
        let at = number / share;
        let (Some(client), Some(status)) = (clients.get(at), statuses.get(at)) else {
            continue;
        };
        let (path, token) = (
            format!("{}/{}", options.session, line.unit),
            options.token(line.unit, line.group.as_deref()),
        );
        if let Some(group) = &line.group {
            ensure_session(client, &format!("{}/{group}", options.session)).await?;
        }
        let channel = enter(client, &path, &token, options.manager.as_deref()).await?;
        let robot = Robot {
            device: DevicePeer::start(client, &channel, Unit::new(line.unit, options.table), begin),
            status: StatusTeller::new(status.path().clone(), line.unit, line.group.clone()),
            client: client.clone(),
            channel,
            line,
            missing: Some(Arc::clone(&missing)),
        };
        robots.spawn(robot.drive(stopping.clone()));
    }
    tracing::info!(peer = first.name(), connections = clients.len(), robots = robots.len(), session = %options.session, "the gateway is ready");
    let mut shutdown = pin!(shutdown);
    tokio::select! {
        () = &mut shutdown => {}
        // None ends by itself while the hub has its channel.
        Some(_) = robots.join_next() => tracing::warn!("a robot's channel is gone"),
    }
    let _ = stop.send(true);
    while robots.join_next().await.is_some() {}
    drop(statuses);
    for client in clients {
        client.close().await;
    }
    Ok(())
}

/// A robot between its channel and its wire.
struct Robot {
    device: DevicePeer<Unit>,
    status: StatusTeller,
    client: Client,
    channel: Channel,
    line: RobotWire,
    /// How many have never been there, until this one is.
    missing: Option<Arc<AtomicUsize>>,
}

impl Robot {
    async fn drive(mut self, mut stopping: watch::Receiver<bool>) {
        // A hub that takes nothing holds up neither stops nor replies.
        let mut outlet = Outlet::new(sender(&self.client));
        loop {
            self.send();
            if self.device.machine().has_to_send() {
                // What has been said goes out before more is, which would have no place otherwise.
                yield_now().await;
                continue;
            }
            let mut out = Vec::new();
            let told = self.tell(&mut out);
            outlet.set_down(self.device.is_down());
            outlet.push(&mut out);
            tokio::select! {
                biased;
                _ = stopping.wait_for(|stop| *stop) => break,
                more = self.device.step() => if !more { break },
                news = self.line.heard.next() => match news {
                    Some(news) => {
                        self.hear(news);
                        // Replies that have come together are taken together.
                        while let Some(news) = self.line.heard.ready() {
                            self.hear(news);
                        }
                    }
                    None => break,
                },
                () = outlet.work() => {}
                () = sleep_or_wait(told) => {}
            }
        }
        // It stands, whatever becomes of its gateway.
        self.device.halt("its gateway ends");
        self.send();
        self.device.end("its gateway ends").await;
    }

    fn hear(&mut self, news: News) {
        match news {
            News::Linked => {
                tracing::info!(unit = self.line.unit, "the robot is connected");
                self.device.note(Unit::linked);
                self.device.report();
                let missing = self.missing.take();
                if missing.is_some_and(|missing| missing.fetch_sub(1, Ordering::Relaxed) == 1) {
                    tracing::info!("all robots are connected");
                }
            }
            News::Lost(why) => {
                tracing::warn!(unit = self.line.unit, why, "the robot is lost");
                self.device.note(Unit::lost);
                let text = format!("robot {} is lost: {why}", self.line.unit);
                self.device.fail(&DeviceError::new(ErrorName::Link, text));
            }
            News::Reply(reply) => {
                let before = self.device.machine().known();
                let mut heard = Ok(());
                self.device.note(|unit| heard = unit.heard(&reply));
                if let Err(error) = heard {
                    self.device.fail(&error);
                }
                // While it moves it is told of by itself.
                let machine = self.device.machine();
                if !machine.is_moving() && before != machine.known() {
                    self.device.report();
                }
            }
        }
    }

    /// Sends what its unit has for it.
    fn send(&mut self) {
        if self.device.machine().is_overdue() {
            self.device.note(Unit::given_up);
            tracing::warn!(unit = self.line.unit, "the robot moves and does not answer");
            (self.line.give_up)();
        }
        if !self.device.machine().has_to_send() {
            return;
        }
        let mut frames = Vec::new();
        self.device.note(|unit| frames = unit.to_send());
        for frame in frames {
            if let Err(why) = (self.line.send)(frame) {
                tracing::warn!(unit = self.line.unit, why, %frame, "a frame was not sent");
                self.device.note(|unit| unit.unsent(&frame));
                // What was to be done is not done. Questions are asked again, and a robot that does not stand is told so again.
                let stop = frame.code() == Code::MOTOR && frame.values() == [0, 0];
                if !stop && !matches!(frame.code(), Code::STATUS | Code::POSE) {
                    let text = format!("robot {} was not told to do it: {why}", self.line.unit);
                    self.device.fail(&DeviceError::new(ErrorName::Link, text));
                }
            }
        }
        self.device.note(Unit::sent);
    }

    /// What is to be told of it in the fleet's channel; when to look again.
    fn tell(&mut self, out: &mut Vec<Parcel>) -> Option<Instant> {
        let told = self.status.tell(
            || self.device.state(),
            || self.channel.gate().guard(),
            Instant::now(),
        );
        if let Some(mut parcel) = told {
            parcel.timestamp = self.device.known_time();
            out.push(parcel);
        }
        self.status.due(self.device.machine().is_moving())
    }
}

async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => pending().await,
    }
}
