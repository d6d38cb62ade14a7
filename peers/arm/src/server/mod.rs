//! The robot's server (M36): reacts to the events of its channel.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use mom_client::event::Reason;
use mom_client::{
    Age, BASED_ON, Delivery, Event, Family, FenceGate, HUB, Latch, Map, Parcel, Path, StateGate, Time, Value,
    WireError, event, to_value,
};

use mom_device::Rest;

use crate::arm::Arm;
use crate::error::{ArmError, ErrorName};
use crate::motion::ArmTime;
use crate::pose::Pose;
use crate::script::Script;
use crate::state::{ArmEvent, ArmState, CommandState, Executing, ScriptProgress};
use crate::status::{CommandRefusal, Status};
use crate::zones::Zones;

#[cfg(test)]
mod interlock_tests;
#[cfg(test)]
mod reach_tests;
#[cfg(test)]
mod stop_tests;
mod stops;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod zone_tests;
mod zones;

pub use zones::ZoneNews;

/// The message that carries a script.
pub const COMMAND: &str = "command";
/// The message that tells how far a command has come.
pub const STATUS: &str = "status";
/// The message that tells the arm's state.
pub const STATE: &str = "state";
/// Why commands end at the hub's safe state.
const SAFE: &str = "the hub ordered the safe state, because the token's owner lost it or gave it up";

/// The decisions of the robot's peer, without a connection and without a clock.
///
/// `handle` takes an event of the robot's channel, `advance` lets time pass, `report` tells the state to all,
/// `halt` ends everything. What is to be sent is pushed to `out`, in order. The driver calls `advance` whenever
/// [`RobotServer::next_wake`] is due.
///
/// - A command is obeyed if the fence gate lets it pass, if the state that it was based on (where it names one, as a relative one has to)
///   still holds (M35), if it is not too old, and if the arm takes its script. Otherwise, and at every later change, a `status` is
///   broadcast (M42).
/// - The event that the token changed hands, or a command of a newer fence, ends all commands of an older owner at once. Where
///   owners hand over by agreement and the hub sends no `halt`, the present statement comes to its end, and no other begins.
/// - Then the arm stands, and says so by a state with the new `fence`. A command of the new owner that comes before is refused as
///   `changing-hands`, and may be sent again.
/// - The hub's `halt` ends all commands, as does its command, the safe state of a token that declares one; anybody's
///   `stop` does, and holds until an `unstop` that names it or a newer one ([`Latch`]). A gap in the events is a stop of its own, of
///   which it tells the hub, because it may have contained a `stop`. The arm moves nothing before it has heard on this connection
///   how it stands.
/// - After each `stop` and `unstop` it says how it stands, changed or not, for whoever waits for that word.
/// - No leg leads through a zone that the commander does not own (M40), and one under way ends when that zone is lost.
/// - A lost link ends all commands; after it, the state is sent again.
/// - A peer that joins the channel gets the state.
#[derive(Debug)]
pub struct RobotServer {
    arm: Arm,
    channel: Path,
    /// Its own name at the hub, once it is known.
    name: Option<String>,
    /// Whether it may move.
    latch: Latch,
    /// Commands that the arm has accepted and not ended, by the arm's own ids, because senders' ids may coincide.
    orders: BTreeMap<u64, Order>,
    last_id: u64,
    states: StateGate,
    /// The arm's posture in the last reported state.
    told: Option<Position>,
    /// Whether the owner is about to change by agreement.
    handing_over: bool,
    /// The token that guards its channel, once that was looked at.
    guard: Option<Option<Path>>,
    /// The newest fence of it that was heard of.
    fence: u64,
    /// The newest fence under which the arm has said that it stands.
    stood: u64,
    /// µs that a command may be old when it begins; none if that is its sender's business alone.
    max_age: Option<ArmTime>,
    /// How many times as fast as the senders' time the arm's passes.
    pace: ArmTime,
    /// The zones that the arm shares with other machines.
    zones: Zones,
    /// Who owns the channel's token, as far as was heard; the zones of others are closed to it.
    commander: Option<String>,
    /// Whether it rests, since it was stopped; none while it is not.
    rest: Option<Rest>,
    now: ArmTime,
}

/// The part of the state that motions change and commands are based on: the hand, the jaws, and the held block.
#[derive(Debug, Clone, PartialEq)]
struct Position {
    pose: Pose,
    opening: f64,
    holding: Option<String>,
}

/// Whose command it is.
#[derive(Debug, Clone, PartialEq)]
struct Order {
    peer: Arc<str>,
    id: Option<u64>,
    fence: Option<u64>,
}

impl RobotServer {
    /// A server for an arm that speaks on this channel.
    #[must_use]
    pub fn new(arm: Arm, channel: Path) -> Self {
        Self {
            arm,
            channel,
            name: None,
            latch: Latch::default(),
            orders: BTreeMap::new(),
            last_id: 0,
            states: StateGate::new(Time::default()),
            told: None,
            handing_over: false,
            guard: None,
            fence: 0,
            stood: 0,
            max_age: None,
            pace: 1,
            zones: Zones::default(),
            commander: None,
            rest: None,
            now: 0,
        }
    }

    /// This server, for commands that are not older than this when they begin, whatever their senders say.
    #[must_use]
    pub fn with_max_age(mut self, max_age: Duration) -> Self {
        self.max_age = Some(ArmTime::try_from(max_age.as_micros()).unwrap_or(ArmTime::MAX));
        self
    }

    /// This server, for an arm whose time passes so many times as fast as that of its users.
    #[must_use]
    pub fn at_pace(mut self, pace: u32) -> Self {
        self.pace = pace.into();
        self.arm.set_pace(self.pace);
        self
    }

    /// This server, started at this time of day: no state of an earlier start passes for one of this.
    #[must_use]
    pub fn starting_at(mut self, time: Time) -> Self {
        self.states = StateGate::new(time);
        self
    }

    /// Handles an event. `gate` is the channel's: it knows the fence of the present owner. `age` is how old a message is, as far as that is known.
    pub fn handle(
        &mut self,
        event: &Event,
        gate: &FenceGate,
        age: Option<Age>,
        now: ArmTime,
        out: &mut Vec<Parcel>,
    ) {
        self.advance(now, out);
        self.watch_guard(gate, now, out);
        if let Some(reaction) = self.latch.observe(event) {
            self.react(event, reaction, now, out);
        }
        match event {
            Event::Message(parcel) => self.handle_message(parcel, gate, age, now, out),
            Event::Joined(member) => out.extend(self.state_message().map(|mut state| {
                state.address = Some(vec![member.peer.as_str().into()]);
                state
            })),
            // Without names of who joined, all are told.
            Event::Count(_) => self.report(out),
            Event::Grabbed { fence, owner, .. } if *fence >= self.fence => {
                self.take_owner(*fence, now, out);
                self.set_commander(Some(owner), now, out);
            }
            Event::Released { fence, reason, .. } => {
                let reason = Reason::from_word(reason);
                self.handing_over = matches!(reason, Some(Reason::Given | Reason::Returned));
                self.end_older(fence.saturating_add(1), now, out);
                if *fence >= self.fence {
                    self.set_commander(None, now, out);
                }
            }
            Event::LinkDown => self.set_commander(None, now, out),
            Event::Rejoined | Event::Resumed => {
                self.learn_commander(gate, now, out);
                self.report(out);
                self.tell_own_stop(out);
            }
            _ => {}
        }
    }

    /// Lets time pass until `now`.
    pub fn advance(&mut self, now: ArmTime, out: &mut Vec<Parcel>) {
        self.now = self.now.max(now);
        self.act(out, |arm, events| arm.advance(now, events));
        self.watch_rest(out);
    }

    /// When [`RobotServer::advance`] is to be called next; `None` while the arm has nothing to do.
    #[must_use]
    pub fn next_wake(&self) -> Option<ArmTime> {
        let look = self.rest.as_ref().filter(|_| self.arm.stands());
        let look = look.and_then(|rest| rest.next_look(self.now));
        self.arm.next_wake().into_iter().chain(look).min()
    }

    /// Ends every command, for a reason in plain words.
    pub fn halt(&mut self, reason: &str, now: ArmTime, out: &mut Vec<Parcel>) {
        self.act(out, |arm, events| arm.halt(now, reason, events));
    }

    /// Tells all members of the channel the state.
    pub fn report(&mut self, out: &mut Vec<Parcel>) {
        out.extend(self.state_message());
    }

    fn handle_message(
        &mut self,
        parcel: &Parcel,
        gate: &FenceGate,
        age: Option<Age>,
        now: ArmTime,
        out: &mut Vec<Parcel>,
    ) {
        let sender = parcel.sender.as_deref().unwrap_or_default();
        match parcel.name() {
            COMMAND => {
                // The safe state that the token declares ends what the owner began, as `halt` does, and then moves the arm.
                if sender == HUB {
                    self.halt(SAFE, now, out);
                }
                let order = Order {
                    peer: sender.into(),
                    id: parcel.id,
                    fence: parcel.fence,
                };
                let obeyed = gate
                    .check(parcel)
                    .map_err(CommandRefusal::from)
                    .and_then(|()| self.obey(order.clone(), parcel, age, now, out));
                if let Err(refusal) = obeyed {
                    let status = order.status().because(Some(&refusal));
                    out.extend(self.status_message(&status));
                }
            }
            // Only the hub may send it; a peer that wants the arm to stop has `stop`.
            event::HALT if sender == HUB => {
                self.halt(SAFE, now, out);
            }
            _ => {}
        }
    }

    /// Stops, or does so no more, and says how the arm stands, changed or not.
    fn obey_stop(&mut self, out: &mut Vec<Parcel>, action: impl FnOnce(&mut Arm, &mut Vec<ArmEvent>)) {
        let before = out.len();
        self.act(out, action);
        if !out[before..].iter().any(|parcel| parcel.name() == STATE) {
            self.report(out);
        }
    }

    fn obey(
        &mut self,
        order: Order,
        command: &Parcel,
        age: Option<Age>,
        now: ArmTime,
        out: &mut Vec<Parcel>,
    ) -> Result<(), CommandRefusal> {
        // The token's events may still be under way; the command's fence has the same information.
        self.take_owner(order.fence.unwrap_or(0), now, out);
        if order.fence == Some(self.fence) {
            self.set_commander(Some(&order.peer), now, out);
        }
        // The hub's own command is the safe state, for which the arm was halted.
        if self.stood < self.fence && &*order.peer != HUB {
            self.arm.check_link()?;
            let text = format!(
                "the arm is changing hands and still moves; send the command again when a state has fence {}",
                self.fence
            );
            return Err(ArmError::new(ErrorName::ChangingHands, text).into());
        }
        if let Err(held) = self.latch.may_move() {
            let text = format!("the arm may not move: {held}");
            return Err(ArmError::new(ErrorName::Stopped, text).into());
        }
        self.states.set_moving(self.arm.is_busy());
        self.states.check(command)?;
        let content = command.content.as_ref();
        let script = content.and_then(|content| content.to_value().ok());
        let script = script.as_ref().and_then(Value::as_str).ok_or_else(|| {
            let text =
                "the content of a command is its script, a string such as `move 100 50 200 0 0; grip close`";
            ArmError::new(ErrorName::Syntax, text)
        })?;
        if let Some(id) = order.id
            && self.orders.values().any(|other| *other == order)
        {
            let text = format!(
                "command {id} of {} is still waiting or executing; choose another id",
                order.peer
            );
            return Err(ArmError::new(ErrorName::DuplicateId, text).into());
        }
        // One that cannot be read is refused by the arm, which says where.
        let relative = script.parse::<Script>().is_ok_and(|script| script.is_relative());
        if relative && command.extra.get(BASED_ON).is_none() {
            let text = "a relative command is right in one place only: it has to name the state that it is based on, by that state's id in the slot `based-on`";
            return Err(ArmError::new(ErrorName::NoState, text).into());
        }
        let use_by = self.use_by(command, age, now)?;
        self.last_id += 1;
        let id = self.last_id;
        self.orders.insert(id, order);
        let mut taken = Ok(());
        self.act(out, |arm, events| {
            taken = arm.submit_fresh(id, script, use_by, now, events);
        });
        if taken.is_err() {
            self.orders.remove(&id);
        }
        Ok(taken?)
    }

    /// Until when a command may begin: until it expires, and until it is older than the arm allows. A limit with which an unknown age is compared is
    /// exceeded.
    fn use_by(&self, command: &Parcel, age: Option<Age>, now: ArmTime) -> Result<Option<ArmTime>, ArmError> {
        // The hub's own command is the safe state, which does not grow old.
        if command.sender.as_deref() == Some(HUB) {
            return Ok(None);
        }
        let expires = command
            .expires
            .and_then(|ms| ArmTime::try_from(ms.saturating_mul(1000)).ok());
        let later = |micros: ArmTime| now.saturating_add(micros.saturating_mul(self.pace));
        let expires = expires.map(|life| later(life - age.map_or(0, |age| age.micros)));
        let Some(max_age) = self.max_age else {
            return Ok(expires);
        };
        let Some(oldest) = age.and_then(|age| age.at_most()) else {
            let text = format!(
                "the arm takes commands of at most {} ms, and the age of this one is not known: its sender has not measured its clock yet",
                max_age / 1000
            );
            return Err(ArmError::new(ErrorName::TooOld, text).with_retry());
        };
        let oldest = ArmTime::try_from(oldest.as_micros()).unwrap_or(ArmTime::MAX);
        if oldest > max_age {
            let text = format!(
                "the command is {} ms old, and the arm takes those of at most {} ms",
                oldest / 1000,
                max_age / 1000
            );
            return Err(ArmError::new(ErrorName::TooOld, text));
        }
        let own = later(max_age - oldest);
        Ok(Some(expires.map_or(own, |expires| expires.min(own))))
    }

    /// Ends all commands where another token guards the channel than before, or one where none did: fences of two tokens say nothing of
    /// each other, and who was allowed before may not be now.
    fn watch_guard(&mut self, gate: &FenceGate, now: ArmTime, out: &mut Vec<Parcel>) {
        let token = gate.guard().map(|guard| guard.token);
        if self.guard.as_ref() == Some(&token) {
            return;
        }
        let is_first = self.guard.replace(token).is_none();
        if !is_first {
            (self.fence, self.stood, self.handing_over) = (0, 0, false);
            self.halt("another token guards its channel from now on", now, out);
        }
    }

    /// The token has an owner of this fence, perhaps a new one.
    fn take_owner(&mut self, fence: u64, now: ArmTime, out: &mut Vec<Parcel>) {
        if fence <= self.fence {
            return;
        }
        self.fence = fence;
        self.end_older(fence, now, out);
        self.handing_over = false;
        self.say_that_it_stands(out);
    }

    /// Ends what older owners have begun: its sender no longer owns the token. Where both sides agree, the hub halts the arm
    /// unless the token says otherwise, so the present statement comes to its end.
    fn end_older(&mut self, fence: u64, now: ArmTime, out: &mut Vec<Parcel>) {
        // What was sent without a fence, before the channel was guarded, is older than any; the hub's own is the safe state of a change.
        let is_older = |order: &Order| order.fence.unwrap_or(0) < fence && &*order.peer != HUB;
        if !self.orders.values().any(is_older) {
            return;
        }
        let reason = "the token changed hands";
        match self.handing_over {
            true => self.act(out, |arm, events| arm.end_statement(now, reason, events)),
            false => self.halt(reason, now, out),
        }
    }

    /// Says that the arm stands under the newest fence, once it does.
    fn say_that_it_stands(&mut self, out: &mut Vec<Parcel>) {
        if self.stood < self.fence && self.arm.stands() {
            self.report(out);
        }
    }

    /// Lets the arm act, and reports the outcome.
    fn act(&mut self, out: &mut Vec<Parcel>, action: impl FnOnce(&mut Arm, &mut Vec<ArmEvent>)) {
        let mut events = Vec::new();
        action(&mut self.arm, &mut events);
        for event in events {
            match event {
                ArmEvent::State(state) => out.extend(self.message_of_state(&state)),
                ArmEvent::Command {
                    id,
                    state,
                    progress,
                    error,
                } => self.tell(id, state, progress, error, out),
            }
        }
        self.say_that_it_stands(out);
    }

    fn tell(
        &mut self,
        id: u64,
        state: CommandState,
        progress: ScriptProgress,
        error: Option<ArmError>,
        out: &mut Vec<Parcel>,
    ) {
        let Some(order) = self.orders.get(&id) else { return };
        let error = error.map(CommandRefusal::from);
        let status = order.status().at(state, progress).because(error.as_ref());
        out.extend(self.status_message(&status));
        if matches!(state, CommandState::Finished | CommandState::Error) {
            self.orders.remove(&id);
        }
    }

    fn status_message(&self, status: &Status) -> Option<Parcel> {
        let mut parcel = self.message(STATUS, to_value(status))?;
        parcel.reference = status.id;
        Some(parcel)
    }

    fn state_message(&mut self) -> Option<Parcel> {
        self.message_of_state(&self.arm.state())
    }

    /// The state as the channel knows it: the command being carried out has its sender's id.
    fn message_of_state(&mut self, state: &ArmState) -> Option<Parcel> {
        if !state.moving && state.linked && state.executing.is_none() && state.waiting == 0 {
            self.stood = self.fence;
        }
        let content = to_value(state).map(|mut content| {
            if let (Value::Map(map), Some(executing)) = (&mut content, state.executing) {
                map.set("executing", self.executing(&executing));
            }
            if let Value::Map(map) = &mut content {
                map.set("reached", state.linked);
                if let Some(rest) = self.rest.as_ref().and_then(Rest::known) {
                    map.set("rest", rest.word());
                }
                map.set("stop", i64::try_from(self.latch.number()).unwrap_or(i64::MAX));
            }
            if let (Value::Map(map), Ok(fence @ 1..)) = (&mut content, i64::try_from(self.stood)) {
                map.set("fence", fence);
            }
            content
        });
        let mut parcel = self.message(STATE, content)?;
        parcel.delivery = Some(Delivery::Latest);
        let position = Position {
            pose: state.pose,
            opening: state.gripper.opening,
            holding: state.holding.clone(),
        };
        let moved = self.told.as_ref() != Some(&position);
        self.told = Some(position);
        self.states.stamp(&mut parcel, moved);
        Some(parcel)
    }

    fn executing(&self, executing: &Executing) -> Map {
        let mut map = Map::new();
        if let Some(order) = self.orders.get(&executing.id) {
            if let Some(id) = order.id.and_then(|id| i64::try_from(id).ok()) {
                map.set("id", id);
            }
            map.set("peer", &*order.peer);
        }
        map.with("statement", executing.statement)
            .with("of", executing.of)
    }

    /// A broadcast without echo.
    fn message(&self, name: &str, content: Result<Value, WireError>) -> Option<Parcel> {
        let content = content.inspect_err(|error| tracing::error!(%error, name, "a message was not sent"));
        let mut parcel = Parcel::new(Family::Message, name)
            .context(self.channel.clone())
            .content(content.ok()?);
        parcel.echo = Some(false);
        Some(parcel)
    }
}

impl Order {
    /// The status of a command that was not accepted.
    fn status(&self) -> Status {
        Status {
            id: self.id,
            peer: self.peer.to_string(),
            state: CommandState::Error,
            statement: 0,
            of: 0,
            error: None,
        }
    }
}
