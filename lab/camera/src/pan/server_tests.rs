//! Dialogues with the mount's server: who says what, and what the channel hears.

use std::fmt::Write as _;

use mom_client::{
    BASED_ON, Delivery, Event, Family, FenceGate, Map, Member, Parcel, Path, StopState, Time, Value,
};
use mom_device::{DeviceServer, DeviceTime};

use super::Mount;

const COMMAND: &str = "command";
const STATE: &str = "state";

const MS: DeviceTime = 1000;

/// The server with a clock and a gate that a dialogue moves.
struct Stage {
    server: DeviceServer<Mount>,
    now: DeviceTime,
    gate: FenceGate,
    out: Vec<Parcel>,
    /// The ids of the states that were told, in order.
    states: Vec<u64>,
    fence: Option<i64>,
    /// The last state that was told, without its number and what never changes.
    known: Option<Map>,
}

impl Stage {
    /// A mount that stands under fence 5.
    fn new() -> Self {
        let channel = Path::parse("/camera/pan").unwrap();
        let mut stage = Self {
            server: DeviceServer::new(Mount::default(), channel, Time::default()),
            now: 0,
            gate: FenceGate::new(),
            out: Vec::new(),
            states: Vec::new(),
            fence: None,
            known: None,
        };
        stage.act("told 0");
        // Until it knows that it rests.
        stage.pass(400);
        assert_eq!(stage.heard(), ["state 0 -20 free"]);
        stage.act("grabbed 5");
        assert_eq!(stage.heard(), ["state 0 -20 free, fence 5"]);
        stage
    }

    fn tell(&mut self, event: &Event) {
        self.server
            .handle(event, &self.gate, None, self.now, &mut self.out);
    }

    /// Tells the gate who owns the token.
    fn guard(&self, owner: &str, fence: &str) {
        let guard = Map::new()
            .with("token", "/camera/pan-token")
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
    fn pass(&mut self, ms: DeviceTime) {
        let until = self.now + ms * MS;
        while let Some(due) = self.server.next_wake().filter(|due| *due <= until) {
            self.server.advance(due, &mut self.out);
        }
        self.now = until;
        self.server.advance(until, &mut self.out);
    }

    /// Does one line of a dialogue.
    fn act(&mut self, line: &str) {
        let (line, script) = line.split_once(": ").unwrap_or((line, ""));
        let words: Vec<&str> = line.split(' ').collect();
        match words[..] {
            ["after", ms] => self.pass(ms.parse().unwrap()),
            ["gate", owner, fence] => self.guard(owner, fence),
            ["down"] => self.tell(&Event::LinkDown),
            ["told", number] => self.told(number, false),
            ["told", number, "stopped"] => self.told(number, true),
            ["rejoined"] => self.tell(&Event::Rejoined),
            ["lagged"] => self.tell(&Event::Lagged(3)),
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
                path: Path::parse("/camera/pan-token").unwrap(),
            }),
            ["released", fence] => self.released("expired", fence),
            ["given", fence] => self.released("given", fence),
            [sender, "command", id, fence] => self.command(sender, id, fence, script, |_| {}),
            [sender, "command", id, fence, "expires", ms] => {
                let ms = ms.parse().ok();
                self.command(sender, id, fence, script, |parcel| parcel.expires = ms);
            }
            [sender, "command", id, fence, "on", state] => {
                let told = |back: usize| self.states[self.states.len() - back];
                let state = match state {
                    "newest" => Value::Int(told(1) as i64),
                    "before" => Value::Int(told(2) as i64),
                    other => other.into(),
                };
                self.command(sender, id, fence, script, |parcel| {
                    parcel.extra.set(BASED_ON, state);
                });
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

    fn command(
        &mut self,
        sender: &str,
        id: &str,
        fence: &str,
        script: &str,
        change: impl FnOnce(&mut Parcel),
    ) {
        let mut parcel = said(sender, COMMAND).content(script);
        (parcel.id, parcel.fence) = (id.parse().ok(), fence.parse().ok());
        change(&mut parcel);
        self.tell(&Event::Message(parcel));
    }

    fn released(&mut self, reason: &str, fence: &str) {
        self.tell(&Event::Released {
            owner: "somebody".to_owned(),
            reason: reason.to_owned(),
            by: None,
            fence: fence.parse().unwrap(),
            path: Path::parse("/camera/pan-token").unwrap(),
        });
    }

    /// What was said since, one line each; states while the mount turns are left out.
    fn heard(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        for parcel in std::mem::take(&mut self.out) {
            assert_eq!(parcel.context.as_ref().unwrap().as_str(), "/camera/pan");
            assert_eq!(parcel.echo, Some(false));
            let line = match parcel.name() {
                STATE => self.line_of_state(&parcel),
                _ => Some(line_of_status(&parcel)),
            };
            lines.extend(line);
        }
        lines
    }

    fn line_of_state(&mut self, parcel: &Parcel) -> Option<String> {
        assert_eq!(parcel.delivery, Some(Delivery::Latest));
        let id = parcel.id.unwrap();
        assert!(
            self.states.last().is_none_or(|last| *last < id),
            "ids of states rise"
        );
        self.states.push(id);
        let content = parcel.value();
        let word = |key: &str| content.get(key).and_then(Value::as_bool).unwrap();
        let angle = |key: &str| match content.get(key) {
            Some(Value::Double(angle)) => *angle,
            other => panic!("{key} is {other:?}"),
        };
        if word("moving") {
            return None;
        }
        // How it comes to know that it rests is told by the tests of devices.
        let mut known = content.as_map().cloned().unwrap();
        known.remove("seq");
        known.remove("stops-within");
        let before = self.known.replace(known.clone());
        if known.remove("rest").is_some() && before.as_ref() == Some(&known) {
            return None;
        }
        let to: Vec<&str> = parcel.address.iter().flatten().map(|peer| &**peer).collect();
        let to: String = to.iter().map(|to| format!(" to {to}")).collect();
        let stands = if word("stopped") { "stopped" } else { "free" };
        let mut line = format!("state{to} {:.0} {:.0} {stands}", angle("pan"), angle("tilt"));
        let fence = content.get("fence").and_then(Value::as_int);
        if fence != self.fence {
            assert!(fence > self.fence, "fences rise");
            self.fence = fence;
            line += &fence.map(|fence| format!(", fence {fence}")).unwrap_or_default();
        }
        Some(line)
    }
}

fn said(sender: &str, name: &str) -> Parcel {
    let mut parcel = Parcel::new(Family::Message, name);
    parcel.sender = Some(sender.into());
    parcel
}

fn line_of_status(parcel: &Parcel) -> String {
    let content = parcel.value();
    let text = |key: &str| content.get(key).and_then(Value::as_str).unwrap().to_owned();
    let number = |key: &str| content.get(key).and_then(Value::as_int);
    assert_eq!(parcel.reference.map(|id| id as i64), number("id"));
    assert_eq!(parcel.delivery, None);
    let id = number("id").map_or("-".to_owned(), |id| id.to_string());
    let (statement, of) = (number("statement").unwrap(), number("of").unwrap());
    let mut line = format!("status {}/{id} {} {statement}/{of}", text("peer"), text("state"));
    if let Some(error) = content.get("error") {
        assert!(!error.get("text").and_then(Value::as_str).unwrap().is_empty());
        let (name, code) = (error.get("name").unwrap(), error.get("code").unwrap());
        write!(line, " {} {}", name.as_str().unwrap(), code.as_int().unwrap()).unwrap();
    }
    line
}

/// Plays a dialogue: lines with `>` are what must have been said since the line before.
fn check(dialogue: &str) {
    let mut stage = Stage::new();
    let lines = dialogue.lines().map(str::trim);
    let mut lines = lines.filter(|line| !line.is_empty()).peekable();
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
        "alice command 7 5: look 30 -20; wait 100
         > status alice/7 waiting 0/2
         > status alice/7 executing 1/2
         alice command - 5: home
         > status alice/- waiting 0/1
         after 499
         after 1
         > status alice/7 executing 2/2
         > state 30 -20 free
         after 100
         > state 30 -20 free
         > status alice/7 finished 2/2
         > status alice/- executing 1/1
         after 500
         > state 0 -20 free
         > status alice/- finished 1/1",
    );
}

#[test]
fn what_it_cannot_do_is_refused_with_its_code() {
    check(
        "alice command 1 5: lok 1 2
         > status alice/1 error 0/0 syntax 5001
         alice command 2 5: look 200 0
         > status alice/2 error 0/0 joint-limit 5005
         alice command 3 5: look nan 0
         > status alice/3 error 0/0 syntax 5001
         alice command
         > status alice/- error 0/0 syntax 5001
         alice command 4 5: turn 1 0
         > status alice/4 error 0/0 no-state 5108",
    );
}

#[test]
fn an_error_tells_the_nearest_aim_beside_its_words() {
    let mut stage = Stage::new();
    stage.act("alice command 2 5: home; look 0 -90");
    let error = stage.out[0].value().get("error").cloned().unwrap();
    let text = "statement 2: tilt is -90°, but the mount turns from -60 to 30°; the nearest that it reaches is 0 -60";
    assert_eq!(error.get("text").and_then(Value::as_str), Some(text));
    assert_eq!(error.get("statement"), Some(&Value::Int(2)));
    let reachable = error.get("reachable").and_then(|aim| aim.get("tilt"));
    assert_eq!(reachable, Some(&Value::Double(-60.0)));
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
         > state 0 -20 free, fence 6
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
         > state 0 -20 free
         > status alice/1 finished 1/1
         > status bob/1 executing 1/1
         alice command 1 5: wait 100
         > status alice/1 waiting 0/1",
    );
}

/// Everything that ends two commands of fence 5, and whether the mount is stopped after it.
#[test]
fn commands_end_when_control_is_lost() {
    for (line, stopped) in [
        ("hub halt", false),
        ("released 5", false),
        ("given 5", false),
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
            "alice command 1 5: look 30 -20
             > status alice/1 waiting 0/1
             > status alice/1 executing 1/1
             alice command 2 5: home
             > status alice/2 waiting 0/1
             after 250
             {line}
             > status alice/1 error 1/1 {code}
             > status alice/2 error 0/1 {code}
             after 299
             after 100
             > state 15 -20 {word}{fence}
             bob command 3 7: wait 9
             > state 15 -20 {word}, fence 7
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
        "bob unstop\n> state 0 -20 free",
        "bob request",
        "bob settings",
    ] {
        check(&format!(
            "alice command 1 5: wait 100
             > status alice/1 waiting 0/1
             > status alice/1 executing 1/1
             {line}
             after 100
             > state 0 -20 free
             > status alice/1 finished 1/1"
        ));
    }
}

#[test]
fn a_newer_fence_ends_what_an_older_one_began() {
    check(
        "alice command 1 5: look 30 -20
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         after 100
         bob command 1 6: home
         > status alice/1 error 1/1 halted 5101
         > status bob/1 waiting 0/1
         released 5
         grabbed 6
         after 299
         after 1
         > state 6 -20 free, fence 6
         > status bob/1 executing 1/1
         after 100
         > state 0 -20 free
         > status bob/1 finished 1/1",
    );
}

/// The safe state that a token declares ends what was begun, and is then carried out itself.
#[test]
fn the_hub_s_own_command_needs_no_fence() {
    check(
        "gate alice 5
         alice command 1 5: look 30 -20
         > state 0 -20 free
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         after 100
         hub command - -: home
         > status alice/1 error 1/1 halted 5101
         > status hub/- waiting 0/1
         > status hub/- executing 1/1
         after 100
         > state 0 -20 free
         > status hub/- finished 1/1",
    );
}

#[test]
fn a_stop_latches_until_it_is_released() {
    check(
        "bob stop
         > state 0 -20 stopped
         carol stop
         > state 0 -20 stopped
         alice command 1 5: home
         > status alice/1 error 0/0 stopped 5102
         rejoined
         > state 0 -20 stopped
         carol unstop
         > state 0 -20 free
         alice command 2 5: wait 1
         > status alice/2 waiting 0/1
         > status alice/2 executing 1/1",
    );
}

#[test]
fn what_was_meant_for_an_earlier_state_is_refused() {
    check(
        "joined carol
         > state to carol 0 -20 free
         alice command 1 5 on newest: turn 6 0
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         alice command 2 5 on newest: turn 6 0
         > status alice/2 error 0/0 stale-state 208
         after 100
         > state 6 -20 free
         > status alice/1 finished 1/1
         alice command 3 5 on before: turn 6 0
         > status alice/3 error 0/0 stale-state 208
         alice command 4 5 on red: turn 6 0
         > status alice/4 error 0/0 bad-slot 220
         alice command 5 5 on newest: turn 6 0
         > status alice/5 waiting 0/1
         > status alice/5 executing 1/1
         after 100
         > state 12 -20 free
         > status alice/5 finished 1/1",
    );
}

#[test]
fn a_command_that_waited_too_long_is_not_begun() {
    check(
        "alice command 1 5: wait 200
         > status alice/1 waiting 0/1
         > status alice/1 executing 1/1
         alice command 2 5 expires 100: home
         > status alice/2 waiting 0/1
         after 200
         > state 0 -20 free
         > status alice/1 finished 1/1
         > state 0 -20 free
         > status alice/2 error 0/1 too-old 5107",
    );
}

#[test]
fn a_queue_that_is_full_says_so() {
    let mut stage = Stage::new();
    for id in 0..=64 {
        stage.act(&format!("alice command {id} 5: wait 1000"));
    }
    stage.heard();
    stage.act("alice command 65 5: home");
    let error = stage.out[0].value().get("error").cloned().unwrap();
    assert_eq!(error.get("retry"), Some(&Value::Bool(true)));
    assert_eq!(stage.heard(), ["status alice/65 error 0/0 queue-full 5103"]);
}

#[test]
fn it_is_freed_by_the_number_of_its_newest_stop_only() {
    let mut stage = Stage::new();
    for (line, state) in [
        ("bob stop 7", "stopped"),
        ("alice stop 8", "stopped"),
        ("bob unstop 7", "stopped"),
        ("alice unstop 8", "free"),
        // One that was lifted before it came holds nobody.
        ("bob stop 6", "free"),
        ("told 9 stopped", "stopped"),
        ("told 9", "free"),
    ] {
        stage.act(line);
        let heard = stage.heard();
        assert!(heard.iter().any(|line| line.contains(state)), "{line}: {heard:?}");
    }
}

#[test]
fn a_gap_is_a_stop_of_which_it_tells_the_hub() {
    let mut stage = Stage::new();
    stage.server.set_name("robot".to_owned());
    for line in ["lagged", "rejoined"] {
        stage.act(line);
        let stop = stage.out.iter().find(|parcel| parcel.name() == "stop");
        let address = stop.and_then(|stop| stop.address.clone());
        assert_eq!(address, Some(vec!["robot".into()]), "{line}");
        stage.out.clear();
    }
    // The hub gives it a number; from then on it is a stop like any other.
    stage.act("robot stop 3");
    stage.out.clear();
    stage.act("rejoined");
    assert!(stage.out.iter().all(|parcel| parcel.name() != "stop"));
    stage.act("bob unstop 3");
    let state = stage.out.last().expect("a state").value();
    assert_eq!(state.get("stopped"), Some(&Value::Bool(false)));
    assert_eq!(state.get("stop"), Some(&Value::Int(3)));
}

/// A configuration guards the channel from now on, by a token whose fences are lower; or only that it has an owner is heard.
#[test]
fn what_was_sent_without_a_fence_ends_where_a_guard_appears() {
    let guard = Map::new().with("token", "/camera/key").with("owner", "bob");
    let guard = guard.with("names", vec![COMMAND.into()]).with("fence", 3);
    let guard = Map::new().with("guard", guard);
    for (guard, line) in [(guard, "bob command 2 3: look 10 0"), (Map::new(), "grabbed 6")] {
        let mut stage = Stage::new();
        stage.act("alice command 1 -: look 100 0; look 0 0");
        stage.pass(300);
        assert!(stage.heard().contains(&"status alice/1 executing 1/2".to_owned()));
        stage.gate.joined(&guard);
        // Fences of two tokens say nothing of each other.
        stage.fence = None;
        stage.act(line);
        let ended = stage.heard();
        assert!(
            ended.contains(&"status alice/1 error 1/2 halted 5101".to_owned()),
            "{ended:?}"
        );
        stage.pass(3_000);
        let obeyed = stage.heard().contains(&"status bob/2 finished 1/1".to_owned());
        assert_eq!(obeyed, line != "grabbed 6");
    }
}
