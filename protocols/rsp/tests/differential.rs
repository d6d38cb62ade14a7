//! Both robot's ends, that in Rust and that in C, in a network that loses, doubles, delays, cuts, changes and makes up datagrams, with
//! programs that do anything: they have to do and say the same.

mod common;

use common::both::{harness, text};
use common::{Both, Random, Told, c_end, element};
use mom_rsp::middle::{self, Middle, Notice};
use mom_rsp::robot::{self, Assembly, Outgoing};
use mom_rsp::{Element, FRAGMENT, Fragment, Kind, Layout, Motion, Number, Payload};
use proptest::prelude::*;

/// How much is done in each case. A step is a millisecond or so, with all that is sent and heard in it.
const STEPS: usize = 700;

const fn motion(interpolate: bool, rate: Option<f32>) -> Motion {
    Motion::Absolute { interpolate, rate }
}

const fn effector(name: &'static str, number: Number, count: u16, motion: Motion) -> Element<'static> {
    Element {
        motion,
        ..element(name, Kind::Effector, Payload::Numbers(number, count))
    }
}

const fn of(name: &'static str, kind: Kind, payload: Payload) -> Element<'static> {
    element(name, kind, payload)
}

const SENSOR: Payload = Payload::Numbers(Number::U32, 2);
const MODULE: u8 = 19;

/// Every kind with every motion, in a map of three bytes that is padded.
static LAYOUT: Layout<'static> = Layout::new(
    0xABCD,
    [5; 32],
    &[
        effector("a-f32", Number::F32, 2, motion(true, Some(100.0))),
        effector("b-f32", Number::F32, 1, motion(false, Some(3.5))),
        effector("c-f32", Number::F32, 1, Motion::Incremental { rate: Some(70.0) }),
        effector("d-i8", Number::I8, 1, Motion::Incremental { rate: Some(1000.0) }),
        effector("e-u16", Number::U16, 3, motion(true, Some(20_000.0))),
        Element {
            safe: &[0x12, 0x34, 0x56, 0x78],
            module: Some(MODULE),
            ..effector("f-i32", Number::I32, 1, motion(false, Some(1e9)))
        },
        effector("g-u32", Number::U32, 1, Motion::Incremental { rate: None }),
        Element {
            safe: &[0x7F],
            module: Some(MODULE),
            ..effector("h-u8", Number::U8, 1, motion(true, None))
        },
        Element {
            safe: &[0, 2, 7, 8],
            ..of("i-bytes", Kind::Effector, Payload::Bytes(9))
        },
        of("j-blob", Kind::Effector, Payload::Bytes(0)),
        of("k-sensor", Kind::Sensor, SENSOR),
        Element {
            period: 70,
            ..of("l-sensor", Kind::Sensor, Payload::Bytes(7))
        },
        Element {
            of: Some(7),
            module: Some(MODULE),
            ..of("m-monitor", Kind::Monitor, Payload::Numbers(Number::U8, 1))
        },
        of("n-command", Kind::Command, Payload::Bytes(5)),
        Element {
            module: Some(MODULE),
            ..of("o-memory-command", Kind::MemoryCommand, Payload::Nothing)
        },
        of("p-event", Kind::Event, Payload::Bytes(5)),
        of("q-event", Kind::Event, Payload::Nothing),
        of("r-memory-event", Kind::MemoryEvent, Payload::Bytes(6)),
        of(
            "s-memory-event",
            Kind::MemoryEvent,
            Payload::Numbers(Number::I16, 2),
        ),
        of("t-module", Kind::Module, Payload::Nothing),
        of("u-camera", Kind::Sensor, Payload::Bytes(0)),
    ],
);

const COUNT: usize = 21;
type Ends = Both<'static, COUNT, { robot::values(&LAYOUT) }, 3, { robot::slot(&LAYOUT) }>;

/// Robot, middle, and what is under way between them.
struct Rig {
    random: Random,
    robot: Ends,
    told: Told,
    middle: Middle<'static>,
    /// µs.
    now: u64,
    under_way: Vec<Vec<u8>>,
    heard: Vec<Vec<u8>>,
    up: Vec<Vec<u8>>,
    /// Sessions that began.
    sessions: usize,
}

fn middle(random: &mut Random, key: Option<[u8; 32]>) -> Middle<'static> {
    let settings = middle::Settings {
        key,
        paper: random.percent(15),
        period: 1 + random.below(40) as u16,
        silence: 300,
        ..middle::Settings::default()
    };
    let mut unforeseen = random.clone();
    Middle::new(&LAYOUT, settings, move |bytes: &mut [u8]| unforeseen.fill(bytes)).expect("settings")
}

impl Rig {
    fn new(seed: u64) -> Rig {
        let mut random = Random(seed);
        let key = random.percent(50).then_some([9; 32]);
        let settings = robot::Settings {
            key,
            watchdog: [0, 100, 300][random.below(3) as usize],
            budget: [0, 700, 1000, 2500][random.below(4) as usize],
        };
        let mut middle = middle(&mut random, key);
        // Near where the low 32 bits of µs, or those of ms, wrap.
        let now = [0, 4_294_000_000, 4_294_967_295_000_000][random.below(3) as usize];
        middle.start(now);
        Rig {
            robot: Both::new(&LAYOUT, settings).expect("settings"),
            told: Told::new(seed),
            middle,
            now,
            under_way: Vec::new(),
            heard: Vec::new(),
            up: Vec::new(),
            sessions: 0,
            random,
        }
    }

    fn bytes(&mut self, of: &Element<'_>) -> Vec<u8> {
        let size = match of.payload {
            Payload::Bytes(most) => self.random.below(u64::from(most) + 2) as usize,
            payload => payload.size(),
        };
        let mut bytes = vec![0; size];
        match of.payload {
            // Floats of which none is infinite, also when many of them add up.
            Payload::Numbers(Number::F32, _) => bytes.chunks_exact_mut(4).for_each(|four| {
                let number = self.random.below(20_000) as f32 / 61.0 - 150.0;
                four.copy_from_slice(&number.to_be_bytes());
            }),
            _ => self.random.fill(&mut bytes),
        }
        bytes
    }

    /// The program of the middle does something.
    fn think(&mut self, key: Option<[u8; 32]>) {
        let place = self.random.below(COUNT as u64) as u8;
        let of = LAYOUT.elements()[usize::from(place)];
        let bytes = self.bytes(&of);
        match (self.random.below(300), of.kind) {
            (0..110, Kind::Effector) => drop(self.middle.write(place, &bytes)),
            (0..110, Kind::Command | Kind::MemoryCommand) => drop(self.middle.command(place, &bytes)),
            (0..110, _) => drop(self.middle.ask(place)),
            (110..125, _) => drop(self.middle.set_activated(place, false)),
            (125..150, _) => drop(self.middle.set_activated(place, true)),
            (150..153, _) => drop(self.middle.set_activated(MODULE, self.now.is_multiple_of(2))),
            (153..156, _) => drop(self.middle.set_period(1 + self.random.below(60) as u16)),
            (156..158, _) => drop(self.middle.clear_buffers()),
            (158..163, _) => drop(
                self.middle
                    .send_blob(9, &vec![3; 1 + self.random.below(2000) as usize]),
            ),
            (163, _) => self.middle.end(self.now),
            (164..167, _) => self.middle.start(self.now),
            (167, _) => {
                self.middle = middle(&mut self.random, key);
                self.middle.start(self.now);
            }
            _ => {}
        }
    }

    /// The program of the robot does something.
    fn sense(&mut self) {
        let place = self.random.below(COUNT as u64 + 1) as u8;
        let of = LAYOUT.elements()[usize::from(place) % COUNT];
        let bytes = self.bytes(&of);
        match self.random.below(100) {
            0..25 => drop(self.robot.set(place, &bytes)),
            25..50 => drop(self.robot.raise(place, &bytes)),
            50..53 => {
                let bytes = vec![1; self.random.below(1400) as usize];
                let first = Outgoing {
                    element: 20,
                    blob: place.into(),
                    offset: 0,
                    total: bytes.len() as u32,
                    len: 0,
                };
                self.told.blob = Some((first, bytes));
            }
            53 if self.random.percent(20) => self.robot.end(self.now, &mut self.told),
            _ => {}
        }
    }

    /// A datagram as a bad network, or a bad neighbour, makes it of one.
    fn spoiled(&mut self, mut datagram: Vec<u8>) -> Vec<u8> {
        let place = self.random.below(datagram.len() as u64 + 1) as usize;
        match self.random.below(8) {
            0 => datagram.truncate(place),
            1 => datagram.push(self.random.next() as u8),
            2 | 3 => {
                if let Some(byte) = datagram.get_mut(place) {
                    *byte ^= 1 << self.random.below(8);
                }
            }
            // Of the session, with another sequence, type, number of the newest packet or counter.
            _ if datagram.len() >= 20 => {
                let at = [4, 5, 6, 6, 6, 17, 18, 19][self.random.below(8) as usize];
                datagram[at] = datagram[at]
                    .wrapping_add(self.random.below(5) as u8)
                    .wrapping_sub(1);
                if self.random.percent(30) {
                    datagram.truncate(20);
                    let body = self.random.below(16);
                    datagram.extend((0..body).map(|_| [0, 1, 2, 0x80, 0xFF][self.random.below(5) as usize]));
                }
            }
            _ => {}
        }
        datagram
    }

    /// What reaches the robot now.
    fn arrive(&mut self) {
        let sent = self.under_way.len() as u64;
        for _ in 0..self.random.below(sent + 1) {
            let at = match self.random.percent(80) {
                true => 0,
                false => self.random.below(self.under_way.len() as u64) as usize,
            };
            if self.under_way.is_empty() {
                break;
            }
            let datagram = self.under_way.remove(at);
            if self.random.percent(5) {
                continue;
            }
            self.heard.push(datagram.clone());
            let _ = self
                .robot
                .receive(self.now, &mut datagram.clone(), &mut self.told);
            if self.random.percent(8) {
                self.under_way.push(datagram);
            }
        }
        if !self.heard.is_empty() && self.random.percent(25) {
            let newest = (self.heard.len() as u64).min([3, 200][self.random.below(2) as usize]);
            let at = self.heard.len() - 1 - self.random.below(newest) as usize;
            let again = self.heard[at].clone();
            let mut made = if self.random.percent(80) {
                self.spoiled(again)
            } else {
                again
            };
            let _ = self.robot.receive(self.now, &mut made, &mut self.told);
        }
    }

    fn speak(&mut self) {
        let room = match self.random.percent(3) {
            true => self.random.below(LAYOUT.largest() as u64) as usize,
            false => LAYOUT.largest(),
        };
        let mut out = vec![0; room];
        while let Some(len) = self.robot.poll(self.now, &mut out, &mut self.told) {
            self.up.push(out[..len].to_vec());
        }
        for mut datagram in self.up.drain(..) {
            if !self.random.percent(5) {
                let _ = self.middle.receive(self.now, &mut datagram);
            }
        }
        while let Some(datagram) = self.middle.poll(self.now) {
            self.under_way.push(datagram.to_vec());
        }
        while let Some(notice) = self.middle.next_notice() {
            self.sessions += usize::from(notice == Notice::Up);
        }
    }

    fn step(&mut self, key: Option<[u8; 32]>) {
        self.now += match self.random.below(200) {
            0 => 600_000,
            1..10 => 50_000,
            _ => self.random.below(8_000),
        };
        self.think(key);
        self.sense();
        self.arrive();
        self.speak();
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, max_shrink_iters: 0, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn both_ends_do_and_say_the_same(seed in any::<u64>()) {
        let mut rig = Rig::new(seed);
        let key = Random(seed).percent(50).then_some([9; 32]);
        for _ in 0..STEPS {
            rig.step(key);
        }
        prop_assert!(rig.sessions > 0, "there was a session");
        prop_assert!(rig.told.outputs.len() > 20, "it moved: {}", rig.told.outputs.len());
        println!("{} operations, {} sessions", rig.robot.steps(), rig.sessions);
    }
}

/// Parts of blobs in any order, lost, doubled, of blobs that are too large and of sessions that end.
#[test]
fn blobs_are_put_together_alike() {
    let Some(harness) = harness() else {
        return;
    };
    let mut random = Random(1);
    let mut assembly = Assembly::<1500>::default();
    let (mut input, mut expected) = ("assembly 1500\n".to_owned(), String::new());
    let (mut whole, mut newest, mut total) = (0, 65_500_u16, 1500_u32);
    for _ in 0..5000 {
        if random.percent(1) {
            assembly.clear();
            input.push_str("clear\n");
            expected.push_str(&format!("= {}\n", assembly.dropped()));
            continue;
        }
        // Mostly parts of the newest blob, some of one that is older or has the same number.
        if random.percent(12) {
            newest = newest.wrapping_add(random.below(3) as u16);
            total = [1, 480, 481, 1400, 1500, 1501, 200_000][random.below(7) as usize];
        }
        let blob = newest.wrapping_sub(u16::from(random.percent(10)));
        let offset = 480 * random.below(u64::from(total).div_ceil(480)) as u32;
        let mut bytes = vec![0; (total - offset).min(480) as usize];
        random.fill(&mut bytes);
        let part = Fragment {
            element: 0,
            blob,
            offset,
            total,
            bytes: &bytes,
        };
        let made = assembly.push(&part).map(text);
        whole += usize::from(made.is_some());
        input.push_str(&format!("push {blob} {offset} {total} {}\n", text(&bytes)));
        let made = made.unwrap_or_else(|| "-".to_owned());
        expected.push_str(&format!("= {} {made}\n", assembly.dropped()));
    }
    assert!(whole > 100, "{whole}");
    let did = c_end::run(harness, &input);
    for (number, (did, expected)) in did.lines().zip(expected.lines()).enumerate() {
        assert_eq!(did, expected, "part {number}");
    }
    assert_eq!(did.lines().count(), expected.lines().count());
}

/// A fragment is as long as the library says.
#[test]
fn a_fragment_has_480_bytes() {
    assert_eq!(FRAGMENT, 480);
    let header = include_str!("../../rsp-c/mom_rsp.h");
    assert!(header.contains("#define MOM_RSP_FRAGMENT 480\n"));
}
