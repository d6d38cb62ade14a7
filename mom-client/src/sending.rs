//! The writer of one link: asks the outbox for as much as the network has room for.

use std::collections::VecDeque;
use std::sync::Arc;

use mom_net::{Flow, GATHER, NetError, Pause, Writer};
use mom_proto::codec::Form;
use tokio::time::{Instant, sleep_until};

use crate::outbox::{Knife, Mark, Piece, Room};
use crate::shared::Shared;

/// Taken at once: what is taken cannot be overtaken while it is written.
const BATCH_PIECES: usize = 64;
const BATCH_BYTES: usize = 256 * 1024;

/// How far a turn came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    /// Something was written, and there may be more.
    Wrote,
    /// Nothing waits.
    Nothing,
    /// Nothing, and never again.
    End,
    /// The link is lost already, and the outbox another's.
    Gone,
    /// The link takes no more now.
    Blocked,
    /// The network holds as much as it may.
    Paced,
}

/// Writes until the outbox says that nothing follows. `link` is the number of the link in the outbox's mark.
pub(crate) async fn write(shared: Arc<Shared>, writer: Writer, link: u64) -> Result<(), NetError> {
    let mut sending = Sending {
        shared,
        writer,
        flow: Flow::default(),
        batch: VecDeque::new(),
        taken: Mark::default(),
        link,
    };
    let mut pause = Pause::default();
    loop {
        let turn = sending.turn()?;
        match turn {
            Turn::Wrote => {}
            Turn::Nothing => sending.shared.outgoing.notified().await,
            Turn::Blocked => sending.writer.ready().await?,
            Turn::Paced => {
                sending.pause(Instant::now() + pause.time()).await;
                pause.look(&sending.flow);
            }
            Turn::End => {
                sending.writer.finish();
                return Ok(());
            }
            Turn::Gone => return Ok(()),
        }
    }
}

/// One link's writer.
struct Sending {
    shared: Arc<Shared>,
    writer: Writer,
    flow: Flow,
    /// Empty between turns: what a link did not take is in the outbox, where it can be overtaken and nothing of it is
    /// lost with this task.
    batch: VecDeque<Piece>,
    /// The outbox as it was when the batch was taken.
    taken: Mark,
    link: u64,
}

impl Sending {
    /// Takes what may be written, writes it, and puts back what the link did not take.
    fn turn(&mut self) -> Result<Turn, NetError> {
        let turn = self.take();
        if self.batch.is_empty() {
            return Ok(turn);
        }
        let mut room = Room::default();
        let written = self.write_batch(&mut room);
        let mut returned = Vec::new();
        if !self.batch.is_empty() {
            let mut state = self.shared.lock();
            while let Some(piece) = self.batch.pop_back() {
                returned.extend(state.outbox.put_back(piece, self.taken));
            }
        }
        self.shared.give_room(room);
        self.shared.tell_returned(returned);
        Ok(if written? { Turn::Wrote } else { Turn::Blocked })
    }

    fn take(&mut self) -> Turn {
        let room = self.flow.room(|| self.writer.link()).min(BATCH_BYTES);
        let piece = self.flow.piece();
        let mut state = self.shared.lock();
        let parcel = state.me.limits.parcel;
        let outbox = &mut state.outbox;
        // A lost link does not wait for the end of its writer, which stops at the next thing that it waits for.
        if outbox.mark().link != self.link {
            return Turn::Gone;
        }
        self.taken = outbox.mark();
        self.batch.extend(outbox.take_begun());
        let mut bytes = 0;
        while self.batch.len() < BATCH_PIECES {
            let next = match room.checked_sub(bytes) {
                // Pieces rather a little too large than very small ones.
                Some(left) if left > 0 => outbox.pop(match self.writer.form() {
                    Some(Form::Binary) => Knife {
                        most: piece.min(left.max(piece / 2)),
                        parcel,
                    },
                    _ => Knife::blunt(),
                }),
                _ => outbox.pop_urgent(),
            };
            let Some(next) = next else { break };
            bytes += next.left();
            self.batch.push_back(next);
        }
        if !outbox.is_empty() {
            return Turn::Paced;
        }
        self.flow.rest();
        match outbox.is_finished() {
            true => Turn::End,
            false => Turn::Nothing,
        }
    }

    /// Writes the batch as far as the link takes it: false if it takes no more now. Adds the room of what has left.
    fn write_batch(&mut self, room: &mut Room) -> Result<bool, NetError> {
        while let Some(front) = self.batch.front() {
            if self.writer.form().is_none() {
                if let Some(parcel) = front.parcel()
                    && !self.writer.try_pass(parcel)?
                {
                    return Ok(false);
                }
                *room += self
                    .batch
                    .pop_front()
                    .map_or_else(Room::default, |piece| piece.room());
                continue;
            }
            let mut slices = Vec::with_capacity(GATHER.min(self.batch.len() * 2 + 1));
            self.batch.iter().for_each(|piece| piece.append_to(&mut slices));
            let Some(mut written) = self.writer.try_write_pieces(&slices)? else {
                return Ok(false);
            };
            self.flow.wrote(written);
            while let Some(front) = self.batch.front_mut() {
                written = front.advance(written);
                if front.left() > 0 {
                    break;
                }
                *room += self
                    .batch
                    .pop_front()
                    .map_or_else(Room::default, |piece| piece.room());
            }
        }
        Ok(true)
    }

    /// Waits for the network, unless something comes that does not.
    async fn pause(&self, end: Instant) {
        loop {
            tokio::select! {
                () = sleep_until(end) => return,
                () = self.shared.outgoing.notified() => {
                    if self.shared.lock().outbox.is_urgent() {
                        return;
                    }
                }
            }
        }
    }
}
