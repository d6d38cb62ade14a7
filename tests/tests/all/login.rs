//! Ways to log in, through real sockets, the client crate and the programs.

use std::fs;
use std::time::Duration;

use mom_broker::{Broker, Clock, Config};
use mom_client::{Builder, Client, Event, Key, LinkState, Proof};
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Time, Value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::lab;
use mom_tests::login::{DeviceKey, Issuer, challenge, claims, log_in, password, token};
use mom_tests::programs::{PATIENCE, Running, project, run, text};
use mom_tests::raw::Raw;
use serde_json::json;
use tempfile::TempDir;
use tokio::time::timeout;

/// 2026-11-21T10:00:00Z, in seconds.
const BEGIN: i64 = 1_795_255_200;

fn clock() -> Clock {
    Clock::manual(Time::from_micros(BEGIN * 1_000_000).expect("a time"))
}

fn guests(config: &mut Config) {
    config.login.guests = true;
}

fn keys_for_bob(config: &mut Config) {
    let bob = config.users.iter_mut().find(|user| user.name == "bob");
    bob.expect("a user of the lab").keys = vec![DeviceKey::number(1).public() + " bob's phone"];
}

fn guest() -> Map {
    Map::new().with("guest", true)
}

#[tokio::test]
async fn guests_are_let_in_where_the_hub_says_so() {
    let broker = lab::start_with(guests).await;
    let closed = lab::start().await;
    for form in Form::ALL {
        let mut nobody = Raw::connect(closed.local_addr(), form).await;
        let error = log_in(&mut nobody, guest()).await.expect_err("not there");
        assert_eq!(error.code.word(), "bad-login");

        let connect = || Raw::connect(broker.local_addr(), form);
        let (mut one, mut two, mut gus) = (connect().await, connect().await, connect().await);
        let welcome = log_in(&mut one, guest()).await.expect("a guest");
        assert_eq!(welcome.get("peer"), Some(&Value::from("guest")));
        assert_eq!(welcome.get("user"), Some(&Value::from("guest")));
        assert_eq!(welcome.get("level"), Some(&Value::Int(0)));
        let groups = Value::from(vec![Value::from("guest")]);
        assert_eq!(welcome.get("groups"), Some(&groups));
        let welcome = log_in(&mut two, guest()).await.expect("another");
        assert_eq!(welcome.get("peer"), Some(&Value::from("guest~2")));
        let welcome = log_in(&mut gus, guest().with("nickname", "gus")).await;
        assert_eq!(welcome.expect("gus").get("peer"), Some(&Value::from("gus")));
        // The lab's rules give nothing to level 0 without a group of theirs.
        let error = gus.ask_about(Family::Context, "join", "/chat").await;
        assert_eq!(error.expect_err("not a guest's").code.word(), "denied");
        for (content, taken) in [
            (guest().with("nickname", "bob"), "a user's name"),
            (
                Map::new()
                    .with("name", "bob")
                    .with("password", "bob")
                    .with("nickname", "guest"),
                "the guests' name",
            ),
        ] {
            let mut peer = connect().await;
            let error = log_in(&mut peer, content).await.expect_err(taken);
            assert_eq!(error.code.word(), "bad-name", "{taken}");
        }
        for mut peer in [one, two, gus] {
            peer.ask_about(Family::Login, "logout", "/")
                .await
                .expect("good-bye");
            peer.check_closed().await;
        }
    }
    broker.stop().await;
    closed.stop().await;
}

/// Any proof again, on one connection: the same user stays who it is, another becomes another peer.
#[tokio::test]
async fn every_proof_again_on_a_live_connection() {
    let issuer = Issuer::number(1);
    let broker = lab::start_at(clock(), |config| {
        guests(config);
        keys_for_bob(config);
        config.login.jwt = Some(issuer.config());
    })
    .await;
    for form in Form::ALL {
        let mut bob = Raw::connect(broker.local_addr(), form).await;
        let joined = |welcome: Value| {
            assert_eq!(welcome.get("peer"), Some(&Value::from("bob")));
        };
        joined(password(&mut bob, "bob", "bob").await.expect("bob's password"));
        bob.join(&["/chat"]).await;
        let asked = challenge(&mut bob, "bob").await.expect("a challenge");
        bob.check_alive().await;
        let answered = bob.ask(DeviceKey::number(1).answer(&asked, "bob")).await;
        joined(answered.expect("bob's key").value());
        let shown = token(&mut bob, &issuer.sign(&claims("bob", BEGIN + 60))).await;
        joined(shown.expect("bob's token"));
        let members = bob.ask_about(Family::Context, "members", "/chat").await;
        let members = members.expect("still a member");
        assert_eq!(
            members.get("members").and_then(Value::as_list).map(<[_]>::len),
            Some(1)
        );
        let welcome = log_in(&mut bob, guest()).await.expect("a guest");
        assert_eq!(welcome.get("user"), Some(&Value::from("guest")));
        let error = bob.ask_about(Family::Context, "members", "/chat").await;
        assert_eq!(error.expect_err("nothing is inherited").code.word(), "denied");
        bob.ask_about(Family::Login, "logout", "/")
            .await
            .expect("good-bye");
        bob.check_closed().await;
    }
    broker.stop().await;
}

fn builders(broker: &std::sync::Arc<Broker>) -> [Builder; 3] {
    let address = broker.local_addr();
    let local = std::sync::Arc::clone(broker);
    [
        Client::builder(format!("tcp://{address}")),
        Client::builder(format!("bin://{address}")),
        Client::builder_local(move || local.connect_local()),
    ]
}

#[tokio::test]
async fn the_client_proves_a_key() {
    let broker = std::sync::Arc::new(
        lab::start_with(|config| {
            keys_for_bob(config);
            config.login.hub = "lab-3".to_owned();
        })
        .await,
    );
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("bob.key");
    fs::write(&file, DeviceKey::number(1).pem()).expect("written");
    let key = || Key::from_file(&file).expect("a key");
    for builder in builders(&broker) {
        let client = builder.user("bob").key(key()).hub_name("lab-3").connect().await;
        let client = client.expect("bob's key");
        assert_eq!(client.user(), "bob");
        client.authenticate_again(Proof::Key(key())).await.expect("again");
        let error = client
            .authenticate_again(Proof::Password("guess".to_owned()))
            .await;
        assert_eq!(
            error.expect_err("a guess").code().map(mom_client::Code::word),
            Some("bad-login")
        );
        client.lookup("/chat").await.expect("still bob");
        client.close().await;
    }
    for builder in builders(&broker) {
        let error = builder.user("bob").key(key()).hub_name("lab-4").connect().await;
        let error = error.expect_err("another hub than the one meant");
        assert!(error.to_string().contains("lab-4"), "{error}");
    }
    for builder in builders(&broker) {
        let error = builder.user("alice").key(key()).connect().await;
        assert_eq!(
            error.expect_err("not alice's").code().map(mom_client::Code::word),
            Some("bad-login")
        );
    }
}

/// A client that brings its new token in time goes on; one that does not is closed for good.
#[tokio::test]
async fn the_client_renews_a_token() {
    let issuer = Issuer::number(1);
    let clock = clock();
    let trusted = issuer.config();
    let broker = lab::start_at(clock.clone(), |config| config.login.jwt = Some(trusted)).await;
    let broker = std::sync::Arc::new(broker);
    for (round, builder) in builders(&broker).into_iter().enumerate() {
        let begin = BEGIN + 1000 * i64::try_from(round).expect("three rounds");
        let until = |seconds: i64| issuer.sign(&claims("bob", begin + seconds));
        let client = builder.token(until(60)).connect().await.expect("bob's token");
        let told = Time::from_micros((begin + 60) * 1_000_000).expect("a time");
        assert_eq!(client.welcome().get("until"), Some(&Value::Time(told)));
        let chat = client.channel("/chat").await.expect("allowed");
        let mut events = chat.events();
        clock.advance(Duration::from_secs(59));
        client
            .authenticate_again(Proof::Token(until(120)))
            .await
            .expect("in time");
        clock.advance(Duration::from_secs(60));
        chat.send("chat", "still here").await.expect("sent");
        let heard = timeout(PATIENCE, async {
            loop {
                match events.next().await {
                    Some(Event::Message(message)) => break message.value(),
                    Some(_) => {}
                    None => panic!("closed"),
                }
            }
        });
        assert_eq!(heard.await.expect("in time"), Value::from("still here"));
        clock.advance(Duration::from_secs(1));
        let mut state = client.state();
        let closed = timeout(
            PATIENCE,
            state.wait_for(|link| matches!(link, LinkState::Closed(_))),
        );
        match &*closed.await.expect("in time").expect("a state") {
            LinkState::Closed(Some(error)) => assert_eq!(error.code.word(), "revoked"),
            other => panic!("{other:?}"),
        }
        clock.advance(Duration::from_secs(1000 - 120));
    }
}

/// A token that has expired while the connection was lost is asked for anew; nobody who gives one is an attempt that failed.
#[tokio::test]
async fn a_token_is_asked_for_at_each_login() {
    let issuer = std::sync::Arc::new(Issuer::number(1));
    let clock = clock();
    let trusted = issuer.config();
    let broker = lab::start_at(clock.clone(), |config| config.login.jwt = Some(trusted)).await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    let asked = std::sync::Arc::new(std::sync::atomic::AtomicI64::new(0));
    let ask = {
        let (issuer, asked) = (std::sync::Arc::clone(&issuer), std::sync::Arc::clone(&asked));
        move || {
            let (issuer, asked) = (std::sync::Arc::clone(&issuer), std::sync::Arc::clone(&asked));
            async move {
                match asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) {
                    0 | 2 => Err("the issuer is away"),
                    1 => Ok(issuer.sign(&claims("bob", BEGIN + 60))),
                    _ => Ok(issuer.sign(&claims("bob", BEGIN + 1060))),
                }
            }
        }
    };
    let builder = || Client::builder(format!("bin://{}", network.address));
    let error = builder().token_from(ask.clone()).connect().await;
    let error = error.expect_err("no token").to_string();
    assert!(error.contains("the issuer is away"), "{error}");
    let client = builder().token_from(ask).connect().await.expect("bob's token");
    let mut state = client.state();
    clock.advance(Duration::from_secs(59));
    network.sever();
    clock.advance(Duration::from_secs(100));
    let back = async {
        state
            .wait_for(|link| !matches!(link, LinkState::Connected))
            .await
            .expect("a state");
        let back = state.wait_for(|link| matches!(link, LinkState::Connected | LinkState::Closed(_)));
        back.await.expect("a state").clone()
    };
    let back = timeout(PATIENCE, back).await.expect("in time");
    assert!(matches!(back, LinkState::Connected), "{back:?}");
    assert_eq!(asked.load(std::sync::atomic::Ordering::Relaxed), 4);
    client.lookup("/chat").await.expect("bob again");
    broker.stop().await;
}

/// From a key to a running device, as the help of `mom keygen` says it.
#[tokio::test(flavor = "multi_thread")]
async fn the_programs_make_and_use_keys_and_tokens() {
    tokio::task::spawn_blocking(keys_and_tokens)
        .await
        .expect("no panic");
}

fn keys_and_tokens() {
    let folder = TempDir::new().expect("a folder");
    let at = |name: &str| folder.path().join(name).display().to_string();
    let made = run("mom", &["keygen", "--json", "--out", &at("arm.key")], &[]);
    assert!(made.status.success(), "{}", text(&made.stderr));
    let private = fs::read_to_string(at("arm.key")).expect("written");
    let shown = text(&made.stdout) + &text(&made.stderr);
    let secret = private.lines().nth(1).expect("three lines");
    assert!(!shown.contains(secret), "the private key is shown: {shown}");
    let mode = std::os::unix::fs::MetadataExt::mode(&fs::metadata(at("arm.key")).expect("there"));
    assert_eq!(mode & 0o777, 0o600);
    let public = serde_json::from_str::<serde_json::Value>(&text(&made.stdout)).expect("JSON");
    let public = public["public"].as_str().expect("a key").to_owned();

    let again = run("mom", &["keygen", "--out", &at("arm.key")], &[]);
    assert_eq!(again.status.code(), Some(2), "{}", text(&again.stderr));
    assert!(text(&again.stderr).contains("--force"));
    assert_eq!(fs::read_to_string(at("arm.key")).expect("there"), private);

    let issuer = Issuer::number(1);
    let rules = fs::read_to_string(project().join("config/lab.toml")).expect("readable");
    let rules = rules.replace("lab-users.toml", "users.toml");
    let login = "[login]\nguests = true\n[login.jwt]\nissuer = \"https://id.example.org\"\naudience = \"mom\"\n\
         algorithms = [\"EdDSA\"]\nkey = \"issuer.pem\"\n";
    fs::write(at("mom.toml"), rules + login).expect("written");
    fs::write(at("issuer.pem"), issuer.public_pem()).expect("written");
    let users = format!("[[users]]\nname = \"arm\"\nkeys = [\"{public} arm\"]\ngroups = [\"device\"]\n");
    fs::write(at("users.toml"), users).expect("written");
    let (broker, address) = Running::broker(&folder.path().join("mom.toml"));
    let hub = format!("bin://{address}");
    let mom = |args: &[&str]| run("mom", &[&["--hub", &hub], args].concat(), &[]);

    let tree = mom(&["--user", "arm", "--key", &at("arm.key"), "tree"]);
    assert!(tree.status.success(), "{}", text(&tree.stderr));
    assert!(text(&tree.stdout).contains("robot"));

    let forced = run("mom", &["keygen", "--force", "--out", &at("arm.key")], &[]);
    assert!(forced.status.success(), "{}", text(&forced.stderr));
    let refused = mom(&["--user", "arm", "--key", &at("arm.key"), "tree"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        text(&refused.stderr).contains("does not know arm with this key"),
        "{}",
        text(&refused.stderr)
    );

    let forever =
        json!({"iss": "https://id.example.org", "aud": "mom", "sub": "arm", "exp": 99_999_999_999_i64});
    fs::write(at("token"), issuer.sign(&forever) + "\n").expect("written");
    let tree = mom(&["--jwt", &at("token"), "tree"]);
    assert!(tree.status.success(), "{}", text(&tree.stderr));

    let guest = mom(&["--guest", "tree"]);
    let told = text(&guest.stderr);
    assert!(!told.contains("not let you in"), "{told}");
    let both = mom(&["--guest", "--key", &at("arm.key"), "tree"]);
    assert_eq!(both.status.code(), Some(2));
    broker.signal("TERM");
    assert!(broker.wait().success());
}
