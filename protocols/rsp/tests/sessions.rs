//! How sessions begin, are refused, are lost and end; keys, replays and silence.

mod common;

use common::*;
use mom_rsp::middle::{Notice, Reason, Refusal, Settings, State};
use mom_rsp::{Dropped, Element, Header, Layout, Refused, Type};

fn keyed() -> Settings {
    Settings {
        key: Some(KEY),
        ..Settings::default()
    }
}

fn kind(packet: &[u8]) -> Type {
    Header::decode(packet).expect("a packet").kind
}

#[test]
fn a_packet_of_16_elements_without_news_is_header_and_map() {
    let mut world = World::up(Settings::default());
    world.sent_down.clear();
    world.run(100);
    assert_eq!(world.sent_down.len(), 5, "one each 20 ms (S9)");
    assert!(world.sent_down.iter().all(|packet| packet.len() == 22));
    assert_eq!(world.told.sessions, [true]);
}

#[test]
fn sealed_packets_show_nothing_and_bear_no_change() {
    let mut world = World::up(keyed());
    world.middle.write(LCD, b"secret words").unwrap();
    world.run(100);
    assert_eq!(world.told.last(LCD), Some(&b"secret words"[..]));
    let find = |packet: &Vec<u8>| packet.windows(6).any(|bytes| bytes == b"secret");
    assert!(!world.sent_down.iter().any(find));
    let mut changed = world.sent_down.last().unwrap().clone();
    *changed.last_mut().unwrap() ^= 1;
    changed[6] = changed[6].wrapping_add(1);
    let theirs = world.now + world.ahead;
    assert_eq!(
        world.robot.receive(theirs, &mut changed, &mut world.told),
        Err(Dropped::Sealed)
    );
    changed[3] = 0;
    assert_eq!(
        world.robot.receive(theirs, &mut changed, &mut world.told),
        Err(Dropped::Encryption)
    );
}

#[test]
fn a_robot_with_a_key_is_silent_to_another_key_and_counts_it() {
    for key in [None, Some([8; 32])] {
        let mut world = World::new(keyed(), Weather::default(), 1);
        world.middle = middle(
            Settings {
                key,
                ..Settings::default()
            },
            2,
        );
        world.middle.start(world.now);
        world.run(3000);
        assert!(world.sent_up.is_empty());
        let reason = if key.is_none() {
            Dropped::Encryption
        } else {
            Dropped::Sealed
        };
        assert!(world.robot.counters().dropped(reason) >= 3);
        assert_eq!(world.middle.state(), State::Calling);
    }
}

#[test]
fn packets_that_are_heard_again_do_nothing_and_are_counted() {
    let mut world = World::up(keyed());
    world.middle.command(FIRE, &[0, 1]).unwrap();
    world.run(300);
    assert_eq!(world.told.executed.len(), 1);
    let theirs = world.now + world.ahead;
    let accepted = world.robot.counters().accepted();
    let data = world.sent_down.iter().filter(|packet| kind(packet) == Type::Data);
    for packet in data.cloned().collect::<Vec<_>>() {
        let outcome = world.robot.receive(theirs, &mut packet.clone(), &mut world.told);
        assert_eq!(outcome, Err(Dropped::Replayed));
    }
    assert_eq!(world.told.executed.len(), 1);
    assert_eq!(world.robot.counters().accepted(), accepted);
}

#[test]
fn a_session_of_before_says_nothing_in_the_next() {
    let mut world = World::up(keyed());
    world.middle.command(FIRE, &[0, 1]).unwrap();
    world.run(100);
    let old = world.sent_down.clone();
    world.middle.end(world.now);
    world.run(100);
    world.middle.start(world.now);
    world.run(100);
    assert!(world.robot.is_up());
    let theirs = world.now + world.ahead;
    for packet in old.iter().filter(|packet| kind(packet) == Type::Data) {
        assert_eq!(
            world.robot.receive(theirs, &mut packet.clone(), &mut world.told),
            Err(Dropped::Session)
        );
    }
    assert_eq!(world.told.executed.len(), 1);
}

#[test]
fn a_hello_that_is_heard_again_changes_nothing() {
    let mut world = World::up(keyed());
    let mut hello = world.sent_down[0].clone();
    assert_eq!(kind(&hello), Type::Hello);
    let theirs = world.now + world.ahead;
    assert_eq!(
        world.robot.receive(theirs, &mut hello.clone(), &mut world.told),
        Err(Dropped::Busy)
    );
    world.run(2000);
    assert_eq!(world.told.sessions, [true], "the session goes on");
    // When it is over, the answer to it leads to a session that nobody has the keys of.
    world.middle.end(world.now);
    world.run(100);
    let theirs = world.now + world.ahead;
    world.robot.receive(theirs, &mut hello, &mut world.told).unwrap();
    world.run(1000);
    assert_eq!(world.told.sessions, [true, false]);
    world.middle.start(world.now);
    world.run(100);
    assert_eq!(world.told.sessions, [true, false, true]);
}

#[test]
fn hellos_are_answered_ten_times_a_second() {
    let mut world = World::new(keyed(), Weather::default(), 1);
    world.middle.start(world.now);
    world.step();
    let hello = world.sent_down[0].clone();
    let mut answers = 0;
    let mut out = [0; 600];
    for ms in 0..1000 {
        let _ = world
            .robot
            .receive(9_000_000 + ms * 1000, &mut hello.clone(), &mut world.told);
        while world
            .robot
            .poll(9_000_000 + ms * 1000, &mut out, &mut world.told)
            .is_some()
        {
            answers += 1;
        }
    }
    assert_eq!(answers, 10);
    assert_eq!(world.robot.counters().dropped(Dropped::Flood), 990);
}

#[test]
fn a_second_middle_is_told_that_the_robot_is_busy_until_the_first_is_silent() {
    let mut world = World::up(keyed());
    let first = std::mem::replace(&mut world.middle, middle(keyed(), 77));
    drop(first);
    world.middle.start(world.now);
    world.run(300);
    assert_eq!(
        world.notices,
        [Notice::Refused(Refusal {
            reason: Reason::Busy,
            differs: Vec::new()
        })]
    );
    world.run(1500);
    assert_eq!(world.middle.state(), State::Up);
}

#[test]
fn another_model_is_refused_by_the_names_of_what_differs() {
    let mut elements: Vec<Element<'static>> = CUBO.elements().to_vec();
    elements[usize::from(RANGE)].digest = 2;
    elements[usize::from(BUMP)].name = "light-2";
    let layout = Layout::new(CUBO.id(), [1; 32], elements.leak());
    let mut world = World::new(keyed(), Weather::default(), 1);
    let settings = mom_rsp::robot::Settings {
        key: Some(KEY),
        ..Default::default()
    };
    world.robot = Both::new(Box::leak(Box::new(layout)), settings).unwrap();
    world.middle.start(world.now);
    world.run(100);
    let [Notice::Refused(refusal)] = &world.notices[..] else {
        panic!("{:?}", world.notices);
    };
    assert_eq!(refusal.reason, Reason::Model);
    assert_eq!(refusal.differs, ["bump", "light-2", "range"]);
    assert_eq!(world.robot.counters().dropped(Dropped::Model), 1);
    assert!(refusal.to_string().contains("bump, light-2, range"));
}

#[test]
fn silence_makes_the_robot_safe_and_both_ends_begin_anew() {
    let mut world = World::up(Settings::default());
    world.middle.write(LEFT, &[0, 9]).unwrap();
    let ticket = {
        world.run(60);
        world.drop_up = |_| true;
        world.drop_down = |_| true;
        world.middle.command(FIRE, &[0, 1]).unwrap()
    };
    world.run(400);
    assert!(world.robot.is_up());
    assert_eq!(world.told.last(LEFT), Some(&[0, 9][..]));
    world.run(200);
    assert!(!world.robot.is_up());
    assert_eq!(world.told.last(LEFT), Some(&[0, 0][..]), "its safe value");
    assert_eq!(world.told.sessions, [true, false]);
    assert_eq!(
        world.notices,
        [
            Notice::Unknown {
                element: FIRE,
                ticket
            },
            Notice::Lost
        ]
    );
    assert_eq!(world.middle.write(LEFT, &[0, 1]), Err(Refused::NoSession));
    world.drop_up = |_| false;
    world.drop_down = |_| false;
    world.run(1200);
    assert_eq!(world.middle.state(), State::Up);
    assert_eq!(
        world.middle.wanted(LEFT),
        None,
        "nobody resumes a motion by itself"
    );
    assert!(world.told.executed.is_empty());
}

#[test]
fn hellos_go_out_less_and_less_often() {
    let mut world = World::new(Settings::default(), Weather::default(), 1);
    world.drop_down = |_| true;
    world.middle.start(world.now);
    world.run(5000);
    let stamps: Vec<u32> = world
        .sent_down
        .iter()
        .map(|hello| Header::decode(hello).unwrap().stamp)
        .collect();
    let waits: Vec<u32> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert_eq!(waits, [200, 300, 450, 675, 1000, 1000, 1000]);
}

#[test]
fn an_end_is_said_until_it_is_answered() {
    let ends = |packets: &[Vec<u8>], of| packets.iter().filter(|packet| kind(packet) == of).count();
    let mut world = World::up(Settings::default());
    world.middle.write(LEFT, &[0, 9]).unwrap();
    world.run(50);
    world.drop_up = |packet| packet[4] == Type::UpEnd as u8;
    world.middle.end(world.now);
    world.run(100);
    assert!(ends(&world.sent_down, Type::End) >= 4, "S23");
    assert_eq!(world.middle.state(), State::Ending);
    assert_eq!(world.told.last(LEFT), Some(&[0, 0][..]));
    world.drop_up = |_| false;
    world.run(50);
    assert_eq!(world.middle.state(), State::Idle);
    assert_eq!(world.notices, [Notice::Ended]);
    let sent = world.sent_down.len() + world.sent_up.len();
    world.run(1000);
    assert_eq!(
        world.sent_down.len() + world.sent_up.len(),
        sent,
        "then there is silence"
    );
}

#[test]
fn a_robot_can_end_it_too_and_two_ends_do_not_answer_each_other_for_ever() {
    let mut world = World::up(Settings::default());
    world.weather = Weather {
        twice: 100,
        delay: 30,
        jitter: 30,
        ..Weather::default()
    };
    world.run(60);
    let theirs = world.now + world.ahead;
    world.robot.end(theirs, &mut world.told);
    assert_eq!(world.told.sessions, [true, false]);
    world.run(1500);
    assert_eq!(world.middle.state(), State::Idle);
    assert_eq!(world.notices.last(), Some(&Notice::Ended));
    let sent = world.sent_down.len() + world.sent_up.len();
    world.run(1000);
    assert_eq!(world.sent_down.len() + world.sent_up.len(), sent);

    let mut world = World::up(Settings::default());
    world.weather.delay = 30;
    let theirs = world.now + world.ahead;
    world.robot.end(theirs, &mut world.told);
    world.middle.end(world.now);
    world.run(1000);
    let sent = world.sent_down.len() + world.sent_up.len();
    world.run(1000);
    assert_eq!(world.sent_down.len() + world.sent_up.len(), sent);
    assert_eq!(world.middle.state(), State::Idle);
}

#[test]
fn sequences_wrap_within_a_sealed_session() {
    let mut world = World::up(Settings { period: 5, ..keyed() });
    world.run(5 * 70_000);
    assert_eq!(world.told.sessions, [true]);
    assert!(world.robot.counters().accepted() > 70_000);
    assert_eq!(
        world.robot.counters().iter().map(|(_, count)| count).sum::<u32>(),
        0
    );
    world.middle.write(LEFT, &[0, 9]).unwrap();
    world.run(50);
    assert_eq!(world.told.last(LEFT), Some(&[0, 9][..]));
    assert_eq!(world.middle.confirmed(LEFT).unwrap().value, [0, 9]);
}

#[test]
fn what_is_not_for_an_end_is_dropped_by_its_reason() {
    let mut world = World::up(Settings::default());
    let theirs = world.now + world.ahead;
    let good = world.sent_down.last().unwrap().clone();
    let with = |at: usize, value: u8| {
        let mut packet = good.clone();
        packet[at] = value;
        packet
    };
    let next = good[6] + 1;
    let mut payload = with(6, next);
    payload.push(1);
    let mut map = with(6, next + 1);
    map.truncate(21);
    let far = {
        let mut packet = good.clone();
        (packet[5], packet[6]) = (0xFF, 0x00);
        packet
    };
    let cases = [
        (good[..19].to_vec(), Dropped::Short),
        (with(0, 2), Dropped::Version),
        (with(1, 9), Dropped::Model),
        (with(4, 0x81), Dropped::Type),
        (with(4, 0x77), Dropped::Type),
        (with(11, good[11] ^ 1), Dropped::Session),
        (with(3, 1), Dropped::Encryption),
        (good.clone(), Dropped::Replayed),
        (far, Dropped::Old),
        (payload, Dropped::Payload),
        (map, Dropped::Map),
    ];
    for (mut packet, reason) in cases {
        let before = world.robot.counters().dropped(reason);
        assert_eq!(
            world.robot.receive(theirs, &mut packet, &mut world.told),
            Err(reason)
        );
        assert_eq!(world.robot.counters().dropped(reason), before + 1);
    }
}

/// A round trip that is longer than the silence that ends a session: packets come each period all the same.
#[test]
fn a_session_holds_over_a_round_trip_of_800_ms() {
    let far = Weather {
        delay: 400,
        ..Weather::default()
    };
    let mut world = World::new(Settings::default(), far, 1);
    world.middle.start(world.now);
    world.run(6000);
    assert_eq!(world.middle.state(), State::Up);
    assert_eq!(world.told.sessions, [true], "one session, which was never lost");
}

#[test]
fn a_robot_without_a_watchdog_keeps_its_session() {
    let mut world = World::new(Settings::default(), Weather::default(), 1);
    world.robot = robot(None, 0);
    world.middle.start(world.now);
    world.run(300);
    assert!(world.robot.is_up() && world.middle.state() == State::Up);
    world.drop_down = |_| true;
    world.run(400);
    assert!(world.robot.is_up(), "nothing is said, and nobody watches");
    // A middle that asks after the silence of one that is gone gets a session.
    world.drop_down = |_| false;
    world.middle = middle(Settings::default(), 2);
    world.run(200);
    world.middle.start(world.now);
    world.run(400);
    assert!(world.robot.is_up() && world.middle.state() == State::Up);
}

#[test]
fn the_end_of_a_robots_session_is_said_at_once() {
    let mut world = World::up(Settings::default());
    world.run(3);
    world.sent_up.clear();
    world.robot.end(world.now + world.ahead, &mut world.told);
    world.step();
    assert_eq!(
        world.sent_up.first().map(|packet| kind(packet)),
        Some(Type::UpEnd)
    );
    world.run(100);
    assert_eq!(world.middle.state(), State::Idle);
    assert!(world.robot.wake().is_none(), "it has nothing to do any more");
}
