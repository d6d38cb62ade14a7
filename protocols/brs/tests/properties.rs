//! What holds for all frames and for any bytes.

mod any_bytes;

use any_bytes::any_bytes;
use mom_brs::file::EXTENDED;
use mom_brs::{Direction, Frame, Parser};
use proptest::collection::vec;
use proptest::prelude::*;

/// Any frame of our own robots, in a direction, with values in and out of range.
fn frames(direction: Direction) -> impl Strategy<Value = Frame> {
    let said: Vec<_> = EXTENDED
        .commands()
        .iter()
        .filter_map(|command| Some((command, command.said(direction)?.len())))
        .collect();
    let said = prop::sample::select(said);
    said.prop_flat_map(move |(command, parameters)| {
        vec(-12_000..120_000, parameters)
            .prop_map(move |values| Frame::said(command, direction, &values).expect("as many as it takes"))
    })
}

fn directions() -> impl Strategy<Value = Direction> {
    prop_oneof![Just(Direction::Command), Just(Direction::Reply)]
}

/// Frames as they are written, with some bytes lost, changed and added.
fn damaged() -> impl Strategy<Value = Vec<u8>> {
    let frames = directions().prop_flat_map(|direction| vec(frames(direction), 0..12));
    (
        frames,
        vec((any::<prop::sample::Index>(), 0..3, any::<u8>()), 0..6),
    )
        .prop_map(|(frames, damages)| {
            let mut bytes: Vec<u8> = frames.iter().flat_map(|frame| frame.encode().to_vec()).collect();
            for (at, kind, byte) in damages {
                let at = at.index(bytes.len() + 1);
                match kind {
                    0 => bytes.insert(at, byte),
                    1 if at < bytes.len() => drop(bytes.remove(at)),
                    _ if at < bytes.len() => bytes[at] = b" -0123456789"[usize::from(byte) % 12],
                    _ => {}
                }
            }
            bytes
        })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn frames_are_read_as_they_were_written(
        frames in directions().prop_flat_map(|direction| (Just(direction), vec(frames(direction), 0..20)))
    ) {
        let (direction, frames) = frames;
        let bytes: Vec<u8> = frames.iter().flat_map(|frame| frame.encode().to_vec()).collect();
        let mut parser = Parser::new(&EXTENDED, direction);
        let read: Vec<(&str, Vec<i32>)> =
            parser.feed(&bytes).map(|frame| (frame.command().name, frame.values().to_vec())).collect();
        let written: Vec<(&str, Vec<i32>)> =
            frames.iter().map(|frame| (frame.command().name, frame.values().to_vec())).collect();
        prop_assert_eq!(read, written);
        prop_assert!(parser.faults().is_none(), "what was clamped once is in range");
    }

    #[test]
    fn values_are_in_range_whatever_was_given(frame in directions().prop_flat_map(frames)) {
        for (parameter, value) in frame.parameters().iter().zip(frame.values()) {
            prop_assert!((parameter.min..=parameter.max).contains(value), "{:?}", frame);
        }
        prop_assert_eq!(Some(frame.encode().len()), frame.command().length(frame.direction()));
    }

    #[test]
    fn any_bytes_are_read_by_the_rules(data in vec(any::<u8>(), 0..200)) {
        any_bytes(&data);
    }

    #[test]
    fn damaged_frames_are_read_by_the_rules(choice in 0_u8..4, cuts: u8, bytes in damaged()) {
        let mut data = vec![choice, cuts];
        data.extend(bytes);
        any_bytes(&data);
    }
}
