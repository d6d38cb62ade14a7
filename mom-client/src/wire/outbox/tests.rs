//! What leaves first, and what becomes of what does not leave.

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE, STREAMS};
use mom_proto::codec::Frame;
use mom_proto::{Delivery, Family, Limits, Path, Time, Value};

use super::*;

/// A hub that reads what leaves.
struct Hub {
    bytes: BytesMut,
    decoder: BinaryDecoder,
}

impl Hub {
    fn new() -> Hub {
        let mut decoder = BinaryDecoder::new(&Limits::default());
        decoder.set_limits(&Limits::default());
        Hub {
            bytes: BytesMut::from(&PREFACE[..]),
            decoder,
        }
    }

    /// The names of the parcels that a piece completes.
    fn take(&mut self, piece: &Piece<Entry>) -> Vec<String> {
        let mut slices = Vec::new();
        piece.append_to(Some(Form::Binary), &mut slices);
        for slice in &slices {
            self.bytes.extend_from_slice(slice);
        }
        let mut names = Vec::new();
        while let Some(frame) = self.decoder.decode(&mut self.bytes).unwrap() {
            let Frame::Parcel(parcel) = frame else {
                panic!("{frame:?}")
            };
            names.push(parcel.name().to_owned());
        }
        names
    }

    fn take_all(&mut self, outbox: &mut Outbox) -> String {
        let mut names = Vec::new();
        while let Some(piece) = outbox.queue.pop(0, MOST) {
            names.extend(self.take(&piece));
        }
        names.join(" ")
    }
}

/// How pieces are cut.
const MOST: usize = 1000;

fn new() -> Outbox {
    Outbox::new(Some(Form::Binary))
}

fn path() -> Path {
    Path::parse("/robot/arm").unwrap()
}

fn frame(parcel: &Parcel) -> Outgoing {
    Outgoing::Encoded(Form::Binary.encode(parcel).unwrap())
}

/// Puts in a message of so many bytes and this priority, which nobody waits for.
fn say(outbox: &mut Outbox, name: &str, size: usize, priority: i32) -> Dropped {
    let mut parcel = Parcel::new(Family::Message, name)
        .context(path())
        .content(Value::from(Bytes::from(vec![7; size])));
    parcel.priority = Some(priority);
    let message = Message {
        capacity: Capacity { usual: 1, urgent: 0 },
        awaited: false,
        guard: (name == "command").then(|| Path::parse("/robot/token").unwrap()),
        outgoing: frame(&parcel),
    };
    outbox.push_message(&parcel, message)
}

fn ask(outbox: &mut Outbox, family: Family, name: &str) {
    let about = match family {
        Family::Token => "/robot/token",
        _ => "/robot",
    };
    let parcel = Parcel::new(family, name).context(Path::parse(about).unwrap());
    outbox.push_control(&parcel, frame(&parcel), Follows::of(&parcel));
}

#[test]
fn control_overtakes_messages_but_gives_up_after_them() {
    use Family::{Context, Login, Message, Time, Token};
    for (pushed, expected) in [
        (vec![(Message, "a"), (Time, "pong")], "pong a"),
        (vec![(Message, "a"), (Token, "grab"), (Message, "b")], "grab a b"),
        (
            vec![(Message, "command"), (Token, "release"), (Message, "b")],
            "command release b",
        ),
        (vec![(Message, "a"), (Token, "release")], "release a"),
        (
            vec![(Message, "a"), (Context, "leave"), (Context, "join")],
            "a leave join",
        ),
        (
            vec![(Message, "a"), (Context, "join"), (Login, "logout")],
            "join a logout",
        ),
        (
            vec![(Message, "command"), (Token, "decline"), (Token, "give")],
            "decline command give",
        ),
        (
            vec![(Message, "command"), (Token, "release"), (Time, "ping")],
            "ping command release",
        ),
        (vec![(Message, "command"), (Token, "accept")], "accept command"),
        (vec![(Context, "delete")], "delete"),
        (
            vec![(Message, "a"), (Message, "unstop"), (Message, "b")],
            "a unstop b",
        ),
        (vec![(Message, "a"), (Message, "stop")], "stop a"),
    ] {
        let mut outbox = new();
        for (family, name) in pushed {
            match family {
                Message => drop(say(&mut outbox, name, 10, 0)),
                _ => ask(&mut outbox, family, name),
            }
        }
        assert_eq!(Hub::new().take_all(&mut outbox), expected);
        assert!(outbox.queue.is_empty());
    }
}

/// What was sent after a good-bye is none of it, however urgent.
#[test]
fn what_gives_up_waits_for_what_was_sent_before_only() {
    let mut outbox = new();
    say(&mut outbox, "low", 5000, -5);
    say(&mut outbox, "usual", 10, 0);
    ask(&mut outbox, Family::Context, "leave");
    say(&mut outbox, "urgent", 10, 50);
    assert_eq!(Hub::new().take_all(&mut outbox), "usual low leave urgent");
}

#[test]
fn urgent_ones_go_between_the_chunks_of_large_ones() {
    let (mut outbox, mut hub) = (new(), Hub::new());
    say(&mut outbox, "map", 10_000, 0);
    say(&mut outbox, "next", 10, 0);
    for _ in 0..3 {
        assert_eq!(hub.take(&outbox.queue.pop(0, MOST).unwrap()), [""; 0]);
    }
    say(&mut outbox, "picture", 5000, 1);
    assert_eq!(hub.take(&outbox.queue.pop(0, MOST).unwrap()), [""; 0]);
    say(&mut outbox, "command", 10, 2);
    ask(&mut outbox, Family::Token, "renew");
    say(&mut outbox, "stop", 10, 0);
    say(&mut outbox, "later", 10, -1);
    assert_eq!(
        hub.take_all(&mut outbox),
        "stop renew command picture map next later",
        "one after the other at the same priority"
    );
}

#[test]
fn nothing_is_cut_that_has_no_chunks() {
    let mut outbox = Outbox::new(Some(Form::Xml));
    say(&mut outbox, "map", 100_000, 0);
    assert!(outbox.queue.pop(0, MOST).unwrap().is_last());
}

/// A link that takes nothing at any point: whatever is put back comes again, nothing twice, and an urgent one first.
#[test]
fn pieces_that_are_put_back_come_again() {
    for refuse in 0..3 {
        let (mut outbox, mut hub) = (new(), Hub::new());
        say(&mut outbox, "image", 3500, 0);
        say(&mut outbox, "chat", 10, 0);
        say(&mut outbox, "map", 3500, 0);
        let mut names = Vec::new();
        for turn in 0.. {
            let mut batch: VecDeque<Piece<Entry>> = (0..3).map_while(|_| outbox.queue.pop(0, MOST)).collect();
            if batch.is_empty() {
                break;
            }
            let taken = if turn % 2 == 0 { refuse } else { 3 };
            for piece in batch.drain(..taken.min(batch.len())) {
                names.extend(hub.take(&piece));
            }
            let mark = outbox.mark();
            outbox.put_back(&mut batch, mark);
            assert!(outbox.take_dropped().is_empty());
            if turn == 0 {
                say(&mut outbox, "urgent", 10, 1);
            }
        }
        assert_eq!(names, ["urgent", "image", "chat", "map"], "{refuse}");
    }
}

/// A stop withdraws an unstop that has not left, wherever that is.
#[test]
fn a_stop_is_the_last_word() {
    let (mut outbox, mut hub) = (new(), Hub::new());
    say(&mut outbox, "unstop", 10, 0);
    let withdrawn = say(&mut outbox, "stop", 10, 0);
    let [(unstop, DropReason::Withdrawn)] = &withdrawn[..] else {
        panic!("{withdrawn:?}")
    };
    assert_eq!(unstop.path(), Some(&path()));
    assert_eq!(hub.take_all(&mut outbox), "stop");

    say(&mut outbox, "unstop", 10, 0);
    let taken = outbox.queue.pop(0, MOST).unwrap();
    assert!(say(&mut outbox, "stop", 10, 0).is_empty(), "the link has it");
    outbox.put_back(&mut [taken].into(), outbox.mark());
    let dropped = outbox.take_dropped();
    assert!(matches!(dropped[..], [(_, DropReason::Withdrawn)]), "it had not");
    assert!(
        say(&mut outbox, "stop", 10, 0).is_empty(),
        "the newer one says the same"
    );
    say(&mut outbox, "unstop", 10, 0);
    assert_eq!(hub.take_all(&mut outbox), "stop unstop", "one is enough");
}

#[test]
fn what_is_cleared_holds_nothing_back() {
    let (mut outbox, mut hub) = (new(), Hub::new());
    say(&mut outbox, "a", 10, 0);
    say(&mut outbox, "map", 9000, 1);
    say(&mut outbox, "unstop", 10, 1);
    hub.take(&outbox.queue.pop(0, MOST).unwrap());
    ask(&mut outbox, Family::Token, "release");
    let lost = outbox.clear(true);
    assert_eq!(lost.len(), 3, "also what was half sent");
    assert!(
        lost.iter()
            .all(|(entry, _)| entry.take_capacity().usual == 1 && entry.path() == Some(&path()))
    );
    assert!(outbox.queue.is_empty());
    ask(&mut outbox, Family::Token, "release");
    assert_eq!(Hub::new().take_all(&mut outbox), "release");
}

/// The link goes on: what has begun ends, and the hub forgets what was half sent.
#[test]
fn another_peer_on_the_same_link_begins_anew() {
    let (mut outbox, mut hub) = (new(), Hub::new());
    say(&mut outbox, "map", 9000, 0);
    say(&mut outbox, "chat", 10, 0);
    hub.take(&outbox.queue.pop(0, MOST).unwrap());
    let mut begun = outbox.queue.pop(0, MOST).unwrap();
    let whole = begun.left();
    begun.advance(10);
    outbox.put_back(&mut [begun].into(), outbox.mark());
    assert_eq!(outbox.clear(false).len(), 2);
    assert!(!outbox.queue.is_empty());
    let mut batch = VecDeque::new();
    let nothing = Allowance {
        bytes: 0,
        piece: MOST,
        stops: usize::MAX,
    };
    outbox.take(0, nothing, Limit::Unlimited, &mut batch);
    let begun = batch.pop_front().unwrap();
    assert!(
        begun.left() == whole - 10 && !begun.is_last(),
        "its capacity is given already"
    );
    // The hub has the first ten bytes.
    let mut slices = Vec::new();
    begun.append_to(Some(Form::Binary), &mut slices);
    let rest: usize = slices.iter().map(|slice| slice.len()).sum();
    assert_eq!(rest, whole - 10);
    let abort = outbox.queue.pop(0, MOST).unwrap();
    assert_eq!(hub.take(&abort), [""; 0], "a stream that it knows");
    for _ in 0..STREAMS {
        say(&mut outbox, "map", 3000, 0);
    }
    assert_eq!(hub.take_all(&mut outbox), ["map"; STREAMS].join(" "));
}

/// A writer has taken something when everything is forgotten: none of it comes back, and each message is told once.
#[test]
fn what_was_taken_before_all_was_forgotten_is_lost() {
    for link_is_gone in [true, false] {
        for begun in [0, 10] {
            let (mut outbox, mut hub) = (new(), Hub::new());
            say(&mut outbox, "picture", 1500, 1);
            hub.take(&outbox.queue.pop(0, MOST).unwrap());
            say(&mut outbox, "chat", 10, 2);
            say(&mut outbox, "map", 9000, 0);
            ask(&mut outbox, Family::Token, "renew");
            let mark = outbox.mark();
            // The request, the chat, the end of the picture, the beginning of the map.
            let mut batch: VecDeque<Piece<Entry>> = (0..4).map_while(|_| outbox.queue.pop(0, MOST)).collect();
            batch[0].advance(begun);
            say(&mut outbox, "waits", 10, 0);
            let mut lost = outbox.clear(link_is_gone).len();
            assert_eq!(lost, 2, "the map, and what waited");
            outbox.put_back(&mut batch, mark);
            let dropped = outbox.take_dropped();
            assert!(dropped.iter().all(|(_, reason)| *reason == DropReason::Closed));
            lost += dropped.len();
            assert_eq!(lost, 4, "and the chat and the picture");
            let nothing = Allowance {
                bytes: 0,
                piece: MOST,
                stops: usize::MAX,
            };
            outbox.take(0, nothing, Limit::Unlimited, &mut batch);
            assert_eq!(batch.len(), usize::from(begun > 0 && !link_is_gone));
            let aborts: Vec<Piece<Entry>> = std::iter::from_fn(|| outbox.queue.pop(0, MOST)).collect();
            assert_eq!(
                aborts.len(),
                usize::from(!link_is_gone),
                "of the picture, not of the map"
            );
            for abort in &aborts {
                assert_eq!(hub.take(abort), [""; 0], "a stream that it knows");
            }
        }
    }
}

/// The hub keeps eight streams open and no more bytes in them than one parcel may have.
#[test]
fn no_more_is_open_than_the_hub_keeps() {
    let (mut outbox, mut hub) = (new(), Hub::new());
    const SMALL: usize = 100;
    outbox.queue.set_limits(usize::MAX, Limit::At(100_000));
    for priority in 0..3 {
        say(&mut outbox, &format!("p{priority}"), 40_000, priority);
        hub.take(&outbox.queue.pop(0, SMALL).unwrap());
    }
    let mut names = Vec::new();
    while let Some(piece) = outbox.queue.pop(0, SMALL) {
        names.extend(hub.take(&piece));
    }
    assert_eq!(names, ["p1", "p2", "p0"]);
    for priority in 0..12 {
        say(&mut outbox, &format!("p{priority}"), 5000, priority);
        hub.take(&outbox.queue.pop(0, SMALL).unwrap());
    }
    assert_eq!(hub.take_all(&mut outbox).split(' ').count(), 12);
}

/// A state that waits gives way to a newer one that goes to the same peers, and to no other.
#[test]
fn the_newest_state_replaces_older_ones() {
    let state = |outbox: &mut Outbox, name: &str, to: Option<&str>| {
        let mut parcel = Parcel::new(Family::Message, name).context(path());
        parcel.delivery = Some(Delivery::Latest);
        parcel.address = to.map(|to| vec![to.into()]);
        let message = Message {
            capacity: Capacity { usual: 1, urgent: 0 },
            awaited: true,
            guard: None,
            outgoing: frame(&parcel),
        };
        outbox.push_message(&parcel, message)
    };
    let (mut outbox, mut hub) = (new(), Hub::new());
    assert!(state(&mut outbox, "pose", None).is_empty());
    assert!(state(&mut outbox, "pose", Some("bob")).is_empty());
    assert!(state(&mut outbox, "image", None).is_empty());
    let dropped = state(&mut outbox, "pose", None);
    let [(older, DropReason::Replaced)] = &dropped[..] else {
        panic!("{dropped:?}")
    };
    assert_eq!(older.take_capacity().usual, 1, "its capacity is free again");
    assert_eq!(hub.take_all(&mut outbox), "pose pose image");
}

/// `expires` counts from the timestamp; a stop has no age.
#[test]
fn what_is_over_does_not_leave() {
    let (mut outbox, mut hub) = (new(), Hub::new());
    for name in ["chat", "stop"] {
        let mut parcel = Parcel::new(Family::Message, name).context(path());
        (parcel.timestamp, parcel.expires) = (Time::from_micros(1_000_000), Some(500));
        let message = Message {
            capacity: Capacity { usual: 1, urgent: 0 },
            awaited: false,
            guard: None,
            outgoing: frame(&parcel),
        };
        outbox.push_message(&parcel, message);
    }
    let mut batch = VecDeque::new();
    let all = Allowance {
        bytes: MOST,
        piece: MOST,
        stops: usize::MAX,
    };
    assert!(outbox.take(1_500_000, all, Limit::Unlimited, &mut batch));
    assert_eq!(hub.take(&batch.pop_front().unwrap()), ["stop"]);
    assert!(batch.is_empty());
    assert!(matches!(outbox.take_dropped()[..], [(_, DropReason::Expired)]));
}
