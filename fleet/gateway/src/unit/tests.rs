//! A unit with its robot, and a link between them that takes its time.

use mom_brs::file::EXTENDED;
use mom_brs::{Direction, Parser};
use mom_client::Parcel;
use mom_device::{Command as Queued, CommandQueue, DeviceServer, Order, QueueEvent};
use mom_device_cases::{Stage, Statements, replay};
use mom_linuxbot::{Robot, Rules};
use mom_wheels::{Chassis, Simulated};
use proptest::prelude::*;

use super::*;

mod wire;

const MS: DeviceTime = 1000;

/// A unit and its robot, with a link between them that takes its time.
struct Pair {
    queue: CommandQueue<Unit>,
    robot: Robot,
    now: DeviceTime,
    /// What is under way, with the time at which it arrives.
    down: VecDeque<(DeviceTime, Frame)>,
    up: VecDeque<(DeviceTime, Frame)>,
    delay: DeviceTime,
    events: Vec<QueueEvent>,
}

impl Pair {
    fn new(delay: DeviceTime) -> Self {
        Self::with(Simulated::linuxbot(), delay)
    }

    fn with(driver: Simulated, delay: DeviceTime) -> Self {
        let robot = Robot::new(Box::new(driver), Chassis::LINUXBOT, Rules::default());
        let mut pair = Self {
            queue: CommandQueue::new(Unit::new(7, &EXTENDED)),
            robot,
            now: 0,
            down: VecDeque::new(),
            up: VecDeque::new(),
            delay,
            events: Vec::new(),
        };
        pair.note(Unit::linked);
        pair
    }

    fn note(&mut self, what: impl FnOnce(&mut Unit)) {
        self.queue.note(self.now, what, &mut self.events);
        self.pump();
    }

    /// Puts what the unit says on its way.
    fn pump(&mut self) {
        while self.queue.machine().has_to_send() {
            let frames = self.said();
            let at = self.now + self.delay;
            self.down.extend(frames.into_iter().map(|frame| (at, frame)));
            self.queue.note(self.now, Unit::sent, &mut self.events);
        }
    }

    fn said(&mut self) -> Vec<Frame> {
        let mut frames = Vec::new();
        self.queue
            .note(self.now, |unit| frames = unit.to_send(), &mut self.events);
        frames
    }

    fn command(&mut self, script: &str) -> Result<(), DeviceError> {
        let taken = self.submit(script);
        self.pump();
        taken
    }

    /// Takes a command, and sends nothing.
    fn submit(&mut self, script: &str) -> Result<(), DeviceError> {
        let command = Queued {
            order: Order {
                peer: "alice".into(),
                id: None,
                fence: None,
            },
            script: Script::read::<Unit>(script)?,
            use_by: None,
        };
        self.queue.submit(command, self.now, &mut self.events)
    }

    /// Lets time pass until then, event by event.
    fn pass(&mut self, until: DeviceTime) {
        loop {
            let due = [
                self.queue.next_wake(),
                self.robot.next_wake(),
                self.down.front().map(|(at, _)| *at),
                self.up.front().map(|(at, _)| *at),
            ];
            let due = due.into_iter().flatten().min().filter(|due| *due <= until);
            let Some(due) = due else { break };
            self.now = due.max(self.now);
            self.robot.advance(self.now);
            while let Some((_, frame)) = self.down.pop_front_if(|(at, _)| *at <= due) {
                if let Some(reply) = self.robot.take(&frame, self.now) {
                    self.up.push_back((self.now + self.delay, reply));
                }
            }
            while let Some((_, reply)) = self.up.pop_front_if(|(at, _)| *at <= due) {
                let mut failed = Ok(());
                self.queue
                    .note(self.now, |unit| failed = unit.heard(&reply), &mut self.events);
                if let Err(error) = failed {
                    self.queue.fail(self.now, &error, &mut self.events);
                }
            }
            self.queue.advance(self.now, &mut self.events);
            self.pump();
        }
        self.now = until;
    }

    fn moves(&mut self) -> bool {
        let status = self.robot.status(self.now).expect("it can be read");
        status.moving || status.on_its_way
    }

    /// How commands ended, since this was asked last.
    fn ended(&mut self) -> Vec<&'static str> {
        let events = std::mem::take(&mut self.events);
        let ends = events.iter().filter_map(|event| match event {
            QueueEvent::Finished(_) => Some("finished"),
            QueueEvent::Failed(_, error) => Some(match error.name() {
                ErrorName::Halted => "halted",
                ErrorName::Stopped => "stopped",
                ErrorName::Obstacle => "obstacle",
                ErrorName::Battery => "battery",
                ErrorName::Link => "link",
                _ => "otherwise",
            }),
            _ => None,
        });
        ends.collect()
    }
}

const STATEMENTS: Statements = Statements {
    go: "goto 1500 500",
    back: "goto 500 500",
    wrong: "gogo 1 2",
    beyond: Some(("follow ada 500", "syntax 5001")),
    relative: None,
    velocity: None,
};

/// The device that the dialogues of every device are replayed by: a unit with its robot, and nothing between them.
fn stage() -> Stage<Unit> {
    let mut robot = Robot::new(
        Box::new(Simulated::linuxbot()),
        Chassis::LINUXBOT,
        Rules::default(),
    );
    let mechanism = move |server: &mut DeviceServer<Unit>, now: DeviceTime, out: &mut Vec<Parcel>| {
        robot.advance(now);
        while server.machine().has_to_send() {
            let mut frames = Vec::new();
            server.note(now, |unit| frames = unit.to_send(), out);
            server.note(now, Unit::sent, out);
            for reply in frames.iter().filter_map(|frame| robot.take(frame, now)) {
                let mut heard = Ok(());
                server.note(now, |unit| heard = unit.heard(&reply), out);
                if let Err(error) = heard {
                    server.fail(now, &error, out);
                }
            }
        }
    };
    let mut stage = Stage::bare(Unit::new(7, &EXTENDED)).driven_by(mechanism);
    stage.note(Unit::linked);
    stage
}

/// Some are played for each of several events; none may be left out in silence.
#[test]
fn a_robot_of_a_fleet_does_what_every_device_does() {
    assert_eq!(replay(stage, &STATEMENTS), 43);
}

#[test]
fn a_command_on_the_wire_is_that_of_the_paper() {
    let mut pair = Pair::new(0);
    pair.pass(0);
    pair.command("motor 50 -50 100; leds 5").expect("it is taken");
    let said: Vec<String> = pair.down.iter().map(|(_, frame)| frame.to_string()).collect();
    assert_eq!(said[0], "06 00050 -0050");
    pair.pass(200 * MS);
    assert_eq!(pair.ended(), ["finished"]);
    assert!(!pair.moves(), "motors stop when their time is over");
    let mut parser = Parser::new(&EXTENDED, Direction::Command);
    assert_eq!(parser.feed(said.concat().as_bytes()).count(), said.len());
}

/// Each question feeds the robot's watchdog, so motors may run for longer than its 500 ms.
#[test]
fn motors_run_as_long_as_the_statement_says() {
    let mut pair = Pair::new(20 * MS);
    pair.command("motor 100 100 3000").expect("it is taken");
    for after in [100, 1000, 2900] {
        pair.pass(after * MS);
        assert!(pair.moves(), "after {after} ms");
    }
    pair.pass(3050 * MS);
    assert!(!pair.moves());
    assert_eq!(pair.ended(), ["finished"]);
}

#[test]
fn a_way_is_done_when_the_robot_says_so() {
    let mut pair = Pair::new(30 * MS);
    pair.command("via 3000 2500 3000 3000; leds 1")
        .expect("it is taken");
    pair.pass(1000 * MS);
    assert_eq!(pair.ended(), [""; 0], "it is under way");
    pair.pass(20_000 * MS);
    assert_eq!(pair.ended(), ["finished"]);
    let position = pair.queue.state().position;
    for key in ["x", "y"] {
        let is = position
            .get(key)
            .and_then(mom_client::Value::as_int)
            .expect("a place");
        assert!((is - 3000).abs() < 15, "{key} is {is}");
    }
    pair.command("goto 9000 3000; leds 2").expect("it is taken");
    pair.pass(60_000 * MS);
    assert_eq!(pair.ended(), ["obstacle"], "there is a wall");
    assert_eq!(pair.queue.machine().leds, 1, "and nothing came after it");
}

/// However many a script sets: each waits until the one before it is sent.
#[test]
fn leds_are_set_when_that_is_sent_and_not_before() {
    let script: Vec<String> = (1..=70).map(|leds| format!("leds {leds}")).collect();
    let script = script.join("; ");
    let mut pair = Pair::new(0);
    pair.command(&script).expect("it is taken");
    pair.pass(0);
    assert_eq!(pair.ended(), ["finished"]);
    assert_eq!(pair.queue.machine().leds, 70);
    pair.submit(&script).expect("it is taken");
    for leds in 1..=3 {
        let mut frames = pair.said();
        frames.retain(|frame| frame.code() == Code::LEDS);
        assert_eq!(frames.len(), 1);
        assert_eq!(frames[0].values(), [leds]);
        if leds < 3 {
            pair.queue.note(pair.now, Unit::sent, &mut pair.events);
        }
    }
    assert_eq!(pair.ended(), [""; 0]);
    // The third has no place.
    let error = DeviceError::new(ErrorName::Link, "it was not told to do it");
    pair.queue.fail(pair.now, &error, &mut pair.events);
    pair.queue.note(pair.now, Unit::sent, &mut pair.events);
    assert_eq!(pair.ended(), ["link"]);
    assert_eq!(pair.queue.machine().leds, 2);
}

#[test]
fn an_empty_battery_ends_what_it_does() {
    for script in ["motor 1000 -1000 60000", "via 500 500 3500 2500 500 500"] {
        let mut pair = Pair::with(Simulated::linuxbot().with_battery(1), 20 * MS);
        pair.pass(1000 * MS);
        let begun = pair.now;
        loop {
            pair.command(script).expect("it is taken");
            pair.pass(pair.now + 60_000 * MS);
            assert!(pair.now < begun + 3_600_000 * MS, "it lasts too long");
            let ended = pair.ended();
            if ended != ["finished"] {
                assert_eq!(ended, ["battery"], "{script}");
                break;
            }
        }
        assert!(!pair.moves());
        // One that cannot tell of a battery has none that is empty.
        let mut pair = Pair::with(Simulated::linuxbot().with_battery(0), 20 * MS);
        pair.command("motor 100 100 500").expect("it is taken");
        pair.pass(1000 * MS);
        assert_eq!(pair.ended(), ["finished"]);
    }
}

#[test]
fn one_that_moves_and_does_not_answer_is_given_up_after_a_second() {
    let mut pair = Pair::new(20 * MS);
    pair.command("motor 100 100 30000").expect("it is taken");
    pair.pass(2000 * MS);
    assert!(!pair.queue.machine().is_overdue());
    pair.delay = 60_000 * MS;
    pair.pass(2900 * MS);
    assert!(!pair.queue.machine().is_overdue(), "not yet");
    pair.pass(3200 * MS);
    assert!(pair.queue.machine().is_overdue());
    pair.note(Unit::given_up);
    assert!(!pair.queue.machine().is_overdue(), "it is done once");
    // One that rests is not hurried.
    let mut pair = Pair::new(1500 * MS);
    pair.pass(20_000 * MS);
    assert!(!pair.queue.machine().is_overdue());
}

#[test]
fn what_is_told_is_as_old_as_its_replies() {
    let mut pair = Pair::new(30 * MS);
    assert_eq!(pair.queue.machine().known_at(), None);
    pair.pass(50 * MS);
    assert_eq!(
        pair.queue.machine().known_at(),
        None,
        "the first reply takes 60 ms"
    );
    pair.pass(60 * MS);
    assert_eq!(pair.queue.machine().known_at(), Some(0));
    assert_eq!(pair.queue.machine().round_trip, Some(60 * MS));
}

/// Whatever becomes of the order to stand: what says that it moves all the same is told again.
#[test]
fn a_robot_that_did_not_hear_that_it_is_to_stand_is_told_again() {
    let mut pair = Pair::new(10 * MS);
    pair.command("motor 100 100 60000").expect("it is taken");
    pair.pass(1000 * MS);
    assert!(pair.moves());
    let under_way = pair.down.len();
    pair.queue.halt(pair.now, "a test", &mut pair.events);
    pair.pump();
    // The order is lost, and what was asked with it is not.
    let order = pair.down.remove(under_way).expect("there is one");
    assert_eq!(order.1.to_string(), "06 00000 00000");
    pair.pass(1015 * MS);
    assert!(pair.moves(), "it has not heard it");
    pair.pass(1040 * MS);
    assert!(!pair.moves());
    let asked = pair.queue.machine().question;
    pair.pass(5000 * MS);
    assert!(
        pair.queue.machine().question < asked + 12,
        "it is asked seldom again"
    );
}

#[test]
fn a_lost_robot_takes_no_command_and_stands_when_it_is_back() {
    let mut pair = Pair::new(0);
    pair.command("motor 100 100 60000").expect("it is taken");
    pair.pass(100 * MS);
    assert!(pair.moves());
    pair.note(|unit| unit.lost("it is gone"));
    let error = DeviceError::new(ErrorName::Link, "it is gone");
    pair.queue.fail(pair.now, &error, &mut pair.events);
    assert_eq!(pair.ended(), ["link"]);
    assert_eq!(
        pair.command("leds 1").map_err(|error| error.name()),
        Err(ErrorName::Link)
    );
    // Its own watchdog stops it.
    pair.pass(700 * MS);
    assert!(!pair.moves());
    pair.note(Unit::linked);
    pair.pass(800 * MS);
    assert_eq!(pair.command("leds 1"), Ok(()));
}

proptest! {
    /// Whenever it is halted, it stands one way of the link later, whatever was under way, and every command ends once.
    #[test]
    fn a_halt_reaches_it_before_anything_else(
        deeds in proptest::collection::vec((0..6, -1000..1000, -1000..1000, 1..2000_i32, 0..2_000 * MS), 1..25),
        delay in 0..150 * MS,
    ) {
        let mut pair = Pair::new(delay);
        let (mut taken, mut ended) = (0, 0);
        for (deed, x, y, ms, later) in deeds {
            let script = match deed {
                0 | 1 => format!("motor {x} {y} {ms}"),
                2 => format!("goto {} {}", 2500 + x, 2500 + y),
                3 => format!("via {} 2500 2500 {}; motor {y} {x} 50", 2500 + x, 2500 + y),
                4 => "leds 3; wait 100".to_owned(),
                _ => {
                    pair.queue.halt(pair.now, "a test", &mut pair.events);
                    pair.pump();
                    let until = pair.now + delay;
                    pair.pass(until);
                    prop_assert!(!pair.moves());
                    String::new()
                }
            };
            if !script.is_empty() {
                taken += usize::from(pair.command(&script).is_ok());
            }
            let until = pair.now + later;
            pair.pass(until);
            ended += pair.ended().len();
        }
        let until = pair.now + 400_000 * MS;
        pair.pass(until);
        ended += pair.ended().len();
        prop_assert_eq!((taken, pair.moves()), (ended, false));
    }
}

#[test]
fn a_robot_that_cannot_be_reached_is_not_said_to_stand() {
    let mut pair = Pair::new(10 * MS);
    let unit = Unit::new(7, &EXTENDED).with_epoch(1_000_000);
    pair.queue = CommandQueue::new(unit);
    let said = |pair: &Pair| {
        let state = pair.queue.state();
        let reached = state.report.get("reached").and_then(mom_client::Value::as_bool);
        let since = state
            .report
            .get("unreached-since")
            .and_then(mom_client::Value::as_int);
        (state.moving, reached, since)
    };
    assert_eq!(
        said(&pair),
        (true, Some(false), Some(1_000_000)),
        "nothing was ever heard of it"
    );
    pair.down.clear();
    pair.note(Unit::linked);
    assert_eq!(said(&pair), (true, Some(true), None), "it has not answered yet");
    pair.pass(2000 * MS);
    assert_eq!(said(&pair), (false, Some(true), None));
    pair.note(|unit| unit.lost("it is gone"));
    pair.pass(9000 * MS);
    assert_eq!(said(&pair), (true, Some(false), Some(3_000_000)));
    // Nor is it after a halt, which is not said to anybody.
    pair.queue.halt(pair.now, "a test", &mut pair.events);
    assert!(said(&pair).0 && !pair.queue.machine().has_to_send());
    pair.note(Unit::linked);
    // Measured anew.
    pair.pass(9900 * MS);
    assert_eq!(said(&pair), (false, Some(true), None));
}

#[test]
fn a_halt_at_rest_reaches_the_robot_too_and_is_said_again_until_it_answers() {
    let stops = |frames: &[Frame]| {
        let stop = |frame: &&Frame| frame.to_string() == "06 00000 00000";
        frames.iter().filter(stop).count()
    };
    let mut pair = Pair::new(0);
    pair.pass(2000 * MS);
    assert!(!pair.queue.state().moving);
    pair.queue.halt(pair.now, "a test", &mut pair.events);
    let frames = pair.said();
    assert_eq!(stops(&frames), 1);
    assert!(
        !pair.queue.state().moving,
        "it has said that it stands, and nobody has moved it since"
    );
    // None of it arrives, and it has other things to do than to answer.
    let mut again = 0;
    for late in 1..=5 {
        pair.queue.advance((2000 + late * 100) * MS, &mut pair.events);
        pair.now = (2000 + late * 100) * MS;
        again += stops(&pair.said());
    }
    assert_eq!(again, 5);
    assert!(
        !pair.queue.machine().is_overdue(),
        "it is not known to move, so its link has its time"
    );
    // One that was driven stands when it has answered.
    pair.command("motor 100 100 300").expect("it is taken");
    pair.down.clear();
    pair.queue.halt(pair.now, "a test", &mut pair.events);
    assert!(pair.queue.state().moving && stops(&pair.said()) == 1);
    // What drives it again is not undone by that.
    pair.command("motor 100 100 300").expect("it is taken");
    let frames: Vec<Frame> = pair.down.iter().map(|(_, frame)| *frame).collect();
    assert_eq!(stops(&frames), 0, "{frames:?}");
}

/// Its gateway is stopped for seconds; then all that was due is due at once.
#[test]
fn a_statement_that_should_have_begun_long_ago_is_not_begun() {
    let mut pair = Pair::new(0);
    pair.note(Unit::linked);
    pair.pass(100 * MS);
    pair.command("motor 300 300 500; leds 7; motor 300 300 500")
        .expect("it is taken");
    pair.pass(300 * MS);
    pair.now = 5000 * MS;
    pair.queue.advance(pair.now, &mut pair.events);
    let frames = pair.said();
    let drives = |frame: &&Frame| !matches!(frame.code(), Code::STATUS | Code::POSE);
    let drives: Vec<String> = frames
        .iter()
        .filter(drives)
        .map(|frame| frame.to_string())
        .collect();
    assert!(drives.iter().all(|frame| frame == "06 00000 00000"), "{drives:?}");
    assert_eq!(pair.ended(), ["halted"]);
    assert!(pair.queue.machine().leds == 0 && pair.queue.machine().insists);
}

/// Two causes of a halt within a moment have it asked twice: a pose is as old as its own question, not as that of the status beside it.
#[test]
fn one_that_turns_is_not_said_to_rest_however_often_it_is_halted() {
    for (delay, between) in [(0, 50), (2, 20), (2, 50), (2, 130), (2, 250), (30, 60), (60, 110)] {
        let mut pair = Pair::new(delay * MS);
        pair.pass(1_500 * MS);
        pair.command("motor 1000 -1000 3000").expect("it can");
        pair.pass(2_300 * MS);
        pair.queue
            .stop(pair.now, "a test", ErrorName::Stopped, &mut pair.events);
        pair.pump();
        pair.pass(pair.now + between * MS);
        pair.queue
            .stop(pair.now, "a test", ErrorName::Stopped, &mut pair.events);
        pair.pump();
        let (stopped, mut headings) = (pair.now, VecDeque::new());
        while pair.queue.state().rest.is_none() {
            let now = pair.now + MS;
            pair.pass(now);
            let pose = pair.robot.glance(now).and_then(|glance| glance.pose);
            headings.push_back((now, pose.expect("it knows").heading));
            assert!(
                now < stopped + 5_000 * MS,
                "{delay} {between}: it rests in the end"
            );
        }
        let (last, heading) = headings.back().copied().expect("some");
        let before = headings
            .iter()
            .find(|(at, _)| *at >= last - 300 * MS)
            .expect("0.3 s ago")
            .1;
        assert!(
            (heading - before).abs() < 2.0,
            "{delay} {between}: it turned by {} degrees in the last 0.3 s",
            heading - before
        );
    }
}
