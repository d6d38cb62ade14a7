//! WebSocket (RFC 6455) below a form, for browsers and for networks that let HTTP through only.
//!
//! The subprotocol tells the form: `mom.json.v1` has one parcel in each text message; `mom.bin.v1` has the stream of the
//! binary form cut into binary messages anywhere, so that chunks and lanes work as on TCP. What is compressed as a stream is cut into
//! binary messages in the same way, whichever form it carries.
//!
//! The frames are our own, as TLS's bytes are rustls's: a writer here never waits, shares the network's bytes with nobody's
//! buffer while it takes them, and must be able to take back what has not left (docs/decisions.md).

mod frame;
mod handshake;
#[cfg(test)]
mod tests;

use std::cell::RefCell;
use std::io::{self, ErrorKind, IoSlice};
use std::task::{Context, Poll, ready};
use std::time::Instant;

use bytes::{Buf as _, BufMut, BytesMut};
use mom_proto::{Code, Micros, WireError};
use parking_lot::Mutex;

use crate::carrier::Carrier;
use crate::turn::next_turn;
use crate::{Privacy, TcpState};
use frame::{CONTINUATION, Fault, Head, Incoming, Rules};

pub(crate) use handshake::connect;
pub use handshake::{UpgradeRefused, WebSocketUpgrade};

/// Read at once from the network.
const AT_ONCE: usize = 64 * 1024;

/// Taken at once from a writer: what has been taken cannot be overtaken.
const AHEAD: usize = 64 * 1024;

/// Frames made at once: the system takes 1024 pieces, two to each of them and a few more.
const FRAMES: usize = 256;

thread_local! {
    /// What has arrived and is not taken apart: used within a turn only, so that idle connections need no memory for it.
    static ARRIVED: RefCell<BytesMut> = RefCell::new(BytesMut::with_capacity(AT_ONCE));
}

/// One WebSocket connection, shared by its two halves.
#[derive(Debug)]
pub(crate) struct WebSocket {
    carrier: Carrier,
    rules: Rules,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    began: Instant,
    incoming: Incoming,
    /// What came with the handshake.
    first: BytesMut,
    /// What the network has not taken yet of frames that were begun, and answers to pings.
    out: BytesMut,
    /// The last byte that was taken is not told yet, since the network has not taken all that was made of it: a task that
    /// writes comes back for that byte, and so the rest is sent.
    owed: bool,
    /// A text message was begun and has no end yet.
    in_message: bool,
    /// What is sent is not text any more: it is compressed.
    sends_binary: bool,
    /// The end was said.
    finished: bool,
    /// What is wrong with what the other side has sent: said at the end, behind what there is to say in its own words.
    fault: Option<Fault>,
    /// Bytes given to the network, and bytes taken from writers.
    sent: u64,
    taken: u64,
    /// How many more were given than taken when all was sent the last time.
    overhead: u64,
}

impl WebSocket {
    /// Who could have read along.
    pub(crate) fn privacy(&self) -> Privacy {
        self.carrier.privacy()
    }

    fn new(carrier: Carrier, rules: Rules, first: BytesMut) -> WebSocket {
        let state = State {
            began: Instant::now(),
            incoming: Incoming::default(),
            first,
            out: BytesMut::new(),
            owed: false,
            in_message: false,
            sends_binary: false,
            fault: None,
            finished: false,
            sent: 0,
            taken: 0,
            overhead: 0,
        };
        WebSocket {
            carrier,
            rules,
            state: Mutex::new(state),
        }
    }

    /// Reads what has arrived; 0 bytes at the end. Stateless for its caller, so that it may be begun anew at each poll.
    pub(crate) fn poll_read(
        &self,
        room: &mut impl BufMut,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        let before = room.remaining_mut();
        let open = ARRIVED.with_borrow_mut(|arrived| {
            arrived.clear();
            let mut state = self.state.lock();
            if let Some(fault) = state.fault {
                return Poll::Ready(Err(io::Error::new(ErrorKind::InvalidData, wire_error(fault))));
            }
            if state.incoming.closed {
                // The close came together with what was read before it.
                return Poll::Ready(Ok(false));
            }
            let first = std::mem::take(&mut state.first);
            drop(state);
            if first.is_empty() {
                let mut some = arrived.limit(AT_ONCE.min(room.remaining_mut()));
                if ready!(self.carrier.poll_read(&mut some, context))? == 0 {
                    return Poll::Ready(Ok(false));
                }
            } else {
                arrived.extend_from_slice(&first);
            }
            Poll::Ready(self.take_in(arrived, room))
        });
        let read = before - room.remaining_mut();
        match ready!(open)? {
            // What it has read for nothing was its turn.
            true if read == 0 => next_turn(context),
            _ => Poll::Ready(Ok(read)),
        }
    }

    /// Takes apart what has arrived; false at the end.
    fn take_in(&self, arrived: &mut [u8], room: &mut impl BufMut) -> io::Result<bool> {
        let mut state = self.state.lock();
        let State {
            incoming, out, began, ..
        } = &mut *state;
        let now = began.elapsed().as_micros() as Micros;
        let taken = incoming.take(arrived, self.rules, room, out, now);
        if let Err(fault) = taken {
            state.fault.get_or_insert(fault);
        } else if state.incoming.closed {
            state.finish(frame::NORMAL, self.rules);
            if state.incoming.left && !self.rules.client {
                // Told behind what was read before it; its sender is not waited for.
                state.fault.get_or_insert(frame::LEFT);
                state.send(&self.carrier)?;
                return Ok(true);
            }
        }
        state.send(&self.carrier)?;
        match taken {
            Ok(()) => Ok(!state.incoming.closed),
            Err(fault) => Err(io::Error::new(ErrorKind::InvalidData, wire_error(fault))),
        }
    }

    /// Writes the front of these pieces; gives how much of it, none if the network takes nothing now.
    pub(crate) fn try_write(&self, pieces: &[IoSlice<'_>]) -> io::Result<Option<usize>> {
        let mut state = self.state.lock();
        if !state.send(&self.carrier)? {
            return Ok(None);
        }
        if state.finished {
            return Err(ErrorKind::BrokenPipe.into());
        }
        let begun = std::mem::take(&mut state.owed);
        let taken = state.take(pieces, begun, self.rules, &self.carrier)?;
        state.owed = !state.send(&self.carrier)?;
        match usize::from(begun) + taken - usize::from(state.owed) {
            0 => Ok(None),
            told => Ok(Some(told)),
        }
    }

    /// From now on, takes binary messages also where text was agreed on: the other side may compress what follows.
    pub(crate) fn take_binary(&self) {
        self.state.lock().incoming.takes_binary = true;
    }

    /// From now on, sends binary messages. No text message is under way.
    pub(crate) fn begin_binary(&self) {
        self.state.lock().sends_binary = true;
    }

    /// What still comes is read for its end only.
    pub(crate) fn forget(&self) {
        self.carrier.forget();
    }

    pub(crate) async fn writable(&self) -> io::Result<()> {
        self.carrier.writable().await
    }

    /// The state of the network, as if it knew the bytes that were taken only.
    pub(crate) fn link(&self) -> Option<TcpState> {
        let mut link = self.carrier.link()?;
        link.acknowledged = link.acknowledged.saturating_sub(self.state.lock().overhead);
        Some(link)
    }

    /// Says that nothing more comes from this end.
    pub(crate) fn finish(&self) {
        let mut state = self.state.lock();
        let fault = state.fault.take().unwrap_or(frame::NORMAL);
        state.finish(fault, self.rules);
        // A link that is gone or full needs no goodbye.
        let _ = state.send(&self.carrier);
        self.carrier.finish();
    }
}

impl State {
    /// Makes frames of the front of these pieces and gives them to the network; gives how much of it. `begun` = the first byte
    /// is in a frame already.
    fn take(
        &mut self,
        pieces: &[IoSlice<'_>],
        begun: bool,
        rules: Rules,
        carrier: &Carrier,
    ) -> io::Result<usize> {
        let mut pieces = pieces.to_vec();
        let mut rest = &mut pieces[..];
        IoSlice::advance_slices(&mut rest, usize::from(begun));
        let frames = match rules.text && !self.sends_binary {
            true => self.plan_text(rest),
            false => plan_binary(rest),
        };
        let taken = frames.iter().map(|frame| frame.size).sum::<usize>();
        self.taken += taken as u64;
        let heads: Vec<Head> = frames
            .iter()
            .map(|frame| Head::new(frame.kind, frame.last, frame.size, rules.mask()))
            .collect();
        let mut slices = Vec::with_capacity(rest.len() + 2 * heads.len());
        let mut walk = Walk { pieces: rest, at: 0 };
        for (frame, head) in frames.iter().zip(&heads) {
            slices.push(IoSlice::new(head.bytes()));
            if rules.client {
                // Masked, so in memory of its own.
                self.out.extend_from_slice(head.bytes());
                let from = self.out.len();
                walk.give(frame.size, |bytes| self.out.extend_from_slice(bytes));
                let mut mask = [0; 4];
                mask.copy_from_slice(&head.bytes()[head.bytes().len() - 4..]);
                frame::apply(&mut self.out[from..], mask, 0);
            } else {
                walk.give(frame.size, |bytes| slices.push(IoSlice::new(bytes)));
            }
        }
        if rules.client || slices.is_empty() {
            return Ok(taken);
        }
        let written = carrier.try_write(&slices)?.unwrap_or_default();
        self.sent += written as u64;
        // What a frame's head has announced has to follow, whatever becomes of the parcels.
        let mut unsent = &mut slices[..];
        IoSlice::advance_slices(&mut unsent, written);
        for slice in unsent {
            self.out.extend_from_slice(slice);
        }
        Ok(taken)
    }

    /// The frames for lines of text: one message for each, which goes in fragments if it is long.
    fn plan_text(&mut self, pieces: &[IoSlice<'_>]) -> Vec<Planned> {
        let (mut frames, mut size, mut left) = (Vec::new(), 0, AHEAD);
        for piece in pieces {
            let mut rest = &piece[..];
            while !rest.is_empty() && left > 0 && frames.len() < FRAMES {
                let line = memchr::memchr(b'\n', rest).map(|at| at + 1);
                let taken = line.unwrap_or(rest.len()).min(left);
                (size, left, rest) = (size + taken, left - taken, &rest[taken..]);
                if line == Some(taken) {
                    frames.push(self.planned(size, true));
                    size = 0;
                }
            }
        }
        if size > 0 {
            frames.push(self.planned(size, false));
        }
        frames
    }

    fn planned(&mut self, size: usize, last: bool) -> Planned {
        let kind = match self.in_message {
            true => CONTINUATION,
            false => frame::TEXT,
        };
        self.in_message = !last;
        Planned { kind, last, size }
    }

    /// Gives the network what waits; false if it does not take all.
    fn send(&mut self, carrier: &Carrier) -> io::Result<bool> {
        while !self.out.is_empty() {
            match carrier.try_write(&[IoSlice::new(&self.out)])? {
                Some(written) => {
                    self.sent += written as u64;
                    self.out.advance(written);
                }
                None => return Ok(false),
            }
        }
        self.out = BytesMut::new();
        self.overhead = self.sent.saturating_sub(self.taken);
        Ok(true)
    }

    fn finish(&mut self, fault: Fault, rules: Rules) {
        if !self.finished {
            self.finished = true;
            frame::add_close(&mut self.out, fault, rules.mask());
        }
    }
}

/// A frame to be made.
struct Planned {
    kind: u8,
    last: bool,
    size: usize,
}

/// One frame for all of it: messages may end anywhere.
fn plan_binary(pieces: &[IoSlice<'_>]) -> Vec<Planned> {
    let size = pieces.iter().map(|piece| piece.len()).sum::<usize>().min(AHEAD);
    let frame = Planned {
        kind: frame::BINARY,
        last: true,
        size,
    };
    Vec::from_iter((size > 0).then_some(frame))
}

/// Goes along pieces.
struct Walk<'a> {
    pieces: &'a [IoSlice<'a>],
    at: usize,
}

impl<'a> Walk<'a> {
    /// Gives the next so many bytes.
    fn give(&mut self, mut size: usize, mut to: impl FnMut(&'a [u8])) {
        while size > 0 {
            let Some(piece) = self.pieces.first() else { return };
            let here = size.min(piece.len() - self.at);
            to(&piece[self.at..self.at + here]);
            size -= here;
            self.at += here;
            if self.at == piece.len() {
                self.pieces = &self.pieces[1..];
                self.at = 0;
            }
        }
    }
}

fn wire_error(fault: Fault) -> WireError {
    let code = match fault == frame::LEFT {
        true => Code::DISCONNECTED,
        false => Code::BAD_FRAME,
    };
    WireError::new(code, format!("WebSocket: {}", fault.text))
}
