//! A link that is lost at any byte: what must not be lost arrives once, in its order, and both ends count the same.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Encoded, Form, Frame};
use mom_proto::{Checksum, Delivery, Family, Limits, Parcel, ReadCount, Value};
use proptest::prelude::*;

use super::super::{BadCount, DropReason, Lane, Ledger, Rewound};
use super::{Origin, Packet, Queue, frame, queue};
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
    /// The checksum after each number of them.
    checksums: Vec<Checksum>,
    /// What the network has taken does not arrive for now.
    stands: bool,
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
            checksums: vec![Checksum::default()],
            stands: false,
        };
        link.push(message(0, 0, 10, Delivery::Reliable));
        link.write(usize::MAX, 4096);
        assert_eq!(
            (link.ledger.sent(), link.read),
            (0, 1),
            "the reply to the login does not count"
        );
        link.forget();
        link
    }

    /// What has arrived so far does not count.
    fn forget(&mut self) {
        (self.read, self.checksums) = (0, vec![Checksum::default()]);
        self.arrived.clear();
    }

    /// What this end says after so many parcels.
    fn count(&self, parcels: u64) -> ReadCount {
        let checksum = self.checksums.get(usize::try_from(parcels).expect("a small one"));
        ReadCount {
            parcels,
            checksum: checksum.map(|checksum| checksum.value()),
        }
    }

    fn push(&mut self, packet: Packet) {
        self.queue.push(Arc::new(packet));
    }

    /// The network takes so many bytes, in pieces of about this size.
    fn write(&mut self, mut bytes: usize, piece: usize) {
        let allowance = Allowance {
            bytes: usize::MAX,
            piece,
            stops: usize::MAX,
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
        if !self.stands {
            self.arrive();
        }
    }

    fn arrive(&mut self) {
        while let Some(frame) = self.decoder.decode(&mut self.bytes).expect("frames") {
            let Frame::Parcel(parcel) = frame else {
                panic!("{frame:?}")
            };
            let checksum = self.checksums[usize::try_from(self.read).expect("a small one")];
            self.read += 1;
            self.checksums
                .truncate(usize::try_from(self.read).expect("a small one"));
            self.checksums.push(checksum.with(parcel.checksum_word()));
            self.arrived
                .push(i64::try_from(parcel.id.expect("a number")).expect("a small one"));
        }
    }

    fn acknowledge(&mut self) {
        let read = self.count(self.read);
        self.queue
            .acknowledge(&mut self.ledger, read)
            .expect("a count that can be");
    }

    /// The connection is lost, and resumed by a peer that has read so many parcels.
    fn resume_at(&mut self, read: u64, end: Option<Arc<Packet>>) {
        (self.read, self.arrived) = (read, Vec::new());
        drop(self.queue.restart(&mut self.ledger));
        (self.decoder, self.bytes) = decoder();
        let count = self.count(read);
        let rewound = self.queue.resend(&mut self.ledger, count, end);
        assert_eq!(rewound, Ok(Rewound::Dropped(0)));
    }

    /// The connection is lost, and resumed.
    fn lose(&mut self) -> Rewound {
        drop(self.queue.restart(&mut self.ledger));
        (self.decoder, self.bytes) = decoder();
        let read = self.count(self.read);
        let rewound = self
            .queue
            .resend(&mut self.ledger, read, None)
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
    /// What is not kept leaves between the parts of a run.
    SayUrgent,
    Tell(usize),
    Write(usize, usize),
    Acknowledge,
    /// The network holds back what it takes, or lets it go.
    Stand(bool),
    Lose,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        4 => (1..20_000usize).prop_map(Step::Say),
        4 => (2..50u32, 1..100usize).prop_map(|(count, size)| Step::SayRun(count, size)),
        1 => Just(Step::SayLatest),
        3 => Just(Step::SayUrgent),
        2 => (1..5000usize).prop_map(Step::Tell),
        8 => (1..6000usize, 100..5000usize).prop_map(|(bytes, piece)| Step::Write(bytes, piece)),
        2 => Just(Step::Acknowledge),
        3 => any::<bool>().prop_map(Step::Stand),
        3 => Just(Step::Lose),
    ];
    proptest::collection::vec(step, 1..60)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn whatever_is_lost_where_each_parcel_arrives_once(steps in steps()) {
        let mut link = Link::new(usize::MAX);
        let (mut next, mut spoken, mut told) = (1u64, Vec::new(), Vec::new());
        let (mut latest, mut urgent) = (Vec::new(), Vec::new());
        let mut dropped = 0;
        for step in steps.into_iter().chain([Step::Lose, Step::Stand(false), Step::Write(usize::MAX, 4096)]) {
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
                Step::SayUrgent => {
                    link.push(message(next, 5, 10, Delivery::Latest));
                    urgent.push(next.cast_signed());
                    next += 1;
                }
                Step::Tell(size) => {
                    link.push(control(next, size));
                    told.push(next.cast_signed());
                    next += 1;
                }
                Step::Write(bytes, piece) => link.write(bytes, piece),
                Step::Acknowledge => link.acknowledge(),
                Step::Stand(stands) => {
                    link.stands = stands;
                    if !stands {
                        link.arrive();
                    }
                }
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
        let (fresh, first) = (of(&latest), of(&urgent));
        prop_assert!(fresh.is_sorted() && first.is_sorted(), "{:?} {:?}", fresh, first);
        let said = latest.len() + urgent.len();
        prop_assert!((fresh.len() + first.len()) as u64 + dropped <= said as u64);
        prop_assert_eq!(link.ledger.sent(), link.read);
        link.acknowledge();
        prop_assert_eq!((link.ledger.bytes(), link.queue.bytes()), (0, 0));
    }
}

/// A stop may leave before the reply that tells the other side of the link, which counts what comes behind that.
#[test]
fn a_stop_before_the_reply_to_a_login_is_not_counted() {
    let mut link = Link {
        ledger: Ledger::after_next(usize::MAX),
        ..Link::new(usize::MAX)
    };
    link.push(control(1, 10));
    link.push(Packet {
        lane: Lane::Stop,
        ..control(2, 10)
    });
    link.push(message(3, 0, 10, Delivery::Reliable));
    link.push(message(4, 0, 10, Delivery::Reliable));
    link.write(usize::MAX, 4096);
    assert_eq!((&link.arrived[..], link.ledger.sent()), (&[2, 1, 3, 4][..], 2));
    let first = Checksum::default().with(3);
    link.checksums = vec![Checksum::default(), first, first.with(4)];
    link.resume_at(1, None);
    link.write(usize::MAX, 4096);
    assert_eq!(link.arrived, [4]);
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
    drop(link.queue.restart(&mut link.ledger));
    let count = link.count(read);
    let rewound = link
        .queue
        .resend(&mut link.ledger, count, None)
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
        differs: false,
    };
    for read in [9, 11] {
        let count = link.count(read);
        assert_eq!(link.queue.acknowledge(&mut link.ledger, count), Err(bad(read)));
        let resent = link.queue.resend(&mut link.ledger, count, None);
        assert_eq!(resent, Err(bad(read)));
    }
}

/// One end counts what the other does not: the next acknowledgement or resume finds it, wherever that was.
#[test]
fn a_count_of_other_parcels_is_refused() {
    for shifted in 1..=10 {
        let mut link = Link::new(usize::MAX);
        for number in 1..=10 {
            let push = match number % 3 {
                0 => message(number, 0, 10, Delivery::Fleeting),
                _ => message(number, 0, 10, Delivery::Reliable),
            };
            link.push(push);
            link.write(usize::MAX, 4096);
            if number == 5 && shifted > 5 {
                link.acknowledge();
            }
        }
        link.push(run(20, 5, 10));
        link.write(usize::MAX, 4096);
        let words = link
            .arrived
            .iter()
            .map(|number| u32::try_from(*number).expect("a small one"));
        let (mut parcels, mut checksum) = (0, Checksum::default());
        for word in words.filter(|word| *word != shifted) {
            (parcels, checksum) = (parcels + 1, checksum.with(word));
        }
        let checksum = Some(checksum.value());
        let bad = link
            .queue
            .acknowledge(&mut link.ledger, ReadCount { parcels, checksum });
        assert!(
            bad.is_err_and(|bad| bad.differs),
            "the {shifted}th was not counted"
        );
        let resent = link
            .queue
            .resend(&mut link.ledger, ReadCount { parcels, checksum }, None);
        assert!(
            resent.is_err_and(|bad| bad.differs),
            "the {shifted}th was not counted"
        );
    }
}

/// Who never acknowledges costs no more than this; what is older is not checked.
#[test]
fn so_many_parcels_are_checked_at_most() {
    let mut link = Link::new(usize::MAX);
    for first in 0..70 {
        link.push(run(first * 4000 + 1, 4000, 10));
        link.write(usize::MAX, 1 << 20);
    }
    assert_eq!(link.read, 280_000);
    let wrong = |parcels| ReadCount {
        parcels,
        checksum: Some(7),
    };
    let ledger = &mut link.ledger;
    assert_eq!(
        link.queue.acknowledge(ledger, wrong(280_000 - (1 << 18) - 1)),
        Ok(())
    );
    let bad = link.queue.acknowledge(ledger, wrong(280_000 - (1 << 18)));
    assert!(bad.is_err_and(|bad| bad.differs));
    link.acknowledge();
}

#[test]
fn what_does_not_outlive_the_loss_is_not_sent_again() {
    let mut link = Link::new(usize::MAX);
    let commands = |first| {
        let run = run(first, 5, 10);
        Packet {
            origin: Origin {
                name: "command".into(),
                ..run.origin.clone()
            },
            ..run
        }
    };
    link.push(message(1, 0, 10, Delivery::Reliable));
    link.push(commands(2));
    link.write(usize::MAX, 4096);
    link.forget();
    link.push(commands(7));
    link.push(message(12, 0, 10, Delivery::Reliable));
    assert_eq!(link.lose(), Rewound::Dropped(5));
    link.write(usize::MAX, 4096);
    assert_eq!(link.arrived, [1, 12]);
    assert_eq!(
        link.queue.take_drops().into_iter().collect::<Vec<_>>(),
        [
            ((DropReason::Lost, Delivery::Reliable), 5),
            ((DropReason::Unknown, Delivery::Reliable), 5)
        ]
    );
}

/// What says that all is sent again leaves behind that, whatever waits and however urgent it is.
#[test]
fn the_end_of_what_is_sent_again_goes_before_all_that_waits() {
    let end = || {
        let mut end = control(99, 10);
        end.origin.name = "resent".into();
        Some(Arc::new(end))
    };
    let mut link = Link::new(usize::MAX);
    link.push(message(1, -9, 10, Delivery::Reliable));
    link.push(message(2, -9, 50_000, Delivery::Reliable));
    link.write(100, 1000);
    // More urgent, and so said after and sent before the second.
    link.push(message(3, 5, 10, Delivery::Reliable));
    link.push(control(4, 10));
    link.write(1000, 1000);
    assert_eq!(link.arrived, [1, 4, 3]);
    link.push(message(5, 9, 10, Delivery::Reliable));
    link.push(control(6, 10));
    // The second time nothing waits.
    for (read, again) in [(0, [1, 4, 3, 99, 6, 5, 2]), (0, [1, 4, 3, 6, 5, 2, 99])] {
        link.resume_at(read, end());
        link.write(usize::MAX, 4096);
        assert_eq!(link.arrived, again);
    }
    assert_eq!(link.queue.bytes(), 0);
}

/// Where nothing ends it, control overtakes what is sent again, as it does all data; what follows data does not.
#[test]
fn what_is_sent_again_keeps_its_order_before_other_data() {
    let named = |number, name: &str| {
        let mut control = control(number, 10);
        control.origin = Origin {
            context: 1,
            name: name.into(),
        };
        control
    };
    let mut link = Link::new(usize::MAX);
    link.push(message(1, -9, 5000, Delivery::Reliable));
    link.write(usize::MAX, 4096);
    link.push(message(2, 0, 5000, Delivery::Reliable));
    link.push(Packet {
        lane: Lane::Stop,
        ..named(3, "stop")
    });
    link.write(usize::MAX, 4096);
    link.push(message(4, 7, 10, Delivery::Reliable));
    link.resume_at(0, None);
    // A part of the first has gone.
    link.write(1000, 500);
    link.push(named(5, "halt"));
    link.push(named(6, "unstop"));
    link.write(usize::MAX, 500);
    assert_eq!(link.arrived, [3, 5, 1, 2, 4, 6]);
    // What the second connection has not taken is still to be sent again, before what is new.
    link.resume_at(0, None);
    link.write(6000, 500);
    link.resume_at(2, None);
    link.push(message(7, 9, 10, Delivery::Reliable));
    link.write(usize::MAX, 500);
    assert_eq!(link.arrived, [1, 2, 4, 6, 7]);
    link.acknowledge();
    assert_eq!((link.ledger.bytes(), link.queue.bytes()), (0, 0));
}
