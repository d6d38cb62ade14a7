//! The Robot API (S7, S8) of a mirror whose robot is a simulated CUBO, over a socket.

use std::future::pending;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::mpsc;
use std::time::Duration;

use mom_client::{Event, Family, FenceGate, Map, Parcel, Path, StopState, Time, Value};
use mom_cubo::model::LAYOUT;
use mom_cubo::model::robot::{Dispatch, PACKET};
use mom_cubo::{Cubo, CuboHandle, End, Touch};
use mom_device::{
    Attachments, Command, CommandQueue, DeviceServer, ErrorName, MAX_ATTACHED, Machine as _, Order, Script,
};
use mom_device_cases::{Stage, Statements, replay};
use mom_rsp::middle::{Notice, Settings};
use mom_rsp::{Direction, Header, Item, Items, Type, robot};
use mom_rsp_model::Model;
use mom_simulacrum::{Action, Mirror, Simulacrum, Wheels, serve, to_wire};
use mom_wheels::{Chassis, Driver as _, Pose};
use tokio::net::UdpSocket;
use tokio::sync::oneshot;
use tokio::time::timeout;

const PATIENCE: Duration = Duration::from_secs(20);

fn cubo() -> CuboHandle {
    let body = Cubo::new(Pose::new(1000.0, 2000.0, 90.0)).expect("a place");
    let settings = robot::Settings {
        watchdog: 5000,
        ..robot::Settings::default()
    };
    CuboHandle::new(body, settings).expect("settings")
}

fn mirror() -> Simulacrum {
    let settings = Settings {
        silence: 5000,
        ..Settings::default()
    };
    let model = Model::read(mom_cubo::MODEL).expect("a model");
    Simulacrum::new("cubo", model, settings).expect("settings")
}

/// A middle's socket, connected to a robot's.
async fn connected(address: SocketAddr) -> UdpSocket {
    let middle = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    middle.connect(address).await.expect("a way");
    middle
}

/// A robot that is served, and its mirror once there is a session.
async fn pair() -> (CuboHandle, Simulacrum) {
    let robot = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let address = robot.local_addr().expect("it has one");
    let (cubo, mirror) = (cubo(), mirror());
    tokio::spawn(mom_cubo::serve(robot, cubo.clone(), pending()));
    let mut notices = mirror.notices();
    tokio::spawn(serve(mirror.clone(), connected(address).await, pending()));
    let up = async { while *notices.recv().await.expect("it lives") != Notice::Up {} };
    timeout(PATIENCE, up).await.expect("there is a session");
    (cubo, mirror)
}

/// A consumer waits until the value it wants has come.
async fn comes(mirror: &Simulacrum, name: &str, wanted: impl Fn(&[f64]) -> bool) -> Vec<f64> {
    let (element, _) = mirror.element(name).expect("CUBO has it");
    let heard = async {
        loop {
            let known = mirror.changed(element).await.expect("it is heard");
            if wanted(&known.values) {
                return known.values;
            }
        }
    };
    timeout(PATIENCE, heard)
        .await
        .unwrap_or_else(|_| panic!("{name} comes"))
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_written_is_read_back_and_consumers_wait_for_it() {
    let (_cubo, mirror) = pair().await;
    let (joints, model) = mirror.element("joints").expect("CUBO has them");
    let (pose, _) = mirror.element("pose").expect("CUBO has it");
    let value = to_wire(model, &[30.0, -20.0, 10.0]).expect("in range");
    mirror.write(joints, &value).expect("there is a session");
    assert_eq!(mirror.wanted(joints), Some(vec![30.0, -20.0, 10.0]));
    let posture = comes(&mirror, "posture", |values| {
        values.first().is_some_and(|left| *left > 25.0)
    })
    .await;
    assert!(posture.get(1).is_some_and(|right| *right < 0.0), "{posture:?}");
    // The body can only follow what has arrived, and the posture that says so acknowledges it.
    let all = mirror.read_list(&[joints, pose]);
    let values: Vec<_> = all.into_iter().flatten().map(|known| known.values).collect();
    assert_eq!(values, [vec![30.0, -20.0, 10.0], vec![1000.0, 2000.0, 90.0]]);
    assert!(to_wire(model, &[91.0, 0.0, 0.0]).is_err(), "out of its range");
}

#[tokio::test(flavor = "multi_thread")]
async fn listeners_are_called_as_an_event_is_heard_and_once() {
    let (cubo, mirror) = pair().await;
    let (button, _) = mirror.element("service-button").expect("CUBO has it");
    let (say, heard) = mpsc::channel();
    let listener = move |notice: &Notice, _: &Simulacrum| {
        // Who does not look any more hears nothing.
        let _ = say.send(matches!(notice, Notice::Raised { .. }));
    };
    mirror.listen(button, Box::new(listener));
    cubo.touch(Touch::ServiceButton);
    cubo.touch(Touch::ServiceButton);
    let heard = tokio::task::spawn_blocking(move || {
        let twice = [heard.recv_timeout(PATIENCE), heard.recv_timeout(PATIENCE)];
        (twice, heard)
    });
    let (twice, heard) = heard.await.expect("it ran");
    assert_eq!(twice, [Ok(true), Ok(true)]);
    // A value that comes later shows that nothing was heard in between.
    let (joints, model) = mirror.element("joints").expect("CUBO has them");
    let value = to_wire(model, &[40.0, 0.0, 0.0]).expect("in range");
    mirror.write(joints, &value).expect("there is a session");
    comes(&mirror, "posture", |values| {
        values.first().is_some_and(|left| *left > 30.0)
    })
    .await;
    assert!(heard.try_recv().is_err(), "each event once");
}

/// A robot whose program ends its session and begins anew is mirrored again, and is not taken for lost meanwhile (S23).
#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_ended_its_session_is_asked_again() {
    let (socket, mirror) = (
        UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port"),
        mirror(),
    );
    let address = socket.local_addr().expect("it has one");
    let (stop, stopped) = oneshot::channel::<()>();
    let first = cubo();
    let ended = tokio::spawn(mom_cubo::serve(socket, first.clone(), async move {
        let _ = stopped.await;
    }));
    let mut notices = mirror.notices();
    tokio::spawn(serve(mirror.clone(), connected(address).await, pending()));
    let mut until = async |wanted: Notice| {
        let heard = async { while *notices.recv().await.expect("it lives") != wanted {} };
        timeout(PATIENCE, heard)
            .await
            .unwrap_or_else(|_| panic!("{wanted:?} is noticed"));
    };
    until(Notice::Up).await;
    // The robot's session begins by the packet after that.
    while !first.look(|_, end| end.is_up()) {
        tokio::task::yield_now().await;
    }
    stop.send(()).expect("it is served");
    until(Notice::Ended).await;
    ended.await.expect("it ends").expect("by itself");
    let again = UdpSocket::bind(address).await.expect("the same port");
    tokio::spawn(mom_cubo::serve(again, cubo(), pending()));
    until(Notice::Up).await;
}

/// The refusal of another model reaches who asked, with the names of what differs (part 2).
#[tokio::test(flavor = "multi_thread")]
async fn another_model_is_refused_by_the_names_of_its_elements() {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let address = socket.local_addr().expect("it has one");
    tokio::spawn(mom_cubo::serve(socket, cubo(), pending()));
    let model = mom_cubo::MODEL.replacen("range = [-500, 500]", "range = [-400, 400]", 1);
    let model = Model::read(&model).expect("a model");
    let mirror = Simulacrum::new("cubo", model, Settings::default()).expect("settings");
    let mut notices = mirror.notices();
    tokio::spawn(serve(mirror, connected(address).await, pending()));
    let refused = timeout(PATIENCE, async {
        loop {
            if let Notice::Refused(refusal) = &*notices.recv().await.expect("it lives") {
                return format!("{refusal:?}");
            }
        }
    });
    let refused = refused.await.expect("it is refused");
    assert!(
        refused.contains("left-wheel") && !refused.contains("joints"),
        "{refused}"
    );
}

/// Nobody has to have listened when it was found out: it is in the state, and in what is refused, for as long as there is no session.
#[tokio::test(flavor = "multi_thread")]
async fn who_comes_later_is_told_why_there_is_no_session() {
    let other = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let silent = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let (refuses, hears) = (other.local_addr(), silent.local_addr());
    let (refuses, hears) = (refuses.expect("one"), hears.expect("one"));
    tokio::spawn(mom_cubo::serve(other, cubo(), pending()));
    let closed = {
        let gone = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
        gone.local_addr().expect("one")
    };
    for (address, words) in [
        (
            refuses,
            "no session: the robot has another model, which differs in left-wheel".to_owned(),
        ),
        (closed, format!("no session: nothing listens at {closed}")),
        (hears, format!("no session: no valid datagram comes from {hears}")),
    ] {
        let model = mom_cubo::MODEL.replacen("range = [-500, 500]", "range = [-400, 400]", 1);
        let model = Model::read(&model).expect("a model");
        let mirror = Simulacrum::new("cubo", model, Settings::default()).expect("settings");
        assert_eq!(
            mirror.trouble().as_deref(),
            Some("no session"),
            "nothing is known yet"
        );
        tokio::spawn(serve(mirror.clone(), connected(address).await, pending()));
        let told = async {
            while !mirror.trouble().is_some_and(|why| why.starts_with(&words)) {
                tokio::task::yield_now().await;
            }
        };
        assert!(
            timeout(PATIENCE, told).await.is_ok(),
            "{words}, and it is {:?}",
            mirror.trouble()
        );
        let queue = CommandQueue::new(Mirror::new(mirror.clone(), Chassis::CUBO, None));
        let state = queue.state();
        let why = state.report.get("unreached-why").and_then(Value::as_str);
        assert!(why.is_some_and(|why| why.starts_with(&words)), "{why:?}");
        assert_eq!(state.report.get("linked"), Some(&Value::from(false)));
    }
    let (_cubo, mirror) = pair().await;
    assert_eq!(mirror.trouble(), None);
}

/// A middle and a robot in virtual time, with nothing between them.
struct Bench {
    mirror: Simulacrum,
    machine: Mirror,
    body: Cubo,
    end: End,
    /// µs.
    now: u64,
}

impl Bench {
    fn new() -> Bench {
        let model = Model::read(mom_cubo::MODEL).expect("a model");
        let mirror = Simulacrum::new("cubo", model, Settings::default()).expect("settings");
        let mut bench = Bench {
            machine: Mirror::new(mirror.clone(), Chassis::CUBO, None),
            mirror,
            body: Cubo::new(Pose::new(2500.0, 2500.0, 0.0)).expect("a place"),
            end: End::new(&LAYOUT, robot::Settings::default()).expect("settings"),
            now: 0,
        };
        bench.mirror.with(|middle| middle.start(0));
        while !bench.mirror.is_up() {
            bench.step();
        }
        bench
    }

    /// A ms passes; the speeds of the left wheel that left for the robot.
    fn step(&mut self) -> Vec<i16> {
        self.now += 1000;
        let Bench {
            mirror,
            machine,
            body,
            end,
            now,
        } = self;
        let mut speeds = Vec::new();
        machine.advance(i64::try_from(*now).expect("not so late"));
        let hear = |notice| machine.heard(&notice).expect("nothing is lost");
        exchange((mirror, body, end), *now, hear, |speed| speeds.push(speed));
        speeds
    }
}

/// What middle and robot have to say to each other now: what the middle notices of it, and the speeds of the left wheel that leave for the
/// robot.
fn exchange(
    (mirror, body, end): (&Simulacrum, &mut Cubo, &mut End),
    now: u64,
    mut hear: impl FnMut(Notice),
    mut sees: impl FnMut(i16),
) {
    body.advance(i64::try_from(now).expect("not so late"));
    while let Some(mut datagram) = mirror.with(|middle| middle.poll(now).map(<[u8]>::to_vec)) {
        let header = Header::decode(&datagram).expect("a header");
        if header.kind == Type::Data {
            let payload = datagram.get(Header::LEN..).unwrap_or_default();
            for item in Items::parse(&LAYOUT, Direction::Down, payload).expect("a packet") {
                if let (0, Item::Value(value)) = item {
                    sees(i16::from_be_bytes(value.try_into().expect("two bytes")));
                }
            }
        }
        end.receive(now, &mut datagram, &mut Dispatch(&mut *body))
            .expect("it is taken");
    }
    body.tell(end);
    let mut out = vec![0; PACKET];
    while let Some(length) = end.poll(now, &mut out, &mut Dispatch(&mut *body)) {
        let datagram = out.get_mut(..length).expect("it was written");
        mirror
            .with(|middle| middle.receive(now, datagram))
            .expect("it is taken");
    }
    while let Some(notice) = mirror.with(mom_rsp::middle::Middle::next_notice) {
        hear(notice);
    }
}

/// Part 7: at the owner's loss, which halts the machine, the robot takes its safe values within 2 T, whenever in a period that is.
#[test]
fn safe_values_are_taken_within_two_periods_of_a_halt() {
    for phase in 0..20 {
        let mut bench = Bench::new();
        let script =
            Script::read::<Mirror>("set left-wheel 200 right-wheel 200 for 60000").expect("a script");
        bench.machine.plan(&script).expect("it can be done");
        let (action, _) = script.actions().next().expect("one");
        let now = i64::try_from(bench.now).expect("not so late");
        bench.machine.begin(action, now).expect("it begins");
        let mut told = Vec::new();
        for _ in 0..100 + phase {
            told.extend(bench.step());
        }
        assert_eq!(told.last(), Some(&200));
        bench.machine.halt(i64::try_from(bench.now).expect("not so late"));
        assert!(bench.body.motion().0, "its wheels turn");
        let left = (1..).find(|_| {
            bench.step();
            !bench.body.motion().0
        });
        let left = left.expect("they stop");
        assert!(left <= 40, "{left} ms after a halt in ms {phase} of a period");
    }
}

/// What a statement left set when it was done rests at a halt, as what goes on does.
#[test]
fn a_halt_ends_what_a_statement_left() {
    let mut bench = Bench::new();
    let now = i64::try_from(bench.now).expect("not so late");
    let script = Script::read::<Mirror>("set joints 30 -20 10").expect("a script");
    let (action, _) = script.actions().next().expect("one");
    assert!(bench.machine.is_at_rest());
    bench.machine.begin(action, now).expect("it begins");
    while bench.machine.done_at().is_none() {
        bench.step();
    }
    let (joints, _) = bench.mirror.element("joints").expect("CUBO has them");
    assert!(!bench.machine.is_moving() && !bench.machine.is_at_rest());
    bench.machine.halt(now);
    assert!(bench.machine.is_moving(), "it has not confirmed it");
    while !bench.machine.is_at_rest() || bench.mirror.wanted(joints).is_none() {
        bench.step();
    }
    assert_eq!(bench.mirror.wanted(joints), Some(vec![0.0, 0.0, 0.0]));
}

/// Who takes or loses the token, and the loss of the hub, end what a finished command has set; the same owner keeps it.
#[test]
fn what_was_set_does_not_outlive_its_owner() {
    let token = || Path::parse("/lab/token").expect("a path");
    let grabbed = |fence| Event::Grabbed {
        owner: "somebody".to_owned(),
        level: 1,
        fence,
        lease: None,
        path: token(),
    };
    let released = Event::Released {
        owner: "alice".to_owned(),
        reason: "released".to_owned(),
        by: None,
        fence: 5,
        path: token(),
    };
    for (event, rests) in [
        (grabbed(5), false),
        (grabbed(6), true),
        (released, true),
        (Event::LinkDown, true),
    ] {
        let mut bench = Bench::new();
        let mirror = bench.mirror.clone();
        let machine = Mirror::new(mirror.clone(), Chassis::CUBO, None);
        let channel = Path::parse("/lab/robot").expect("a path");
        let mut server = DeviceServer::new(machine, channel.clone(), Time::default());
        let gate = FenceGate::new();
        let guard = Map::new()
            .with("token", "/lab/token")
            .with("names", vec!["command".into()])
            .with("fence", 5)
            .with("owner", "alice");
        gate.joined(&Map::new().with("guard", guard));
        let mut out = Vec::new();
        // It may move, as the hub says.
        let time = |bench: &Bench| i64::try_from(bench.now).expect("not so late");
        let stops = Event::Stops(StopState::default());
        server.handle(&stops, &gate, None, time(&bench), &mut out);
        let mut command = Parcel::new(Family::Message, "command")
            .context(channel)
            .content("set joints 30 -20 10");
        (command.sender, command.id, command.fence) = (Some("alice".into()), Some(1), Some(5));
        server.handle(&Event::Message(command), &gate, None, time(&bench), &mut out);
        let (joints, _) = mirror.element("joints").expect("CUBO has them");
        let is_set = || mirror.wanted(joints) == Some(vec![30.0, -20.0, 10.0]);
        let done = |out: &[Parcel]| format!("{out:?}").contains("finished");
        while !done(&out) {
            bench.step();
            server.advance(time(&bench), &mut out);
        }
        assert!(is_set() && !server.machine().is_moving(), "{out:?}");
        server.handle(&event, &gate, None, time(&bench), &mut out);
        assert_eq!(is_set(), !rests, "{event:?}");
    }
}

/// Remembers how far the turret of figure 8's robot was turned.
struct Turret(i64);

impl robot::Body for Turret {
    fn random(&mut self, bytes: &mut [u8]) {
        bytes.fill(5);
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        if element == 2 {
            self.0 += i64::from(i16::from_be_bytes(value.try_into().expect("two bytes")));
        }
    }

    fn command(&mut self, _: u8, _: &[u8]) {}
}

/// What moves by steps makes no more of them after a halt, though it had many left (S12).
#[test]
fn a_halt_ends_the_steps_that_were_not_made() {
    let model = Model::read(include_str!("../../../config/ir-robot.toml")).expect("a model");
    let layout = model.clone().into_layout();
    let mut end = robot::Robot::<8, 128, 4, 64>::new(&layout, robot::Settings::default()).expect("it fits");
    let mirror = Simulacrum::new("ir", model, Settings::default()).expect("settings");
    let mut machine = Mirror::new(mirror.clone(), Chassis::CUBO, None);
    let mut turret = Turret(0);
    mirror.with(|middle| middle.start(0));
    let mut pass = |machine: &mut Mirror, turret: &mut Turret, ms: std::ops::Range<u64>| {
        let mut out = [0; 2048];
        for now in ms.map(|ms| ms * 1000) {
            machine.advance(i64::try_from(now).expect("not so late"));
            while let Some(mut datagram) = mirror.with(|middle| middle.poll(now).map(<[u8]>::to_vec)) {
                end.receive(now, &mut datagram, turret).expect("it is taken");
            }
            while let Some(length) = end.poll(now, &mut out, turret) {
                let datagram = out.get_mut(..length).expect("it was written");
                let heard = mirror.with(|middle| middle.receive(now, datagram));
                heard.expect("it is taken");
            }
            while let Some(notice) = mirror.with(mom_rsp::middle::Middle::next_notice) {
                machine.heard(&notice).expect("nothing is lost");
            }
        }
        turret.0
    };
    pass(&mut machine, &mut turret, 0..100);
    let script = Script::read::<Mirror>("set turret 300").expect("a script");
    let (action, _) = script.actions().next().expect("one");
    machine.begin(action, 100_000).expect("it begins");
    let turned = pass(&mut machine, &mut turret, 100..400);
    assert!((50..1000).contains(&turned), "{turned}");
    machine.halt(400_000);
    let at_most = pass(&mut machine, &mut turret, 400..440);
    let stood = pass(&mut machine, &mut turret, 440..1400);
    assert_eq!(stood, at_most, "it stands within 2 T");
    // The next owner can turn it.
    let script = Script::read::<Mirror>("set turret -1").expect("a script");
    let (action, _) = script.actions().next().expect("one");
    machine.begin(action, 1_400_000).expect("it is active again");
    assert!(pass(&mut machine, &mut turret, 1400..1600) < stood);
}

/// A place that a sensor said before it was switched off is not where the robot is.
#[test]
fn what_is_switched_off_tells_no_place() {
    let mut bench = Bench::new();
    let (pose, _) = bench.mirror.element("pose").expect("CUBO has it");
    let place = |bench: &Bench| {
        let mut wheels = Wheels::of(&bench.mirror, Chassis::CUBO).expect("CUBO has wheels");
        wheels.sensors(0).expect("there is a session").pose
    };
    while place(&bench).is_none() {
        bench.step();
    }
    let switched = bench.mirror.with(|middle| middle.set_activated(pose, false));
    switched.expect("there is a session");
    while bench.mirror.with(|middle| middle.active(pose)) {
        bench.step();
    }
    assert_eq!(place(&bench), None);
}

/// What waits with its sounds and pictures is bounded, so that no owner fills the memory of a middle that others need.
#[test]
fn so_many_attachments_wait_and_no_more() {
    let model = Model::read(mom_cubo::MODEL).expect("a model");
    let mirror = Simulacrum::new("cubo", model, Settings::default()).expect("settings");
    let mut queue = CommandQueue::new(Mirror::new(mirror, Chassis::CUBO, None));
    let half = MAX_ATTACHED / 2;
    let mut submit = |size: usize| {
        let face = Map::new().with("face", Value::Binary(vec![1; size].into()));
        let attachments = Attachments::of(&face).expect("bytes");
        let command = Command {
            order: Order {
                peer: "alice".into(),
                id: None,
                fence: None,
            },
            script: Script::read_with::<Mirror>("wait 60000; show lcd face", &attachments).expect("a script"),
            use_by: None,
        };
        queue.submit(command, 0, &mut Vec::new())
    };
    submit(half).expect("there is room");
    submit(half).expect("there is room");
    let full = submit(1).expect_err("there is none");
    assert_eq!(full.name(), ErrorName::QueueFull, "{full}");
}

#[test]
fn statements_share_the_bytes_of_an_attachment() {
    let face = Map::new().with("face", Value::Binary(vec![1; 1000].into()));
    let attachments = Attachments::of(&face).expect("bytes");
    let script = "show lcd face\n".repeat(1000);
    let script = Script::read_with::<Mirror>(&script, &attachments).expect("a script");
    let shown = script.actions().map(|(action, _)| match action {
        Action::Show { bytes, .. } => bytes.bytes.as_ptr(),
        other => panic!("{other:?}"),
    });
    let mut shown: Vec<_> = shown.collect();
    assert_eq!(shown.len(), 1000);
    shown.dedup();
    assert_eq!(shown.len(), 1, "no statement has a copy of its own");
}

const STATEMENTS: Statements = Statements {
    go: "goto 3500 2500",
    back: "goto 2500 2500",
    wrong: "gogo 1 2",
    beyond: None,
    relative: None,
    velocity: None,
};

/// The device that the dialogues of every device are replayed by: a mirror with its robot, in virtual time.
fn stage() -> Stage<Mirror> {
    let Bench {
        mirror,
        machine,
        mut body,
        mut end,
        now,
    } = Bench::new();
    let mechanism = move |server: &mut DeviceServer<Mirror>, now: i64, out: &mut Vec<Parcel>| {
        let mut heard = Vec::new();
        let time = u64::try_from(now).expect("not before the beginning");
        exchange(
            (&mirror, &mut body, &mut end),
            time,
            |notice| heard.push(notice),
            |_| {},
        );
        let hear = |machine: &mut Mirror| {
            heard
                .iter()
                .for_each(|notice| machine.heard(notice).expect("nothing is lost"));
        };
        server.note(now, hear, out);
    };
    let now = i64::try_from(now).expect("not so late");
    Stage::bare(machine).at(now).driven_by(mechanism)
}

/// Some are played for each of several events; none may be left out in silence.
#[test]
fn a_mirrored_robot_does_what_every_device_does() {
    assert_eq!(replay(stage, &STATEMENTS), 42);
}
