//! What a connection waits for between frames, what ends its waiting, and what it does meanwhile.

use std::io::ErrorKind;
use std::pin::pin;
use std::sync::Arc;

use mom_net::{NetError, Reader};
use mom_proto::codec::{Deferred, Frame};
use mom_proto::{Verb, WireError};
use tokio::sync::oneshot;
use tokio::time::{Instant, sleep_until};

use super::behind::{Behind, withdrawn};
use super::login::Login;
use super::{Connection, End, Next, closed, is_sign_of_life, login};
use crate::traffic::capacity::WaitingMessage;
use crate::traffic::memory::Charge;
use crate::traffic::switchboard::{Handled, Touched, flush};

impl Connection {
    /// Does what takes its time before the next frame.
    pub(super) async fn go_on(
        &mut self,
        mut next: Next,
        reader: &mut Reader,
        touched: &mut Touched,
    ) -> Result<(), End> {
        if let Next::Memory(message) = next {
            self.wait_for_memory(reader, true, touched).await?;
            next = self.send(message, touched);
        }
        match next {
            Next::Frame | Next::Memory(_) => Ok(()),
            // Nothing is read meanwhile, so the network holds the peer back.
            Next::Pause(time) => {
                let over = tokio::time::sleep(time);
                self.meanwhile(over, reader, false, touched).await
            }
            Next::Login(login) => match self.login(reader, &login, touched).await {
                Ok(Login::Goes) => Ok(()),
                Ok(Login::Became) => Err(End::Became),
                Err(error) => Err(Some(error).into()),
            },
            Next::Capacity(held, reference) => self.wait_for_capacity(held, reference, reader, touched).await,
            Next::End(error) => Err(Some(*error).into()),
        }
    }

    /// Waits until the connection is to end.
    async fn called(&self) {
        loop {
            self.outbox.end.notified().await;
            // It may have been called before, on another connection of the same peer.
            if self.is_called() {
                return;
            }
        }
    }

    pub(super) fn is_called(&self) -> bool {
        let claimed = self.link.as_ref().is_some_and(|served| served.link.is_claimed());
        claimed || self.outbox.is_closed() || self.outbox.is_broken()
    }

    /// What to say at the end.
    pub(super) fn closing(&self) -> Option<WireError> {
        self.outbox.closing().and_then(|closing| closing.error)
    }

    /// Waits for something, and gives it. Meanwhile the peer is heard and hears that the hub is there, and with `reads` what comes behind
    /// is read on, within bounds. Gives how the connection ends if it does.
    async fn meanwhile<T>(
        &mut self,
        what: impl Future<Output = T>,
        reader: &mut Reader,
        reads: bool,
        touched: &mut Touched,
    ) -> Result<T, End> {
        let mut what = pin!(what);
        let mut ended = false;
        loop {
            let reads = reads && self.read_on(reader, touched)? && !ended;
            flush(touched);
            let began = Instant::now();
            let wake = match reads {
                true => self.look_at(),
                false => self.beat_at,
            };
            let woken = tokio::select! {
                biased;
                () = self.called() => return Err(self.closing().into()),
                () = self.proof_over() => return Err(Some(login::proof_over()).into()),
                done = &mut what => Woken::Done(done),
                arrived = reader.arrive(), if reads => Woken::Arrived(arrived),
                () = sleep_until(wake) => Woken::Late,
            };
            if !reads {
                // Nobody is heard who is not read.
                self.excuse(began.elapsed());
            }
            match woken {
                Woken::Done(done) => return Ok(done),
                Woken::Arrived(Ok(true)) => self.note_arrived(reader),
                Woken::Arrived(Err(NetError::Io(error))) if error.kind() != ErrorKind::UnexpectedEof => {
                    return Err(self.failed(error.into()).into());
                }
                // The end is found again when what came before it is handled.
                Woken::Arrived(Ok(false) | Err(_)) => ended = true,
                Woken::Late => self.look(wake, reader)?,
            }
        }
    }

    /// Takes what has come behind something that waits: handles what passes it, and keeps the rest; gives whether more is to be read.
    fn read_on(&mut self, reader: &mut Reader, touched: &mut Touched) -> Result<bool, End> {
        let mut behind = self.arrival.behind.take().unwrap_or_default();
        let mut result = Ok(());
        while result.is_ok() && behind.takes_more() {
            match reader.try_next() {
                // What is large and not decoded ends this, too: it is the first that is taken afterwards.
                Ok(None) => break,
                Ok(Some(frame)) if behind.lets_pass(&frame) => {
                    result = self.pass(&mut behind, frame, touched);
                }
                Ok(Some(frame)) => behind.push(frame),
                Err(fault) => behind.break_off(fault),
            }
        }
        let reads = behind.reads_on(reader.held());
        self.arrival.behind = Some(behind);
        self.count_held(reader, false);
        result.map(|()| reads && !self.charge.as_ref().is_some_and(Charge::is_held))
    }

    /// Handles at once what passes those that came before it. It takes no time.
    fn pass(&mut self, behind: &mut Behind, frame: Frame, touched: &mut Touched) -> Result<(), End> {
        if !is_sign_of_life(&frame) {
            behind.note_passed(&frame);
        }
        let board = &self.services.board;
        let withdraws = match &frame {
            Frame::Parcel(stop) if Verb::of(stop.family, &stop.name) == Ok(Verb::Stop) => {
                behind.withdraw(stop, |parcel| board.number_of(parcel))
            }
            _ => Vec::new(),
        };
        let next = self.handle(frame, touched);
        for reference in withdraws {
            self.refuse(&withdrawn(), reference, touched);
        }
        match next {
            Next::End(error) => Err(Some(*error).into()),
            _ => Ok(()),
        }
    }

    /// Has a large frame of a text form read by a thread that gives way to this one, and waits for that; gives how the connection ends
    /// if it does.
    pub(super) async fn open(
        &mut self,
        frame: Deferred,
        reader: &mut Reader,
        touched: &mut Touched,
    ) -> Result<Frame, End> {
        let (answer, answered) = oneshot::channel();
        self.arrival.opening = frame.size();
        self.count_held(reader, true);
        let frame = Arc::new(frame);
        let job = Arc::downgrade(&frame);
        self.services.board.workers.run(move || {
            // A connection that has ended has taken it along.
            if let Some(frame) = job.upgrade() {
                let _ = answer.send(frame.open().map(closed));
            }
        });
        // Nothing passes what nobody has read: it may decide what follows.
        let opened = self.meanwhile(answered, reader, false, touched).await;
        drop(frame);
        self.arrival.opening = 0;
        match opened? {
            Ok(frame) => frame.map_err(|error| Some(error).into()),
            Err(_) => Err(End::Over(None)),
        }
    }

    /// Waits until a message can go, or is refused; gives how the connection ends if it does.
    async fn wait_for_capacity(
        &mut self,
        mut held: Box<WaitingMessage>,
        reference: Option<u64>,
        reader: &mut Reader,
        touched: &mut Touched,
    ) -> Result<(), End> {
        let board = Arc::clone(&self.services.board);
        loop {
            self.meanwhile(held.ready(&board.clock), reader, true, touched)
                .await?;
            let clock = |now| self.peer_clock(now);
            let sender = self.sender(&clock);
            match board.resume(&sender, &self.services.limits, *held, touched) {
                Ok(Handled::Done) => return Ok(()),
                Ok(Handled::Waits(still)) => held = still,
                Err(error) => {
                    self.refuse(&error, reference, touched);
                    return Ok(());
                }
            }
        }
    }

    /// Waits until the hub has memory for more of this user, as long as a sender waits; gives how the connection ends if it does.
    pub(super) async fn wait_for_memory(
        &mut self,
        reader: &mut Reader,
        reads: bool,
        touched: &mut Touched,
    ) -> Result<(), End> {
        let Some(account) = self.charge.as_ref().map(|charge| Arc::clone(charge.account())) else {
            return Ok(());
        };
        let clock = self.services.board.clock.clone();
        let until = clock
            .now()
            .saturating_add(self.services.limits.send_wait.saturating_mul(1000));
        self.meanwhile(account.relieved(&clock, until), reader, reads, touched)
            .await
    }
}

/// What ends a moment of waiting.
enum Woken<T> {
    /// What was waited for.
    Done(T),
    /// Bytes have come, or the end.
    Arrived(Result<bool, NetError>),
    /// It is time to look whether the peer is there.
    Late,
}
