//! When a robot is left: it floods, answers what nobody asks, or is silent while a station listens.

use super::*;

/// By codes that nobody knows, which are no reason to leave it: the rate is.
#[test]
fn of_a_robot_that_floods_no_more_is_read_than_the_rate_and_it_is_left_for_long() {
    let mut circuit = writable();
    let mut read = 0;
    let mut now = SECOND;
    let mut wakes = 0;
    while circuit.state() == State::Writable {
        let may = circuit.may_read(now);
        if may == 0 {
            now = circuit.next_wake().unwrap().max(now + 1);
            circuit.take(now, Input::Time);
            wakes += 1;
        } else {
            let bytes = vec![b'5'; may.min(512)];
            read += bytes.len();
            circuit.take(now, Input::Bytes(&bytes));
        }
        all(&mut circuit, now);
        assert!(now < 6 * SECOND, "it stays for good");
    }
    assert_eq!(circuit.last_end(), Some(&End::Flooding));
    assert!(
        (3 * 4096..=5 * 4096).contains(&read) && wakes < 60,
        "{read}, {wakes}"
    );
    assert!(circuit.next_wake().unwrap() >= now + 8 * SECOND, "not at once");
    // Who says much at once, and then goes on in order, is not a flood.
    let mut circuit = writable();
    circuit.take(SECOND, Input::Bytes(&[b'5'; 4096]));
    circuit.take(10 * SECOND, Input::Bytes(&[b'5'; 100]));
    assert_eq!(circuit.state(), State::Writable);
}

#[test]
fn a_robot_that_answers_what_nobody_asks_is_left() {
    let mut circuit = writable();
    // One that says something unasked now and then, and answers, is borne.
    for at in 0..500 {
        for _ in 0..2 {
            circuit.send(frame("status", &[])).unwrap();
        }
        all(&mut circuit, at * MS);
        circuit.take(at * MS, Input::Bytes(b"04 0000504 0000504 00005"));
    }
    assert_eq!(circuit.state(), State::Writable);
    for at in 500..600 {
        circuit.take(at * MS, Input::Bytes(b"04 00005"));
    }
    assert_eq!(circuit.last_end(), Some(&End::Flooding));
}

/// As a station that is stopped, or has no processor: what the robot answered meanwhile lies there.
#[test]
fn a_robot_is_not_silent_while_nobody_listens() {
    let mut circuit = writable();
    circuit.take(10 * SECOND, Input::Time);
    assert_eq!(written(&mut circuit, 10 * SECOND), "00");
    circuit.take(100 * SECOND, Input::Time);
    assert_eq!(circuit.state(), State::Writable);
    circuit.take(100 * SECOND, Input::Bytes(b"00"));
    assert_eq!(circuit.round_trip(), Some(90 * SECOND));
    // What it leaves unanswered from then on is counted as ever.
    all(&mut circuit, 100 * SECOND);
    while circuit.state() == State::Writable {
        let wake = circuit.next_wake().unwrap();
        assert!(wake <= 130 * SECOND, "it is silent");
        circuit.take(wake, Input::Time);
        all(&mut circuit, wake);
    }
    assert_eq!(circuit.last_end(), Some(&End::Silent));
}
