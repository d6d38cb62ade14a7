//! A peer whose connection is lost, until another one goes on with it or its time is over.

use std::sync::Arc;

use mom_hub::{Input, PeerId};
use mom_proto::WireError;
use mom_system::Expiry;

use super::doors::UserPlace;
use super::links::Served;
use super::login::proof_over;
use super::measure::{Measure, Pings};
use super::requests::Requests;
use super::services::SharedServices;
use super::{Connection, Services};
use crate::traffic::memory::Charge;
use crate::traffic::outbox::Outbox;
use crate::traffic::switchboard::{Touched, flush};

/// What outlives a connection.
#[derive(Debug)]
pub(super) struct Parked {
    pub(super) services: Services,
    pub(super) served: Box<Served>,
    pub(super) proven_until: Option<Box<Expiry>>,
    pub(super) requests: Requests,
    pub(super) pings: Pings,
    pub(super) measure: Measure,
    pub(super) charge: Option<Charge>,
    /// Its part in the counts of connections from outside.
    pub(super) place: Option<UserPlace>,
}

impl Connection {
    /// Whether it has ended so that its peer may come back.
    pub(super) fn is_lost(&self, error: Option<&WireError>) -> bool {
        let failed = error.is_none_or(|error| error.code == mom_proto::Code::SILENT);
        self.link.is_some() && failed && !self.outbox.is_closed() && !self.services.board.is_stopping()
    }

    /// The connection is lost: makes its peer's devices safe, and lets the peer wait for another connection.
    pub(super) fn lose(&mut self, error: Option<WireError>) {
        let Some(served) = self.link.take() else {
            return self.end(error);
        };
        self.ended = true;
        let board = Arc::clone(&self.services.board);
        let writer = self.outbox.detach();
        // Only who is not to come back: any other would count what it hears.
        if let Some(writer) = writer.filter(|_| served.link.is_claimed()) {
            let error = self.services.answer(&super::resume::taken_over());
            let _ = writer.try_last_word(error);
        }
        let (peer, grace) = (self.peer(), served.link.grace);
        let grace_micros = u64::try_from(grace.as_micros()).unwrap_or(u64::MAX);
        let mut touched = Touched::new();
        let input = Input::Lost {
            peer,
            grace: grace_micros,
        };
        board.decide(input, &mut touched);
        flush(&mut touched);
        let user = board.tap.audit.user(peer);
        if self
            .services
            .is_first("link lost", self.arrival.remote.from, user.as_deref())
        {
            tracing::info!(peer = peer.0, name = %self.outbox.name(), ?grace, "link lost");
        }
        let parked = Parked {
            services: self.services.clone(),
            served,
            proven_until: self.proven_until.take(),
            requests: std::mem::take(&mut self.requests),
            pings: std::mem::take(&mut self.pings),
            measure: std::mem::take(&mut self.measure),
            charge: self.charge.take(),
            place: self.arrival.seat.take().and_then(super::Seat::park),
        };
        parked.wait();
    }
}

impl Parked {
    pub(super) fn outbox(&self) -> &Arc<Outbox> {
        &self.served.link.outbox
    }

    pub(super) fn peer(&self) -> PeerId {
        self.served.link.peer()
    }

    /// Waits, in a task of its own, until another connection goes on or the hub lets the peer go.
    pub(super) fn wait(self) {
        tokio::spawn(async move {
            let mut parked = self;
            let outbox = Arc::clone(parked.outbox());
            let error = loop {
                if let Some(give) = parked.served.link.claimed() {
                    match give.send(parked) {
                        Ok(()) => return,
                        Err(kept) => parked = kept,
                    }
                    continue;
                }
                if outbox.is_closed() {
                    break outbox.closing().and_then(|closing| closing.error);
                }
                tokio::select! {
                    () = outbox.end.notified() => {}
                    () = parked.proof_over() => break Some(proof_over()),
                }
            };
            parked.end(error);
        });
    }

    async fn proof_over(&self) {
        match self.proven_until.as_deref() {
            Some(until) => self.services.board.clock.reach_expiry(*until).await,
            None => std::future::pending().await,
        }
    }

    /// Its peer is gone.
    pub(super) fn end(self, error: Option<WireError>) {
        let (peer, outbox) = (self.peer(), Arc::clone(self.outbox()));
        let SharedServices {
            board, logins, links, ..
        } = &*self.services;
        let mut touched = Touched::new();
        links.close(&self.served.link);
        logins.forget(peer);
        let name = outbox.name();
        board.decide(Input::Gone { peer }, &mut touched);
        let user = board.tap.audit.user(peer);
        if self.services.is_first("gone", None, user.as_deref()) {
            tracing::info!(peer = peer.0, %name, code = ?error.as_ref().map(|error| error.code.word()), "gone");
        }
        board.close(&outbox, error);
        flush(&mut touched);
        board.remove_outbox(&outbox);
    }
}
