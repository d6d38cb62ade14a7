//! One task: from what is asked for to the token's return.

use std::time::Duration;

use mom_agent::{Ended, Hired, Trade};
use mom_client::{Channel, Client, Code, Event, Events, Token, Value, WireError, from_value};
use mom_drive::{Holding, RobotState, VerbFailure, WorkEnd};
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout_at};

use super::drive::{Drive, Links, hub_now, long};
use super::report::Report;
use super::watch::Eyes;
use super::{ServoOptions, watch};
use crate::control::{Hand, Servo, stands_high};
use crate::eyes::Seen;
use crate::task::{NAMES, Task};
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
pub(super) struct Places {
    arm: Channel,
    events: Events,
    seen: Eyes,
    /// They end with this.
    _eyes: JoinSet<()>,
}

/// Who puts one block beside another.
pub(super) struct Aligner(pub(super) ServoOptions);

impl Trade for Aligner {
    type Task = Task;
    type Tools = Places;

    const VERB: &'static str = "align";

    fn read(&self, content: &Value) -> Result<Task, WireError> {
        Task::read(content).map_err(|text| WireError::new(Code::BAD_CONTENT, text))
    }

    fn words(task: &Task) -> String {
        format!("put {} beside {}", NAMES[task.first].0, NAMES[task.second].0)
    }

    async fn meet(&self, hired: &Hired<Task>) -> Result<(Places, Token), WireError> {
        let (mut places, token) = Places::join(&hired.client, &self.0).await?;
        places.check(&self.0, hired).await?;
        Ok((places, token))
    }

    async fn work(&self, hired: &Hired<Task>, places: Places, holding: Holding) -> Ended {
        places.work(hired, holding).await
    }
}

impl Places {
    async fn join(client: &Client, options: &ServoOptions) -> Result<(Places, Token), WireError> {
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
        let places = Places {
            events: arm.events(),
            arm,
            seen,
            _eyes: eyes,
        };
        Ok((places, token))
    }

    /// Whether the task can be done, by what is seen now.
    async fn check(&mut self, options: &ServoOptions, hired: &Hired<Task>) -> Result<(), WireError> {
        let (client, task) = (&hired.client, &hired.task);
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
        let mut servo = Servo::new(task.clone(), hand(&state), hub_now(client));
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
        for block in [task.first, task.second] {
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

    /// Works under the token, and gives it back.
    async fn work(mut self, hired: &Hired<Task>, mut holding: Holding) -> Ended {
        let state = tokio::select! {
            state = self.state(true) => state,
            why = hired.ends() => Err(VerbFailure::plain(why)),
        };
        let (work, mut drive) = match state {
            Ok(state) => {
                let now = hub_now(&hired.client);
                let servo = Servo::new(hired.task.clone(), hand(&state), now).expecting(NOISE);
                let links = Links {
                    hired: hired.clone(),
                    arm: self.arm.clone(),
                    events: self.events,
                    seen: self.seen,
                };
                let mut drive = Drive::new(links, servo, holding.fence(), state.seq);
                let work = holding
                    .during(async { drop(hired.ends().await) }, drive.run())
                    .await;
                (work, Some(drive))
            }
            Err(failure) => (WorkEnd::Ended(Err(failure)), None),
        };
        let (state, why) = match work {
            WorkEnd::Ended(Ok(words)) => ("done", words),
            WorkEnd::Ended(Err(failure)) => ("failed", failure.to_string()),
            WorkEnd::Interrupted => ("cancelled", hired.ends().await),
            WorkEnd::Lost(lost) => ("lost", holding.lost_words(&lost)),
        };
        let report = match &mut drive {
            Some(drive) => drive.last(state, &why),
            None => Report {
                text: Some(why),
                ..Report::new(&hired.peer, state)
            },
        };
        give_back(hired, drive, holding, state, report).await
    }
}

/// Gives the token back, and hears how the robot takes that; the end of the task.
async fn give_back(
    hired: &Hired<Task>,
    drive: Option<Drive>,
    holding: Holding,
    state: &'static str,
    report: Report,
) -> Ended {
    // Before the token returns, so that its next owner knows.
    let ending = Report {
        state: "ending".to_owned(),
        ..report.clone()
    };
    hired.tell(ending.to_map()).await;
    let ended = match drive {
        Some(drive) => drive.end(holding).await,
        None => holding.release().await,
    };
    let text = report.text.clone().unwrap_or_default();
    let (state, text) = match ended {
        Ok(()) => (state, text),
        // People near the robot have to know.
        Err(failure) => (
            if state == "done" { "failed" } else { state },
            format!("{text}; {failure}"),
        ),
    };
    Ended {
        state,
        text,
        more: report.facts(),
    }
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
