//! `mom servo`: gives the agent the robot's token for one task, and takes it back.

use std::future::Future;
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_client::{
    Client, ClientError, Event, Events, Family, Given, Lost, Map, Parcel, TokenGuard, from_value,
};
use mom_drive::{
    DeviceChannel, Doing as _, Holding, REPEATED, TIMES, Tell, VerbFailure, both, closed, insist, lost_words,
};
use mom_pages::duration_within;
use serde_json::json;
use tokio::time::error::Elapsed;
use tokio::time::{Instant, timeout};

use crate::peer::report::Report;
use crate::task::{Side, Task};

/// Have the visual-servoing agent put one block beside another: give it the robot's token with a scope, and take it back
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct VerbArgs {
    /// The block that is moved, by its colour: red, green, blue, ...
    pub first: String,
    /// The block beside which it is put
    pub second: String,
    /// On which side of the second: right, left, front or back
    #[arg(long, default_value = "right")]
    pub side: Side,
    /// mm between their faces, 5 to 200
    #[arg(long, value_name = "MM", default_value = "20")]
    pub gap: f64,
    /// How long the agent may drive: 30s, 2m; at most 1h
    #[arg(long = "for", value_name = "TIME", default_value = "2m", value_parser = duration_within(Duration::from_millis(1)..=Duration::from_secs(3600)))]
    pub time: Duration,
    /// How many commands it may send
    #[arg(long, value_name = "N", default_value_t = 120, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub commands: u64,
    /// The agent's channel
    #[arg(long, value_name = "PATH", default_value = "/servo")]
    pub agent: String,
    /// The token that guards the robot
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    pub token: String,
    /// The robot's channel: it is stopped where the agent does not answer to Ctrl-C
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    pub robot: String,
    /// Wait in the token's queue for at most so many seconds
    #[arg(long, value_name = "SECONDS")]
    pub wait: Option<u64>,
}

const EXAMPLES: &str = "\
The agent works from the images of the cameras that stand: it takes the first block, puts it beside the second, looks, and
does so again until it is within 3 mm of its place. The side is that of the second block's face that looks most that way.
Its progress: what it does, the error as the images tell it, how old they are, and the time from a command to its effect.

Examples:
  mom servo red green
  mom servo red green --side left --gap 30
  mom servo blue red --for 1m --commands 40     it loses the token after a minute, or 40 commands
  mom servo red green --json | jq .mm

Ctrl-C takes the token back at once; the hub halts the robot, and the last line says where the block is. Where the agent does not answer
to it within a second, the robot is stopped, until a user lets it go (mom unstop), and 5 s after Ctrl-C this ends: the agent has the
token still, until the hub misses it or its scope is over.";

/// How long the agent may take to give the token back after it was cancelled.
const CANCELLED: Duration = Duration::from_secs(5);
/// How long the hub may take to tell the robot to stop.
const STOPPED: Duration = Duration::from_secs(2);
/// How long after the token's return its last word may take: the robot has that time to say that it stands.
const LAST: Duration = mom_drive::HALTED
    .saturating_add(REPEATED.saturating_mul(TIMES))
    .saturating_add(Duration::from_secs(1));

/// Works until the blocks are aligned, or `interrupt` is. The caller closes the client.
///
/// # Errors
///
/// [`VerbFailure`]; whatever happened, the token is released, unless another peer has it.
pub async fn run(
    args: &VerbArgs,
    client: &Client,
    interrupt: impl Future<Output = ()>,
    tell: Tell<'_>,
) -> Result<(), VerbFailure> {
    let task = Task::new(&args.first, &args.second, args.side, args.gap).map_err(VerbFailure::plain)?;
    let mut interrupt = pin!(interrupt);
    let begun = async {
        let agent = DeviceChannel::join(client, &args.agent).await?;
        find_agent(client, args).await?;
        let holding = Holding::grab(client, &args.token, args.wait.map(Duration::from_secs)).await?;
        Ok::<_, VerbFailure>((agent, holding))
    };
    let (agent, mut holding) = tokio::select! {
        begun = begun => begun?,
        () = &mut interrupt => return Err(VerbFailure::plain("interrupted before the token was grabbed")),
    };
    // Before anything is asked for, so that nothing is missed.
    let events = agent.events();
    let what = format!(
        "ask the agent in {} to put {} beside {}",
        args.agent, args.first, args.second
    );
    let asked = tokio::select! {
        asked = agent.ask("align", task.to_map(), &what) => asked,
        lost = lost(&mut holding) => return Err(VerbFailure::plain(lost_words(&args.token, &lost))),
        () = &mut interrupt => {
            cancel(&agent).await;
            Err(VerbFailure::plain("interrupted before the agent had the token"))
        }
    };
    let given = match asked {
        Ok(answer) => {
            let name = from_value::<Report>(answer).ok().and_then(|report| report.agent);
            let name = name.unwrap_or_else(|| "servo".to_owned());
            let give = holding
                .guard()
                .give(name.as_str())
                .time(args.time)
                .commands(args.commands);
            give.await.doing(format!("give {} to {name}", args.token))
        }
        Err(failure) => Err(failure),
    };
    let given = match given {
        Ok(given) => given,
        Err(failure) => return both(Err(failure), holding.release().await),
    };
    let loan = Loan {
        args,
        client,
        agent: &agent,
        events,
        last: None,
        tell,
    };
    loan.follow(given, interrupt).await
}

async fn lost(holding: &mut Holding) -> Lost {
    match holding
        .during(
            std::future::pending(),
            std::future::pending::<Result<(), VerbFailure>>(),
        )
        .await
    {
        mom_drive::WorkEnd::Lost(lost) => lost,
        _ => std::future::pending().await,
    }
}

/// Whether an agent is there that can do it.
async fn find_agent(client: &Client, args: &VerbArgs) -> Result<(), VerbFailure> {
    let members = client
        .members(&args.agent)
        .await
        .doing(format!("look into {}", args.agent))?;
    let me = client.name();
    if members
        .iter()
        .any(|member| member.peer != me && member.user == "servo")
    {
        return Ok(());
    }
    Err(VerbFailure::new(
        format!("the agent is not in {}", args.agent),
        "start it: MOM_PASSWORD=servo mom-servo; mom lab has one of its own",
    ))
}

/// Cancels the task, again and again; done when the agent has had its time to answer, even if nobody waits for that.
async fn cancel(agent: &DeviceChannel) {
    let cancel = || {
        let agent = agent.clone();
        let message = Parcel::new(Family::Message, "cancel").content(Map::new());
        // If it cannot be sent, the link is down, and the hub takes the token from its owner.
        async move { drop(agent.send(message, "cancel the task").await) }
    };
    let _nothing = insist(cancel, std::future::pending::<()>()).await;
}

/// Stops the robot whose driver does not answer: the lender cannot take the token back. Whether it was told.
async fn stop(client: &Client, robot: &str) -> Result<(), VerbFailure> {
    let device = DeviceChannel::join(client, robot).await?;
    let content = Map::new().with("reason", "the agent that drives it does not answer");
    let message = Parcel::new(Family::Message, "stop").content(content);
    device.send(message, &format!("stop {robot}")).await.map(drop)
}

/// The token is with the agent.
struct Loan<'a, 'b> {
    args: &'a VerbArgs,
    client: &'a Client,
    agent: &'a DeviceChannel,
    events: Events,
    /// The newest report, and when it came.
    last: Option<(Report, Instant)>,
    tell: Tell<'b>,
}

/// The token's return, or why it does not.
type Return = Pin<Box<dyn Future<Output = Result<TokenGuard, Lost>> + Send>>;

impl Loan<'_, '_> {
    async fn follow(
        mut self,
        mut given: Given,
        mut interrupt: Pin<&mut impl Future<Output = ()>>,
    ) -> Result<(), VerbFailure> {
        let mut interrupted = None;
        let agent = self.agent;
        let mut unanswered: Pin<Box<dyn Future<Output = ()> + Send + '_>> = Box::pin(std::future::pending());
        let accepted = tokio::select! {
            accepted = given.accepted() => accepted,
            () = &mut interrupt => {
                interrupted = Some(Instant::now());
                unanswered = Box::pin(cancel(agent));
                Ok(())
            }
        };
        let mut stopped = None;
        let lapsed = accepted.err();
        let mut returned: Return = Box::pin(given.returned());
        if let Some(lapsed) = lapsed {
            let failure = Err(VerbFailure::plain(format!(
                "the agent did not take the token: {}",
                lapsed.reason
            )));
            return both(failure, release(returned.await.ok()).await);
        }
        let end = loop {
            tokio::select! {
                biased;
                event = self.events.next() => self.note(&event.ok_or_else(closed)?)?,
                end = &mut returned => break end,
                () = &mut interrupt, if interrupted.is_none() => {
                    interrupted = Some(Instant::now());
                    unanswered = Box::pin(cancel(agent));
                }
                () = &mut unanswered, if stopped.is_none() => {
                    unanswered = Box::pin(std::future::pending());
                    if !self.ends() {
                        stopped = Some(timeout(STOPPED, stop(self.client, &self.args.robot)).await);
                        self.tell_of(&stopped)?;
                    }
                }
                () = silence(interrupted) => {
                    return Err(VerbFailure::new(
                        format!("interrupted; the agent does not answer and has the token still; {}; {}", self.stop_words(&stopped), self.whereabouts()),
                        format!("it loses the token when the hub misses it, or at the end of its scope ({} s); let the robot go then: mom unstop {}", self.args.time.as_secs(), self.args.robot),
                    ));
                }
            }
        };
        self.hear_last().await?;
        let verdict = match &stopped {
            None => self.verdict(),
            Some(_) => self.verdict().map_err(|failure| {
                let words = format!(
                    "{failure}; {}, as the agent did not answer",
                    self.stop_words(&stopped)
                );
                VerbFailure::new(words, format!("let it go with: mom unstop {}", self.args.robot))
            }),
        };
        match end {
            Ok(guard) => both(verdict, release(Some(guard)).await),
            Err(lost) => {
                let text = format!("{}; {}", lost_words(&self.args.token, &lost), self.whereabouts());
                Err(VerbFailure::plain(text))
            }
        }
    }

    /// Takes what the agent says of this task.
    fn note(&mut self, event: &Event) -> Result<(), VerbFailure> {
        if let Event::Message(parcel) = event
            && parcel.name() == "progress"
            && let Ok(report) = from_value::<Report>(parcel.value())
            && report.peer == self.agent.me()
        {
            // In one place, what a program is told and what people read.
            let json = serde_json::to_value(&report).unwrap_or_else(|_| json!({"state": report.state}));
            if report.state == "working" {
                (self.tell)(json, report.line())?;
            } else if report.state == "ending" {
                (self.tell)(json, "ending: waiting until the robot stands".to_owned())?;
            } else if report.is_last() {
                let text = report.text.clone().unwrap_or_default();
                (self.tell)(json, format!("{}: {text}", report.state))?;
            }
            self.last = Some((report, Instant::now()));
        }
        match event {
            Event::LinkDown => Err(VerbFailure::plain(format!(
                "the connection to the hub is lost, and the agent loses the token with it: the hub halts {}; {}",
                self.args.robot,
                self.whereabouts()
            ))),
            _ => Ok(()),
        }
    }

    /// Its last word may be on its way still.
    async fn hear_last(&mut self) -> Result<(), VerbFailure> {
        let until = Instant::now() + LAST;
        while !self.is_over() {
            let Ok(Some(event)) = tokio::time::timeout_at(until, self.events.next()).await else {
                break;
            };
            self.note(&event)?;
        }
        Ok(())
    }

    /// Says at once that the agent does not answer, and what became of the stop.
    fn tell_of(
        &mut self,
        stopped: &Option<Result<Result<(), VerbFailure>, Elapsed>>,
    ) -> Result<(), VerbFailure> {
        let words = format!("the agent does not answer; {}", self.stop_words(stopped));
        let json = json!({"state": "unanswered", "text": words});
        Ok((self.tell)(json, format!("{words}; waiting for the token"))?)
    }

    /// What became of the stop.
    fn stop_words(&self, stopped: &Option<Result<Result<(), VerbFailure>, Elapsed>>) -> String {
        let robot = &self.args.robot;
        match stopped {
            Some(Ok(Ok(()))) => format!("{robot} was told to stop"),
            Some(Ok(Err(failure))) => format!("{robot} was not stopped: {failure}"),
            Some(Err(_)) | None => format!("{robot} was not stopped"),
        }
    }

    /// Whether it has answered to an end.
    fn ends(&self) -> bool {
        let ends = |report: &Report| report.is_last() || report.state == "ending";
        self.last.as_ref().is_some_and(|(report, _)| ends(report))
    }

    fn is_over(&self) -> bool {
        self.last.as_ref().is_some_and(|(report, _)| report.is_last())
    }

    /// Where the first block is, by the agent's last word.
    fn whereabouts(&self) -> String {
        match &self.last {
            Some((report, at)) => {
                let text = report
                    .text
                    .as_deref()
                    .unwrap_or("the state of the block is unknown");
                format!("{text}, by its word of {:.1} s ago", at.elapsed().as_secs_f64())
            }
            None => format!("{} was not touched", self.args.first),
        }
    }

    /// What came of it, the token being back.
    fn verdict(&self) -> Result<(), VerbFailure> {
        let last = self.last.as_ref().filter(|(report, _)| report.is_last());
        match last.map(|(report, _)| report) {
            Some(report) if report.state == "done" => Ok(()),
            Some(report) => {
                let text = report.text.clone().unwrap_or_default();
                Err(VerbFailure::plain(format!("{text}; the token is released")))
            }
            None => Err(VerbFailure::plain(format!(
                "the scope is used up ({} s or {} commands) and the agent says nothing; {}; the token is released",
                self.args.time.as_secs(),
                self.args.commands,
                self.whereabouts()
            ))),
        }
    }
}

/// Too long after an interrupt.
async fn silence(interrupted: Option<Instant>) {
    match interrupted {
        Some(at) => tokio::time::sleep_until(at + CANCELLED).await,
        None => std::future::pending().await,
    }
}

async fn release(guard: Option<TokenGuard>) -> Result<(), VerbFailure> {
    let Some(guard) = guard else { return Ok(()) };
    let what = format!("release {}", guard.path());
    let released: Result<(), ClientError> = guard.release().await;
    released.doing(what)
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    #[derive(Debug, clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: VerbArgs,
    }

    #[test]
    fn defaults_and_limits() {
        let args = Line::try_parse_from(["servo", "red", "green"]).unwrap().args;
        assert_eq!(
            (args.side, args.gap, args.time, args.commands),
            (Side::Right, 20.0, Duration::from_secs(120), 120)
        );
        for (option, value, words) in [
            ("--side", "above", "is not a side: right, left, front or back"),
            ("--for", "2d", "a time must be a number with ms, s, m or h"),
            ("--for", "0s", "it must be a time from 1ms to 1h"),
            ("--commands", "0", "0 is not in 1..=10000"),
        ] {
            let error = Line::try_parse_from(["servo", "red", "green", option, value]).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
