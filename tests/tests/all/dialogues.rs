//! The dialogues of `tests/dialogues`, over every carrier.
#![expect(clippy::unwrap_used, reason = "a test that fails panics")]

use std::path::PathBuf;

use mom_net::Door;
use mom_proto::codec::Form;
use mom_tests::dialogue::{CLIENTS, Carrier, Dialogue};
use tokio::task::JoinSet;

/// Dialogues that are played at once.
const SIDE_BY_SIDE: usize = 3;

fn files() -> Vec<PathBuf> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/dialogues");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "txt"))
        .collect();
    files.sort();
    files
}

/// Runs all dialogues, or those whose name contains `DIALOGUE`, and tells of all that fail.
fn check(carrier: Carrier) {
    let chosen = std::env::var("DIALOGUE").unwrap_or_default();
    check_some(carrier, &[&chosen]);
}

/// Runs those whose name contains one of these, and tells of all that fail.
fn check_some(carrier: Carrier, chosen: &[&str]) {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    let named = files().into_iter().map(|file| {
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        (name, file)
    });
    let mut waiting = named.filter(|(name, _)| chosen.iter().any(|part| name.contains(part)));
    let failures = runtime.block_on(async {
        let (mut running, mut failures) = (JoinSet::new(), Vec::new());
        // They wait for their hubs more than they compute, and each has one of its own.
        for dialogue in waiting.by_ref().take(SIDE_BY_SIDE) {
            begin(&mut running, dialogue, carrier);
        }
        while let Some(ended) = running.join_next().await {
            failures.extend(ended.unwrap());
            if let Some(dialogue) = waiting.next() {
                begin(&mut running, dialogue, carrier);
            }
        }
        failures
    });
    assert!(failures.is_empty(), "\n{}", failures.join("\n"));
}

/// Begins to play a dialogue; gives how it fails, if it does.
fn begin(running: &mut JoinSet<Option<String>>, (name, file): (String, PathBuf), carrier: Carrier) {
    let text = std::fs::read_to_string(&file).unwrap();
    let _handle = running.spawn(async move {
        let played = match Dialogue::parse(&text) {
            Ok(dialogue) => dialogue.run(carrier).await,
            Err(error) => Err(error),
        };
        played.err().map(|error| format!("{name}, {carrier}, {error}"))
    });
}

#[test]
fn over_tcp() {
    for form in Form::ALL {
        check(Carrier::Remote(form, Door::Stream, false));
    }
}

#[test]
fn over_tls() {
    for form in Form::ALL {
        check(Carrier::Remote(form, Door::Stream, true));
    }
}

/// Without TLS and with it.
fn check_both(form: Form, door: Door) {
    check(Carrier::Remote(form, door, false));
    check(Carrier::Remote(form, door, true));
}

#[test]
fn over_websocket_binary() {
    check_both(Form::Binary, Door::WebSocket);
}

#[test]
fn over_websocket_json() {
    check_both(Form::Json, Door::WebSocket);
}

#[test]
fn through_a_tunnel() {
    for form in Form::ALL {
        check_both(form, Door::Tunnel { polled: false });
    }
}

#[test]
fn through_a_polled_tunnel() {
    for form in Form::ALL {
        check_both(form, Door::Tunnel { polled: true });
    }
}

#[test]
fn in_process() {
    check(Carrier::Local);
}

#[test]
fn mixed() {
    check(Carrier::Mixed);
}

/// All of them through one door, and through the others those in which parcels of every kind are said.
#[test]
fn through_clients_of_other_languages() {
    for client in CLIENTS {
        for (place, (door, tls)) in client.doors.iter().enumerate() {
            let carrier = Carrier::Program(client, *door, *tls);
            match place {
                0 => check(carrier),
                _ => check_some(carrier, &["values", "slots", "safe-state"]),
            }
        }
    }
}

#[test]
fn there_are_dialogues() {
    assert!(files().len() >= 18, "{}", files().len());
}

/// What is written and does not happen fails, with the line and all that was said.
#[test]
fn a_dialogue_that_goes_otherwise_fails() {
    for (text, line, words) in [
        (
            "connect alice\nalice: lookup /chat\nalice< ok kind=token\n",
            3,
            "kind is channel, not token",
        ),
        (
            "connect alice\nalice: lookup /chat\nalice< error denied\n",
            3,
            "it is another parcel",
        ),
        ("connect alice\nalice: lookup /chat\n", 2, "it is another parcel"),
        (
            "connect alice\nalice: lookup /chat\nalice< nothing\n",
            3,
            "it is another parcel",
        ),
        (
            "connect alice\nalice: lookup /chat\nalice< closed\n",
            3,
            "heard instead",
        ),
        ("connect alice\nbob: lookup /chat\n", 2, "connect bob"),
        ("connect alice as ally\n", 1, "peer is alice, not ally"),
    ] {
        let dialogue = Dialogue::parse(text).unwrap();
        let runtime = tokio::runtime::Runtime::new().unwrap();
        let error = runtime
            .block_on(dialogue.run(Carrier::Local))
            .expect_err(text)
            .to_string();
        assert!(error.starts_with(&format!("line {line}:")), "{error}");
        assert!(error.contains(words), "{error}");
    }
}
