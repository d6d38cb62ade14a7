//! The stage of a dialogue: a device's server, with a clock and a gate that its lines move.

use std::collections::VecDeque;
use std::time::Duration;

use mom_client::{
    Age, BASED_ON, Event, Family, FenceGate, Map, Member, Parcel, Path, StopState, Time, Value,
};
use mom_device::{COMMAND, DeviceServer, DeviceTime, Machine, STATE};

use crate::line::line_of;

const MS: DeviceTime = 1000;

/// What else hears the events of the channel: before the device where they are messages, after it where they are not.
type Beside<M> = Box<dyn FnMut(&Event, &FenceGate, &mut DeviceServer<M>, DeviceTime, &mut Vec<Parcel>)>;

/// What a device's machine tells what to do, and hears of: called for each millisecond that passes.
type Mechanism<M> = Box<dyn FnMut(&mut DeviceServer<M>, DeviceTime, &mut Vec<Parcel>)>;

/// A device's server with a clock and a gate that a dialogue moves.
pub struct Stage<M: Machine> {
    server: Option<DeviceServer<M>>,
    channel: Path,
    token: Path,
    beside: Option<Beside<M>>,
    mechanism: Option<Mechanism<M>>,
    push: Option<fn(&mut M)>,
    press: Option<fn(&mut M, bool)>,
    kept: Option<fn(&M) -> DeviceTime>,
    now: DeviceTime,
    /// Who owns the token, as the client knows it.
    pub gate: FenceGate,
    /// ms that the next commands are old, with an error of 10 ms.
    pub age: Option<i64>,
    /// What it has said since it was listened to.
    pub out: Vec<Parcel>,
    /// The ids of the states that were told, in order.
    pub states: Vec<u64>,
    /// The newest fence under which it has said that it stands.
    pub fence: Option<i64>,
    /// The newest state that was told.
    said: Map,
    /// What it is called.
    name: String,
    /// The ids of the stops that it has said, and that have not come back.
    stops: VecDeque<Option<u64>>,
}

impl<M: Machine> Stage<M> {
    /// A device of which nothing was heard yet, at `/robot/arm`, which `/robot/token` guards.
    pub fn bare(machine: M) -> Self {
        let channel = Path::parse("/robot/arm").unwrap();
        Self {
            server: Some(DeviceServer::new(machine, channel.clone(), Time::default())),
            channel,
            token: Path::parse("/robot/token").unwrap(),
            beside: None,
            mechanism: None,
            push: None,
            press: None,
            kept: None,
            now: 0,
            gate: FenceGate::new(),
            age: None,
            out: Vec::new(),
            states: Vec::new(),
            fence: None,
            said: Map::new(),
            name: String::new(),
            stops: VecDeque::new(),
        }
    }

    /// A device that rests under fence 5.
    pub fn new(machine: M) -> Self {
        Self::with(machine, |server| server)
    }

    /// The same, with what its server is set to.
    pub fn with(machine: M, set: impl FnOnce(DeviceServer<M>) -> DeviceServer<M>) -> Self {
        let mut stage = Self::bare(machine);
        stage.set(set);
        stage.begin()
    }

    /// This stage, once its device rests under fence 5.
    #[must_use]
    pub fn begin(mut self) -> Self {
        self.act("told 0");
        self.act("grabbed 5");
        self.act("rests");
        let heard = self.heard();
        let rests = |line: &String| line.starts_with("state free at rest");
        assert!(heard.last().is_some_and(rests), "{heard:?}");
        assert_eq!(self.fence, Some(5));
        self
    }

    /// This stage, with what moves the device though no command does.
    #[must_use]
    pub fn pushed_by(mut self, push: fn(&mut M)) -> Self {
        self.push = Some(push);
        self
    }

    /// This stage, with the emergency stop at the device itself, which is pressed or reset.
    #[must_use]
    pub fn pressed_by(mut self, press: fn(&mut M, bool)) -> Self {
        self.press = Some(press);
        self
    }

    /// Whether its device has an emergency stop of its own.
    pub fn is_pressed(&self) -> bool {
        self.press.is_some()
    }

    /// This stage, with when its mechanism was kept alive last.
    #[must_use]
    pub fn kept_by(mut self, kept: fn(&M) -> DeviceTime) -> Self {
        self.kept = Some(kept);
        self
    }

    /// Whether its device keeps its mechanism alive.
    pub fn is_kept(&self) -> bool {
        self.kept.is_some()
    }

    /// Whether its device can be pushed.
    pub fn is_pushed(&self) -> bool {
        self.push.is_some()
    }

    /// This stage, at a time that its machine knows already.
    #[must_use]
    pub fn at(mut self, now: DeviceTime) -> Self {
        self.now = now;
        self
    }

    /// This stage, with what the machine works by.
    #[must_use]
    pub fn driven_by(
        mut self,
        mechanism: impl FnMut(&mut DeviceServer<M>, DeviceTime, &mut Vec<Parcel>) + 'static,
    ) -> Self {
        self.mechanism = Some(Box::new(mechanism));
        self
    }

    /// This stage, with something beside the device that hears what it hears.
    #[must_use]
    pub fn beside(
        mut self,
        beside: impl FnMut(&Event, &FenceGate, &mut DeviceServer<M>, DeviceTime, &mut Vec<Parcel>) + 'static,
    ) -> Self {
        self.beside = Some(Box::new(beside));
        self
    }

    /// The server.
    pub fn server(&mut self) -> &mut DeviceServer<M> {
        self.server.as_mut().unwrap()
    }

    /// Changes what the server is set to.
    pub fn set(&mut self, set: impl FnOnce(DeviceServer<M>) -> DeviceServer<M>) {
        self.server = self.server.take().map(set);
    }

    /// Lets something be done to the device that no event does.
    pub fn note(&mut self, what: impl FnOnce(&mut M)) {
        let server = self.server.as_mut().unwrap();
        server.note(self.now, what, &mut self.out);
    }

    /// Has it hear an event of its channel.
    pub fn tell(&mut self, event: &Event) {
        let age = self.age.map(|ms| Age {
            micros: ms * MS,
            error_micros: Some(10_000),
        });
        let (now, server) = (self.now, self.server.as_mut().unwrap());
        let is_message = matches!(event, Event::Message(_));
        let mut hear = |server: &mut DeviceServer<M>, out: &mut Vec<Parcel>| {
            if let Some(beside) = &mut self.beside {
                beside(event, &self.gate, server, now, out);
            }
        };
        if is_message {
            hear(server, &mut self.out);
        }
        server.handle(event, &self.gate, age, now, &mut self.out);
        if !is_message {
            hear(server, &mut self.out);
        }
    }

    /// Tells the gate who owns the token; `-` = nobody.
    pub fn guard(&self, owner: &str, fence: &str) {
        let guard = Map::new()
            .with("token", self.token.as_str())
            .with("names", vec![COMMAND.into()])
            .with("fence", fence.parse::<i64>().unwrap());
        let guard = match owner {
            "-" => guard,
            owner => guard.with("owner", owner),
        };
        self.gate.joined(&Map::new().with("guard", guard));
    }

    /// Lets ms pass as a punctual driver does.
    pub fn pass(&mut self, ms: DeviceTime) {
        let until = self.now + ms * MS;
        while let (true, Some(mechanism)) = (self.now < until, &mut self.mechanism) {
            let server = self.server.as_mut().unwrap();
            self.now += MS;
            mechanism(server, self.now, &mut self.out);
            if server.next_wake().is_some_and(|due| due <= self.now) {
                server.advance(self.now, &mut self.out);
            }
        }
        let server = self.server.as_mut().unwrap();
        while let Some(due) = server.next_wake().filter(|due| *due <= until) {
            server.advance(due, &mut self.out);
        }
        self.now = until;
        server.advance(until, &mut self.out);
    }

    /// Lets time pass until it is so, for as long as a device may take for it.
    fn pass_until(&mut self, what: &str, mut is_so: impl FnMut(&mut DeviceServer<M>, &[Parcel]) -> bool) {
        let longest = 2 * M::STOPPING_TIME / MS + 70_000;
        for _ in 0..longest {
            if is_so(self.server.as_mut().unwrap(), &self.out) {
                return;
            }
            self.pass(1);
        }
        panic!("{what} never: {:?}", self.server().state());
    }

    /// Does one line of a dialogue.
    pub fn act(&mut self, line: &str) {
        if let Some(line) = line.strip_prefix("unheard ") {
            self.act(line);
            self.heard();
            return;
        }
        let (line, script) = line.split_once(": ").unwrap_or((line, ""));
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["max-age", ms] => {
                let max_age = Duration::from_millis(ms.parse().unwrap());
                self.set(|server| server.with_max_age(max_age));
            }
            ["name", name] => {
                name.clone_into(&mut self.name);
                self.server().set_name(name.to_owned());
            }
            ["age", ms] => self.age = ms.parse().ok(),
            ["after", ms] => self.pass(ms.parse().unwrap()),
            // The driver had no turn meanwhile.
            ["frozen", ms] => {
                self.now += ms.parse::<DeviceTime>().unwrap() * MS;
                let (now, server) = (self.now, self.server.as_mut().unwrap());
                server.advance(now, &mut self.out);
            }
            ["rests"] => {
                // Where a command waits for that, it moves again at once.
                self.pass_until("it rests", |server, out| {
                    let state = server.state();
                    (state.rest.is_some() && !state.moving)
                        || out
                            .iter()
                            .any(|parcel| parcel.name() == STATE && tells_rest(parcel))
                });
                self.leave_out_motion();
            }
            ["ends"] => {
                self.pass_until("all ends", |server, _| {
                    let state = server.state();
                    state.executing.is_none() && state.waiting == 0
                });
                self.leave_out_motion();
            }
            ["said", key, value] => {
                let said = match self.said.get(key) {
                    None => "-".to_owned(),
                    Some(Value::String(text)) => text.to_string(),
                    Some(value) => value.as_int().unwrap().to_string(),
                };
                assert_eq!(said, value, "{key} of the newest state");
            }
            ["fill", count] => {
                for id in 1..=count.parse().unwrap() {
                    self.command("alice", &[&format!("{id}"), "5"], "wait 1000");
                }
                self.out.clear();
            }
            ["report"] => {
                let server = self.server.as_mut().unwrap();
                server.report(&mut self.out);
            }
            [sender, "command", ..] => self.command(sender, &words[2..], script),
            ["pressed" | "reset" | "pushed"] | ["kept", _] => self.touch(&words),
            _ => self.happen(line, &words),
        }
    }

    /// Does something to the device itself, or looks at what it has done to its mechanism.
    fn touch(&mut self, words: &[&str]) {
        match *words {
            [word @ ("pressed" | "reset")] => {
                let press = self.press.unwrap();
                self.note(|machine| press(machine, word == "pressed"));
            }
            ["kept", word] => {
                let kept = self.kept.unwrap();
                let kept = kept(self.server().machine());
                let is_kept = self.now.saturating_sub(kept) <= 100 * MS;
                assert_eq!(
                    is_kept,
                    word == "alive",
                    "it was kept alive at {kept} of {}",
                    self.now
                );
            }
            ["pushed"] => {
                let push = self.push.unwrap();
                self.note(push);
            }
            _ => panic!("nothing is done to a device by {words:?}"),
        }
    }

    /// Leaves out the states that do not tell of rest: bodies roll for different times.
    fn leave_out_motion(&mut self) {
        let ids = self
            .out
            .iter()
            .filter(|parcel| parcel.name() == STATE)
            .filter_map(|parcel| parcel.id);
        self.states.extend(ids);
        self.out
            .retain(|parcel| parcel.name() != STATE || tells_rest(parcel));
    }

    /// Does a line that tells an event.
    fn happen(&mut self, line: &str, words: &[&str]) {
        match *words {
            ["gate", owner, fence] => self.guard(owner, fence),
            ["down"] => self.tell(&Event::LinkDown),
            ["told", number] => self.told(number, false),
            ["told", number, "stopped"] => self.told(number, true),
            ["rejoined"] => {
                // What it had said before does not come back.
                self.stops.clear();
                self.tell(&Event::Rejoined);
            }
            ["resumed"] => self.tell(&Event::Resumed),
            ["lagged"] => self.tell(&Event::Lagged(3)),
            ["count"] => self.tell(&Event::Count(300)),
            ["joined", peer] => self.tell(&Event::Joined(Member {
                peer: peer.to_owned(),
                user: peer.to_owned(),
                level: 1,
                device: false,
            })),
            ["grabbed", fence] => self.tell(&Event::Grabbed {
                owner: "somebody".to_owned(),
                level: 1,
                fence: fence.parse().unwrap(),
                lease: None,
                path: self.token.clone(),
            }),
            ["expelled", peer] => self.tell(&Event::Expelled {
                peer: peer.to_owned(),
                by: None,
                text: Some("arm~2 is the device here now".to_owned()),
                path: self.channel.clone(),
            }),
            [reason @ ("released" | "given" | "returned" | "expired"), fence] => {
                self.tell(&Event::Released {
                    owner: "somebody".to_owned(),
                    reason: reason.to_owned(),
                    by: None,
                    fence: fence.parse().unwrap(),
                    path: self.token.clone(),
                });
            }
            [sender, name] => self.tell(&Event::Message(said(sender, name))),
            [sender, name, number] => {
                let mut parcel = said(sender, name);
                if name == "stop" && *sender == self.name {
                    parcel.id = self.stops.pop_front().flatten();
                }
                parcel.extra.set("stop", number.parse::<i64>().unwrap());
                self.tell(&Event::Message(parcel));
            }
            _ => panic!("no such line: {line}"),
        }
    }

    /// The hub's word about stops.
    fn told(&mut self, number: &str, stopped: bool) {
        self.tell(&Event::Stops(StopState {
            number: number.parse().unwrap(),
            stopped,
            ..StopState::default()
        }));
    }

    /// `[id fence [expires ms | on state]]` of a command.
    fn command(&mut self, sender: &str, words: &[&str], script: &str) {
        let mut parcel = said(sender, COMMAND).content(script);
        match *words {
            [] => parcel.content = None,
            [id, fence, ref rest @ ..] => {
                (parcel.id, parcel.fence) = (id.parse().ok(), fence.parse().ok());
                match *rest {
                    [] => {}
                    ["expires", ms] => parcel.expires = ms.parse().ok(),
                    ["on", state] => parcel.extra.set(BASED_ON, self.state_of(state)),
                    _ => panic!("no such command: {words:?}"),
                }
            }
            _ => panic!("no such command: {words:?}"),
        }
        self.tell(&Event::Message(parcel));
    }

    /// The id of a state that a dialogue names.
    fn state_of(&self, word: &str) -> Value {
        let told = |back: usize| self.states[self.states.len() - back];
        match word {
            "newest" => Value::Int(told(1) as i64),
            "next" => Value::Int(told(1) as i64 + 1),
            "before" => Value::Int(told(2) as i64),
            "first" => Value::Int(self.states[0] as i64),
            other => other.parse::<i64>().map_or(other.into(), Value::Int),
        }
    }

    /// What was said since, one line each; states while the device carries something out and moves are left out.
    pub fn heard(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        for parcel in std::mem::take(&mut self.out) {
            assert_eq!(parcel.context.as_ref(), Some(&self.channel));
            if parcel.name() == STATE {
                let id = parcel.id.unwrap();
                // Of those that were passed over it is known already.
                if !self.states.contains(&id) {
                    assert!(
                        self.states.last().is_none_or(|last| *last < id),
                        "ids of states rise"
                    );
                    self.states.push(id);
                }
                self.said = parcel.value().as_map().cloned().unwrap();
            }
            if parcel.name() == "stop" {
                self.stops.push_back(parcel.id);
            }
            let Some(mut line) = line_of(&parcel) else {
                continue;
            };
            let fence = parcel.value().get("fence").and_then(Value::as_int);
            if parcel.name() == STATE && fence != self.fence {
                // Fences of two tokens say nothing of each other.
                assert!(fence.is_none() || fence > self.fence, "fences rise");
                self.fence = fence;
                line += &fence.map_or(", no fence".to_owned(), |fence| format!(", fence {fence}"));
            }
            // While it comes to rest it says so again and again.
            if lines.last() != Some(&line) || !line.ends_with(" moving") {
                lines.push(line);
            }
        }
        lines
    }
}

fn tells_rest(state: &Parcel) -> bool {
    state.value().get("rest").is_some()
}

fn said(sender: &str, name: &str) -> Parcel {
    let mut parcel = Parcel::new(Family::Message, name);
    parcel.sender = Some(sender.into());
    parcel
}
