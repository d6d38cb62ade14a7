//! Users who ask by HTTP: each is a peer of the hub like any other, inside this process, and sees what that peer may see.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use http::header::{AUTHORIZATION, COOKIE, HeaderMap};
use http::{HeaderValue, Response, StatusCode};
use mom_client::{Client, ClientError, LinkState, Proof};
use mom_net::{SecretId, Transceiver};
use mom_proto::{Code, Path, WireError};
use parking_lot::Mutex;
use sha2::{Digest, Sha256};
use tokio::time::{Instant, sleep_until};

use super::HttpConnection;
use super::answers::{Body, refuse, refuse_wire};
use super::image::Watched;
use crate::connection::{Remote, Serving, login_time};

/// A visit by cookie ends after so long without a request, one by token sooner: the token opens another.
const IDLE: Duration = Duration::from_secs(15 * 60);
const TOKEN_IDLE: Duration = Duration::from_secs(60);

/// Visits of guests from one address that are open at once, each a peer of the hub: one more ends the one that was not
/// used for longest, so that nobody locks all others out.
const GUESTS: usize = 16;

/// The name of the cookie.
const NAME: &str = "mom-session";

/// The visitors of a hub.
#[derive(Debug, Default)]
pub(super) struct Visitors {
    open: Mutex<HashMap<Credential, Arc<Visitor>>>,
}

/// What a request shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Credential {
    Cookie(SecretId),
    /// The SHA-256 of a token, which itself is not kept.
    Token([u8; 32]),
}

/// A user.
#[derive(Debug)]
pub(super) struct Visitor {
    pub(super) client: Client,
    /// Channels whose images it has asked for.
    pub(super) watched: tokio::sync::Mutex<HashMap<Path, Arc<Watched>>>,
    used: Mutex<Instant>,
    /// Where a guest comes from, who has shown nothing.
    guest_from: Option<IpAddr>,
}

impl Visitors {
    fn find(&self, credential: Credential) -> Option<Arc<Visitor>> {
        let visitor = self.open.lock().get(&credential).cloned()?;
        let closed = matches!(&*visitor.client.state().borrow(), LinkState::Closed(_));
        if closed {
            return None;
        }
        *visitor.used.lock() = Instant::now();
        Some(visitor)
    }

    /// Keeps a visitor until it is not used for long, or its user is put out.
    fn keep(
        self: &Arc<Visitors>,
        credential: Credential,
        client: Client,
        guest_from: Option<IpAddr>,
    ) -> Arc<Visitor> {
        let visitor = Arc::new(Visitor {
            client,
            watched: tokio::sync::Mutex::default(),
            used: Mutex::new(Instant::now()),
            guest_from,
        });
        let one_too_many = {
            let mut open = self.open.lock();
            let oldest = guest_from.and_then(|from| take_oldest_guest(&mut open, from));
            open.insert(credential, Arc::clone(&visitor));
            oldest
        };
        if let Some(oldest) = one_too_many {
            tokio::spawn(oldest.client.clone().close());
        }
        let (visitors, kept) = (Arc::clone(self), Arc::clone(&visitor));
        tokio::spawn(async move {
            let idle = match credential {
                Credential::Cookie(_) => IDLE,
                Credential::Token(_) => TOKEN_IDLE,
            };
            kept.is_over(idle).await;
            // Tasks that watch channels have clones, which would keep the user logged in.
            kept.client.clone().close().await;
            let mut open = visitors.open.lock();
            if open.get(&credential).is_some_and(|open| Arc::ptr_eq(open, &kept)) {
                open.remove(&credential);
            }
        });
        visitor
    }
}

/// Takes out the guest from an address that was not here for longest, if there are as many as may.
fn take_oldest_guest(open: &mut HashMap<Credential, Arc<Visitor>>, from: IpAddr) -> Option<Arc<Visitor>> {
    let guests = open
        .iter()
        .filter(|(_, visitor)| visitor.guest_from == Some(from));
    let guests = guests.map(|(credential, visitor)| (*visitor.used.lock(), *credential));
    let guests: Vec<(Instant, Credential)> = guests.collect();
    let oldest = guests.iter().min_by_key(|(used, _)| *used)?;
    match guests.len() >= GUESTS {
        true => open.remove(&oldest.1),
        false => None,
    }
}

impl Visitor {
    async fn is_over(&self, idle: Duration) {
        let mut state = self.client.state();
        loop {
            let until = *self.used.lock() + idle;
            tokio::select! {
                () = sleep_until(until) => {
                    if *self.used.lock() + idle <= Instant::now() {
                        return;
                    }
                }
                closed = state.wait_for(|state| matches!(state, LinkState::Closed(_))) => {
                    // Nobody says more when the client is gone.
                    drop(closed);
                    return;
                }
            }
        }
    }
}

impl HttpConnection {
    /// Whose request it is, by its cookie or its token.
    pub(super) async fn visitor(&self, headers: &HeaderMap) -> Result<Arc<Visitor>, Response<Body>> {
        let remote = self
            .private_remote(headers)
            .map_err(|error| refuse_wire(&error))?;
        let visitor = match bearer(headers) {
            Some(token) => {
                let credential = Credential::Token(Sha256::digest(token).into());
                match self.web.visitors.find(credential) {
                    Some(visitor) => visitor,
                    None => {
                        let client = self.log_in(remote, "", Proof::Token(token.to_owned())).await?;
                        self.web.visitors.keep(credential, client, None)
                    }
                }
            }
            None => cookie(headers)
                .and_then(|id| self.web.visitors.find(Credential::Cookie(id)))
                .ok_or_else(nobody)?,
        };
        self.count_as(&visitor.client.user())
            .map_err(|error| refuse_wire(&error))?;
        Ok(visitor)
    }

    /// Begins a visit, and gives its user the cookie.
    pub(super) async fn begin_visit(
        &self,
        headers: &HeaderMap,
        user: &str,
        proof: Proof,
    ) -> Result<(Client, HeaderValue), Response<Body>> {
        let remote = self
            .private_remote(headers)
            .map_err(|error| refuse_wire(&error))?;
        let guest_from = remote.from.filter(|_| matches!(proof, Proof::Guest));
        let client = self.log_in(remote, user, proof).await?;
        let id = SecretId::random().ok_or_else(|| {
            refuse(
                StatusCode::INTERNAL_SERVER_ERROR,
                "internal",
                "the system's random number generator failed",
            )
        })?;
        let visitors = &self.web.visitors;
        visitors.keep(Credential::Cookie(id), client.clone(), guest_from);
        let secure = if self.is_secured(remote) { "; Secure" } else { "" };
        Ok((client, cookie_of(&id.to_string(), secure)))
    }

    /// Ends the visit of a cookie.
    pub(super) fn end_visit(&self, headers: &HeaderMap) -> HeaderValue {
        let ended = cookie(headers).and_then(|id| {
            let mut open = self.web.visitors.open.lock();
            open.remove(&Credential::Cookie(id))
        });
        if let Some(visitor) = ended {
            tokio::spawn(visitor.client.clone().close());
        }
        cookie_of("", "; Max-Age=0")
    }

    /// Logs in, as over any other door, so that every rule for logins holds.
    async fn log_in(&self, remote: Remote, user: &str, proof: Proof) -> Result<Client, Response<Body>> {
        let from = remote.from.ok_or_else(nobody)?;
        let services = self.services.fresh();
        let seated = services.seat(&self.web.doors, from);
        let (seat, told) = seated.map_err(|error| self.refuse_full(from, &error))?;
        // It is told to go by its outbox.
        drop(told);
        let (here, there) = mom_net::pair();
        let login_by = Instant::now() + login_time(&services.limits);
        let remote = Remote {
            secured: self.is_secured(remote),
            visit: true,
            ..remote
        };
        let mut serving = Serving::begin(services, here, remote, Some(seat), login_by);
        tokio::spawn(async move { serving.run().await });
        let there = Mutex::new(Some(there));
        let connected = Client::builder_local(move || there.lock().take().unwrap_or_else(broken))
            .user(user)
            .proof(proof)
            .no_reconnect()
            .connect();
        connected.await.map_err(|error| refuse_client(&error))
    }

    /// Whose a request is that shows a secret; refused where others could have read it.
    fn private_remote(&self, headers: &HeaderMap) -> Result<Remote, WireError> {
        let remote = self.remote_of(headers);
        let near = |from: IpAddr| from.to_canonical().is_loopback() && !remote.relayed;
        if self.is_secured(remote) || remote.from.is_some_and(near) {
            return Ok(remote);
        }
        let text =
            "a login is accepted over TLS or loopback only, because others could read it; use https://";
        Err(WireError::new(Code::INSECURE, text))
    }
}

/// An end whose other one is gone.
fn broken() -> Transceiver {
    mom_net::pair().0
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    let shown = headers.get(AUTHORIZATION)?.to_str().ok()?;
    let (scheme, token) = shown.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

fn cookie(headers: &HeaderMap) -> Option<SecretId> {
    let lines = headers.get_all(COOKIE).into_iter();
    let pairs = lines
        .filter_map(|line| line.to_str().ok())
        .flat_map(|line| line.split(';'));
    pairs
        .filter_map(|pair| pair.trim().split_once('='))
        .find(|(name, _)| *name == NAME)
        .and_then(|(_, id)| id.parse().ok())
}

fn cookie_of(id: &str, more: &str) -> HeaderValue {
    let text = format!("{NAME}={id}; Path=/; HttpOnly; SameSite=Strict{more}");
    HeaderValue::try_from(text).expect("an id has letters and digits only")
}

fn nobody() -> Response<Body> {
    let text =
        "log in first: POST /api/login with user and password, or Authorization: Bearer and a token (JWT)";
    refuse_wire(&WireError::new(Code::NOT_LOGGED_IN, text))
}

/// What the hub's refusal is in HTTP.
pub(super) fn refuse_client(error: &ClientError) -> Response<Body> {
    match error {
        ClientError::Refused(error) | ClientError::Closed(Some(error)) | ClientError::Local(error) => {
            refuse_wire(error)
        }
        other => refuse(StatusCode::SERVICE_UNAVAILABLE, "try-later", &other.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credentials_are_found_among_others() {
        let mut headers = HeaderMap::new();
        let id = "00112233445566778899aabbccddeeff";
        for line in [
            "theme=dark; mom-session-2=1",
            "a=b;mom-session=00112233445566778899aabbccddeeff ; c",
        ] {
            headers.append(COOKIE, HeaderValue::from_static(line));
        }
        assert_eq!(cookie(&headers).map(|id| id.to_string()).as_deref(), Some(id));
        for (line, token) in [
            ("Bearer a.b.c", Some("a.b.c")),
            ("bearer  a", Some("a")),
            ("Basic YTpi", None),
            ("Bearer", None),
        ] {
            headers.insert(AUTHORIZATION, HeaderValue::from_static(line));
            assert_eq!(bearer(&headers), token, "{line}");
        }
    }
}
