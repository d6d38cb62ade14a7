//! What leaves first, and what becomes of what does not leave.

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE, STREAMS};
use mom_proto::codec::{Form, Frame};
use mom_proto::{Limit, Limits, Value};

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
    fn take(&mut self, piece: &Piece) -> Vec<String> {
        let mut slices = Vec::new();
        piece.append_to(&mut slices);
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
        while let Some(piece) = outbox.pop(KNIFE) {
            names.extend(self.take(&piece));
        }
        names.join(" ")
    }
}

const KNIFE: Knife = Knife {
    most: 1000,
    parcel: Limit::At(1 << 20),
};

fn path() -> Path {
    Path::parse("/robot/arm").unwrap()
}

fn frame(parcel: &Parcel) -> Outgoing {
    Outgoing::Encoded(Form::Binary.encode(parcel).unwrap())
}

/// Puts in a message of so many bytes and this priority, which nobody waits for.
fn say(outbox: &mut Outbox, name: &str, size: usize, priority: i32) -> Vec<Overruled> {
    let mut parcel = Parcel::new(Family::Message, name)
        .context(path())
        .content(Value::from(Bytes::from(vec![7; size])));
    parcel.priority = Some(priority);
    let message = Message {
        room: Room { usual: 1, urgent: 0 },
        path: Some(path()),
        outgoing: frame(&parcel),
    };
    outbox.push_message(&parcel, message)
}

fn ask(outbox: &mut Outbox, family: Family, name: &str) {
    let parcel = Parcel::new(family, name);
    outbox.push_control(&parcel, frame(&parcel));
}

#[test]
fn control_overtakes_messages_but_gives_up_after_them() {
    use Family::{Context, Login, Message, Time, Token};
    for (pushed, expected) in [
        (vec![(Message, "a"), (Time, "pong")], "pong a"),
        (vec![(Message, "a"), (Token, "grab"), (Message, "b")], "grab a b"),
        (
            vec![(Message, "a"), (Token, "release"), (Message, "b")],
            "a release b",
        ),
        (
            vec![(Message, "a"), (Context, "leave"), (Context, "join")],
            "a leave join",
        ),
        (
            vec![(Message, "a"), (Context, "join"), (Login, "logout")],
            "join a logout",
        ),
        (
            vec![(Message, "a"), (Token, "decline"), (Token, "give")],
            "decline a give",
        ),
        (
            vec![(Message, "a"), (Token, "release"), (Time, "ping")],
            "ping a release",
        ),
        (vec![(Message, "a"), (Token, "accept")], "accept a"),
        (vec![(Context, "delete")], "delete"),
        (
            vec![(Message, "a"), (Message, "unstop"), (Message, "b")],
            "a unstop b",
        ),
        (vec![(Message, "a"), (Message, "stop")], "stop a"),
    ] {
        let mut outbox = Outbox::default();
        for (family, name) in pushed {
            match family {
                Message => drop(say(&mut outbox, name, 10, 0)),
                _ => ask(&mut outbox, family, name),
            }
        }
        assert_eq!(Hub::new().take_all(&mut outbox), expected);
        assert!(outbox.is_empty());
    }
}

/// What was sent after a good-bye is none of it, however urgent.
#[test]
fn what_gives_up_waits_for_what_was_sent_before_only() {
    let mut outbox = Outbox::default();
    say(&mut outbox, "low", 5000, -5);
    say(&mut outbox, "usual", 10, 0);
    ask(&mut outbox, Family::Token, "release");
    say(&mut outbox, "urgent", 10, 50);
    assert_eq!(Hub::new().take_all(&mut outbox), "usual low release urgent");
}

#[test]
fn urgent_ones_go_between_the_chunks_of_large_ones() {
    let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
    say(&mut outbox, "map", 10_000, 0);
    say(&mut outbox, "next", 10, 0);
    for _ in 0..3 {
        assert_eq!(hub.take(&outbox.pop(KNIFE).unwrap()), [""; 0]);
    }
    say(&mut outbox, "picture", 5000, 1);
    assert_eq!(hub.take(&outbox.pop(KNIFE).unwrap()), [""; 0]);
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
    let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
    say(&mut outbox, "map", 100_000, 0);
    assert_eq!(hub.take(&outbox.pop(Knife::blunt()).unwrap()), ["map"]);
}

/// The hub keeps eight streams open and no more bytes in them than one parcel may have.
#[test]
fn no_more_is_open_than_the_hub_keeps() {
    let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
    let small = Knife {
        most: 100,
        parcel: Limit::At(100_000),
    };
    for priority in 0..3 {
        say(&mut outbox, &format!("p{priority}"), 40_000, priority);
        hub.take(&outbox.pop(small).unwrap());
    }
    assert_eq!(outbox.open.len(), 2);
    let mut names = Vec::new();
    while let Some(piece) = outbox.pop(small) {
        names.extend(hub.take(&piece));
    }
    assert_eq!(names, ["p1", "p2", "p0"]);
    for priority in 0..12 {
        say(&mut outbox, &format!("p{priority}"), 5000, priority);
        hub.take(&outbox.pop(small).unwrap());
    }
    assert_eq!(outbox.open.len(), STREAMS);
    assert_eq!(hub.take_all(&mut outbox).split(' ').count(), 12);
}

/// A link that takes nothing at any point: whatever is put back comes again, nothing twice, and an urgent one first.
#[test]
fn pieces_that_are_put_back_come_again() {
    for refuse in 0..3 {
        let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
        say(&mut outbox, "image", 3500, 0);
        say(&mut outbox, "chat", 10, 0);
        say(&mut outbox, "map", 3500, 0);
        let mut names = Vec::new();
        for turn in 0.. {
            let mut batch: VecDeque<Piece> = (0..3).map_while(|_| outbox.pop(KNIFE)).collect();
            if batch.is_empty() {
                break;
            }
            let taken = if turn % 2 == 0 { refuse } else { 3 };
            for piece in batch.drain(..taken.min(batch.len())) {
                names.extend(hub.take(&piece));
            }
            while let Some(piece) = batch.pop_back() {
                let mark = outbox.mark();
                assert!(outbox.put_back(piece, mark).is_none());
            }
            if turn == 0 {
                say(&mut outbox, "urgent", 10, 1);
            }
        }
        assert_eq!(names, ["urgent", "image", "chat", "map"], "{refuse}");
    }
}

/// A stop overrules an unstop that has not left, wherever that is.
#[test]
fn a_stop_is_the_last_word() {
    let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
    say(&mut outbox, "unstop", 10, 0);
    let overruled = say(&mut outbox, "stop", 10, 0);
    assert!(overruled.len() == 1 && overruled[0].path == Some(path()));
    assert_eq!(hub.take_all(&mut outbox), "stop");

    say(&mut outbox, "unstop", 10, 0);
    let taken = outbox.pop(KNIFE).unwrap();
    assert!(say(&mut outbox, "stop", 10, 0).is_empty(), "the link has it");
    let returned = outbox.put_back(taken, outbox.mark());
    assert!(matches!(returned, Some(Returned::Overruled(_))), "it had not");
    assert!(say(&mut outbox, "stop", 10, 0).is_empty());
    say(&mut outbox, "unstop", 10, 0);
    assert_eq!(
        hub.take_all(&mut outbox),
        "stop unstop",
        "a stop twice says no more"
    );
}

#[test]
fn what_is_cleared_holds_nothing_back() {
    let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
    say(&mut outbox, "a", 10, 0);
    say(&mut outbox, "map", 9000, 1);
    say(&mut outbox, "unstop", 10, 1);
    hub.take(&outbox.pop(KNIFE).unwrap());
    ask(&mut outbox, Family::Token, "release");
    let lost = outbox.clear(true);
    assert_eq!(lost.len(), 3, "also what was half sent");
    assert!(
        lost.iter()
            .all(|entry| entry.room().usual == 1 && entry.path() == Some(&path()))
    );
    assert!(outbox.is_empty());
    ask(&mut outbox, Family::Token, "release");
    assert_eq!(Hub::new().take_all(&mut outbox), "release");
}

/// The link goes on: what has begun ends, and the hub forgets what was half sent.
#[test]
fn another_peer_on_the_same_link_begins_anew() {
    let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
    say(&mut outbox, "map", 9000, 0);
    say(&mut outbox, "chat", 10, 0);
    hub.take(&outbox.pop(KNIFE).unwrap());
    let mut begun = outbox.pop(KNIFE).unwrap();
    let whole = begun.left();
    begun.advance(10);
    assert!(outbox.put_back(begun, outbox.mark()).is_none());
    assert_eq!(outbox.clear(false).len(), 2);
    assert!(!outbox.is_empty());
    let begun = outbox.take_begun().unwrap();
    assert_eq!(
        (begun.left(), begun.room()),
        (whole - 10, Room::default()),
        "its room is given already"
    );
    // The hub has the first ten bytes.
    let mut slices = Vec::new();
    begun.append_to(&mut slices);
    let rest: usize = slices.iter().map(|slice| slice.len()).sum();
    assert_eq!(rest, whole - 10);
    let abort = outbox.pop(KNIFE).unwrap();
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
            let (mut outbox, mut hub) = (Outbox::default(), Hub::new());
            say(&mut outbox, "picture", 1500, 1);
            hub.take(&outbox.pop(KNIFE).unwrap());
            say(&mut outbox, "chat", 10, 2);
            say(&mut outbox, "map", 9000, 0);
            ask(&mut outbox, Family::Token, "renew");
            let mark = outbox.mark();
            // The request, the chat, the end of the picture, the beginning of the map.
            let mut batch: VecDeque<Piece> = (0..4).map_while(|_| outbox.pop(KNIFE)).collect();
            batch[0].advance(begun);
            say(&mut outbox, "waits", 10, 0);
            let mut lost = outbox.clear(link_is_gone).len();
            assert_eq!(lost, 2, "the map, and what waited");
            while let Some(piece) = batch.pop_back() {
                match outbox.put_back(piece, mark) {
                    Some(Returned::Lost(_)) => lost += 1,
                    None => {}
                    other => panic!("{other:?}"),
                }
            }
            assert_eq!(lost, 4, "and the chat and the picture");
            let goes_on = outbox.take_begun();
            assert_eq!(goes_on.is_some(), begun > 0 && !link_is_gone);
            let aborts: Vec<Piece> = std::iter::from_fn(|| outbox.pop(KNIFE)).collect();
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
