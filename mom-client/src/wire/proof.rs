//! A peer's proof of identity (M12) and its login parcels.

use std::fmt;
use std::ops::RangeInclusive;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use mom_net::{Address, Identity};
use mom_proto::{
    Code, Compression, Family, LOGIN_CONTEXT, Map, NONCE_BYTES, Parcel, Path, Value, WireError,
    login_challenge,
};

use crate::error::bad_reply;
use crate::wire::clock::system;
use crate::words::{map_of, text};
use crate::{ClientError, Key};

/// How often a peer may ask for signs of life: a hub refuses more, and fewer than it gives by default are probably a time in another unit.
const HEARTBEATS: RangeInclusive<Duration> = Duration::from_millis(100)..=Duration::from_secs(10);

/// How a peer proves who it is.
#[derive(Clone)]
#[non_exhaustive]
pub enum Proof {
    /// The user's password; taken over TLS or loopback only.
    Password(String),
    /// A key of the user's: it signs the hub's challenge, and no secret is on the wire.
    Key(Key),
    /// A token (JWT) of an issuer that the hub trusts; it names the user itself, and is taken over TLS or loopback only.
    Token(String),
    /// The same, asked for at each login: it may have expired when the connection is lost.
    TokenFrom(TokenSource),
    /// A certificate of the user's, shown over TLS.
    Certificate(Identity),
    /// None: a guest, where the hub lets guests in.
    Guest,
}

/// What gives a token (JWT) for each login.
#[derive(Clone)]
pub struct TokenSource(Arc<dyn Fn() -> Asked + Send + Sync>);

type Asked = Pin<Box<dyn Future<Output = Result<String, String>> + Send>>;

impl TokenSource {
    /// Asks this function.
    pub fn new<F, E>(ask: impl Fn() -> F + Send + Sync + 'static) -> TokenSource
    where
        F: Future<Output = Result<String, E>> + Send + 'static,
        E: fmt::Display,
    {
        TokenSource(Arc::new(move || {
            let asked = ask();
            Box::pin(async move { asked.await.map_err(|error| error.to_string()) })
        }))
    }
}

impl fmt::Debug for TokenSource {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("TokenSource")
    }
}

impl fmt::Debug for Proof {
    // Secrets do not belong in logs.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Proof::Password(_) => "Password",
            Proof::Key(_) => "Key",
            Proof::Token(_) => "Token",
            Proof::TokenFrom(_) => "TokenFrom",
            Proof::Certificate(_) => "Certificate",
            Proof::Guest => "Guest",
        })
    }
}

/// The login data of a peer.
#[derive(Clone, Debug)]
pub(crate) struct Credentials {
    pub(crate) user: String,
    pub(crate) proof: Proof,
    pub(crate) nickname: Option<String>,
    /// The hub for which a key signs; none = whichever it says it is.
    pub(crate) hub: Option<String>,
    /// The address of the hub, if it is not in this process.
    pub(crate) address: Option<Address>,
    /// For how long the hub is to keep this peer's place when its connection is lost; none = not at all.
    pub(crate) link: Option<Duration>,
    /// How often both sides say that they are there; none = as the hub says.
    pub(crate) heartbeat: Option<Duration>,
    /// That content may be compressed.
    pub(crate) compress: bool,
}

impl Credentials {
    /// Refuses to say a secret that others could read.
    ///
    /// # Errors
    /// `Local`, with an address to use instead.
    pub(crate) fn check(&self) -> Result<(), ClientError> {
        let what = match &self.proof {
            Proof::Password(_) => "password",
            Proof::Token(_) | Proof::TokenFrom(_) => "token",
            Proof::Key(_) | Proof::Certificate(_) | Proof::Guest => return Ok(()),
        };
        let Some(address) = self.address.as_ref().filter(|address| !address.is_private()) else {
            return Ok(());
        };
        let between = match address.proxy() {
            Ok(Some(proxy)) => format!("the proxy {proxy}"),
            _ => "others".to_owned(),
        };
        let safe = Address {
            tls: true,
            ..address.clone()
        };
        let text = format!(
            "a {what} is sent over TLS or loopback only, and {between} could read it on the way to {address}: write {safe}, or \
             log in with a key; nothing was sent"
        );
        Err(ClientError::Local(WireError::new(Code::INSECURE, text)))
    }

    /// Refuses signs of life that a hub would refuse, or that are so seldom that milliseconds were probably taken for seconds.
    ///
    /// # Errors
    /// `Local`, with the range.
    pub(crate) fn check_heartbeat(&self) -> Result<(), ClientError> {
        let wrong = self.heartbeat.filter(|beat| !HEARTBEATS.contains(beat));
        let Some(beat) = wrong else { return Ok(()) };
        let (least, most) = HEARTBEATS.into_inner();
        let text = format!("a heartbeat must be from {least:?} to {most:?}, not {beat:?}");
        let error = WireError::new(Code::BAD_CONTENT, text).slot("content/heartbeat");
        Err(ClientError::Local(error))
    }

    /// `login login`, with a token that is asked for now.
    ///
    /// # Errors
    /// As [`Credentials::check`]; `Connection` if no token is given.
    pub(crate) async fn login(&self) -> Result<Parcel, ClientError> {
        self.check()?;
        let given = match &self.proof {
            Proof::TokenFrom(source) => {
                let given = (source.0)().await;
                given.map_err(|error| {
                    ClientError::Connection(format!("there is no token to log in with: {error}"))
                })?
            }
            _ => String::new(),
        };
        let name = Map::new().with("name", self.user.as_str());
        let mut content = match &self.proof {
            Proof::Password(password) => name.with("password", password.as_str()),
            Proof::Key(_) => name.with("key", true),
            Proof::TokenFrom(_) => Map::new().with("token", given),
            Proof::Token(token) => Map::new().with("token", token.as_str()),
            Proof::Certificate(_) => name.with("certificate", true),
            Proof::Guest => Map::new().with("guest", true),
        };
        if let Some(nickname) = &self.nickname {
            content.set("nickname", nickname.as_str());
        }
        let millis = |time: Duration| i64::try_from(time.as_millis()).unwrap_or(i64::MAX);
        if let Some(grace) = self.link {
            content.set("link", Map::new().with("grace", millis(grace)));
        }
        if let Some(heartbeat) = self.heartbeat {
            content.set("heartbeat", millis(heartbeat));
        }
        if self.compress {
            // The first is of the binary form only, the other of any.
            let ways = [Compression::Zstd, Compression::StreamZstd];
            content.set("compress", ways.map(|way| Value::from(way.word())).to_vec());
        }
        Ok(said("login", content))
    }

    /// `login answer` to what the hub asks.
    ///
    /// # Errors
    /// `Local` for a hub that is not the one meant, or asks for something else than a login.
    pub(crate) fn answer(&self, challenge: &Parcel) -> Result<Parcel, ClientError> {
        let Proof::Key(key) = &self.proof else {
            return Err(bad_reply("welcome, but a challenge to a key"));
        };
        let content = map_of(challenge);
        // The key's signature must be useless for any other purpose.
        if text(&content, "context") != Some(LOGIN_CONTEXT) {
            return Err(bad_reply("challenge of a login"));
        }
        let hub = text(&content, "hub").ok_or_else(|| bad_reply("hub"))?;
        if let Some(meant) = self.hub.as_deref().filter(|meant| *meant != hub) {
            let text = format!("the hub is {hub:?}, not {meant:?}: nothing was signed for it");
            return Err(ClientError::Local(WireError::new(Code::BAD_LOGIN, text)));
        }
        let nonce = content
            .get("nonce")
            .and_then(Value::as_binary)
            .filter(|nonce| nonce.len() == NONCE_BYTES)
            .ok_or_else(|| bad_reply("proper nonce"))?;
        let signature = key.sign(&login_challenge(hub, &self.user, nonce));
        let signature = Value::Binary(signature.to_vec().into());
        Ok(said("answer", Map::new().with("signature", signature)))
    }
}

/// Whether a reply is a challenge to a key.
pub(crate) fn is_challenge(reply: &Parcel) -> bool {
    reply.is(Family::Reply, "challenge")
}

fn said(name: &str, content: Map) -> Parcel {
    let mut parcel = Parcel::new(Family::Login, name)
        .context(Path::root())
        .content(content);
    parcel.timestamp = system();
    parcel
}

#[cfg(test)]
mod tests {
    use super::*;

    fn challenge(hub: &str, context: &str, bytes: usize) -> Parcel {
        let content = Map::new()
            .with("nonce", Value::Binary(vec![7; bytes].into()))
            .with("hub", hub)
            .with("context", context);
        Parcel::new(Family::Reply, "challenge").content(content)
    }

    #[test]
    fn a_key_signs_for_its_hub_only_and_nothing_but_logins() {
        let key = Key::generate().expect("randomness");
        let mut credentials = Credentials {
            user: "arm".to_owned(),
            proof: Proof::Key(key.clone()),
            nickname: None,
            hub: None,
            address: None,
            link: None,
            heartbeat: None,
            compress: false,
        };
        let answer = credentials
            .answer(&challenge("lab", LOGIN_CONTEXT, 32))
            .expect("signed");
        let signed = key.sign(&login_challenge("lab", "arm", &[7; 32]));
        assert_eq!(
            map_of(&answer).get("signature"),
            Some(&Value::Binary(signed.to_vec().into()))
        );
        credentials.hub = Some("lab".to_owned());
        assert!(credentials.answer(&challenge("lab", LOGIN_CONTEXT, 32)).is_ok());
        for wrong in [
            challenge("other", LOGIN_CONTEXT, 32),
            challenge("lab", "mom-login-2", 32),
            challenge("lab", LOGIN_CONTEXT, 31),
        ] {
            assert!(credentials.answer(&wrong).is_err(), "{wrong:?}");
        }
        credentials.proof = Proof::Password("secret".to_owned());
        assert!(credentials.answer(&challenge("lab", LOGIN_CONTEXT, 32)).is_err());
        assert!(!format!("{credentials:?}").contains("secret"));
    }
}
