//! What both ends do with each kind of element, and with what is measured.

mod common;

use common::*;
use mom_rsp::middle::{Notice, Settings};
use mom_rsp::robot::{Assembly, Body, Outgoing};
use mom_rsp::{FRAGMENT, Fragment, Header, Kind, Layout, Motion, Number, Payload, Refused, Type};
use proptest::prelude::*;

fn of_type(packets: &[Vec<u8>], kind: Type) -> Vec<&Vec<u8>> {
    let of = |packet: &&Vec<u8>| Header::decode(packet).expect("a packet").kind == kind;
    packets.iter().filter(of).collect()
}

#[test]
fn a_value_travels_until_it_is_acknowledged_and_no_longer() {
    let mut world = World::up(Settings::default());
    world.sent_down.clear();
    world.middle.write(LEFT, &[1, 2]).unwrap();
    world.weather.delay = 30;
    world.run(400);
    let with = world.sent_down.iter().filter(|packet| packet.len() > 22).count();
    assert!(
        (4..=6).contains(&with),
        "a round trip of four to six periods, {with}"
    );
    let confirmed = world.middle.confirmed(LEFT).unwrap();
    assert_eq!(confirmed.value, [1, 2]);
    assert!(confirmed.at <= world.now && confirmed.stamp > 5000);
    assert_eq!(
        world.told.outputs,
        [(LEFT, vec![1, 2])],
        "one output, however often it came"
    );
}

#[test]
fn each_value_is_confirmed_though_the_next_is_under_way() {
    let mut world = World::up(Settings::default());
    world.weather.delay = 50;
    for value in 0..20 {
        world.middle.write(LEFT, &[0, value]).unwrap();
        world.run(20);
    }
    let confirmed = world.middle.confirmed(LEFT).unwrap().value[1];
    assert!((10..19).contains(&confirmed), "{confirmed}");
    assert_eq!(world.middle.wanted(LEFT).unwrap(), [0, 19]);
}

#[test]
fn what_cannot_be_is_refused() {
    let mut world = World::up(Settings::default());
    let middle = &mut world.middle;
    assert_eq!(middle.write(16, &[0]), Err(Refused::Element));
    assert_eq!(middle.write(RANGE, &[0, 0, 0, 0]), Err(Refused::Kind));
    assert_eq!(middle.write(LEFT, &[0]), Err(Refused::Size));
    assert_eq!(middle.command(LEFT, &[0]), Err(Refused::Kind));
    assert_eq!(middle.set_period(0), Err(Refused::Period));
    assert_eq!(middle.write(HEAD, &i16::MAX.to_be_bytes()), Ok(()));
    assert_eq!(
        middle.write(HEAD, &[0, 1]),
        Err(Refused::Value),
        "the robot could not tell the sum from its negative"
    );
    let commands: Vec<_> = (0..18).map(|_| middle.command(FIRE, &[0, 0]).is_ok()).collect();
    assert_eq!(
        commands.iter().filter(|taken| **taken).count(),
        17,
        "one under way and 16 that wait"
    );
    assert_eq!(middle.command(FIRE, &[0, 0]), Err(Refused::Full));
    assert_eq!(world.robot.set(LEFT, &[0, 0]), Err(Refused::Kind));
    assert_eq!(world.robot.set(RANGE, &[0, 0]), Err(Refused::Size));
    let raised: Vec<_> = (0..5).map(|_| world.robot.raise(BUTTON, &[0, 0])).collect();
    assert_eq!(raised[4], Err(Refused::Full));
    assert_eq!(robot(None, 500).raise(BUTTON, &[0, 0]), Err(Refused::NoSession));
}

#[test]
fn a_deactivated_module_makes_its_members_safe_and_silent() {
    let mut world = World::up(Settings::default());
    world.middle.write(LEFT, &[0, 9]).unwrap();
    world.run(60);
    world.middle.set_activated(DRIVE, false).unwrap();
    assert!(
        !world.middle.activated(LEFT) && world.middle.active(LEFT),
        "wanted, not confirmed (S7)"
    );
    assert_eq!(world.middle.write(LEFT, &[0, 1]), Err(Refused::Inactive));
    world.run(60);
    assert!(!world.middle.active(LEFT) && !world.robot.is_active(LEFT) && world.middle.active(HEAD));
    assert_eq!(world.told.last(LEFT), Some(&[0, 0][..]));
    let expected = [DRIVE, LEFT, RIGHT].map(|element| (element, false));
    let mut active = world.told.active.clone();
    active.sort_by_key(|(element, _)| [DRIVE, LEFT, RIGHT].iter().position(|of| of == element));
    assert_eq!(active, expected);
    world.middle.set_activated(DRIVE, true).unwrap();
    world.run(60);
    assert!(world.middle.is_confirmed());
    assert_eq!(world.middle.wanted(LEFT), None);
    world.middle.write(LEFT, &[0, 3]).unwrap();
    world.run(60);
    assert_eq!(world.told.last(LEFT), Some(&[0, 3][..]));
    assert_eq!(
        of_type(&world.sent_down, Type::Control).len(),
        2,
        "each confirmed by one answer"
    );
}

#[test]
fn what_is_written_while_an_activation_is_under_way_waits_for_it() {
    let mut world = World::up(Settings::default());
    world.middle.set_activated(DRIVE, false).unwrap();
    world.run(60);
    world.middle.set_activated(DRIVE, true).unwrap();
    assert_eq!(
        world.middle.write(LEFT, &[0, 3]),
        Err(Refused::Inactive),
        "the robot was not told yet"
    );
    world.drop_down = |packet| packet[4] == Type::Control as u8;
    world.run(30);
    world.middle.write(LEFT, &[0, 3]).unwrap();
    world.run(100);
    assert_eq!(world.middle.confirmed(LEFT), None);
    world.drop_down = |_| false;
    world.run(60);
    assert_eq!(world.told.last(LEFT), Some(&[0, 3][..]));
    assert_eq!(world.middle.confirmed(LEFT).unwrap().value, [0, 3]);
}

#[test]
fn steps_that_were_written_before_a_deactivation_are_not_made_after_it() {
    let mut world = World::up(Settings::default());
    world.middle.write(HEAD, &[0, 50]).unwrap();
    world.run(60);
    world.drop_down = |packet| packet[4] == Type::Data as u8;
    world.middle.write(HEAD, &[0, 7]).unwrap();
    world.run(60);
    world.middle.set_activated(HEAD, false).unwrap();
    world.run(30);
    world.middle.set_activated(HEAD, true).unwrap();
    world.drop_down = |_| false;
    world.run(60);
    world.middle.write(HEAD, &[0, 5]).unwrap();
    world.run(60);
    assert_eq!(world.told.sum(HEAD), 55);
}

#[test]
fn a_deactivated_sensor_is_silent_and_tells_its_value_when_it_is_activated() {
    let mut world = World::up(Settings::default());
    world.middle.set_activated(RANGE, false).unwrap();
    world.run(60);
    world.robot.set(RANGE, &[1, 2, 3, 4]).unwrap();
    world.run(60);
    assert_eq!(world.middle.read(RANGE), None);
    assert_eq!(world.middle.ask(RANGE), Err(Refused::Inactive));
    world.middle.set_activated(RANGE, true).unwrap();
    world.run(60);
    assert_eq!(world.middle.read(RANGE).unwrap().value, [1, 2, 3, 4]);
}

#[test]
fn a_sensor_says_its_value_again_when_it_is_asked() {
    let mut world = World::up(Settings::default());
    world.robot.set(RANGE, &[1, 2, 3, 4]).unwrap();
    world.run(100);
    let first = world.middle.read(RANGE).unwrap().at;
    world.weather.loss = 60;
    world.middle.ask(RANGE).unwrap();
    world.run(400);
    assert!(world.middle.read(RANGE).unwrap().at > first);
    assert!(world.notices.contains(&Notice::Changed { element: RANGE }));
}

#[test]
fn a_sensor_with_a_period_begins_a_new_value_only_so_often() {
    let mut world = World::up(Settings::default());
    world.sent_up.clear();
    for value in 0..100 {
        world.robot.set(LIGHT, &[value]).unwrap();
        world.run(10);
    }
    let with = world.sent_up.iter().filter(|packet| packet.len() > 22).count();
    assert!(
        (10..=22).contains(&with),
        "ten a second, each until it is acknowledged: {with}"
    );
}

#[test]
fn the_period_can_be_changed_while_it_runs() {
    let mut world = World::up(Settings::default());
    world.middle.set_period(40).unwrap();
    assert!(!world.middle.is_confirmed());
    world.run(100);
    assert!(world.middle.is_confirmed());
    assert_eq!(world.robot.period(), 40);
    let (down, up) = (world.sent_down.len(), world.sent_up.len());
    world.run(400);
    assert_eq!(
        (world.sent_down.len() - down, world.sent_up.len() - up),
        (10, 10),
        "S10"
    );
}

#[test]
fn commands_of_an_element_go_one_after_another() {
    let mut world = World::up(Settings::default());
    world.weather.delay = 10;
    let tickets: Vec<u32> = (0..5)
        .map(|number| world.middle.command(FIRE, &[0, number]).unwrap())
        .collect();
    world.run(600);
    assert_eq!(world.done(), tickets);
    let executed: Vec<u8> = world.told.executed.iter().map(|(_, data)| data[1]).collect();
    assert_eq!(executed, [0, 1, 2, 3, 4]);
    let Some(Notice::Done { after, .. }) = world.notices.first() else {
        panic!("{:?}", world.notices);
    };
    assert!((20_000..80_000).contains(after), "{after}");
}

#[test]
fn ids_go_round_after_255() {
    let mut world = World::up(Settings::default());
    for number in 0..600_u16 {
        world.middle.command(FIRE, &number.to_be_bytes()).unwrap();
        world.robot.raise(BUTTON, &number.to_be_bytes()).unwrap();
        world.robot.raise(CARD, &number.to_be_bytes()).unwrap();
        world.run(45);
    }
    world.run(200);
    assert_eq!(world.done().len(), 600);
    assert_eq!(world.told.executed.len(), 600);
    let all: Vec<Vec<u8>> = (0..600_u16).map(|number| number.to_be_bytes().to_vec()).collect();
    assert_eq!(world.raised(BUTTON), all);
    assert_eq!(world.raised(CARD), all);
}

#[test]
fn a_memory_command_is_sent_again_only_after_a_while() {
    let mut world = World::up(Settings::default());
    world.drop_up = |_| true;
    world.sent_down.clear();
    world.middle.command(SAY, &[0, 1]).unwrap();
    world.run(300);
    let with = world.sent_down.iter().filter(|packet| packet.len() > 22).count();
    assert_eq!(with, 4, "each 80 ms (S20)");
    world.drop_up = |_| false;
    world.run(100);
    assert_eq!((world.done().len(), world.told.executed.len()), (1, 1));
}

#[test]
fn a_memory_event_is_held_until_it_is_acknowledged_and_can_be_cleared() {
    let mut world = World::up(Settings::default());
    world.robot.raise(CARD, b"one").unwrap();
    world.robot.raise(CARD, b"two").unwrap();
    world.robot.raise(BUMP, b"").unwrap();
    world.drop_up = |packet| packet.len() > 22;
    world.run(100);
    assert_eq!(world.robot.free_buffers(), 1);
    assert_eq!(world.middle.free_buffers(), 1, "S16");
    world.drop_up = |_| false;
    world.run(400);
    assert_eq!(world.raised(CARD), [b"one".to_vec(), b"two".to_vec()]);
    assert_eq!(world.raised(BUMP), [b"".to_vec()]);
    assert_eq!(world.robot.free_buffers(), 4);
    world.drop_up = |packet| packet.len() > 22;
    (0..4).for_each(|_| world.robot.raise(CARD, b"x").unwrap());
    assert_eq!(world.robot.raise(CARD, b"x"), Err(Refused::Full));
    world.middle.clear_buffers().unwrap();
    world.run(60);
    assert_eq!(world.robot.free_buffers(), 4);
}

#[test]
fn a_lost_memory_event_is_asked_for_though_other_events_go_on() {
    let mut world = World::up(Settings::default());
    world.robot.raise(CARD, b"card").unwrap();
    world.drop_up = |packet| packet.len() > 22;
    world.run(20);
    world.drop_up = |_| false;
    for number in 0..10_u16 {
        world.robot.raise(BUTTON, &number.to_be_bytes()).unwrap();
        world.run(20);
    }
    assert_eq!(world.raised(CARD), [b"card".to_vec()]);
}

#[test]
fn a_memory_event_waits_for_a_session() {
    let mut world = World::new(Settings::default(), Weather::default(), 3);
    world.robot.raise(CARD, b"early").unwrap();
    world.middle.start(world.now);
    world.run(100);
    assert_eq!(world.raised(CARD), [b"early".to_vec()]);
}

#[test]
fn blobs_go_in_parts_behind_the_packets_and_never_delay_them() {
    let mut world = World::up(Settings::default());
    let music: Vec<u8> = (0..5000_u32).map(|at| at as u8).collect();
    world.sent_down.clear();
    world.middle.send_blob(SPEAKER, &music).unwrap();
    world.run(200);
    assert_eq!(
        of_type(&world.sent_down, Type::Data).len(),
        10,
        "motion does not wait (S27)"
    );
    assert!(
        world
            .sent_down
            .iter()
            .all(|packet| packet.len() <= 20 + 11 + FRAGMENT)
    );
    let parts = of_type(&world.sent_down, Type::Fragment).len();
    assert_eq!(parts, 11);
    let mut assembly = Assembly::<8192>::default();
    let mut whole = None;
    for (element, blob, offset, bytes) in world.told.fragments.iter().rev() {
        assert_eq!(*element, SPEAKER);
        let part = Fragment {
            element: SPEAKER,
            blob: *blob,
            offset: *offset,
            total: 5000,
            bytes,
        };
        whole = whole.or(assembly.push(&part).map(<[u8]>::to_vec));
    }
    assert_eq!(whole.as_ref(), Some(&music));
    // Another session numbers its blobs anew.
    let part = |blob, byte| Fragment {
        element: SPEAKER,
        blob,
        offset: 0,
        total: 2,
        bytes: if byte == 0 { &[0, 0] } else { &[1, 1] },
    };
    assert_eq!(assembly.push(&part(7, 0)), Some(&[0, 0][..]));
    assert_eq!(assembly.push(&part(0, 1)), None, "it is older");
    assembly.clear();
    assert_eq!(assembly.push(&part(0, 1)), Some(&[1, 1][..]));
}

#[test]
fn sound_does_not_wait_for_a_picture() {
    let mut world = World::up(Settings::default());
    world.middle.send_blob(LCD, &[1; 5000]).expect("it fits");
    world.run(30);
    for block in [2, 3] {
        world.middle.send_blob(SPEAKER, &[block; 900]).expect("it fits");
    }
    world.run(300);
    let parts: Vec<(u8, u8)> = world
        .told
        .fragments
        .iter()
        .map(|(element, _, _, bytes)| (*element, bytes[0]))
        .collect();
    let at = |part: (u8, u8)| parts.iter().rposition(|other| *other == part).expect("it came");
    assert!(at((SPEAKER, 2)) < at((SPEAKER, 3)), "in order: {parts:?}");
    assert!(
        at((SPEAKER, 3)) + 2 < at((LCD, 1)),
        "before the rest of the picture: {parts:?}"
    );
    assert_eq!(parts.len(), 11 + 2 + 2);
}

#[test]
fn blobs_of_the_robot_are_put_together_and_incomplete_ones_counted() {
    let mut world = World::up(Settings::default());
    let picture: Vec<u8> = (0..3000_u32).map(|at| (at / 7) as u8).collect();
    let send = |world: &mut World, blob| {
        let first = Outgoing {
            element: CAMERA,
            blob,
            offset: 0,
            total: 3000,
            len: 0,
        };
        world.told.blob = Some((first, picture.clone()));
        world.run(150);
    };
    world.weather.jitter = 30;
    send(&mut world, 0);
    world.drop_up = |packet| packet[4] == Type::UpFragment as u8 && packet[25] == 0x03;
    send(&mut world, 1);
    world.drop_up = |_| false;
    send(&mut world, 2);
    let blobs: Vec<_> = world
        .notices
        .iter()
        .filter(|notice| matches!(notice, Notice::Blob { .. }))
        .collect();
    let whole = |blob| Notice::Blob {
        element: CAMERA,
        blob,
        bytes: picture.clone(),
    };
    assert!(blobs == [&whole(0), &whole(2)], "{}", blobs.len());
    assert_eq!(world.middle.lost_blobs(), 1);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    /// The truth lies within the error that is told, whatever the delays of both directions.
    #[test]
    fn the_clock_of_the_robot_is_known_within_its_error(
        ahead in 0..100_000_000_u64, delay in 0..100_u64, jitter in 0..100_u64, loss in 0..30_u64, seed in any::<u64>()
    ) {
        let mut world = World::new(Settings::default(), Weather { loss, twice: 0, delay, jitter }, seed);
        world.ahead = ahead;
        world.middle.start(world.now);
        world.run(3000);
        if let Some(clock) = world.middle.clock(world.now) {
            prop_assert!((clock.offset - ahead as i64).unsigned_abs() <= clock.error, "{clock:?}");
            let round = world.middle.round_trip().unwrap();
            prop_assert!(round >= 2000 * delay, "{round}");
            prop_assert!(clock.error >= 1000 + 1000 * delay);
        }
    }
}

#[test]
fn loss_is_counted_by_sequence() {
    let mut world = World::up(Settings::default());
    assert_eq!(world.middle.loss(), 0.0);
    world.weather.loss = 25;
    world.run(5000);
    assert!(
        (0.15..0.35).contains(&world.middle.loss()),
        "{}",
        world.middle.loss()
    );
}

/// One output of an effector: when it came, how long after the last packet, and its value; in ms.
#[derive(Debug)]
struct Output {
    at: u64,
    waited: u64,
    value: i16,
}

/// Remembers the outputs of one effector.
#[derive(Default)]
struct Outputs {
    now: u64,
    arrived: u64,
    all: Vec<Output>,
}

impl Body for Outputs {
    fn random(&mut self, bytes: &mut [u8]) {
        bytes.fill(1);
    }

    fn effector(&mut self, _: u8, value: &[u8]) {
        self.all.push(Output {
            at: self.now,
            waited: self.now - self.arrived,
            value: i16::from_be_bytes([value[0], value[1]]),
        });
    }

    fn command(&mut self, _: u8, _: &[u8]) {}
}

/// What a motion filter puts out of values that are written at these ms. Packets leave each 20 ms and take as long as `late` says of
/// the ms of their sending, or are lost.
fn put_out(
    motion: Motion,
    values: &[(u64, i16)],
    paper: bool,
    late: impl Fn(u64) -> Option<u64>,
) -> Vec<Output> {
    let elements = [mom_rsp::Element {
        motion,
        ..element("motor", Kind::Effector, Payload::Numbers(Number::I16, 1))
    }];
    let layout = Layout::new(1, [0; 32], &elements);
    let mut robot = Both::<1, 6, 0, 0>::new(&layout, Default::default()).expect("it fits");
    let settings = Settings {
        paper,
        ..Settings::default()
    };
    let mut middle =
        mom_rsp::middle::Middle::new(&layout, settings, |bytes: &mut [u8]| bytes.fill(2)).expect("it fits");
    let mut outputs = Outputs::default();
    middle.start(0);
    let mut values = values.iter().peekable();
    let mut under_way = Vec::new();
    let mut out = [0; 600];
    for ms in 0..400 {
        let now = ms * 1000;
        outputs.now = ms;
        while let Some((_, value)) = values.next_if(|(at, _)| *at == ms) {
            middle.write(0, &value.to_be_bytes()).expect("it fits");
        }
        while let Some(packet) = middle.poll(now).map(<[u8]>::to_vec) {
            if let Some(late) = late(ms) {
                under_way.push((ms + late, packet));
            }
        }
        for (_, mut packet) in under_way.extract_if(.., |(at, _)| *at <= ms) {
            outputs.arrived = ms;
            let _ = robot.receive(now, &mut packet, &mut outputs);
        }
        while let Some(len) = robot.poll(now, &mut out, &mut outputs) {
            let _ = middle.receive(now, &mut out[..len]);
        }
    }
    outputs.all
}

/// What a motion filter puts out of values that are written at these ms.
fn filtered(motion: Motion, values: &[(u64, i16)], paper: bool) -> Vec<i16> {
    let outputs = put_out(motion, values, paper, |_| Some(0));
    outputs.into_iter().map(|output| output.value).collect()
}

#[test]
fn the_motion_filter_follows_its_settings() {
    let absolute = |interpolate, rate| Motion::Absolute { interpolate, rate };
    assert_eq!(
        filtered(absolute(false, None), &[(30, 100), (31, 200), (90, 300)], false),
        [200, 300],
        "the newest wins, else hold"
    );
    let limited = filtered(absolute(false, Some(2000.0)), &[(30, 100)], false);
    assert_eq!(
        limited,
        [40, 86, 100],
        "2000 a second are 40 in 20 ms, and 46 in 23"
    );
    let slow = filtered(absolute(false, Some(25.0)), &[(30, 4)], false);
    assert_eq!(slow, [1, 2, 3, 4], "less than one unit in a period adds up");
    let between = filtered(absolute(true, None), &[(30, 100)], false);
    assert_eq!(between.last(), Some(&100));
    assert!(
        between.len() == 2 && (0..100).contains(&between[0]) || between == [0, 100] || between == [100],
        "{between:?}"
    );
    let steps = Motion::Incremental { rate: Some(500.0) };
    assert_eq!(
        filtered(steps, &[(30, 25), (31, 5), (32, -2)], false),
        [10, 11, 7],
        "the sum, limited (S12)"
    );
    assert_eq!(
        filtered(steps, &[(30, 25), (31, 5), (90, -40)], true)
            .iter()
            .sum::<i16>(),
        -10,
        "raw increments add up too"
    );
}

#[test]
fn an_output_follows_the_packet_that_brought_it() {
    let absolute = Motion::Absolute {
        interpolate: false,
        rate: None,
    };
    let values: Vec<_> = (1..20).map(|turn| (20 * turn, turn as i16)).collect();
    let waited = |late: fn(u64) -> Option<u64>| -> Vec<u64> {
        let outputs = put_out(absolute, &values, false, late);
        let is_apart = outputs.windows(2).all(|two| two[1].at - two[0].at >= 17);
        assert!(is_apart, "two within 7/8 of T: {outputs:?}");
        outputs.iter().map(|output| output.waited).collect()
    };
    assert_eq!(waited(|_| Some(0)), [0; 19]);
    assert_eq!(waited(|_| Some(7)), [0; 19]);
    // Two ms of jitter are less than an eighth of T, to either side.
    assert_eq!(waited(|ms| Some(5 + ms / 20 % 3)), [0; 19]);
    // Where one is lost, the next one does not wait.
    assert_eq!(waited(|ms| (ms % 100 != 0 || ms == 0).then_some(0)), [0; 16]);
    // What comes in the wake of a late one waits for its turn, each less than the one before.
    let waited = waited(|ms| Some(if ms == 200 { 12 } else { 0 }));
    assert_eq!(waited[9..], [0, 10, 8, 6, 4, 2, 0, 0, 0, 0]);
}
