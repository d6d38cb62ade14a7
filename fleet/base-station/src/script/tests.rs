//! What scripts send and when, what is refused, and that each of them ends.

use mom_brs::file::EXTENDED;
use mom_brs::{Command, PAPER};
use proptest::prelude::*;

use super::*;

const UNITS: [Unit; 5] = [1, 2, 3, 4, 5];

fn script(text: &str) -> Script {
    Script::parse(text, &UNITS, &EXTENDED).unwrap()
}

/// What it sends, as `time in ms:unit:frame`, if nobody replies; and how it ends.
fn run(text: &str) -> (Vec<String>, Action) {
    let mut interpreter = Interpreter::new(script(text), 0);
    let (mut now, mut sent) = (0, Vec::new());
    loop {
        match interpreter.poll(now) {
            Action::Send(unit, frame) => sent.push(format!("{}:{unit}:{frame:#}", now / 1000)),
            Action::Wait(until) => {
                assert!(until > now);
                now = until;
            }
            end => return (sent, end),
        }
    }
}

#[test]
fn statements_are_sent_in_order_to_one_several_and_all_units() {
    let (sent, end) = run("1 motor 100 -100 # forward; all leds 1\n\n1,3-5,4 leds 255;ALL Null");
    let expected = [
        "0:1:motor left=100 right=-100",
        "0:1:leds data=255",
        "0:3:leds data=255",
        "0:4:leds data=255",
        "0:5:leds data=255",
        "0:1:null",
        "0:2:null",
        "0:3:null",
        "0:4:null",
        "0:5:null",
    ];
    assert_eq!((sent, end), (expected.map(str::to_owned).to_vec(), Action::Done));
}

#[test]
fn repetitions_in_one_another_keep_their_times() {
    let (sent, _) = run("repeat 2\n 1 leds 1\n repeat 3; wait 10; 2 leds 2; end\n wait 5\nend\n1 leds 3");
    let times: Vec<&str> = sent
        .iter()
        .map(|line| line.split(" ").next().unwrap_or_default())
        .collect();
    let expected = [
        "0:1:leds",
        "10:2:leds",
        "20:2:leds",
        "30:2:leds",
        "35:1:leds",
        "45:2:leds",
        "55:2:leds",
        "65:2:leds",
        "70:1:leds",
    ];
    assert_eq!(times, expected);
}

#[test]
fn waits_make_up_for_a_late_poll_but_not_for_a_long_sleep() {
    let mut interpreter = Interpreter::new(script("repeat 9; wait 100; 1 leds 1; end"), 0);
    assert_eq!(interpreter.poll(0), Action::Wait(100_000));
    assert!(matches!(interpreter.poll(130_000), Action::Send(1, _)));
    assert_eq!(interpreter.poll(130_000), Action::Wait(200_000));
    assert!(matches!(interpreter.poll(60_000_000), Action::Send(1, _)));
    assert_eq!(interpreter.poll(60_000_000), Action::Wait(60_100_000));
}

#[test]
fn to_drives_by_the_places_after_via_and_ends_where_it_says() {
    let (sent, _) = run("3 to 1000 500 via 200 300 via -9 0\n4 to 1 2");
    let expected = [
        "0:3:goto x=200 y=300",
        "0:3:via x=-9 y=0",
        "0:3:via x=1000 y=500",
        "0:4:goto x=1 y=2",
    ];
    assert_eq!(sent, expected);
    let error = Script::parse("3 to 1 2", &UNITS, &PAPER).unwrap_err();
    assert_eq!(error.fault(), ScriptFault::NoCommand);
}

#[test]
fn on_waits_for_a_reply_since_the_command_was_sent() {
    let reply = Frame::reply(&Command::STATUS, &[5]).unwrap();
    let null = Frame::reply(&Command::NULL, &[]).unwrap();
    let mut interpreter = Interpreter::new(script("2 status\non 2 reply status\n1 leds 1"), 0);
    interpreter.replied(2, &reply);
    assert!(matches!(interpreter.poll(0), Action::Send(2, _)));
    assert_eq!(
        interpreter.poll(0),
        Action::Wait(3_000_000),
        "the reply was before"
    );
    interpreter.replied(1, &reply);
    interpreter.replied(2, &null);
    assert_eq!(
        interpreter.poll(5),
        Action::Wait(3_000_000),
        "of another unit, of another command"
    );
    interpreter.replied(2, &reply);
    assert!(matches!(interpreter.poll(6), Action::Send(1, _)));
    assert_eq!(interpreter.poll(6), Action::Done);
}

#[test]
fn on_is_content_with_a_reply_that_came_before_it_and_uses_it_up() {
    let reply = Frame::reply(&Command::STATUS, &[5]).unwrap();
    let mut interpreter = Interpreter::new(
        script("2 status; wait 10; on 2 reply status; on 2 reply status"),
        0,
    );
    assert!(matches!(interpreter.poll(0), Action::Send(2, _)));
    assert_eq!(interpreter.poll(0), Action::Wait(10_000));
    interpreter.replied(2, &reply);
    assert_eq!(
        interpreter.poll(10_000),
        Action::Wait(3_010_000),
        "the second one waits"
    );
}

#[test]
fn without_a_reply_the_script_fails_after_three_seconds() {
    let (sent, end) = run("2 status\n  on 2 reply status\n1 leds 1");
    let spot = Spot { line: 2, column: 3 };
    assert_eq!((sent.len(), end), (1, Action::Failed(NoReply { unit: 2, spot })));
    let text = NoReply { unit: 2, spot }.to_string();
    assert_eq!(text, "line 2, column 3: unit 2 did not reply within 3 s");
}

#[test]
fn a_script_tells_its_units_and_the_replies_to_expect() {
    let script = script("5 motor 1 1; 2,3 status; 2 leds 1");
    assert_eq!(script.units(), [2, 3, 5]);
    assert_eq!(script.replies(), [(2, Code::STATUS), (3, Code::STATUS)]);
}

fn check(cases: &[(&str, ScriptFault, &str)]) {
    for (text, fault, words) in cases {
        let error = Script::parse(text, &UNITS, &EXTENDED).unwrap_err();
        assert_eq!(
            (error.fault(), error.to_string().as_str()),
            (*fault, *words),
            "{text}"
        );
    }
}

#[test]
fn unknown_words_name_the_nearest() {
    use ScriptFault::{NoCommand, NoReply, UnknownWord};
    check(&[
        (
            "1 motr 1 1",
            UnknownWord,
            "line 1, column 3: there is no command `motr`; did you mean `motor`?",
        ),
        (
            "ö; wiat 5",
            UnknownWord,
            "line 1, column 1: there is no statement `ö`; expected one of `all`, `wait`, `repeat`, `end`, `on`",
        ),
        (
            "wait 1\n wiat 5",
            UnknownWord,
            "line 2, column 2: there is no statement `wiat`; did you mean `wait`?",
        ),
        (
            "motor 1 1",
            UnknownWord,
            "line 1, column 1: the unit is missing before `motor`, as in `1 motor`",
        ),
        (
            "on 1 replies status",
            UnknownWord,
            "line 1, column 6: `reply` is expected, and this is `replies`",
        ),
        (
            "on 1 reply status1",
            UnknownWord,
            "line 1, column 12: there is no command `status1`; did you mean `status`?",
        ),
        (
            "on 1 reply motor",
            NoReply,
            "line 1, column 12: robots do not reply to `motor`",
        ),
        (
            "1 to 1 2 by 3 4",
            UnknownWord,
            "line 1, column 10: `via` is expected, and this is `by`",
        ),
        (
            "1 holder",
            NoCommand,
            "line 1, column 3: `holder` is sent by robots only",
        ),
    ]);
}

#[test]
fn wrong_units_and_values_are_refused_where_they_stand() {
    use ScriptFault::{Missing, TooMuch, Unit, Value};
    check(&[
        (
            "6 null",
            Unit,
            "line 1, column 1: there is no unit 6 in the fleet",
        ),
        (
            "1,6 null",
            Unit,
            "line 1, column 3: there is no unit 6 in the fleet",
        ),
        (
            "1,2-99999999999 null",
            Unit,
            "line 1, column 5: there is no unit 99999999999 in the fleet",
        ),
        (
            "1, 2 null",
            Unit,
            "line 1, column 3: `` is not a unit number; units are written 1,3-5",
        ),
        (
            "4-2 null",
            Unit,
            "line 1, column 1: the range 4-2 is the wrong way round",
        ),
        (
            "1",
            Missing,
            "line 1, column 2: the command, such as `motor`, is missing",
        ),
        (
            "1 motor 5 ;",
            Missing,
            "line 1, column 10: the value of `right`, -1000 to 1000, is missing",
        ),
        (
            "1 motor 5 1001",
            Value,
            "line 1, column 11: `right` is -1000 to 1000, not 1001",
        ),
        (
            "1 motor 5 x",
            Value,
            "line 1, column 11: `right` is a whole number from -1000 to 1000, not `x`",
        ),
        (
            "1 null 1",
            TooMuch,
            "line 1, column 8: the statement ends before `1`; the next one is on a line of its own or after `;`",
        ),
        (
            "wait -1",
            Value,
            "line 1, column 6: a whole number from 0 to 3600000 is expected, not `-1`",
        ),
        (
            "repeat",
            Missing,
            "line 1, column 7: how often, 1 to 1000000, is missing",
        ),
        (
            "repeat 0",
            Value,
            "line 1, column 8: a whole number from 1 to 1000000 is expected, not `0`",
        ),
    ]);
}

#[test]
fn what_has_no_end_or_is_too_long_is_refused() {
    use ScriptFault::{Nesting, TooLong};
    check(&[
        (
            "repeat 2\nrepeat 3; end",
            Nesting,
            "line 1, column 1: this `repeat` has no `end`",
        ),
        ("wait 1; end", Nesting, "line 1, column 9: `end` without `repeat`"),
        (
            &"repeat 1;".repeat(9),
            Nesting,
            "line 1, column 73: `repeat` may be nested at most 8 deep",
        ),
        (
            "repeat 1000; repeat 1000; 1 null; end; end",
            TooLong,
            "line 1, column 1: the script has more than 1000000 steps here, counting repetitions",
        ),
        (
            "repeat 25; wait 3600000; end",
            TooLong,
            "line 1, column 1: up to here it would wait for more than a day",
        ),
        (
            &" ".repeat(MOST_BYTES + 1),
            TooLong,
            "line 1, column 1: 1048577 bytes exceed the limit of 1048576",
        ),
    ]);
}

fn word() -> impl Strategy<Value = String> {
    let words = [
        "1", "2,3", "1-5", "all", "motor", "leds", "status", "null", "to", "via", "wait", "repeat", "end",
        "on", "reply", "100", "-5", "0", "3", "99", ";", "\n", "#", "1000000", "3600000",
    ];
    prop_oneof![
        20 => prop::sample::select(words.to_vec()).prop_map(str::to_owned),
        1 => ".{0,6}",
    ]
}

/// Statements that are right, so that most scripts run.
fn statement() -> impl Strategy<Value = String> {
    let statements = [
        "1 motor 5 5",
        "all leds 1",
        "2 status",
        "on 2 reply status",
        "wait 0",
        "wait 700",
        "repeat 3",
        "repeat 40",
        "end",
        "3 to 1 2 via 3 4",
    ];
    prop::sample::select(statements.to_vec()).prop_map(str::to_owned)
}

/// Carries it out; the number of answers until it ended.
fn steps_to_the_end(script: Script, replies: bool) -> u64 {
    let mut interpreter = Interpreter::new(script, 0);
    let (mut now, mut answers) = (0, 0);
    loop {
        answers += 1;
        assert!(answers <= 2 * MOST_STEPS && now <= LONGEST);
        match interpreter.poll(now) {
            Action::Send(unit, frame) if replies && frame.command().reply.is_some() => {
                interpreter.replied(unit, &Frame::reply(&Command::STATUS, &[1]).unwrap());
            }
            Action::Send(..) => {}
            Action::Wait(until) => now = until,
            end => {
                assert_eq!(interpreter.poll(i64::MAX), end, "an end is an end");
                return answers;
            }
        }
    }
}

proptest! {
    #[test]
    fn no_text_makes_it_panic_and_what_it_accepts_ends(words in prop::collection::vec(word(), 0..40), replies: bool) {
        let text = words.join(" ");
        if let Ok(script) = Script::parse(&text, &UNITS, &EXTENDED) {
            prop_assert!(steps_to_the_end(script, replies) > 0);
        }
    }

    #[test]
    fn every_script_ends(statements in prop::collection::vec(statement(), 0..30), replies: bool) {
        let mut text = String::new();
        let mut depth = 0;
        for statement in statements {
            match statement.as_str() {
                "end" if depth == 0 => continue,
                "end" => depth -= 1,
                word if word.starts_with("repeat") && depth == 4 => continue,
                word if word.starts_with("repeat") => depth += 1,
                _ => {}
            }
            text += &statement;
            text.push('\n');
        }
        text += &"end\n".repeat(depth);
        match Script::parse(&text, &UNITS, &EXTENDED) {
            Ok(script) => prop_assert!(steps_to_the_end(script, replies) > 0),
            Err(error) => prop_assert_eq!(error.fault(), ScriptFault::TooLong),
        }
    }
}
