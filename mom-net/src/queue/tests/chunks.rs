//! Large items in pieces, and what becomes of pieces that the link did not take.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Form, Frame};
use mom_proto::{Delivery, Family, Limit, Limits, Parcel, Value};

use super::super::{DropReason, Lane, Taken};
use super::{Packet, Piece, Queue, frame, queue};

/// A message of so many bytes as one frame.
fn message(name: &str, size: usize, priority: i32, delivery: Delivery) -> Packet {
    let parcel = Parcel::new(Family::Message, name).content(Value::from(Bytes::from(vec![7; size])));
    let encoded = Form::Binary.encode(&parcel).unwrap();
    frame(name, Lane::Data(priority), delivery, encoded.to_vec())
}

/// What a receiver makes of all pieces until now.
#[derive(Default)]
struct Receiver {
    bytes: BytesMut,
    decoder: Option<BinaryDecoder>,
}

impl Receiver {
    fn take(&mut self, piece: &Piece) -> Vec<String> {
        let decoder = self.decoder.get_or_insert_with(|| {
            self.bytes.extend_from_slice(&PREFACE);
            BinaryDecoder::for_peer(&Limits::default())
        });
        let mut slices = Vec::new();
        piece.append_to(Some(Form::Binary), &mut slices);
        slices
            .iter()
            .for_each(|slice| self.bytes.extend_from_slice(slice));
        let mut names = Vec::new();
        while let Some(frame) = decoder.decode(&mut self.bytes).unwrap() {
            let Frame::Parcel(parcel) = frame else {
                panic!("{frame:?}")
            };
            names.push(parcel.name().to_owned());
        }
        names
    }

    fn take_all(&mut self, queue: &mut Queue) -> Vec<String> {
        std::iter::from_fn(|| queue.pop(0, 4096))
            .flat_map(|piece| self.take(&piece))
            .collect()
    }
}

/// The urgent overtake inside a large parcel, nested, and what is begun comes to its end.
#[test]
fn urgent_parcels_overtake_inside_large_ones() {
    let mut queue = queue(1 << 20);
    let mut receiver = Receiver::default();
    let push = |queue: &mut Queue, packet: Packet| {
        assert_eq!(queue.push(Arc::new(packet)), Taken::Yes);
    };
    push(&mut queue, message("image", 64 * 1024, 0, Delivery::Latest));
    for _ in 0..3 {
        let piece = queue.pop(0, 4096).unwrap();
        assert!(piece.left() <= 4096 + 16, "{}", piece.left());
        assert_eq!(receiver.take(&piece), [""; 0]);
    }
    push(&mut queue, message("map", 20_000, 5, Delivery::Reliable));
    let piece = queue.pop(0, 4096).unwrap();
    assert_eq!(receiver.take(&piece), [""; 0]);
    push(&mut queue, message("chat", 10, 0, Delivery::Reliable));
    push(&mut queue, message("command", 10, 5, Delivery::Reliable));
    push(&mut queue, message("urgent", 10, 9, Delivery::Reliable));
    let stop = message("stop", 10, 0, Delivery::Reliable);
    push(
        &mut queue,
        Packet {
            lane: Lane::Stop,
            ..stop
        },
    );
    assert_eq!(
        receiver.take_all(&mut queue),
        ["stop", "urgent", "map", "command", "image", "chat"]
    );
    assert!(queue.is_empty());
    assert_eq!(queue.data_bytes(), 0);
}

/// A newer image does not stop the one that is half there, or on a slow link none would ever arrive.
#[test]
fn what_is_begun_is_not_replaced_but_ends_with_its_gate_or_its_time() {
    let mut queue = queue(1 << 20);
    let mut receiver = Receiver::default();
    let image = || Arc::new(message("image", 64 * 1024, 0, Delivery::Latest));
    queue.push(image());
    receiver.take(&queue.pop(0, 4096).unwrap());
    queue.push(image());
    queue.push(image());
    assert_eq!(receiver.take_all(&mut queue), ["image", "image"]);

    let gate = Arc::new(AtomicU64::new(7));
    let upload = |name: &str| message(name, 64 * 1024, 0, Delivery::Reliable);
    queue.push(Arc::new(Packet {
        gate: Some((Arc::clone(&gate), 7)),
        ..upload("program")
    }));
    queue.push(Arc::new(Packet {
        expires_at: Some(50),
        ..upload("view")
    }));
    receiver.take(&queue.pop(0, 4096).unwrap());
    gate.store(8, Ordering::Release);
    receiver.take(&queue.pop(0, 4096).unwrap());
    receiver.take(&queue.pop(49, 4096).unwrap());
    receiver.take(&queue.pop(50, 4096).unwrap());
    assert!(queue.pop(50, 4096).is_none());
    assert_eq!(queue.data_bytes(), 0);
    let drops: Vec<_> = queue
        .take_drops()
        .into_iter()
        .map(|((reason, _), count)| (reason, count))
        .collect();
    assert_eq!(
        drops,
        [
            (DropReason::Replaced, 1),
            (DropReason::Expired, 1),
            (DropReason::Fence, 1)
        ]
    );
    queue.push(Arc::new(message("chat", 10, 0, Delivery::Reliable)));
    assert_eq!(
        receiver.take_all(&mut queue),
        ["chat"],
        "the receiver forgot both streams"
    );
}

/// A link that takes nothing at any point: whatever is put back comes again, and nothing twice.
#[test]
fn pieces_that_are_put_back_come_again() {
    for refuse in 1..6 {
        let mut queue = queue(1 << 20);
        let mut receiver = Receiver::default();
        queue.push(Arc::new(message("image", 9000, 0, Delivery::Latest)));
        queue.push(Arc::new(message("chat", 10, 0, Delivery::Reliable)));
        queue.push(Arc::new(message("map", 9000, 0, Delivery::Reliable)));
        let mut arrived = Vec::new();
        for turn in 0.. {
            let batch: Vec<Piece> = (0..3).map_while(|_| queue.pop(0, 4096)).collect();
            if batch.is_empty() {
                break;
            }
            let taken = if turn % 2 == 0 { refuse % 3 } else { 3 };
            let mut rest = Vec::new();
            for (at, piece) in batch.into_iter().enumerate() {
                if at < taken {
                    arrived.extend(receiver.take(&piece));
                } else {
                    rest.push(piece);
                }
            }
            rest.into_iter().rev().for_each(|piece| queue.put_back(piece));
        }
        assert_eq!(arrived, ["image", "chat", "map"], "{refuse}");
        assert_eq!(queue.data_bytes(), 0);
        assert!(queue.take_drops().is_empty());
    }
}

/// A receiver keeps a parcel's bytes and eight streams open, no more.
#[test]
fn no_more_is_open_than_the_receiver_keeps() {
    let mut queue = queue(1 << 20);
    queue.set_limits(1 << 20, Limit::At(100_000));
    let mut receiver = Receiver::default();
    for priority in 0..3 {
        let size = 40_000;
        queue.push(Arc::new(message(
            &format!("p{priority}"),
            size,
            priority,
            Delivery::Reliable,
        )));
        assert_eq!(receiver.take(&queue.pop(0, 4096).unwrap()), [""; 0]);
    }
    assert_eq!(queue.open.len(), 2);
    assert_eq!(receiver.take_all(&mut queue), ["p1", "p2", "p0"]);
    for priority in 0..20 {
        queue.push(Arc::new(message(
            &format!("p{priority}"),
            5000,
            priority,
            Delivery::Reliable,
        )));
        assert_eq!(receiver.take(&queue.pop(0, 100).unwrap()), [""; 0]);
    }
    assert_eq!(queue.open.len(), 8);
    assert_eq!(receiver.take_all(&mut queue).len(), 20);
}

/// A run of small frames is cut between them, and what did not leave of it is counted.
#[test]
fn a_run_is_cut_between_frames() {
    let frames: Vec<u8> = (0..10)
        .flat_map(|_| {
            let parcel = Parcel::new(Family::Message, "chat").content(Value::from(Bytes::from(vec![7; 500])));
            Form::Binary.encode(&parcel).unwrap().to_vec()
        })
        .collect();
    let mut queue = queue(1 << 20);
    let mut receiver = Receiver::default();
    let run = Packet {
        count: 10,
        ..frame("chat", Lane::Data(0), Delivery::Reliable, frames)
    };
    queue.push(Arc::new(run));
    assert_eq!(receiver.take(&queue.pop(0, 1000).unwrap()).len(), 2);
    queue.push(Arc::new(message("urgent", 10, 1, Delivery::Reliable)));
    queue.push(Arc::new(message("after", 10, 0, Delivery::Reliable)));
    assert_eq!(receiver.take(&queue.pop(0, 1000).unwrap()), ["urgent"]);
    assert_eq!(receiver.take(&queue.pop(0, 2000).unwrap()).len(), 4);
    assert_eq!(queue.drop_data().len(), 2);
    let drops: Vec<u64> = queue.take_drops().into_values().collect();
    assert_eq!(drops, [5], "four of the run and the one after it");
    assert!(queue.pop(0, 1000).is_none());
}

/// What a writer had taken when all was forgotten comes back to nobody, and the receiver forgets the chunks that it has.
#[test]
fn what_is_cleared_leaves_no_trace() {
    for begun in [false, true] {
        let mut queue = queue(1 << 20);
        let mut receiver = Receiver::default();
        queue.push(Arc::new(message("image", 9000, 0, Delivery::Latest)));
        queue.push(Arc::new(message("chat", 10, 0, Delivery::Reliable)));
        if begun {
            receiver.take(&queue.pop(0, 4096).unwrap());
        }
        let taken = queue.pop(0, 4096).unwrap();
        assert_eq!(queue.clear(false).len(), 2);
        assert_eq!((queue.bytes(), queue.forget(taken).is_none()), (0, true));
        let aborts: Vec<Piece> = std::iter::from_fn(|| queue.pop(0, 4096)).collect();
        assert_eq!(aborts.len(), usize::from(begun), "the receiver knows the stream");
        aborts
            .iter()
            .for_each(|abort| assert_eq!(receiver.take(abort), [""; 0]));
        queue.push(Arc::new(message("image", 9000, 0, Delivery::Latest)));
        assert_eq!(receiver.take_all(&mut queue), ["image"]);
    }
}
