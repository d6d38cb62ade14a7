//! What a connection waits for between frames, and what ends its waiting.

use std::sync::Arc;
use std::time::Duration;

use mom_net::Reader;
use mom_proto::WireError;
use mom_proto::codec::{Deferred, Frame};
use tokio::sync::oneshot;

use super::login::Login;
use super::{Connection, End, Next, closed, login};
use crate::traffic::capacity::WaitingMessage;
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
            self.wait_for_memory(touched).await?;
            next = self.send(message, touched);
        }
        match next {
            Next::Frame | Next::Memory(_) => Ok(()),
            Next::Pause(time) => self.pause(time, touched).await.map_err(End::from),
            Next::Login(login) => match self.login(reader, &login, touched).await {
                Ok(Login::Goes) => Ok(()),
                Ok(Login::Became) => Err(End::Became),
                Err(error) => Err(Some(error).into()),
            },
            // Nothing is read meanwhile, so the network holds the peer back.
            Next::Capacity(held, reference) => {
                let waited = self.wait_for_capacity(held, reference, touched).await;
                waited.map_err(End::from)
            }
            Next::End(error) => Err(Some(*error).into()),
        }
    }

    /// Waits until the connection is to end.
    pub(super) async fn called(&self) {
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

    /// Has a large frame of a text form read by a thread that gives way to this one, and waits for that; gives the error to say if
    /// the connection ends meanwhile.
    pub(super) async fn open(
        &mut self,
        frame: Deferred,
        touched: &mut Touched,
    ) -> Result<Frame, Option<WireError>> {
        flush(touched);
        let (answer, answered) = oneshot::channel();
        self.services.board.workers.run(move || {
            let frame = frame.open().map(closed);
            // Nobody listens if the connection has ended.
            let _ = answer.send(frame);
        });
        match answered.await {
            Ok(frame) => frame.map_err(Some),
            Err(_) => Err(None),
        }
    }

    /// Waits until a message can go, or is refused; gives the error to say if the connection ends meanwhile.
    pub(super) async fn wait_for_capacity(
        &mut self,
        mut held: Box<WaitingMessage>,
        reference: Option<u64>,
        touched: &mut Touched,
    ) -> Result<(), Option<WireError>> {
        loop {
            flush(touched);
            tokio::select! {
                biased;
                () = self.called() => return Err(self.closing()),
                () = self.proof_over() => return Err(Some(login::proof_over())),
                () = held.ready(&self.services.board.clock) => {}
            }
            let clock = |now| self.peer_clock(now);
            let sender = self.sender(&clock);
            match self
                .services
                .board
                .resume(&sender, &self.services.limits, *held, touched)
            {
                Ok(Handled::Done) => return Ok(()),
                Ok(Handled::Waits(still)) => held = still,
                Err(error) => {
                    self.refuse(&error, reference, touched);
                    return Ok(());
                }
            }
        }
    }

    /// Waits until the hub has memory for more of this user, as long as a sender waits; gives the error to say if the
    /// connection ends meanwhile. Nothing is read meanwhile, so the network holds the peer back.
    pub(super) async fn wait_for_memory(&mut self, touched: &mut Touched) -> Result<(), Option<WireError>> {
        flush(touched);
        let Some(account) = self.charge.as_ref().map(|charge| Arc::clone(charge.account())) else {
            return Ok(());
        };
        let clock = &self.services.board.clock;
        let until = clock
            .now()
            .saturating_add(self.services.limits.send_wait.saturating_mul(1000));
        tokio::select! {
            biased;
            () = self.called() => Err(self.closing()),
            () = self.proof_over() => Err(Some(login::proof_over())),
            () = account.relieved(clock, until) => Ok(()),
        }
    }

    /// Reads nothing for a time; gives the error to say if the connection ends meanwhile.
    pub(super) async fn pause(&self, time: Duration, touched: &mut Touched) -> Result<(), Option<WireError>> {
        flush(touched);
        tokio::select! {
            biased;
            () = self.called() => Err(self.closing()),
            () = self.proof_over() => Err(Some(login::proof_over())),
            () = tokio::time::sleep(time) => Ok(()),
        }
    }
}
