//! The arm as a peer: joins its channel and connects it to the [`RobotServer`].

use std::future::{Future, pending};
use std::pin::pin;
use std::time::{Duration, SystemTime};

use mom_client::{Client, ClientError, Code, Consult, Event, FenceGate, LinkState, Parcel, Time, WireError};
use mom_device::{Outlet, sender};
use tokio::time::{Instant, sleep_until, timeout};

use crate::arm::Arm;
use crate::blocks::Block;
use crate::controller::{LinkFault, Simulated};
use crate::motion::ArmTime;
use crate::server::RobotServer;
use crate::zone_watch::{ZoneEvent, ZoneWatch};
use crate::zones::{Mount, Zones};

/// How long the last statuses may take to leave when the program ends.
const FAREWELL: Duration = Duration::from_secs(1);

/// The channel of the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmOptions {
    /// The channel of its commands and states; its session is joined first.
    pub channel: String,
    /// How old a command may be when it begins, whatever its sender says; none: as old as it likes.
    pub max_age: Option<Duration>,
    /// A fault of the simulated link between the program and the controller (M53), to try what happens then.
    pub link_fault: Option<LinkFault>,
    /// The session whose tokens are zones that the arm shares with other machines (M40); none: it has the table for itself.
    pub zones: Option<String>,
    /// Where the arm's table is in the frame of the zones.
    pub mount: Mount,
    /// How many times as fast as real time the simulated arm's time passes: 1 to 100.
    pub pace: u32,
}

impl Default for ArmOptions {
    /// The lab's: `/robot/arm`.
    fn default() -> Self {
        Self {
            channel: "/robot/arm".to_owned(),
            max_age: None,
            link_fault: None,
            zones: None,
            mount: Mount::default(),
            pace: 1,
        }
    }
}

impl ArmOptions {
    /// The controller of the lab's simulated arm, on its table.
    #[must_use]
    pub fn controller(&self) -> Simulated {
        let controller = Simulated::new(0, Block::lab());
        match self.link_fault {
            Some(fault) => controller.failing(fault),
            None => controller,
        }
    }
}

/// Runs the lab's simulated arm until `shutdown` is done, as [`run_arm`] does.
///
/// A lost link halts the arm; the client connects again by itself, and the arm goes on with the next command.
///
/// ```no_run
/// use mom_arm::{ArmOptions, peer};
/// use mom_client::Client;
///
/// # async fn example() -> Result<(), mom_client::ClientError> {
/// let client = Client::builder("bin://127.0.0.1:7666").user("arm").password("arm").connect().await?;
/// peer::run(client, ArmOptions::default(), std::future::pending()).await?;
/// # Ok(())
/// # }
/// ```
///
/// # Errors
///
/// [`ClientError`] if the channel cannot be joined or the connection is closed for good.
pub async fn run(
    client: Client,
    options: ArmOptions,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let arm = Arm::with_controller(0, Box::new(options.controller()));
    run_arm(client, options, arm, shutdown).await
}

/// Runs an arm, with whatever controller it has, until `shutdown` is done. Then it halts, reports that, and logs out. Its time begins at 0.
///
/// # Errors
///
/// As [`run`].
pub async fn run_arm(
    client: Client,
    options: ArmOptions,
    arm: Arm,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let channel = client.channel_as_device(&options.channel).await?;
    let (mut events, gate) = (channel.events(), channel.gate());
    let mut zones = match &options.zones {
        Some(session) => Some(ZoneWatch::join(&client, session).await?),
        None => None,
    };
    let clock = ArmClock::start(options.pace);
    let mut server = RobotServer::new(arm, channel.path().clone()).starting_at(time_of_day());
    server.set_name(client.name());
    if let Some(max_age) = options.max_age {
        server = server.with_max_age(max_age);
    }
    server = server.at_pace(options.pace.clamp(1, 100));
    let mut outlet = Outlet::new(sender(&client));
    let mut out = Vec::new();
    if zones.is_some() {
        server = server.in_zones(Zones::new(options.mount));
        server.learn_commander(&gate, 0, &mut out);
    }
    let mut shutdown = pin!(shutdown);
    server.report(&mut out);
    tracing::info!(peer = client.name(), channel = %channel.path(), "the arm is ready");
    // Whatever ends it, the arm is halted.
    let result = loop {
        outlet.push(&mut out);
        let wake = server.next_wake().map(|due| clock.at(due));
        tokio::select! {
            () = &mut shutdown => break Ok(()),
            event = zone_event(&mut zones) => {
                let Some(event) = event else { break Err(ended(&client)) };
                handle_zone(&mut server, &event, &gate, clock.now(), &mut out);
            }
            event = events.next() => match event {
                Some(event) => {
                    // What the hub told of zones before is heard first: who grabs a zone may use it at once.
                    let mut are_gone = false;
                    while let (false, Some(event)) = (are_gone, ready(zone_event(&mut zones)).await) {
                        match event {
                            Some(event) => handle_zone(&mut server, &event, &gate, clock.now(), &mut out),
                            None => are_gone = true,
                        }
                    }
                    if are_gone {
                        break Err(ended(&client));
                    }
                    log(&event);
                    let age = match &event {
                        Event::Message(parcel) => client.clock().age(parcel),
                        _ => None,
                    };
                    server.handle(&event, &gate, age, clock.now(), &mut out);
                    match event {
                        Event::LinkDown => outlet.set_down(true),
                        Event::Rejoined | Event::Resumed => outlet.set_down(false),
                        _ => {}
                    }
                }
                None => break Err(ended(&client)),
            },
            () = sleep_or_wait(wake) => server.advance(clock.now(), &mut out),
            () = outlet.work() => {}
        }
    };
    server.halt("its program ends", clock.now(), &mut out);
    outlet.push(&mut out);
    if timeout(FAREWELL, outlet.flush()).await.is_err() {
        tracing::warn!("the last messages did not leave in time");
    }
    client.close().await;
    result
}

/// Waits for news of the zones, if there are any.
async fn zone_event(zones: &mut Option<ZoneWatch>) -> Option<ZoneEvent> {
    match zones {
        Some(zones) => zones.next().await,
        None => pending().await,
    }
}

/// What a future gives at once, if it does.
async fn ready<T>(future: impl Future<Output = T>) -> Option<T> {
    tokio::select! {
        biased;
        value = future => Some(value),
        () = std::future::ready(()) => None,
    }
}

fn handle_zone(
    server: &mut RobotServer,
    event: &ZoneEvent,
    gate: &FenceGate,
    now: ArmTime,
    out: &mut Vec<Parcel>,
) {
    match event {
        ZoneEvent::News(news) => server.handle_zones(news, now, out),
        ZoneEvent::Question(consult) => {
            let answer = server.grant(&consult.context, &consult.peer, gate, now, out);
            tokio::spawn(answer_question(consult.clone(), answer));
        }
    }
}

async fn answer_question(consult: Consult, answer: Result<(), String>) {
    let answered = match answer {
        Ok(()) => consult.allow().await,
        Err(why) => consult.deny(&why).await,
    };
    if let Err(error) = answered {
        tracing::warn!(%error, "an answer about a zone did not arrive");
    }
}

fn log(event: &Event) {
    match event {
        Event::Refused(error, reference) => tracing::warn!(%error, reference, "the hub refused a message"),
        Event::Lagged(count) => tracing::error!(count, "events were lost; the arm stops"),
        Event::LinkDown => tracing::warn!("the link is lost; the arm halts"),
        Event::Rejoined => tracing::info!("joined again"),
        Event::Resumed => tracing::info!("the link goes on; the arm is at rest"),
        event => tracing::debug!(?event),
    }
}

/// Why there are no more events.
fn ended(client: &Client) -> ClientError {
    match &*client.state().borrow() {
        LinkState::Closed(error) => ClientError::Closed(error.clone()),
        _ => WireError::new(
            Code::UNKNOWN_PATH,
            "the hub deleted the arm's channel, or its zones",
        )
        .into(),
    }
}

async fn sleep_or_wait(wake: Option<Instant>) {
    match wake {
        Some(wake) => sleep_until(wake).await,
        None => pending().await,
    }
}

fn time_of_day() -> Time {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    let micros = since.ok().and_then(|since| i64::try_from(since.as_micros()).ok());
    micros.and_then(Time::from_micros).unwrap_or_default()
}

/// The arm's time.
struct ArmClock {
    begin: Instant,
    pace: u32,
}

impl ArmClock {
    fn start(pace: u32) -> ArmClock {
        ArmClock {
            begin: Instant::now(),
            pace: pace.clamp(1, 100),
        }
    }

    fn now(&self) -> ArmTime {
        let micros = self.begin.elapsed().as_micros() * u128::from(self.pace);
        ArmTime::try_from(micros).unwrap_or(ArmTime::MAX)
    }

    fn at(&self, due: ArmTime) -> Instant {
        let micros = u64::try_from(due).unwrap_or(0);
        self.begin + Duration::from_micros(micros.div_ceil(self.pace.into()))
    }
}
