//! Dialogues with the robot's server: who says what, and what the channel hears.

use std::fmt::Write;

use mom_client::{Member, StopState, from_value};

use super::*;
use crate::state::ArmState;

/// The server with a clock and a gate that a dialogue moves.
pub(super) struct Stage {
    pub(super) server: RobotServer,
    now: ArmTime,
    gate: FenceGate,
    /// ms that the next commands are old, with an error of 10 ms.
    pub(super) age: Option<i64>,
    pub(super) out: Vec<Parcel>,
    /// The ids of the states that were told, in order.
    states: Vec<u64>,
    /// The newest fence under which it has said that it stands.
    pub(super) fence: Option<i64>,
}

impl Stage {
    /// An arm that stands under fence 5.
    pub(super) fn new() -> Self {
        Self::with(Arm::new(0), |server| server)
    }

    /// The same with another arm, and with what the server is set to.
    pub(super) fn with(arm: Arm, set: impl FnOnce(RobotServer) -> RobotServer) -> Self {
        let channel = Path::parse("/robot/arm").unwrap();
        let mut stage = Self {
            server: set(RobotServer::new(arm, channel)),
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
        stage
    }

    fn tell(&mut self, event: &Event) {
        let age = self.age.map(|ms| Age {
            micros: ms * 1000,
            error_micros: Some(10_000),
        });
        self.server
            .handle(event, &self.gate, age, self.now, &mut self.out);
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
            ["released", fence] => self.released("released", fence),
            ["given", fence] => self.released("given", fence),
            ["returned", fence] => self.released("returned", fence),
            ["zone", ..] => {
                let news = super::zone_tests::news(&words);
                self.server.handle_zones(&news, self.now, &mut self.out);
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

    fn command(&mut self, sender: &str, id: &str, fence: &str, script: &str, based_on: Option<Value>) {
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
        self.server
            .grant(&zone, peer, &self.gate, self.now, &mut self.out)
    }

    /// What was said since, one line each; states while the arm moves are left out.
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
            lines.push(line);
        }
        lines
    }
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
        if word("moving") {
            return None;
        }
        line += if word("stopped") { " stopped" } else { " free" };
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

#[test]
fn a_command_goes_through_its_states() {
    check(
        "alice command 7 5: move 0 0 270 0 0; wait 100
         > status alice/7 waiting 0/2
         > status alice/7 executing 1/2
         alice command - 5: home
         > status alice/- waiting 0/1
         after 250
         > status alice/7 executing 2/2
         > state free
         after 1000
         > state free
         > status alice/7 finished 2/2
         > status alice/- executing 1/1
         > state free
         > status alice/- finished 1/1",
    );
}

#[test]
fn what_the_arm_cannot_do_is_refused_with_its_code() {
    check(
        "alice command 1 5: mvoe 1 2
         > status alice/1 error 0/0 syntax 5001
         alice command 2 5: move 0 0 900 0 0
         > status alice/2 error 0/0 workspace-boundary 5002
         alice command
         > status alice/- error 0/0 syntax 5001",
    );
}

#[test]
fn only_the_fence_of_the_owner_is_obeyed() {
    check(
        "gate bob 6
         alice command 1 5: home
         > status alice/1 error 0/0 older-fence 205
         alice command 2 -: home
         > status alice/2 error 0/0 older-fence 205
         bob command 1 6: wait 10
         > state free, fence 6
         > status bob/1 waiting 0/1
         > status bob/1 executing 1/1
         gate - 6
         bob command 2 6: home
         > status bob/2 error 0/0 older-fence 205",
    );
}

#[test]
fn ids_are_unique_per_sender_and_fence_only() {
    check(
        "alice command 1 5: wait 100
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         bob command 1 5: wait 100
         > status bob/1 waiting 0/1
         alice command 1 5: home
         > status alice/1 error 0/0 duplicate-id 5104
         after 100
         > state free
         > status alice/1 finished 1/1
         > status bob/1 executing 1/1
         alice command 1 5: wait 100
         > status alice/1 waiting 0/1
         alice command - 5: wait 1
         > status alice/- waiting 0/1
         alice command - 5: wait 1
         > status alice/- waiting 0/1",
    );
}

/// Everything that ends two commands of fence 5, and whether the arm is stopped after it.
#[test]
fn commands_end_when_control_is_lost() {
    for (line, stopped) in [
        ("hub halt", false),
        ("released 5", false),
        ("grabbed 6", false),
        ("down", false),
        ("bob stop", true),
        ("lagged", true),
    ] {
        let refused = "error 0/0 stopped 5102";
        let (word, code, next) = match stopped {
            true => ("stopped", "stopped 5102", refused),
            // It has not heard on the new connection whether it is stopped.
            false if line == "down" => ("free", "halted 5101", refused),
            false => ("free", "halted 5101", "waiting 0/1\n> status bob/3 executing 1/1"),
        };
        let fence = if line == "grabbed 6" { ", fence 6" } else { "" };
        check(&format!(
            "alice command 1 5: wait 100
             > status alice/1 waiting 0/1
             > status alice/1 executing 1/1
             alice command 2 5: home
             > status alice/2 waiting 0/1
             {line}
             > state {word}{fence}
             > status alice/1 error 1/1 {code}
             > status alice/2 error 0/1 {code}
             bob command 3 7: wait 9
             > state {word}, fence 7
             > status bob/3 {next}"
        ));
    }
}

#[test]
fn what_takes_no_control_away_ends_nothing() {
    for line in [
        "released 4",
        "grabbed 5",
        "bob halt",
        "bob unstop\n> state free",
        "bob chat",
    ] {
        check(&format!(
            "alice command 1 5: wait 100
             > status alice/1 waiting 0/1
             > status alice/1 executing 1/1
             {line}
             after 100
             > state free
             > status alice/1 finished 1/1"
        ));
    }
}

#[test]
fn a_newer_fence_ends_what_an_older_one_began() {
    check(
        "alice command 1 5: wait 100
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         bob command 1 6: wait 100
         > state free, fence 6
         > status alice/1 error 1/1 halted 5101
         > status bob/1 waiting 0/1
         > status bob/1 executing 1/1
         released 5
         grabbed 6
         after 100
         > state free
         > status bob/1 finished 1/1",
    );
}

#[test]
fn a_stop_latches_until_it_is_released() {
    check(
        "bob stop
         > state stopped
         carol stop
         > state stopped
         released 5
         alice command 1 5: home
         > status alice/1 error 0/0 stopped 5102
         rejoined
         > state stopped
         carol unstop
         > state free
         alice command 2 5: wait 1
         > status alice/2 waiting 0/1
         > status alice/2 executing 1/1",
    );
}

/// A velocity holds for its time, gives way to the next one, and is refused while a script is carried out.
#[test]
fn a_jog_ends_at_rest_unless_it_is_said_again() {
    check(
        "alice command 1 5: jog 100 0 0 0 0
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         after 150
         alice command 2 5: jog 100 0 0 0 0
         > status alice/1 finished 1/1
         > status alice/2 waiting 0/1
         > status alice/2 executing 1/1
         alice command 3 5: home
         > status alice/3 error 0/0 busy 5106
         after 200
         alice command 4 5: home
         > status alice/4 error 0/0 busy 5106
         after 170
         > state free
         > status alice/2 finished 1/1
         alice command 5 5: home
         > status alice/5 waiting 0/1
         > status alice/5 executing 1/1
         alice command 6 5: jog 10 0 0 0 0
         > status alice/6 error 0/0 busy 5106
         after 1000
         > state free
         > status alice/5 finished 1/1
         alice command 7 5: jog 10 0 0 0 0; home
         > status alice/7 error 0/0 syntax 5001
         alice command 8 5: jog 200 0 0 0 0
         > status alice/8 error 0/0 syntax 5001
         alice command 9 5: jog 20 0 0 0 0 2000
         > status alice/9 error 0/0 syntax 5001
         alice command 9 5: jog 150 0 0 0 0 1000
         > status alice/9 waiting 0/1
         > status alice/9 executing 1/1
         bob stop
         > state stopped
         > status alice/9 error 1/1 stopped 5102",
    );
}

#[test]
fn what_was_meant_for_an_earlier_state_is_refused() {
    check(
        "report
         > state free
         report
         > state free
         alice command 1 5 on before: move 0 0 270 0 0
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         alice command 2 5 on newest: home
         > status alice/2 error 0/0 stale-state 208
         alice command 3 5: wait 10
         > status alice/3 waiting 0/1
         after 1000
         > state free
         > status alice/1 finished 1/1
         > status alice/3 executing 1/1
         > state free
         > status alice/3 finished 1/1
         alice command 4 5 on before: wait 10
         > status alice/4 waiting 0/1
         > status alice/4 executing 1/1
         after 10
         > state free
         > status alice/4 finished 1/1
         alice command 5 5: home
         > status alice/5 waiting 0/1
         > status alice/5 executing 1/1
         after 1000
         > state free
         > status alice/5 finished 1/1
         alice command 6 5 on before: home
         > status alice/6 error 0/0 stale-state 208
         alice command 7 5 on next: home
         > status alice/7 error 0/0 stale-state 208
         alice command 8 5 on red: home
         > status alice/8 error 0/0 bad-slot 220
         alice command 9 5 on newest: wait 10
         > status alice/9 waiting 0/1
         > status alice/9 executing 1/1",
    );
}

#[test]
fn the_jaws_move_too_and_a_refusal_names_the_newest_state() {
    let mut stage = Stage::new();
    stage.act("report");
    stage.heard();
    stage.act("alice command 1 5: grip close");
    stage.pass(1000);
    stage.heard();
    let newest = *stage.states.last().unwrap();
    let first = stage.states[0];
    stage.command("alice", "2", "5", "home", Some(Value::Int(first as i64)));
    let error = stage.out[0].value().get("error").cloned().unwrap();
    assert_eq!(error.get("state"), Some(&Value::Int(newest as i64)));
    assert_eq!(stage.heard(), ["status alice/2 error 0/0 stale-state 208"]);
}

#[test]
fn a_state_of_an_earlier_start_is_no_state_of_this_one() {
    let mut before = Stage::new();
    before.act("report");
    before.heard();
    let mut stage = Stage::new();
    stage.server = stage.server.starting_at(Time::from_micros(1_000_000).unwrap());
    stage.act("report");
    stage.heard();
    let old = Value::Int(before.states[0] as i64);
    stage.command("alice", "1", "5", "home", Some(old));
    assert_eq!(stage.heard(), ["status alice/1 error 0/0 stale-state 208"]);
}

#[test]
fn who_joins_is_told_the_state() {
    check(
        "joined bob
         > state to bob free
         count
         > state free
         down
         rejoined
         > state free",
    );
}

#[test]
fn states_come_at_20_hz_and_name_the_command_as_its_sender_does() {
    let mut stage = Stage::new();
    stage.act("alice command 1 5: wait 1");
    stage.pass(1);
    stage.out.clear();
    stage.act("bob command 41 5: move 0 0 150 0 0");
    stage.pass(900);
    let states: Vec<Value> = stage
        .out
        .iter()
        .filter(|parcel| parcel.name() == STATE)
        .map(Parcel::value)
        .collect();
    assert_eq!(states.len(), 18);
    for state in &states {
        let executing = state.get("executing").unwrap();
        assert_eq!(executing.get("id"), Some(&Value::Int(41)));
        assert_eq!(executing.get("peer").and_then(Value::as_str), Some("bob"));
        let read: ArmState = from_value(state.clone()).unwrap();
        assert!(read.moving && read.pose.z < 300.0);
    }
}
