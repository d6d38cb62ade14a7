//! `mom fleet send` and `mom fleet run`: robots side by side, each under its token.

use std::collections::{BTreeMap, BTreeSet};
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::task::Poll;

use mom_client::{Client, Map, TokenGuard};
use mom_drive::{CommandEnd, DeviceChannel, Doing as _, Robot, Tell, VerbFailure, lost_words};
use serde_json::json;
use tokio::sync::mpsc;
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
        let robots = held.robots(channels);
        let mut failed = 0;
        let ended = tokio::select! {
            biased;
            lost = held.lost() => Err(VerbFailure::plain(lost)),
            () = interrupt => {
                let text = "interrupted; the tokens are released, and the hub halts the robots";
                Err(VerbFailure::plain(text))
            }
            worked = self.steps(work, robots, &mut failed, tell) => worked,
        };
        let released = held.release().await;
        ended?;
        released?;
        match failed {
            0 => Ok(()),
            1 => Err(VerbFailure::plain("1 command failed")),
            failed => Err(VerbFailure::plain(format!("{failed} commands failed"))),
        }
    }

    async fn steps(
        &self,
        work: &Work,
        mut robots: BTreeMap<u32, Robot>,
        failed: &mut usize,
        tell: Tell<'_>,
    ) -> Result<(), VerbFailure> {
        for step in work {
            let (outcomes, mut told) = mpsc::channel(64);
            let mut working = JoinSet::new();
            for (unit, scripts) in step {
                let Some(mut robot) = robots.remove(unit) else {
                    continue;
                };
                let (unit, scripts, outcomes) = (*unit, scripts.clone(), outcomes.clone());
                let attachments = self.attachments.clone();
                working.spawn(async move {
                    for script in scripts {
                        let error = match robot.carry_out_with(&script, &attachments).await {
                            Ok(CommandEnd::Done) => None,
                            Ok(CommandEnd::Refused(why)) => Some(VerbFailure::plain(why)),
                            Err(error) => Some(error),
                        };
                        let over = error.is_some();
                        let outcome = Outcome { unit, script, error };
                        if outcomes.send(outcome).await.is_err() || over {
                            break;
                        }
                    }
                    (unit, robot)
                });
            }
            drop(outcomes);
            while let Some(Outcome { unit, script, error }) = told.recv().await {
                *failed += usize::from(error.is_some());
                let text = error.map(|error| match error {
                    // Which command it was is told beside it.
                    VerbFailure::Refused { error, .. } => error.to_string(),
                    other => other.to_string(),
                });
                let state = if text.is_some() { "error" } else { "finished" };
                let line = match &text {
                    None => format!("{unit:>5}  finished  {script}"),
                    Some(text) => format!("{unit:>5}  error     {script}: {text}"),
                };
                tell(
                    json!({"unit": unit, "state": state, "script": script, "error": text}),
                    line,
                )?;
            }
            while let Some(worked) = working.join_next().await {
                let (unit, robot) = worked.map_err(|error| VerbFailure::plain(error.to_string()))?;
                robots.insert(unit, robot);
            }
            // What comes after a barrier was meant for robots that have come there.
            if *failed > 0 {
                break;
            }
        }
        Ok(())
    }
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
    fn robots(&self, channels: BTreeMap<u32, DeviceChannel>) -> BTreeMap<u32, Robot> {
        let fence = |unit: &u32| self.guards.get(self.of.get(unit)?).map(TokenGuard::fence);
        channels
            .into_iter()
            .filter_map(|(unit, channel)| Some((unit, Robot::new(channel, fence(&unit)?))))
            .collect()
    }

    /// Waits until one of them is lost, and says how.
    async fn lost(&mut self) -> String {
        let mut losses: Vec<_> = self
            .guards
            .iter_mut()
            .map(|(path, guard)| Box::pin(async move { lost_words(path, &guard.lost().await) }))
            .collect();
        poll_fn(|task| {
            for loss in &mut losses {
                if let Poll::Ready(words) = pin!(loss).poll(task) {
                    return Poll::Ready(words);
                }
            }
            Poll::Pending
        })
        .await
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
