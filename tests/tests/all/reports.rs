//! What programs report of their errors by plain HTTP, without a login: who may read it, and how much it may be.

use mom_broker::{Broker, Config};
use mom_client::{Client, ClientError, Code, Event, Parcel, Report, Value, report as report_to};
use mom_tests::programs::{program, run, text};
use mom_tests::web::{Answer, ask};
use mom_tests::{lab, tls};
use tokio::process::Command;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

async fn post(broker: &Broker, headers: &[&str], body: &str) -> Answer {
    ask(broker.local_addr(), "POST /log", headers, body.as_bytes()).await
}

async fn log_in(broker: &Broker, user: &str) -> Client {
    let client = Client::builder(format!("bin://{}", broker.local_addr()));
    let client = client.user(user).password(user).connect().await;
    client.expect("a user of the lab")
}

async fn next_report(events: &mut mom_client::Events) -> Parcel {
    let next = async {
        loop {
            if let Event::Message(parcel) = events.next().await.expect("the channel stays") {
                return parcel;
            }
        }
    };
    timeout(mom_tests::raw::PATIENCE, next).await.expect("it comes")
}

const REPORT: &str = r#"{"text": "no way to the hub\u001b[2J", "level": "error", "code": "timed-out", "program": "mom", "version": "0.1.0"}"#;

#[tokio::test]
async fn a_report_reaches_who_may_read_it() {
    let broker = lab::start().await;
    assert_eq!(post(&broker, &[], REPORT).await.status, 204);
    // An operator reads what was kept, and what comes; it is the hub that says it.
    let carol = log_in(&broker, "carol").await;
    let log = carol.channel("/log").await.expect("operators may");
    let mut events = log.events();
    let kept = next_report(&mut events).await;
    let said = |parcel: &Parcel, key: &str| match parcel.value().get(key) {
        Some(Value::String(text)) => text.to_string(),
        other => panic!("{key}: {other:?} in {parcel:?}"),
    };
    assert_eq!(
        (kept.name(), kept.sender.as_deref()),
        ("log", Some(mom_client::HUB))
    );
    assert_eq!(said(&kept, "text"), "no way to the hub\\u{1b}[2J");
    assert_eq!(
        (said(&kept, "from"), said(&kept, "code")),
        ("127.0.0.1".into(), "timed-out".into())
    );
    assert!(
        kept.timestamp.is_some() && kept.extra.get(mom_client::HISTORY).is_some(),
        "{kept:?}"
    );
    let second = post(&broker, &[], r#"{"text": "second", "level": "info"}"#).await;
    assert_eq!(second.status, 204);
    let live = next_report(&mut events).await;
    assert_eq!(
        (said(&live, "text"), live.extra.get(mom_client::HISTORY)),
        ("second".into(), None)
    );
    // Others may not, nor speak there in the hub's stead.
    let alice = log_in(&broker, "alice").await;
    match alice.channel("/log").await {
        Err(ClientError::Refused(error)) => assert_eq!(error.code, Code::UNKNOWN_PATH),
        other => panic!("{other:?}"),
    }
    let own = log.message("log").content("made up").send_acknowledged().await;
    assert!(matches!(own, Err(ClientError::Refused(error)) if error.code == Code::DENIED));
    broker.stop().await;
}

#[tokio::test]
async fn reports_are_bounded_and_checked() {
    let broker = lab::start().await;
    let get = ask(broker.local_addr(), "GET /log", &[], b"").await;
    assert_eq!((get.status, get.header("allow")), (405, Some("POST")));
    let foreign = post(&broker, &["Origin: https://evil.example"], REPORT).await;
    assert_eq!(foreign.status, 403, "{}", foreign.text());
    let long = format!(r#"{{"text": "{}", "level": "error"}}"#, "x".repeat(5000));
    for (body, status) in [
        (&*long, 413),
        ("no JSON", 400),
        (r#"{"text": "x", "level": "loud"}"#, 400),
    ] {
        let answer = post(&broker, &[], body).await;
        assert_eq!(answer.status, status, "{}", answer.text());
        assert!(!answer.text().contains("loud"), "nobody is quoted");
    }
    // Those three have counted too.
    for _ in 3..10 {
        assert_eq!(post(&broker, &[], REPORT).await.status, 204);
    }
    let refused = post(&broker, &[], REPORT).await;
    assert_eq!(
        (refused.status, &refused.json()["code"]),
        (429, &"try-later".into())
    );
    let wait: u64 = refused
        .header("retry-after")
        .expect("when")
        .parse()
        .expect("seconds");
    assert!((1..=6).contains(&wait), "{wait}");
    broker.stop().await;

    let without = |config: &mut Config| config.web.log = None;
    let broker = lab::start_with(without).await;
    let answer = post(&broker, &[], REPORT).await;
    assert_eq!(answer.status, 404);
    assert!(answer.text().contains("[web] log"), "{}", answer.text());
    broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_shows_them() {
    let broker = lab::start().await;
    post(&broker, &[], REPORT).await;
    let built = spawn_blocking(|| program("mom")).await.expect("it is built");
    let hub = format!("bin://{}", broker.local_addr());
    let logs = async |user: &str, args: &[&str]| {
        let mut command = Command::new(&built);
        command.arg("logs").args(args).kill_on_drop(true);
        command
            .env("MOM_HUB", &hub)
            .env("MOM_USER", user)
            .env("MOM_PASSWORD", user);
        command.output().await.expect("it runs")
    };
    let shown = logs("carol", &[]).await;
    let line = text(&shown.stdout);
    assert!(
        line.ends_with(" error 127.0.0.1 mom 0.1.0: no way to the hub\\u{1b}[2J (timed-out)\n"),
        "{line}"
    );
    let shown = logs("carol", &["--json"]).await;
    let json: serde_json::Value = serde_json::from_slice(&shown.stdout).expect("one object");
    assert_eq!(
        (&json["level"], &json["from"]),
        (&"error".into(), &"127.0.0.1".into()),
        "{json}"
    );
    let refused = logs("alice", &[]).await;
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        text(&refused.stderr).contains("refused: read the reports in /log"),
        "{refused:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_channel_for_reports_is_one_of_the_file() {
    let checked = |table: &'static str| async move {
        let check = move || {
            let folder = tempfile::tempdir().expect("a folder");
            let file = folder.path().join("mom.toml").display().to_string();
            std::fs::write(&file, table).expect("written");
            run("mom-broker", &["check", &file], &[])
        };
        spawn_blocking(check).await.expect("it runs")
    };
    let missing = checked("[web]\nlog = \"/log\"\n").await;
    let told = text(&missing.stderr);
    assert_eq!(missing.status.code(), Some(1), "{told}");
    assert!(told.contains(":2: web.log: this file has no /log"), "{told}");
    let session = checked("[web]\nlog = \"/log\"\n[[contexts]]\npath = \"/log\"\nkind = \"session\"\n").await;
    assert!(text(&session.stderr).contains("/log is a session"), "{session:?}");
    let right =
        "[web]\nlog = \"/log\"\n[[contexts]]\npath = \"/log\"\nkind = \"channel\"\nkeep = { parcels = 10 }\n";
    let right = checked(right).await;
    assert_eq!(right.status.code(), Some(0), "{}", text(&right.stderr));
}

/// The hub's certificate is not to be trusted, so nobody logs in; the report says why all the same, if it is asked for.
#[tokio::test(flavor = "multi_thread")]
async fn a_program_that_cannot_connect_reports_why_if_it_is_asked_to() {
    let broker = lab::start_with(|config| config.tls = tls::of_hub()).await;
    let carol = log_in(&broker, "carol").await;
    let log = carol.channel("/log").await.expect("operators may");
    let mut events = log.events();
    let built = spawn_blocking(|| program("mom")).await.expect("it is built");
    let hub = format!("bins://{}?pin={}", broker.local_addr(), "0".repeat(64));
    let tree = async |args: &[&str]| {
        let mut command = Command::new(&built);
        command
            .args(["--hub", &hub, "tree"])
            .args(args)
            .kill_on_drop(true);
        command
            .env("MOM_USER", "alice")
            .env("MOM_PASSWORD", "secret-of-alice");
        command.output().await.expect("it runs")
    };
    assert_eq!(tree(&[]).await.status.code(), Some(1));
    assert_eq!(tree(&["--report"]).await.status.code(), Some(1));
    let report = next_report(&mut events).await;
    let said = report.value();
    let word = |key: &str| said.get(key).and_then(Value::as_str).unwrap_or_default();
    assert!(word("text").contains("certificate"), "{said:?}");
    assert_eq!(
        (word("program"), word("level"), word("from")),
        ("mom", "error", "127.0.0.1")
    );
    assert!(!format!("{said:?}").contains("secret"), "{said:?}");

    // From a program of one's own; the first run without --report has said nothing.
    let own = Report {
        text: "x".repeat(10_000),
        ..Report::default()
    }
    .by("mine", "1");
    report_to(&format!("bin://{}", broker.local_addr()), &own)
        .await
        .expect("it is taken");
    let second = next_report(&mut events).await;
    assert_eq!(second.value().get("program"), Some(&Value::from("mine")));
    let nobody = report_to("bin://127.0.0.1:9", &own).await;
    assert!(matches!(nobody, Err(ClientError::Connection(_))), "{nobody:?}");
    broker.stop().await;
}
