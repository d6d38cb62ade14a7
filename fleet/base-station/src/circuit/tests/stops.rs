//! A stop that may not have been read is said again.

use super::*;

#[test]
fn a_robot_may_move_until_it_has_read_a_stop() {
    let mut circuit = writable();
    assert!(!circuit.may_move());
    circuit.send(frame("motor", &[5, 5])).unwrap();
    all(&mut circuit, 1);
    circuit.send(frame("null", &[])).unwrap();
    all(&mut circuit, 1);
    circuit.take(1, Input::Bytes(b"00"));
    assert!(circuit.may_move(), "it has read that it is to move");
    circuit.send(frame("motor", &[0, 0])).unwrap();
    all(&mut circuit, 2);
    assert!(
        !circuit.is_in_motion() && circuit.may_move(),
        "it is only written"
    );
    circuit.take(3, Input::Ended(End::Closed));
    assert!(
        circuit.may_move(),
        "it was on its way when the connection was lost"
    );
    // What it answers on the next connection says nothing of that one.
    let now = circuit.next_wake().expect("it tries again");
    take(&mut circuit, now, Input::Time);
    take(&mut circuit, now, Input::Connected);
    assert_eq!(written(&mut circuit, now), "00");
    circuit.take(now, Input::Bytes(b"00"));
    // So it is said again.
    assert_eq!(written(&mut circuit, now), "06 00000 00000|00");
    assert!(circuit.may_move() && !circuit.is_stop_heard());
    circuit.take(now, Input::Bytes(b"00"));
    assert!(!circuit.may_move() && circuit.is_stop_heard());
}

/// Motion that a robot was told and did not get is late by then; a stop is not.
#[test]
fn a_stop_that_finds_no_connection_is_said_first_on_the_next_one_and_no_motion_is() {
    for (commands, said) in [(&[[5, 5]][..], "00"), (&[[5, 5], [0, 0]], "00|06 00000 00000|00")] {
        let mut circuit = writable();
        circuit.take(1, Input::Ended(End::Closed));
        all(&mut circuit, 1);
        for speeds in commands {
            let refused = circuit.send(frame("motor", speeds));
            assert_eq!(refused, Err(Refusal::NotWritable(State::Trying)));
        }
        // A stop is not kept until the pause is over.
        let tries = all(&mut circuit, 1).contains(&Output::Connect);
        assert_eq!(tries, said.contains("06"));
        let now = if tries {
            1
        } else {
            circuit.next_wake().expect("it tries again")
        };
        take(&mut circuit, now, Input::Time);
        take(&mut circuit, now, Input::Connected);
        circuit.take(now, Input::Bytes(b"00"));
        assert_eq!(written(&mut circuit, now + SECOND), said);
    }
}

/// One that waits behind others when the connection is lost is said on the next one, unless motion was told behind it.
#[test]
fn the_last_word_that_waited_is_said_again_if_it_is_a_stop() {
    for (last, owed) in [([0, 0], true), ([9, 9], false)] {
        let mut circuit = writable();
        circuit.send(frame("motor", &[5, 5])).unwrap();
        all(&mut circuit, 1);
        circuit.take(1, Input::Blocked);
        circuit.send(frame("motor", &[0, 0])).unwrap();
        circuit.send(frame("motor", &last)).unwrap();
        circuit.take(2, Input::Ended(End::Closed));
        all(&mut circuit, 2);
        let now = circuit.next_wake().expect("it tries again");
        take(&mut circuit, now, Input::Time);
        take(&mut circuit, now, Input::Connected);
        all(&mut circuit, now);
        circuit.take(now, Input::Bytes(b"00"));
        assert_eq!(written(&mut circuit, now).starts_with("06 00000 00000"), owed);
    }
}
