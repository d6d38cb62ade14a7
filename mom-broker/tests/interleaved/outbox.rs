//! Several threads at one outbox, over a link that takes a few parcels and then no more until its peer reads.

use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::Reader;
use mom_net::{DropReason, Lane, Rewound, Taken};
use mom_proto::{Code, ContextNumber, Delivery, Parcel, WireError};
use mom_system::sync::atomic::{AtomicU64, Ordering};
use shuttle::thread;

use super::{LIMIT, explore, hear, link, said, write};
use crate::traffic::encodings::Encodings;
use crate::traffic::outbox::{Charged, Gate, Origin, Outbox, Packet, Paths};

const READER: PeerId = PeerId(9);

/// So many of the 64 that a link inside the process takes are taken: it blocks soon.
const TAKEN: u64 = 62;

fn packet(sender: u64, name: &str, id: u64) -> Packet {
    let origin = Origin {
        context: ContextNumber(1),
        sender: PeerId(sender),
        name: name.into(),
    };
    let mut parcel = said(name, id);
    parcel.sender = Some(sender.to_string().into());
    Packet {
        charged: Charged::Nowhere,
        encodings: Encodings::new(parcel, std::iter::once(None)).expect("no form needed"),
        lane: Lane::Data(0),
        delivery: Delivery::Reliable,
        origin,
        expires_at: None,
        gate: None,
        count: 1,
        counts: true,
        outlives_loss: true,
    }
}

/// Puts a parcel in and does what the first one has to.
fn put(outbox: &Outbox, packet: Packet) -> Taken {
    let (taken, first) = outbox.push(Arc::new(packet));
    if first {
        outbox.flush();
    }
    taken
}

fn sender_of(parcel: &Parcel) -> u64 {
    let name = parcel.sender.as_deref().expect("it was stamped");
    name.parse().expect("a number")
}

/// Ends the connection in order; nothing comes after what was heard.
fn end(outbox: Arc<Outbox>, writer: shuttle::future::JoinHandle<()>, reader: &mut Reader) {
    outbox.close(None, None, true);
    shuttle::future::block_on(writer).expect("the writer ends");
    drop(outbox);
    assert!(hear(reader).is_none(), "something came twice");
}

/// A reader of the link keeps no parcel.
#[test]
fn what_is_put_in_while_somebody_looks_at_the_link_leaves() {
    explore(|| {
        let (outbox, mut reader) = link(READER, 0);
        let writer = write(&outbox);
        let looking = Arc::clone(&outbox);
        let looks = thread::spawn(move || assert!(!looking.is_linked()));
        put(&outbox, packet(1, "say", 1));
        assert_eq!(hear(&mut reader).map(|parcel| parcel.id), Some(Some(1)));
        looks.join().expect("no panic");
        end(outbox, writer, &mut reader);
    });
}

#[test]
fn every_parcel_leaves_once_and_each_sender_keeps_its_order() {
    explore(|| {
        let (outbox, mut reader) = link(READER, TAKEN);
        let writer = write(&outbox);
        let senders: Vec<_> = (1..=3)
            .map(|sender| {
                let outbox = Arc::clone(&outbox);
                let all = move || {
                    (0..3).for_each(|id| assert_eq!(put(&outbox, packet(sender, "state", id)), Taken::Yes));
                };
                thread::spawn(all)
            })
            .collect();
        // A parcel that nobody writes, or a writer that nobody wakes, would be waited for forever.
        let mut next = [0; 3];
        for _ in 0..9 {
            let parcel = hear(&mut reader).expect("the link is open");
            let place = &mut next[usize::try_from(sender_of(&parcel) - 1).expect("small")];
            assert_eq!(parcel.id, Some(*place), "lost, twice, or out of order");
            *place += 1;
        }
        assert_eq!(next, [3, 3, 3]);
        senders
            .into_iter()
            .for_each(|sender| sender.join().expect("it pushed"));
        end(outbox, writer, &mut reader);
    });
}

/// A connection is lost while others put parcels in and write them, and another one goes on: each parcel comes once and in order.
#[test]
fn a_link_goes_on_where_its_connection_was_lost() {
    #[derive(Debug)]
    struct Nowhere;
    impl Paths for Nowhere {
        fn path(&self, _: ContextNumber) -> Option<mom_proto::Path> {
            None
        }
    }
    explore(|| {
        let (outbox, mut reader) = link(READER, 0);
        assert!(outbox.begin_link(LIMIT), "nothing waits yet");
        put(&outbox, packet(0, "welcome", 0));
        assert!(hear(&mut reader).is_some_and(|parcel| parcel.name() == "welcome"));
        let sender = thread::spawn({
            let outbox = Arc::clone(&outbox);
            move || (0..4).for_each(|id| assert_eq!(put(&outbox, packet(1, "state", id)), Taken::Yes))
        });
        drop(outbox.detach());
        let mut heard: Vec<Option<u64>> = Vec::new();
        while let Some(parcel) = hear(&mut reader) {
            heard.push(parcel.id);
        }
        let (here, there) = mom_net::pair();
        let (read, paths) = (heard.len() as u64, Arc::new(Nowhere) as Arc<dyn Paths>);
        let rewound = outbox.resend(read, &here.writer, Arc::downgrade(&paths));
        assert_eq!(rewound, Ok(Rewound::Dropped(0)));
        outbox.attach(Arc::new(here.writer));
        let writer = write(&outbox);
        let mut reader = there.reader;
        while heard.len() < 4 {
            heard.push(hear(&mut reader).expect("the link is open").id);
        }
        assert_eq!(heard, [0, 1, 2, 3].map(Some));
        sender.join().expect("it pushed");
        end(outbox, writer, &mut reader);
    });
}

/// Design §6: what waits is looked at again when it leaves. From the word that the token has changed hands on, a
/// receiver hears nothing of the old owner, and what it does not hear is counted.
#[test]
fn nothing_of_an_old_owner_follows_the_word_of_the_change() {
    explore(|| {
        let (outbox, mut reader) = link(READER, TAKEN);
        let writer = write(&outbox);
        let gate: Gate = Arc::new(AtomicU64::new(1));
        let guarded = |sender, id, gate: &Gate, fence| Packet {
            gate: Some((Arc::clone(gate), fence)),
            ..packet(sender, "command", id)
        };
        let old = thread::spawn({
            let (outbox, gate) = (Arc::clone(&outbox), Arc::clone(&gate));
            move || {
                for id in 0..5 {
                    assert_eq!(put(&outbox, guarded(1, id, &gate, 1)), Taken::Yes);
                }
            }
        });
        let new = thread::spawn({
            let (outbox, gate) = (Arc::clone(&outbox), Arc::clone(&gate));
            move || {
                // As a swap and the effects after it.
                gate.store(2, Ordering::Release);
                let released = Packet {
                    lane: Lane::Control,
                    ..packet(0, "released", 0)
                };
                put(&outbox, released);
                put(&outbox, guarded(2, 0, &gate, 2));
            }
        });
        let last = thread::spawn({
            let outbox = Arc::clone(&outbox);
            move || {
                old.join().expect("the old owner is done");
                new.join().expect("the new owner is done");
                put(&outbox, packet(0, "last", 0));
            }
        });
        let mut names = Vec::new();
        loop {
            let parcel = hear(&mut reader).expect("the link is open");
            if parcel.name() == "last" {
                break;
            }
            names.push((parcel.name().to_owned(), sender_of(&parcel)));
        }
        last.join().expect("all is said");
        let word = names
            .iter()
            .position(|(name, _)| name == "released")
            .expect("it is told");
        let of_old = |(_, sender): &(String, u64)| *sender == 1;
        assert!(!names[word..].iter().any(of_old), "{names:?}");
        assert_eq!(names.last(), Some(&("command".to_owned(), 2)), "{names:?}");
        let drops = outbox.take_drops();
        let fenced: u64 = drops
            .iter()
            .filter(|(dropped, _)| dropped.reason == DropReason::Fence)
            .map(|(_, count)| count)
            .sum();
        let left = names.iter().filter(|name| of_old(name)).count() as u64;
        assert_eq!(left + fenced, 5, "each left or was counted");
        end(outbox, writer, &mut reader);
    });
}

/// What is more urgent overtakes what a blocked link gave back, and of a `latest` value the newest leaves.
#[test]
fn what_a_blocked_link_gives_back_keeps_its_place() {
    explore(|| {
        let (outbox, mut reader) = link(READER, TAKEN);
        let writer = write(&outbox);
        let states = thread::spawn({
            let outbox = Arc::clone(&outbox);
            move || {
                for id in 0..6 {
                    let state = Packet {
                        delivery: Delivery::Latest,
                        ..packet(1, "state", id)
                    };
                    assert_eq!(put(&outbox, state), Taken::Yes);
                }
            }
        });
        let stop = thread::spawn({
            let outbox = Arc::clone(&outbox);
            move || {
                let stop = Packet {
                    lane: Lane::Stop,
                    ..packet(2, "stop", 0)
                };
                assert_eq!(put(&outbox, stop), Taken::Yes);
            }
        });
        let (mut states_heard, mut stops) = (Vec::new(), 0);
        while states_heard.last() != Some(&5) || stops == 0 {
            let parcel = hear(&mut reader).expect("the link is open");
            match parcel.name() {
                "stop" => stops += 1,
                _ => states_heard.extend(parcel.id),
            }
        }
        states.join().expect("all states are said");
        stop.join().expect("the stop is said");
        assert!(
            states_heard.is_sorted_by(|one, next| one < next),
            "{states_heard:?}"
        );
        let replaced: u64 = outbox.take_drops().into_iter().map(|(_, count)| count).sum();
        assert_eq!(
            states_heard.len() as u64 + replaced,
            6,
            "each left or was counted"
        );
        assert_eq!(stops, 1);
        end(outbox, writer, &mut reader);
    });
}

/// The error that ends a connection is its last word, even if other senders have more.
#[test]
fn nothing_follows_the_last_word() {
    explore(|| {
        let (outbox, mut reader) = link(READER, TAKEN);
        let writer = write(&outbox);
        let sender = thread::spawn({
            let outbox = Arc::clone(&outbox);
            move || {
                (0..4)
                    .filter(|id| put(&outbox, packet(1, "state", *id)) == Taken::Yes)
                    .count()
            }
        });
        let closer = thread::spawn({
            let outbox = Arc::clone(&outbox);
            move || {
                let error = WireError::new(Code::SHUTDOWN, "the end");
                let farewell = packet(0, "farewell", 0);
                outbox.close(Some(error), Some(Arc::new(farewell)), true);
            }
        });
        let mut names = Vec::new();
        while names.last().is_none_or(|name| name != "farewell") {
            names.push(hear(&mut reader).expect("the last word comes").name().to_owned());
        }
        let taken = sender.join().expect("it pushed");
        closer.join().expect("it closed");
        shuttle::future::block_on(writer).expect("the writer ends");
        assert!(outbox.closing().is_some() && outbox.is_closed());
        drop(outbox);
        assert!(hear(&mut reader).is_none(), "something follows the last word");
        assert_eq!(names.len(), taken + 1, "what was taken in leaves");
    });
}
