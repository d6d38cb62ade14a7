//! A link that is lost at any byte: what must not be lost arrives once, in its order, and both ends count the same.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Encoded, Form, Frame};
use mom_proto::{Delivery, Family, Limits, Parcel, Value};
use proptest::prelude::*;

use super::super::{BadCount, DropReason, Lane, Ledger, Rewound};
use super::{Packet, Queue, frame, queue};
use crate::Allowance;

/// The link as it is at one end, with what the other end has made of it.
struct Link {
    queue: Queue,
    ledger: Ledger<Packet>,
    batch: VecDeque<super::Piece>,
    bytes: BytesMut,
    decoder: BinaryDecoder,
    /// The numbers of what has arrived.
    arrived: Vec<i64>,
    read: u64,
}

fn decoder() -> (BinaryDecoder, BytesMut) {
    (
        BinaryDecoder::for_peer(&Limits::default()),
        BytesMut::from(&PREFACE[..]),
    )
}

impl Link {
    fn new(limit: usize) -> Link {
        let (decoder, bytes) = decoder();
        let mut link = Link {
            queue: queue(1 << 24),
            ledger: Ledger::after_next(limit),
            batch: VecDeque::new(),
            bytes,
            decoder,
            arrived: Vec::new(),
            read: 0,
        };
        link.push(message(0, 0, 10, Delivery::Reliable));
        link.write(usize::MAX, 4096);
        assert_eq!(
            (link.ledger.sent(), link.read),
            (0, 1),
            "the reply to the login does not count"
        );
        link.read = 0;
        link.arrived.clear();
        link
    }

    fn push(&mut self, packet: Packet) {
        self.queue.push(Arc::new(packet));
    }

    /// The network takes so many bytes, in pieces of about this size.
    fn write(&mut self, mut bytes: usize, piece: usize) {
        let allowance = Allowance {
            bytes: usize::MAX,
            piece,
        };
        while bytes > 0 {
            self.queue.take(0, allowance, &mut self.batch);
            let Some(front) = self.batch.front_mut() else {
                break;
            };
            let mut slices = Vec::new();
            front.append_to(Some(Form::Binary), &mut slices);
            let mut written = 0;
            for slice in slices {
                let taken = slice.len().min(bytes - written);
                self.bytes.extend_from_slice(&slice[..taken]);
                written += taken;
            }
            bytes -= written;
            front.advance(written);
            if front.left() == 0 {
                self.ledger.note(front, Some(Form::Binary));
                self.batch.pop_front();
            }
            self.queue.put_back_all(&mut self.batch);
        }
        while let Some(frame) = self.decoder.decode(&mut self.bytes).expect("frames") {
            let Frame::Parcel(parcel) = frame else {
                panic!("{frame:?}")
            };
            self.read += 1;
            self.arrived
                .push(i64::try_from(parcel.id.expect("a number")).expect("a small one"));
        }
    }

    fn acknowledge(&mut self) {
        self.queue
            .acknowledge(&mut self.ledger, self.read)
            .expect("a count that can be");
    }

    /// The connection is lost, and resumed.
    fn lose(&mut self) -> Rewound {
        self.queue.restart(&mut self.ledger);
        (self.decoder, self.bytes) = decoder();
        let rewound = self
            .queue
            .resend(&mut self.ledger, self.read)
            .expect("a count that can be");
        assert_eq!(self.ledger.sent(), self.read);
        rewound
    }
}

fn parcel(number: u64, size: usize) -> Encoded {
    let content = Value::from(Bytes::from(vec![7; size]));
    let parcel = Parcel::new(Family::Message, "command")
        .id(number)
        .content(content);
    Form::Binary.encode(&parcel).expect("a frame")
}

fn message(number: u64, priority: i32, size: usize, delivery: Delivery) -> Packet {
    let name = format!("{number}");
    frame(
        &name,
        Lane::Data(priority),
        delivery,
        parcel(number, size).to_vec(),
    )
}

fn control(number: u64, size: usize) -> Packet {
    Packet {
        lane: Lane::Control,
        ..message(number, 0, size, Delivery::Reliable)
    }
}

/// So many messages as one.
fn run(first: u64, count: u32, size: usize) -> Packet {
    let frames = (first..first + u64::from(count)).flat_map(|number| parcel(number, size).to_vec());
    Packet {
        count,
        ..frame("run", Lane::Data(0), Delivery::Reliable, frames.collect())
    }
}

#[derive(Clone, Debug)]
enum Step {
    Say(usize),
    SayRun(u32, usize),
    SayLatest,
    Tell(usize),
    Write(usize, usize),
    Acknowledge,
    Lose,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        4 => (1..20_000usize).prop_map(Step::Say),
        4 => (2..50u32, 1..100usize).prop_map(|(count, size)| Step::SayRun(count, size)),
        1 => Just(Step::SayLatest),
        2 => (1..5000usize).prop_map(Step::Tell),
        8 => (1..6000usize, 100..5000usize).prop_map(|(bytes, piece)| Step::Write(bytes, piece)),
        2 => Just(Step::Acknowledge),
        3 => Just(Step::Lose),
    ];
    proptest::collection::vec(step, 1..60)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn whatever_is_lost_where_each_parcel_arrives_once(steps in steps()) {
        let mut link = Link::new(usize::MAX);
        let (mut next, mut spoken, mut told, mut latest) = (1u64, Vec::new(), Vec::new(), Vec::new());
        let mut dropped = 0;
        for step in steps.into_iter().chain([Step::Lose, Step::Write(usize::MAX, 4096)]) {
            match step {
                Step::Say(size) => {
                    link.push(message(next, 0, size, Delivery::Reliable));
                    spoken.push(next.cast_signed());
                    next += 1;
                }
                Step::SayRun(count, size) => {
                    link.push(run(next, count, size));
                    spoken.extend((next..next + u64::from(count)).map(u64::cast_signed));
                    next += u64::from(count);
                }
                Step::SayLatest => {
                    link.push(message(next, 0, 2000, Delivery::Latest));
                    latest.push(next.cast_signed());
                    next += 1;
                }
                Step::Tell(size) => {
                    link.push(control(next, size));
                    told.push(next.cast_signed());
                    next += 1;
                }
                Step::Write(bytes, piece) => link.write(bytes, piece),
                Step::Acknowledge => link.acknowledge(),
                Step::Lose => match link.lose() {
                    Rewound::Dropped(count) => dropped += count,
                    lost @ Rewound::Lost(_) => panic!("{lost:?}"),
                },
            }
        }
        let of = |list: &[i64]| -> Vec<i64> {
            link.arrived.iter().copied().filter(|number| list.contains(number)).collect()
        };
        prop_assert_eq!(of(&spoken), spoken);
        prop_assert_eq!(of(&told), told);
        let fresh = of(&latest);
        prop_assert!(fresh.is_sorted(), "{:?}", fresh);
        prop_assert!(fresh.len() as u64 + dropped <= latest.len() as u64);
        prop_assert_eq!(link.ledger.sent(), link.read);
        link.acknowledge();
        prop_assert_eq!((link.ledger.bytes(), link.queue.bytes()), (0, 0));
    }
}

#[test]
fn what_must_be_kept_and_was_not_is_told() {
    let mut link = Link::new(5000);
    for number in 1..=10 {
        link.push(message(number, 0, 936, Delivery::Reliable));
    }
    link.write(usize::MAX, 4096);
    link.read = 6;
    link.acknowledge();
    assert!(
        matches!(link.lose(), Rewound::Dropped(0)),
        "the last four are kept"
    );
    link.write(usize::MAX, 4096);
    for number in 11..=20 {
        link.push(message(number, 0, 936, Delivery::Reliable));
    }
    let read = link.read;
    link.write(usize::MAX, 4096);
    link.read = read;
    link.queue.restart(&mut link.ledger);
    let rewound = link
        .queue
        .resend(&mut link.ledger, read)
        .expect("a count that can be");
    assert_eq!(rewound, Rewound::Lost(6), "six of ten do not fit");
}

#[test]
fn counts_that_cannot_be_are_refused() {
    let mut link = Link::new(usize::MAX);
    for number in 1..=10 {
        link.push(message(number, 0, 10, Delivery::Reliable));
    }
    link.write(usize::MAX, 4096);
    link.acknowledge();
    let bad = |read| BadCount {
        read,
        sent: 10,
        acknowledged: 10,
    };
    for read in [9, 11] {
        assert_eq!(link.queue.acknowledge(&mut link.ledger, read), Err(bad(read)));
        let resent = link.queue.resend(&mut link.ledger, read);
        assert_eq!(resent, Err(bad(read)));
    }
}

#[test]
fn what_is_dropped_while_lost_is_not_sent_again() {
    let mut link = Link::new(usize::MAX);
    link.push(message(1, 0, 10, Delivery::Reliable));
    link.push(run(2, 5, 10));
    link.write(usize::MAX, 4096);
    link.read = 0;
    link.arrived.clear();
    let dropped = link.ledger.drop_kept(|packet| packet.count > 1);
    let counts: Vec<u64> = dropped.iter().map(|(_, count)| *count).collect();
    assert_eq!(counts, [5]);
    for (item, count) in &dropped {
        link.queue.note_unread(item, *count, DropReason::Lost);
    }
    assert_eq!(link.lose(), Rewound::Dropped(5));
    link.write(usize::MAX, 4096);
    assert_eq!(link.arrived, [1]);
    assert_eq!(
        link.queue.take_drops().into_iter().collect::<Vec<_>>(),
        [((DropReason::Lost, Delivery::Reliable), 5)]
    );
}
