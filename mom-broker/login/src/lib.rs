//! Authentication: passwords, keys, tokens and guests (M12, M13).

mod book;
mod content;
mod error;
mod hashing;
mod jwt;
mod key;
mod link;
mod password;
mod places;
mod resume;
mod settings;
mod subjects;
mod throttle;
mod user;

use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;

use dashmap::DashMap;
use mom_hub::{PeerId, User};
use mom_proto::{Code, Parcel, Time, WireError};
use mom_system::{Clock, Expiry};
use parking_lot::RwLock;

use self::book::{Book, Identity};
use self::content::{ClaimedProof, LoginRequest, read_signature};
use self::key::Asked;
use self::places::Places;
use self::subjects::Subjects;
use self::throttle::Throttle;

pub use book::{UserSource, guest};
pub use content::{LinkWish, ResumeAnswer, Wishes};
pub use error::SettingError;
pub use hashing::LoginStats;
pub use jwt::{JwtConfig, JwtUsers, KeyFile, Verifier};
pub use key::Challenge;
pub use link::LoginLink;
pub use password::hash;
pub use resume::{ResumeChallenge, Secret};
pub use settings::{FailureRate, LoginConfig, ThrottleConfig};
pub use throttle::network;
pub use user::{GUEST, UserEntry};

/// The next step of a login that is not refused.
#[derive(Debug)]
pub enum LoginStep {
    /// A key must answer this challenge first.
    Challenge(Challenge),
    /// The user is authenticated.
    Granted(Granted),
}

/// An authenticated user, before the hub knows of it.
#[derive(Debug)]
pub struct Granted {
    standing: Identity,
    nickname: Option<String>,
    wishes: Wishes,
    until: Option<Time>,
    /// By which it was proven.
    book: Arc<Book>,
}

/// The users, and everything that checks logins.
#[derive(Debug)]
pub struct Logins {
    clock: Clock,
    /// Replaced as a whole by a new configuration.
    book: RwLock<Arc<Book>>,
    throttle: Throttle,
    places: Places,
    subjects: Subjects,
    /// The user of each peer.
    peers: DashMap<PeerId, Identity>,
}

impl Logins {
    /// # Errors
    /// A user or a setting that [`LoginConfig::check`] or [`UserEntry::check`] would refuse too.
    pub fn new(users: Vec<UserEntry>, settings: LoginConfig, clock: Clock) -> Result<Logins, SettingError> {
        Ok(Logins {
            clock,
            book: RwLock::new(Arc::new(Book::new(users, settings, None)?)),
            throttle: Throttle::new(),
            places: Places::forgetful(),
            subjects: Subjects::default(),
            peers: DashMap::new(),
        })
    }

    /// Knows from now on where users had logged in before the start, and keeps it in this directory for the next.
    ///
    /// # Errors
    /// A file there that cannot be read; then it is as without a directory.
    pub fn remember_in(&mut self, directory: &Path) -> std::io::Result<()> {
        self.places = Places::open(directory)?;
        Ok(())
    }

    /// Writes what is to be known at the next start and is not written yet. Blocks.
    ///
    /// # Errors
    /// What the system says.
    pub fn remember(&self) -> std::io::Result<()> {
        self.places.write()
    }

    /// Applies another configuration, also to logins under way. `apply` gets the peers whose user has changed since
    /// they logged in, with the new user (none = it may no longer be here), to tell the hub; nobody logs in before it
    /// has returned.
    ///
    /// # Errors
    /// As [`Logins::new`]; then nothing changes.
    pub fn replace(
        &self,
        users: Vec<UserEntry>,
        settings: LoginConfig,
        apply: impl FnOnce(Vec<(PeerId, Option<User>)>),
    ) -> Result<(), SettingError> {
        let book = Arc::new(Book::new(users, settings, Some(&self.book()))?);
        let mut present = self.book.write();
        *present = Arc::clone(&book);
        apply(self.reconsider(&book));
        Ok(())
    }

    fn reconsider(&self, book: &Book) -> Vec<(PeerId, Option<User>)> {
        let mut changed = Vec::new();
        for mut peer in self.peers.iter_mut() {
            let user = peer.as_of(book);
            if user.as_ref() != Some(&peer.user) {
                if let Some(user) = &user {
                    peer.user = Arc::clone(user);
                }
                let user = user.map(|user| User::clone(&user));
                changed.push((*peer.key(), user));
            }
        }
        changed
    }

    /// Whether the users file has a user of this name.
    pub fn knows(&self, user: &str) -> bool {
        self.book().users.contains_key(user)
    }

    /// The name of this hub in what keys sign.
    pub fn hub(&self) -> String {
        self.book().settings.hub.clone()
    }

    /// Failed logins after which a connection is closed.
    pub fn attempts(&self) -> u32 {
        self.book().settings.attempts
    }

    /// Statistics of the hashing pool.
    pub fn stats(&self) -> LoginStats {
        self.book().hashing.stats()
    }

    /// Checks a `login login`.
    ///
    /// # Errors
    /// Why it is refused.
    pub async fn check(&self, parcel: &Parcel, link: &LoginLink) -> Result<LoginStep, WireError> {
        let (book, from) = (self.book(), link.from);
        let request = LoginRequest::read(parcel).map_err(|error| self.malformed(&book, from, error));
        let LoginRequest {
            proof,
            nickname,
            wishes,
        } = request?;
        let (standing, until) = match proof {
            ClaimedProof::Password { name, password } => {
                (self.by_password(&book, &name, password, link).await?, None)
            }
            ClaimedProof::Token(token) => self.by_token(&book, &token, link)?,
            ClaimedProof::Certificate { name } => (self.by_certificate(&book, &name, link)?, None),
            ClaimedProof::Guest => (book.guest()?, None),
            ClaimedProof::Key { name } => {
                let until = self.clock.now().saturating_add(book.challenge_time());
                let asked = Asked { nickname, wishes };
                let challenge = Challenge::new(name, asked, &book.settings.hub, until)?;
                return Ok(LoginStep::Challenge(challenge));
            }
        };
        self.grant(standing, Asked { nickname, wishes }, until, book)
            .map(LoginStep::Granted)
    }

    /// Asks who wants to go on with a link for a proof.
    ///
    /// # Errors
    /// `bad-content`, or `try-later` if the system gives no randomness.
    pub fn resume(&self, parcel: &Parcel) -> Result<ResumeChallenge, WireError> {
        let book = self.book();
        let until = self.clock.now().saturating_add(book.challenge_time());
        ResumeChallenge::new(parcel, &book.settings.hub, until)
    }

    /// Checks a `login answer` to the last challenge of its connection, and consumes the challenge.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn answer(
        &self,
        parcel: &Parcel,
        challenge: Option<Challenge>,
        from: Option<IpAddr>,
    ) -> Result<Granted, WireError> {
        let book = self.book();
        let signature = read_signature(parcel).map_err(|error| self.malformed(&book, from, error))?;
        // Not throttled: who has the key gets in whatever others try, and a signature cannot be guessed.
        let attempt = self.attempt(&book, from, None);
        let challenge = challenge.filter(|challenge| challenge.is_open(self.clock.now()));
        let Some(challenge) = challenge else {
            attempt.fail();
            let text = "there is no open challenge to answer: ask for one with login {name, key}";
            return Err(WireError::new(Code::BAD_LOGIN, text));
        };
        // Unknown users and those without keys get a challenge too, and fail only here.
        let entry = book.users.get(&challenge.user);
        let keys = entry.map_or(&[][..], |entry| &entry.keys);
        match entry.zip(challenge.is_answered(keys, book.keys, &signature)) {
            Some((entry, key)) => {
                let standing = Identity::of_file(entry, book::ShownProof::Key(Box::new(key)));
                self.grant(standing, challenge.asked, None, Arc::clone(&book))
            }
            None => {
                attempt.fail();
                let text = "no user has this name and a key that made this signature";
                Err(WireError::new(Code::BAD_LOGIN, text))
            }
        }
    }

    /// Admits an authenticated user: `decide` tells the hub. No reload can happen in between.
    ///
    /// # Errors
    /// `bad-login` if the configuration has changed meanwhile and the user no longer exists.
    pub fn admit(
        &self,
        peer: PeerId,
        granted: Granted,
        decide: impl FnOnce(User, Option<String>),
    ) -> Result<Option<Expiry>, WireError> {
        let Granted {
            mut standing,
            nickname,
            until,
            book,
            ..
        } = granted;
        let now = self.book.read();
        if !Arc::ptr_eq(&book, &now) {
            let gone = || {
                WireError::new(
                    Code::BAD_LOGIN,
                    "this user no longer exists, or its credentials have changed",
                )
            };
            standing.user = standing.as_of(&now).ok_or_else(gone)?;
            now.check_nickname(&standing.user, nickname.as_deref())?;
        }
        if standing.origin == UserSource::Claims {
            self.subjects.note(&standing.user.name);
        }
        let mut user = User::clone(&standing.user);
        if let Some(until) = until {
            user.details.set("until", until);
        }
        self.peers.insert(peer, standing);
        decide(user, nickname);
        Ok(until.map(|until| self.clock.expiry(until)))
    }

    /// A peer is gone.
    pub fn forget(&self, peer: PeerId) {
        self.peers.remove(&peer);
    }

    /// Occupies the whole hashing pool until the result is dropped: for tests.
    #[cfg(feature = "occupy")]
    pub async fn occupy(&self) -> impl Drop + use<> {
        self.book().hashing.occupy().await
    }

    fn book(&self) -> Arc<Book> {
        Arc::clone(&self.book.read())
    }

    async fn by_password(
        &self,
        book: &Book,
        name: &str,
        password: String,
        link: &LoginLink,
    ) -> Result<Identity, WireError> {
        password::check_private(link, "password")?;
        let from = link.from;
        let attempt = self.enter(book, from, Some(name))?;
        let place = from.map(network);
        let known = place.filter(|place| self.places.knows(name, *place));
        let entry = book.users.get(name).filter(|entry| entry.password.is_some());
        let expected = entry.and_then(|entry| entry.password.clone());
        let expected = expected.unwrap_or_else(|| book.decoys.of(name).to_owned());
        let shown = expected.clone();
        let known = known.map(|place| (name.to_owned(), place));
        let matches = book
            .hashing
            .verify(password, expected, known, book.settings.waiting)
            .await?;
        match entry.filter(|_| matches) {
            Some(entry) => {
                if let Some(place) = place {
                    self.places.note(name, place);
                }
                Ok(Identity::of_file(entry, book::ShownProof::Password(shown)))
            }
            None => {
                attempt.fail();
                Err(WireError::new(
                    Code::BAD_LOGIN,
                    "no user has this name and password",
                ))
            }
        }
    }

    fn by_token(
        &self,
        book: &Book,
        token: &str,
        link: &LoginLink,
    ) -> Result<(Identity, Option<Time>), WireError> {
        password::check_private(link, "token")?;
        // As with keys.
        let attempt = self.attempt(book, link.from, None);
        let standing = book.bearer(token, self.clock.civil());
        if standing.is_err() {
            attempt.fail();
        }
        standing.map(|(standing, until)| (standing, Some(until)))
    }

    fn by_certificate(&self, book: &Book, name: &str, link: &LoginLink) -> Result<Identity, WireError> {
        // As with keys.
        let attempt = self.attempt(book, link.from, None);
        let shown = link.certificate;
        let known = |entry: &&book::BookEntry| shown.is_some_and(|shown| entry.certificates.contains(&shown));
        match (book.users.get(name).filter(known), shown) {
            (Some(entry), Some(shown)) => Ok(Identity::of_file(entry, book::ShownProof::Certificate(shown))),
            (_, shown) => {
                attempt.fail();
                let text = match shown {
                    Some(shown) => format!("no user has this name and the certificate {shown}"),
                    None => "no certificate was shown: connect to bins:// or tcps:// with one".to_owned(),
                };
                Err(WireError::new(Code::BAD_LOGIN, text))
            }
        }
    }

    fn grant(
        &self,
        standing: Identity,
        Asked { nickname, wishes }: Asked,
        until: Option<Time>,
        book: Arc<Book>,
    ) -> Result<Granted, WireError> {
        // Only now: an earlier refusal would reveal which users exist.
        book.check_nickname(&standing.user, nickname.as_deref())?;
        self.subjects
            .check_nickname(&standing.user, nickname.as_deref())?;
        Ok(Granted {
            standing,
            nickname,
            wishes,
            until,
            book,
        })
    }

    /// An attempt that does not wait.
    fn attempt<'a>(&'a self, book: &'a Book, from: Option<IpAddr>, account: Option<&str>) -> Attempt<'a> {
        let known = |from, account: &str| self.places.knows(account, network(from));
        let source = |from| {
            let known = account.is_some_and(|account| known(from, account));
            self.throttle.source(from, account, known)
        };
        Attempt {
            logins: self,
            book,
            source: from.map(source),
        }
    }

    /// Counts a login that cannot be read as a failed attempt, unless only the name was not a valid one; gives what its
    /// sender hears.
    fn malformed(&self, book: &Book, from: Option<IpAddr>, error: WireError) -> WireError {
        if error.code == Code::BAD_NAME {
            return error;
        }
        match self.enter(book, from, None) {
            Ok(attempt) => {
                attempt.fail();
                error
            }
            Err(later) => later,
        }
    }

    /// An attempt, unless the throttle makes it wait.
    fn enter<'a>(
        &'a self,
        book: &'a Book,
        from: Option<IpAddr>,
        account: Option<&str>,
    ) -> Result<Attempt<'a>, WireError> {
        let attempt = self.attempt(book, from, account);
        let Some(source) = attempt.source else {
            // Peers inside this process are not throttled: they need not guess.
            return Ok(attempt);
        };
        self.throttle
            .check(source, self.clock.now(), &book.settings.throttle)
            .map_err(|wait| {
                WireError::new(Code::TRY_LATER, "too many logins have failed").retry_after(wait)
            })?;
        Ok(attempt)
    }
}

impl Granted {
    /// The user's name, for logs.
    pub fn user(&self) -> &str {
        &self.standing.user.name
    }

    /// What else was asked for.
    pub fn wishes(&self) -> &Wishes {
        &self.wishes
    }

    /// Where the user comes from, for logs.
    pub fn origin(&self) -> UserSource {
        self.standing.origin
    }
}

/// One attempt, counted by its outcome; without an outcome it does not count.
struct Attempt<'a> {
    logins: &'a Logins,
    book: &'a Book,
    source: Option<throttle::AttemptSource>,
}

impl Attempt<'_> {
    fn fail(self) {
        if let Some(source) = self.source {
            let Logins { throttle, clock, .. } = self.logins;
            throttle.fail(source, clock.now(), &self.book.settings.throttle);
        }
    }
}
