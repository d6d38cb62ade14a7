//! One configuration of logins: the users, and which others are let in.

use std::collections::BTreeMap;
use std::sync::Arc;

use ed25519_dalek::VerifyingKey;
use mom_hub::User;
use mom_proto::{BadFingerprint, Code, Fingerprint, Map, Micros, Time, WireError, folds_of, resembles};

use super::hashing::Hashing;
use super::jwt::{Proven, Verifier};
use super::key::parse_key;
use super::password::Decoys;
use super::user::GUEST;
use crate::{LoginConfig, SettingError, UserEntry};

/// Where a user comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UserSource {
    /// The users file.
    File,
    /// Nowhere: a guest.
    Guest,
    /// The claims of a token.
    Claims,
}

/// The configuration of logins.
#[derive(Debug)]
pub(super) struct Book {
    pub(super) users: BTreeMap<String, BookEntry>,
    /// The user for each form by which its name is taken for another; none = several users share it.
    folds: BTreeMap<String, Option<String>>,
    /// The most keys that a user has.
    pub(super) keys: usize,
    pub(super) settings: LoginConfig,
    pub(super) hashing: Arc<Hashing>,
    pub(super) decoys: Decoys,
    verifier: Option<Arc<Verifier>>,
    guest: Arc<User>,
}

/// A user of the file.
#[derive(Debug)]
pub(super) struct BookEntry {
    pub(super) user: Arc<User>,
    pub(super) password: Option<String>,
    pub(super) keys: Vec<VerifyingKey>,
    pub(super) certificates: Vec<Fingerprint>,
}

/// A logged-in peer's user.
#[derive(Clone, Debug)]
pub(super) struct Identity {
    /// Shared by all peers of a user.
    pub(super) user: Arc<User>,
    pub(super) origin: UserSource,
    /// The proof it has shown, which must remain valid for it to stay.
    proof: ShownProof,
}

/// The proof by which a peer has authenticated.
#[derive(Clone, Debug)]
pub(super) enum ShownProof {
    /// A password, as the hash that it was checked against; each change makes another hash.
    Password(String),
    /// The key that signed.
    Key(Box<VerifyingKey>),
    /// The certificate of its TLS connection.
    Certificate(Fingerprint),
    /// A JWT, with the settings by which it was checked.
    Token(Arc<Verifier>),
    /// Nothing: a guest.
    Nothing,
}

impl Book {
    /// Keeps what is still valid of an earlier configuration: the hashing pool, and the verifier, which shows that
    /// bearers of JWTs are still trusted.
    pub(super) fn new(
        users: Vec<UserEntry>,
        settings: LoginConfig,
        earlier: Option<&Book>,
    ) -> Result<Book, SettingError> {
        let hashing = earlier
            .map(|earlier| &earlier.hashing)
            .filter(|hashing| hashing.hashers == settings.hashers)
            .map_or_else(|| Arc::new(Hashing::new(settings.hashers)), Arc::clone);
        let known = earlier
            .and_then(|earlier| earlier.verifier.as_ref())
            .filter(|verifier| settings.jwt.as_ref() == Some(&verifier.config));
        let verifier = match (&settings.jwt, known) {
            (_, Some(known)) => Some(Arc::clone(known)),
            (Some(jwt), None) => Some(Arc::new(
                Verifier::new(jwt).map_err(|error| error.below(&["login", "jwt"]))?,
            )),
            (None, None) => None,
        };
        let users = users
            .into_iter()
            .map(|user| Ok((user.name.clone(), BookEntry::new(user)?)))
            .collect::<Result<BTreeMap<_, _>, SettingError>>()?;
        let mut folds: BTreeMap<String, Option<String>> = BTreeMap::new();
        for name in users.keys() {
            for fold in folds_of(name) {
                folds
                    .entry(fold)
                    .and_modify(|whose| *whose = None)
                    .or_insert_with(|| Some(name.clone()));
            }
        }
        Ok(Book {
            folds,
            keys: users
                .values()
                .map(|user| user.keys.len())
                .max()
                .unwrap_or_default()
                .max(1),
            decoys: Decoys::new(users.values().filter_map(|user| user.password.as_deref())),
            users,
            settings,
            hashing,
            verifier,
            guest: Arc::new(guest()),
        })
    }

    pub(super) fn challenge_time(&self) -> Micros {
        self.settings.challenge_time.saturating_mul(1000)
    }

    pub(super) fn guest(&self) -> Result<Identity, WireError> {
        if !self.settings.guests {
            return Err(WireError::new(Code::BAD_LOGIN, "this hub lets no guests in"));
        }
        Ok(Identity {
            user: Arc::clone(&self.guest),
            origin: UserSource::Guest,
            proof: ShownProof::Nothing,
        })
    }

    /// The bearer of a token, and when it must prove itself again.
    pub(super) fn bearer(&self, token: &str, now: Time) -> Result<(Identity, Time), WireError> {
        let refused = |text: &str| WireError::new(Code::BAD_LOGIN, text);
        let verifier = self
            .verifier
            .as_ref()
            .ok_or_else(|| refused("this hub takes no tokens"))?;
        let Proven { name, claims, until } = verifier.verify(token, now)?;
        let entry = self.users.get(&name);
        let standing = match (entry, claims) {
            (Some(entry), None) => Identity::of_file(entry, ShownProof::Token(Arc::clone(verifier))),
            (None, None) => return Err(refused("the token's user does not exist here")),
            (None, Some((level, groups))) if !self.resembles_own(&name) => Identity {
                user: Arc::new(User {
                    name,
                    level,
                    groups,
                    details: Map::new(),
                }),
                origin: UserSource::Claims,
                proof: ShownProof::Token(Arc::clone(verifier)),
            },
            // A user of the file has its rights from there, and those may be higher.
            (_, Some(_)) => {
                return Err(refused(
                    "the token's user is one of this hub's own, or looks like one",
                ));
            }
        };
        Ok((standing, until))
    }

    /// Refuses the name of another user, and look-alikes of it, so that nobody can be mistaken for that user.
    pub(super) fn check_nickname(&self, user: &User, nickname: Option<&str>) -> Result<(), WireError> {
        let Some(nickname) = nickname.filter(|nickname| *nickname != user.name) else {
            return Ok(());
        };
        let whose = |fold: String| self.folds.get(&fold);
        let mut whose = folds_of(nickname).into_iter().filter_map(whose);
        let anothers = whose.any(|whose| whose.as_ref() != Some(&user.name));
        if !anothers && !self.resembles_guest(nickname) {
            return Ok(());
        }
        let is_name = self.users.contains_key(nickname) || nickname == GUEST;
        Err(anothers_name(nickname, is_name))
    }

    /// Whether a name could be taken for that of a user of the file, or of guests.
    fn resembles_own(&self, name: &str) -> bool {
        let known = |fold: &String| self.folds.contains_key(fold);
        folds_of(name).iter().any(known) || self.resembles_guest(name)
    }

    fn resembles_guest(&self, name: &str) -> bool {
        self.settings.guests && resembles(name, GUEST)
    }
}

impl Identity {
    pub(super) fn of_file(entry: &BookEntry, proof: ShownProof) -> Identity {
        Identity {
            user: Arc::clone(&entry.user),
            origin: UserSource::File,
            proof,
        }
    }

    /// The same user in another book; none = there is no such user, or its proof is no longer valid.
    pub(super) fn as_of(&self, book: &Book) -> Option<Arc<User>> {
        let entry = book.users.get(&self.user.name);
        let proven = match &self.proof {
            ShownProof::Password(hash) => entry.is_some_and(|entry| entry.password.as_ref() == Some(hash)),
            ShownProof::Key(key) => entry.is_some_and(|entry| entry.keys.contains(key)),
            ShownProof::Certificate(shown) => entry.is_some_and(|entry| entry.certificates.contains(shown)),
            ShownProof::Token(trusted) => book
                .verifier
                .as_ref()
                .is_some_and(|now| Arc::ptr_eq(now, trusted)),
            ShownProof::Nothing => true,
        };
        if !proven {
            return None;
        }
        match self.origin {
            UserSource::File => entry.map(|entry| Arc::clone(&entry.user)),
            UserSource::Guest => book.settings.guests.then(|| Arc::clone(&book.guest)),
            UserSource::Claims => {
                let free = !book.resembles_own(&self.user.name);
                free.then(|| Arc::clone(&self.user))
            }
        }
    }
}

impl BookEntry {
    fn new(user: UserEntry) -> Result<BookEntry, SettingError> {
        let keys = user
            .keys
            .iter()
            .map(|key| {
                parse_key(key).map_err(|text| SettingError::new(&["users"], format!("{}: {text}", user.name)))
            })
            .collect::<Result<_, _>>()?;
        let certificates = user.certificates.iter().map(|text| text.parse());
        let certificates = certificates
            .collect::<Result<_, BadFingerprint>>()
            .map_err(|error| SettingError::new(&["users"], format!("{}: {error}", user.name)))?;
        Ok(BookEntry {
            user: Arc::new(user.to_user()),
            password: user.password,
            keys,
            certificates,
        })
    }
}

/// The refusal of a nickname that is another user's name, or looks like it.
pub(super) fn anothers_name(nickname: &str, is_name: bool) -> WireError {
    let text = match is_name {
        true => format!("the nickname {nickname:?} is another user's name"),
        false => format!("the nickname {nickname:?} looks like another user's name"),
    };
    WireError::new(Code::BAD_NAME, text).slot("content/nickname")
}

/// The user of all guests.
pub fn guest() -> User {
    User {
        name: GUEST.to_owned(),
        level: 0,
        groups: vec![GUEST.to_owned()],
        details: Map::new(),
    }
}
