//! Nobody is kept out by others: not by strangers who say nothing, not by guests, not by wrong passwords.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use mom_broker::{Broker, Config};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, Value, WireError};
use mom_tests::canary::Canary;
use mom_tests::lab;
use mom_tests::login::{DeviceKey, Issuer, challenge, claims, make_costly, password, token};
use mom_tests::raw::{PATIENCE, Raw};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// The lab with its canary, which must not notice.
struct House {
    broker: Broker,
    canary: Canary,
}

impl House {
    async fn open(change: impl FnOnce(&mut Config)) -> House {
        // A clock that stands still: on a busy machine nobody is forgiven because a test takes long.
        let broker = lab::start_at(lab::clock(), |config| {
            // Hashing gives way to all else that this machine does meanwhile.
            config.limits.login_time = 600_000;
            change(config);
        })
        .await;
        let canary = Canary::start(broker.local_addr()).await;
        House { broker, canary }
    }

    fn address(&self) -> SocketAddr {
        self.broker.local_addr()
    }

    async fn from(&self, from: IpAddr) -> Raw {
        Raw::connect_from(from, self.address(), Form::Binary).await
    }

    async fn guest(&self, nickname: &str) -> Result<(Raw, String), WireError> {
        let mut raw = Raw::connect(self.address(), Form::Binary).await;
        let name = be_guest(&mut raw, nickname).await?;
        Ok((raw, name))
    }

    async fn close(self) {
        assert!(self.canary.stop().await > 0);
        self.broker.check();
        self.broker.stop().await;
    }
}

async fn be_guest(raw: &mut Raw, nickname: &str) -> Result<String, WireError> {
    let content = Map::new().with("guest", true).with("nickname", nickname);
    let login = Parcel::new(Family::Login, "login").content(content);
    let id = raw.post(login).await;
    loop {
        let heard = raw.next().await.expect("an answer before the end");
        match heard.family {
            // One that closes the connection refers to nothing.
            Family::Error => return Err(WireError::from_parcel(&heard)),
            _ if heard.reference == Some(id) => {
                let welcome = heard.value();
                let name = welcome.get("peer").and_then(Value::as_str);
                return Ok(name.expect("the hub gives a name").to_owned());
            }
            _ => {}
        }
    }
}

/// An address of loopback.
fn address(last: u8) -> IpAddr {
    IpAddr::from(Ipv4Addr::new(127, 0, 9, last))
}

/// Strangers who say nothing, or not enough, fill all places that they may, again and again; a peer with something to
/// say gets in each time, also from their address. They hear why they are closed, and who has logged in stays.
#[tokio::test]
async fn silent_strangers_keep_nobody_out() {
    let mut house = House::open(|config| {
        config.connections = 20;
        config.connections_before_login = Some(16);
        config.connections_per_address = Some(8);
    })
    .await;
    let mut peers = Vec::new();
    let mut strangers = Vec::new();
    for _ in 0..8 {
        for number in 0..40 {
            let form = [Form::Xml, Form::Binary][number % 2];
            let from = address(1 + (number % 4) as u8);
            strangers.push(Raw::connect_from(from, house.address(), form).await);
        }
        for from in [address(1), address(9)] {
            let mut peer = house.from(from).await;
            password(&mut peer, "bob", "bob").await.expect("bob");
            peers.push(peer);
        }
        house.canary.check().await;
    }
    let told = strangers[0].last_error().await;
    assert_eq!(told, Some(Code::TOO_MANY_CONNECTIONS));
    let told = strangers[1].last_error().await;
    assert_eq!(told, Some(Code::TOO_MANY_CONNECTIONS));
    for peer in &mut peers {
        peer.check_alive().await;
    }
    house.close().await;
}

/// One user has so many connections, and no more places than that are gone for others. Guests are one user.
#[tokio::test]
async fn one_user_does_not_fill_the_house() {
    let house = House::open(|config| {
        config.connections = 12;
        config.connections_per_user = Some(5);
        config.login.guests = true;
    })
    .await;
    let mut guests = Vec::new();
    for _ in 0..5 {
        guests.push(house.guest("anna").await.expect("a guest").0);
    }
    let mut bobs = Vec::new();
    // The canary's two are connected as well, so that all places are taken.
    for _ in 0..4 {
        bobs.push(Raw::login(house.address(), Form::Xml, "bob").await);
    }
    for _ in 0..3 {
        let error = house.guest("anna").await.expect_err("one more");
        assert_eq!(error.code, Code::TOO_MANY_CONNECTIONS);
    }
    Raw::login(house.address(), Form::Xml, "carol")
        .await
        .check_alive()
        .await;
    let mut gone = guests.pop().expect("one of five");
    let logout = Parcel::new(Family::Login, "logout");
    gone.ask(logout).await.expect("ok");
    gone.check_closed().await;
    drop(gone);
    while house.guest("anna").await.is_err() {}
    house.close().await;
}

/// A guest may not be taken for another user, in whatever letters.
#[tokio::test]
async fn names_are_nobody_elses_in_any_form() {
    let issuer = Issuer::number(1);
    let house = House::open(|config| {
        config.login.guests = true;
        config.login.jwt = Some(mom_broker::JwtConfig {
            users: mom_broker::JwtUsers::FromClaims,
            ..issuer.config()
        });
    })
    .await;
    let cyrillic = "\u{430}\u{441}\u{435}";
    for nickname in [
        "alice",
        "Alice",
        "ALICE",
        "a1ice",
        "Guest",
        "HUB",
        "alice ",
        "c\u{430}rol",
    ] {
        let error = house.guest(nickname).await.expect_err(nickname);
        assert_eq!(error.code, Code::BAD_NAME, "{nickname}");
    }
    for (nickname, name) in [
        ("ace", "ace"),
        ("Ace", "Ace~2"),
        (cyrillic, &*format!("{cyrillic}~3")),
    ] {
        let (mut guest, given) = house.guest(nickname).await.expect("a guest");
        assert_eq!(given, name);
        guest.check_alive().await;
        // It stays while the next ones come.
        tokio::spawn(async move { guest.next().await });
    }
    house.guest("dora").await.expect("nobody is called so");
    let mut dora = Raw::connect(house.address(), Form::Binary).await;
    let signed = |user: &str| issuer.sign(&claims(user, i64::from(u32::MAX)));
    token(&mut dora, &signed("dora")).await.expect("dora");
    for nickname in ["dora", "Dora", "d\u{43e}ra"] {
        let error = house.guest(nickname).await.expect_err(nickname);
        assert_eq!(error.code, Code::BAD_NAME, "{nickname}");
    }
    for user in ["alice", "Alice", "GUEST"] {
        let mut raw = Raw::connect(house.address(), Form::Binary).await;
        let error = token(&mut raw, &signed(user)).await.expect_err(user);
        assert_eq!(error.code, Code::BAD_LOGIN, "{user}");
    }
    house.close().await;
}

/// Guesses until it is told to come later, as several users.
async fn guess_as_much_as_one_may(house: &House, from: IpAddr, users: &[&str]) {
    let mut eve = house.from(from).await;
    for user in users {
        loop {
            let error = password(&mut eve, user, "guess").await.expect_err("a guess");
            if error.code == Code::TRY_LATER {
                break;
            }
            assert_eq!(error.code, Code::BAD_LOGIN);
        }
    }
}

/// Wrong passwords from everywhere, also from their own address, keep neither a user out where it has been before nor a
/// device with its key; nor do they after a restart.
#[tokio::test]
async fn wrong_passwords_keep_neither_the_right_one_nor_a_key_out() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("state");
    let open = || {
        House::open(|config| {
            config.store.path = Some(path.clone());
            config.login.attempts = 10_000;
            let bob = config.users.iter_mut().find(|user| user.name == "bob");
            bob.expect("of the lab").keys = vec![DeviceKey::number(1).public()];
        })
    };
    let home = address(1);
    let house = open().await;
    let mut alice = house.from(home).await;
    password(&mut alice, "alice", "alice").await.expect("alice");
    house.close().await;

    let mut house = open().await;
    for from in [home, address(2), address(3)] {
        guess_as_much_as_one_may(&house, from, &["bob", "carol", "nobody"]).await;
    }
    let mut eve = house.from(home).await;
    for _ in 0..30 {
        let guessed = password(&mut eve, "alice", "guess").await;
        assert_eq!(guessed.expect_err("a guess").code, Code::BAD_LOGIN);
    }
    let mut alice = house.from(home).await;
    password(&mut alice, "alice", "alice").await.expect("known there");
    let mut bob = house.from(home).await;
    let asked = challenge(&mut bob, "bob").await.expect("a challenge");
    let answered = bob.ask(DeviceKey::number(1).answer(&asked, "bob")).await;
    answered.expect("bob's key");
    let mut bob = house.from(home).await;
    let error = password(&mut bob, "bob", "bob")
        .await
        .expect_err("never here before");
    assert_eq!(error.code, Code::TRY_LATER);
    house.canary.check().await;
    // That is not a licence: guesses there have a bound of their own.
    guess_as_much_as_one_may(&house, home, &["alice"]).await;
    house.close().await;
}

/// More wrong passwords at once than may wait to be hashed: who is known where it comes from waits beside them.
#[tokio::test]
async fn a_storm_of_hashing_keeps_known_places_open() {
    const EVES: usize = 24;
    let mut house = House::open(|config| {
        config.login.waiting = 4;
        make_costly(&mut config.users, "bob");
        config.login.attempts = 1_000_000;
        let rate = mom_broker::FailureRate {
            per_minute: 1_000_000,
            burst: 1_000_000,
        };
        config.login.throttle.per_address = rate;
        config.login.throttle.per_account = rate;
    })
    .await;
    let home = address(1);
    let mut alice = house.from(home).await;
    password(&mut alice, "alice", "alice").await.expect("alice");
    let mut storm = tokio::task::JoinSet::new();
    let (tell, mut put_off) = tokio::sync::watch::channel(0_usize);
    for number in 0..EVES {
        let mut eve = house.from(address(10 + number as u8)).await;
        let tell = tell.clone();
        storm.spawn(async move {
            loop {
                let error = password(&mut eve, "bob", "guess").await.expect_err("a guess");
                if error.code == Code::TRY_LATER {
                    tell.send_modify(|count| *count += 1);
                }
            }
        });
    }
    for round in 1..=10 {
        let some = put_off.wait_for(|count| *count >= round * EVES).await;
        some.expect("the storm goes on");
        let mut alice = house.from(home).await;
        password(&mut alice, "alice", "alice").await.expect("not put off");
    }
    house.canary.check().await;
    storm.shutdown().await;
    house.close().await;
}

/// Who is refused hears why, in a parcel like any other of the hub: the close is not a reset, which would overtake it where
/// a peer has sent what nobody has read.
#[tokio::test(flavor = "multi_thread")]
async fn who_finds_no_place_hears_why() {
    let house = House::open(|config| config.connections = 4).await;
    let mut inside = Vec::new();
    for _ in 0..2 {
        inside.push(Raw::login(house.address(), Form::Binary, "bob").await);
    }
    for _ in 0..20 {
        let mut stream = TcpStream::connect(house.address()).await.expect("it listens");
        // More than its login, at once.
        let wrote = stream.write_all(&[b'<'; 16 * 1024]).await;
        wrote.expect("it is not reset");
        let mut said = String::new();
        let heard = timeout(PATIENCE, stream.read_to_string(&mut said)).await;
        heard.expect("it closes").expect("it is not reset");
        for part in [
            "<name>too-many-connections</name>",
            "<sender>hub</sender>",
            "<timestamp ",
        ] {
            assert!(said.contains(part), "{part} in {said}");
        }
    }
    for peer in &mut inside {
        peer.check_alive().await;
    }
    house.close().await;
}
