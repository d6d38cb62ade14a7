//! The part of a connection that asks who its peer is.

use std::sync::Arc;

use mom_hub::Input;
use mom_login::{Challenge, Granted, LoginStep};
use mom_net::Reader;
use mom_proto::{Code, Family, Limits, Parcel, Path, Value, Verb, WireError};
use tokio::sync::oneshot;
use tokio::time::Instant;

use super::Connection;
use crate::traffic::outbox::LoginFacts;
use crate::traffic::switchboard::{Touched, flush};

/// Whether this is part of a login.
pub(super) fn concerns(parcel: &Parcel) -> bool {
    [Verb::Login, Verb::Answer]
        .iter()
        .any(|verb| verb.word() == parcel.name())
}

/// What a peer hears whose token has expired.
pub(super) fn proof_over() -> WireError {
    let text = "the token has expired; log in again with a new one before that";
    WireError::new(Code::REVOKED, text)
}

impl Connection {
    pub(super) async fn login(
        &mut self,
        reader: &mut Reader,
        parcel: &Parcel,
        touched: &mut Touched,
    ) -> Result<(), WireError> {
        // What was caused so far must not wait for a password to be hashed.
        flush(touched);
        let logins = Arc::clone(&self.services.logins);
        let claimed = self.claimed(parcel);
        // Whatever comes now, the last challenge is over.
        let challenge = self.challenge.take();
        if let Some(seat) = &self.arrival.seat {
            seat.set_proving(true);
        }
        let step = if parcel.name() == Verb::Answer.word() {
            logins
                .answer(
                    parcel,
                    challenge.map(|challenge| *challenge),
                    self.arrival.remote.from,
                )
                .map(LoginStep::Granted)
        } else {
            logins.check(parcel, &self.arrival.link()).await
        };
        let refused = match step {
            Ok(LoginStep::Challenge(challenge)) => {
                self.challenge(challenge, parcel.id, touched);
                Ok(())
            }
            Ok(LoginStep::Granted(granted)) => self.admit(reader, granted, parcel.id, touched),
            Err(error) => Err(error),
        };
        if let Some(seat) = &self.arrival.seat {
            seat.set_proving(false);
        }
        refused.or_else(|error| self.refuse_login(error, claimed, parcel.id, touched))
    }

    /// Waits until the proof of who the peer is, if it is one for a time, is over.
    pub(super) async fn proof_over(&self) {
        match self.proven_until.as_deref() {
            Some(until) => Box::pin(self.services.board.clock.reach_expiry(*until)).await,
            None => std::future::pending().await,
        }
    }

    /// Whether it is over by now.
    pub(super) fn is_proof_over(&self) -> bool {
        let until = self.proven_until.as_deref();
        until.is_some_and(|until| self.services.board.clock.is_over(*until))
    }

    fn challenge(&mut self, challenge: Challenge, reference: Option<u64>, touched: &mut Touched) {
        let mut reply = Parcel::new(Family::Reply, "challenge")
            .context(Path::root())
            .content(challenge.content());
        reply.reference = reference;
        self.services.board.tell(self.peer, reply, touched);
        self.challenge = Some(Box::new(challenge));
    }

    fn admit(
        &mut self,
        reader: &mut Reader,
        granted: Granted,
        id: Option<u64>,
        touched: &mut Touched,
    ) -> Result<(), WireError> {
        let (peer, board) = (self.peer, Arc::clone(&self.services.board));
        if let Some(seat) = &mut self.arrival.seat {
            seat.log_in(granted.user())?;
        }
        if self
            .services
            .is_first("logged in", self.arrival.remote.from, Some(granted.user()))
        {
            tracing::info!(peer = peer.0, user = granted.user(), origin = ?granted.origin(), from = ?self.arrival.remote.from, "logged in");
        }
        let account = board.memory.account(&granted.user().into());
        let logged_in = &mut self.logged_in;
        let decide = |user, nickname| {
            // First: whatever happens then, the hub hears of the end.
            *logged_in = true;
            let login = Input::Login {
                peer,
                user,
                nickname,
                id,
            };
            board.decide(login, touched);
        };
        let until = self.services.logins.admit(peer, granted, decide)?;
        self.proven_until = until.map(Box::new);
        reader.set_limits(&self.services.limits);
        reader.trust();
        let name = board.peer_name(peer).unwrap_or_default();
        let limits = &self.services.limits;
        self.charge = Some(account.charge(0));
        let link = self.arrival.link();
        let login = LoginFacts {
            from: link.from,
            tls: link.private,
            since: board.clock.wall(),
        };
        // Its first bytes may have come with those by which its form was told.
        self.outbox.note_heard(reader.received());
        self.outbox.admit(limits, name, account, login);
        Ok(())
    }

    fn refuse_login(
        &mut self,
        error: WireError,
        claimed: Option<Arc<str>>,
        reference: Option<u64>,
        touched: &mut Touched,
    ) -> Result<(), WireError> {
        self.audit_login(claimed.clone(), &error.code);
        if self
            .services
            .is_first("login refused", self.arrival.remote.from, Some(error.code.word()))
        {
            tracing::info!(peer = self.peer.0, from = ?self.arrival.remote.from, code = %error.code, "login refused");
        }
        if [Code::BAD_LOGIN, Code::BAD_CONTENT].contains(&error.code) {
            self.failures += 1;
        }
        if error.code.closes() {
            return Err(error);
        }
        self.refuse(&error, reference, touched);
        if self.failures < self.services.logins.attempts() {
            return Ok(());
        }
        self.audit_login(claimed, &Code::TOO_MANY_LOGINS);
        Err(WireError::new(
            Code::TOO_MANY_LOGINS,
            "too many failed logins on one connection",
        ))
    }

    /// The user that a peer claims to be, if there is one of that name: others may be secrets in the wrong place.
    fn claimed(&self, parcel: &Parcel) -> Option<Arc<str>> {
        let content = parcel.value();
        let name = match &self.challenge {
            Some(challenge) if parcel.name() == Verb::Answer.word() => Some(challenge.user()),
            _ => content.get("name").and_then(Value::as_str),
        };
        let known = |name: &&str| self.services.logins.knows(name);
        name.filter(known).map(Arc::from)
    }

    /// Notes a login that was refused.
    fn audit_login(&self, claimed: Option<Arc<str>>, code: &Code) {
        // Only who was here before, as another user perhaps, has a name.
        let name = Some(self.outbox.name()).filter(|name| !name.is_empty());
        let tap = &self.services.board.tap;
        tap.login_refused(self.peer, name, claimed, code);
    }
}

/// Waits until it is too late for a peer to say in which form it speaks, and gives why.
pub(crate) async fn too_late(
    limits: &Limits,
    login_by: Instant,
    told: impl Future<Output = Result<WireError, oneshot::error::RecvError>>,
) -> WireError {
    tokio::select! {
        Ok(error) = told => error,
        () = tokio::time::sleep_until(login_by) => login_timeout(limits.login_time),
    }
}

pub(crate) fn login_timeout(millis: u64) -> WireError {
    WireError::new(
        Code::LOGIN_TIMEOUT,
        format!("no login within {} s", millis / 1000),
    )
}
