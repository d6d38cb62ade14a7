//! The Robot API (S7, S8) of a mirror whose robot is a simulated CUBO, over a socket.

use std::future::pending;
use std::net::Ipv4Addr;
use std::sync::mpsc;
use std::time::Duration;

use mom_client::{Map, Value};
use mom_cubo::model::LAYOUT;
use mom_cubo::model::robot::{Dispatch, PACKET};
use mom_cubo::{Cubo, CuboHandle, End, Touch};
use mom_device::{Attachments, Command, CommandQueue, ErrorName, MAX_ATTACHED, Machine as _, Order, Script};
use mom_rsp::middle::{Notice, Settings};
use mom_rsp::{Direction, Header, Item, Items, Type, robot};
use mom_rsp_model::Model;
use mom_simulacrum::{Mirror, Simulacrum, serve, to_wire};
use mom_wheels::{Chassis, Pose};
use tokio::net::UdpSocket;
use tokio::time::timeout;

const PATIENCE: Duration = Duration::from_secs(20);

/// A robot that is served, and its mirror once there is a session.
async fn pair() -> (CuboHandle, Simulacrum) {
    let robot = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let middle = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let address = robot.local_addr().expect("it has one");
    middle.connect(address).await.expect("a way");
    let body = Cubo::new(Pose::new(1000.0, 2000.0, 90.0)).expect("a place");
    let settings = robot::Settings {
        watchdog: 5000,
        ..robot::Settings::default()
    };
    let cubo = CuboHandle::new(body, settings).expect("settings");
    tokio::spawn(mom_cubo::serve(robot, cubo.clone(), pending()));
    let settings = Settings {
        silence: 5000,
        ..Settings::default()
    };
    let model = Model::read(mom_cubo::MODEL).expect("a model");
    let mirror = Simulacrum::new("cubo", model, settings).expect("settings");
    let mut notices = mirror.notices();
    tokio::spawn(serve(mirror.clone(), middle, pending()));
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
        body.advance(i64::try_from(*now).expect("not so late"));
        while let Some(mut datagram) = mirror.with(|middle| middle.poll(*now).map(<[u8]>::to_vec)) {
            let header = Header::decode(&datagram).expect("a header");
            if header.kind == Type::Data {
                let payload = datagram.get(Header::LEN..).unwrap_or_default();
                let items = Items::parse(&LAYOUT, Direction::Down, payload).expect("a packet");
                speeds.extend(items.filter_map(|(place, item)| match (place, item) {
                    (0, Item::Value(value)) => Some(i16::from_be_bytes(value.try_into().expect("two bytes"))),
                    _ => None,
                }));
            }
            end.receive(*now, &mut datagram, &mut Dispatch(&mut *body))
                .expect("it is taken");
        }
        body.tell(end);
        let mut out = vec![0; PACKET];
        while let Some(length) = end.poll(*now, &mut out, &mut Dispatch(&mut *body)) {
            let datagram = out.get_mut(..length).expect("it was written");
            mirror
                .with(|middle| middle.receive(*now, datagram))
                .expect("it is taken");
        }
        while let Some(notice) = mirror.with(mom_rsp::middle::Middle::next_notice) {
            machine.heard(&notice).expect("nothing is lost");
        }
        speeds
    }
}

/// Part 7: at the owner's loss, which halts the machine, safe values are on their way within 2 T, whenever in a period that is.
#[test]
fn safe_values_are_on_their_way_within_two_periods_of_a_halt() {
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
        let left = (1..).find(|_| bench.step().contains(&0)).expect("it leaves");
        assert!(left <= 40, "{left} ms after a halt in ms {phase} of a period");
    }
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
