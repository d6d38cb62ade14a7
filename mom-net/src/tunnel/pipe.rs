//! The two streams of bytes of a tunnel, at one of its ends.
//!
//! Requests of HTTP are lost, repeated and cut off, so each stream is counted: the sender says where in the stream its
//! bytes begin, and keeps them until the other end has said that it has them.

use std::io::{self, ErrorKind, IoSlice};
use std::task::{Context, Poll, Waker};

use bytes::{Buf as _, BufMut, Bytes, BytesMut};
use parking_lot::Mutex;
use tokio::sync::Notify;

/// Bytes on their way out that the other end may not have yet: nothing urgent can overtake them.
pub(crate) const WINDOW: usize = 64 * 1024;

/// Bytes that may have come and not been read.
pub(super) const UNREAD: usize = 512 * 1024;

/// One end of a tunnel.
#[derive(Debug, Default)]
pub(crate) struct Pipe {
    state: Mutex<State>,
    /// There is more to send, or an end.
    sendable: Notify,
    /// The other end has more of what was sent.
    acknowledged: Notify,
    /// The reader has taken all and come back.
    settled: Notify,
}

#[derive(Debug, Default)]
struct State {
    /// What has come and is not read, and how much has come in all.
    arrived: BytesMut,
    arrived_to: u64,
    reader: Option<Waker>,
    /// The reader waits for more.
    hungry: bool,
    /// Nothing more will come.
    arrived_all: bool,
    /// What was taken from writers and is not acknowledged, and how much is.
    kept: BytesMut,
    kept_from: u64,
    /// Nothing more will be written here.
    finished: bool,
    /// Why the tunnel is broken.
    broken: Option<String>,
    /// Its peer has logged in.
    trusted: bool,
}

/// Bytes that do not follow on those that are here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Misplaced {
    /// Some before them are missing; so many are here.
    Gap(u64),
    /// More has come than is read.
    Full(u64),
    /// Nobody reads any more.
    Over,
}

impl Pipe {
    /// Reads what has come; 0 bytes at the end.
    pub(crate) fn poll_read(
        &self,
        room: &mut impl BufMut,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        let mut state = self.state.lock();
        let here = state.arrived.len().min(room.remaining_mut());
        if here > 0 {
            room.put_slice(&state.arrived[..here]);
            state.arrived.advance(here);
            if state.arrived.is_empty() {
                state.arrived = BytesMut::new();
            }
            return Poll::Ready(Ok(here));
        }
        if let Some(why) = &state.broken {
            return Poll::Ready(Err(io::Error::new(ErrorKind::ConnectionReset, why.clone())));
        }
        if state.arrived_all {
            return Poll::Ready(Ok(0));
        }
        state.reader = Some(context.waker().clone());
        state.hungry = true;
        drop(state);
        self.settled.notify_waiters();
        Poll::Pending
    }

    /// Takes the front of these pieces; gives how much of it, none if the other end lacks too much already.
    pub(crate) fn try_write(&self, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        let mut state = self.state.lock();
        if state.finished || state.broken.is_some() {
            return Err(ErrorKind::BrokenPipe.into());
        }
        let mut left = WINDOW.saturating_sub(state.kept.len());
        let mut taken = 0;
        for piece in pieces {
            let here = piece.len().min(left);
            state.kept.extend_from_slice(&piece[..here]);
            (left, taken) = (left - here, taken + here);
            if left == 0 {
                break;
            }
        }
        drop(state);
        if taken == 0 {
            return Ok(None);
        }
        self.sendable.notify_waiters();
        Ok(Some(taken))
    }

    /// Waits until a writer may write more.
    pub(crate) async fn writable(&self) {
        self.until(&self.acknowledged, |state| {
            let open = !state.finished && state.broken.is_none();
            (!open || state.kept.len() < WINDOW).then_some(())
        })
        .await;
    }

    /// Says that nothing more will be written at this end.
    pub(crate) fn finish(&self) {
        self.state.lock().finished = true;
        self.sendable.notify_waiters();
        self.acknowledged.notify_waiters();
    }

    /// Takes bytes from the other end that begin at this place in its stream; those that are here already are skipped. Gives
    /// how many have come in all.
    pub(crate) fn take_in(&self, at: u64, bytes: &[u8]) -> Result<u64, Misplaced> {
        let mut state = self.state.lock();
        if state.broken.is_some() {
            return Err(Misplaced::Over);
        }
        let Some(known) = state.arrived_to.checked_sub(at) else {
            return Err(Misplaced::Gap(state.arrived_to));
        };
        let new = bytes
            .get(usize::try_from(known).unwrap_or(usize::MAX)..)
            .unwrap_or_default();
        if state.arrived.len() + new.len() > UNREAD {
            return Err(Misplaced::Full(state.arrived_to));
        }
        if !new.is_empty() {
            state.arrived.extend_from_slice(new);
            state.arrived_to += new.len() as u64;
            state.wake();
        }
        Ok(state.arrived_to)
    }

    /// Notes that nothing more comes.
    pub(crate) fn took_all(&self) {
        let mut state = self.state.lock();
        state.arrived_all = true;
        state.wake();
        drop(state);
        self.settled.notify_waiters();
    }

    /// Whether no more can come before the reader takes some.
    pub(super) fn is_full(&self) -> bool {
        self.state.lock().arrived.len() > UNREAD / 2
    }

    /// Notes that the tunnel cannot go on.
    pub(crate) fn break_off(&self, why: &str) {
        let mut state = self.state.lock();
        state.broken.get_or_insert_with(|| why.to_owned());
        state.wake();
        drop(state);
        self.sendable.notify_waiters();
        self.acknowledged.notify_waiters();
        self.settled.notify_waiters();
    }

    /// Gives back the memory of what nobody will have any more.
    pub(super) fn empty(&self) {
        let mut state = self.state.lock();
        (state.arrived, state.kept) = (BytesMut::new(), BytesMut::new());
    }

    /// Notes that the peer has logged in.
    pub(crate) fn trust(&self) {
        self.state.lock().trusted = true;
    }

    /// Whether the peer has logged in.
    pub(super) fn is_trusted(&self) -> bool {
        self.state.lock().trusted
    }

    /// Waits until the reader has dealt with all that has come.
    pub(crate) async fn settle(&self) {
        self.until(&self.settled, |state| {
            let over = state.arrived_all || state.broken.is_some() || state.finished;
            (over || (state.hungry && state.arrived.is_empty())).then_some(())
        })
        .await;
    }

    /// How many bytes have come in all.
    pub(super) fn arrived_to(&self) -> u64 {
        self.state.lock().arrived_to
    }

    /// How many bytes were taken from writers in all.
    pub(super) fn written_to(&self) -> u64 {
        let state = self.state.lock();
        state.kept_from + state.kept.len() as u64
    }

    /// How many bytes the other end is known to have.
    pub(super) fn kept_from(&self) -> u64 {
        self.state.lock().kept_from
    }

    /// The other end has all bytes before this place, which are kept no longer; false if there is no such place.
    pub(crate) fn acknowledge(&self, to: u64) -> bool {
        let mut state = self.state.lock();
        let Some(more) = to.checked_sub(state.kept_from) else {
            // Said before, and overtaken.
            return true;
        };
        let more = usize::try_from(more).unwrap_or(usize::MAX);
        if more > state.kept.len() {
            return false;
        }
        state.kept.advance(more);
        state.kept_from = to;
        if state.kept.is_empty() {
            state.kept = BytesMut::new();
        }
        drop(state);
        self.acknowledged.notify_waiters();
        true
    }

    /// Bytes from this place on, `most` at most, once there are any; none at the end, and where the place is gone.
    pub(crate) async fn bytes_from(&self, from: u64, most: usize) -> Option<Bytes> {
        self.until(&self.sendable, |state| {
            let Some(skipped) = from.checked_sub(state.kept_from) else {
                return Some(None);
            };
            let here = state.kept.get(usize::try_from(skipped).unwrap_or(usize::MAX)..);
            let here = here.unwrap_or_default();
            match here.is_empty() {
                false => Some(Some(Bytes::copy_from_slice(&here[..here.len().min(most)]))),
                true if state.finished || state.broken.is_some() => Some(None),
                true => None,
            }
        })
        .await
    }

    /// Waits until the other end has all that was written, or nobody can know any more.
    pub(super) async fn drained(&self) {
        self.until(&self.acknowledged, |state| {
            (state.broken.is_some() || state.kept.is_empty()).then_some(())
        })
        .await;
    }

    /// Whether nothing more will be written at this end.
    pub(super) fn is_finished(&self) -> bool {
        self.state.lock().finished
    }

    async fn until<T>(&self, changed: &Notify, mut look: impl FnMut(&State) -> Option<T>) -> T {
        loop {
            // Before the look, so that no change is missed.
            let mut notified = std::pin::pin!(changed.notified());
            notified.as_mut().enable();
            if let Some(found) = look(&self.state.lock()) {
                return found;
            }
            notified.await;
        }
    }
}

impl State {
    fn wake(&mut self) {
        self.hungry = false;
        if let Some(reader) = self.reader.take() {
            reader.wake();
        }
    }
}
