//! What of the wire differs: smaller tables, foreign robots, a gateway that is late, robots that are not there.

use std::sync::LazyLock;

use mom_brs::{PAPER, Parameter};

use super::*;

/// Nothing moves before all of a script is known to be one for these robots.
#[test]
fn what_the_robots_of_a_smaller_table_do_not_know_is_refused_before_any_motion() {
    const PARAMETERS: [Parameter; 2] = [Parameter::new("x", 0, 5000), Parameter::new("y", 0, 5000)];
    static SMALL: LazyLock<Table> = LazyLock::new(|| {
        let goto = mom_brs::Command {
            code: Code::GOTO,
            name: "goto",
            parameters: Some(&PARAMETERS),
            reply: None,
        };
        let all = [
            mom_brs::Command::NULL,
            mom_brs::Command::STATUS,
            mom_brs::Command::MOTOR,
            mom_brs::Command::LEDS,
            goto,
        ];
        Table::new(Box::leak(Box::new(all))).expect("a table")
    });
    for (table, script, words) in [
        (
            &PAPER,
            "motor 100 100 500; goto 5 5",
            "statement 2: the robots of this gateway know no `goto`: its table of commands has no code 10",
        ),
        (
            &SMALL,
            "motor 100 100 500; via 5 5 6 6",
            "statement 2: the robots of this gateway know no `via`: its table of commands has no code 11",
        ),
        (
            &SMALL,
            "motor 100 100 500; goto 9000 5",
            "statement 2: `goto` takes x from 0 to 5000 by this gateway's table of commands, not 9000",
        ),
    ] {
        let mut pair = Pair::new(0);
        pair.queue = CommandQueue::new(Unit::new(7, table));
        pair.note(Unit::linked);
        pair.down.clear();
        let refused = pair.command(script).expect_err("it is refused");
        assert_eq!((refused.name(), refused.text()), (ErrorName::Syntax, words));
        assert!(pair.down.is_empty() && pair.ended().is_empty(), "nothing moves");
    }
}

/// The paper gives the bits of STATUS no meaning: those of a robot that does not say where it is may be anything.
#[test]
fn the_status_of_a_foreign_robot_says_that_it_answers_and_no_more() {
    let unit = Unit::new(7, &PAPER);
    let mut pair = Pair::new(0);
    pair.queue = CommandQueue::new(unit);
    let answer = |pair: &mut Pair| {
        // Whatever it is asked: it moves, is on its way, its watchdog has stopped it, and its battery is empty.
        let reply = Frame::reply(&mom_brs::Command::STATUS, &[0b1111_1111]).expect("a reply");
        let mut heard = Ok(());
        pair.queue
            .note(pair.now, |unit| heard = unit.heard(&reply), &mut pair.events);
        heard
    };
    pair.note(Unit::linked);
    assert!(pair.queue.state().moving, "it has not answered yet");
    assert_eq!(answer(&mut pair), Ok(()));
    let state = pair.queue.state();
    for key in ["battery", "charging", "switches", "expired"] {
        assert_eq!(state.report.get(key), None, "{key} is not known");
    }
    assert!(
        !pair.queue.machine().is_moving(),
        "it has carried out the stop before the question"
    );
    pair.command("motor 100 100 500").expect("it is taken");
    pair.now = 600 * MS;
    pair.queue.advance(pair.now, &mut pair.events);
    while !pair.queue.machine().asked_status.is_empty() {
        assert_eq!(answer(&mut pair), Ok(()));
    }
    assert_eq!(pair.ended(), ["finished"], "its battery is not known to be empty");
    // Of a way nobody would know the end.
    pair.queue = CommandQueue::new(Unit::new(7, &EXTENDED));
    pair.note(Unit::linked);
    pair.command("goto 500 500").expect("it may be one of ours");
    let told = (0..2).map(|_| answer(&mut pair)).find(Result::is_err);
    let error = told
        .expect("the answer after the statement")
        .expect_err("an error");
    assert_eq!(error.name(), ErrorName::Link);
    pair.queue.fail(pair.now, &error, &mut pair.events);
    let refused = pair
        .command("motor 0 0 1; goto 500 500")
        .expect_err("it is foreign");
    assert!(
        refused
            .text()
            .contains("statement 2: robot 7 does not say whether it is on its way"),
        "{refused}"
    );
}

/// A gateway that was stopped, or had no processor, has the answers behind it.
#[test]
fn a_robot_that_moves_is_not_given_up_while_its_gateway_does_not_listen() {
    let mut pair = Pair::new(20 * MS);
    pair.command("motor 100 100 30000").expect("it is taken");
    pair.pass(2000 * MS);
    pair.now = 2900 * MS;
    pair.queue.advance(pair.now, &mut pair.events);
    pair.now = 3700 * MS;
    pair.queue.advance(pair.now, &mut pair.events);
    assert!(!pair.queue.machine().is_overdue(), "it was late twice, by 1.6 s");
    // From now on it listens.
    pair.up.clear();
    pair.delay = 60_000 * MS;
    for late in 1..20 {
        pair.now = (3700 + late * 100) * MS;
        pair.queue.advance(pair.now, &mut pair.events);
    }
    assert!(pair.queue.machine().is_overdue());
}

#[test]
fn a_robot_that_is_not_reached_says_why() {
    let mut pair = Pair::new(0);
    let why = |pair: &Pair| pair.queue.state().report.get("unreached-why").cloned();
    pair.note(|unit| unit.lost("the robot is silent"));
    assert_eq!(why(&pair), Some("the robot is silent".into()));
    pair.note(|unit| unit.unreached("cannot connect: no answer in time"));
    assert_eq!(why(&pair), Some("cannot connect: no answer in time".into()));
    let refused = pair.command("leds 1").expect_err("it is not there");
    assert_eq!(
        refused.text(),
        "robot 7 is not connected to its gateway: cannot connect: no answer in time"
    );
    pair.note(Unit::linked);
    assert_eq!(why(&pair), None);
}
