//! What holds for any bytes: the bodies of the property tests and of the fuzz targets.
#![allow(dead_code, unreachable_pub, reason = "each fuzz target uses one of them")]

use mom_rsp::middle::{self, Middle};
use mom_rsp::robot::{self, Body, Robot};
use mom_rsp::{Direction, Element, Fragment, Header, Items, Kind, Layout, Motion, Number, Payload, Writer};

const fn element(
    name: &'static str,
    kind: Kind,
    payload: Payload,
    safe: &'static [u8],
    motion: Motion,
) -> Element<'static> {
    Element {
        name,
        kind,
        payload,
        motion,
        safe,
        period: 0,
        module: None,
        of: None,
        digest: 0,
    }
}

const ABSOLUTE: Motion = Motion::Absolute {
    interpolate: true,
    rate: Some(100.0),
};
const STEPS: Motion = Motion::Incremental { rate: Some(1000.0) };

/// One of each kind and type, and a map of two bytes that is padded.
static LAYOUT: Layout<'static> = Layout::new(
    0,
    [0; 32],
    &[
        element(
            "a",
            Kind::Effector,
            Payload::Numbers(Number::F32, 2),
            &[0; 8],
            ABSOLUTE,
        ),
        element("b", Kind::Effector, Payload::Numbers(Number::I8, 1), &[0], STEPS),
        element(
            "c",
            Kind::Effector,
            Payload::Bytes(5),
            &[0, 0],
            Motion::Absolute {
                interpolate: false,
                rate: None,
            },
        ),
        element("d", Kind::Sensor, Payload::Numbers(Number::U32, 1), &[], ABSOLUTE),
        element("e", Kind::Sensor, Payload::Bytes(5), &[], ABSOLUTE),
        element("f", Kind::Command, Payload::Bytes(5), &[], ABSOLUTE),
        element("g", Kind::MemoryCommand, Payload::Nothing, &[], ABSOLUTE),
        element("h", Kind::Event, Payload::Bytes(5), &[], ABSOLUTE),
        element("i", Kind::MemoryEvent, Payload::Bytes(5), &[], ABSOLUTE),
        element("j", Kind::Module, Payload::Nothing, &[], ABSOLUTE),
        element(
            "k",
            Kind::Effector,
            Payload::Numbers(Number::U16, 1),
            &[0; 2],
            STEPS,
        ),
        element(
            "l",
            Kind::Effector,
            Payload::Numbers(Number::F32, 1),
            &[0; 4],
            STEPS,
        ),
    ],
);

/// A header, a map and a payload: what is read is written again as the same bytes.
pub fn any_packet(bytes: &[u8]) {
    if let Ok(header) = Header::decode(bytes) {
        assert_eq!(header.encode(), bytes[..Header::LEN]);
    }
    let body = bytes.get(Header::LEN..).unwrap_or(bytes);
    for direction in [Direction::Down, Direction::Up] {
        let Ok(items) = Items::parse(&LAYOUT, direction, body) else {
            continue;
        };
        let mut out = [0; 256];
        let mut writer = Writer::new(&LAYOUT, direction, &mut out).expect("there is space");
        for (place, item) in items {
            writer.put(place, item).expect("what was read can be written");
        }
        let len = writer.finish();
        assert_eq!(&out[..len], body);
    }
}

/// Checks what it is told.
struct Checks(u8);

impl Body for Checks {
    fn random(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            self.0 = self.0.wrapping_add(1);
            *byte = self.0;
        }
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        let element = LAYOUT.elements()[usize::from(element)];
        assert_eq!(element.kind, Kind::Effector);
        match element.payload {
            Payload::Bytes(most) => assert!(value.len() <= usize::from(most)),
            payload => assert_eq!(value.len(), payload.size()),
        }
    }

    fn command(&mut self, element: u8, data: &[u8]) {
        let element = LAYOUT.elements()[usize::from(element)];
        assert!(matches!(element.kind, Kind::Command | Kind::MemoryCommand));
        assert!(data.len() <= element.payload.size());
    }

    fn fragment(&mut self, fragment: Fragment<'_>) {
        assert!(!fragment.bytes.is_empty());
    }
}

type Any = Robot<'static, 12, { robot::values(&LAYOUT) }, 2, { robot::slot(&LAYOUT) }>;

/// Datagrams in these bytes: the first says how long it is and what is put into its header, so that some get further.
fn datagrams(mut bytes: &[u8], mut each: impl FnMut(u8, &mut [u8])) {
    while let Some((&[len, how], rest)) = bytes.split_first_chunk() {
        let (datagram, rest) = rest.split_at(usize::from(len).min(rest.len()));
        each(how, &mut datagram.to_vec());
        bytes = rest;
    }
}

/// Puts what is known into a header: version, model, no encryption, session and sequence.
fn complete(datagram: &mut [u8], how: u8, known: &[u8], sequence: u16) {
    if how & 1 == 0 || datagram.len() < Header::LEN || known.len() < Header::LEN {
        return;
    }
    datagram[..4].copy_from_slice(&[1, 0, 0, 0]);
    datagram[11..17].copy_from_slice(&known[11..17]);
    if how & 2 == 0 {
        datagram[5..7].copy_from_slice(&sequence.to_be_bytes());
    }
}

/// Lets both ends begin a session.
fn begin(robot: &mut Any, middle: &mut Middle<'_>, checks: &mut Checks) -> Vec<u8> {
    let mut out = [0; 1024];
    let mut welcome = Vec::new();
    middle.start(0);
    for now in [0, 1000, 2000] {
        while let Some(packet) = middle.poll(now).map(<[u8]>::to_vec) {
            let _ = robot.receive(now, &mut packet.clone(), checks);
        }
        while let Some(len) = robot.poll(now, &mut out, checks) {
            if welcome.is_empty() {
                welcome = out[..len].to_vec();
            }
            let _ = middle.receive(now, &mut out[..len]);
        }
    }
    assert!(robot.is_up());
    welcome
}

fn ends() -> (Any, Middle<'static>, Checks) {
    let robot = Robot::new(&LAYOUT, robot::Settings::default()).expect("it fits");
    let middle = Middle::new(&LAYOUT, middle::Settings::default(), |bytes: &mut [u8]| {
        bytes.fill(3);
    })
    .expect("it fits");
    (robot, middle, Checks(0))
}

/// Whatever arrives, a robot's end counts it and goes on.
pub fn any_datagram(bytes: &[u8]) {
    let (mut robot, mut middle, mut checks) = ends();
    let known = begin(&mut robot, &mut middle, &mut checks);
    let (mut now, mut sequence, mut arrived) = (3000, 1, robot.counters().accepted());
    datagrams(bytes, |how, datagram| {
        complete(datagram, how, &known, sequence);
        sequence = sequence.wrapping_add(1 + u16::from(how >> 4));
        let _ = robot.receive(now, datagram, &mut checks);
        arrived += 1;
        let _ = robot.set(3, &[how; 4]);
        let _ = robot.raise(7, &[how; 3]);
        let _ = robot.raise(8, &[how; 3]);
        now += u64::from(how) * 100;
        let mut out = [0; 1024];
        for _ in 0..4 {
            let _ = robot.poll(now, &mut out, &mut checks);
        }
    });
    let counters = robot.counters();
    let counted = counters.accepted() + counters.iter().map(|(_, count)| count).sum::<u32>();
    assert_eq!(counted, arrived);
}

/// Whatever arrives, a middle's end counts it and goes on.
pub fn any_uplink(bytes: &[u8]) {
    let (mut robot, mut middle, mut checks) = ends();
    let known = begin(&mut robot, &mut middle, &mut checks);
    let mut arrived = middle.counters().accepted();
    let (mut now, mut sequence) = (3000, 1);
    datagrams(bytes, |how, datagram| {
        complete(datagram, how, &known, sequence);
        sequence = sequence.wrapping_add(1 + u16::from(how >> 4));
        let _ = middle.receive(now, datagram);
        arrived += 1;
        let _ = middle.write(1, &[how & 3]);
        let _ = middle.command(5, &[how; 2]);
        let _ = middle.set_activated(how % 12, how & 8 == 0);
        now += u64::from(how) * 100;
        for _ in 0..4 {
            let _ = middle.poll(now);
        }
        while middle.next_notice().is_some() {}
    });
    let counters = middle.counters();
    let counted = counters.accepted() + counters.iter().map(|(_, count)| count).sum::<u32>();
    assert_eq!(counted, arrived);
}
