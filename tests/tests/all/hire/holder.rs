//! The agents that are hired here, one in each language: each holds the token as its task says.

use std::process::Command;

use mom_agent::{Ended, Hired, Trade};
use mom_client::{Code, Map, Token, Value, WireError};
use mom_drive::{Commander, DeviceChannel, Holding, VerbFailure, WorkEnd};
use mom_tests::programs::{Running, project};
use tokio::sync::oneshot;
use tokio::task::spawn_blocking;

use super::{TOKEN, join};

/// Whose kit an agent is of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kit {
    Rust,
    Python,
    JavaScript,
}

/// An agent at work; it ends when this is used.
pub(super) enum Agent {
    Here(oneshot::Sender<()>),
    Program(Running),
}

impl Agent {
    pub(super) async fn start(kit: Kit, hub: &str) -> Agent {
        let files = project().join("tests/tests/all/hire");
        let mut command = match kit {
            Kit::Rust => {
                let (end, ends) = oneshot::channel();
                let agent = join(hub, "servo").await;
                tokio::spawn(mom_agent::run(agent, "/servo", Holder, async {
                    drop(ends.await);
                }));
                return Agent::Here(end);
            }
            Kit::Python => {
                let mut python = Command::new(project().join("target/python/bin/python"));
                python
                    .arg(files.join("holder.py"))
                    .env("PYTHONPATH", project().join("clients/python/src"));
                python
            }
            Kit::JavaScript => {
                let mut node = Command::new("node");
                node.arg(files.join("holder.mjs"));
                node
            }
        };
        command.env("MOM_HUB", hub.replace("bin://", "mom://"));
        let started = spawn_blocking(move || {
            let agent = Running::of("holder", &mut command);
            agent.line_with("ready");
            agent
        });
        Agent::Program(started.await.expect("it starts"))
    }

    pub(super) fn end(self) -> Option<Running> {
        match self {
            Agent::Here(end) => end.send(()).map(|()| None).expect("it lives"),
            Agent::Program(program) => {
                program.signal("TERM");
                Some(program)
            }
        }
    }
}

/// Holds the token as the task says: `on`, until it is told to end; `once`; `badly`; so that it `crashes`; or driving `the arm`.
struct Holder;

impl Trade for Holder {
    type Task = String;
    type Tools = ();

    const VERB: &'static str = "hold";

    fn read(&self, content: &Value) -> Result<String, WireError> {
        let what = content.get("what").and_then(Value::as_str);
        what.map(str::to_owned)
            .ok_or_else(|| WireError::new(Code::BAD_CONTENT, "say `what`"))
    }

    fn words(task: &String) -> String {
        format!("hold {task}")
    }

    async fn meet(&self, hired: &Hired<String>) -> Result<((), Token), WireError> {
        if hired.task == "nothing" {
            return Err(WireError::new(Code::TRY_LATER, "there is nothing to hold"));
        }
        let token = hired.client.token(TOKEN).await;
        token
            .map(|token| ((), token))
            .map_err(|error| WireError::new(Code::TRY_LATER, error.to_string()))
    }

    async fn work(&self, hired: &Hired<String>, (): (), mut holding: Holding) -> Ended {
        hired.tell(hired.report("working").with("text", "")).await;
        let arm = match hired.task.as_str() {
            "the arm" => DeviceChannel::join(&hired.client, "/robot/arm").await,
            _ => DeviceChannel::join(&hired.client, "/servo").await,
        };
        let mut arm = Commander::new(arm.expect("it may"), holding.fence());
        let wanted = async { drop(hired.ends().await) };
        let ended = holding.during(wanted, hold(&hired.task, &mut arm)).await;
        let ended = match ended {
            WorkEnd::Interrupted => Ended::new("cancelled", hired.ends().await),
            WorkEnd::Lost(lost) => Ended::new("lost", holding.lost_words(&lost)),
            WorkEnd::Ended(Err(failure)) => Ended::new("failed", failure.to_string()),
            WorkEnd::Ended(Ok(())) => Ended {
                more: Map::new().with("times", 1),
                ..Ended::new("done", "I held it once")
            },
        };
        drop(holding.end(&mut arm).await);
        ended
    }
}

async fn hold(task: &str, arm: &mut Commander) -> Result<(), VerbFailure> {
    match task {
        "once" => Ok(()),
        "badly" => Err(VerbFailure::plain("my hands are full")),
        "crashes" => panic!("it crashes, as it is to"),
        "the arm" => {
            let end = arm.carry_out("home; wait 60000".to_owned()).await;
            end.unreachable().map(drop)
        }
        _ => std::future::pending().await,
    }
}
