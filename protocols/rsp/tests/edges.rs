//! What a random network seldom finds: both robot's ends at the edges of windows, ids, clocks, numbers and sizes, by packets in the
//! open that are written here.

mod common;

use common::{Both, Told, element};
use mom_rsp::robot::{self, Settings};
use mom_rsp::{Dropped, Element, Header, Kind, Layout, Motion, Number, Payload, Type};

const SPEED: Payload = Payload::Numbers(Number::I16, 1);

static LAYOUT: Layout<'static> = Layout::new(
    3,
    [8; 32],
    &[
        element("motor", Kind::Effector, SPEED),
        element("force", Kind::Effector, Payload::Numbers(Number::F32, 2)),
        Element {
            motion: Motion::Absolute {
                interpolate: true,
                rate: None,
            },
            ..element("arm", Kind::Effector, SPEED)
        },
        Element {
            motion: Motion::Incremental { rate: None },
            ..element("way", Kind::Effector, Payload::Numbers(Number::F32, 1))
        },
        element("fire", Kind::Command, Payload::Nothing),
        Element {
            period: 70,
            ..element("light", Kind::Sensor, SPEED)
        },
        element("go", Kind::MemoryCommand, Payload::Nothing),
        element("lamp", Kind::Effector, Payload::Bytes(3)),
    ],
);

const MOTOR: u8 = 0;
const FORCE: u8 = 1;
const ARM: u8 = 2;
const WAY: u8 = 3;
const FIRE: u8 = 4;
const LIGHT: u8 = 5;
const LAMP: u8 = 7;

type Ends = Both<'static, 8, { robot::values(&LAYOUT) }, 1, { robot::slot(&LAYOUT) }>;

/// A robot, and a middle that says what a test wants it to say.
struct Stage {
    robot: Ends,
    told: Told,
    now: u64,
    session: [u8; 6],
    sequence: u16,
}

impl Stage {
    /// A session that begins at this time, with its first packet heard.
    fn at(now: u64) -> Stage {
        let settings = Settings {
            watchdog: 0,
            ..Settings::default()
        };
        let mut stage = Stage {
            robot: Both::new(&LAYOUT, settings).expect("it fits"),
            told: Told::new(1),
            now,
            session: [0; 6],
            sequence: 0,
        };
        stage.session = stage.ask(1).expect("a welcome");
        assert_eq!(stage.data(0, &[]), Ok(()));
        stage
    }

    fn packet(&self, kind: Type, sequence: u16, body: &[u8]) -> Vec<u8> {
        let header = Header {
            version: 1,
            model: LAYOUT.id(),
            encryption: 0,
            kind,
            sequence,
            stamp: 0,
            session: self.session,
            last: 0xFFFF,
            buffers: 0,
        };
        [&header.encode()[..], body].concat()
    }

    /// A hello with this nonce; the session of the welcome.
    fn ask(&mut self, nonce: u8) -> Option<[u8; 6]> {
        let body = [&[nonce; 16], &LAYOUT.hash()[..], &[0, 20, 0]].concat();
        let mut hello = self.packet(Type::Hello, 0, &body);
        hello[11..17].fill(0);
        let _ = self.robot.receive(self.now, &mut hello, &mut self.told);
        let said = self.poll();
        let welcome = said.iter().find(|packet| packet[4] == Type::Welcome as u8)?;
        welcome[11..17].try_into().ok()
    }

    fn say(&mut self, kind: Type, sequence: u16, body: &[u8]) -> Result<(), Dropped> {
        let mut packet = self.packet(kind, sequence, body);
        self.robot.receive(self.now, &mut packet, &mut self.told)
    }

    /// A data packet with these elements and what stands behind the map of each.
    fn data(&mut self, sequence: u16, items: &[(u8, &[u8])]) -> Result<(), Dropped> {
        let mut body = vec![items.iter().map(|(place, _)| 0x80 >> place).sum::<u8>()];
        items.iter().for_each(|(_, bytes)| body.extend(*bytes));
        self.say(Type::Data, sequence, &body)
    }

    fn next(&mut self, items: &[(u8, &[u8])]) -> Result<(), Dropped> {
        self.sequence += 1;
        self.data(self.sequence, items)
    }

    /// The middle has heard the robot's packet with this sequence.
    fn acknowledge(&mut self, last: u8) {
        self.sequence += 1;
        let mut packet = self.packet(Type::Data, self.sequence, &[0]);
        packet[17..19].copy_from_slice(&[0, last]);
        let heard = self.robot.receive(self.now, &mut packet, &mut self.told);
        assert_eq!(heard, Ok(()));
    }

    fn control(&mut self, number: u8, period: u8, map: u8) {
        self.sequence += 1;
        let said = self.say(Type::Control, self.sequence, &[number, 0, period, map]);
        assert_eq!(said, Ok(()));
    }

    fn poll(&mut self) -> Vec<Vec<u8>> {
        let mut out = vec![0; LAYOUT.largest()];
        let mut said = Vec::new();
        while let Some(len) = self.robot.poll(self.now, &mut out, &mut self.told) {
            said.push(out[..len].to_vec());
        }
        said
    }

    fn pass(&mut self, ms: u64) -> Vec<Vec<u8>> {
        self.now += 1000 * ms;
        self.poll()
    }
}

#[test]
fn the_window_knows_the_newest_128() {
    for ahead in [1, 2, 63, 64, 65, 100, 126, 127, 128, 129, 1000, 0x7FFF] {
        let mut stage = Stage::at(5_000_000);
        assert_eq!(stage.data(1, &[]), Ok(()));
        assert_eq!(stage.data(1 + ahead, &[]), Ok(()));
        for back in 0..140 {
            let sequence = (1 + ahead).wrapping_sub(back);
            let outcome = stage.data(sequence, &[]);
            let is_heard = [0, 1, 1 + ahead].contains(&sequence);
            // A session begins near 0: what would be before it is old.
            let expected = match back {
                _ if back > 1 + ahead || back >= 128 => Err(Dropped::Old),
                _ if is_heard => Err(Dropped::Replayed),
                _ => Ok(()),
            };
            assert_eq!(outcome, expected, "{ahead} {back}");
        }
    }
    // 2^15 ahead is behind.
    let mut stage = Stage::at(5_000_000);
    assert_eq!(stage.data(0x8000, &[]), Err(Dropped::Old));
}

#[test]
fn ids_are_new_to_127_ahead() {
    for first in [1, 10, 200, 255_u8] {
        let mut stage = Stage::at(5_000_000);
        for ahead in 0..255_u16 {
            // A deactivation forgets the ids of before.
            stage.control(2 * (ahead as u8 & 1), 20, !(0x80 >> FIRE));
            stage.control(2 * (ahead as u8 & 1) + 1, 20, 0xFF);
            let before = stage.told.executed.len();
            assert_eq!(stage.next(&[(FIRE, &[first])]), Ok(()));
            let id = ((u16::from(first) - 1 + ahead) % 255 + 1) as u8;
            stage.pass(30);
            assert_eq!(stage.next(&[(FIRE, &[id])]), Ok(()));
            let executed = 1 + usize::from((1..=127).contains(&ahead));
            assert_eq!(stage.told.executed.len() - before, executed, "{first} {id}");
            stage.pass(30);
        }
    }
}

#[test]
fn numbers_that_are_none_move_nothing() {
    let mut stage = Stage::at(5_000_000);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let value = [1_f32.to_be_bytes(), bad.to_be_bytes()].concat();
        assert_eq!(
            stage.next(&[(MOTOR, &[0, 9]), (FORCE, &value)]),
            Err(Dropped::Payload)
        );
        stage.pass(20);
    }
    assert!(stage.told.outputs.is_empty());
    let greatest = [f32::MAX.to_be_bytes(), f32::MIN.to_be_bytes()].concat();
    assert_eq!(stage.next(&[(FORCE, &greatest)]), Ok(()));
    stage.pass(20);
    assert_eq!(stage.told.last(FORCE), Some(&greatest[..]));
}

/// Steps of a float end exactly at the total, whatever was rounded on the way, also from the greatest to the least.
#[test]
fn steps_of_a_float_end_at_their_total() {
    let mut stage = Stage::at(5_000_000);
    for total in [0.1_f32, 0.3, 1.0e10, 0.7, -1.0e-3, f32::MAX, f32::MIN, 0.0, 0.1] {
        assert_eq!(stage.next(&[(WAY, &total.to_be_bytes())]), Ok(()));
        stage.pass(23);
        stage.pass(23);
    }
}

#[test]
fn a_way_that_has_ended_ends_there_though_the_period_is_another() {
    let mut stage = Stage::at(5_000_000);
    assert_eq!(stage.next(&[(ARM, &[0, 100])]), Ok(()));
    for _ in 0..5 {
        stage.pass(23);
    }
    assert_eq!(stage.told.last(ARM), Some(&[0, 100][..]));
    stage.control(1, 200, 0xFF);
    stage.pass(1);
    let before = stage.told.outputs.len();
    assert_eq!(stage.next(&[(ARM, &[0, 200])]), Ok(()));
    for _ in 0..400 {
        stage.pass(1);
    }
    let values: Vec<u8> = stage.told.outputs[before..]
        .iter()
        .map(|(_, value)| value[1])
        .collect();
    assert!(
        values.len() > 1 && values.is_sorted() && values.last() == Some(&200),
        "{values:?}"
    );
}

#[test]
fn a_sensor_keeps_its_period_from_the_first_microsecond() {
    for now in [0, 1, 1 << 32, (1 << 32) - 70_000] {
        let mut stage = Stage::at(now);
        stage.robot.set(LIGHT, &[0, 1]).expect("a sensor");
        stage.poll();
        // It is acknowledged, and a new value waits for its time.
        stage.acknowledge(0);
        let said = (1..=4).map(|value| {
            stage.robot.set(LIGHT, &[0, value]).expect("a sensor");
            stage.pass(20).iter().any(|packet| packet.len() > 21)
        });
        assert_eq!(said.collect::<Vec<_>>(), [false, false, false, true], "{now}");
    }
}

#[test]
fn what_was_asked_before_a_deactivation_is_not_told_after_it() {
    let mut stage = Stage::at(5_000_000);
    stage.robot.set(LIGHT, &[0, 1]).expect("a sensor");
    stage.pass(20);
    // It is said again only when it is asked for.
    stage.acknowledge(0);
    assert_eq!(stage.next(&[(LIGHT, &[])]), Ok(()));
    stage.control(1, 20, 0b1111_1011);
    stage.control(2, 20, 0xFF);
    for _ in 0..10 {
        stage.pass(20);
    }
}

/// Another session begins before the end of the first was answered: it is not ended by that answer.
#[test]
fn an_end_that_was_not_answered_is_not_said_in_the_next_session() {
    let mut stage = Stage::at(5_000_000);
    stage.pass(600);
    // Nobody has been heard for so long, and there is no watchdog.
    let next = stage.ask(2).expect("another welcome");
    assert_eq!(stage.say(Type::End, 1, &[]), Ok(()));
    stage.session = next;
    assert_eq!(stage.data(0, &[(LAMP, &[0, 1, 9])]), Ok(()));
    let said = stage.poll();
    assert!(
        said.iter().all(|packet| packet[4] == Type::UpData as u8),
        "{said:?}"
    );
    assert_eq!(stage.told.sessions, [true, false, true]);
}

/// As many names as fit are told to a middle of another model.
#[test]
fn a_refusal_has_1200_bytes_at_most() {
    let names: Vec<String> = (0..100)
        .map(|number| format!("sensor-{}-{number}", "x".repeat(number % 40)))
        .collect();
    let elements: Vec<Element<'_>> = names
        .iter()
        .map(|name| Element {
            name: name.clone().leak(),
            ..element("x", Kind::Sensor, SPEED)
        })
        .collect();
    let layout = Layout::new(3, [9; 32], &elements);
    for (key, room) in [
        (None, 2000),
        (None, 1200),
        (None, 700),
        (None, 85),
        (None, 84),
        (Some([1; 32]), 1300),
    ] {
        let settings = Settings {
            key,
            ..Settings::default()
        };
        let mut robot: Both<'_, 100, 200, 0, 0> = Both::new(&layout, settings).expect("it fits");
        let mut told = Told::new(1);
        let other = middle(key);
        let mut hello = other.clone();
        let refused = robot.receive(0, &mut hello, &mut told);
        assert_eq!(refused, Err(Dropped::Model));
        let len = robot.poll(0, &mut vec![0; room], &mut told);
        assert!(len.is_none_or(|len| len <= room.min(1200)), "{len:?}");
        assert_eq!(len.is_some(), room >= 85, "{room}");
    }
}

/// A hello for another model.
fn middle(key: Option<[u8; 32]>) -> Vec<u8> {
    let settings = mom_rsp::middle::Settings {
        key,
        ..Default::default()
    };
    let mut middle =
        mom_rsp::middle::Middle::new(&LAYOUT, settings, |bytes: &mut [u8]| bytes.fill(2)).expect("settings");
    middle.start(0);
    middle.poll(0).expect("a hello").to_vec()
}
