//! The calibration agent: hears in its channel which camera is to be calibrated, takes the robot's token from the peer that
//! asked, and gives it back.
//!
//! In the channel, `/calibrate`:
//!
//! | message | by | content |
//! |---|---|---|
//! | `calibrate` | anybody | `camera`: its name, as in `mom calibrate`; `poses`: in how many to look, 6 to 500, 20 if absent |
//! | `cancel` | whose task it is | |
//! | `progress` | the agent | `by`: who asked; `state`: `accepted` (to the peer that asked, with `agent`), `working` (with `pose` and
//! `of`), or the last one: `calibrated` (with `rms`), `failed`, `cancelled`; `text` |
//! | `calibrate-refused`, `cancel-refused` | the agent | code, name and text |
//!
//! It takes an offer of the token from the peer of an accepted task only, within [`OFFERED`] of the acceptance.

use std::future::{Future, pending};
use std::pin::pin;
use std::time::Duration;

use mom_client::{
    Channel, Client, ClientError, Code, Event, LinkState, Map, Parcel, Token, Value, WireError,
};
use mom_drive::{Commander, DeviceChannel, Doing as _, Holding, VerbFailure};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout, timeout_at};

use crate::camera::Camera;
use crate::verb::{self, VerbArgs};

/// How long an accepted task waits for the token.
pub const OFFERED: Duration = Duration::from_secs(15);
/// How long an offer that nobody asked for takes to be declined.
const DECLINED: Duration = Duration::from_secs(2);
/// How long a task may take to end when the agent does.
const LAST: Duration = Duration::from_secs(2);
/// In how many poses is looked where nobody says.
const POSES: i64 = 20;
/// Lines of progress that wait to be sent; there is one a pose.
const LINES: usize = 512;

/// The channels and the token of the agent.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentOptions {
    /// Its own channel.
    pub channel: String,
    /// How it calibrates; the camera, and in how many poses, is what others say.
    pub args: VerbArgs,
}

impl Default for AgentOptions {
    /// The lab's.
    fn default() -> AgentOptions {
        AgentOptions {
            channel: "/calibrate".to_owned(),
            args: VerbArgs::of("", 6),
        }
    }
}

/// What a peer asked for.
#[derive(Debug, Clone)]
struct Order {
    peer: String,
    /// The id of the message.
    id: Option<u64>,
    camera: String,
    poses: u16,
}

/// The task under way.
struct Task {
    order: Order,
    /// Why it is to end, once it is.
    cancel: watch::Sender<Option<String>>,
    work: JoinHandle<()>,
}

/// What a task works with.
#[derive(Clone)]
struct Agent {
    client: Client,
    channel: Channel,
    options: AgentOptions,
}

/// Runs the agent until `shutdown` is done; a task under way is cancelled, and the token returned.
///
/// # Errors
///
/// [`ClientError`] if its channel cannot be joined, or the connection is closed for good.
pub async fn run(
    client: Client,
    options: AgentOptions,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ClientError> {
    let channel = client.channel(&options.channel).await?;
    let mut events = channel.events();
    let mut shutdown = pin!(shutdown);
    let agent = Agent {
        client: client.clone(),
        channel,
        options,
    };
    let mut task: Option<Task> = None;
    loop {
        tokio::select! {
            () = &mut shutdown => break,
            () = ended(&mut task) => task = None,
            event = events.next() => match event {
                Some(Event::Message(parcel)) => agent.hear(&mut task, &parcel).await,
                Some(Event::Left(member)) => {
                    if let Some(task) = task.as_ref().filter(|task| task.order.peer == member.peer) {
                        task.cancel.send_replace(Some(format!("{} has left", member.peer)));
                    }
                }
                Some(_) => {}
                None => return Err(closed(&client)),
            },
        }
    }
    if let Some(task) = task {
        task.cancel
            .send_replace(Some("the agent's program ends".to_owned()));
        // Otherwise the hub takes the token back.
        let _ended = timeout(LAST, task.work).await;
    }
    client.close().await;
    Ok(())
}

/// Waits for the end of the task, if there is one.
async fn ended(task: &mut Option<Task>) {
    match task {
        // A task that broke down has lost its token with its guard.
        Some(task) => drop((&mut task.work).await),
        None => pending().await,
    }
}

/// Why there are no more events.
fn closed(client: &Client) -> ClientError {
    match &*client.state().borrow() {
        LinkState::Closed(error) => ClientError::Closed(error.clone()),
        _ => WireError::new(Code::UNKNOWN_PATH, "the hub deleted the agent's channel").into(),
    }
}

/// The task that is asked for, if it can be read.
fn read(peer: String, parcel: &Parcel) -> Result<Order, WireError> {
    let bad = |text: String| WireError::new(Code::BAD_CONTENT, text);
    let content = parcel.value();
    let camera = content.get("camera").and_then(Value::as_str);
    let camera = camera.ok_or_else(|| bad("say which `camera`: x, y or top".to_owned()))?;
    let poses = match content.get("poses") {
        None => POSES,
        Some(poses) => poses.as_int().unwrap_or(-1),
    };
    let poses = u16::try_from(poses)
        .ok()
        .filter(|poses| (6..=500).contains(poses));
    Ok(Order {
        peer,
        id: parcel.id,
        camera: camera.to_owned(),
        poses: poses.ok_or_else(|| bad("`poses` are 6 to 500".to_owned()))?,
    })
}

impl Agent {
    async fn hear(&self, task: &mut Option<Task>, parcel: &Parcel) {
        let Some(peer) = parcel.sender.as_deref().map(str::to_owned) else {
            return;
        };
        let later = |text: String| WireError::new(Code::TRY_LATER, text);
        let refused = match (parcel.name(), &*task) {
            ("calibrate", Some(task)) => {
                let Order { peer, camera, .. } = &task.order;
                (
                    "calibrate-refused",
                    later(format!("busy: {peer} has it calibrate {camera}")),
                )
            }
            ("calibrate", None) => match read(peer.clone(), parcel) {
                Ok(order) => {
                    let (cancel, cancelled) = watch::channel(None);
                    let work = tokio::spawn(self.clone().carry_out(order.clone(), cancelled));
                    *task = Some(Task { order, cancel, work });
                    return;
                }
                Err(error) => ("calibrate-refused", error),
            },
            ("cancel", Some(task)) if task.order.peer == peer => {
                task.cancel.send_replace(Some(format!("{peer} cancelled it")));
                return;
            }
            ("cancel", Some(task)) => {
                let text = format!("the task is {0}'s; only {0} cancels it", task.order.peer);
                ("cancel-refused", WireError::new(Code::DENIED, text))
            }
            ("cancel", None) => ("cancel-refused", later("there is no task to cancel".to_owned())),
            _ => return,
        };
        let content = refused.1.to_map().with("by", peer.as_str());
        self.say(refused.0, content, Some((&peer, parcel.id))).await;
    }

    /// Says something to all, or to one peer as the answer to its message.
    async fn say(&self, name: &str, content: Map, to: Option<(&str, Option<u64>)>) {
        let mut message = self.channel.message(name).content(Value::from(content)).no_echo();
        if let Some((peer, id)) = to {
            message = message.to([peer]);
            if let Some(id) = id {
                message = message.reference(id);
            }
        }
        // Who asked hears of the end by the token's return, too.
        let _sent = message.send().await;
    }

    async fn carry_out(self, order: Order, cancelled: watch::Receiver<Option<String>>) {
        let told = |state: &str, text: &str| {
            Map::new()
                .with("by", order.peer.as_str())
                .with("state", state)
                .with("text", text)
        };
        let meeting = self.meet(&order);
        let (camera, robot, token) = match meeting.await {
            Ok(met) => met,
            Err(failure) => {
                let error = WireError::new(Code::TRY_LATER, failure.to_string());
                let content = error.to_map().with("by", order.peer.as_str());
                return self
                    .say("calibrate-refused", content, Some((&order.peer, order.id)))
                    .await;
            }
        };
        let accepted = told("accepted", "offer me the token").with("agent", self.client.name());
        self.say("progress", accepted, Some((&order.peer, order.id)))
            .await;
        let offered = tokio::select! {
            offered = self.offered(&order.peer, &token) => offered,
            why = wanted(cancelled.clone()) => Err(VerbFailure::plain(why)),
        };
        let worked = match offered {
            Ok(holding) => self.work(&order, camera, robot, holding, cancelled.clone()).await,
            Err(failure) => Err(failure),
        };
        let why = cancelled.borrow().clone();
        let last = match (worked, why) {
            (Ok(rms), _) => told("calibrated", &format!("RMS {rms:.3} px; the camera uses it now"))
                .with("rms", Value::Double(rms)),
            (Err(failure), Some(why)) => told("cancelled", &format!("{why}: {failure}")),
            (Err(failure), None) => told("failed", &failure.to_string()),
        };
        self.say("progress", last, None).await;
    }

    /// What can be said of the task before anything is lent.
    async fn meet(&self, order: &Order) -> Result<(Camera, DeviceChannel, Token), VerbFailure> {
        let VerbArgs {
            session,
            robot,
            token,
            ..
        } = &self.options.args;
        let session = session.trim_end_matches('/');
        let path = format!("{session}/{}", order.camera);
        let camera = Camera::meet(DeviceChannel::join(&self.client, &path).await?).await?;
        let robot = DeviceChannel::join(&self.client, robot).await?;
        let token = self.client.token(token).await.doing(format!("join {token}"))?;
        Ok((camera, robot, token))
    }

    /// The token, once the peer of the task offers it.
    async fn offered(&self, peer: &str, token: &Token) -> Result<Holding, VerbFailure> {
        let (me, mut events) = (self.client.name(), token.events());
        let until = Instant::now() + OFFERED;
        loop {
            let Ok(event) = timeout_at(until, events.next()).await else {
                let text = format!("{peer} did not offer the token within {} s", OFFERED.as_secs());
                return Err(VerbFailure::plain(text));
            };
            match event {
                Some(Event::Offer { by, to, .. }) if to == me && by == peer => {
                    return Holding::accept(token.clone()).await;
                }
                Some(Event::Offer { to, .. }) if to == me => drop(timeout(DECLINED, token.decline()).await),
                Some(_) => {}
                None => return Err(VerbFailure::plain("the connection to the hub is closed")),
            }
        }
    }

    /// Calibrates, and tells each pose; gives the RMS in pixels.
    async fn work(
        &self,
        order: &Order,
        camera: Camera,
        robot: DeviceChannel,
        holding: Holding,
        cancelled: watch::Receiver<Option<String>>,
    ) -> Result<f64, VerbFailure> {
        let args = VerbArgs {
            view: order.camera.clone(),
            poses: order.poses,
            ..self.options.args.clone()
        };
        let (lines, mut to_tell) = mpsc::channel(LINES);
        let mut rms = None;
        let mut tell = |json: serde_json::Value, line: String| {
            rms = json["rms"].as_f64().or(rms);
            // A line that nobody takes is not worth a pause of the arm.
            let _taken = lines.try_send((json["pose"].as_i64(), json["of"].as_i64(), line));
            Ok(())
        };
        let telling = async {
            while let Some((pose, of, line)) = to_tell.recv().await {
                let (Some(pose), Some(of)) = (pose, of) else {
                    continue;
                };
                let content = Map::new()
                    .with("by", order.peer.as_str())
                    .with("state", "working")
                    .with("text", line)
                    .with("pose", pose)
                    .with("of", of);
                self.say("progress", content, None).await;
            }
        };
        let robot = Commander::new(robot, holding.fence());
        let interrupt = async { drop(wanted(cancelled).await) };
        let working = verb::under(&args, camera, robot, holding, interrupt, &mut tell);
        tokio::select! {
            worked = working => worked?,
            () = telling => {}
        }
        rms.ok_or_else(|| VerbFailure::plain("nothing was measured"))
    }
}

/// Why the task is to end, once it is.
async fn wanted(mut cancelled: watch::Receiver<Option<String>>) -> String {
    match cancelled.wait_for(Option::is_some).await {
        Ok(why) => why.clone().unwrap_or_default(),
        Err(_) => "the agent ends".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use mom_client::Family;

    use super::*;

    #[test]
    fn tasks_are_read_and_refused_in_words() {
        let asked = |content: Map| {
            let parcel = Parcel::new(Family::Message, "calibrate").content(Value::from(content));
            read("alice".to_owned(), &parcel).map(|order| (order.camera, order.poses))
        };
        assert_eq!(
            asked(Map::new().with("camera", "x")).ok(),
            Some(("x".to_owned(), 20))
        );
        assert_eq!(
            asked(Map::new().with("camera", "top").with("poses", 6)).ok(),
            Some(("top".to_owned(), 6))
        );
        for (content, word) in [
            (Map::new(), "camera"),
            (Map::new().with("camera", 7), "camera"),
            (Map::new().with("camera", "x").with("poses", 5), "6 to 500"),
            (Map::new().with("camera", "x").with("poses", "many"), "6 to 500"),
        ] {
            let error = asked(content).expect_err("it is not a task");
            assert!(
                error.code == Code::BAD_CONTENT && error.text.contains(word),
                "{error}"
            );
        }
    }
}
