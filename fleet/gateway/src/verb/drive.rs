//! `mom fleet send` and `mom fleet run`: robots side by side, each under its token.

use std::collections::{BTreeMap, BTreeSet};
use std::future::{Future, poll_fn, ready};
use std::pin::pin;
use std::task::Poll;

use mom_client::{Client, Lost, Map, TokenGuard};
use mom_drive::{Command, Commander, DeviceChannel, Doing as _, How, Tell, VerbFailure, both, lost_words};
use serde_json::json;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;

use super::channel;
use super::steps::Work;

/// Who drives.
pub(super) struct Drivers<'a> {
    pub(super) client: &'a Client,
    pub(super) fleet: &'a str,
    /// What comes with each script.
    pub(super) attachments: &'a Map,
}

/// What became of a command.
struct Outcome {
    unit: u32,
    script: String,
    error: Option<VerbFailure>,
}

/// Robots that are at work, each in a task of its own.
struct Team {
    working: JoinSet<(u32, Commander)>,
    /// Whether they are to leave what they do as it is.
    over: watch::Sender<bool>,
    /// Those that wait for the next step.
    robots: BTreeMap<u32, Commander>,
}

impl Drivers<'_> {
    /// Grabs the tokens, has all steps carried out one after the other, and gives the tokens back.
    pub(super) async fn run(
        &self,
        work: &Work,
        interrupt: &mut (impl Future<Output = ()> + Unpin),
        tell: Tell<'_>,
    ) -> Result<(), VerbFailure> {
        let units: BTreeSet<u32> = work.iter().flat_map(|step| step.keys().copied()).collect();
        let mut channels = BTreeMap::new();
        for unit in units {
            let joined = DeviceChannel::join(self.client, &channel(self.fleet, unit)).await?;
            channels.insert(unit, joined);
        }
        let mut held = Held::grab(self.client, &channels).await?;
        let mut team = Team {
            working: JoinSet::new(),
            over: watch::Sender::new(false),
            robots: held.robots(channels),
        };
        let mut failed = 0;
        let mut lost = None;
        let ended = tokio::select! {
            biased;
            (token, how) = held.lost() => {
                let words = lost_words(&token, &how);
                lost = Some((token, how));
                Err(VerbFailure::plain(words))
            }
            () = interrupt => Err(VerbFailure::plain("interrupted; the tokens are released")),
            worked = self.steps(work, &mut team, &mut failed, tell) => worked,
        };
        let robots = team.leave().await;
        let released = held.end(robots, lost).await;
        both(ended, released)?;
        match failed {
            0 => Ok(()),
            1 => Err(VerbFailure::plain("1 command failed")),
            failed => Err(VerbFailure::plain(format!("{failed} commands failed"))),
        }
    }

    async fn steps(
        &self,
        work: &Work,
        team: &mut Team,
        failed: &mut usize,
        tell: Tell<'_>,
    ) -> Result<(), VerbFailure> {
        for step in work {
            let (outcomes, mut told) = mpsc::channel(64);
            for (unit, scripts) in step {
                let Some(robot) = team.robots.remove(unit) else {
                    continue;
                };
                let over = team.over.subscribe();
                let (scripts, attachments) = (scripts.clone(), self.attachments.clone());
                team.working.spawn(work_of(
                    *unit,
                    robot,
                    scripts,
                    attachments,
                    outcomes.clone(),
                    over,
                ));
            }
            drop(outcomes);
            while let Some(Outcome { unit, script, error }) = told.recv().await {
                *failed += usize::from(error.is_some());
                let state = if error.is_some() { "error" } else { "finished" };
                let line = match &error {
                    None => format!("{unit:>5}  finished  {script}"),
                    Some(error) => {
                        let hint = error.hint().map(|hint| format!("\n         -> {hint}"));
                        format!(
                            "{unit:>5}  error     {script}: {error}{}",
                            hint.unwrap_or_default()
                        )
                    }
                };
                let text = error.map(|error| error.to_string());
                tell(
                    json!({"unit": unit, "state": state, "script": script, "error": text}),
                    line,
                )?;
            }
            team.gather().await;
            // What comes after a barrier was meant for robots that have come there.
            if *failed > 0 {
                break;
            }
        }
        Ok(())
    }
}

impl Team {
    /// Waits until all have done their work.
    async fn gather(&mut self) {
        // One that panicked is not heard of any more, and the hub halts it when its token is given back.
        while let Some(worked) = self.working.join_next().await {
            self.robots.extend(worked);
        }
    }

    /// Has them leave what they do as it is.
    async fn leave(mut self) -> BTreeMap<u32, Commander> {
        self.over.send_replace(true);
        self.gather().await;
        self.robots
    }
}

/// Has a robot carry out scripts up to the first that fails, or until it is to leave.
async fn work_of(
    unit: u32,
    mut robot: Commander,
    scripts: Vec<String>,
    attachments: Map,
    outcomes: mpsc::Sender<Outcome>,
    mut over: watch::Receiver<bool>,
) -> (u32, Commander) {
    for script in scripts {
        let command = Command::from(&*script).attachments(attachments.clone());
        let end = tokio::select! {
            _over = over.wait_for(|over| *over) => break,
            end = robot.carry_out(command) => end,
        };
        let error = match end.how {
            // Which command it was is told beside it.
            How::Failed(report) => Some(VerbFailure::Failed {
                text: report.wire_error().to_string(),
                hint: end.hint,
            }),
            _ => end.done().err(),
        };
        let failed = error.is_some();
        let outcome = Outcome { unit, script, error };
        if outcomes.send(outcome).await.is_err() || failed {
            break;
        }
    }
    (unit, robot)
}

/// The tokens of robots, or the one of all.
struct Held {
    guards: BTreeMap<String, TokenGuard>,
    /// The token of each robot.
    of: BTreeMap<u32, String>,
}

impl Held {
    /// Grabs them, one after the other; if one cannot be had, those before are given back.
    async fn grab(client: &Client, channels: &BTreeMap<u32, DeviceChannel>) -> Result<Self, VerbFailure> {
        let mut held = Self {
            guards: BTreeMap::new(),
            of: BTreeMap::new(),
        };
        for (unit, channel) in channels {
            let grabbed = match channel.token() {
                Ok(token) if held.guards.contains_key(token.as_str()) => Ok(token.to_string()),
                Ok(token) => Self::grab_one(client, token.as_str()).await.map(|guard| {
                    held.guards.insert(token.to_string(), guard);
                    token.to_string()
                }),
                Err(error) => Err(error),
            };
            match grabbed {
                Ok(path) => held.of.insert(*unit, path),
                Err(error) => {
                    // The refusal is what there is to be told.
                    let _ = held.release().await;
                    return Err(error);
                }
            };
        }
        Ok(held)
    }

    async fn grab_one(client: &Client, path: &str) -> Result<TokenGuard, VerbFailure> {
        let token = client.token(path).await.doing(format!("join {path}"))?;
        token.grab().await.doing(format!("grab {path}"))
    }

    /// The robots under the tokens that are held.
    fn robots(&self, channels: BTreeMap<u32, DeviceChannel>) -> BTreeMap<u32, Commander> {
        let fence = |unit: &u32| self.guards.get(self.of.get(unit)?).map(TokenGuard::fence);
        channels
            .into_iter()
            .filter_map(|(unit, channel)| Some((unit, Commander::new(channel, fence(&unit)?))))
            .collect()
    }

    /// Waits until one of them is lost, and says how.
    async fn lost(&mut self) -> (String, Lost) {
        let mut losses: Vec<_> = self
            .guards
            .iter_mut()
            .map(|(path, guard)| Box::pin(async move { (path.clone(), guard.lost().await) }))
            .collect();
        poll_fn(|task| {
            for loss in &mut losses {
                if let Poll::Ready(lost) = pin!(loss).poll(task) {
                    return Poll::Ready(lost);
                }
            }
            Poll::Pending
        })
        .await
    }

    /// Gives them back, and hears that all robots have ended what they did.
    async fn end(
        self,
        robots: BTreeMap<u32, Commander>,
        lost: Option<(String, Lost)>,
    ) -> Result<(), VerbFailure> {
        let of = self.of.clone();
        let released = self.release().await;
        let mut hearing = JoinSet::new();
        for (unit, mut robot) in robots {
            let lost = lost.clone().filter(|(token, _)| of.get(&unit) == Some(token));
            hearing.spawn(async move {
                match lost {
                    // The hub has halted it, and another peer may drive it by now.
                    Some((_, lost)) => match robot.lost(&lost).await {
                        Some(end) => end.done(),
                        None => Ok(()),
                    },
                    None => robot.end(ready(Ok(()))).await,
                }
            });
        }
        let mut ended = released;
        for heard in hearing.join_all().await {
            ended = both(ended, heard);
        }
        ended
    }

    async fn release(self) -> Result<(), VerbFailure> {
        let mut released = Ok(());
        for (path, guard) in self.guards {
            if !guard.is_lost() {
                released = released.and(guard.release().await.doing(format!("release {path}")));
            }
        }
        released
    }
}
