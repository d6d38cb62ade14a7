//! The part of a connection that asks who its peer is.

use std::sync::Arc;

use std::time::Duration;

use mom_hub::{Input, User};
use mom_login::{Granted, LoginStep, UserSource};
use mom_net::{COMPRESSION_MEMORY, Reader};
use mom_proto::codec::Form;
use mom_proto::{Code, Compression, Family, Limits, Map, Parcel, Path, Value, Verb, WireError, check_name};
use tokio::sync::oneshot;
use tokio::time::Instant;

use super::links::Served;
use super::{Asked, Connection};
use crate::traffic::memory::{Account, Gate};
use crate::traffic::outbox::LoginFacts;
use crate::traffic::switchboard::{Touched, flush};

/// How a login went that does not end its connection.
pub(super) enum Login {
    /// It goes on with the same peer.
    Goes,
    /// It goes on with the peer of another connection.
    Became,
}

/// A peer that has asked for its own signs of life is silent after so many of them.
const BEATS: u64 = 3;

/// Whether this is part of a login.
pub(super) fn concerns(parcel: &Parcel) -> bool {
    [Verb::Login, Verb::Answer, Verb::Resume]
        .iter()
        .any(|verb| verb.word() == parcel.name())
}

/// What a peer hears whose token has expired.
pub(super) fn proof_over() -> WireError {
    let text = "the token has expired; log in again with a new one before it expires";
    WireError::new(Code::REVOKED, text)
}

impl Connection {
    pub(super) async fn login(
        &mut self,
        reader: &mut Reader,
        parcel: &Parcel,
        touched: &mut Touched,
    ) -> Result<Login, WireError> {
        // What was caused so far must not wait for a password to be hashed.
        flush(touched);
        let logins = Arc::clone(&self.services.logins);
        let claimed = self.claimed(parcel);
        // Whatever comes now, the last challenge is over.
        let asked = self.asked.take().map(|asked| *asked);
        if let Some(seat) = &self.arrival.seat
            && !self.logged_in
        {
            seat.prove()?;
        }
        let answers = parcel.name() == Verb::Answer.word();
        let step = match asked {
            Some(Asked::Link(challenge, number)) if answers => {
                let resumed = self.resume(reader, (&challenge, number), parcel).await;
                self.proved();
                return match resumed {
                    Ok(()) => Ok(Login::Became),
                    Err(error) => self.refuse_login(error, None, parcel.id, touched),
                };
            }
            _ if parcel.name() == Verb::Resume.word() => {
                let asked = self.ask_for_proof(parcel, touched);
                self.proved();
                return match asked {
                    Ok(()) => Ok(Login::Goes),
                    Err(error) => self.refuse_login(error, None, parcel.id, touched),
                };
            }
            Some(Asked::Key(challenge)) if answers => logins
                .answer(parcel, Some(challenge), self.arrival.remote.from)
                .map(LoginStep::Granted),
            _ if answers => logins
                .answer(parcel, None, self.arrival.remote.from)
                .map(LoginStep::Granted),
            _ => logins.check(parcel, &self.arrival.link()).await,
        };
        let refused = match step {
            Ok(LoginStep::Challenge(challenge)) => {
                self.challenge(challenge.content(), parcel.id, touched);
                self.asked = Some(Box::new(Asked::Key(challenge)));
                Ok(Login::Goes)
            }
            Ok(LoginStep::Granted(granted)) => self.admit(reader, granted, parcel.id, touched),
            Err(error) => Err(error),
        };
        self.proved();
        refused.or_else(|error| self.refuse_login(error, claimed, parcel.id, touched))
    }

    fn proved(&self) {
        if let Some(seat) = &self.arrival.seat {
            seat.proved();
        }
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

    pub(super) fn challenge(&self, content: Map, reference: Option<u64>, touched: &mut Touched) {
        let mut reply = Parcel::new(Family::Reply, "challenge")
            .context(Path::root())
            .content(content);
        reply.reference = reference;
        self.services.board.tell(self.peer(), reply, touched);
    }

    fn admit(
        &mut self,
        reader: &mut Reader,
        granted: Granted,
        id: Option<u64>,
        touched: &mut Touched,
    ) -> Result<Login, WireError> {
        let (peer, board) = (self.peer(), Arc::clone(&self.services.board));
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
        let told = self.grant_wishes(&granted, &account);
        let compression = told
            .get("compress")
            .and_then(Value::as_str)
            .and_then(Compression::of);
        let stream = compression.filter(|way| way.is_stream() && self.arrival.compression.is_some());
        let visit = self.arrival.remote.visit;
        let logged_in = &mut self.logged_in;
        let decide = |mut user: User, nickname: Option<String>| {
            // First: whatever happens then, the hub hears of the end.
            *logged_in = true;
            told.into_iter()
                .for_each(|(key, value)| user.details.set(&key, value));
            let login = Input::Login {
                peer,
                nickname: nickname.or_else(|| visit.then(|| name_of_visit(&user.name)).flatten()),
                user,
                id,
            };
            board.decide(login, touched);
        };
        let admitted = self.services.logins.admit(peer, granted, decide);
        if admitted.is_err() && !self.logged_in {
            // The hub knows nobody who could come back.
            self.end_link();
        }
        let until = admitted?;
        self.proven_until = until.map(Box::new);
        reader.set_limits(&self.services.limits);
        if self.outbox.packs() {
            reader.take_packed();
        }
        reader.trust();
        let name = board.peer_name(peer).unwrap_or_default();
        let limits = &self.services.limits;
        self.charge = Some(account.charge(0));
        let link = self.arrival.link();
        let login = LoginFacts {
            from: link.from,
            tls: link.private,
            since: board.clock.wall(),
            visit,
        };
        // Its first bytes may have come with those by which its form was told.
        self.outbox.note_heard(reader.received());
        self.outbox.admit(limits, name, account, login);
        if let Some(way) = stream {
            reader.take_compressed(way);
            // Behind the reply, whose secrets belong in no dictionary that is shared with what others say.
            flush(touched);
            self.outbox.begin_stream(way);
        }
        Ok(Login::Goes)
    }

    /// Grants what a login asks for beside entry; gives what its reply tells of that.
    fn grant_wishes(&mut self, granted: &Granted, account: &Arc<Account>) -> Map {
        let (mut told, wishes) = (Map::new(), granted.wishes());
        if let Some(beat) = wishes.heartbeat {
            let limits = &self.services.limits;
            if beat < limits.heartbeat {
                let gone = beat.saturating_mul(BEATS).min(limits.gone);
                self.services.limits = Arc::new(Limits {
                    heartbeat: beat,
                    gone,
                    ..Limits::clone(limits)
                });
                self.beat_at = Instant::now() + Duration::from_millis(beat);
            }
            told.set("limits", self.services.limits.to_map());
        }
        // Another user on the same connection is another peer.
        if self.logged_in {
            if let Some(way) = self.compression() {
                told.set("compress", way.word());
            }
            if self.services.board.tap.audit.user(self.peer()).as_deref() != Some(granted.user()) {
                self.end_link();
            }
            return told;
        }
        let (limits, link) = (&self.services.limits, self.arrival.link());
        if let Some(wish) = wishes.link
            && self.outbox.form().is_some()
            && link.is_private()
            && self.outbox.begin_link(limits.outbox)
        {
            match self.services.links.open(&self.outbox, wish.grace, limits.grace) {
                Some(link) => {
                    told.set("link", link.to_map());
                    self.link = Some(Served::new(link));
                }
                None => self.outbox.end_link(),
            }
        }
        if let Some(way) = self.choose_compression(granted, account) {
            told.set("compress", way.word());
        }
        told
    }

    /// How this connection is compressed.
    fn compression(&self) -> Option<Compression> {
        match self.outbox.packs() {
            true => Some(Compression::Zstd),
            false => self.arrival.compression.as_ref().map(|charged| charged.0),
        }
    }

    /// The first of the ways that the peer knows which this connection can have.
    fn choose_compression(&mut self, granted: &Granted, account: &Arc<Account>) -> Option<Compression> {
        let form = self.outbox.form()?;
        // A stream costs memory from the first byte on, and the hub opens what comes: strangers get none.
        let may_stream = granted.origin() != UserSource::Guest && account.gate() == Gate::Open;
        let fits = |way: &&Compression| match way {
            Compression::Zstd => form == Form::Binary,
            Compression::StreamZstd | Compression::StreamDeflate => may_stream,
        };
        let way = *granted.wishes().compress.iter().find(fits)?;
        match way.is_stream() {
            true => {
                let charge = account.charge(COMPRESSION_MEMORY);
                self.arrival.compression = Some(Box::new((way, charge)));
            }
            false => self.outbox.begin_packing(),
        }
        Some(way)
    }

    /// The end of this connection is the end of its peer from now on.
    pub(super) fn end_link(&mut self) {
        if let Some(served) = self.link.take() {
            self.services.links.close(&served.link);
            self.outbox.end_link();
        }
    }

    fn refuse_login(
        &mut self,
        error: WireError,
        claimed: Option<Arc<str>>,
        reference: Option<u64>,
        touched: &mut Touched,
    ) -> Result<Login, WireError> {
        if error.code != Code::NOT_RESUMED {
            self.audit_login(claimed.clone(), &error.code);
        }
        if self
            .services
            .is_first("login refused", self.arrival.remote.from, Some(error.code.word()))
        {
            tracing::info!(peer = self.peer().0, from = ?self.arrival.remote.from, code = %error.code, "login refused");
        }
        if [Code::BAD_LOGIN, Code::BAD_CONTENT, Code::NOT_RESUMED].contains(&error.code) {
            self.failures += 1;
        }
        if error.code.closes() {
            return Err(error);
        }
        self.refuse(&error, reference, touched);
        if self.failures < self.services.logins.attempts() {
            return Ok(Login::Goes);
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
        let name = match self.asked.as_deref() {
            Some(Asked::Key(challenge)) if parcel.name() == Verb::Answer.word() => Some(challenge.user()),
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
        tap.login_refused(self.peer(), name, claimed, code);
    }
}

/// The name of a user who asks by HTTP, so that who only looks leaves the plain name to what the user types and drives
/// with; none if it were none.
fn name_of_visit(user: &str) -> Option<String> {
    let name = format!("{user}@http");
    check_name(&name).is_ok().then_some(name)
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

#[cfg(test)]
mod tests {
    use super::name_of_visit;

    #[test]
    fn who_asks_by_http_has_a_name_beside_the_plain_one() {
        assert_eq!(name_of_visit("alice").as_deref(), Some("alice@http"));
        assert_eq!(name_of_visit(&"a".repeat(64)), None, "too long");
        assert_eq!(name_of_visit("\u{430}\u{43d}\u{44f}"), None, "of two scripts");
    }
}
