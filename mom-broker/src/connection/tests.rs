//! Logins inside a broker without a listener, so that a peer may come from anywhere.

use std::net::IpAddr;
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ed25519_dalek::{Signer, SigningKey};
use mom_config::Config;
use mom_hub::{Hub, PeerId, Settings, User};
use mom_journal::Tap;
use mom_login::{Granted, LoginConfig, LoginLink, LoginStep, Logins, UserEntry, UserSource};
use mom_net::Transceiver;
use mom_proto::codec::Frame;
use mom_proto::{Code, Family, Limit, Map, Parcel, Path, Value, WireError, login_challenge};
use mom_system::Clock;
use tokio::sync::mpsc;
use tokio::time::Instant;

use super::{Remote, Services, Serving};
use crate::traffic::encodings::Bounds;
use crate::traffic::switchboard::{Keeping, Switchboard};

/// The lab without a listener.
struct House {
    services: Services,
}

impl House {
    fn open(change: impl FnOnce(&mut Config)) -> House {
        let mut config = Config::lab();
        change(&mut config);
        let settings = Settings::default();
        let hub = Hub::new(
            settings.clone(),
            config.registry(),
            &config.root,
            &config.contexts,
        );
        let bounds = Bounds {
            depth: config.limits.depth,
            parcel: config.limits.parcel,
        };
        let clock = Clock::manual(mom_proto::Time::from_micros(0).expect("1970"));
        let journal = (&config.audit, &config.record);
        let tap = Tap::start(journal, config.file(), &settings, &clock).expect("no files to write");
        let logins = Logins::new(config.users, config.login, clock.clone()).expect("right");
        let board = Switchboard::new(hub.expect("right"), clock, bounds, Keeping::default(), tap);
        House {
            services: Services::new(board, logins, config.limits),
        }
    }

    /// A peer that comes from somewhere.
    fn enter(&self, from: Option<&str>) -> Visitor {
        let (here, there) = mom_net::pair();
        let remote = Remote {
            from: from.map(|from| from.parse::<IpAddr>().expect("an address")),
            ..Remote::default()
        };
        let login_by = Instant::now() + Duration::from_secs(60);
        let mut serving = Serving::begin(self.services.clone(), here, remote, None, login_by);
        tokio::spawn(async move { serving.run().await });
        Visitor { link: there, last: 0 }
    }

    fn logins(&self) -> &Logins {
        &self.services.logins
    }
}

struct Visitor {
    link: Transceiver,
    last: u64,
}

impl Visitor {
    async fn ask(&mut self, parcel: Parcel) -> Result<Value, WireError> {
        self.last += 1;
        let sent = self.link.writer.send(parcel.id(self.last)).await;
        sent.expect("the broker reads");
        loop {
            let heard = self.next().await.expect("an answer");
            match heard.family {
                Family::Error if heard.reference == Some(self.last) || heard.reference.is_none() => {
                    return Err(WireError::from_parcel(&heard));
                }
                _ if heard.reference == Some(self.last) => return Ok(heard.value()),
                _ => {}
            }
        }
    }

    async fn next(&mut self) -> Option<Box<Parcel>> {
        match self.link.reader.next().await.expect("a whole link")? {
            Frame::Parcel(parcel) => Some(parcel),
            Frame::Malformed { error, .. } => panic!("{error}"),
        }
    }

    async fn about(&mut self, family: Family, name: &str, path: &str) -> Result<Value, WireError> {
        let path = Path::parse(path).expect("a path");
        self.ask(Parcel::new(family, name).context(path)).await
    }

    async fn log_in(&mut self, content: Map) -> Result<Value, WireError> {
        self.ask(login(content)).await
    }
}

fn login(content: Map) -> Parcel {
    Parcel::new(Family::Login, "login").content(content)
}

fn password(name: &str, password: &str) -> Map {
    Map::new().with("name", name).with("password", password)
}

/// Threat 15: who cannot log in does not learn who can.
#[tokio::test]
async fn a_nickname_does_not_tell_who_exists() {
    let house = House::open(|_| {});
    for nickname in ["bob", "nobody"] {
        let content = password("eve", "x").with("nickname", nickname);
        let error = house.enter(None).log_in(content).await.expect_err("no user");
        assert_eq!(error.code, Code::BAD_LOGIN, "{nickname}");
    }
}

/// A secret that could be read on its way is not taken, a signature is; and the hub says so and closes.
#[tokio::test]
async fn from_elsewhere_only_keys_and_guests() {
    let key = SigningKey::from_bytes(&[1; 32]);
    let house = House::open(|config| {
        config.login.guests = true;
        config.users[0].keys = vec![public(&key)];
    });
    for from in ["192.0.2.1", "::ffff:192.0.2.1", "2001:db8::1"] {
        for content in [password("alice", "alice"), Map::new().with("token", "x.y.z")] {
            let mut eve = house.enter(Some(from));
            let error = eve.log_in(content).await.expect_err("not over this link");
            assert_eq!(error.code, Code::INSECURE);
            assert!(eve.next().await.is_none(), "closed");
        }
        let mut alice = house.enter(Some(from));
        let challenge = alice.log_in(Map::new().with("name", "alice").with("key", true));
        let challenge = challenge.await.expect("a challenge");
        let answer = answer_to(&challenge, "alice", &key);
        let welcome = alice.ask(answer).await.expect("alice's key");
        assert_eq!(welcome.get("user"), Some(&Value::from("alice")));
        let mut guest = house.enter(Some(from));
        let welcome = guest
            .log_in(Map::new().with("guest", true))
            .await
            .expect("a guest");
        assert_eq!(welcome.get("user"), Some(&Value::from("guest")));
    }
}

fn public(key: &SigningKey) -> String {
    format!("ed25519 {}", STANDARD.encode(key.verifying_key().to_bytes()))
}

fn answer_to(challenge: &Value, user: &str, key: &SigningKey) -> Parcel {
    let hub = challenge.get("hub").and_then(Value::as_str).expect("a hub");
    let nonce = challenge
        .get("nonce")
        .and_then(Value::as_binary)
        .expect("a nonce");
    let signature = key.sign(&login_challenge(hub, user, nonce)).to_bytes();
    let signature = Value::Binary(signature.to_vec().into());
    Parcel::new(Family::Login, "answer").content(Map::new().with("signature", signature))
}

/// Threat 16: while all places for hashing are taken, connected peers go on, and of those who come only so many
/// wait; the others are told when to come again.
#[tokio::test]
async fn logins_that_wait_hold_nobody_up() {
    const AT_ONCE: usize = 200;
    let house = House::open(|_| {});
    let LoginConfig { waiting, hashers, .. } = LoginConfig::default();
    let mut owner = house.enter(None);
    owner.log_in(password("alice", "alice")).await.expect("alice");
    owner
        .about(Family::Context, "join", "/robot")
        .await
        .expect("allowed");
    owner
        .about(Family::Token, "grab", "/robot/token")
        .await
        .expect("free");
    let occupied = house.logins().occupy().await;
    let (told, mut outcomes) = mpsc::unbounded_channel();
    for _ in 0..AT_ONCE {
        let (mut visitor, told) = (house.enter(None), told.clone());
        tokio::spawn(async move {
            let outcome = visitor.log_in(password("bob", "bob")).await;
            // The test is over if nobody hears it.
            let _ = told.send((outcome, visitor));
        });
    }
    for _ in waiting..AT_ONCE {
        let (outcome, _) = outcomes.recv().await.expect("an outcome");
        let error = outcome.expect_err("nothing can be hashed now");
        assert_eq!(error.code, Code::TRY_LATER);
        assert!(error.retry_in().is_some_and(|wait| !wait.is_zero()), "{error}");
    }
    // All others are waiting now, and will until the places are free.
    assert_eq!(house.logins().stats().waiting, waiting);
    for _ in 0..10 {
        owner
            .about(Family::Token, "renew", "/robot/token")
            .await
            .expect("the owner");
        owner
            .ask(Parcel::new(Family::Time, "ping"))
            .await
            .expect("a pong");
    }
    assert!(outcomes.try_recv().is_err(), "nobody was checked meanwhile");
    drop(occupied);
    for _ in 0..waiting {
        let (outcome, _) = outcomes.recv().await.expect("an outcome");
        outcome.expect("bob's password");
    }
    let stats = house.logins().stats();
    assert!(stats.most <= hashers, "{stats:?}");
    assert_eq!((stats.hashed, stats.hashing), (1 + waiting as u64, 0));
}

/// A refusal costs the hub as much as a small request, so a peer that goes on asking is read no faster; what is not a request
/// passes as soon as it is read, and others do not wait.
#[tokio::test]
async fn who_asks_on_is_read_slowly() {
    const MOST: u32 = 10;
    const REFUSED: u32 = 4 * MOST;
    const MORE: u32 = 10;
    let house = House::open(|config| config.limits.requests = Limit::At(u64::from(MOST)));
    let [mut alice, mut bob] = [house.enter(None), house.enter(None)];
    alice.log_in(password("alice", "alice")).await.expect("alice");
    bob.log_in(password("bob", "bob")).await.expect("bob");
    let began = Instant::now();
    let mut refused = 0;
    // The broker's clock stands still, so nothing is paid back.
    for _ in 0..MOST + REFUSED + MORE {
        let answer = alice.about(Family::Context, "list", "/").await;
        refused += u32::from(answer.is_err_and(|error| error.code == Code::TRY_LATER));
    }
    assert!(refused >= REFUSED + MORE - 1, "{refused}");
    // One request and one refusal more than in a second may come at once, and nothing waits for the last pause.
    let pauses = MORE - 3;
    let least = Duration::from_secs(1) / REFUSED * pauses;
    assert!(began.elapsed() >= least, "{:?}", began.elapsed());
    alice
        .ask(Parcel::new(Family::Time, "ping"))
        .await
        .expect("a pong");
    bob.about(Family::Context, "list", "/")
        .await
        .expect("not bob's fault");
}

async fn prove(logins: &Logins, content: Map) -> Granted {
    match logins.check(&login(content), &LoginLink::default()).await {
        Ok(LoginStep::Granted(granted)) => granted,
        other => panic!("{other:?}"),
    }
}

fn admit(logins: &Logins, peer: u64, granted: Granted) -> Result<User, WireError> {
    let mut admitted = None;
    logins.admit(PeerId(peer), granted, |user, _| admitted = Some(user))?;
    Ok(admitted.expect("the hub is told"))
}

fn without(name: &str) -> Vec<UserEntry> {
    let users = Config::lab().users.into_iter();
    users.filter(|user| user.name != name).collect()
}

/// A password that is another one now, and a key that the user has no more, prove nothing any more: also on
/// connections that are open, and to who is on the way in.
#[tokio::test]
async fn what_was_shown_must_still_be_the_users() {
    let key = SigningKey::from_bytes(&[7; 32]);
    let mut config = Config::lab();
    let user = |name: &str| {
        config
            .users
            .iter()
            .position(|user| user.name == name)
            .expect("of the lab")
    };
    let (alice, bob) = (user("alice"), user("bob"));
    config.users[bob].keys = vec![public(&SigningKey::from_bytes(&[8; 32])), public(&key)];
    let settings = config.login.clone();
    let logins = Logins::new(config.users.clone(), settings.clone(), Clock::system()).expect("right");
    admit(&logins, 1, prove(&logins, password("alice", "alice")).await).expect("in");
    admit(&logins, 2, prove(&logins, password("bob", "bob")).await).expect("in");
    let asked = logins
        .check(
            &login(Map::new().with("name", "bob").with("key", true)),
            &LoginLink::default(),
        )
        .await;
    let Ok(LoginStep::Challenge(challenge)) = asked else {
        panic!("{asked:?}")
    };
    let answer = answer_to(&challenge.content().into(), "bob", &key);
    let by_key = logins.answer(&answer, Some(challenge), None).expect("his key");
    admit(&logins, 3, by_key).expect("in");
    let late = prove(&logins, password("alice", "alice")).await;

    let mut users = config.users;
    let replace = |users: &[UserEntry]| {
        let mut changed = Vec::new();
        let replaced = logins.replace(users.to_vec(), settings.clone(), |list| changed = list);
        replaced.expect("right");
        changed
    };
    assert_eq!(replace(&users), []);
    users[alice].password = Some(crate::hash("another").expect("a hash"));
    assert_eq!(replace(&users), [(PeerId(1), None)]);
    let error = admit(&logins, 4, late).expect_err("it was the old password");
    assert_eq!(error.code, Code::BAD_LOGIN);
    logins.forget(PeerId(1));
    users[bob].keys.swap(0, 1);
    assert_eq!(replace(&users), [], "he has it still");
    users[bob].keys.remove(0);
    assert_eq!(replace(&users), [(PeerId(3), None)], "his password is as it was");
}

/// A new configuration reaches who is here already, and who is on the way in.
#[tokio::test]
async fn a_new_users_file_holds_for_everybody() {
    let mut config = Config::lab();
    config.login.guests = true;
    let settings = config.login.clone();
    let logins = Logins::new(config.users, settings.clone(), Clock::system()).expect("right");
    for (peer, name) in [(1, "alice"), (2, "bob"), (3, "carol")] {
        admit(&logins, peer, prove(&logins, password(name, name)).await).expect("in");
    }
    let guest = prove(&logins, Map::new().with("guest", true)).await;
    assert_eq!(guest.origin(), UserSource::Guest);
    admit(&logins, 4, guest).expect("in");
    let late = prove(&logins, password("alice", "alice")).await;
    let promoted = prove(&logins, password("bob", "bob")).await;
    let named = prove(&logins, password("bob", "bob").with("nickname", "dave")).await;
    logins.forget(PeerId(3));

    let mut users = without("alice");
    users[0].level = 3;
    users.push(UserEntry {
        name: "dave".to_owned(),
        ..users[0].clone()
    });
    let mut changed = Vec::new();
    let replaced = logins.replace(users.clone(), settings.clone(), |list| changed = list);
    replaced.expect("right");
    changed.sort_by_key(|(peer, _)| *peer);
    let [(PeerId(1), None), (PeerId(2), Some(bob))] = &changed[..] else {
        panic!("{changed:?}")
    };
    assert_eq!((&*bob.name, bob.level), ("bob", 3));
    assert!(!logins.knows("alice"));
    let error = admit(&logins, 5, late).expect_err("alice is not a user any more");
    assert_eq!(error.code, Code::BAD_LOGIN);
    assert_eq!(admit(&logins, 6, promoted).expect("bob").level, 3);
    let error = admit(&logins, 7, named).expect_err("dave is known now");
    assert_eq!(error.code, Code::BAD_NAME);

    // The same again changes nothing; without guests the guest goes; what is wrong leaves all as it is.
    let mut replace = |users: Vec<UserEntry>, settings| {
        changed.clear();
        let replaced = logins.replace(users, settings, |list| changed = list);
        replaced.map(|()| changed.clone())
    };
    let mut gone = without("alice");
    gone[0].level = 3;
    assert_eq!(
        replace(gone.clone(), settings.clone()),
        Ok(vec![(PeerId(1), None)])
    );
    logins.forget(PeerId(1));
    let closed = crate::LoginConfig {
        guests: false,
        ..settings.clone()
    };
    assert_eq!(replace(gone.clone(), closed.clone()), Ok(vec![(PeerId(4), None)]));
    gone[0].keys = vec!["nonsense".to_owned()];
    gone[0].level = 9;
    assert!(replace(gone, settings).is_err());
    let bob = prove(&logins, password("bob", "bob")).await;
    assert_eq!(admit(&logins, 8, bob).expect("as before").level, 3);
}
