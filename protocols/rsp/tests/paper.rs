//! Paper mode: S19 to S23 to the letter, with what is lost by it.

mod common;

use common::*;
use mom_rsp::middle::{Notice, Settings, State};

fn paper() -> World {
    World::up(Settings {
        paper: true,
        ..Settings::default()
    })
}

#[test]
fn a_memory_command_that_is_lost_is_reported_as_failed_and_not_sent_again() {
    let mut world = paper();
    world.drop_down = |packet| packet.len() > 22;
    world.sent_down.clear();
    let ticket = world.middle.command(SAY, &[0, 1]).unwrap();
    world.run(40);
    world.drop_down = |_| false;
    world.run(500);
    assert_eq!(world.notices, [Notice::Failed { element: SAY, ticket }]);
    assert!(world.told.executed.is_empty());
    assert_eq!(
        world.sent_down.iter().filter(|packet| packet.len() > 22).count(),
        1,
        "only once (S20)"
    );
    let ticket = world.middle.command(SAY, &[0, 2]).unwrap();
    world.run(100);
    assert_eq!(world.done(), [ticket]);
}

#[test]
fn a_command_goes_in_each_packet_until_its_acknowledgement() {
    let mut world = paper();
    world.drop_up = |_| true;
    world.sent_down.clear();
    world.middle.command(FIRE, &[0, 1]).unwrap();
    world.run(200);
    assert_eq!(
        world.sent_down.iter().filter(|packet| packet.len() > 22).count(),
        10,
        "S19"
    );
    assert_eq!(world.told.executed.len(), 1);
}

#[test]
fn a_memory_event_that_is_lost_stays_lost_until_somebody_asks() {
    let mut world = paper();
    world.drop_up = |packet| packet.len() > 22;
    world.robot.raise(CARD, b"card").unwrap();
    world.run(40);
    world.drop_up = |_| false;
    world.run(2000);
    assert!(world.raised(CARD).is_empty(), "sent once (S22)");
    assert_eq!(world.middle.free_buffers(), 3, "though the middle could know");
    world.middle.ask(CARD).unwrap();
    world.run(60);
    assert_eq!(world.raised(CARD), [b"card".to_vec()]);
    assert_eq!(world.robot.free_buffers(), 4);
}

#[test]
fn increments_that_are_lost_are_not_made() {
    let mut world = paper();
    world.middle.write(HEAD, &[0, 5]).unwrap();
    world.run(40);
    world.drop_down = |_| true;
    world.middle.write(HEAD, &[0, 7]).unwrap();
    world.run(40);
    world.drop_down = |_| false;
    world.middle.write(HEAD, &[0, 1]).unwrap();
    world.run(60);
    assert_eq!(world.told.sum(HEAD), 6);
}

#[test]
fn all_effectors_that_have_a_value_are_in_each_packet() {
    let mut world = paper();
    world.middle.write(LEFT, &[0, 5]).unwrap();
    world.middle.write(RIGHT, &[0, 5]).unwrap();
    world.run(40);
    world.sent_down.clear();
    world.run(200);
    assert!(world.sent_down.iter().all(|packet| packet.len() == 22 + 4));
}

#[test]
fn no_watchdog_stops_the_robot() {
    let mut world = paper();
    world.middle.write(LEFT, &[0, 5]).unwrap();
    world.run(40);
    world.drop_down = |_| true;
    world.run(10_000);
    assert!(world.robot.is_up());
    assert_eq!(world.told.last(LEFT), Some(&[0, 5][..]));
    world.drop_down = |_| false;
    world.middle = middle(Settings::default(), 5);
    world.middle.start(world.now);
    world.run(1500);
    assert_eq!(
        world.middle.state(),
        State::Up,
        "another middle may have it after 500 ms of silence"
    );
    assert_eq!(world.told.last(LEFT), Some(&[0, 0][..]));
}
