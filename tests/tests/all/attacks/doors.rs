//! Nobody is kept out by others: not by strangers who say nothing, not by guests, not by wrong passwords.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use mom_broker::{Broker, Config};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, Value, WireError};
use mom_tests::canary::Canary;
use mom_tests::lab;
use mom_tests::login::{Issuer, claims, password, token};
use mom_tests::raw::Raw;

/// The lab with its canary, which must not notice.
struct House {
    broker: Broker,
    canary: Canary,
}

impl House {
    async fn open(change: impl FnOnce(&mut Config)) -> House {
        let broker = lab::start_with(change).await;
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

/// Strangers who say nothing, or not enough, fill all places that they may, again and again; whoever has something to
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

/// A guest may not be taken for somebody else, in whatever letters.
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
