//! Stops of a mirrored robot, by what its body does: middle and robot in virtual time, and between them a network that loses, doubles,
//! delays and reorders.
use std::sync::LazyLock;

use mom_client::{Map, Value};
use mom_cubo::model::LAYOUT;
use mom_cubo::model::elements::Camera;
use mom_cubo::model::robot::{Body as _, Dispatch, PACKET};
use mom_cubo::{Cubo, End, Glance};
use mom_device::{
    AtRest, Attachments, Command, CommandQueue, DeviceTime, ErrorName, Machine, Order, QueueEvent, Script,
};
use mom_rsp::middle::{Middle, Notice, Settings};
use mom_rsp::robot;
use mom_rsp::typed::Named as _;
use mom_rsp_model::Model;
use mom_simulacrum::{Mirror, Simulacrum};
use mom_wheels::{Chassis, Pose};
use proptest::prelude::*;

/// ms within which it stands.
const STOPPING: u64 = Mirror::STOPPING_TIME as u64 / 1000;

/// What the network does to each datagram: percent that are lost and doubled, the least delay and how much it varies, ms.
#[derive(Debug, Clone, Copy, Default)]
struct Weather {
    loss: u64,
    twice: u64,
    delay: u64,
    jitter: u64,
}

/// A mirrored robot with its queue, as its peer drives it.
struct Rig {
    mirror: Simulacrum,
    queue: CommandQueue<Mirror>,
    body: Cubo,
    end: End,
    weather: Weather,
    random: u64,
    /// Arrival, datagram: to the robot, and to the middle.
    ways: [Vec<(u64, Vec<u8>)>; 2],
    events: Vec<QueueEvent>,
    /// How often the machine failed by itself.
    failures: usize,
    /// The robot tells nothing new of itself.
    is_numb: bool,
    /// The peer hears no notices.
    is_deaf: bool,
    /// µs.
    now: u64,
}

impl Rig {
    fn new() -> Rig {
        let mut rig = Rig::with(Settings::default(), robot::Settings::default(), 1);
        while !rig.mirror.is_up() {
            rig.step();
        }
        rig.run(50);
        rig
    }

    fn with(settings: Settings, theirs: robot::Settings, seed: u64) -> Rig {
        let model = Model::read(mom_cubo::MODEL).expect("a model");
        let mirror = Simulacrum::new("cubo", model, settings).expect("settings");
        let machine = Mirror::new(mirror.clone(), Chassis::CUBO, None);
        mirror.with(|middle| middle.start(0));
        let mut body = Cubo::new(Pose::new(2500.0, 2500.0, 0.0)).expect("a place");
        // Its pictures are nobody's here.
        body.active(Camera::PLACE, false);
        Rig {
            mirror,
            queue: CommandQueue::new(machine),
            body,
            end: End::new(&LAYOUT, theirs).expect("settings"),
            weather: Weather::default(),
            random: seed | 1,
            ways: [Vec::new(), Vec::new()],
            events: Vec::new(),
            failures: 0,
            is_numb: false,
            is_deaf: false,
            now: 0,
        }
    }

    fn below(&mut self, end: u64) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random % end.max(1)
    }

    fn send(&mut self, way: usize, datagram: &[u8]) {
        let weather = self.weather;
        if self.below(100) < weather.loss {
            return;
        }
        let copies = if self.below(100) < weather.twice { 2 } else { 1 };
        for _ in 0..copies {
            let delay = weather.delay + self.below(weather.jitter + 1);
            self.ways[way].push((self.now + 1000 * delay, datagram.to_vec()));
        }
    }

    fn arrived(&mut self, way: usize) -> Vec<Vec<u8>> {
        let now = self.now;
        let mut due: Vec<_> = self.ways[way].extract_if(.., |(at, _)| *at <= now).collect();
        due.sort_by_key(|(at, _)| *at);
        due.into_iter().map(|(_, datagram)| datagram).collect()
    }

    fn time(&self) -> DeviceTime {
        DeviceTime::try_from(self.now).expect("not so late")
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.step();
        }
    }

    /// A ms passes for all.
    fn step(&mut self) {
        self.now += 1000;
        self.robot();
        self.middle();
    }

    /// A ms of the robot.
    fn robot(&mut self) {
        self.body.advance(self.time());
        for mut datagram in self.arrived(0) {
            let _ = self
                .end
                .receive(self.now, &mut datagram, &mut Dispatch(&mut self.body));
            let until = self
                .end
                .deadline()
                .map_or(DeviceTime::MAX, |until| until as DeviceTime);
            self.body.hold(until);
        }
        if !self.is_numb {
            self.body.tell(&mut self.end);
        }
        let mut out = vec![0; PACKET];
        while let Some(length) = self.end.poll(self.now, &mut out, &mut Dispatch(&mut self.body)) {
            self.send(1, &out[..length]);
        }
    }

    /// A ms of the middle, as its peer has it pass.
    fn middle(&mut self) {
        let (mirror, time) = (self.mirror.clone(), self.time());
        for mut datagram in self.arrived(1) {
            let _ = mirror.with(|middle| middle.receive(self.now, &mut datagram));
        }
        while let Some(datagram) = mirror.with(|middle| middle.poll(self.now).map(<[u8]>::to_vec)) {
            self.send(0, &datagram);
        }
        if self.is_deaf {
            return;
        }
        self.queue.advance(time, &mut self.events);
        while let Some(notice) = mirror.with(Middle::next_notice) {
            let mut heard = Ok(());
            self.queue
                .note(time, |machine| heard = machine.heard(&notice), &mut self.events);
            if let Err(error) = heard {
                self.queue.fail(time, &error, &mut self.events);
            }
            if notice == Notice::Ended {
                mirror.with(|middle| middle.start(self.now));
            }
        }
        let mut failed = None;
        self.queue
            .note(time, |machine| failed = machine.take_failure(), &mut self.events);
        if let Some(error) = failed {
            self.failures += 1;
            self.queue.fail(time, &error, &mut self.events);
        }
    }

    /// Has it carry out a script, with a sound of 3 s that is called `song`.
    fn submit(&mut self, script: &str) {
        static SONG: LazyLock<Map> = LazyLock::new(|| {
            let song = mom_sound::Clip::tone(440.0, 3.0, 48_900)
                .to_wav()
                .expect("a file");
            Map::new().with("song", Value::Binary(song.into()))
        });
        let attachments = match script.contains("song") {
            true => Attachments::of(&SONG).expect("bytes"),
            false => Attachments::default(),
        };
        let command = Command {
            order: Order {
                peer: "alice".into(),
                id: None,
                fence: None,
            },
            script: Script::read_with::<Mirror>(script, &attachments).expect("a script"),
            use_by: None,
        };
        let time = self.time();
        // A stopped one takes none.
        let _ = self.queue.submit(command, time, &mut self.events);
    }

    fn stop(&mut self) {
        let time = self.time();
        self.queue
            .stop(time, "a test", ErrorName::Stopped, &mut self.events);
    }

    fn halt(&mut self) {
        let time = self.time();
        self.queue.halt(time, "a test", &mut self.events);
    }

    /// ms until this is so.
    fn until(&mut self, what: impl Fn(&mut Rig) -> bool) -> u64 {
        for ms in 0..20_000 {
            if what(self) {
                return ms;
            }
            self.step();
        }
        panic!("it is not so: {:?} {:?}", self.body.glance(), self.events.last());
    }

    fn acts(&mut self) -> bool {
        let Glance {
            turns,
            gesture,
            sounds,
            ..
        } = self.body.glance();
        turns || gesture.is_some() || sounds
    }

    /// Degrees of the arm that is farthest from hanging down.
    fn swing(&mut self) -> f64 {
        let posture = self.body.glance().posture;
        posture.left_arm.0.abs().max(posture.right_arm.0.abs())
    }

    fn is_finished(&self) -> bool {
        self.events
            .iter()
            .any(|event| matches!(event, QueueEvent::Finished(_)))
    }

    fn failed(&self) -> Option<(ErrorName, String)> {
        self.events.iter().rev().find_map(|event| match event {
            QueueEvent::Failed(_, error) => Some((error.name(), error.to_string())),
            _ => None,
        })
    }
}

/// At full swing and at full speed, with a sound: a stop ends all of it, and nothing moves beyond the stopping time.
#[test]
fn a_stop_ends_gesture_sound_and_wheels() {
    for script in [
        "do gesture 2",
        "play speaker song on; do gesture 2",
        "set joints 80 80 30; wait 5000",
        "motor 1000 1000 5000",
        "set left-wheel 500 right-wheel 500 lips 80 for 5000",
        "play speaker song",
    ] {
        let mut rig = Rig::new();
        rig.submit(script);
        rig.run(500);
        assert!(rig.acts() || rig.swing() > 30.0, "{script}");
        rig.stop();
        let ended = rig.until(|rig| !rig.acts());
        assert!(ended <= 40, "{script}: {ended} ms");
        rig.run(STOPPING - ended);
        let before = rig.body.glance();
        assert!(rig.swing() < 1.0 && before.lips.0 == 0.0, "{script}: {before:?}");
        rig.run(3000);
        let after = rig.body.glance();
        let way = (after.pose.x - before.pose.x).hypot(after.pose.y - before.pose.y);
        assert!(
            way < 1.0 && !rig.acts() && rig.swing() < 1.0,
            "{script}: {after:?}"
        );
        assert!(!rig.queue.state().moving && rig.queue.state().rest.is_some());
    }
}

/// A call that is on a slow way when the stop is confirmed does not begin, nor does one that waits behind it.
#[test]
fn a_call_under_way_does_not_begin_after_a_stop() {
    let mut rig = Rig::new();
    rig.weather.delay = 300;
    rig.submit("do gesture 2; do gesture 3");
    rig.run(60);
    assert!(rig.queue.state().moving, "nobody knows whether it has begun");
    rig.weather.delay = 0;
    rig.stop();
    assert!(rig.queue.state().moving);
    rig.until(|rig| !rig.queue.state().moving);
    rig.run(5000);
    assert_eq!(rig.body.doings.gestures, [0_u8; 0]);
    let time = rig.time();
    rig.queue.unstop(time, &mut rig.events);
    rig.submit("do gesture 4");
    rig.run(100);
    assert_eq!(rig.body.doings.gestures, [4]);
}

/// A halt that the network loses is said again until the robot has confirmed it; what is commanded meanwhile waits for that.
#[test]
fn a_halt_is_said_until_the_robot_confirms_it() {
    let mut rig = Rig::new();
    rig.submit("do gesture 2");
    rig.run(200);
    rig.weather.loss = 100;
    rig.halt();
    rig.submit("do gesture 5");
    rig.run(300);
    assert!(rig.queue.state().moving && rig.body.glance().gesture == Some(2));
    rig.weather.loss = 0;
    rig.until(|rig| rig.body.glance().gesture.is_none());
    rig.until(|rig| rig.body.glance().gesture == Some(5));
    rig.until(|rig| rig.is_finished());
    assert_eq!(rig.body.doings.gestures, [2, 5]);
}

/// A session that is lost and begins anew before anybody has looked leaves nothing switched off.
#[test]
fn a_session_that_began_before_the_loss_was_heard_of_is_as_any() {
    let mut rig = Rig::new();
    rig.submit("motor 400 400 60000");
    rig.run(300);
    // The program looks at its notices late.
    rig.is_deaf = true;
    rig.end = End::new(&LAYOUT, robot::Settings::default()).expect("settings");
    rig.run(3000);
    assert!(rig.mirror.is_up());
    rig.is_deaf = false;
    rig.run(1500);
    rig.submit("motor 400 400 500; do gesture 2");
    rig.until(|rig| rig.body.glance().gesture == Some(2));
}

/// The robot may do what nobody knows of: a halt of one that is held to be at rest reaches it, too.
#[test]
fn a_halt_at_rest_reaches_the_robot() {
    let mut rig = Rig::new();
    rig.run(1500);
    assert!(rig.queue.is_at_rest() && rig.queue.state().rest.is_some());
    for stops in [false, true, true] {
        rig.body.run_gesture(2);
        match stops {
            true => rig.stop(),
            false => rig.halt(),
        }
        let ended = rig.until(|rig| rig.body.glance().gesture.is_none());
        assert!(ended <= 40, "{ended} ms");
        rig.run(1500);
    }
}

/// `finished` is said when the motion has ended: of a gesture after its time by the model, of effectors when they are measured there.
#[test]
fn what_is_finished_has_ended() {
    for (script, gestures) in [("do gesture 2", 1), ("set joints 80 -80 30", 0)] {
        let mut rig = Rig::new();
        rig.submit(script);
        rig.until(|rig| rig.swing() > 30.0 || rig.body.glance().gesture.is_some());
        assert!(!rig.is_finished() && rig.queue.state().moving, "{script}");
        rig.until(|rig| rig.is_finished());
        let before = rig.body.glance();
        assert!(before.gesture.is_none() && rig.body.doings.gestures.len() == gestures);
        rig.run(2000);
        let (before, after) = (before.posture.left_arm.0, rig.body.glance().posture.left_arm.0);
        assert!((before - after).abs() < 2.0, "{script}: {before} {after}");
    }
}

/// What is switched on is on for the statement that follows.
#[test]
fn what_is_switched_is_so_when_its_statement_ends() {
    let mut rig = Rig::new();
    rig.submit("deactivate motion; wait 300; activate motion; set joints 80 -80 30");
    rig.until(|rig| rig.swing() > 30.0 || rig.failed().is_some());
    assert_eq!(rig.failed(), None);
}

/// What does not come to where it was set to is said to be hindered.
#[test]
fn what_does_not_arrive_is_hindered() {
    let mut rig = Rig::new();
    rig.is_numb = true;
    rig.submit("set joints 80 80 0");
    rig.until(|rig| rig.failed().is_some());
    let (name, text) = rig.failed().expect("it failed");
    assert!(
        name == ErrorName::Obstacle && text.contains("`posture` says"),
        "{text}"
    );
    rig.until(|rig| rig.swing() < 1.0);
}

/// Rest is measured of all that may have moved, and not measured where some of it is not.
#[test]
fn rest_speaks_of_all_that_can_move() {
    for (script, rest, ms) in [
        ("motor 200 200 400", AtRest::Measured, 2000),
        ("set joints 80 80 0", AtRest::Measured, 2000),
        ("set lips 50", AtRest::NotMeasured, 2000),
        // Nobody says what it moves.
        ("do gesture 2", AtRest::NotMeasured, 2000),
    ] {
        let mut rig = Rig::new();
        rig.run(2000);
        rig.submit(script);
        rig.run(400);
        rig.stop();
        let mut at = None;
        for passed in 0..ms {
            rig.step();
            let state = rig.queue.state();
            if state.rest.is_some() {
                assert!(
                    !rig.acts() && rig.swing() < 2.0,
                    "{script}: {:?}",
                    rig.body.glance()
                );
                at = at.or(Some((passed, state.rest)));
            }
        }
        let (passed, known) = at.expect("it rests");
        assert_eq!(known, Some(rest), "{script}");
        assert_eq!(
            rest == AtRest::NotMeasured,
            passed >= STOPPING - 50,
            "{script}: {passed}"
        );
    }
}

/// A program that stood still: the robot has stood since its watchdog's time, and no later statement begins.
#[test]
fn of_a_program_that_stood_still_no_later_statement_begins() {
    for script in [
        "motor 500 500 1000; motor 500 500 1000; do gesture 2",
        "set left-wheel 250 right-wheel 250 for 1000; set joints 80 80 0",
        "do gesture 3; do gesture 2",
        "wait 1000; do gesture 2",
    ] {
        let theirs = robot::Settings {
            watchdog: 600,
            ..robot::Settings::default()
        };
        let settings = Settings {
            silence: 60_000,
            ..Settings::default()
        };
        let mut rig = Rig::with(settings, theirs, 1);
        while !rig.mirror.is_up() {
            rig.step();
        }
        rig.run(50);
        rig.submit(script);
        rig.run(300);
        for _ in 0..6000 {
            rig.now += 1000;
            rig.robot();
        }
        assert!(
            !rig.acts() && rig.swing() < 1.0,
            "{script}: {:?}",
            rig.body.glance()
        );
        let (before, gestures) = (rig.body.glance(), rig.body.doings.gestures.len());
        rig.run(4000);
        let after = rig.body.glance();
        assert_eq!(
            (before.pose, gestures),
            (after.pose, rig.body.doings.gestures.len())
        );
        assert!(
            !rig.is_finished() && rig.swing() < 1.0,
            "{script}: {:?}",
            rig.events
        );
        let (name, text) = rig.failed().expect("it failed");
        assert!(
            name == ErrorName::Halted && text.contains("stood still"),
            "{text}"
        );
    }
}

/// What is switched off is not told again and again, and ends what needs it once.
#[test]
fn what_is_switched_off_ends_a_statement_once_and_nothing_spins() {
    for (element, script) in [
        ("left-wheel", "motor 500 500 1000"),
        ("right-wheel", "goto 3000 3000"),
        ("pose", "goto 3000 3000"),
        ("joints", "set joints 10 10 10"),
        ("speaker", "play speaker song on; wait 800"),
    ] {
        let mut rig = Rig::new();
        rig.submit(&format!("deactivate {element}; {script}"));
        for ms in 0..1500 {
            rig.step();
            let time = rig.time();
            let due = rig.queue.next_wake();
            assert!(due.is_none_or(|due| due > time), "{element}, {script}: {ms} ms");
        }
        let failed = |event: &&QueueEvent| matches!(event, QueueEvent::Failed(..));
        assert_eq!(rig.events.iter().filter(failed).count(), 1, "{element}, {script}");
        assert!(rig.failures <= 1, "{element}, {script}: {}", rig.failures);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 16, max_shrink_iters: 40, failure_persistence: None, ..ProptestConfig::default() })]

    /// After any commands, in any weather, at any time: once the robot has confirmed a stop nothing of its body begins to act before it is
    /// let go, and where it says that it rests it does so.
    #[test]
    fn nothing_begins_between_a_stop_and_an_unstop(
        loss in 0..40_u64,
        twice in 0..40_u64,
        delay in 0..60_u64,
        jitter in 0..400_u64,
        seed in any::<u64>(),
        rounds in proptest::collection::vec((proptest::collection::vec(0..8_usize, 0..5), 0..900_u64, 0..4_u64), 1..4),
    ) {
        const SCRIPTS: [&str; 8] = [
            "do gesture 2; do gesture 3",
            "do gesture 1",
            "motor 600 400 700; motor -500 500 700",
            "set joints 60 -60 20; set joints 0 0 0",
            "set left-wheel 300 lips 60 for 400; set lips 20",
            "play speaker song on; do gesture 0",
            "goto 2800 2600",
            "period 40; do gesture 5; period 20",
        ];
        let mut rig = Rig::with(Settings::default(), robot::Settings::default(), seed);
        rig.weather = Weather { loss, twice, delay, jitter };
        for (commands, busy, again) in rounds {
            for _ in 0..15_000 {
                if rig.mirror.is_up() {
                    break;
                }
                rig.step();
            }
            for command in commands {
                rig.submit(SCRIPTS[command]);
                let pause = rig.below(200);
                rig.run(pause);
            }
            rig.run(busy);
            rig.stop();
            for _ in 0..again {
                let pause = rig.below(100);
                rig.run(pause);
                rig.stop();
                rig.submit("do gesture 7");
            }
            let mut stood = false;
            let mut at_rest: Option<Glance> = None;
            for _ in 0..2500 {
                rig.step();
                let state = rig.queue.state();
                prop_assert!(state.stopped);
                // It has confirmed the stop, or the end of its session has had it rest.
                stood |= !state.moving;
                let acts = rig.acts();
                prop_assert!(!(stood && acts), "{:?}", rig.body.glance());
                if state.rest.is_none() {
                    at_rest = None;
                    continue;
                }
                let now = rig.body.glance();
                let before = *at_rest.get_or_insert(now);
                let way = (now.pose.x - before.pose.x).hypot(now.pose.y - before.pose.y);
                let swing = (now.posture.left_arm.0 - before.posture.left_arm.0).abs();
                prop_assert!(way < 4.0 && swing < 4.0, "{:?} {:?}", before, now);
            }
            let gestures = rig.body.doings.gestures.len();
            rig.run(1000);
            prop_assert_eq!(rig.body.doings.gestures.len(), gestures);
            let time = rig.time();
            rig.queue.unstop(time, &mut rig.events);
        }
    }
}
