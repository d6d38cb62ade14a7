//! The device's server: reacts to the events of its channel (M36).

use std::time::Duration;

use mom_client::event::Reason;
use mom_client::{
    Age, BASED_ON, Delivery, Event, Family, FenceGate, HUB, Latch, Map, Parcel, Path, Reaction, StateGate,
    Time, Value, event, to_value,
};

use crate::command::{Command, Order, Progress, QueueEvent, State};
use crate::estop::Estop;
use crate::fresh::Freshness;
use crate::pull::{NEXT, Pull};
use crate::queue::CommandQueue;
use crate::refusal::CommandRefusal;
use crate::script::script_of;
use crate::{DeviceError, DeviceTime, ErrorName, Machine, Script};

/// The message that carries a script.
pub const COMMAND: &str = "command";
/// The message that tells how far a command has come (M42).
pub const STATUS: &str = "status";
/// The number of the newest stop that it has heard of, in its state.
const STOP: &str = "stop";
/// The message that tells the device's state.
pub const STATE: &str = "state";
/// Whether an emergency stop at the device itself is pressed, in the states of a device that knows of one.
const ESTOP: &str = "estop";
/// ms within which it stands once it is to, in the state that who joins gets.
const STOPS_WITHIN: &str = "stops-within";
/// Why commands end at the hub's safe state.
const SAFE: &str = "the hub ordered the safe state, because the token's owner lost it or gave it up";

/// The decisions of a device's peer, without a connection and without a clock.
///
/// `handle` takes an event of the device's channel, `advance` lets time pass, `report` tells the state to all, `halt`
/// ends everything. What is to be sent is pushed to `out`, in order. The driver calls `advance` whenever
/// [`DeviceServer::next_wake`] is due.
///
/// - A command is obeyed if the fence gate lets it pass, if the state that it was based on (where it names one, as a relative
///   one has to) still holds (M35), if it is not too old, and if the device takes its script. Otherwise, and at every later
///   change, a `status` is broadcast (M42).
/// - Whenever the owner changes, for whatever reason, another token guards the channel, the hub sends `halt`, or the link is lost, all
///   commands end and the device stands at once: nothing of an old owner is ever under way when a command of the new one begins.
///   Where owners hand over by agreement and the hub sends no `halt`, the present statement comes to its end in a device that says so
///   ([`Machine::COMPLETES`]); what comes meanwhile is refused as `changing-hands`, and may be sent again.
/// - The first motion of a new owner waits until the device rests ([`Machine::TOLERANCE`]), at most twice its stopping time and a second;
///   then it is refused as `changing-hands`.
/// - Anybody's `stop` ends all commands too, and holds until an `unstop` that names it or a newer one ([`Latch`]). A gap in the events
///   is a stop of its own, of which it tells the hub, because it may have contained a `stop`. After each of both it says how it
///   stands, changed or not. It moves nothing before it has heard on this connection how it stands.
/// - An emergency stop at the device itself ([`Machine::estop`]) is a stop of its own, too. While it is pressed nothing is carried out,
///   whatever is lifted.
/// - A peer that joins the channel gets the state; after a lost link it is sent again.
#[derive(Debug)]
pub struct DeviceServer<M: Machine> {
    queue: CommandQueue<M>,
    channel: Path,
    /// Its own name at the hub, once it is known.
    name: Option<String>,
    /// Whether it may move.
    latch: Latch,
    states: StateGate,
    /// Where the device was in the last state that was told.
    told: Option<Map>,
    /// The token that guards its channel, once that was looked at.
    guard: Option<Option<Path>>,
    /// The newest fence of it that was heard of.
    fence: u64,
    /// That of the command that was taken last, 0 for the hub's.
    commanded: u64,
    /// What it asks for, if it does.
    pull: Option<Pull>,
    /// Whether its owner has given the token away, and nobody has it yet.
    handing_over: bool,
    estop: Estop,
    /// µs that a command may be old when it begins, whatever its sender says.
    max_age: Option<DeviceTime>,
}

impl<M: Machine> DeviceServer<M> {
    /// A server for a device that speaks on this channel, started at this time of day: no state of an earlier start passes for
    /// one of this.
    #[must_use]
    pub fn new(machine: M, channel: Path, start: Time) -> Self {
        Self {
            queue: CommandQueue::new(machine),
            channel,
            name: None,
            latch: Latch::default(),
            states: StateGate::new(start),
            told: None,
            guard: None,
            fence: 0,
            commanded: 0,
            pull: None,
            handing_over: false,
            estop: Estop::new(),
            max_age: None,
        }
    }

    /// This server, for commands that are not older than this when they begin, whatever their senders say.
    #[must_use]
    pub fn with_max_age(mut self, max_age: Duration) -> Self {
        self.max_age = Some(DeviceTime::try_from(max_age.as_micros()).unwrap_or(DeviceTime::MAX));
        self
    }

    /// This server, for a device whose time passes so many times as fast as that of its users, as a simulated one's may.
    #[must_use]
    pub fn at_pace(mut self, pace: u32) -> Self {
        self.queue = self.queue.at_pace(pace);
        self
    }

    /// Says what it is called at the hub, so that it can stop itself there.
    pub fn set_name(&mut self, name: String) {
        self.name = Some(name);
    }

    /// Has it ask for its commands, each time for so many µs, and take none that is not an answer or may be too old (W22).
    ///
    /// While it has nothing to do, [`DeviceServer::ask`] says `next {wait}`, ms. The token's owner answers by a `command` with the id of
    /// that in `reference`, and with `expires`. What comes later, answers an older request, or is of an unknown age is refused as
    /// `expired`.
    #[must_use]
    pub fn pulling(mut self, wait: DeviceTime) -> Self {
        self.pull = Some(Pull::new(wait));
        self
    }

    /// Asks for the next command, if that is due and the token has an owner.
    pub fn ask(&mut self, gate: &FenceGate, now: DeviceTime, out: &mut Vec<Parcel>) {
        if self.asks_at(gate).is_none_or(|due| due > now) {
            return;
        }
        let Some(wait) = self.pull.as_ref().map(Pull::wait) else {
            return;
        };
        let mut next = self.message(NEXT, Map::new().with("wait", wait / 1000));
        next.delivery = Some(Delivery::Latest);
        self.states.stamp(&mut next, false);
        if let Some(pull) = &mut self.pull {
            pull.ask(next.id, now);
        }
        out.push(next);
    }

    /// When [`DeviceServer::ask`] has to be called next.
    #[must_use]
    pub fn asks_at(&self, gate: &FenceGate) -> Option<DeviceTime> {
        let pull = self.pull.as_ref().filter(|_| !self.queue.is_busy())?;
        let owned = gate.guard().is_some_and(|guard| guard.owner.is_some());
        (owned && self.queue.check_free().is_ok()).then(|| pull.due())
    }

    /// Handles an event. `gate` is the channel's: it knows the fence of the present owner. `age` is how old a message
    /// is, as far as that is known.
    pub fn handle(
        &mut self,
        event: &Event,
        gate: &FenceGate,
        age: Option<Age>,
        now: DeviceTime,
        out: &mut Vec<Parcel>,
    ) {
        self.advance(now, out);
        self.watch_guard(gate, now, out);
        let reaction = self.latch.observe(event);
        self.estop.hear(event, self.name.as_deref());
        if let Some(reaction) = reaction {
            self.react(event, reaction, now, out);
        }
        match event {
            Event::Message(parcel) => self.handle_message(parcel, gate, age, now, out),
            Event::Joined(member) => {
                let mut state = self.full_state();
                state.address = Some(vec![member.peer.as_str().into()]);
                out.push(state);
            }
            // Without names of who joined, all are told.
            Event::Count(_) => self.report(out),
            event if event.is_gap() => self.report(out),
            Event::Rejoined | Event::Resumed => {
                self.report(out);
                self.tell_own_stop(out);
                self.tell_estop(out);
            }
            Event::Expelled { peer, text, .. } if self.name.as_ref() == Some(peer) => {
                let why = text.as_deref().unwrap_or("nobody says why");
                self.halt(
                    &format!("this device was put out of its channel: {why}"),
                    now,
                    out,
                );
            }
            Event::Grabbed { fence, .. } => self.take_owner(*fence, now, out),
            Event::Released { fence, reason, .. } => {
                let agreed = matches!(Reason::from_word(reason), Some(Reason::Given | Reason::Returned));
                self.handing_over = M::COMPLETES && agreed;
                self.end_older(fence.saturating_add(1), now, out);
            }
            _ => {}
        }
    }

    /// Lets time pass until `now`.
    pub fn advance(&mut self, now: DeviceTime, out: &mut Vec<Parcel>) {
        self.watch_estop(now, out);
        self.act(out, |queue, events| queue.advance(now, events));
    }

    /// When [`DeviceServer::advance`] is to be called next; `None` while the device has nothing to do.
    #[must_use]
    pub fn next_wake(&self) -> Option<DeviceTime> {
        self.queue.next_wake()
    }

    /// The device itself.
    pub fn machine(&self) -> &M {
        self.queue.machine()
    }

    /// The device itself, without its commands.
    pub(crate) fn into_machine(self) -> M {
        self.queue.into_machine()
    }

    /// How it stands.
    pub fn state(&self) -> State {
        self.queue.state()
    }

    /// Lets something be done to the device that no command does, such as that news of it have come.
    pub fn note(&mut self, now: DeviceTime, what: impl FnOnce(&mut M), out: &mut Vec<Parcel>) {
        self.act(out, |queue, events| queue.note(now, what, events));
    }

    /// Ends every command with this error, because the device cannot carry it out.
    pub fn fail(&mut self, now: DeviceTime, error: &DeviceError, out: &mut Vec<Parcel>) {
        self.act(out, |queue, events| queue.fail(now, error, events));
    }

    /// Ends every command, for a reason in plain words.
    pub fn halt(&mut self, reason: &str, now: DeviceTime, out: &mut Vec<Parcel>) {
        self.act(out, |queue, events| queue.halt(now, reason, events));
    }

    /// Tells all members of the channel the state.
    pub fn report(&mut self, out: &mut Vec<Parcel>) {
        self.watch_estop(self.queue.now(), out);
        out.push(self.full_state());
    }

    fn handle_message(
        &mut self,
        parcel: &Parcel,
        gate: &FenceGate,
        age: Option<Age>,
        now: DeviceTime,
        out: &mut Vec<Parcel>,
    ) {
        let sender = parcel.sender.as_deref().unwrap_or_default();
        match parcel.name() {
            COMMAND => {
                // The safe state that the token declares ends what the owner began, as `halt` does, and then moves the device.
                if sender == HUB {
                    self.halt(SAFE, now, out);
                }
                let order = Order {
                    peer: sender.into(),
                    id: parcel.id,
                    fence: parcel.fence,
                };
                let passed = gate.check(parcel).map_err(CommandRefusal::from);
                let obeyed = passed.and_then(|()| self.obey(order.clone(), parcel, age, now, out));
                if let Err(refusal) = obeyed {
                    let refused = Progress {
                        order,
                        statement: 0,
                        of: 0,
                    };
                    out.push(self.status_message(&refused, "error", refusal.content()));
                }
            }
            // Only the hub may send it; a peer that wants the device to stop has `stop`.
            event::HALT if sender == HUB => self.halt(SAFE, now, out),
            _ => {}
        }
    }

    /// Does what an event about stops means.
    fn react(&mut self, event: &Event, reaction: Reaction, now: DeviceTime, out: &mut Vec<Parcel>) {
        match reaction {
            Reaction::Stop(reason) => self.obey_stop(out, |queue, events| {
                queue.stop(now, &reason, ErrorName::Stopped, events);
            }),
            // It was said before the stop that the hub does not know yet.
            Reaction::Free if self.estop.owed().is_some() => self.report(out),
            Reaction::Free => self.obey_stop(out, |queue, events| queue.unstop(now, events)),
            Reaction::Halt if matches!(event, Event::LinkDown) => {
                self.halt("the link to the hub was lost", now, out);
            }
            Reaction::Halt => self.obey_stop(out, |queue, events| {
                queue.halt(now, "a stop has come that was lifted before", events);
            }),
            Reaction::Same => self.report(out),
        }
        if matches!(event, Event::Lagged(_)) {
            self.tell_own_stop(out);
        }
    }

    /// Tells the hub that it has stopped itself, if the hub does not know: from then on it is a stop like any other.
    fn tell_own_stop(&self, out: &mut Vec<Parcel>) {
        if let Err(held) = self.latch.may_move()
            && self.latch.is_own()
        {
            out.extend(self.own_stop(&held.to_string()));
        }
    }

    /// A stop that it says to itself, once it knows what it is called.
    fn own_stop(&self, reason: &str) -> Option<Parcel> {
        let mut stop = Parcel::new(Family::Message, event::STOP)
            .context(self.channel.clone())
            .content(Map::new().with("reason", reason));
        stop.address = Some(vec![self.name.as_deref()?.into()]);
        Some(stop)
    }

    /// Looks at the emergency stop of the device itself. Each press and each reset is a stop of its own: who resets it does not set the
    /// device in motion, nor does a velocity that is still being sent, nor an `unstop` that was said before.
    fn watch_estop(&mut self, now: DeviceTime, out: &mut Vec<Parcel>) {
        let Some(why) = self.estop.look(self.queue.machine().estop()) else {
            return;
        };
        let name = match self.estop.is_pressed() {
            true => ErrorName::Estop,
            false => ErrorName::Stopped,
        };
        self.obey_stop(out, |queue, events| queue.stop(now, why, name, events));
        self.tell_estop(out);
    }

    /// Tells the hub that its emergency stop was pressed or reset, as long as the hub does not know.
    fn tell_estop(&mut self, out: &mut Vec<Parcel>) {
        if let Some(why) = self.estop.to_say()
            && let Some(mut stop) = self.own_stop(&format!("stopped by itself: {why}"))
        {
            self.states.stamp(&mut stop, false);
            self.estop.said(stop.id);
            out.push(stop);
        }
    }

    /// Stops, or does so no more, and says how the device stands, changed or not.
    fn obey_stop(
        &mut self,
        out: &mut Vec<Parcel>,
        action: impl FnOnce(&mut CommandQueue<M>, &mut Vec<QueueEvent>),
    ) {
        let before = out.len();
        self.act(out, action);
        if !out[before..].iter().any(|parcel| parcel.name() == STATE) {
            self.report(out);
        }
    }

    fn obey(
        &mut self,
        order: Order,
        parcel: &Parcel,
        age: Option<Age>,
        now: DeviceTime,
        out: &mut Vec<Parcel>,
    ) -> Result<(), CommandRefusal> {
        // The token's events may still be under way; the command's fence has the same information.
        self.take_owner(order.fence.unwrap_or(0), now, out);
        self.states
            .set_moving(self.queue.is_busy() || self.queue.is_moving());
        self.states.check(parcel)?;
        if let Some(pull) = &self.pull {
            pull.check(parcel, age)?;
        }
        let content = parcel
            .content
            .as_ref()
            .and_then(|content| content.to_value().ok());
        let (script, attachments) = script_of(M::NAME, content.as_ref())?;
        if let Some(id) = order.id
            && self.queue.orders().any(|other| *other == order)
        {
            let text = format!(
                "command {id} of {} is still waiting or executing; choose another id",
                order.peer
            );
            return Err(DeviceError::new(ErrorName::DuplicateId, text).into());
        }
        if self.estop.is_pressed() {
            let text = format!(
                "the emergency stop of {} is pressed: reset it there, and then lift the stop",
                M::NAME
            );
            return Err(DeviceError::new(ErrorName::Estop, text).into());
        }
        self.queue.check_free()?;
        if let Err(held) = self.latch.may_move() {
            return Err(
                DeviceError::new(ErrorName::Stopped, format!("{} may not move: {held}", M::NAME)).into(),
            );
        }
        let script = Script::read_with::<M>(script, &attachments)?;
        if script.is_relative::<M>() && parcel.extra.get(BASED_ON).is_none() {
            let text =
                "a relative command requires the slot `based-on`: the id of the state that it is based on";
            return Err(DeviceError::new(ErrorName::NoState, text).into());
        }
        let commanded = order.fence.unwrap_or(0);
        let freshness = Freshness {
            max_age: self.max_age,
            pace: self.queue.pace(),
        };
        let command = Command {
            use_by: freshness.use_by(M::NAME, parcel, age, now)?,
            order,
            script,
        };
        let mut taken = Ok(());
        self.act(out, |mount, events| taken = mount.submit(command, now, events));
        taken?;
        self.commanded = commanded;
        if let Some(pull) = &mut self.pull {
            pull.renew(now);
        }
        Ok(())
    }

    /// Ends all commands where another token guards the channel than before, or one where none did: fences of two tokens say nothing of
    /// each other, and who was allowed before may not be now.
    fn watch_guard(&mut self, gate: &FenceGate, now: DeviceTime, out: &mut Vec<Parcel>) {
        let token = gate.guard().map(|guard| guard.token);
        if self.guard.as_ref() == Some(&token) {
            return;
        }
        let is_first = self.guard.replace(token).is_none();
        if !is_first {
            (self.fence, self.commanded, self.handing_over) = (0, 0, false);
            self.halt("another token guards its channel from now on", now, out);
        }
    }

    /// The token has an owner of this fence, perhaps a new one.
    fn take_owner(&mut self, fence: u64, now: DeviceTime, out: &mut Vec<Parcel>) {
        if fence <= self.fence {
            return;
        }
        // Before anything is told: each state from now on says that it stands for the new owner.
        self.fence = fence;
        if let Some(pull) = &mut self.pull {
            pull.renew(now);
        }
        let before = out.len();
        self.end_older(fence, now, out);
        self.handing_over = false;
        self.act(out, |queue, events| queue.change_hands(now, events));
        if !out[before..].iter().any(|parcel| parcel.name() == STATE) {
            self.report(out);
        }
    }

    /// Ends what older owners have begun, also what their commands left behind: its sender no longer owns the token.
    fn end_older(&mut self, fence: u64, now: DeviceTime, out: &mut Vec<Parcel>) {
        // What was sent without a fence, before the channel was guarded, is older than any; the hub's own is the safe state of a change.
        let is_older = |order: &Order| order.fence.unwrap_or(0) < fence && &*order.peer != HUB;
        let is_left = !self.queue.is_busy() && !self.queue.is_at_rest() && self.commanded < fence;
        if !is_left && !self.queue.orders().any(is_older) {
            return;
        }
        let reason = "the token changed hands";
        match self.handing_over {
            true => self.act(out, |queue, events| queue.end_statement(now, reason, events)),
            false => self.halt(reason, now, out),
        }
    }

    /// Lets the device act, and reports the outcome.
    fn act(
        &mut self,
        out: &mut Vec<Parcel>,
        action: impl FnOnce(&mut CommandQueue<M>, &mut Vec<QueueEvent>),
    ) {
        let mut events = Vec::new();
        action(&mut self.queue, &mut events);
        for event in events {
            out.push(match event {
                QueueEvent::Waiting(progress) => self.status_message(&progress, "waiting", None),
                QueueEvent::Executing(progress) => self.status_message(&progress, "executing", None),
                QueueEvent::Finished(progress) => self.status_message(&progress, "finished", None),
                QueueEvent::Failed(progress, error) => {
                    self.status_message(&progress, "error", to_value(&error).ok())
                }
                QueueEvent::State(state) => self.state_message(&state),
            });
        }
    }

    /// `{id?, peer, fence?, state, statement, of, error?}`, as a robot's.
    fn status_message(&self, progress: &Progress, state: &str, error: Option<Value>) -> Parcel {
        let Progress { order, statement, of } = progress;
        let mut content = id_map(order)
            .with("peer", &*order.peer)
            .with("state", state)
            .with("statement", *statement)
            .with("of", *of);
        if let Some(fence) = order.fence {
            content.set("fence", i64::try_from(fence).unwrap_or(i64::MAX));
        }
        if let Some(error) = error {
            content.set("error", error);
        }
        let mut parcel = self.message(STATUS, content);
        parcel.reference = order.id;
        parcel
    }

    /// The state with what never changes, for who has just come.
    fn full_state(&mut self) -> Parcel {
        let mut parcel = self.state_message(&self.queue.state());
        if let Value::Map(mut content) = parcel.value() {
            content.set(STOPS_WITHIN, M::STOPPING_TIME / 1000);
            parcel = parcel.content(content);
        }
        parcel
    }

    /// `{seq, …position, …report, moving, rest?, reached, stopped, estop?, stop, executing {id?, peer, statement, of}?, waiting, fence?}`.
    fn state_message(&mut self, state: &State) -> Parcel {
        let mut content = Map::new().with("seq", state.seq as i64);
        for (key, value) in state.position.iter().chain(state.report.iter()) {
            content.set(key, value.clone());
        }
        content.set("moving", state.moving);
        if let Some(rest) = state.rest {
            content.set("rest", rest.word());
        }
        content.set("reached", state.reached);
        content.set("stopped", state.stopped || self.estop.owed().is_some());
        if let Some(is_pressed) = self.estop.known() {
            content.set(ESTOP, is_pressed);
        }
        content.set(STOP, i64::try_from(self.latch.number()).unwrap_or(i64::MAX));
        if let Some(Progress { order, statement, of }) = &state.executing {
            let executing = id_map(order).with("peer", &*order.peer);
            content.set(
                "executing",
                executing.with("statement", *statement).with("of", *of),
            );
        }
        content.set("waiting", state.waiting as i64);
        if let Ok(fence @ 1..) = i64::try_from(self.fence) {
            content.set("fence", fence);
        }
        let mut parcel = self.message(STATE, content);
        parcel.delivery = Some(Delivery::Latest);
        let moved = self.told.as_ref() != Some(&state.position);
        if moved {
            self.told = Some(state.position.clone());
        }
        self.states.stamp(&mut parcel, moved);
        parcel
    }

    /// A broadcast without echo.
    fn message(&self, name: &str, content: Map) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, name)
            .context(self.channel.clone())
            .content(content);
        parcel.echo = Some(false);
        parcel
    }
}

/// `{id?}`.
fn id_map(order: &Order) -> Map {
    match order.id.and_then(|id| i64::try_from(id).ok()) {
        Some(id) => Map::new().with("id", id),
        None => Map::new(),
    }
}
