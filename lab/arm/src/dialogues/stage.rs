//! The stage of a dialogue: the arm's server, with a clock and a gate that its lines move.

use std::fmt::Write;

use mom_client::{
    Age, Delivery, Event, Family, FenceGate, Map, Member, Parcel, Path, StopState, Time, Value, from_value,
};
use mom_device::{COMMAND, DeviceServer, STATE};

use super::zones;
use crate::machine::ArmMachine;
use crate::motion::ArmTime;
use crate::status::Status;
use crate::zone_keeper::ZoneKeeper;
use crate::zones::Zones;

/// The server with a clock and a gate that a dialogue moves.
pub(super) struct Stage {
    pub(super) server: DeviceServer<ArmMachine>,
    keeper: ZoneKeeper,
    now: ArmTime,
    gate: FenceGate,
    /// ms that the next commands are old, with an error of 10 ms.
    pub(super) age: Option<i64>,
    pub(super) out: Vec<Parcel>,
    /// The ids of the states that were told, in order.
    pub(super) states: Vec<u64>,
    /// The newest fence under which it has said that it stands.
    pub(super) fence: Option<i64>,
}

impl Stage {
    /// An arm that rests under fence 5.
    pub(super) fn new() -> Self {
        Self::with(lab(), Zones::default(), |server| server)
    }

    /// The same with another arm, in zones, and with what the server is set to.
    pub(super) fn with(
        arm: ArmMachine,
        zones: Zones,
        set: impl FnOnce(DeviceServer<ArmMachine>) -> DeviceServer<ArmMachine>,
    ) -> Self {
        let channel = Path::parse("/robot/arm").unwrap();
        let mut stage = Self {
            server: set(DeviceServer::new(arm, channel, Time::default())),
            keeper: ZoneKeeper::new(zones),
            now: 0,
            gate: FenceGate::new(),
            age: None,
            out: Vec::new(),
            states: Vec::new(),
            fence: None,
        };
        stage.act("told 0");
        assert_eq!(stage.heard(), ["state free"]);
        stage.act("grabbed 5");
        assert_eq!(stage.heard(), ["state free, fence 5"]);
        stage.pass(400);
        assert_eq!(stage.heard(), ["state free at rest"]);
        stage
    }

    pub(super) fn tell(&mut self, event: &Event) {
        let age = self.age.map(|ms| Age {
            micros: ms * 1000,
            error_micros: Some(10_000),
        });
        // As its peer does.
        if matches!(event, Event::Message(_)) {
            self.keeper.observe(event, &self.gate);
            self.close();
        }
        self.server
            .handle(event, &self.gate, age, self.now, &mut self.out);
        if !matches!(event, Event::Message(_)) {
            self.keeper.observe(event, &self.gate);
            self.close();
        }
    }

    fn close(&mut self) {
        let closed = self.keeper.closed();
        if *self.server.machine().closed() != closed {
            self.server.note(self.now, |arm| arm.close(closed), &mut self.out);
        }
    }

    /// Tells the gate who owns the token.
    pub(super) fn guard(&self, owner: &str, fence: &str) {
        let guard = Map::new()
            .with("token", "/robot/token")
            .with("names", vec![COMMAND.into()])
            .with("fence", fence.parse::<i64>().unwrap());
        let guard = match owner {
            "-" => guard,
            owner => guard.with("owner", owner),
        };
        self.gate.joined(&Map::new().with("guard", guard));
    }

    /// The hub's word about stops.
    fn told(&mut self, number: &str, stopped: bool) {
        self.tell(&Event::Stops(StopState {
            number: number.parse().unwrap(),
            stopped,
            ..StopState::default()
        }));
    }

    /// Lets ms pass as a punctual driver does.
    pub(super) fn pass(&mut self, ms: ArmTime) {
        let until = self.now + ms * 1000;
        while let Some(due) = self.server.next_wake().filter(|due| *due <= until) {
            self.server.advance(due, &mut self.out);
        }
        self.now = until;
        self.server.advance(until, &mut self.out);
    }

    /// Does one line of a dialogue.
    pub(super) fn act(&mut self, line: &str) {
        let (line, script) = line.split_once(": ").unwrap_or((line, ""));
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["after", ms] => self.pass(ms.parse().unwrap()),
            ["gate", owner, fence] => self.guard(owner, fence),
            ["down"] => self.tell(&Event::LinkDown),
            ["told", number] => self.told(number, false),
            ["told", number, "stopped"] => self.told(number, true),
            ["rejoined"] => self.tell(&Event::Rejoined),
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
                path: Path::parse("/robot/token").unwrap(),
            }),
            ["expelled", peer] => self.tell(&Event::Expelled {
                peer: peer.to_owned(),
                by: None,
                text: Some("arm~2 is the device here now".to_owned()),
                path: Path::parse("/robot/arm").unwrap(),
            }),
            ["released", fence] => self.released("released", fence),
            ["given", fence] => self.released("given", fence),
            ["returned", fence] => self.released("returned", fence),
            ["zone", ..] => {
                self.keeper.hear(&zones::news(&words));
                self.close();
            }
            ["report"] => self.server.report(&mut self.out),
            [sender, "command", id, fence] => self.command(sender, id, fence, script, None),
            [sender, "command", id, fence, "expires", ms] => {
                let mut parcel = said(sender, COMMAND).content(script);
                (parcel.id, parcel.fence) = (id.parse().ok(), fence.parse().ok());
                parcel.expires = ms.parse().ok();
                self.tell(&Event::Message(parcel));
            }
            [sender, "command", id, fence, "on", state] => {
                let told = |back: usize| self.states[self.states.len() - back];
                let state = match state {
                    "newest" => Value::Int(told(1) as i64),
                    "next" => Value::Int(told(1) as i64 + 1),
                    "before" => Value::Int(told(2) as i64),
                    "first" => Value::Int(self.states[0] as i64),
                    other => other.into(),
                };
                self.command(sender, id, fence, script, Some(state));
            }
            [sender, name] => self.tell(&Event::Message(said(sender, name))),
            [sender, name, number] => {
                let mut parcel = said(sender, name);
                parcel.extra.set("stop", number.parse::<i64>().unwrap());
                self.tell(&Event::Message(parcel));
            }
            _ => panic!("no such line: {line}"),
        }
    }

    pub(super) fn command(
        &mut self,
        sender: &str,
        id: &str,
        fence: &str,
        script: &str,
        based_on: Option<Value>,
    ) {
        let mut parcel = said(sender, COMMAND).content(script);
        (parcel.id, parcel.fence) = (id.parse().ok(), fence.parse().ok());
        if let Some(based_on) = based_on {
            parcel.extra.set("based-on", based_on);
        }
        self.tell(&Event::Message(parcel));
    }

    fn released(&mut self, reason: &str, fence: &str) {
        self.tell(&Event::Released {
            owner: "somebody".to_owned(),
            reason: reason.to_owned(),
            by: None,
            fence: fence.parse().unwrap(),
            path: Path::parse("/robot/token").unwrap(),
        });
    }

    /// Whether a peer may be granted a zone, as far as the arm is concerned.
    pub(super) fn grant(&mut self, zone: &str, peer: &str) -> Result<(), String> {
        let zone = Path::parse(zone).unwrap();
        self.server.advance(self.now, &mut self.out);
        let state = self.server.state();
        let is_busy = state.executing.is_some() || state.waiting > 0;
        let arm = self.server.machine();
        let answer = self.keeper.grant(&zone, peer, &self.gate, arm, is_busy);
        self.close();
        answer
    }

    /// What was said since, one line each; states while the arm carries something out and moves are left out.
    pub(super) fn heard(&mut self) -> Vec<String> {
        let states = self.out.iter().filter(|parcel| parcel.name() == STATE);
        let ids: Vec<u64> = states.map(|state| state.id.unwrap()).collect();
        for id in ids {
            assert!(
                self.states.last().is_none_or(|last| *last < id),
                "ids of states rise"
            );
            self.states.push(id);
        }
        let mut lines = Vec::new();
        for parcel in self.out.drain(..) {
            let Some(mut line) = line_of(&parcel) else {
                continue;
            };
            let fence = parcel.value().get("fence").and_then(Value::as_int);
            if parcel.name() == STATE && fence != self.fence {
                assert!(fence > self.fence, "fences rise");
                self.fence = fence;
                line += &fence.map(|fence| format!(", fence {fence}")).unwrap_or_default();
            }
            // While it comes to rest it says so again and again.
            if lines.last() != Some(&line) || !line.ends_with(" moving") {
                lines.push(line);
            }
        }
        lines
    }
}

/// The lab's arm.
pub(super) fn lab() -> ArmMachine {
    ArmMachine::with_blocks(0, crate::Block::lab())
}

fn said(sender: &str, name: &str) -> Parcel {
    let mut parcel = Parcel::new(Family::Message, name);
    parcel.sender = Some(sender.into());
    parcel
}

fn line_of(parcel: &Parcel) -> Option<String> {
    assert_eq!(parcel.context.as_ref().unwrap().as_str(), "/robot/arm");
    assert_eq!(parcel.echo, Some(false));
    let content = parcel.value();
    let to: Vec<&str> = parcel.address.iter().flatten().map(|peer| &**peer).collect();
    let mut line = format!(
        "{}{}",
        parcel.name(),
        to.iter().map(|to| format!(" to {to}")).collect::<String>()
    );
    let word = |key: &str| content.get(key).and_then(Value::as_bool).unwrap();
    if parcel.name() == STATE {
        assert_eq!(parcel.delivery, Some(Delivery::Latest));
        if word("moving") && content.get("executing").is_some() {
            return None;
        }
        line += if word("stopped") { " stopped" } else { " free" };
        // Until it is known that it rests, it is not said to stand.
        line += match (word("moving"), content.get("rest").is_some()) {
            (true, _) => " moving",
            (false, true) => " at rest",
            (false, false) => "",
        };
        return Some(line);
    }
    let status: Status = from_value(content.clone()).unwrap();
    assert_eq!((parcel.reference, parcel.delivery), (status.id, None));
    let id = status.id.map_or("-".to_owned(), |id| id.to_string());
    let state = format!("{:?}", status.state).to_lowercase();
    write!(
        line,
        " {}/{id} {state} {}/{}",
        status.peer, status.statement, status.of
    )
    .unwrap();
    if let Some(error) = status.error {
        let (name, code) = (error.get("name").unwrap(), error.get("code").unwrap());
        assert!(!error.get("text").and_then(Value::as_str).unwrap().is_empty());
        write!(line, " {} {}", name.as_str().unwrap(), code.as_int().unwrap()).unwrap();
    }
    Some(line)
}

/// Plays a dialogue: lines with `>` are what must have been said since the line before.
pub(super) fn check(dialogue: &str) {
    let mut stage = Stage::new();
    let mut lines = dialogue
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .peekable();
    while let Some(line) = lines.next() {
        stage.act(line);
        let mut expected = Vec::new();
        while let Some(heard) = lines.next_if(|line| line.starts_with('>')) {
            expected.push(heard.trim_start_matches("> ").to_owned());
        }
        assert_eq!(stage.heard(), expected, "after `{line}` in {dialogue}");
    }
}
