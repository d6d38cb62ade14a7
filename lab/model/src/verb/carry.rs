//! Carrying an object to its goal, and saying where it is then.

use std::future::Future;
use std::pin::pin;
use std::time::Duration;

use mom_client::{Client, Time};
use mom_drive::{Commander, DeviceChannel, Holding, RobotState, Tell, VerbFailure, WorkEnd, both};
use serde_json::json;
use tokio::time::{Instant, timeout};

use super::DriveArgs;
use super::channel::ModelChannel;
use crate::objects::since_words;
use crate::plan::{Goal, Missed, Plan, PlanError, arrived, lies_at, plan};

/// How long the cameras may take to see an object where it was put.
const SIGHT: Duration = Duration::from_secs(6);
/// The same where it may be anywhere, and after a failure nobody waits for long.
const GLIMPSE: Duration = Duration::from_secs(2);
/// How often the model is asked.
const AGAIN: Duration = Duration::from_millis(200);

impl From<PlanError> for VerbFailure {
    fn from(error: PlanError) -> VerbFailure {
        VerbFailure::new(error.text, error.hint)
    }
}

/// Carries an object to its goal, unless `interrupt` is done before.
pub(super) async fn run(
    args: &DriveArgs,
    what: &str,
    goal: &Goal,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let mut interrupt = pin!(interrupt);
    let begun = async {
        let model = ModelChannel::join(client, &args.model).await?;
        // What cannot be done takes the robot from nobody.
        plan(&model.all().await?.0, what, goal, model.now())?;
        let robot = DeviceChannel::join(client, &args.robot).await?;
        let holding = Holding::grab(client, &args.token, args.wait.map(Duration::from_secs)).await?;
        Ok::<_, VerbFailure>((model, Commander::new(robot, holding.fence()), holding))
    };
    let (model, robot, mut holding) = tokio::select! {
        begun = begun => begun?,
        () = &mut interrupt => return Err(VerbFailure::plain("interrupted before the token was grabbed")),
    };
    let mut job = Job {
        what,
        goal,
        model,
        robot,
        began: false,
    };
    let failure = match holding.during(interrupt, job.carry_out()).await {
        WorkEnd::Ended(Ok(arrival)) => {
            tell(arrival.json(what), arrival.line.clone())?;
            return holding.release().await;
        }
        WorkEnd::Lost(lost) => {
            let loss = holding.loss(&lost, &mut job.robot).await;
            return Err(job.with_place(loss).await);
        }
        WorkEnd::Ended(Err(failure)) => failure,
        WorkEnd::Interrupted => VerbFailure::plain("interrupted; the token is released"),
    };
    // First the token, so that nobody waits for a look.
    let given_back = holding.end(&mut job.robot).await;
    let failure = job.with_place(failure).await;
    both(Err(failure), given_back)
}

/// What is done under the token.
struct Job<'a> {
    what: &'a str,
    goal: &'a Goal,
    model: ModelChannel,
    robot: Commander,
    /// Whether the arm was told to move.
    began: bool,
}

/// An object that was seen at its goal.
struct Arrival {
    /// mm from it.
    off: f64,
    place: [f64; 3],
    age: i64,
    line: String,
}

impl Arrival {
    fn json(&self, what: &str) -> serde_json::Value {
        let [x, y, z] = self.place;
        json!({"object": what, "x": x, "y": y, "z": z, "off": self.off, "age": self.age})
    }
}

impl Job<'_> {
    async fn carry_out(&mut self) -> Result<Arrival, VerbFailure> {
        // It may have changed while the token was waited for.
        let plan = plan(&self.model.all().await?.0, self.what, self.goal, self.model.now())?;
        let robot: RobotState = self.robot.state_when(|_| true).await?;
        if let Some(held) = robot.holding {
            let hint = "open them first: echo 'grip open' | mom run -";
            return Err(VerbFailure::new(format!("the jaws hold {held} already"), hint));
        }
        let rise = plan.rise_from(&robot.pose);
        let mut why = None;
        for script in &plan.scripts {
            self.began = true;
            let script = rise
                .iter()
                .chain([script])
                .map(String::as_str)
                .collect::<Vec<_>>()
                .join("; ");
            match self.robot.carry_out(&*script).await.unreachable()? {
                None => return self.see(&plan).await,
                Some(reason) => {
                    self.began = false;
                    // The first is the one that is least turned.
                    why.get_or_insert(reason);
                }
            }
        }
        let why = why.unwrap_or_default();
        let hint = "nothing has moved; choose another place";
        Err(VerbFailure::new(format!("the arm cannot do that: {why}"), hint))
    }

    /// Waits until the cameras see it at its goal.
    async fn see(&mut self, plan: &Plan) -> Result<Arrival, VerbFailure> {
        let done = self.model.now();
        let until = Instant::now() + SIGHT;
        let mut elsewhere = None;
        while Instant::now() < until {
            let objects = self.model.all().await?.0;
            let now = self.model.now();
            let seen = objects.get(self.what).filter(|object| object.seen > Some(done));
            match seen.map(|object| (object, arrived(object, plan))) {
                Some((object, Ok(off))) => {
                    return Ok(Arrival {
                        off,
                        place: [object.x, object.y, object.z],
                        age: object.age_at(now).unwrap_or_default(),
                        line: format!(
                            "{} is {} ({}, {off:.1} mm off)",
                            self.what,
                            goal_words(self.goal),
                            since_words(object, now)
                        ),
                    });
                }
                Some((object, Err(missed))) => elsewhere = Some((missed, object.yaw)),
                None => {}
            }
            self.robot.rest(AGAIN).await?;
        }
        let not_there = format!("{} is not {}", self.what, goal_words(self.goal));
        Err(VerbFailure::plain(match elsewhere {
            Some((Missed::Place, _)) => not_there,
            Some((Missed::Turn, yaw)) => format!(
                "{} is {}, but turned to {yaw:.0} degrees and not to {:.0}",
                self.what,
                goal_words(self.goal),
                plan.yaw.unwrap_or_default().rem_euclid(90.0)
            ),
            None => format!("{not_there}, as far as the cameras see: they have not seen it since"),
        }))
    }

    /// A failure, and where the object is now.
    async fn with_place(&mut self, failure: VerbFailure) -> VerbFailure {
        if !self.began || matches!(failure, VerbFailure::Io(_)) {
            return failure;
        }
        let text = match &failure {
            VerbFailure::Failed {
                text,
                hint: Some(hint),
            } => format!("{text} ({hint})"),
            other => other.to_string(),
        };
        let place = self.whereabouts().await;
        VerbFailure::new(text, place)
    }

    /// Where the object is: in the jaws, or where it was seen last.
    async fn whereabouts(&mut self) -> String {
        let failed = self.model.now();
        let until = Instant::now() + GLIMPSE;
        let state = timeout(GLIMPSE, self.robot.state_when(|_: &RobotState| true)).await;
        if let Ok(Ok(state)) = state
            && state.holding.as_deref() == Some(self.what)
        {
            let (x, y, z) = (state.pose.x, state.pose.y, state.pose.z);
            return format!("{} is in the jaws, at {x:.0} {y:.0} {z:.0}", self.what);
        }
        loop {
            let objects = match self.model.all().await {
                Ok((objects, _)) => objects,
                Err(failure) => return format!("the position of {} is unknown: {failure}", self.what),
            };
            let Some(object) = objects.get(self.what) else {
                return format!("the position of {} is unknown", self.what);
            };
            if is_settled(object.seen, failed) || Instant::now() > until {
                return lies_at(object, self.model.now());
            }
            tokio::time::sleep(AGAIN).await;
        }
    }
}

/// Whether an object was seen when what fell had time to come to rest.
fn is_settled(seen: Option<Time>, failed: Time) -> bool {
    const FALL: i64 = 400_000;
    seen.is_some_and(|seen| seen.micros() > failed.micros() + FALL)
}

fn goal_words(goal: &Goal) -> String {
    match goal {
        Goal::On(name) => format!("on {name}"),
        Goal::At { x, y, .. } => format!("at {x} {y}"),
    }
}
