//! One task: from what is asked for to the token's return.

use std::time::Duration;

use mom_client::{Channel, Client, Code, Event, Events, Token, WireError, from_value};
use mom_drive::{Holding, RobotState, VerbFailure, WorkEnd};
use tokio::sync::watch as signal;
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout, timeout_at};

use super::drive::{Drive, Links, hub_now, long};
use super::report::Report;
use super::watch::Eyes;
use super::{OFFERED, Order, ServoOptions, refuse, say, watch};
use crate::control::{Hand, Servo, stands_high};
use crate::eyes::Seen;
use crate::task::NAMES;
use crate::track::Noise;

/// How long is looked before a block counts as not there.
const LOOK: Duration = Duration::from_secs(2);
/// How long the cameras together may take for their first image.
const FIRST: Duration = Duration::from_secs(3);
/// How long the robot may take to say where it is.
const STATE: Duration = Duration::from_secs(3);
/// What is expected of links and machines.
const NOISE: Noise = Noise {
    time: 0.06,
    command: 1.5,
};
/// mm in which the hand may be (M50): x, y and z.
const WORKSPACE: [[f64; 2]; 3] = [[-300.0, 300.0], [-300.0, 300.0], [0.0, 450.0]];

/// What a task needs, joined.
struct Places {
    arm: Channel,
    events: Events,
    token: Token,
    offers: Events,
    seen: Eyes,
    /// They end with this.
    _eyes: JoinSet<()>,
}

/// Carries out an order, or refuses it.
pub(super) async fn run(
    client: Client,
    channel: Channel,
    options: ServoOptions,
    order: Order,
    cancelled: signal::Receiver<Option<String>>,
) {
    let ready = async {
        let mut places = Places::join(&client, &options).await?;
        places.check(&client, &options, &order).await?;
        Ok::<_, WireError>(places)
    };
    let ready = tokio::select! {
        ready = ready => ready,
        why = wanted(cancelled.clone()) => Err(WireError::new(Code::TRY_LATER, why)),
    };
    let places = match ready {
        Ok(places) => places,
        Err(error) => {
            tracing::info!(peer = order.peer, %error, "refused");
            return refuse(&channel, &order.peer, order.id, "align-refused", &error).await;
        }
    };
    let accepted = Report {
        agent: Some(client.name()),
        ..Report::new(&order.peer, "accepted")
    };
    say(
        &channel,
        "progress",
        accepted.to_map(),
        Some((&order.peer, order.id)),
    )
    .await;
    let last = places.work(&client, &channel, &order, cancelled).await;
    tracing::info!(
        peer = order.peer,
        state = last.state,
        text = last.text,
        "the task has ended"
    );
}

/// Why the task is to end, once it is.
async fn wanted(mut cancelled: signal::Receiver<Option<String>>) -> String {
    match cancelled.wait_for(Option::is_some).await {
        Ok(why) => why.clone().unwrap_or_default(),
        Err(_) => "the agent ends".to_owned(),
    }
}

impl Places {
    async fn join(client: &Client, options: &ServoOptions) -> Result<Places, WireError> {
        let failed = |what: &str, error: &dyn std::fmt::Display| {
            WireError::new(Code::TRY_LATER, format!("the agent cannot join {what}: {error}"))
        };
        let arm = client.channel(&options.robot).await;
        let arm = arm.map_err(|error| failed(&options.robot, &error))?;
        let token = client.token(&options.token).await;
        let token = token.map_err(|error| failed(&options.token, &error))?;
        let mut seen = Eyes::default();
        let mut eyes = JoinSet::new();
        for (camera, path) in options.cameras.iter().enumerate() {
            match client.channel(path).await {
                Ok(channel) => {
                    eyes.spawn(watch::watch(channel, client.clock(), camera, seen.add()));
                }
                Err(error) => tracing::warn!(%error, path, "a camera is left out"),
            }
        }
        Ok(Places {
            events: arm.events(),
            offers: token.events(),
            arm,
            token,
            seen,
            _eyes: eyes,
        })
    }

    /// Whether the task can be done, by what is seen now.
    async fn check(
        &mut self,
        client: &Client,
        options: &ServoOptions,
        order: &Order,
    ) -> Result<(), WireError> {
        let later = |text: String| WireError::new(Code::TRY_LATER, text);
        let state = self
            .state(false)
            .await
            .map_err(|_| later(format!("no robot tells its state in {}", options.robot)))?;
        if let Some(block) = &state.holding {
            return Err(later(format!(
                "the jaws hold {block} already; have it put down first"
            )));
        }
        if state.stopped {
            return Err(later(format!("the robot in {} is stopped", options.robot)));
        }
        let mut servo = Servo::new(order.task.clone(), hand(&state), hub_now(client));
        let mut images: Vec<Option<Seen>> = vec![None; options.cameras.len()];
        let begin = Instant::now();
        loop {
            let until = begin
                + if images.iter().all(Option::is_none) {
                    FIRST
                } else {
                    LOOK
                };
            let Ok(Some(seen)) = timeout_at(until, self.seen.next()).await else {
                break;
            };
            long(|| servo.see(&seen));
            let camera = seen.camera;
            images[camera] = Some(seen);
            if images.iter().all(Option::is_some) && long(|| servo.feasible(hub_now(client))).is_ok() {
                break;
            }
        }
        let images: Vec<Seen> = images.into_iter().flatten().collect();
        if images.is_empty() {
            let paths = options.cameras.join(", ");
            return Err(later(format!("no camera shows an image with a matrix: {paths}")));
        }
        for block in [order.task.first, order.task.second] {
            if let Some(height) = long(|| stands_high(&images, block)) {
                let name = NAMES[block].0;
                return Err(later(format!(
                    "{name} is {height:.0} mm above the table; both blocks must stand on it"
                )));
            }
        }
        servo.feasible(hub_now(client)).map_err(later)
    }

    /// The newest state that the robot has told; when it rests, if that matters.
    async fn state(&mut self, rests: bool) -> Result<RobotState, VerbFailure> {
        let mut newest: Option<RobotState> = None;
        let until = Instant::now() + STATE;
        loop {
            // What has come already is older than what follows.
            let event = match newest.as_ref().is_some_and(|state| !rests || !state.moving) {
                true => match self.events.try_next() {
                    Some(event) => Some(event),
                    None => break,
                },
                false => match timeout_at(until, self.events.next()).await {
                    Ok(event) => event,
                    Err(_) => break,
                },
            };
            match event {
                Some(Event::Message(parcel)) if parcel.name() == "state" => {
                    newest = from_value(parcel.value()).ok().or(newest);
                }
                Some(_) => {}
                None => break,
            }
        }
        newest.ok_or_else(|| VerbFailure::plain("the robot does not tell its state"))
    }

    /// Takes the token, works, and gives it back.
    async fn work(
        mut self,
        client: &Client,
        channel: &Channel,
        order: &Order,
        cancelled: signal::Receiver<Option<String>>,
    ) -> Report {
        let me = client.name();
        let offered = tokio::select! {
            offered = self.offered(&me, &order.peer) => offered,
            why = wanted(cancelled.clone()) => Err(("cancelled", why)),
        };
        let mut holding = match offered {
            Ok(holding) => holding,
            Err((state, why)) => {
                let report = Report {
                    text: Some(why),
                    ..Report::new(&order.peer, state)
                };
                say(channel, "progress", report.to_map(), None).await;
                return report;
            }
        };
        let state = tokio::select! {
            state = self.state(true) => state,
            why = wanted(cancelled.clone()) => Err(VerbFailure::plain(why)),
        };
        let (work, mut drive) = match state {
            Ok(state) => {
                let servo = Servo::new(order.task.clone(), hand(&state), hub_now(client)).expecting(NOISE);
                let links = Links {
                    client: client.clone(),
                    channel: channel.clone(),
                    arm: self.arm.clone(),
                    events: self.events,
                    seen: self.seen,
                };
                let mut drive = Drive::new(links, order.clone(), servo, holding.fence(), state.seq);
                let work = holding
                    .during(async { drop(wanted(cancelled.clone()).await) }, drive.run())
                    .await;
                (work, Some(drive))
            }
            Err(failure) => (WorkEnd::Ended(Err(failure)), None),
        };
        let (state, why) = match work {
            WorkEnd::Ended(Ok(words)) => ("aligned", words),
            WorkEnd::Ended(Err(failure)) => ("failed", failure.to_string()),
            WorkEnd::Interrupted => ("cancelled", wanted(cancelled).await),
            WorkEnd::Lost(lost) => ("lost", holding.lost_words(&lost)),
        };
        let report = match &mut drive {
            Some(drive) => drive.last(state, &why),
            None => Report {
                text: Some(why),
                ..Report::new(&order.peer, state)
            },
        };
        give_back(channel, drive, holding, report).await
    }

    /// The token, once the peer of the task offers it.
    async fn offered(&mut self, me: &str, peer: &str) -> Result<Holding, (&'static str, String)> {
        let until = Instant::now() + OFFERED;
        loop {
            let Ok(event) = timeout_at(until, self.offers.next()).await else {
                let text = format!("{peer} did not offer the token within {} s", OFFERED.as_secs());
                return Err(("failed", text));
            };
            match event {
                Some(Event::Offer { by, to, .. }) if to == me && by == peer => {
                    let accepted = Holding::accept(self.token.clone()).await;
                    return accepted.map_err(|error| ("failed", error.to_string()));
                }
                Some(Event::Offer { by, to, .. }) if to == me => {
                    tracing::info!(by, "an offer without a task is declined");
                    let declined = timeout(LOOK, self.token.decline()).await;
                    if let Ok(Err(error)) = declined {
                        tracing::warn!(%error, "an offer was not declined");
                    }
                }
                Some(_) => {}
                None => return Err(("failed", "the connection to the hub is closed".to_owned())),
            }
        }
    }
}

/// Gives the token back, hears how the robot takes that, and says both; gives the last report.
async fn give_back(channel: &Channel, drive: Option<Drive>, holding: Holding, report: Report) -> Report {
    // Before the token returns, so that its next owner knows.
    let ending = Report {
        state: "ending".to_owned(),
        ..report.clone()
    };
    say(channel, "progress", ending.to_map(), None).await;
    let ended = match drive {
        Some(drive) => drive.end(holding).await,
        None => holding.release().await,
    };
    let report = match ended {
        Ok(()) => report,
        // People near the robot have to know.
        Err(failure) => {
            let state = match report.state.as_str() {
                "aligned" => "failed",
                state => state,
            };
            Report {
                text: Some(format!("{}; {failure}", report.text.clone().unwrap_or_default())),
                state: state.to_owned(),
                ..report
            }
        }
    };
    say(channel, "progress", report.to_map(), None).await;
    report
}

/// What of the arm's state no image shows.
fn hand(state: &RobotState) -> Hand {
    let pose = state.pose;
    let at = [pose.x, pose.y, pose.z];
    Hand {
        turned: [pose.spin, pose.tilt],
        room: std::array::from_fn(|i| WORKSPACE[i].map(|limit| limit - at[i])),
    }
}
