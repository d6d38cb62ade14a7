//! The writer of one link: asks the outbox for as much as the network has room for.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use mom_net::{Flow, NetError, Pause, Piece, Writer, write_batch};
use tokio::time::{Instant, sleep_until};

use crate::peer::shared::Shared;
use crate::wire::outbox::{Capacity, Entry, Mark};

/// How far a write came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Written {
    /// Something was written, and there may be more.
    Some,
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
    let mut sending = LinkWriter {
        shared,
        writer,
        flow: Flow::default(),
        batch: VecDeque::new(),
        taken: Mark::default(),
        link,
    };
    let mut pause = Pause::default();
    loop {
        match sending.write_on()? {
            Written::Some => {}
            Written::Nothing => sending.shared.outgoing.notified().await,
            Written::Blocked => sending.writer.ready().await?,
            Written::Paced => {
                sending.pause(Instant::now() + pause.time()).await;
                pause.look(&sending.flow);
            }
            Written::End => {
                sending.writer.finish();
                return Ok(());
            }
            Written::Gone => return Ok(()),
        }
    }
}

/// One link's writer.
struct LinkWriter {
    shared: Arc<Shared>,
    writer: Writer,
    flow: Flow,
    /// Empty between writes: what a link did not take is in the outbox, where it can be overtaken and nothing of it is
    /// lost with this task.
    batch: VecDeque<Piece<Entry>>,
    /// The outbox as it was when the batch was taken.
    taken: Mark,
    link: u64,
}

impl LinkWriter {
    /// Takes what may be written, writes it, and puts back what the link did not take.
    fn write_on(&mut self) -> Result<Written, NetError> {
        let taken = self.take();
        if self.batch.is_empty() {
            if taken == Written::Nothing {
                self.flow.rest();
            }
            return Ok(taken);
        }
        let mut capacity = Capacity::default();
        let form = self.writer.form();
        let written = {
            // Writing never waits.
            let counts = self.shared.counts.load(Ordering::Relaxed);
            let mut ledger = counts.then(|| self.shared.ledger.lock());
            write_batch(&self.writer, form, &mut self.flow, &mut self.batch, |piece| {
                let entry = piece.item().filter(|_| piece.is_last());
                capacity += entry.map(|entry| entry.take_capacity()).unwrap_or_default();
                if let Some(ledger) = ledger.as_mut().and_then(|ledger| ledger.as_mut()) {
                    ledger.note(piece, form);
                }
            })
        };
        self.shared.give_capacity(capacity);
        if !self.batch.is_empty() {
            let dropped = {
                let mut state = self.shared.lock();
                state.outbox.put_back(&mut self.batch, self.taken);
                state.outbox.take_dropped()
            };
            self.shared.tell_dropped(&dropped);
        }
        Ok(if written? { Written::Some } else { Written::Blocked })
    }

    fn take(&mut self) -> Written {
        let mut allowance = self.flow.allowance(&self.writer);
        allowance.bytes = allowance.bytes.min(self.shared.room_to_keep());
        let wall = self.shared.clock.wall();
        let now = wall.and_then(|wall| u64::try_from(wall.micros()).ok());
        let mut state = self.shared.lock();
        let parcel = state.me.limits.parcel;
        let outbox = &mut state.outbox;
        // A lost link does not wait for the end of its writer, which stops at the next thing that it waits for.
        if outbox.mark().link != self.link {
            return Written::Gone;
        }
        self.taken = outbox.mark();
        let all = outbox.take(now.unwrap_or_default(), allowance, parcel, &mut self.batch);
        let (finished, expired) = (outbox.is_finished(), outbox.take_dropped());
        state.tell_replaced();
        drop(state);
        self.shared.tell_dropped(&expired);
        match (all, finished) {
            (false, _) => Written::Paced,
            (true, true) => Written::End,
            (true, false) => Written::Nothing,
        }
    }

    /// Waits for the network, unless something comes that does not.
    async fn pause(&self, end: Instant) {
        loop {
            tokio::select! {
                () = sleep_until(end) => return,
                () = self.shared.outgoing.notified() => {
                    if self.shared.lock().outbox.has_unpaced() {
                        return;
                    }
                }
            }
        }
    }
}
