//! A language model's tools: the real `mom-mcp` over its standard streams, beside the real lab.

use std::process::Command;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use mom_client::{Client, Code, Event, Given, Token, TokenGuard};
use mom_tests::assistant::{Assistant, text};
use mom_tests::audit::AuditLog;
use mom_tests::programs::{PATIENCE, Running, project};
use serde_json::{Value as Json, json};
use tokio::time::timeout;

pub(crate) const ROBOT: &str = "/robot/arm";
const TOKEN: &str = "/robot/token";

pub(crate) async fn person(hub: &str, name: &str) -> Client {
    let client = Client::builder(hub).user(name).password(name).connect().await;
    client.expect("the lab knows its users")
}

/// Alice, with the token in her hand.
pub(crate) async fn alice(hub: &str) -> (Client, Token, TokenGuard) {
    let alice = person(hub, "alice").await;
    let token = alice.token(TOKEN).await.expect("she may look");
    let guard = token.grab().await.expect("it is free");
    (alice, token, guard)
}

/// Gives the token to the assistant, which takes it.
pub(crate) async fn give(guard: &TokenGuard, time: Option<Duration>, commands: Option<u64>) -> Given {
    let mut give = guard.give("assistant");
    if let Some(time) = time {
        give = give.time(time);
    }
    if let Some(commands) = commands {
        give = give.commands(commands);
    }
    let mut given = give.await.expect("the assistant is here");
    given.accepted().await.expect("it takes what a person gives");
    given
}

/// Who owns the token, as the hub says.
async fn owner(client: &Client) -> Option<String> {
    let token = client.token(TOKEN).await.expect("it may look");
    token.status().await.expect("it may look").owner
}

#[tokio::test(flavor = "multi_thread")]
async fn it_looks_and_knows_where_everything_is() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let tools = assistant.request("tools/list", &json!({}));
    let tools = tools["tools"].as_array().expect("tools").clone();
    let names: Vec<&str> = tools.iter().filter_map(|tool| tool["name"].as_str()).collect();
    assert_eq!(
        names,
        ["look", "where", "request_token", "move", "stop", "return_token"]
    );
    for (tool, read_only, destructive) in [
        (0, true, Json::Null),
        (1, true, Json::Null),
        (2, false, false.into()),
        (3, false, true.into()),
        (4, false, true.into()),
        (5, false, false.into()),
    ] {
        let hints = &tools[tool]["annotations"];
        assert_eq!(hints["readOnlyHint"], read_only, "{hints}");
        assert_eq!(hints["destructiveHint"], destructive, "{hints}");
        assert_eq!(tools[tool]["inputSchema"]["type"], "object");
    }
    for camera in ["x", "wrist"] {
        let seen = assistant.call("look", &json!({"camera": camera}));
        shows_the_arm(&seen);
    }
    let said = assistant.bad("look", &json!({"camera": "../robot/arm"}), "unknown-camera");
    assert!(said.contains("top, wrist, x, y"), "{said}");
    let (_alice, _token, guard) = alice(&hub).await;
    let facts = assistant.good("where", &json!({}));
    assert_eq!(facts["token"]["owner"], "alice");
    assert_eq!(
        (&facts["token"]["yours"], &facts["token"]["owner_level"]),
        (&json!(false), &json!(1))
    );
    assert_eq!(
        (&facts["robot"]["moving"], &facts["robot"]["stopped"]),
        (&json!(false), &json!(false))
    );
    assert!(
        facts["robot"]["age_ms"].is_f64() && facts["robot"]["age_error_ms"].is_f64(),
        "{facts}"
    );
    let _given = give(&guard, Some(Duration::from_secs(30)), Some(3)).await;
    let token = assistant.good("where", &json!({}))["token"].clone();
    assert_eq!(
        (&token["yours"], &token["scope"]["commands_left"]),
        (&json!(true), &json!(3))
    );
    assert_eq!(token["scope"]["from"], "alice");
    let left = token["scope"]["left_ms"].as_u64().expect("ms");
    assert!((1..=30_000).contains(&left), "{token}");
}

/// A picture that can be decoded, and what stands beside it.
fn shows_the_arm(seen: &Json) {
    assert_eq!(seen["isError"], false, "{}", text(seen));
    let picture = &seen["content"][1];
    assert_eq!(
        (&picture["type"], &picture["mimeType"]),
        (&json!("image"), &json!("image/jpeg"))
    );
    let bytes = STANDARD
        .decode(picture["data"].as_str().expect("data"))
        .expect("base64");
    let picture = image::load_from_memory(&bytes).expect("an image");
    assert_eq!((picture.width(), picture.height()), (640, 480));
    let facts = &seen["structuredContent"];
    assert!(
        facts["age_ms"].is_f64() && facts["age_error_ms"].is_f64(),
        "{facts}"
    );
    assert!(
        facts["taken"].is_string() && facts["pose"]["z"].is_f64(),
        "{facts}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_but_a_person_gives_it_the_token() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let wish = json!({"reason": "to look", "for_seconds": 30, "commands": 3, "wait_seconds": 1});
    let home = json!({"script": "home"});
    // A free token is nobody's to hand over.
    let said = assistant.bad("request_token", &json!({"reason": "to look"}), "not-granted");
    assert!(
        said.contains("mom give assistant /robot/token --for 2m"),
        "{said}"
    );
    let said = assistant.bad("request_token", &wish, "not-granted");
    assert!(
        said.contains("mom give assistant /robot/token --for 2m"),
        "{said}"
    );
    let said = assistant.bad("move", &home, "not-owner");
    assert!(said.contains("nobody holds it now"), "{said}");
    // The hub says no as well, to whatever speaks as this user.
    let itself = person(&hub, "assistant").await;
    let free = itself.token(TOKEN).await.expect("it may look");
    for refused in [free.grab().await, free.request().await] {
        let refused = refused.expect_err("nobody has given it");
        assert_eq!(refused.code().map(Code::word), Some("denied"), "{refused}");
    }
    let (alice, token, guard) = alice(&hub).await;
    assert_eq!(owner(&alice).await.as_deref(), Some("alice"));
    // Nor is one whose owner says nothing, or no.
    let said = assistant.bad("request_token", &wish, "timed-out");
    assert!(said.contains("alice"), "{said}");
    let mut events = token.events();
    let asked = assistant.begin("request_token", &json!({"reason": "please"}));
    loop {
        if let Some(Event::Requested { member, text, .. }) = events.next().await
            && text.as_deref() == Some("please")
        {
            assert_eq!(member.user, "assistant");
            break;
        }
    }
    token
        .decline_request("assistant", "not now")
        .await
        .expect("she may");
    let said = assistant.failure(asked, "declined");
    assert!(said.contains("not now"), "{said}");
    let said = assistant.bad("move", &home, "not-owner");
    assert!(said.contains("alice holds it now"), "{said}");
    assert!(!guard.is_lost());
    assert_eq!(owner(&alice).await.as_deref(), Some("alice"));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_person_hands_over_is_kept_for_what_was_asked() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let (_alice, token, _guard) = alice(&hub).await;
    let mut events = token.events();
    let meta = json!({"name": "request_token", "arguments": {"reason": "to fetch the cup", "commands": 1},
                      "_meta": {"progressToken": "p"}});
    let asked = assistant.send("tools/call", &meta);
    loop {
        if let Some(Event::Requested { text, .. }) = events.next().await {
            assert_eq!(text.as_deref(), Some("to fetch the cup (for 1 command)"));
            break;
        }
    }
    let told = assistant.heard();
    assert_eq!(told["method"], "notifications/progress", "{told}");
    assert_eq!(told["params"]["progressToken"], "p");
    token.accept_request("assistant").await.expect("she may");
    let granted = assistant.result(asked);
    assert!(text(&granted).contains("for good"), "{granted}");
    assert_eq!(granted["structuredContent"]["scope"], Json::Null);
    assistant.moves("move 0 0 280 0 0");
    // That was the command that it had asked for.
    let said = assistant.bad("move", &json!({"script": "home"}), "not-owner");
    assert!(said.contains("what you asked for is over"), "{said}");
    assert_eq!(assistant.good("return_token", &json!({}))["returned"], false);
    // And the same for a time.
    let guard = token.grab().await.expect("it is free");
    let asked = assistant.begin("request_token", &json!({"reason": "to wave", "for_seconds": 1}));
    while !matches!(events.next().await, Some(Event::Requested { .. })) {}
    token.accept_request("assistant").await.expect("she may");
    assistant.result(asked);
    let over = async {
        while !matches!(events.next().await, Some(Event::Released { owner, .. }) if owner == "assistant") {}
    };
    timeout(PATIENCE, over).await.expect("it gives it back");
    drop(guard);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_is_taken_back_and_made_again() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let (_alice, token, guard) = alice(&hub).await;
    let mut events = token.events();
    let asked = assistant.begin("request_token", &json!({"reason": "to tidy up"}));
    while !matches!(events.next().await, Some(Event::Requested { .. })) {}
    let cancelled =
        json!({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": asked}});
    assistant.line(&cancelled.to_string());
    loop {
        if let Some(Event::Lapsed { what, by, .. }) = events.next().await {
            assert_eq!((what.as_str(), by.as_str()), ("request", "assistant"));
            break;
        }
    }
    // Asked again, it is given with a scope instead of handed over.
    let asked = assistant.begin("request_token", &json!({"reason": "to tidy up"}));
    while !matches!(events.next().await, Some(Event::Requested { .. })) {}
    let given = give(&guard, Some(Duration::from_secs(30)), None).await;
    let granted = assistant.result(asked);
    assert_eq!(
        granted["structuredContent"]["scope"]["from"], "alice",
        "{granted}"
    );
    assert_eq!(assistant.good("return_token", &json!({}))["to"], "alice");
    given.returned().await.expect("it is hers again");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scope_is_so_many_commands() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let (alice, _token, guard) = alice(&hub).await;
    let given = give(&guard, Some(Duration::from_secs(30)), Some(3)).await;
    let granted = assistant.good("request_token", &json!({"reason": "to move"}));
    assert_eq!(granted["scope"]["commands"], 3);
    for (height, left) in [(290, 2), (280, 1), (275, 0)] {
        let moved = assistant.moves(&format!("move 0 0 {height} 0 0"));
        assert_eq!(moved["pose"]["z"], f64::from(height), "{moved}");
        assert_eq!(moved["scope"]["commands_left"], left, "{moved}");
    }
    assistant.bad("move", &json!({"script": "home"}), "not-owner");
    let guard = given.returned().await.expect("it comes back by itself");
    let said = assistant.bad("move", &json!({"script": "home"}), "not-owner");
    assert!(said.contains("you have lost /robot/token: returned"), "{said}");
    assert_eq!(owner(&alice).await.as_deref(), Some("alice"));
    // What the arm refuses is an error with its code, and nothing is sent twice.
    let given = give(&guard, None, Some(2)).await;
    let high = json!({"script": "move 0 0 290 0 0; by 0 0 300 0 0"});
    let said = assistant.bad("move", &high, "workspace-boundary");
    assert!(
        said.contains("reaches from 0 to 450 mm") && said.contains("left of the scope: 1 command"),
        "{said}"
    );
    // What its card refuses is not sent, and is no command.
    assistant.bad("move", &json!({"script": "by 0 0 -5 0 0; mvoe 1"}), "syntax");
    assistant.bad("move", &json!({"script": "move 0 0 900 0 0"}), "syntax");
    let low = json!({"script": "move 0 0 290 0 0; by 0 0 -300 0 0"});
    assistant.bad("move", &low, "workspace-boundary");
    given.returned().await.expect("two errors are two commands");
}

#[tokio::test(flavor = "multi_thread")]
async fn it_is_interrupted() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let (_alice, _token, guard) = alice(&hub).await;
    let given = give(&guard, Some(Duration::from_secs(60)), None).await;
    let carol = person(&hub, "carol").await;
    let mut said = carol.channel(ROBOT).await.expect("she may look").events();
    let moving = assistant.begin("move", &json!({"script": "move 0 0 290 0 0; wait 50000"}));
    executing(&mut said).await;
    // Carol's level is above that of alice, who defends what she has lent.
    let token = carol.token(TOKEN).await.expect("she may look");
    let hers = token.grab().await.expect("she is an operator");
    let words = assistant.failure(moving, "lost");
    assert!(
        words.contains("lost /robot/token: carol has a higher level and took it"),
        "{words}"
    );
    assert!(given.returned().await.is_err(), "it is carol's");
    let words = assistant.bad("move", &json!({"script": "home"}), "not-owner");
    assert!(words.contains("carol holds it now"), "{words}");
    // A stop needs no token.
    let arm = carol.channel(ROBOT).await.expect("she may look");
    arm.message("command")
        .content("wait 50000")
        .fence(hers.fence())
        .send()
        .await
        .expect("it is hers");
    executing(&mut said).await;
    let stopped = assistant.good("stop", &json!({}));
    assert_eq!(
        (&stopped["stands"], &stopped["unstop"]),
        (&json!(true), &json!("mom unstop /robot/arm"))
    );
    assert_eq!(assistant.good("where", &json!({}))["robot"]["stopped"], true);
    // And there is no tool that lets the robot go again.
    let unstop = assistant.begin("unstop", &json!({}));
    assert_eq!(assistant.answer(unstop)["error"]["code"], -32602);
}

/// Waits until a command is carried out.
async fn executing(events: &mut mom_client::Events) {
    loop {
        if let Some(Event::Message(parcel)) = events.next().await
            && parcel.name() == "status"
            && parcel.value().get("state").and_then(mom_client::Value::as_str) == Some("executing")
        {
            return;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn it_gives_back_what_it_has_when_it_ends() {
    let (_lab, hub) = Running::lab();
    let (_alice, _token, mut guard) = alice(&hub).await;
    for signal in [None, Some("TERM"), Some("INT")] {
        let mut assistant = Assistant::at(&hub);
        assistant.good("where", &json!({}));
        let given = give(&guard, Some(Duration::from_secs(60)), None).await;
        let moving = assistant.begin("move", &json!({"script": "wait 50000"}));
        let begun = assistant.good("where", &json!({}));
        assert_eq!(begun["token"]["yours"], true, "{moving}: {begun}");
        let status = match signal {
            None => assistant.close(),
            Some(signal) => {
                let id = assistant.id().to_string();
                let sent = Command::new("kill").args([&format!("-{signal}"), &id]).status();
                assert!(sent.is_ok_and(|sent| sent.success()));
                assistant.end()
            }
        };
        assert!(status.success(), "{signal:?}: {status}");
        guard = given.returned().await.expect("it is hers again");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_keeps_the_token_loses_it_by_its_scope() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let (_alice, _token, guard) = alice(&hub).await;
    // It does nothing with it.
    let given = give(&guard, Some(Duration::from_secs(1)), None).await;
    let guard = given.returned().await.expect("it comes back by itself");
    let said = assistant.bad("move", &json!({"script": "home"}), "not-owner");
    assert!(said.contains("returned"), "{said}");
    // It is at it.
    let given = give(&guard, Some(Duration::from_secs(2)), None).await;
    let said = assistant.bad("move", &json!({"script": "wait 50000"}), "lost");
    assert!(said.contains("lost /robot/token: returned"), "{said}");
    let guard = given.returned().await.expect("it comes back by itself");
    // It floods: what is too much is said, and the scope counts what passes.
    let given = give(&guard, Some(Duration::from_secs(30)), Some(4)).await;
    let all: Vec<u64> = (0..100)
        .map(|_| assistant.begin("move", &json!({"script": "wait 1"})))
        .collect();
    let (mut moved, mut busy) = (0, 0);
    for _ in &all {
        let answer = assistant.heard();
        moved += u32::from(answer["result"]["isError"] == false);
        busy += u32::from(answer["error"]["code"] == -32000);
    }
    assert_eq!(moved, 4, "as many as alice has given");
    assert!(busy > 0, "16 calls at once");
    given.returned().await.expect("it comes back by itself");
}

#[test]
fn nonsense_is_answered_and_does_no_harm() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let long = format!(
        r#"{{"jsonrpc":"2.0","id":1,"method":"{}"}}"#,
        "x".repeat(1_000_000)
    );
    for (line, id, code) in [
        ("nonsense", Json::Null, -32700),
        (&"[".repeat(10_000), Json::Null, -32700),
        ("[]", Json::Null, -32600),
        (r#"{"jsonrpc":"2.0","id":"a","method":7}"#, json!("a"), -32600),
        (
            r#"{"jsonrpc":"2.0","id":"b","method":"tools/call","params":{"name":"fly"}}"#,
            json!("b"),
            -32602,
        ),
        (
            r#"{"jsonrpc":"2.0","id":"c","method":"tools/call","params":[]}"#,
            json!("c"),
            -32600,
        ),
        (&long, json!(1), -32600),
    ] {
        assistant.line(line);
        let answer = assistant.heard();
        let shown = &line[..line.len().min(80)];
        assert_eq!(
            (&answer["id"], &answer["error"]["code"]),
            (&id, &json!(code)),
            "{shown}: {answer}"
        );
        assert!(answer["error"]["message"].is_string(), "{answer}");
    }
    for (tool, arguments) in [
        ("look", json!({"camera": ["x"]})),
        ("where", json!({"all": true})),
        ("move", json!({})),
        ("request_token", json!({"reason": "x".repeat(501)})),
        ("request_token", json!({"reason": "x", "commands": 0})),
    ] {
        assistant.bad(tool, &arguments, "bad-arguments");
    }
    // An id that is under way is not taken twice: nobody grants this one.
    let asked = assistant.begin(
        "request_token",
        &json!({"reason": "to tidy up", "wait_seconds": 60}),
    );
    let again = json!({"jsonrpc": "2.0", "id": asked, "method": "ping"});
    assistant.line(&again.to_string());
    let answer = assistant.heard();
    assert_eq!(
        (&answer["id"], &answer["error"]["code"]),
        (&json!(asked), &json!(-32600)),
        "{answer}"
    );
    // A stop overtakes it.
    assistant.good("stop", &json!({}));
    assert_eq!(assistant.good("where", &json!({}))["robot"]["stopped"], true);
    assert!(assistant.close().success());
    // Who begins with something else is told why it ends.
    let mut stranger = Assistant::start(&hub);
    stranger.line(r#"{"jsonrpc":"2.0","method":"notifications/initialized"}"#);
    assert_eq!(stranger.end().code(), Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_hub_is_told_and_found_again_and_the_audit_knows_who() {
    let folder = tempfile::tempdir().expect("a folder");
    let audit = AuditLog::new();
    let lab = std::fs::read_to_string(project().join("config/lab.toml")).expect("it is there");
    let config = folder.path().join("lab.toml");
    let more = format!("\n[audit]\npath = {:?}\n", audit.path());
    std::fs::write(&config, lab + &more).expect("it is written");
    let users = project().join("config/lab-users.toml");
    std::fs::copy(users, folder.path().join("lab-users.toml")).expect("it is copied");
    let (broker, address) = Running::broker(&config);
    let hub = format!("bin://{address}");
    let mut assistant = Assistant::at(&hub);
    let said = assistant.good("where", &json!({}));
    assert_eq!(
        (&said["robot"], &said["token"]["owner"]),
        (&Json::Null, &Json::Null)
    );
    assistant.bad("look", &json!({"camera": "x"}), "failed");
    broker.signal("KILL");
    drop(broker);
    let said = loop {
        let result = assistant.call("where", &json!({}));
        if result["isError"] == true {
            break text(&result);
        }
    };
    assert!(said.starts_with("disconnected"), "{said}");
    assistant.bad("stop", &json!({}), "disconnected");
    std::fs::remove_file(audit.path()).expect("it is there");
    let config = config.to_str().expect("a path in text");
    let broker = Running::start("mom-broker", &["--config", config, "--listen", &address], &[]);
    broker.listening();
    loop {
        let result = assistant.call("where", &json!({}));
        if result["isError"] == false {
            break;
        }
    }
    let (_alice, _token, guard) = alice(&hub).await;
    let given = give(&guard, Some(Duration::from_secs(30)), Some(1)).await;
    let granted = assistant.good("request_token", &json!({"reason": "to look"}));
    assert_eq!(granted["scope"]["commands"], 1);
    assert_eq!(assistant.good("return_token", &json!({}))["to"], "alice");
    given
        .returned()
        .await
        .expect("it is hers again")
        .release()
        .await
        .expect("it is hers");
    assistant.bad("request_token", &json!({"reason": "again"}), "not-granted");
    assert!(assistant.close().success());
    broker.signal("TERM");
    assert!(broker.wait().success());
    let lines = audit.lines();
    let given = [("what", "granted"), ("peer", "assistant"), ("reason", "given")];
    assert_eq!(lines.count(&given), 1);
    let from = [
        ("what", "lost"),
        ("peer", "alice"),
        ("reason", "given"),
        ("by", "assistant"),
    ];
    assert_eq!(lines.count(&from), 1);
    let back = [("what", "lost"), ("peer", "assistant"), ("reason", "returned")];
    assert_eq!(lines.count(&back), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn it_takes_a_block_and_moves_relative_to_what_it_knows() {
    let (_lab, hub) = Running::lab();
    let mut assistant = Assistant::at(&hub);
    let (_alice, _token, guard) = alice(&hub).await;
    let _given = give(&guard, Some(Duration::from_secs(50)), None).await;
    let taken = assistant.moves("reset; move -150 100 20 0 0; grip close");
    assert_eq!(taken["holding"], "red", "{taken}");
    let lifted = assistant.moves("by 0 0 80 0 0");
    assert_eq!(lifted["pose"]["z"], 100.0, "{lifted}");
    assert_eq!(assistant.good("where", &json!({}))["robot"]["holding"], "red");
    let hint = |tool: &Json, key: &str| tool["inputSchema"]["properties"][key].is_object();
    let tools = assistant.request("tools/list", &json!({}))["tools"].clone();
    assert!(hint(&tools[3], "script") && hint(&tools[2], "reason"), "{tools}");
}
