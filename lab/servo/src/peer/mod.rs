//! The agent: hears in its channel what it is to do, takes the robot's token from the peer that asked, works, and gives it back.
//!
//! In the channel, `/servo`:
//!
//! | message | by | content |
//! |---|---|---|
//! | `align` | anybody | `first`, `second`: names of blocks; `side`: `right`, `left`, `front` or `back`; `gap`: mm |
//! | `cancel` | whose task it is | |
//! | `progress` | the agent | `state`: `accepted` (to the peer that asked, with `agent`), `working`, or the last one: `aligned`, `failed`,
//! `cancelled`, `lost`; see [`report`] |
//! | `align-refused`, `cancel-refused` | the agent | code, name and text |
//!
//! It takes an offer of the token from the peer of an accepted task only, within [`OFFERED`] of the acceptance.
//! Of the arm's state it uses the pose (spin and tilt at the beginning, which no image shows, and how far the workspace goes), whether
//! the jaws hold anything, and whether it is stopped; never where the arm says that blocks are.

mod drive;
mod job;
pub mod report;
mod watch;

use std::future::{Future, pending};
use std::pin::pin;
use std::time::Duration;

use mom_client::{
    Boxed, Channel, Client, ClientError, Code, Event, LinkState, Map, Parcel, Value, WireError,
};
use tokio::sync::watch as signal;
use tokio::task::JoinHandle;
use tokio::time::Instant;

use crate::task::{NAMES, Task};

/// How long an accepted task waits for the token.
pub const OFFERED: Duration = Duration::from_secs(15);

/// The channels and the token of the agent.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoOptions {
    /// Its own channel.
    pub channel: String,
    /// The robot's.
    pub robot: String,
    /// The token that guards the robot.
    pub token: String,
    /// Those of the cameras; they stand still.
    pub cameras: Vec<String>,
}

impl Default for ServoOptions {
    /// The lab's.
    fn default() -> ServoOptions {
        ServoOptions {
            channel: "/servo".to_owned(),
            robot: "/robot/arm".to_owned(),
            token: "/robot/token".to_owned(),
            cameras: ["/camera/x", "/camera/y", "/camera/top"]
                .map(str::to_owned)
                .to_vec(),
        }
    }
}

/// What a peer asked for.
#[derive(Debug, Clone)]
pub(crate) struct Order {
    /// Who.
    pub(crate) peer: String,
    /// The id of the message.
    pub(crate) id: Option<u64>,
    pub(crate) task: Task,
}

/// The task under way.
struct Job {
    order: Order,
    since: Instant,
    /// Why it is to end, once it is.
    cancel: signal::Sender<Option<String>>,
    work: JoinHandle<()>,
}

/// Runs the agent until `shutdown` is done; a task under way is cancelled, and the token returned.
///
/// # Errors
///
/// [`ClientError`] if its channel cannot be joined, or the connection is closed for good.
pub fn run(
    client: Client,
    options: ServoOptions,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Boxed<'static, Result<(), ClientError>> {
    Box::pin(run_until(client, options, Box::pin(shutdown)))
}

async fn run_until(
    client: Client,
    options: ServoOptions,
    shutdown: Boxed<'static, ()>,
) -> Result<(), ClientError> {
    let channel = client.channel(&options.channel).await?;
    let mut events = channel.events();
    let mut shutdown = pin!(shutdown);
    let mut job: Option<Job> = None;
    tracing::info!(peer = client.name(), channel = %channel.path(), "the agent is ready");
    loop {
        tokio::select! {
            () = &mut shutdown => break,
            () = ended(&mut job) => job = None,
            event = events.next() => match event {
                Some(Event::Message(parcel)) => handle(&client, &channel, &options, &mut job, &parcel).await,
                Some(Event::Left(member)) => {
                    if let Some(job) = job.as_ref().filter(|job| job.order.peer == member.peer) {
                        job.cancel.send_replace(Some(format!("{} has left", member.peer)));
                    }
                }
                Some(Event::Lagged(count)) => tracing::warn!(count, "messages were lost"),
                Some(_) => {}
                None => return Err(closed(&client)),
            },
        }
    }
    if let Some(job) = job {
        job.cancel
            .send_replace(Some("the agent's program ends".to_owned()));
        if tokio::time::timeout(Duration::from_secs(2), job.work)
            .await
            .is_err()
        {
            tracing::warn!("the task did not end in time; the hub takes the token back");
        }
    }
    client.close().await;
    Ok(())
}

/// Waits for the end of the task, if there is one.
async fn ended(job: &mut Option<Job>) {
    match job {
        Some(job) => {
            if let Err(error) = (&mut job.work).await {
                tracing::error!(%error, "the task failed with an internal error");
            }
        }
        None => pending().await,
    }
}

async fn handle(
    client: &Client,
    channel: &Channel,
    options: &ServoOptions,
    job: &mut Option<Job>,
    parcel: &Parcel,
) {
    let Some(peer) = parcel.sender.as_deref().map(str::to_owned) else {
        return;
    };
    let refused = match parcel.name() {
        "align" => match begin(job.as_ref(), parcel) {
            Ok(task) => {
                let order = Order {
                    peer,
                    id: parcel.id,
                    task,
                };
                tracing::info!(peer = order.peer, first = NAMES[order.task.first].0, "a task");
                let (cancel, cancelled) = signal::channel(None);
                let work = job::run(
                    client.clone(),
                    channel.clone(),
                    options.clone(),
                    order.clone(),
                    cancelled,
                );
                *job = Some(Job {
                    order,
                    since: Instant::now(),
                    cancel,
                    work: tokio::spawn(work),
                });
                return;
            }
            Err(error) => ("align-refused", error),
        },
        "cancel" => match job {
            Some(job) if job.order.peer == peer => {
                job.cancel.send_replace(Some(format!("{peer} cancelled it")));
                return;
            }
            Some(job) => {
                let text = format!(
                    "the task is {}'s; only {} cancels it",
                    job.order.peer, job.order.peer
                );
                ("cancel-refused", WireError::new(Code::DENIED, text))
            }
            None => (
                "cancel-refused",
                WireError::new(Code::TRY_LATER, "there is no task to cancel"),
            ),
        },
        _ => return,
    };
    refuse(channel, &peer, parcel.id, refused.0, &refused.1).await;
}

/// The task that is asked for, if it can be begun.
fn begin(job: Option<&Job>, parcel: &Parcel) -> Result<Task, WireError> {
    if let Some(job) = job {
        let Task { first, second, .. } = job.order.task;
        let text = format!(
            "busy: {} has had it put {} beside {} for {} s",
            job.order.peer,
            NAMES[first].0,
            NAMES[second].0,
            job.since.elapsed().as_secs()
        );
        return Err(WireError::new(Code::TRY_LATER, text));
    }
    Task::read(&parcel.value()).map_err(|text| WireError::new(Code::BAD_CONTENT, text))
}

/// Refuses what a peer asked for.
pub(crate) async fn refuse(channel: &Channel, peer: &str, id: Option<u64>, name: &str, error: &WireError) {
    let content: Map = error.to_map().with("by", peer);
    say(channel, name, content, Some((peer, id))).await;
}

/// Says something to all, or to one peer as the answer to its message.
pub(crate) async fn say(channel: &Channel, name: &str, content: Map, to: Option<(&str, Option<u64>)>) {
    let mut message = channel.message(name).content(Value::from(content)).no_echo();
    if let Some((peer, id)) = to {
        message = message.to([peer]);
        if let Some(id) = id {
            message = message.reference(id);
        }
    }
    if let Err(error) = message.send().await {
        tracing::warn!(%error, name, "a message was not sent");
    }
}

/// Why there are no more events.
fn closed(client: &Client) -> ClientError {
    match &*client.state().borrow() {
        LinkState::Closed(error) => ClientError::Closed(error.clone()),
        _ => WireError::new(Code::UNKNOWN_PATH, "the hub deleted the agent's channel").into(),
    }
}
