//! What a circuit does, step by step, and that no order of inputs makes it do what it must not.

use mom_brs::{PAPER, file::EXTENDED};
use proptest::prelude::*;

use super::*;

mod patience;
mod stops;

const MS: i64 = 1000;

/// Takes an input after all outputs were carried out, as a driver does.
fn take(circuit: &mut Circuit, now: i64, input: Input<'_>) {
    all(circuit, now);
    circuit.take(now, input);
}

fn circuit() -> Circuit {
    Circuit::new(&EXTENDED, Options::default(), 1)
}

/// All that it asks for at a time, without notes.
fn asked(circuit: &mut Circuit, now: i64) -> Vec<Output> {
    let note = |output: &Output| !matches!(output, Output::Note(_));
    all(circuit, now).into_iter().filter(note).collect()
}

fn all(circuit: &mut Circuit, now: i64) -> Vec<Output> {
    std::iter::from_fn(|| circuit.poll(now)).collect()
}

fn written(circuit: &mut Circuit, now: i64) -> String {
    let written = asked(circuit, now);
    let text = |output: &Output| match output {
        Output::Write(bytes) => bytes.as_str().to_owned(),
        other => panic!("{other:?}"),
    };
    written.iter().map(text).collect::<Vec<_>>().join("|")
}

fn frame(name: &str, values: &[i32]) -> Frame {
    Frame::new(EXTENDED.command(name).unwrap(), values).unwrap()
}

/// A circuit that became writable at time 0.
fn writable() -> Circuit {
    let mut circuit = circuit();
    take(&mut circuit, 0, Input::Connect);
    take(&mut circuit, 0, Input::Connected);
    assert_eq!(written(&mut circuit, 0), "00");
    circuit.take(0, Input::Bytes(b"00"));
    all(&mut circuit, 0);
    assert_eq!(circuit.state(), State::Writable);
    circuit
}

#[test]
fn it_goes_through_the_states_of_the_paper() {
    let mut circuit = circuit();
    assert_eq!(
        (circuit.state(), circuit.next_wake()),
        (State::Disconnected, None)
    );
    circuit.take(0, Input::Connect);
    assert_eq!(circuit.state(), State::Trying);
    assert_eq!(
        all(&mut circuit, 0),
        [Output::Connect, Output::Note(Note::State(State::Trying))]
    );
    circuit.take(MS, Input::Connected);
    assert_eq!(circuit.state(), State::Connected);
    assert_eq!(written(&mut circuit, MS), "00");
    circuit.take(7 * MS, Input::Bytes(b"00"));
    assert_eq!(
        (circuit.state(), circuit.round_trip()),
        (State::Writable, Some(6 * MS))
    );
    circuit.take(8 * MS, Input::Disconnect);
    assert_eq!(circuit.state(), State::Disconnected);
    assert_eq!(asked(&mut circuit, 8 * MS), [Output::Close]);
    assert_eq!(circuit.next_wake(), None);
}

#[test]
fn a_null_leaves_every_ten_seconds_and_its_round_trip_is_measured_in_order() {
    let mut circuit = writable();
    assert_eq!(circuit.next_wake(), Some(10 * SECOND));
    assert_eq!(written(&mut circuit, 10 * SECOND - 1), "");
    assert_eq!(written(&mut circuit, 10 * SECOND), "00");
    circuit.send(frame("null", &[])).unwrap();
    assert_eq!(written(&mut circuit, 11 * SECOND), "00");
    circuit.take(12 * SECOND, Input::Bytes(b"0000"));
    let trips: Vec<Output> = all(&mut circuit, 12 * SECOND);
    let trip = |micros| {
        Output::Note(Note::Received(
            Frame::reply(&Command::NULL, &[]).unwrap(),
            Some(micros),
        ))
    };
    assert_eq!(trips, [trip(2 * SECOND), trip(SECOND)]);
    assert_eq!(circuit.faults().unasked, 0);
    circuit.take(12 * SECOND, Input::Bytes(b"00"));
    assert_eq!(
        (circuit.faults().unasked, circuit.round_trip()),
        (1, Some(SECOND))
    );
}

#[test]
fn a_robot_that_leaves_a_null_unanswered_for_three_periods_is_silent() {
    let mut circuit = writable();
    let mut nulls = Vec::new();
    while circuit.state() == State::Writable {
        let wake = circuit.next_wake().unwrap();
        circuit.take(wake, Input::Time);
        match asked(&mut circuit, wake).as_slice() {
            [Output::Write(_)] => nulls.push(wake / SECOND),
            outputs => assert_eq!((outputs, wake), (&[Output::Abort][..], 40 * SECOND)),
        }
    }
    assert_eq!(
        (nulls, circuit.last_end()),
        (vec![10, 20, 30], Some(&End::Silent))
    );
    assert_eq!(circuit.state(), State::Trying);
}

#[test]
fn a_robot_that_reads_nothing_for_three_periods_is_silent() {
    let mut circuit = writable();
    circuit.take(SECOND, Input::Blocked);
    assert_eq!(
        (circuit.state(), circuit.next_wake()),
        (State::Connected, Some(31 * SECOND))
    );
    circuit.take(31 * SECOND, Input::Time);
    assert_eq!(circuit.last_end(), Some(&End::Silent));
}

#[test]
fn attempts_come_after_half_a_second_doubling_to_ten() {
    let mut circuit = circuit();
    take(&mut circuit, 0, Input::Connect);
    let mut now = 0;
    for most in [500, 1000, 2000, 4000, 8000, 10_000, 10_000] {
        take(
            &mut circuit,
            now,
            Input::Ended(End::Unreachable("refused".into())),
        );
        assert_eq!(circuit.state(), State::Trying);
        all(&mut circuit, now);
        let wake = circuit.next_wake().unwrap();
        let pause = wake - now;
        assert!(
            (most * MS * 4 / 5..=most * MS).contains(&pause),
            "{pause} of {most}"
        );
        assert_eq!(asked(&mut circuit, wake - 1), []);
        now = wake;
        take(&mut circuit, now, Input::Time);
        assert_eq!(asked(&mut circuit, now), [Output::Connect]);
    }
    // A robot that accepts and says nothing is not a success; one that speaks is.
    for (heard, most) in [(false, 10_000), (true, 500)] {
        take(&mut circuit, now, Input::Connected);
        if heard {
            take(&mut circuit, now, Input::Bytes(b"00"));
        }
        take(&mut circuit, now, Input::Ended(End::Closed));
        all(&mut circuit, now);
        let wake = circuit.next_wake().unwrap();
        assert!((most * MS * 4 / 5..=most * MS).contains(&(wake - now)));
        now = wake;
        take(&mut circuit, now, Input::Time);
    }
}

/// What a robot says before it closes, as it has a base station already, is not a success.
#[test]
fn a_robot_that_says_who_holds_it_is_never_writable_and_tried_ever_more_seldom() {
    let options = Options {
        attempts: Some(5),
        ..Options::default()
    };
    let mut circuit = Circuit::new(&EXTENDED, options, 1);
    take(&mut circuit, 0, Input::Connect);
    let mut now = 0;
    for most in [500, 1000, 2000, 4000] {
        take(&mut circuit, now, Input::Connected);
        take(&mut circuit, now, Input::Bytes(b"90 00192 00168 00001 00020"));
        assert_eq!(circuit.state(), State::Connected);
        let refusal = Refusal::NotWritable(State::Connected);
        assert_eq!(circuit.send(frame("motor", &[1, 1])), Err(refusal));
        assert_eq!(circuit.halt(), Err(refusal));
        take(&mut circuit, now, Input::Ended(End::Closed));
        let pause = circuit.next_wake().unwrap() - now;
        assert!(
            (most * MS * 4 / 5..=most * MS).contains(&pause),
            "{pause} of {most}"
        );
        now += pause;
        take(&mut circuit, now, Input::Time);
    }
    take(&mut circuit, now, Input::Connected);
    take(&mut circuit, now, Input::Bytes(b"90 00192 00168 00001 00020"));
    take(&mut circuit, now, Input::Ended(End::Closed));
    assert_eq!(circuit.state(), State::Disconnected, "these were all attempts");
    assert!(
        all(&mut circuit, now)
            .iter()
            .all(|output| !matches!(output, Output::Note(Note::State(State::Writable)))),
    );
}

#[test]
fn robots_of_other_seeds_pause_otherwise_and_the_same_seed_alike() {
    let pause = |seed| {
        let mut circuit = Circuit::new(&PAPER, Options::default(), seed);
        take(&mut circuit, 0, Input::Connect);
        take(&mut circuit, 0, Input::Ended(End::Closed));
        circuit.next_wake()
    };
    assert_eq!(pause(1), pause(1));
    assert_ne!(pause(1), pause(2));
}

#[test]
fn an_attempt_that_takes_too_long_ends() {
    let mut circuit = circuit();
    circuit.take(0, Input::Connect);
    all(&mut circuit, 0);
    assert_eq!(circuit.next_wake(), Some(5 * SECOND));
    circuit.take(5 * SECOND, Input::Time);
    assert_eq!(asked(&mut circuit, 5 * SECOND), [Output::Close]);
    assert_eq!(circuit.last_end(), Some(&End::TimedOut));
    circuit.take(5 * SECOND, Input::Connected);
    assert_eq!(circuit.state(), State::Trying, "it is too late");
}

#[test]
fn it_gives_up_after_as_many_attempts_as_it_may_make() {
    let options = Options {
        attempts: Some(2),
        ..Options::default()
    };
    let mut circuit = Circuit::new(&PAPER, options, 1);
    take(&mut circuit, 0, Input::Connect);
    take(&mut circuit, 0, Input::Ended(End::Closed));
    assert_eq!(circuit.state(), State::Trying);
    take(&mut circuit, SECOND, Input::Time);
    take(&mut circuit, SECOND, Input::Ended(End::Closed));
    assert_eq!(circuit.state(), State::Disconnected);
    take(&mut circuit, SECOND, Input::Connect);
    assert_eq!(circuit.state(), State::Trying, "asked again");
}

#[test]
fn commands_leave_byte_for_byte_those_of_the_extended_table_too() {
    let mut circuit = writable();
    for (name, values) in [
        ("motor", &[50, -50][..]),
        ("leds", &[255]),
        ("goto", &[1000, 500]),
        ("pose", &[]),
    ] {
        assert_eq!(circuit.send(frame(name, values)), Ok(Taken::Queued));
    }
    assert_eq!(
        written(&mut circuit, 1),
        "06 00050 -0050|07 00255|10 01000 00500|12"
    );
    circuit.take(2, Input::Bytes(b"12 01000 00500 00090"));
    let [Output::Note(Note::Received(pose, None))] = &all(&mut circuit, 2)[..] else {
        panic!("one reply")
    };
    assert_eq!(format!("{pose:#}"), "pose x=1000 y=500 heading=90");
}

#[test]
fn nothing_is_sent_to_a_robot_that_has_not_spoken_and_nothing_waits_for_the_next_connection() {
    let mut circuit = circuit();
    let motor = frame("motor", &[1, 1]);
    assert_eq!(
        circuit.send(motor),
        Err(Refusal::NotWritable(State::Disconnected))
    );
    take(&mut circuit, 0, Input::Connect);
    take(&mut circuit, 0, Input::Connected);
    assert_eq!(circuit.send(motor), Err(Refusal::NotWritable(State::Connected)));
    take(&mut circuit, 0, Input::Bytes(b"00"));
    take(&mut circuit, 0, Input::Blocked);
    assert_eq!(circuit.send(motor), Ok(Taken::Queued));
    take(&mut circuit, 0, Input::Ended(End::Closed));
    assert_eq!((circuit.waiting(), circuit.is_in_motion()), (0, false));
    take(&mut circuit, SECOND, Input::Time);
    take(&mut circuit, SECOND, Input::Connected);
    assert_eq!(written(&mut circuit, SECOND), "00");
    circuit.take(SECOND, Input::Bytes(b"00"));
    assert_eq!(written(&mut circuit, SECOND), "");
    let reply = Frame::reply(&Command::NULL, &[]).unwrap();
    assert_eq!(circuit.send(reply), Err(Refusal::NoCommand));
}

#[test]
fn in_a_full_queue_a_motor_replaces_the_newest_that_waits_and_others_are_refused() {
    let mut circuit = writable();
    circuit.take(1, Input::Blocked);
    circuit.send(frame("motor", &[1, 1])).unwrap();
    circuit.send(frame("motor", &[2, 2])).unwrap();
    for _ in 2..MOST_WAITING {
        assert_eq!(circuit.send(frame("leds", &[1])), Ok(Taken::Queued));
    }
    assert_eq!(circuit.send(frame("leds", &[2])), Err(Refusal::Full));
    assert_eq!(circuit.send(frame("motor", &[3, 3])), Ok(Taken::Replaced(1)));
    assert_eq!(circuit.waiting(), MOST_WAITING);
    circuit.take(2, Input::Unblocked);
    let frames = written(&mut circuit, 2);
    assert!(
        frames.starts_with("06 00001 00001|06 00003 00003|07 00001|"),
        "{frames}"
    );
}

/// Else the robot would stand, and then drive off.
#[test]
fn a_stop_drops_the_motion_that_waits_and_goes_after_the_rest() {
    for full in [false, true] {
        let mut circuit = writable();
        circuit.take(1, Input::Blocked);
        for (name, values) in [
            ("motor", &[1, 1][..]),
            ("leds", &[1]),
            ("goto", &[1, 1]),
            ("via", &[2, 2]),
            ("pose", &[]),
        ] {
            circuit.send(frame(name, values)).unwrap();
        }
        while full && circuit.waiting() < MOST_WAITING {
            circuit.send(frame("via", &[3, 3])).unwrap();
        }
        let dropped = circuit.waiting() - 2;
        let stop = frame("motor", &[0, 0]);
        assert_eq!(circuit.send(stop), Ok(Taken::Replaced(dropped)));
        // A stop that waits is dropped for the next one, too.
        assert_eq!(circuit.send(stop), Ok(Taken::Replaced(1)));
        circuit.send(frame("goto", &[4, 4])).unwrap();
        circuit.take(2, Input::Unblocked);
        assert_eq!(
            written(&mut circuit, 2),
            "07 00001|12|06 00000 00000|10 00004 00004"
        );
    }
}

#[test]
fn a_stop_has_its_place_in_a_queue_that_is_full_of_other_commands() {
    let mut circuit = writable();
    circuit.take(1, Input::Blocked);
    while circuit.send(frame("leds", &[1])).is_ok() {}
    let stop = frame("motor", &[0, 0]);
    assert_eq!(circuit.send(stop), Ok(Taken::Queued));
    assert_eq!(circuit.send(stop), Ok(Taken::Replaced(1)));
    assert_eq!(circuit.send(frame("leds", &[1])), Err(Refusal::Full));
    assert_eq!(circuit.waiting(), MOST_WAITING + 1);
    circuit.take(2, Input::Unblocked);
    assert!(written(&mut circuit, 2).ends_with("|07 00001|06 00000 00000"));
}

#[test]
fn without_a_waiting_motor_a_full_queue_refuses_a_motor_too() {
    let mut circuit = writable();
    circuit.take(1, Input::Blocked);
    for _ in 0..MOST_WAITING {
        circuit.send(frame("leds", &[1])).unwrap();
    }
    assert_eq!(circuit.send(frame("motor", &[3, 3])), Err(Refusal::Full));
    circuit.halt().unwrap();
    circuit.take(2, Input::Unblocked);
    assert_eq!(
        written(&mut circuit, 2),
        "06 00000 00000|00",
        "to halt drops all that waits, and asks whether it was read"
    );
    assert!(!circuit.is_stop_heard(), "it is only written");
    circuit.take(3, Input::Bytes(b"00"));
    assert!(circuit.is_stop_heard());
}

#[test]
fn nulls_without_replies_are_bounded() {
    let mut circuit = writable();
    for _ in 0..MOST_UNANSWERED {
        circuit.send(frame("null", &[])).unwrap();
        all(&mut circuit, 1);
    }
    assert_eq!(circuit.send(frame("null", &[])), Err(Refusal::Unanswered));
    assert_eq!(written(&mut circuit, 20 * SECOND), "");
    assert_eq!(circuit.next_wake(), Some(30 * SECOND + 1), "it does not spin");
}

#[test]
fn it_knows_whether_the_robot_was_set_in_motion() {
    let mut circuit = writable();
    for (name, values, moving) in [
        ("leds", &[1][..], false),
        ("motor", &[0, -1], true),
        ("status", &[], true),
        ("motor", &[0, 0], false),
        ("goto", &[1, 1], true),
    ] {
        circuit.send(frame(name, values)).unwrap();
        all(&mut circuit, 1);
        assert_eq!(circuit.is_in_motion(), moving, "{name} {values:?}");
    }
    circuit.take(1, Input::Ended(End::Closed));
    assert!(circuit.is_in_motion(), "a lost connection stops no motor");
}

#[test]
fn silence_within_a_frame_drops_it_and_faults_outlive_the_connection() {
    let mut circuit = writable();
    circuit.take(MS, Input::Bytes(b"04 000"));
    assert_eq!(circuit.next_wake(), Some(201 * MS));
    circuit.take(201 * MS, Input::Time);
    assert_eq!(
        circuit.faults(),
        Faults {
            bytes: 6,
            cut: 1,
            ..Faults::default()
        }
    );
    circuit.take(202 * MS, Input::Bytes(b"04 00005"));
    assert_eq!(circuit.status(), Some(5));
    circuit.take(203 * MS, Input::Bytes(b"77 00001!04 99999"));
    circuit.take(204 * MS, Input::Ended(End::Closed));
    let faults = circuit.faults();
    assert_eq!((faults.unknown, faults.bytes, faults.cut), (1, 6 + 8 + 1, 1));
}

#[test]
fn a_robot_that_is_not_understood_is_left() {
    let mut circuit = writable();
    // What a person types, or a line end after each answer, harms nobody.
    for at in 0..100 {
        circuit.send(frame("status", &[])).unwrap();
        all(&mut circuit, at * MS);
        circuit.take(at * MS, Input::Bytes(b"04 00005\r\n"));
    }
    circuit.take(SECOND, Input::Bytes(&[b'?'; 60]));
    assert_eq!(circuit.state(), State::Writable);
    // An answer to a NULL that is found in the middle of it proves nothing.
    circuit.take(SECOND, Input::Bytes(b"?00"));
    circuit.take(SECOND, Input::Bytes(b"????????"));
    assert_eq!(asked(&mut circuit, SECOND).last(), Some(&Output::Abort));
    assert_eq!(
        (circuit.last_end(), circuit.state()),
        (Some(&End::Astray), State::Trying)
    );
}

#[test]
fn what_an_older_connection_says_is_nothing_to_the_next_one() {
    let mut circuit = writable();
    circuit.take(1, Input::Disconnect);
    circuit.take(1, Input::Connect);
    // The driver has not closed the first one yet.
    circuit.take(1, Input::Connected);
    circuit.take(1, Input::Bytes(b"00"));
    circuit.take(1, Input::Ended(End::Closed));
    assert_eq!(circuit.state(), State::Trying);
    assert_eq!(asked(&mut circuit, 1), [Output::Close, Output::Connect]);
    circuit.take(2, Input::Connected);
    assert_eq!(circuit.state(), State::Connected);
}

#[derive(Clone, Debug)]
enum Step {
    Input(Input<'static>),
    Wake,
    Wait(i64),
    Send(Frame),
    Halt,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        Just(Step::Input(Input::Connect)),
        Just(Step::Input(Input::Disconnect)),
        Just(Step::Input(Input::Connected)),
        Just(Step::Input(Input::Ended(End::Closed))),
        Just(Step::Input(Input::Bytes(b"00"))),
        Just(Step::Input(Input::Bytes(b"04 00001"))),
        Just(Step::Input(Input::Bytes(b"04 0"))),
        Just(Step::Input(Input::Bytes(b"06 zz"))),
        Just(Step::Input(Input::Blocked)),
        Just(Step::Input(Input::Unblocked)),
        Just(Step::Wake),
        (0..20 * SECOND).prop_map(Step::Wait),
        Just(Step::Send(frame("motor", &[1, 2]))),
        Just(Step::Send(frame("motor", &[0, 0]))),
        Just(Step::Send(frame("null", &[]))),
        Just(Step::Send(frame("leds", &[7]))),
        Just(Step::Halt),
    ]
}

proptest! {
    /// Connect and Close alternate as a socket needs it, writes are only on a connection that takes them, all is
    /// bounded, and waking always leads on.
    #[test]
    fn no_order_of_inputs_breaks_it(seed: u64, steps in prop::collection::vec(step(), 0..200)) {
        let mut circuit = Circuit::new(&EXTENDED, Options::default(), seed);
        let (mut now, mut open, mut blocked) = (0, false, false);
        for step in steps {
            match step {
                Step::Input(input) => {
                    // A driver tells nothing of a socket that it does not have.
                    let of_socket = !matches!(input, Input::Connect | Input::Disconnect);
                    if of_socket && !open { continue }
                    if matches!(input, Input::Ended(_)) { open = false }
                    if matches!(input, Input::Blocked) { blocked = circuit.state().is_up() }
                    if matches!(input, Input::Unblocked) { blocked = false }
                    circuit.take(now, input);
                }
                Step::Wake => {
                    if let Some(wake) = circuit.next_wake() { now = now.max(wake) }
                    circuit.take(now, Input::Time);
                }
                Step::Wait(micros) => { now += micros; circuit.take(now, Input::Time) }
                Step::Send(frame) => {
                    let state = circuit.state();
                    let sent = circuit.send(frame);
                    prop_assert!(sent.is_err() || state.is_up());
                }
                Step::Halt => { let _ = circuit.halt(); }
            }
            let mut told = None;
            for output in all(&mut circuit, now) {
                match output {
                    Output::Connect => { prop_assert!(!open); open = true; blocked = false }
                    Output::Close | Output::Abort => { prop_assert!(open); open = false; blocked = false }
                    Output::Write(_) => prop_assert!(open && !blocked && circuit.state().is_up()),
                    Output::Note(Note::State(state)) => told = Some(state),
                    Output::Note(_) => {}
                }
            }
            prop_assert!(told.is_none_or(|told| told == circuit.state()));
            prop_assert!(circuit.waiting() <= MOST_WAITING + 1);
            prop_assert_eq!(circuit.next_wake().is_none(), circuit.state() == State::Disconnected);
            prop_assert!(circuit.next_wake().is_none_or(|wake| wake > now), "it would spin");
        }
    }
}
