//! The threads of the broker in orders that the machine would hardly ever take: run by `cargo xtask shuttle`.
//!
//! Each test is a small program of two to four threads. Shuttle runs it again and again, one thread at a time, and
//! chooses after every step on a lock, an atomic or a wake-up who goes on. A thread that nobody wakes shows as a
//! deadlock. An order that fails is printed; `shuttle::replay` runs it again. What shuttle cannot show is memory that
//! one processor sees later than another: to it every atomic is `SeqCst`, and a fence is nothing.

mod board;
mod capacity;
mod outbox;

use std::collections::VecDeque;
use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::{Progress, Reader, Writer};
use mom_proto::codec::Frame;
use mom_proto::{Family, Parcel, Time};
use mom_system::Clock;
use mom_system::sync::explore;

use crate::traffic::outbox::Outbox;
use crate::traffic::switchboard::Switchboard;

/// What waits may be as much as it likes.
const LIMIT: usize = 1 << 20;

/// A clock that stands still: time is none of the orders.
fn clock() -> Clock {
    Clock::manual(Time::default())
}

/// An outbox with what its peer hears, over a link that has taken so many parcels already.
fn link(peer: PeerId, taken: u64) -> (Arc<Outbox>, Reader) {
    let (here, there) = mom_net::pair();
    fill(&here.writer, taken);
    let outbox = Outbox::new(peer, clock(), here.writer, LIMIT);
    (Arc::new(outbox), there.reader)
}

fn fill(writer: &Writer, count: u64) {
    let mut filling: VecDeque<_> = (0..count)
        .map(|_| {
            writer
                .prepare(Arc::new(said("filling", 0)))
                .expect("no form needed")
        })
        .collect();
    assert_eq!(writer.try_write(&mut filling).expect("a link"), Progress::Done);
}

fn said(name: &str, id: u64) -> Parcel {
    Parcel::new(Family::Message, name).id(id)
}

/// The next parcel that is none of the filling; waits for it.
fn hear(reader: &mut Reader) -> Option<Box<Parcel>> {
    loop {
        match shuttle::future::block_on(reader.next()).expect("a link") {
            Some(Frame::Parcel(parcel)) if parcel.name() == "filling" => {}
            Some(Frame::Parcel(parcel)) => return Some(parcel),
            Some(Frame::Malformed { error, .. }) => panic!("a broken parcel: {error}"),
            None => return None,
        }
    }
}

/// All that has arrived.
fn heard(reader: &mut Reader) -> Vec<Parcel> {
    let parcel = |frame| match frame {
        Frame::Parcel(parcel) => *parcel,
        Frame::Malformed { error, .. } => panic!("a broken parcel: {error}"),
    };
    let next = || reader.try_next().expect("a link").map(parcel);
    std::iter::from_fn(next).collect()
}

/// The writer of an outbox, as a task.
fn write(outbox: &Arc<Outbox>) -> shuttle::future::JoinHandle<()> {
    let outbox = Arc::clone(outbox);
    shuttle::future::spawn(async move { outbox.run().await })
}

/// A thread that has the switchboard.
fn on<T: Send + 'static>(
    board: &Arc<Switchboard>,
    act: impl FnOnce(&Switchboard) -> T + Send + 'static,
) -> shuttle::thread::JoinHandle<T> {
    let board = Arc::clone(board);
    shuttle::thread::spawn(move || act(&board))
}
