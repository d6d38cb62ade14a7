//! A machine whose clock was wrong when the broker started, and is set later.

use std::time::Duration;

use mom_broker::Clock;
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Time, Value};
use mom_tests::audit::AuditLog;
use mom_tests::canary::Canary;
use mom_tests::lab;
use mom_tests::login::{Issuer, claims, token};
use mom_tests::raw::{Raw, at};

/// 2026-11-21T10:00:00Z in seconds: the true time.
const NOW: i64 = 1_795_255_200;
const HOUR: i64 = 3600;
const SECOND: i64 = 1_000_000;

/// A clock that woke up in 1970, as that of a board without a battery does.
fn woken() -> Clock {
    Clock::manual(Time::from_micros(0).expect("1970"))
}

/// An expired token of an issuer lets nobody in once the clock is set, nor does it keep anybody in.
#[tokio::test]
async fn an_expired_jwt_ends_when_the_clock_is_set() {
    let issuer = Issuer::number(1);
    let (clock, audit) = (woken(), AuditLog::new());
    let broker = lab::start_at(clock.clone(), |config| {
        config.login.jwt = Some(issuer.config());
        config.audit.path = Some(audit.path());
    })
    .await;
    let address = broker.local_addr();
    let mut canary = Canary::start(address).await;
    let expired = issuer.sign(&claims("bob", NOW - HOUR));
    let valid = issuer.sign(&claims("bob", NOW + HOUR));
    let mut stays = Raw::connect(address, Form::Xml).await;
    token(&mut stays, &valid).await.expect("not over for years");
    let mut goes = Raw::connect(address, Form::Binary).await;
    token(&mut goes, &expired)
        .await
        .expect("not over by a wrong clock");

    clock.step(NOW * SECOND);
    let last = goes.next().await.expect("the reason");
    assert!(last.is(Family::Error, "revoked"), "{last:?}");
    let mut again = Raw::connect(address, Form::Binary).await;
    let refused = token(&mut again, &expired).await.expect_err("over for an hour");
    assert_eq!(refused.code.word(), "bad-login", "{refused}");
    stays.check_alive().await;
    // Set back, an hour is an hour all the same.
    clock.step(-NOW * SECOND / 2);
    stays.check_alive().await;
    canary.check().await;
    canary.stop().await;
    broker.stop().await;
    let text = std::fs::read_to_string(audit.path()).expect("an audit log");
    let line = text.lines().find(|line| line.contains("clock-stepped"));
    let line = line.expect("a step is a fact");
    assert!(line.contains("\"at\":\"2026-11-21T10:00:00"), "{line}");
    assert!(line.contains(&format!("+{NOW}.000 s")), "{line}");
}

/// A calendar goes by the new time at once; a lease, and a grant that was given until some time, last as long as they
/// were given for.
#[tokio::test]
async fn a_calendar_follows_the_clock_and_a_grant_lasts() {
    let clock = woken();
    let broker = lab::start_at(clock.clone(), |_| {}).await;
    let mut carol = Raw::login(broker.local_addr(), Form::Xml, "carol").await;
    let slot = Map::new()
        .with("from", "2026-11-21T10:00:00Z")
        .with("to", "2026-11-21T11:00:00Z")
        .with("users", vec![Value::from("carol")]);
    let manager = Map::new()
        .with("kind", "schedule")
        .with("free", "deny")
        .with("slots", vec![Value::from(slot)]);
    let spec = Map::new().with("kind", "token").with("manager", manager);
    let create = Parcel::new(Family::Context, "create")
        .context(at("/key"))
        .content(spec);
    carol.ask(create).await.expect("an administrator may");
    carol.join(&["/key"]).await;
    let early = carol.ask_about(Family::Token, "grab", "/key").await;
    let early = early.expect_err("not in 1970");
    assert_eq!(early.code.word(), "denied", "{early}");

    clock.step((NOW + HOUR / 2) * SECOND);
    // The hub hears of it from a task of its own.
    let until = tokio::time::Instant::now() + mom_tests::raw::PATIENCE;
    while carol.ask_about(Family::Token, "grab", "/key").await.is_err() {
        assert!(
            tokio::time::Instant::now() < until,
            "the calendar does not follow"
        );
    }
    clock.step(HOUR * SECOND);
    carol.check_alive().await;
    carol
        .ask_about(Family::Token, "renew", "/key")
        .await
        .expect("half an hour was given");
    clock.advance(Duration::from_secs(HOUR.unsigned_abs()));
    let lost = carol.next_of(Family::Event, "released").await;
    assert_eq!(
        lost.value().get("reason"),
        Some(&Value::from("expired")),
        "{lost:?}"
    );
    broker.stop().await;
}
