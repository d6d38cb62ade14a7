//! Who is it? Names and passwords (M12, M13).

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicUsize, Ordering};

use argon2::Argon2;
use argon2::password_hash::phc::PasswordHash;
use argon2::password_hash::{PasswordHasher, PasswordVerifier};
use mom_hub::User;
use mom_proto::{Code, Parcel, WireError, check_name};
use serde::Deserialize;
use tokio::sync::Semaphore;

use crate::config::{LoginConfig, UserEntry};

/// The content of `login login`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Credentials {
    name: String,
    password: String,
    #[serde(default)]
    nickname: Option<String>,
}

/// What became of a login.
#[derive(Debug)]
pub(crate) enum Attempt {
    /// It is that user.
    Granted {
        /// Who.
        user: User,
        /// The name it wishes.
        nickname: Option<String>,
    },
    /// It is not, or cannot be told.
    Refused(WireError),
}

/// The users, and the bounded pool in which passwords are hashed.
#[derive(Debug)]
pub(crate) struct Logins {
    users: BTreeMap<String, UserEntry>,
    settings: LoginConfig,
    hashing: Semaphore,
    waiting: AtomicUsize,
    /// Checked in place of an unknown user's, so that the time says nothing about who exists.
    dummy: String,
}

impl Logins {
    pub(crate) fn new(users: Vec<UserEntry>, settings: LoginConfig) -> Logins {
        Logins {
            users: users.into_iter().map(|user| (user.name.clone(), user)).collect(),
            hashing: Semaphore::new(settings.hashers),
            settings,
            waiting: AtomicUsize::new(0),
            dummy: hash("no such user").unwrap_or_default(),
        }
    }

    /// Failed logins after which a connection is closed.
    pub(crate) fn attempts(&self) -> u32 {
        self.settings.attempts
    }

    /// Checks the credentials in a login parcel.
    pub(crate) async fn check(&self, parcel: &Parcel, from: Option<IpAddr>) -> Attempt {
        match self.try_check(parcel, from).await {
            Ok((user, nickname)) => Attempt::Granted { user, nickname },
            Err(error) => Attempt::Refused(error),
        }
    }

    async fn try_check(
        &self,
        parcel: &Parcel,
        from: Option<IpAddr>,
    ) -> Result<(User, Option<String>), WireError> {
        if from.is_some_and(|from| !from.is_loopback()) {
            let text = "a password is taken only over loopback: others could read it on the way";
            return Err(WireError::new(Code::INSECURE, text));
        }
        let content = parcel.content.as_ref();
        let credentials: Credentials = content
            .ok_or_else(|| {
                WireError::new(Code::BAD_CONTENT, "a login needs content {name, password}").slot("content")
            })?
            .read()?;
        if let Some(nickname) = &credentials.nickname {
            check_name(nickname).map_err(|error| error.slot("content/nickname"))?;
        }
        let known = self.users.get(&credentials.name);
        let expected = known.map_or(&self.dummy, |user| &user.password).clone();
        let matches = self.verify(credentials.password, expected).await?;
        let user = known
            .filter(|_| matches)
            .ok_or_else(|| WireError::new(Code::BAD_LOGIN, "no user has this name and password"))?;
        // Only now: before, it would tell anybody which users there are.
        match credentials.nickname {
            Some(nickname) if nickname != user.name && self.users.contains_key(&nickname) => {
                let text = format!("the nickname {nickname:?} is another user's name");
                Err(WireError::new(Code::BAD_NAME, text).slot("content/nickname"))
            }
            nickname => Ok((user.to_user(), nickname)),
        }
    }

    async fn verify(&self, password: String, expected: String) -> Result<bool, WireError> {
        let _place = Waiting::enter(&self.waiting, self.settings.waiting).ok_or_else(|| {
            WireError::new(Code::TRY_LATER, "too many logins at once")
                .retry_after(std::time::Duration::from_secs(1))
        })?;
        let stopped = |_| WireError::new(Code::SHUTDOWN, "the hub is shutting down");
        let _permit = self.hashing.acquire().await.map_err(stopped)?;
        let check = move || {
            let hash = PasswordHash::new(&expected).ok()?;
            Argon2::default().verify_password(password.as_bytes(), &hash).ok()
        };
        let verified = tokio::task::spawn_blocking(check).await;
        verified
            .map(|matches| matches.is_some())
            .map_err(|_| WireError::new(Code::TRY_LATER, "the login failed here"))
    }
}

/// A place among those who wait for a hash; left on drop.
struct Waiting<'a>(&'a AtomicUsize);

impl<'a> Waiting<'a> {
    fn enter(waiting: &'a AtomicUsize, most: usize) -> Option<Waiting<'a>> {
        let before = waiting.fetch_add(1, Ordering::AcqRel);
        let place = Waiting(waiting);
        (before < most).then_some(place)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// The argon2id hash of a password with a new salt, for the users file.
///
/// # Errors
/// The words of the hash function: no randomness, or a password it does not take.
pub fn hash(password: &str) -> Result<String, String> {
    Argon2::default()
        .hash_password(password.as_bytes())
        .map(|hash| hash.to_string())
        .map_err(|error| error.to_string())
}

/// Whether text is a hash that logins can be checked against.
pub(crate) fn is_hash(text: &str) -> bool {
    PasswordHash::new(text).is_ok_and(|hash| hash.algorithm.as_str() == "argon2id")
}

impl UserEntry {
    fn to_user(&self) -> User {
        let mut details = mom_proto::Map::new();
        details.set("preferences", self.preferences.clone());
        details.set("personal", self.personal.clone());
        User {
            name: self.name.clone(),
            level: self.level,
            groups: self.groups.clone(),
            details,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;
    use mom_proto::{Family, Map};

    /// Threat 15: who cannot log in does not learn who can.
    #[tokio::test]
    async fn a_nickname_does_not_tell_who_exists() {
        let config = Config::lab();
        let logins = Logins::new(config.users.clone(), config.login.clone());
        for nickname in ["bob", "nobody"] {
            let content = Map::new()
                .with("name", "eve")
                .with("password", "x")
                .with("nickname", nickname);
            let parcel = Parcel::new(Family::Login, "login").content(content);
            match logins.check(&parcel, None).await {
                Attempt::Refused(error) => assert_eq!(error.code, Code::BAD_LOGIN, "{nickname}"),
                Attempt::Granted { .. } => panic!("eve has no password"),
            }
        }
    }
}
