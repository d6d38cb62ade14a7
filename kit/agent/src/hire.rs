//! Hiring an agent: it is asked for a task, lent the token with a scope, followed to its end, and the token is taken back.

use std::future::Future;
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_client::{
    Client, ClientError, Event, Events, Family, Given, Lost, Map, Parcel, TokenGuard, Value, visible,
};
use mom_drive::{
    DeviceChannel, Doing as _, Holding, REPEATED, TIMES, Tell, VerbFailure, WorkEnd, both, closed, insist,
    lost_words,
};
use serde_json::json;
use tokio::time::error::Elapsed;
use tokio::time::{Instant, timeout, timeout_at};

/// How long the agent may take to give the token back after it was cancelled.
const CANCELLED: Duration = Duration::from_secs(5);
/// How long the hub may take to tell the robot to stop.
const STOPPED: Duration = Duration::from_secs(2);
/// How long after the token's return its last word may take: the robot has that time to say that it stands.
const LAST: Duration = mom_drive::HALTED
    .saturating_add(REPEATED.saturating_mul(TIMES))
    .saturating_add(Duration::from_secs(1));

/// Letters of what an agent says that are shown.
const TEXT: usize = 500;

/// What an agent is hired for, and under which terms.
pub struct Hire<'a> {
    /// The agent's channel.
    pub channel: &'a str,
    /// The user as which it logs in, where that is known; otherwise any other peer in its channel is taken for it.
    pub user: Option<&'a str>,
    /// What to do if it is not there.
    pub absent: &'a str,
    /// The message by which it is asked.
    pub verb: &'a str,
    /// The task.
    pub task: Map,
    /// The same in words that follow "ask the agent in /servo to".
    pub words: String,
    /// The token that is lent.
    pub token: &'a str,
    /// How long it is waited for in the token's queue; none = not at all.
    pub wait: Option<Duration>,
    /// How long the agent may have it.
    pub time: Duration,
    /// How many commands it may send.
    pub commands: Option<u64>,
    /// The device, which is stopped where the agent does not answer to its end.
    pub robot: &'a str,
    /// What is known of the work as long as the agent has said nothing.
    pub untouched: String,
    /// How far the agent is, in a line for people.
    pub line: fn(&Map) -> String,
}

/// The newest word of an agent.
struct Report {
    content: Map,
    at: Instant,
}

impl Report {
    fn word(&self, key: &str) -> Option<&str> {
        self.content.get(key).and_then(Value::as_str)
    }

    fn state(&self) -> &str {
        self.word("state").unwrap_or_default()
    }

    fn text(&self) -> String {
        let text: String = self.word("text").unwrap_or_default().chars().take(TEXT).collect();
        visible(&text)
    }

    /// Whether nothing follows.
    fn is_last(&self) -> bool {
        !matches!(self.state(), "accepted" | "working" | "ending")
    }
}

impl Hire<'_> {
    /// Works until the agent has ended, or `interrupt` is done. The caller closes the client.
    ///
    /// # Errors
    ///
    /// [`VerbFailure`]; whatever happened, the token is released, unless another peer has it.
    pub async fn carry_out(
        &self,
        client: &Client,
        interrupt: impl Future<Output = ()>,
        tell: Tell<'_>,
    ) -> Result<(), VerbFailure> {
        let mut interrupt = pin!(interrupt);
        let begun = async {
            let agent = DeviceChannel::join(client, self.channel).await?;
            self.find(client).await?;
            let holding = Holding::grab(client, self.token, self.wait).await?;
            Ok::<_, VerbFailure>((agent, holding))
        };
        let (agent, mut holding) = tokio::select! {
            begun = begun => begun?,
            () = &mut interrupt => return Err(VerbFailure::plain("interrupted before the token was grabbed")),
        };
        // Before anything is asked for, so that nothing is missed.
        let events = agent.events();
        let what = format!("ask the agent in {} to {}", self.channel, self.words);
        let asked = tokio::select! {
            asked = agent.ask(self.verb, self.task.clone(), &what) => asked,
            lost = lost(&mut holding) => return Err(VerbFailure::plain(lost_words(self.token, &lost))),
            () = &mut interrupt => {
                cancel(&agent).await;
                Err(VerbFailure::plain("interrupted before the agent had the token"))
            }
        };
        let given = match asked {
            Ok(answer) => self.lend(&answer, &holding).await,
            Err(failure) => Err(failure),
        };
        let given = match given {
            Ok(given) => given,
            Err(failure) => return both(Err(failure), holding.release().await),
        };
        let loan = Loan {
            hire: self,
            client,
            agent: &agent,
            events,
            last: None,
            gone: None,
            tell,
        };
        loan.follow(given, interrupt).await
    }

    /// Whether an agent is there that can do it.
    async fn find(&self, client: &Client) -> Result<(), VerbFailure> {
        let members = client.members(self.channel).await;
        let members = members.doing(format!("look into {}", self.channel))?;
        let me = client.name();
        let is_it = |user: &str| self.user.is_none_or(|agent| agent == user);
        if members
            .iter()
            .any(|member| member.peer != me && is_it(&member.user))
        {
            return Ok(());
        }
        Err(VerbFailure::new(
            format!("the agent is not in {}", self.channel),
            self.absent,
        ))
    }

    /// Gives the token to the agent that has accepted the task.
    async fn lend(&self, accepted: &Value, holding: &Holding) -> Result<Given, VerbFailure> {
        let name = accepted.get("agent").and_then(Value::as_str);
        let name = name.ok_or_else(|| {
            let text = format!(
                "the agent in {} has accepted, and does not say to whom {} is to be given",
                self.channel, self.token
            );
            VerbFailure::plain(text)
        })?;
        let give = holding.guard().give(name).time(self.time);
        let give = match self.commands {
            Some(count) => give.commands(count),
            None => give,
        };
        give.await.doing(format!("give {} to {name}", self.token))
    }
}

async fn lost(holding: &mut Holding) -> Lost {
    let never = std::future::pending::<Result<(), VerbFailure>>();
    match holding.during(std::future::pending(), never).await {
        WorkEnd::Lost(lost) => lost,
        _ => std::future::pending().await,
    }
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
    hire: &'a Hire<'a>,
    client: &'a Client,
    agent: &'a DeviceChannel,
    events: Events,
    /// The newest report.
    last: Option<Report>,
    /// Why nothing more is heard of the agent.
    gone: Option<String>,
    tell: Tell<'b>,
}

/// The token's return, or why it does not.
type Return = Pin<Box<dyn Future<Output = Result<TokenGuard, Lost>> + Send>>;

/// What became of the stop; none if none was said.
type Stopped = Option<Result<Result<(), VerbFailure>, Elapsed>>;

impl Loan<'_, '_> {
    async fn follow(
        mut self,
        mut given: Given,
        mut interrupt: Pin<&mut impl Future<Output = ()>>,
    ) -> Result<(), VerbFailure> {
        let (mut interrupted, lent) = (None, Instant::now());
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
        let mut stopped: Stopped = None;
        let lapsed = accepted.err();
        let mut returned: Return = Box::pin(given.returned());
        if let Some(lapsed) = lapsed {
            let text = format!("the agent did not take the token: {}", lapsed.reason);
            return both(Err(VerbFailure::plain(text)), release(returned.await.ok()).await);
        }
        let end = loop {
            let overdue = self.overdue();
            tokio::select! {
                biased;
                event = self.events.next() => match event {
                    Some(event) => self.note(&event)?,
                    None => return Err(self.unheard()),
                },
                end = &mut returned => break end,
                () = reached(overdue) => return Err(self.not_back()),
                () = &mut interrupt, if interrupted.is_none() => {
                    interrupted = Some(Instant::now());
                    unanswered = Box::pin(cancel(agent));
                }
                () = &mut unanswered, if stopped.is_none() => {
                    unanswered = Box::pin(std::future::pending());
                    if !self.ends() {
                        stopped = Some(timeout(STOPPED, stop(self.client, self.hire.robot)).await);
                        self.tell_of(&stopped)?;
                    }
                }
                () = silence(interrupted) => return Err(self.silent(&stopped)),
            }
        };
        self.hear_last().await?;
        let verdict = self
            .verdict(lent.elapsed() >= self.hire.time)
            .map_err(|failure| match &stopped {
                None => failure,
                Some(_) => {
                    let stop = self.stop_words(&stopped);
                    let words = format!("{failure}; {stop}, as the agent did not answer");
                    VerbFailure::new(words, format!("let it go with: mom unstop {}", self.hire.robot))
                }
            });
        match end {
            Ok(guard) => both(verdict, release(Some(guard)).await),
            Err(lost) => {
                let text = format!("{}; {}", lost_words(self.hire.token, &lost), self.whereabouts());
                Err(VerbFailure::plain(text))
            }
        }
    }

    /// Takes what the agent says of this task.
    fn note(&mut self, event: &Event) -> Result<(), VerbFailure> {
        if let Event::Message(parcel) = event
            && parcel.name() == "progress"
            && !parcel.is_history()
            && let Value::Map(content) = parcel.value()
            && content.get("by").and_then(Value::as_str) == Some(&*self.agent.me())
        {
            let at = Instant::now();
            let report = Report { content, at };
            // In one place, what a program is told and what people read.
            let state = report.state();
            let json = serde_json::to_value(&report.content).unwrap_or_else(|_| json!({"state": state}));
            match state {
                "accepted" => {}
                "working" => (self.tell)(json, (self.hire.line)(&report.content))?,
                "ending" => (self.tell)(json, "ending: waiting until the robot stands".to_owned())?,
                state => {
                    let line = format!("{}: {}", visible(state), report.text());
                    (self.tell)(json, line)?;
                }
            }
            self.last = Some(report);
        }
        match event {
            Event::Expelled { peer, by, path, .. } if *peer == self.client.name() => {
                let by = by.as_deref().unwrap_or("a peer");
                self.gone = Some(format!("{by} has put you out of {path}"));
                Ok(())
            }
            Event::Deleted { path } => {
                self.gone = Some(format!("{path} was deleted"));
                Ok(())
            }
            Event::LinkDown => Err(VerbFailure::plain(format!(
                "the connection to the hub is lost, and the agent loses the token with it: the hub halts {}; {}",
                self.hire.robot,
                self.whereabouts()
            ))),
            _ => Ok(()),
        }
    }

    /// Its last word may be on its way still.
    async fn hear_last(&mut self) -> Result<(), VerbFailure> {
        let until = Instant::now() + LAST;
        while !self.is_over() {
            let Ok(Some(event)) = timeout_at(until, self.events.next()).await else {
                break;
            };
            self.note(&event)?;
        }
        Ok(())
    }

    /// That nothing more is heard of the agent, which hears that its task's peer is gone.
    fn unheard(&self) -> VerbFailure {
        match &self.gone {
            Some(gone) => VerbFailure::plain(format!(
                "{gone}: the agent ends its task as it does when you leave; {}",
                self.whereabouts()
            )),
            None => closed(),
        }
    }

    /// When the token has to be back: some time after the agent's last word.
    fn overdue(&self) -> Option<Instant> {
        let last = self.last.as_ref().filter(|report| report.is_last());
        last.map(|report| report.at + LAST)
    }

    /// That the agent has ended and the token has not come back.
    fn not_back(&self) -> VerbFailure {
        VerbFailure::new(
            format!("{}; {} has not come back", self.whereabouts(), self.hire.token),
            format!("mom token {} says who has it", self.hire.token),
        )
    }

    /// That the agent does not answer to its end, and has the token still.
    fn silent(&self, stopped: &Stopped) -> VerbFailure {
        VerbFailure::new(
            format!(
                "interrupted; the agent does not answer and has the token still; {}; {}",
                self.stop_words(stopped),
                self.whereabouts()
            ),
            format!(
                "it loses the token when the hub misses it, or at the end of its scope ({} s); let the robot go then: mom unstop {}",
                self.hire.time.as_secs(),
                self.hire.robot
            ),
        )
    }

    /// Says at once that the agent does not answer, and what became of the stop.
    fn tell_of(&mut self, stopped: &Stopped) -> Result<(), VerbFailure> {
        let words = format!("the agent does not answer; {}", self.stop_words(stopped));
        let json = json!({"state": "unanswered", "text": words});
        Ok((self.tell)(json, format!("{words}; waiting for the token"))?)
    }

    /// What became of the stop.
    fn stop_words(&self, stopped: &Stopped) -> String {
        let robot = self.hire.robot;
        match stopped {
            Some(Ok(Ok(()))) => format!("{robot} was told to stop"),
            Some(Ok(Err(failure))) => format!("{robot} was not stopped: {failure}"),
            Some(Err(_)) | None => format!("{robot} was not stopped"),
        }
    }

    /// Whether it has answered to an end.
    fn ends(&self) -> bool {
        let ends = |report: &Report| report.is_last() || report.state() == "ending";
        self.last.as_ref().is_some_and(ends)
    }

    fn is_over(&self) -> bool {
        self.last.as_ref().is_some_and(Report::is_last)
    }

    /// What is known of the work, by the agent's last word.
    fn whereabouts(&self) -> String {
        match &self.last {
            Some(report) => {
                let word = match report.text() {
                    text if text.is_empty() => visible(report.state()),
                    text => text,
                };
                format!(
                    "{word}, by its word of {:.1} s ago",
                    report.at.elapsed().as_secs_f64()
                )
            }
            None => self.hire.untouched.clone(),
        }
    }

    /// What came of it, the token being back; `is_used_up`: the scope's time is over.
    fn verdict(&self, is_used_up: bool) -> Result<(), VerbFailure> {
        match self.last.as_ref().filter(|report| report.is_last()) {
            Some(report) if report.state() == "done" => Ok(()),
            Some(report) => Err(VerbFailure::plain(format!(
                "{}; the token is released",
                report.text()
            ))),
            None => {
                let time = format!("{} s", self.hire.time.as_secs());
                let scope = match self.hire.commands {
                    Some(count) => format!("{time} or {count} commands"),
                    None => time,
                };
                let why = match is_used_up || self.hire.commands.is_some() {
                    true => format!("the agent has given the token back, or its scope is used up ({scope})"),
                    false => "the agent has given the token back".to_owned(),
                };
                Err(VerbFailure::plain(format!(
                    "{why}, and it does not say how the task ended; {}; the token is released",
                    self.whereabouts()
                )))
            }
        }
    }
}

/// Too long after an interrupt.
async fn silence(interrupted: Option<Instant>) {
    reached(interrupted.map(|at| at + CANCELLED)).await;
}

async fn reached(at: Option<Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at).await,
        None => std::future::pending().await,
    }
}

async fn release(guard: Option<TokenGuard>) -> Result<(), VerbFailure> {
    let Some(guard) = guard else { return Ok(()) };
    let what = format!("release {}", guard.path());
    let released: Result<(), ClientError> = guard.release().await;
    released.doing(what)
}
