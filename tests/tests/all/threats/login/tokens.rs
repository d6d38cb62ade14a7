//! Threat 14: tokens that are forged, for another user, or expired.

use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use jsonwebtoken::{Algorithm, EncodingKey, Header, encode};
use mom_broker::{Config, JwtConfig, JwtUsers, KeyFile};
use mom_proto::codec::Form;
use mom_proto::{Family, Parcel, Time, Value};
use mom_tests::login::{AUDIENCE, Issuer, claims, password, token, unsigned, with};
use mom_tests::raw::Raw;
use serde_json::{Value as Json, json};

use super::{BEGIN, check_bad_login, check_outside, clock};
use crate::threats::World;

fn trusting(jwt: JwtConfig) -> impl FnOnce(&mut Config) {
    move |config| {
        config.login.jwt = Some(jwt);
        config.login.throttle.per_address.burst = 1000;
    }
}

fn right() -> Json {
    claims("bob", BEGIN + 60)
}

/// A token signed with the secret of these bytes.
fn with_secret(secret: &[u8]) -> String {
    encode(
        &Header::new(Algorithm::HS256),
        &right(),
        &EncodingKey::from_secret(secret),
    )
    .expect("claims are JSON")
}

/// What is not a token, or not the issuer's.
fn forged(issuer: &Issuer) -> Vec<(&'static str, String)> {
    let good = issuer.sign(&right());
    let (message, signature) = good.rsplit_once('.').expect("three parts");
    let (header, _) = message.split_once('.').expect("three parts");
    let promoted = unsigned(&json!({"alg": "EdDSA"}), &claims("carol", BEGIN + 60));
    let (_, promoted) = promoted.split_once('.').expect("two parts");
    let none = |word: &str| unsigned(&json!({"alg": word, "typ": "JWT"}), &right());
    let eve = Issuer::number(66);
    let jwk = json!({
        "kty": "OKP", "crv": "Ed25519", "x": URL_SAFE_NO_PAD.encode(eve.public_bytes()),
    });
    vec![
        ("none", format!("{}.", none("none"))),
        ("None", format!("{}.", none("None"))),
        ("NONE, with a signature", format!("{}.{signature}", none("NONE"))),
        (
            "without alg",
            format!("{}.{signature}", unsigned(&json!({"typ": "JWT"}), &right())),
        ),
        ("without its signature", format!("{message}.")),
        ("in two parts", message.to_owned()),
        ("in four parts", format!("{good}.{signature}")),
        ("another's claims", format!("{header}.{promoted}.{signature}")),
        ("signed by another", eve.sign(&right())),
        (
            "with the key in its header",
            eve.sign_with_header(&json!({"alg": "EdDSA", "jwk": jwk}), &right()),
        ),
        (
            "with what must be understood",
            issuer.sign_with_header(&json!({"alg": "EdDSA", "crit": ["exp"]}), &right()),
        ),
        (
            "by another algorithm's name",
            issuer.sign_with_header(&json!({"alg": "ES256"}), &right()),
        ),
        (
            "HS256 with the public key",
            with_secret(issuer.public_pem().as_bytes()),
        ),
        (
            "HS256 with its text",
            with_secret(issuer.public_pem().trim_end().as_bytes()),
        ),
        ("HS256 with its bytes", with_secret(&issuer.public_bytes())),
        ("HS256 with nothing", with_secret(b"")),
        ("nothing", String::new()),
        ("dots", "..".to_owned()),
        ("letters", "a.b.c".to_owned()),
        ("no base64", "§.§.§".to_owned()),
        (
            "no JSON",
            format!("{0}.{0}.{0}", URL_SAFE_NO_PAD.encode("no JSON")),
        ),
        ("long", format!("{}.{}", "a".repeat(6000), "b".repeat(6000))),
        (
            "deep",
            format!(
                "{header}.{}.{signature}",
                URL_SAFE_NO_PAD.encode("[".repeat(5000))
            ),
        ),
    ]
}

/// What the issuer signed, but not for this, here and now; with the word that says so.
fn misplaced(issuer: &Issuer) -> Vec<(&'static str, String, &'static str)> {
    let changed = |key: &str, value: Json| issuer.sign(&with(right(), key, value));
    vec![
        (
            "another audience",
            changed("aud", json!("other")),
            "another audience",
        ),
        (
            "other audiences",
            changed("aud", json!(["a", "b"])),
            "another audience",
        ),
        ("no audience", changed("aud", Json::Null), "aud"),
        (
            "another issuer",
            changed("iss", json!("https://evil.example")),
            "another issuer",
        ),
        ("no issuer", changed("iss", Json::Null), "iss"),
        ("no end", changed("exp", Json::Null), "exp"),
        ("an end in words", changed("exp", json!("tomorrow")), ""),
        ("an end as text", changed("exp", json!("1795255260")), ""),
        ("an end before all time", changed("exp", json!(-1)), ""),
        ("over", changed("exp", json!(BEGIN)), "expired"),
        ("long over", changed("exp", json!(0)), "expired"),
        ("not yet", changed("nbf", json!(BEGIN + 1)), "not valid yet"),
        ("a beginning in words", changed("nbf", json!("yesterday")), ""),
        ("nobody", changed("sub", Json::Null), "sub"),
        ("a number", changed("sub", json!(7)), ""),
        (
            "an unknown user",
            changed("sub", json!("mallory")),
            "does not exist here",
        ),
        ("the hub", changed("sub", json!("hub")), "not a name"),
        ("a pattern", changed("sub", json!("*")), "not a name"),
    ]
}

#[tokio::test]
async fn threat_14_forged_tokens() {
    let issuer = Issuer::number(1);
    let world = World::start_at(clock(), trusting(issuer.config())).await;
    let connect = || Raw::connect(world.address(), Form::Binary);
    for (what, forged) in forged(&issuer) {
        let mut eve = connect().await;
        let text = check_bad_login(token(&mut eve, &forged).await, what);
        assert!(text.contains("not a token of the issuer"), "{what}: {text}");
        check_outside(&mut eve, what).await;
    }
    for (what, misplaced, words) in misplaced(&issuer) {
        let mut eve = connect().await;
        let text = check_bad_login(token(&mut eve, &misplaced).await, what);
        assert!(text.contains(words), "{what}: {text}");
        check_outside(&mut eve, what).await;
    }
    for (what, good) in [
        ("right", right()),
        (
            "one of several audiences",
            with(right(), "aud", json!(["a", AUDIENCE])),
        ),
        ("just begun", with(right(), "nbf", json!(BEGIN))),
        ("to the fraction", with(right(), "exp", json!(BEGIN as f64 + 0.5))),
        ("claims that are not asked for", with(right(), "level", json!(99))),
    ] {
        let mut bob = connect().await;
        let welcome = token(&mut bob, &issuer.sign(&good)).await;
        let welcome = welcome.unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!(welcome.get("user"), Some(&Value::from("bob")), "{what}");
        assert_eq!(
            welcome.get("level"),
            Some(&Value::Int(1)),
            "{what}: from the file"
        );
    }
    world.end().await;
}

/// A hub that shares a secret takes no other algorithm either.
#[tokio::test]
async fn threat_14_tokens_by_a_shared_secret() {
    let secret = b"a secret of more than thirty-two bytes";
    let issuer = Issuer::number(1);
    let jwt = JwtConfig {
        algorithms: vec!["HS256".to_owned()],
        key: KeyFile::from_text(String::from_utf8_lossy(secret).into_owned() + "\n"),
        ..issuer.config()
    };
    let world = World::start_at(clock(), trusting(jwt)).await;
    for (what, forged) in forged(&issuer) {
        let mut eve = Raw::connect(world.address(), Form::Xml).await;
        check_bad_login(token(&mut eve, &forged).await, what);
    }
    let mut bob = Raw::connect(world.address(), Form::Xml).await;
    check_bad_login(token(&mut bob, &issuer.sign(&right())).await, "another algorithm");
    let longer = encode(
        &Header::new(Algorithm::HS512),
        &right(),
        &EncodingKey::from_secret(secret),
    );
    check_bad_login(token(&mut bob, &longer.expect("JSON")).await, "not in the list");
    token(&mut bob, &with_secret(secret)).await.expect("bob");
    world.end().await;
}

/// A user named by a token gets no more than the configuration gives away, and nobody's name.
#[tokio::test]
async fn threat_14_rights_from_claims() {
    let issuer = Issuer::number(1);
    let jwt = JwtConfig {
        users: JwtUsers::FromClaims,
        max_level: 3,
        ..issuer.config()
    };
    let world = World::start_at(clock(), |config| {
        trusting(jwt)(config);
        config.login.guests = true;
    })
    .await;
    let dora = |key: &str, value: Json| with(claims("dora", BEGIN + 60), key, value);
    for (what, refused) in [
        ("a user of the file", claims("carol", BEGIN + 60)),
        ("the guests", claims("guest", BEGIN + 60)),
        ("the hub", claims("hub", BEGIN + 60)),
        ("groups that are no names", dora("groups", json!(["a/b"]))),
        ("groups that are no list", dora("groups", json!("operator"))),
        ("a level that is none", dora("level", json!("9"))),
        (
            "too many groups",
            dora(
                "groups",
                json!((0..65).map(|n| n.to_string()).collect::<Vec<_>>()),
            ),
        ),
    ] {
        let mut eve = Raw::connect(world.address(), Form::Binary).await;
        check_bad_login(token(&mut eve, &issuer.sign(&refused)).await, what);
    }
    for (level, given) in [
        (json!(2), 2),
        (json!(3), 3),
        (json!(4), 3),
        (json!(i64::MAX), 3),
        (json!(-5), -5),
        (json!(i64::MIN), i64::from(i32::MIN)),
        (Json::Null, 0),
    ] {
        let mut peer = Raw::connect(world.address(), Form::Binary).await;
        let claims = with(dora("groups", json!(["staff"])), "level", level);
        let welcome = token(&mut peer, &issuer.sign(&claims)).await.expect("dora");
        assert_eq!(welcome.get("user"), Some(&Value::from("dora")));
        assert_eq!(welcome.get("level"), Some(&Value::Int(given)));
        assert_eq!(
            welcome.get("groups"),
            Some(&Value::from(vec![Value::from("staff")]))
        );
    }
    world.end().await;
}

/// A token ends with its connection, unless its bearer comes with a new one before; and what it owned is free.
#[tokio::test]
async fn threat_14_a_token_expires_on_a_live_connection() {
    let issuer = Issuer::number(1);
    let clock = clock();
    let jwt = JwtConfig {
        leeway: 500,
        ..issuer.config()
    };
    let mut world = World::start_at(clock.clone(), trusting(jwt)).await;
    for form in Form::ALL {
        let now = clock.wall().micros() / 1_000_000;
        let short = issuer.sign(&claims("bob", now + 60));
        let mut idle = Raw::connect(world.address(), form).await;
        let welcome = token(&mut idle, &short).await.expect("bob");
        let until = Time::from_micros((now + 60) * 1_000_000 + 500_000).expect("a time");
        assert_eq!(welcome.get("until"), Some(&Value::Time(until)));
        let mut busy = Raw::connect(world.address(), form).await;
        token(&mut busy, &short).await.expect("bob");
        let mut renewed = Raw::connect(world.address(), form).await;
        token(&mut renewed, &short).await.expect("bob");
        let mut other = Raw::connect(world.address(), form).await;
        token(&mut other, &short).await.expect("bob");
        clock.advance(Duration::from_millis(60_499));
        for raw in [&mut idle, &mut busy, &mut renewed, &mut other] {
            raw.check_alive().await;
        }
        // A new token in time, or any other proof, and the old one's end is of no account.
        let longer = issuer.sign(&claims("bob", now + 3600));
        let welcome = token(&mut renewed, &longer).await.expect("bob again");
        assert_ne!(welcome.get("until"), Some(&Value::Time(until)));
        password(&mut other, "bob", "bob").await.expect("bob again");
        check_bad_login(token(&mut busy, &issuer.sign(&claims("bob", now))).await, "over");
        clock.advance(Duration::from_millis(1));
        busy.post(Parcel::new(Family::Time, "ping")).await;
        for raw in [&mut idle, &mut busy] {
            // Not even the ping is answered any more.
            let last = raw.next().await.expect("the reason");
            assert!(last.is(Family::Error, "revoked"), "{last:?}");
            raw.check_closed().await;
        }
        let mut eve = Raw::connect(world.address(), form).await;
        check_bad_login(token(&mut eve, &short).await, "over");
        for raw in [&mut renewed, &mut other] {
            raw.check_alive().await;
        }
        let members = world.witness.ask_about(Family::Context, "members", "/").await;
        let members = members.expect("allowed");
        let members = members.get("members").and_then(Value::as_list).expect("a list");
        let bobs = members
            .iter()
            .filter(|member| member.get("user") == Some(&Value::from("bob")));
        assert_eq!(bobs.count(), 2, "{members:?}");
        // To a whole second again.
        clock.advance(Duration::from_millis(3_600_500));
        let last = renewed.next().await.expect("the reason");
        assert!(last.is(Family::Error, "revoked"), "{last:?}");
        other.check_alive().await;
    }
    world.end().await;
}
