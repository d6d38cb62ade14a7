//! Both ends through a network that loses, doubles, delays and reorders, in virtual time: what must hold whatever it does.

mod common;

use common::*;
use mom_rsp::Dropped;
use mom_rsp::middle::{Notice, Settings, State};
use proptest::prelude::*;

fn weather() -> impl Strategy<Value = Weather> {
    (0..40_u64, 0..30_u64, 0..60_u64, 0..80_u64).prop_map(|(loss, twice, delay, jitter)| Weather {
        loss,
        twice,
        delay,
        jitter,
    })
}

/// What was asked for, and came about, in one run.
#[derive(Default)]
struct Asked {
    commands: Vec<(u32, u8, Vec<u8>)>,
    buttons: Vec<Vec<u8>>,
    cards: Vec<Vec<u8>>,
    steps: i64,
}

/// Both programs do something at random each ms.
fn act(world: &mut World, asked: &mut Asked, number: u16) {
    let bytes = number.to_be_bytes();
    match world.random.below(40) {
        0 => drop(world.middle.write(LEFT, &bytes)),
        1 => drop(world.middle.write(ARM, &bytes)),
        2 => drop(world.middle.write(LCD, format!("line {number}").as_bytes())),
        3 => {
            let step = world.random.below(200) as i16 - 100;
            if world.middle.write(HEAD, &step.to_be_bytes()).is_ok() {
                asked.steps += i64::from(step);
            }
        }
        4 | 5 => {
            let element = if world.random.percent(50) { FIRE } else { SAY };
            if let Ok(ticket) = world.middle.command(element, &bytes) {
                asked.commands.push((ticket, element, bytes.to_vec()));
            }
        }
        6 if world.robot.raise(BUTTON, &bytes).is_ok() => asked.buttons.push(bytes.to_vec()),
        7 if world.robot.raise(CARD, &bytes).is_ok() => asked.cards.push(bytes.to_vec()),
        8 => world
            .robot
            .set(RANGE, &[bytes, bytes].concat())
            .expect("a sensor"),
        9 => world.robot.set(LIGHT, &bytes[1..]).expect("a sensor"),
        10 => world
            .robot
            .set(CAMERA, format!("{number}").as_bytes())
            .expect("a sensor"),
        11 => drop(world.middle.ask(RANGE)),
        _ => {}
    }
}

fn settings(key: bool) -> Settings {
    Settings {
        key: key.then_some(KEY),
        ..Settings::default()
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, max_shrink_iters: 60, failure_persistence: None, ..ProptestConfig::default() })]

    /// S3, S12, S19 to S22: as long as the session lasts, everything arrives once, and the last values are the same at both ends.
    #[test]
    fn a_session_loses_nothing(weather in weather(), seed in any::<u64>(), key in any::<bool>()) {
        // So patient that no weather ends the session.
        let settings = Settings { silence: 60_000, ..settings(key) };
        let mut world = World::new(settings, weather, seed);
        world.middle.start(world.now);
        let mut asked = Asked::default();
        for number in 0..3000 {
            act(&mut world, &mut asked, number);
            world.step();
        }
        world.calm(4000);
        prop_assert_eq!(world.middle.state(), State::Up);
        prop_assert_eq!(world.told.sessions.len(), 1);

        let mut executed = world.told.executed.clone();
        for element in [FIRE, SAY] {
            let wanted: Vec<_> = asked.commands.iter().filter(|(_, of, _)| *of == element).map(|(_, _, data)| data.clone()).collect();
            let done: Vec<_> = executed.extract_if(.., |(of, _)| *of == element).map(|(_, data)| data).collect();
            prop_assert_eq!(done, wanted, "each once, in order");
        }
        let mut done = world.done();
        done.sort_unstable();
        prop_assert_eq!(done, asked.commands.iter().map(|(ticket, ..)| *ticket).collect::<Vec<_>>());
        prop_assert_eq!(world.raised(BUTTON), asked.buttons);
        prop_assert_eq!(world.raised(CARD), asked.cards);
        prop_assert_eq!(world.robot.free_buffers(), 4);

        prop_assert_eq!(world.told.sum(HEAD), asked.steps, "increments");
        for element in [LEFT, ARM, LCD] {
            prop_assert_eq!(world.told.last(element), world.middle.wanted(element), "{}", element);
            prop_assert_eq!(world.middle.confirmed(element).map(|read| read.value), world.middle.wanted(element));
        }
    }

    /// Sensors: the last value that was set is the last that is read, by differences alone (S3).
    #[test]
    fn the_last_values_of_sensors_arrive(weather in weather(), seed in any::<u64>(), values in proptest::collection::vec(any::<[u8; 4]>(), 1..60)) {
        let mut world = World::up(settings(false));
        (world.weather, world.random) = (weather, Random(seed));
        for value in &values {
            world.robot.set(RANGE, value).unwrap();
            world.robot.set(LIGHT, &value[..1]).unwrap();
            world.run(7);
        }
        world.calm(700);
        prop_assume!(!world.notices.contains(&Notice::Lost));
        let last = values.last().unwrap();
        prop_assert_eq!(world.middle.read(RANGE).unwrap().value, last);
        prop_assert_eq!(world.middle.read(LIGHT).unwrap().value, &last[..1]);
        // Then nothing differs: packets are header and map.
        let sent = world.sent_up.len();
        world.run(100);
        prop_assert!(world.sent_up[sent..].iter().all(|packet| packet.len() == 22));
    }

    /// Restarts of either end, and sessions that are lost: nothing is executed twice, and what became of each command is said.
    #[test]
    fn nothing_is_executed_twice_over_restarts(weather in weather(), seed in any::<u64>(), key in any::<bool>()) {
        let mut world = World::new(settings(key), weather, seed);
        world.middle.start(world.now);
        let mut asked = Asked::default();
        let mut results: Vec<(u32, &str)> = Vec::new();
        let mut known_from = 0;
        for number in 0..6000 {
            act(&mut world, &mut asked, number);
            world.step();
            if world.random.below(1500) == 0 {
                match world.random.below(3) {
                    0 => world.robot = robot(key.then_some(KEY), 500),
                    1 => {
                        // What the old program asked for, its successor cannot tell.
                        known_from = asked.commands.len();
                        world.notices.clear();
                        world.middle = middle(settings(key), seed ^ u64::from(number));
                        world.middle.start(world.now);
                    }
                    _ => {
                        let silence = world.now + 700_000;
                        while world.now < silence {
                            world.down.clear();
                            world.up.clear();
                            world.step();
                        }
                    }
                }
            }
        }
        world.calm(3000);
        prop_assert_eq!(world.middle.state(), State::Up);
        let mut executed = world.told.executed.clone();
        executed.sort();
        let all = executed.len();
        executed.dedup();
        prop_assert_eq!(executed.len(), all, "twice");
        for notice in &world.notices {
            match notice {
                Notice::Done { ticket, .. } => results.push((*ticket, "done")),
                Notice::Unknown { ticket, .. } => results.push((*ticket, "unknown")),
                _ => {}
            }
        }
        let asked = &asked.commands[known_from..];
        prop_assert_eq!(results.len(), asked.len(), "one result for each");
        for (ticket, result) in results {
            let (_, element, data) = asked.iter().find(|(of, ..)| *of == ticket).unwrap();
            let was = executed.contains(&(*element, data.clone()));
            prop_assert!(was || result == "unknown", "{} {}", ticket, result);
        }
        for element in [BUTTON, CARD] {
            let mut raised = world.raised(element);
            let all = raised.len();
            raised.dedup();
            prop_assert_eq!(raised.len(), all, "an event twice");
        }
    }

    /// S6, S7: whatever is activated and deactivated meanwhile, in the end both ends agree, and nobody moves what is not active.
    #[test]
    fn activation_is_the_same_at_both_ends(weather in weather(), seed in any::<u64>(), key in any::<bool>()) {
        let mut world = World::new(Settings { silence: 60_000, ..settings(key) }, weather, seed);
        world.middle.start(world.now);
        for number in 0..2000_u16 {
            let element = world.random.below(16) as u8;
            match world.random.below(20) {
                0 => drop(world.middle.set_activated(element, number % 3 > 0)),
                1 => drop(world.middle.set_activated(DRIVE, number % 2 > 0)),
                2 => drop(world.middle.write(LEFT, &number.to_be_bytes())),
                3 => drop(world.middle.write(SPEAKER, &[number as u8])),
                4 => drop(world.robot.set(RANGE, &[number.to_be_bytes(); 2].concat())),
                _ => {}
            }
            world.step();
        }
        world.calm(1000);
        prop_assert!(world.middle.is_confirmed());
        for element in 0..16 {
            prop_assert_eq!(world.robot.is_active(element), world.middle.activated(element), "{}", element);
            prop_assert_eq!(world.middle.active(element), world.middle.activated(element), "{}", element);
        }
        for (element, safe) in [(LEFT, &[0, 0][..]), (SPEAKER, &[0])] {
            let last = world.told.last(element).unwrap_or(safe);
            prop_assert_eq!(last, world.middle.wanted(element).unwrap_or(safe), "{}", element);
            prop_assert!(world.middle.active(element) || last == safe);
            prop_assert_eq!(world.middle.confirmed(element).map(|read| read.value), world.middle.wanted(element));
        }
    }

    /// A late data packet changes no value; what it brings of commands counts once.
    #[test]
    fn late_and_repeated_packets_change_nothing(order in Just((0..40_usize).collect::<Vec<_>>()).prop_shuffle()) {
        let mut world = World::up(Settings { silence: 60_000, ..settings(false) });
        world.drop_down = |_| true;
        world.sent_down.clear();
        for number in 0..40_u16 {
            world.now += 20_000;
            world.middle.write(LEFT, &number.to_be_bytes()).unwrap();
            world.middle.write(HEAD, &1_i16.to_be_bytes()).unwrap();
            if number == 3 {
                world.middle.command(FIRE, &[0, 1]).unwrap();
            }
            while world.middle.poll(world.now).map(|datagram| world.sent_down.push(datagram.to_vec())).is_some() {}
        }
        prop_assert_eq!(world.sent_down.len(), 40);
        let mut highest = 0;
        let theirs = world.now + world.ahead;
        for &at in order.iter().chain(&order) {
            let _ = world.robot.receive(theirs, &mut world.sent_down[at].clone(), &mut world.told);
            highest = highest.max(at as u16);
            let mut out = [0; 600];
            while world.robot.poll(theirs + u64::from(highest), &mut out, &mut world.told).is_some() {}
        }
        let mut out = [0; 600];
        world.robot.poll(theirs + 30_000, &mut out, &mut world.told);
        prop_assert_eq!(world.told.last(LEFT).unwrap(), 39_u16.to_be_bytes());
        prop_assert_eq!(world.told.sum(HEAD), 40);
        prop_assert_eq!(&world.told.executed, &[(FIRE, vec![0, 1])]);
        prop_assert_eq!(world.robot.counters().dropped(Dropped::Replayed), 40);
    }
}
