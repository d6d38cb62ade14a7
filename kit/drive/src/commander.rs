//! Driving a device: one command after the other, each to its end.

use std::future::{Future, pending};
use std::pin::{Pin, pin};
use std::time::Duration;

use mom_client::{BASED_ON, ClientError, Event, Events, Family, Lost, Map, Parcel, Value, from_value};
use serde::de::DeserializeOwned;
use tokio::time::{Instant, sleep_until, timeout, timeout_at};

use crate::asking::{ANSWER, DeviceChannel, closed};
use crate::course::Course;
use crate::end::{CommandEnd, Halt, Whose};
use crate::heard::{Report, StateNews};
use crate::step::{Basis, Progress, Step};
use crate::{VerbFailure, both};

/// A device that tells no state for so long is not there any more.
const SILENT: Duration = Duration::from_secs(30);

/// A command to a device.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct Command {
    /// Its statements.
    pub text: String,
    /// Bytes that they name, such as a sound: a map of names to binary values.
    pub attachments: Map,
    /// The state that it is based on.
    pub basis: Basis,
    /// ms after which it is worth nothing.
    pub expires: Option<u64>,
    /// Whether it is never sent again, whatever is in its way.
    pub once: bool,
    /// Whether it is sent when the device asks for it (`next`), and again when that did not begin it in time.
    pub pulls: bool,
}

impl From<&str> for Command {
    fn from(text: &str) -> Command {
        Command {
            text: text.to_owned(),
            ..Command::default()
        }
    }
}

impl From<String> for Command {
    fn from(text: String) -> Command {
        Command {
            text,
            ..Command::default()
        }
    }
}

impl Command {
    /// With bytes that its statements name.
    #[must_use]
    pub fn attachments(self, attachments: Map) -> Command {
        Command { attachments, ..self }
    }

    /// Relative to a state.
    #[must_use]
    pub fn based_on(self, basis: Basis) -> Command {
        Command { basis, ..self }
    }

    /// Worth nothing after so long.
    #[must_use]
    pub fn expires(self, time: Duration) -> Command {
        let expires = u64::try_from(time.as_millis()).ok();
        Command { expires, ..self }
    }

    /// Never sent again, whatever is in its way.
    #[must_use]
    pub fn once(self) -> Command {
        Command { once: true, ..self }
    }

    /// Sent when the device asks for it.
    #[must_use]
    pub fn when_asked(self) -> Command {
        Command { pulls: true, ..self }
    }
}

/// What happened next to a command.
#[derive(Debug, Clone, PartialEq)]
pub enum Next {
    /// It has come further.
    Progress(Progress),
    /// It has ended.
    End(CommandEnd),
}

/// A device that is driven under a token. It does not hold the token: its owner says that it is lost ([`Commander::lost`]), or ends
/// the work ([`Commander::end`]).
#[derive(Debug)]
pub struct Commander {
    channel: DeviceChannel,
    events: Events,
    course: Course,
    command: Command,
    fence: u64,
    since: Instant,
    /// The content of the newest state.
    state: Option<Value>,
}

impl Commander {
    /// Drives the device of this channel as the owner with this fence.
    #[must_use]
    pub fn new(channel: DeviceChannel, fence: u64) -> Commander {
        let events = channel.events();
        let whose = Whose {
            place: channel.path().clone(),
            token: channel.token().ok(),
        };
        Commander {
            course: Course::new(channel.me(), whose, fence),
            channel,
            events,
            command: Command::default(),
            fence,
            since: Instant::now(),
            state: None,
        }
    }

    /// Its channel.
    #[must_use]
    pub fn channel(&self) -> &DeviceChannel {
        &self.channel
    }

    /// Has a command carried out. What is in its way and passes (the device still does what its last owner began, its mechanism is out
    /// of reach, or our clock is being measured) is waited for.
    pub async fn carry_out(&mut self, command: impl Into<Command>) -> CommandEnd {
        self.begin(command);
        loop {
            if let Next::End(end) = self.next().await {
                return end;
            }
        }
    }

    /// Begins a command; [`next`](Self::next) says what becomes of it. One that has not ended goes on, and nothing more is heard of it.
    pub fn begin(&mut self, command: impl Into<Command>) {
        self.command = command.into();
        // What came between commands is not said of this one.
        self.newest_state();
        self.course.at(self.now());
        let Command {
            text,
            basis,
            pulls,
            once,
            ..
        } = &self.command;
        self.course.begin(text, *basis, *pulls, *once);
    }

    /// What happens next to the command that was begun; after its end it waits for ever. Cancel safe, but while the command is sent: it may
    /// be with the device then, and is told as `unanswered` where nothing more is heard of it.
    pub async fn next(&mut self) -> Next {
        loop {
            match self.course.poll() {
                Some(Step::Send { on, to }) => self.send(on, to).await,
                Some(Step::Ask) => {
                    let _asked = timeout(ANSWER, self.channel.ask_token()).await;
                    self.course.asked();
                }
                Some(Step::Tell(progress)) => return Next::Progress(progress),
                Some(Step::End(end)) => return Next::End(end),
                // These are steps of the end of the work.
                Some(Step::Release | Step::Stop | Step::Halted(_)) => {}
                None => self.hear().await,
            }
        }
    }

    /// The token is lost: how the command that is under way ends. None if none is.
    pub async fn lost(&mut self, lost: &Lost) -> Option<CommandEnd> {
        self.course.at(self.now());
        if !self.course.is_under_way() {
            return None;
        }
        self.course.lost(lost.clone());
        loop {
            if let Next::End(end) = self.next().await {
                return Some(end);
            }
        }
    }

    /// Ends the work: `release` gives the token back, and the device is heard to have ended what runs.
    ///
    /// # Errors
    /// The token was not taken back; a device that did not end its command, and was stopped or is silent.
    pub async fn end(
        &mut self,
        release: impl Future<Output = Result<(), VerbFailure>>,
    ) -> Result<(), VerbFailure> {
        let (released, halt) = self.halt(release).await;
        both(released, halt.verdict(self.channel.path().as_str()))
    }

    /// The same, and how the device took it.
    pub async fn halt(
        &mut self,
        release: impl Future<Output = Result<(), VerbFailure>>,
    ) -> (Result<(), VerbFailure>, Halt) {
        let (device, since) = (self.channel.clone(), self.since);
        let Commander {
            course,
            events,
            state,
            ..
        } = self;
        halting(course, &device, since, release, Ears::Channel { events, state }).await
    }

    /// The content of the newest state as its reader has it; waits for the first, and for one that is so.
    ///
    /// # Errors
    /// A device that tells none; a lost connection, lost events.
    pub async fn state_when<T: DeserializeOwned>(
        &mut self,
        is: impl Fn(&T) -> bool,
    ) -> Result<T, VerbFailure> {
        // What has come meanwhile is newer.
        while let Some(event) = self.events.try_next() {
            self.note(&event)?;
        }
        loop {
            if let Some(state) = self.state.clone()
                && let Ok(state) = from_value::<T>(state)
                && is(&state)
            {
                return Ok(state);
            }
            let event = timeout(SILENT, self.events.next()).await.map_err(|_| {
                let place = self.channel.path();
                let silent = SILENT.as_secs();
                VerbFailure::new(
                    format!("the device in {place} has told no state for {silent} s"),
                    "see who is there: mom tree",
                )
            })?;
            self.note(&event.ok_or_else(closed)?)?;
        }
    }

    /// The content of the newest state that has come; none if none has.
    pub fn newest_state(&mut self) -> Option<Value> {
        while let Some(event) = self.events.try_next() {
            self.course.at(self.now());
            feed(&mut self.course, &mut self.state, &event);
        }
        self.state.clone()
    }

    /// Lets it rest for so long; what is said meanwhile does not pile up.
    ///
    /// # Errors
    /// A lost connection, lost events.
    pub async fn rest(&mut self, time: Duration) -> Result<(), VerbFailure> {
        let until = Instant::now() + time;
        while let Ok(event) = timeout_at(until, self.events.next()).await {
            self.note(&event.ok_or_else(closed)?)?;
        }
        Ok(())
    }

    /// Takes an event between commands.
    fn note(&mut self, event: &Event) -> Result<(), VerbFailure> {
        self.course.at(self.now());
        feed(&mut self.course, &mut self.state, event);
        match event {
            Event::LinkDown => Err(VerbFailure::plain(
                "the connection to the hub is lost, and the token with it",
            )),
            Event::Lagged(_) => Err(VerbFailure::plain(
                "events of the device were lost here; what it did is not known",
            )),
            event if let Some(gone) = self.course.device().and_then(|device| gone(event, device)) => {
                Err(VerbFailure::new(
                    format!("{gone} {}", self.channel.path()),
                    "see who is there: mom tree",
                ))
            }
            _ => Ok(()),
        }
    }

    /// Waits for what happens next, and takes it.
    async fn hear(&mut self) {
        let due = self
            .course
            .next_wake()
            .map(|due| self.since + Duration::from_millis(due));
        let event = tokio::select! {
            biased;
            event = self.events.next() => Some(event),
            () = until(due) => None,
        };
        match event.is_some() {
            true => self.course.at(self.now()),
            false => self.course.wake(self.now()),
        }
        match event {
            Some(Some(event)) => feed(&mut self.course, &mut self.state, &event),
            Some(None) => {
                self.course.link_down();
                if !self.course.has_steps() {
                    pending::<()>().await;
                }
            }
            None => {}
        }
    }

    async fn send(&mut self, on: Option<u64>, to: Option<u64>) {
        let command = &self.command;
        let text = Value::from(command.text.as_str());
        let content = match command.attachments.is_empty() {
            true => text,
            false => Map::new()
                .with("script", text)
                .with("attachments", command.attachments.clone())
                .into(),
        };
        let mut parcel = Parcel::new(Family::Message, "command").content(content);
        // Not under another ownership, should the token be lost and come back meanwhile.
        parcel.fence = Some(self.fence);
        parcel.reference = to;
        parcel.expires = command.expires;
        if let Some(on) = on.and_then(|on| i64::try_from(on).ok()) {
            parcel.extra.set(BASED_ON, on);
        }
        let sent = self.channel.request(parcel).await;
        self.course.at(self.now());
        match sent {
            Ok(Some(id)) => self.course.sent(Some(id)),
            Ok(None) => self.course.sent(None),
            Err(ClientError::Refused(error) | ClientError::Local(error)) => self.course.refused(error),
            Err(ClientError::Connection(_) | ClientError::Closed(_)) => self.course.link_down(),
            Err(error) => self.course.unanswered(error.to_string()),
        }
    }

    fn now(&self) -> u64 {
        millis(self.since)
    }
}

fn millis(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_millis()).unwrap_or(u64::MAX)
}

async fn until(due: Option<Instant>) {
    match due {
        Some(due) => sleep_until(due).await,
        None => pending().await,
    }
}

/// Takes an event of the device's channel.
fn feed(course: &mut Course, state: &mut Option<Value>, event: &Event) {
    match event {
        Event::Message(parcel) => match parcel.name() {
            "state" => {
                if let Some(news) = StateNews::read(parcel) {
                    *state = Some(parcel.value());
                    course.state_told(news, parcel.sender.as_deref(), parcel.is_history());
                }
            }
            "status" if !parcel.is_history() => {
                if let Some(report) = Report::read(parcel) {
                    course.reported(report, parcel.sender.as_deref());
                }
            }
            "next" if !parcel.is_history() => {
                if let Some(id) = parcel.id {
                    course.asks(id);
                }
            }
            _ => {}
        },
        Event::Left(member) => course.gone(&member.peer, false),
        Event::Other(parcel) if parcel.is(Family::Event, mom_client::event::LOST) => {
            let lost = parcel.value();
            if let Some(peer) = lost.get("peer").and_then(Value::as_str) {
                course.gone(peer, true);
            }
        }
        Event::Other(parcel) if parcel.is(Family::Event, mom_client::event::DROPPED) => {
            let dropped = parcel.value();
            let word = |key: &str| dropped.get(key).and_then(Value::as_str);
            if word("sender") == Some(course.me()) {
                course.dropped(word("reason").unwrap_or_default(), word("receiver"));
            }
        }
        Event::LinkDown => course.link_down(),
        Event::Lagged(count) => course.lagged(*count),
        _ => {}
    }
}

/// That a device is not there any more, in words that a place follows: it has left, or its connection is lost, and what it does then
/// nobody can tell.
#[must_use]
pub fn gone(event: &Event, device: &str) -> Option<String> {
    match event {
        Event::Left(member) if member.peer == device => Some(format!("{device} has left")),
        Event::Other(parcel) if parcel.is(Family::Event, mom_client::event::LOST) => {
            let lost = parcel.value();
            let is_device = lost.get("peer").and_then(Value::as_str) == Some(device);
            is_device.then(|| format!("the hub has lost the connection of {device}, the device in"))
        }
        _ => None,
    }
}

/// Ends what runs in a device: `release` gives the token back, and the hub halts it. Where `ended` (it says that all is over) is not done
/// soon after that, it is told to stop.
pub async fn halt(
    device: &DeviceChannel,
    release: impl Future<Output = Result<(), VerbFailure>>,
    ended: impl Future<Output = ()> + Send,
) -> (Result<(), VerbFailure>, Halt) {
    let mut course = Course::running(device.path().clone());
    let ended = pin!(ended);
    halting(
        &mut course,
        device,
        Instant::now(),
        release,
        Ears::Told(Some(ended)),
    )
    .await
}

/// How the end of what runs is heard.
enum Ears<'a> {
    /// By what is said in the device's channel.
    Channel {
        events: &'a mut Events,
        state: &'a mut Option<Value>,
    },
    /// By who listens there: done once it has ended.
    Told(Option<Pin<&'a mut (dyn Future<Output = ()> + Send)>>),
}

impl Ears<'_> {
    async fn hear(&mut self, course: &mut Course) {
        match self {
            Ears::Channel { events, state } => match events.next().await {
                Some(event) => feed(course, state, &event),
                None => pending().await,
            },
            Ears::Told(ended) => {
                match ended {
                    Some(ended) => ended.as_mut().await,
                    None => pending().await,
                }
                *self = Ears::Told(None);
                course.has_ended();
            }
        }
    }
}

/// The end of the work under a token.
async fn halting(
    course: &mut Course,
    device: &DeviceChannel,
    since: Instant,
    release: impl Future<Output = Result<(), VerbFailure>>,
    mut ears: Ears<'_>,
) -> (Result<(), VerbFailure>, Halt) {
    let mut release = pin!(release);
    let mut released = None;
    let mut asked = false;
    let mut stopping: Pin<Box<dyn Future<Output = ()> + Send>> = Box::pin(pending());
    course.at(millis(since));
    course.cancel();
    loop {
        while let Some(step) = course.poll() {
            match step {
                Step::Release => asked = true,
                // Of three that cannot be sent, or hang, the next is due all the same.
                Step::Stop => stopping = Box::pin(stop(device.clone())),
                Step::Halted(halt) => {
                    let released = released.unwrap_or_else(|| {
                        Err(VerbFailure::plain(
                            "the hub does not say that it has the token back",
                        ))
                    });
                    return (released, halt);
                }
                Step::Send { .. } | Step::Tell(_) | Step::Ask | Step::End(_) => {}
            }
        }
        let due = course.next_wake().map(|due| since + Duration::from_millis(due));
        tokio::select! {
            biased;
            answer = &mut release, if asked && released.is_none() => {
                released = Some(answer);
                course.at(millis(since));
                course.released();
            }
            () = ears.hear(course) => {}
            () = until(due) => course.wake(millis(since)),
            () = &mut stopping => stopping = Box::pin(pending()),
        }
    }
}

async fn stop(device: DeviceChannel) {
    let content = Map::new().with("reason", "it did not end a command when its token was given back");
    let message = Parcel::new(Family::Message, "stop").content(content);
    drop(device.send(message, "stop").await);
}
