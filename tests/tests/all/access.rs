//! Who may, who did, and what another configuration would do: asked by peers over real sockets, and by the command line.

use std::process::Command as Program;
use std::time::Duration;

use mom_client::{Client, ClientError, Code, Family, Map, Parcel, Path, Value, WireError};
use mom_tests::programs::{PATIENCE, program, text};
use mom_tests::service::{Home, Service};
use serde_json::Value as Json;
use tokio::process::Command;
use tokio::time::timeout;

const TOKEN: &str = "/robot/token";

/// Only carol may know of the vault.
const VAULT: &str = r#"
[[contexts]]
path = "/vault"
kind = "session"
manager = { kind = "roles", rules = [{ users = ["carol"], allow = ["*"] }] }

[[contexts]]
path = "/vault/key"
kind = "token"

[managers.readers]
kind = "roles"

[[managers.readers.rules]]
name = "bob reads all"
users = ["bob"]
allow = ["lookup", "join", "grab", "audit", "explain"]

[[managers.readers.rules]]
name = "carol may all"
users = ["carol"]
allow = ["*"]
"#;

const FILES: &str = "[audit]\npath = \"audit.jsonl\"\n[record]\npath = \"control.jsonl\"\n";

async fn log_in(service: &Service, user: &str) -> Client {
    let builder = Client::builder(format!("bin://{}", service.address()));
    let client = builder.user(user).password(user).connect().await;
    client.expect("a user of the lab")
}

async fn ask(client: &Client, verb: &str, path: &str, content: Map) -> Result<Map, WireError> {
    let parcel = Parcel::new(Family::Context, verb)
        .context(Path::parse(path).expect("a path"))
        .content(content);
    match client.request(parcel).await {
        Ok(reply) => Ok(reply.value().as_map().cloned().unwrap_or_default()),
        Err(ClientError::Refused(error)) => Err(error),
        Err(other) => panic!("{verb} {path}: {other}"),
    }
}

async fn grab(client: &Client) -> Result<Map, WireError> {
    // Its session first, once.
    for path in ["/robot", TOKEN] {
        let join = Parcel::new(Family::Context, "join").context(Path::parse(path).expect("a path"));
        client.request(join).await.expect("people may join");
    }
    let grab = Parcel::new(Family::Token, "grab").context(Path::parse(TOKEN).expect("a path"));
    match client.request(grab).await {
        Ok(reply) => Ok(reply.value().as_map().cloned().unwrap_or_default()),
        Err(ClientError::Refused(error)) => Err(error),
        Err(other) => panic!("grab: {other}"),
    }
}

fn word<'a>(map: &'a Map, key: &str) -> &'a str {
    map.get(key).and_then(Value::as_str).unwrap_or_default()
}

fn maps<'a>(map: &'a Map, key: &str) -> Vec<&'a Map> {
    let list = map.get(key).and_then(Value::as_list).unwrap_or_default();
    list.iter().filter_map(Value::as_map).collect()
}

fn with(key: &str, value: impl Into<Value>) -> Map {
    Map::new().with(key, value)
}

/// Alice has the token, bob is refused it, carol takes it.
async fn contention(service: &Service) -> [Client; 3] {
    let [alice, bob, carol] = [
        log_in(service, "alice").await,
        log_in(service, "bob").await,
        log_in(service, "carol").await,
    ];
    grab(&alice).await.expect("it is free");
    let held = grab(&bob).await.expect_err("alice has it");
    assert_eq!(held.code, Code::HELD);
    grab(&carol).await.expect("a higher level takes it");
    [alice, bob, carol]
}

#[tokio::test]
async fn who_had_the_token_is_told_to_who_may_ask() {
    for files in [FILES, ""] {
        let home = Home::new(files);
        let service = home.start().await;
        let [alice, _bob, carol] = contention(&service).await;
        let refused = ask(&alice, "audit", TOKEN, Map::new())
            .await
            .expect_err("level 1");
        assert_eq!(
            (refused.code.clone(), refused.get("rule")),
            (Code::DENIED, Some(&"lab".into()))
        );
        let told = ask(&carol, "audit", TOKEN, Map::new())
            .await
            .expect("an operator");
        let source = if files.is_empty() { "memory" } else { "file" };
        assert_eq!(word(&told, "source"), source);
        let facts = maps(&told, "facts");
        let shown: Vec<String> = facts
            .iter()
            .map(|fact| {
                format!(
                    "{} {} {}",
                    word(fact, "what"),
                    word(fact, "peer"),
                    word(fact, "code")
                )
            })
            .collect();
        let expected = [
            "refused alice denied",
            "granted carol ",
            "lost alice ",
            "refused bob held",
            "granted alice ",
        ];
        assert_eq!(shown, expected);
        assert!(matches!(facts[0].get("at"), Some(Value::Time(_))), "{facts:?}");
        check_pages(&carol, expected.len()).await;
    }
}

/// Facts of the contention that are chosen, page by page, and those after the newest.
async fn check_pages(carol: &Client, all: usize) {
    let content = with("what", vec![Value::from("refused")]).with("user", "bob");
    let told = ask(carol, "audit", "/", content).await.expect("an operator");
    assert_eq!(maps(&told, "facts").len(), 1);
    let (mut before, mut pages) = (None, Vec::new());
    loop {
        let mut content = with("most", 2);
        if let Some(before) = before {
            content.set("before", before);
        }
        let told = ask(carol, "audit", TOKEN, content).await.expect("an operator");
        pages.extend(maps(&told, "facts").into_iter().cloned());
        before = told.get("next").and_then(Value::as_int);
        if before.is_none() {
            break;
        }
    }
    assert_eq!(pages.len(), all);
    let latest = told
        .get("latest")
        .and_then(Value::as_int)
        .expect("there are facts");
    let none = ask(carol, "audit", "/", with("after", latest))
        .await
        .expect("an operator");
    assert!(
        maps(&none, "facts").is_empty() && !none.contains_key("more"),
        "{none:?}"
    );
    for (content, slot) in [
        (with("most", 0), "content/most"),
        (with("since", "yesterday"), "content/since"),
    ] {
        let wrong = ask(carol, "audit", "/", content).await.expect_err("wrong");
        assert_eq!(
            (wrong.code.clone(), wrong.get("slot")),
            (Code::BAD_CONTENT, Some(&slot.into()))
        );
    }
}

#[tokio::test]
async fn what_is_hidden_stays_so() {
    let home = Home::new(VAULT);
    home.write_config(&home.config().replace("root = \"lab\"", "root = \"readers\""));
    let service = home.start().await;
    let (bob, carol) = (log_in(&service, "bob").await, log_in(&service, "carol").await);
    for path in ["/vault", "/vault/key"] {
        let join = Parcel::new(Family::Context, "join").context(Path::parse(path).expect("a path"));
        carol.request(join).await.expect("carol may");
    }
    let grab = Parcel::new(Family::Token, "grab").context(Path::parse("/vault/key").expect("a path"));
    carol.request(grab).await.expect("carol may");
    let of = |told: &Map| -> Vec<String> {
        let facts = maps(told, "facts");
        facts
            .iter()
            .map(|fact| word(fact, "context").to_owned())
            .collect()
    };
    let told = ask(&bob, "audit", "/", Map::new()).await.expect("bob may read");
    assert!(
        !of(&told).iter().any(|context| context.starts_with("/vault")),
        "{told:?}"
    );
    let told = ask(&carol, "audit", "/", Map::new()).await.expect("carol may");
    assert!(
        of(&told).iter().any(|context| context == "/vault/key"),
        "{told:?}"
    );
    for verb in ["audit", "explain"] {
        let hidden = ask(&bob, verb, "/vault/key", Map::new())
            .await
            .expect_err("hidden");
        assert_eq!(hidden.code, Code::UNKNOWN_PATH, "{verb}");
    }
}

/// The line of a rule is that which `mom-broker explain` names.
#[tokio::test]
async fn who_may_what_is_explained_by_line() {
    let home = Home::new("");
    let service = home.start().await;
    let [alice, bob, carol] = contention(&service).await;
    for (user, verb, path, message) in [
        ("bob", "grab", "/chat", None),
        ("bob", "break", TOKEN, None),
        ("bob", "join", TOKEN, None),
        ("alice", "send", "/robot/arm", Some("state")),
        ("dora", "stats", "/", None),
    ] {
        let mut content = with("user", user).with("verb", verb);
        let config = home.file("mom.toml").display().to_string();
        let mut command = Program::new(program("mom-broker"));
        command.args([
            "explain", "--json", "--config", &config, "--user", user, "--verb", verb,
        ]);
        command.args(["--context", path]);
        if let Some(message) = message {
            content.set("message", message);
            command.args(["--message", message]);
        }
        let local = command.output().expect("it runs");
        let Ok(local) = serde_json::from_slice::<Json>(&local.stdout) else {
            // A user that neither knows.
            let unknown = ask(&carol, "explain", path, content).await.expect_err("nobody");
            assert_eq!((user, unknown.code), ("dora", Code::UNKNOWN_PEER));
            continue;
        };
        let told = ask(&carol, "explain", path, content).await.expect("an operator");
        assert_eq!(
            word(&told, "rule"),
            local["rule"].as_str().unwrap_or_default(),
            "{verb}"
        );
        assert_eq!(
            told.get("line").and_then(Value::as_int),
            local["place"]["line"].as_i64(),
            "{verb}"
        );
        // What the hub itself says stands in no file.
        let file = if local["place"].is_null() { "" } else { "mom.toml" };
        assert_eq!(
            (word(&told, "file"), word(&told, "answer")),
            (file, local["answer"].as_str().unwrap_or_default())
        );
    }
    drop(alice);
    check_now(&bob, &carol).await;
}

/// What holds as it is now: carol has the token.
async fn check_now(bob: &Client, carol: &Client) {
    let told = ask(bob, "explain", TOKEN, with("verb", "grab"))
        .await
        .expect("about itself");
    assert_eq!((word(&told, "code"), word(&told, "owner")), ("held", "carol"));
    assert!(
        told.get("retry-after")
            .and_then(Value::as_int)
            .is_some_and(|ms| ms > 0),
        "{told:?}"
    );
    let refused = ask(bob, "explain", TOKEN, with("user", "alice"))
        .await
        .expect_err("level 1");
    assert_eq!(refused.code, Code::DENIED);
    // A table.
    let users = vec![Value::from("alice"), Value::from("bob")];
    let told = ask(carol, "explain", "/robot/arm", with("users", users))
        .await
        .expect("an operator");
    let users = maps(&told, "users");
    assert_eq!((users.len(), word(&told, "kind")), (2, "channel"));
    let answer = |key: &str, of: &str| {
        users[1]
            .get(key)
            .and_then(|map| map.get(of))
            .and_then(Value::as_map)
    };
    let command = answer("messages", "command").expect("a guarded message");
    assert_eq!(
        (word(command, "guard"), word(command, "guard-owner")),
        (TOKEN, "carol")
    );
    assert_eq!(command.get("allow"), Some(&true.into()));
    assert_eq!(
        answer("messages", "state").and_then(|state| state.get("allow")),
        Some(&false.into())
    );
    assert_eq!(
        answer("verbs", "audit").map(|audit| word(audit, "rule")),
        Some("lab")
    );
}

#[tokio::test]
async fn another_configuration_is_tried_on_what_was_recorded() {
    let home = Home::new(FILES);
    let service = home.start().await;
    let [alice, _bob, carol] = contention(&service).await;
    let running = ask(&carol, "what-if", "/", Map::new())
        .await
        .expect("an operator");
    assert_eq!(word(&running, "config"), home.config());
    assert_eq!(
        (word(&running, "file"), running.get("recorded")),
        ("mom.toml", Some(&true.into()))
    );
    let text = word(&running, "config").to_owned();
    let same = ask(&carol, "what-if", "/", with("config", text.as_str()))
        .await
        .expect("an operator");
    assert_eq!(same.get("differ").and_then(Value::as_int), Some(0), "{same:?}");
    let rule = "[[managers.lab.rules]]\nname = \"alice watches\"\nusers = [\"alice\"]\ndeny = [\"grab\"]\n";
    let first = text.find("[[managers.lab.rules]]").expect("rules");
    let changed = [&text[..first], rule, &text[first..]].concat();
    let line = changed[..first].lines().count() as i64 + 1;
    let told = ask(&carol, "what-if", "/", with("config", changed))
        .await
        .expect("an operator");
    let differences = maps(&told, "differences");
    let grabs: Vec<_> = differences
        .iter()
        .filter(|difference| word(difference, "peer") == "alice" && word(difference, "request") == "grab")
        .collect();
    assert_eq!(grabs.len(), 1, "{told:?}");
    assert_eq!(word(grabs[0], "rule"), "lab/alice watches");
    assert_eq!(grabs[0].get("line").and_then(Value::as_int), Some(line));
    assert!(word(grabs[0], "new").starts_with("refused denied"), "{grabs:?}");
    check_faults(&carol, &text).await;
    let refused = ask(&alice, "what-if", "/", Map::new())
        .await
        .expect_err("level 1");
    assert_eq!(refused.code, Code::DENIED);
}

#[tokio::test]
async fn where_nothing_is_recorded_it_says_how() {
    let home = Home::new("");
    let service = home.start().await;
    let carol = log_in(&service, "carol").await;
    let running = ask(&carol, "what-if", "/", Map::new())
        .await
        .expect("an operator");
    let text = with("config", word(&running, "config"));
    let error = ask(&carol, "what-if", "/", text)
        .await
        .expect_err("nothing to decide");
    assert_eq!(error.code, Code::NOT_RECORDED);
    assert!(error.text.contains("[record]"), "{error}");
}

/// What is wrong with a configuration is told by line, and no file that it names is read.
async fn check_faults(carol: &Client, text: &str) {
    for (wrong, line, words) in [
        (
            format!("{text}\n[managers.lab\n"),
            text.lines().count() as i64 + 2,
            "",
        ),
        (
            text.replacen("kind = \"roles\"", "kind = \"rolls\"", 1),
            line_of(text, "kind = \"roles\""),
            "roles",
        ),
        (
            text.replace("lab-users.toml", "/etc/passwd") + "\n[tls]\ncertificate = \"/etc/passwd\"\n",
            0,
            "",
        ),
    ] {
        let told = ask(carol, "what-if", "/", with("config", wrong)).await;
        if line == 0 {
            told.expect("no file is read");
            continue;
        }
        let error = told.expect_err("it is wrong");
        assert_eq!(
            (error.code.clone(), error.get("slot")),
            (Code::BAD_CONTENT, Some(&"content/config".into()))
        );
        let faults = error.get("faults").and_then(Value::as_list).expect("faults");
        assert!(
            faults
                .iter()
                .any(|fault| fault.get("line").and_then(Value::as_int) == Some(line)),
            "{error:?}"
        );
        assert!(error.text.contains(words), "{error}");
    }
}

fn line_of(text: &str, words: &str) -> i64 {
    let index = text.lines().position(|line| line == words);
    i64::try_from(index.expect("it is there")).expect("few lines") + 1
}

/// A peer that asks on and on has one answered at a time, and bob drives as before.
#[tokio::test]
async fn a_flood_of_what_ifs_disturbs_nobody() {
    let home = Home::new(FILES);
    let service = home.start().await;
    let [_alice, bob, carol] = contention(&service).await;
    let mut floods = Vec::new();
    for _ in 0..50 {
        let (carol, text) = (carol.clone(), home.config());
        floods.push(tokio::spawn(async move {
            ask(&carol, "what-if", "/", with("config", text)).await
        }));
    }
    for _ in 0..20 {
        let told = timeout(PATIENCE, ask(&bob, "explain", TOKEN, with("verb", "grab"))).await;
        told.expect("in time").expect("about itself");
    }
    let (mut answered, mut later) = (0, 0);
    for flood in floods {
        match flood.await.expect("it ends") {
            Ok(_) => answered += 1,
            Err(error) => {
                assert_eq!(error.code, Code::TRY_LATER);
                assert!(
                    error
                        .retry_in()
                        .is_some_and(|wait| wait <= Duration::from_secs(1))
                );
                later += 1;
            }
        }
    }
    assert!(answered >= 1 && later >= 1, "{answered} {later}");
}

async fn mom(service: &Service, user: &str, arguments: &[&str]) -> (Option<i32>, String, String) {
    let hub = format!("bin://{}", service.address());
    let mut command = Command::new(program("mom"));
    command.args(["--hub", &hub, "--user", user]).args(arguments);
    let ended = command.env("MOM_PASSWORD", user).output().await.expect("it runs");
    (ended.status.code(), text(&ended.stdout), text(&ended.stderr))
}

#[tokio::test]
async fn the_command_line_asks_the_same() {
    let home = Home::new(FILES);
    let service = home.start().await;
    let _peers = contention(&service).await;
    let (code, said, _) = mom(&service, "carol", &["audit", TOKEN, "--since", "1h"]).await;
    assert_eq!(code, Some(0));
    let lines: Vec<&str> = said.lines().collect();
    assert!(
        lines[0].contains("granted alice (level 1)") && lines[1].contains("refused bob"),
        "{said}"
    );
    let (_, said, _) = mom(&service, "carol", &["audit", "/", "--what", "refused", "--json"]).await;
    let fact: Json = serde_json::from_str(said.lines().next().expect("a fact")).expect("JSON");
    assert_eq!((&fact["peer"], &fact["code"]), (&"bob".into(), &"held".into()));
    let (code, _, said) = mom(&service, "alice", &["audit"]).await;
    assert!(code == Some(1) && said.contains("rule  lab"), "{said}");
    let (_, said, _) = mom(&service, "bob", &["explain", TOKEN, "grab"]).await;
    assert!(
        said.starts_with("bob as bob~2 (level 1) may not grab /robot/token\n"),
        "{said}"
    );
    let (_, said, _) = mom(
        &service,
        "carol",
        &["explain", TOKEN, "--about", "alice", "--about", "bob"],
    )
    .await;
    assert!(
        said.contains("alice (level 1) at /robot/token (token;") && said.contains("mom.toml:"),
        "{said}"
    );
    let (_, shown, _) = mom(&service, "carol", &["what-if", "--show"]).await;
    assert_eq!(shown.trim_end(), home.config().trim_end());
    let file = home.file("try.toml");
    std::fs::write(&file, &shown).expect("a file");
    let file = file.display().to_string();
    let (code, said, _) = mom(&service, "carol", &["what-if", &file]).await;
    assert!(
        code == Some(0) && said.ends_with("decided again: nothing differs\n"),
        "{said}"
    );
    std::fs::write(&file, shown.replacen("min-level = 1", "min-level = 2", 1)).expect("a file");
    let (code, said, _) = mom(&service, "carol", &["what-if", &file]).await;
    assert!(code == Some(1) && said.contains("differ\n"), "{said}");
    std::fs::write(&file, "root = \n").expect("a file");
    let (code, _, said) = mom(&service, "carol", &["what-if", &file]).await;
    assert!(code == Some(1) && said.contains("line 1"), "{said}");
}
