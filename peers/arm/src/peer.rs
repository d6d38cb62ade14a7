//! The arm as a peer: joins its channel and connects it to the [`RobotServer`].

use std::future::{Future, pending};
use std::pin::pin;
use std::time::{Duration, SystemTime};

use mom_client::{Client, ClientError, Code, Event, LinkState, Parcel, Time, WireError};
use tokio::time::{Instant, sleep_until, timeout};

use crate::arm::Arm;
use crate::blocks::Block;
use crate::controller::{LinkFault, Simulated};
use crate::motion::ArmTime;
use crate::outlet::{Outlet, Sending};
use crate::server::RobotServer;

/// How long the last statuses may take to leave when the program ends.
const FAREWELL: Duration = Duration::from_secs(1);

/// The channel of the arm.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArmOptions {
    /// The channel of its commands and states; its session is joined first.
    pub channel: String,
    /// How old a command may be when it begins, whatever its sender says; none: as old as it likes.
    pub max_age: Option<Duration>,
    /// A fault of the simulated link between the program and the controller (M53), to try what happens then.
    pub link_fault: Option<LinkFault>,
}

impl Default for ArmOptions {
    /// The lab's: `/robot/arm`.
    fn default() -> Self {
        Self {
            channel: "/robot/arm".to_owned(),
            max_age: None,
            link_fault: None,
        }
    }
}

impl ArmOptions {
    /// The lab's simulated arm, on its table.
    fn arm(&self) -> Arm {
        let controller = Simulated::new(0, Block::lab());
        let controller = match self.link_fault {
            Some(fault) => controller.failing(fault),
            None => controller,
        };
        Arm::with_controller(0, Box::new(controller))
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
    let arm = options.arm();
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
    let begin = Instant::now();
    let mut server = RobotServer::new(arm, channel.path().clone()).starting_at(time_of_day());
    if let Some(max_age) = options.max_age {
        server = server.with_max_age(max_age);
    }
    let mut outlet = Outlet::new(sender(&client));
    let mut out = Vec::new();
    let mut shutdown = pin!(shutdown);
    server.report(&mut out);
    tracing::info!(peer = client.name(), channel = %channel.path(), "the arm is ready");
    loop {
        outlet.push(&mut out);
        let wake = server.next_wake().map(|due| begin + duration(due));
        tokio::select! {
            () = &mut shutdown => break,
            event = events.next() => match event {
                Some(event) => {
                    log(&event);
                    let age = match &event {
                        Event::Message(parcel) => client.clock().age(parcel),
                        _ => None,
                    };
                    server.handle(&event, &gate, age, micros(begin), &mut out);
                    match event {
                        Event::LinkDown => outlet.set_down(true),
                        Event::Rejoined | Event::Resumed => outlet.set_down(false),
                        _ => {}
                    }
                }
                None => return Err(ended(&client)),
            },
            () = sleep_or_wait(wake) => server.advance(micros(begin), &mut out),
            () = outlet.work() => {}
        }
    }
    server.halt("its program ends", micros(begin), &mut out);
    outlet.push(&mut out);
    if timeout(FAREWELL, outlet.flush()).await.is_err() {
        tracing::warn!("the last messages did not leave in time");
    }
    client.close().await;
    Ok(())
}

fn sender(client: &Client) -> impl Fn(Parcel) -> Sending + use<> {
    let client = client.clone();
    move |parcel| {
        let client = client.clone();
        Box::pin(async move { client.send(parcel).await })
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
        _ => WireError::new(Code::UNKNOWN_PATH, "the hub deleted the arm's channel").into(),
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

fn micros(begin: Instant) -> ArmTime {
    ArmTime::try_from(begin.elapsed().as_micros()).unwrap_or(ArmTime::MAX)
}

fn duration(micros: ArmTime) -> Duration {
    Duration::from_micros(u64::try_from(micros).unwrap_or(0))
}
