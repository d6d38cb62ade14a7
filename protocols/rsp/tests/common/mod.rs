//! A model, both ends of it, and a seeded network between them in virtual time.
#![allow(dead_code, unreachable_pub, reason = "each test program uses some of it")]

pub mod both;
pub mod c_end;

use std::collections::VecDeque;

use mom_rsp::middle::{self, Middle, Notice, State};
use mom_rsp::robot::{self, Body, Outgoing, Robot};
use mom_rsp::{Element, Fragment, Kind, Layout, Motion, Number, Payload};

pub use both::Both;

pub const KEY: [u8; 32] = [7; 32];

const ABSOLUTE: Motion = Motion::Absolute {
    interpolate: false,
    rate: None,
};

pub const fn element(name: &'static str, kind: Kind, payload: Payload) -> Element<'static> {
    let safe: &[u8] = match (kind, payload) {
        (Kind::Effector, Payload::Bytes(_)) => &[0, 0],
        (Kind::Effector, _) => [0; 16].split_at(payload.size()).0,
        _ => &[],
    };
    Element {
        name,
        kind,
        payload,
        motion: ABSOLUTE,
        safe,
        period: 0,
        module: None,
        of: None,
        digest: 1,
    }
}

const SPEED: Payload = Payload::Numbers(Number::I16, 1);
const BYTE: Payload = Payload::Numbers(Number::U8, 1);

pub const LEFT: u8 = 0;
pub const RIGHT: u8 = 1;
pub const HEAD: u8 = 2;
pub const ARM: u8 = 3;
pub const LCD: u8 = 4;
pub const SPEAKER: u8 = 5;
pub const RANGE: u8 = 6;
pub const CAMERA: u8 = 7;
pub const WHEEL: u8 = 8;
pub const FIRE: u8 = 9;
pub const SAY: u8 = 10;
pub const BUTTON: u8 = 11;
pub const CARD: u8 = 12;
pub const DRIVE: u8 = 13;
pub const LIGHT: u8 = 14;
pub const BUMP: u8 = 15;

/// A robot like the paper's CUBO (S25), of 16 elements.
pub static CUBO: Layout<'static> = Layout::new(
    0x0102,
    [9; 32],
    &[
        Element {
            module: Some(DRIVE),
            ..element("left", Kind::Effector, SPEED)
        },
        Element {
            module: Some(DRIVE),
            ..element("right", Kind::Effector, SPEED)
        },
        Element {
            motion: Motion::Incremental { rate: None },
            ..element("head", Kind::Effector, SPEED)
        },
        Element {
            motion: Motion::Absolute {
                interpolate: true,
                rate: Some(2000.0),
            },
            ..element("arm", Kind::Effector, SPEED)
        },
        element("lcd", Kind::Effector, Payload::Bytes(32)),
        element("speaker", Kind::Effector, BYTE),
        element("range", Kind::Sensor, Payload::Numbers(Number::U16, 2)),
        element("camera", Kind::Sensor, Payload::Bytes(16)),
        Element {
            of: Some(LEFT),
            ..element("left-now", Kind::Monitor, SPEED)
        },
        element("fire", Kind::Command, Payload::Numbers(Number::U16, 1)),
        element("say", Kind::MemoryCommand, Payload::Numbers(Number::U16, 1)),
        element("button", Kind::Event, Payload::Numbers(Number::U16, 1)),
        element("card", Kind::MemoryEvent, Payload::Bytes(24)),
        element("drive", Kind::Module, Payload::Nothing),
        Element {
            period: 100,
            ..element("light", Kind::Sensor, BYTE)
        },
        element("bump", Kind::MemoryEvent, Payload::Nothing),
    ],
);

/// Its end in Rust alone.
pub type RustCubo = Robot<'static, 16, { robot::values(&CUBO) }, 4, { robot::slot(&CUBO) }>;
/// Its end in Rust; what is done with it is done with the end in C too.
pub type Cubo = Both<'static, 16, { robot::values(&CUBO) }, 4, { robot::slot(&CUBO) }>;

/// Numbers that are the same for the same seed.
#[derive(Clone, Debug)]
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end.max(1)
    }

    pub fn percent(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }

    pub fn fill(&mut self, bytes: &mut [u8]) {
        bytes.iter_mut().for_each(|byte| *byte = self.next() as u8);
    }
}

/// A robot's program that remembers what it was told.
pub struct Told {
    pub random: Random,
    pub outputs: Vec<(u8, Vec<u8>)>,
    pub executed: Vec<(u8, Vec<u8>)>,
    pub fragments: Vec<(u8, u16, u32, Vec<u8>)>,
    pub active: Vec<(u8, bool)>,
    pub sessions: Vec<bool>,
    pub unknown: Vec<u8>,
    /// Blob that is sent, and how far.
    pub blob: Option<(Outgoing, Vec<u8>)>,
}

impl Told {
    pub fn new(seed: u64) -> Told {
        Told {
            random: Random(seed),
            outputs: Vec::new(),
            executed: Vec::new(),
            fragments: Vec::new(),
            active: Vec::new(),
            sessions: Vec::new(),
            unknown: Vec::new(),
            blob: None,
        }
    }

    pub fn last(&self, element: u8) -> Option<&[u8]> {
        let outputs = self.outputs.iter().rev();
        outputs
            .into_iter()
            .find(|(of, _)| *of == element)
            .map(|(_, value)| value.as_slice())
    }

    /// The sum of the steps of an incremental effector of one i16.
    pub fn sum(&self, element: u8) -> i64 {
        let steps = self.outputs.iter().filter(|(of, _)| *of == element);
        steps
            .map(|(_, value)| i64::from(i16::from_be_bytes([value[0], value[1]])))
            .sum()
    }
}

impl Body for Told {
    fn random(&mut self, bytes: &mut [u8]) {
        self.random.fill(bytes);
    }

    fn effector(&mut self, element: u8, value: &[u8]) {
        self.outputs.push((element, value.to_vec()));
    }

    fn command(&mut self, element: u8, data: &[u8]) {
        self.executed.push((element, data.to_vec()));
    }

    fn fragment(&mut self, fragment: Fragment<'_>) {
        let bytes = fragment.bytes.to_vec();
        self.fragments
            .push((fragment.element, fragment.blob, fragment.offset, bytes));
    }

    fn next_fragment(&mut self, into: &mut [u8]) -> Option<Outgoing> {
        let (next, bytes) = self.blob.as_mut()?;
        let rest = bytes
            .get(next.offset as usize..)
            .filter(|rest| !rest.is_empty())?;
        let len = rest.len().min(into.len());
        into[..len].copy_from_slice(&rest[..len]);
        let part = Outgoing {
            len: len as u16,
            ..*next
        };
        next.offset += len as u32;
        Some(part)
    }

    fn active(&mut self, element: u8, active: bool) {
        self.active.push((element, active));
    }

    fn session(&mut self, up: bool) {
        self.sessions.push(up);
    }

    fn unknown(&mut self, element: u8) {
        self.unknown.push(element);
    }
}

/// What a network does to each datagram.
#[derive(Clone, Copy, Debug, Default)]
pub struct Weather {
    /// Percent that are lost, and that arrive twice.
    pub loss: u64,
    pub twice: u64,
    /// The least delay, and how much it varies, ms: so datagrams overtake each other.
    pub delay: u64,
    pub jitter: u64,
}

pub struct World {
    pub now: u64,
    pub robot: Cubo,
    pub told: Told,
    pub middle: Middle<'static>,
    pub notices: Vec<Notice>,
    pub weather: Weather,
    pub random: Random,
    /// Arrival, datagram; to the robot, and to the middle.
    pub down: VecDeque<(u64, Vec<u8>)>,
    pub up: VecDeque<(u64, Vec<u8>)>,
    /// All that was sent.
    pub sent_down: Vec<Vec<u8>>,
    pub sent_up: Vec<Vec<u8>>,
    /// The robot's clock is so far ahead, µs.
    pub ahead: u64,
    pub drop_up: fn(&[u8]) -> bool,
    pub drop_down: fn(&[u8]) -> bool,
}

pub fn robot(key: Option<[u8; 32]>, watchdog: u16) -> Cubo {
    Both::new(&CUBO, robot_settings(key, watchdog)).expect("the model fits")
}

pub fn robot_settings(key: Option<[u8; 32]>, watchdog: u16) -> robot::Settings {
    robot::Settings {
        key,
        watchdog,
        ..robot::Settings::default()
    }
}

pub fn middle(settings: middle::Settings, seed: u64) -> Middle<'static> {
    let mut random = Random(seed ^ 0xABCD);
    Middle::new(&CUBO, settings, move |bytes: &mut [u8]| random.fill(bytes)).expect("the model fits")
}

impl World {
    pub fn new(settings: middle::Settings, weather: Weather, seed: u64) -> World {
        World {
            now: 1_000_000,
            robot: robot(settings.key, settings.silence),
            told: Told::new(seed),
            middle: middle(settings, seed),
            notices: Vec::new(),
            weather,
            random: Random(seed),
            down: VecDeque::new(),
            up: VecDeque::new(),
            sent_down: Vec::new(),
            sent_up: Vec::new(),
            ahead: 5_000_000,
            drop_up: |_| false,
            drop_down: |_| false,
        }
    }

    /// A world in good weather that has a session.
    pub fn up(settings: middle::Settings) -> World {
        let mut world = World::new(settings, Weather::default(), 1);
        world.middle.start(world.now);
        world.run(50);
        assert_eq!(world.middle.state(), State::Up);
        assert!(world.robot.is_up());
        world.notices.clear();
        world
    }

    fn arrivals(&mut self, datagram: &[u8], lost: bool) -> Vec<(u64, Vec<u8>)> {
        if lost || self.random.percent(self.weather.loss) {
            return Vec::new();
        }
        let copies = 1 + usize::from(self.random.percent(self.weather.twice));
        let arrival = |random: &mut Random| {
            self.now + 1000 * (self.weather.delay + random.below(self.weather.jitter + 1))
        };
        (0..copies)
            .map(|_| (arrival(&mut self.random), datagram.to_vec()))
            .collect()
    }

    /// So many ms pass.
    pub fn run(&mut self, ms: u64) {
        for _ in 0..ms {
            self.step();
        }
    }

    pub fn step(&mut self) {
        self.now += 1000;
        let theirs = self.now + self.ahead;
        let due = |queue: &mut VecDeque<(u64, Vec<u8>)>, now: u64| {
            let (due, later): (VecDeque<_>, VecDeque<_>) = queue.drain(..).partition(|(at, _)| *at <= now);
            *queue = later;
            let mut due: Vec<(u64, Vec<u8>)> = due.into();
            due.sort_by_key(|(at, _)| *at);
            due
        };
        for (_, mut datagram) in due(&mut self.down, self.now) {
            let _ = self.robot.receive(theirs, &mut datagram, &mut self.told);
        }
        for (_, mut datagram) in due(&mut self.up, self.now) {
            let _ = self.middle.receive(self.now, &mut datagram);
        }
        let mut out = [0; 2048];
        while let Some(len) = self.robot.poll(theirs, &mut out, &mut self.told) {
            self.sent_up.push(out[..len].to_vec());
            let arrivals = self.arrivals(&out[..len], (self.drop_up)(&out[..len]));
            self.up.extend(arrivals);
        }
        while let Some(datagram) = self.middle.poll(self.now).map(<[u8]>::to_vec) {
            let arrivals = self.arrivals(&datagram, (self.drop_down)(&datagram));
            self.sent_down.push(datagram);
            self.down.extend(arrivals);
        }
        while let Some(notice) = self.middle.next_notice() {
            self.notices.push(notice);
        }
    }

    /// The weather clears, and all that is under way arrives.
    pub fn calm(&mut self, ms: u64) {
        self.weather = Weather::default();
        self.run(ms);
    }

    pub fn done(&self) -> Vec<u32> {
        let done = self.notices.iter().filter_map(|notice| match notice {
            Notice::Done { ticket, .. } => Some(*ticket),
            _ => None,
        });
        done.collect()
    }

    pub fn raised(&self, element: u8) -> Vec<Vec<u8>> {
        let raised = self.notices.iter().filter_map(|notice| match notice {
            Notice::Raised {
                element: of, data, ..
            } if *of == element => Some(data.clone()),
            _ => None,
        });
        raised.collect()
    }
}
