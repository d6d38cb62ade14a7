//! The commands about tokens, as processes beside each other.

use std::process::{Output, Stdio};

use mom_broker::Broker;
use mom_client::{Client, Event, Events, Family, Map, Parcel, Path, Value};
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, Running, program, text};
use tokio::io::AsyncWriteExt as _;
use tokio::process::Command;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

const TOKEN: &str = "/desk/token";

/// A broker with a token that everybody may have, and who watches it.
struct Desk {
    broker: Broker,
    carol: Client,
    events: Events,
}

impl Desk {
    async fn start(manager: impl Into<mom_client::Value>) -> Desk {
        let broker = lab::start().await;
        let builder = Client::builder(format!("bin://{}", broker.local_addr()));
        let carol = builder.user("carol").password("carol").connect().await;
        let carol = carol.expect("a user of the lab");
        let session = Map::new().with("kind", "session").with("manager", "open");
        let token = Map::new()
            .with("kind", "token")
            .with("manager", manager)
            .with("lease", 180_000);
        for (path, spec) in [("/desk", session), (TOKEN, token)] {
            carol.create(path, spec).await.expect("an operator may");
        }
        let events = carol.token(TOKEN).await.expect("made just now").events();
        Desk {
            broker,
            carol,
            events,
        }
    }

    fn settings(&self, user: &str) -> Vec<(&'static str, String)> {
        vec![
            ("MOM_HUB", format!("bin://{}", self.broker.local_addr())),
            ("MOM_USER", user.to_owned()),
            ("MOM_PASSWORD", user.to_owned()),
        ]
    }

    /// A command that goes on beside the test.
    fn start_as(&self, user: &str, args: &[&str]) -> Running {
        let settings = self.settings(user);
        let settings: Vec<(&str, &str)> = settings.iter().map(|(key, value)| (*key, &**value)).collect();
        Running::start("mom", args, &settings)
    }

    /// A command to its end; with this on its standard input.
    async fn run_as(&self, user: &str, args: &[&str], input: &'static str) -> Output {
        let program = spawn_blocking(|| program("mom")).await.expect("it is built");
        let mut command = Command::new(program);
        command.args(args).envs(self.settings(user));
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .kill_on_drop(true);
        let run = async {
            let mut child = command.spawn().expect("the program starts");
            let mut stdin = child.stdin.take().expect("its input is piped");
            // One that needs no input may have ended already.
            let _ = stdin.write_all(input.as_bytes()).await;
            drop(stdin);
            child.wait_with_output().await.expect("the program ends")
        };
        timeout(PATIENCE, run).await.expect("the program ends in time")
    }

    /// Waits until a peer has joined the token.
    async fn joined(&mut self, peer: &str) {
        joined(&mut self.events, peer).await;
    }

    async fn end(self) {
        self.carol.close().await;
        self.broker.stop().await;
    }
}

/// Waits until a peer has joined a context.
async fn joined(events: &mut Events, peer: &str) {
    let joined = async {
        while let Some(event) = events.next().await {
            if matches!(&event, Event::Joined(member) if member.peer == peer) {
                return;
            }
        }
    };
    timeout(PATIENCE, joined).await.expect("it joins in time");
}

/// The exit code of a program that was asked to end.
async fn interrupted(running: Running) -> Option<i32> {
    running.signal("INT");
    ended(running).await
}

async fn ended(running: Running) -> Option<i32> {
    let status = spawn_blocking(move || running.wait()).await;
    status.expect("waited for").code()
}

fn check(output: &Output, code: i32, words: &[&str]) {
    let said = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{said}");
    for word in words {
        assert!(said.contains(word), "{word:?} is in {said}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_waits_sees_its_place_and_who_is_refused_sees_why() {
    let desk = Desk::start("open").await;
    let alice = desk.start_as("alice", &["grab", TOKEN]);
    alice.line_with("holding /desk/token");
    let refused = desk.run_as("bob", &["grab", TOKEN], "").await;
    let words = [
        "owner  alice, level 1",
        "you    level 1",
        "if alice does not renew before",
        "place  1st in the queue, if you wait; your turn would be in ",
        "held (101)",
        "mom grab --wait",
    ];
    check(&refused, 1, &words);
    let late = desk.run_as("bob", &["grab", "--wait", "20ms", TOKEN], "").await;
    check(
        &late,
        1,
        &["1st in the queue", "alice, level 1", "timed-out (102)"],
    );

    let bob = desk.start_as("bob", &["grab", "--json", "--wait", "forever", TOKEN]);
    bob.line_with(r#""state":"waiting","path":"/desk/token","place":1"#);
    let shown = desk.run_as("carol", &["token", TOKEN], "").await;
    let words = [
        "owner     alice (level 1), for",
        "of 3 min left",
        "queue     1  bob (level 1)",
    ];
    check(&shown, 0, &words);
    assert_eq!(interrupted(alice).await, Some(0));
    bob.line_with(r#""state":"grabbed""#);
    let waits = desk.start_as("alice", &["grab", "--wait", "5m", TOKEN]);
    waits.line_with("1st in the queue");
    assert_eq!(interrupted(waits).await, Some(1), "it has not got it");
    assert_eq!(interrupted(bob).await, Some(0));
    let free = desk.run_as("carol", &["token", "--json", TOKEN], "").await;
    check(&free, 0, &[r#""kind":"token""#, r#""lease":180000"#]);
    let channel = desk.run_as("carol", &["token", "/chat"], "").await;
    check(&channel, 1, &["/chat is a channel, not a token"]);
    desk.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_given_for_a_while_and_for_good_or_not_at_all() {
    let mut desk = Desk::start("open").await;
    let nobody = desk.run_as("alice", &["give", "bob", TOKEN], "").await;
    check(
        &nobody,
        1,
        &["bob is not in /desk; nothing was grabbed", "mom tree /desk"],
    );

    let bob = desk.start_as("bob", &["accept", "--json", "--peer", "alice", TOKEN]);
    desk.joined("bob").await;
    let give = ["give", "bob", TOKEN, "--for", "100ms", "--commands", "5"];
    let lent = desk.run_as("alice", &give, "").await;
    let words = [
        "offered /desk/token to bob for 0.1 s or 5 commands",
        "bob has /desk/token",
        "/desk/token is back",
        "released /desk/token",
    ];
    check(&lent, 0, &words);
    bob.line_with(r#""state":"offered","path":"/desk/token","by":"alice","for":100,"commands":5"#);
    bob.line_with(r#""from":"alice""#);
    bob.line_with(r#""state":"returned""#);
    assert_eq!(ended(bob).await, Some(0));

    let bob = desk.start_as("bob", &["accept", TOKEN]);
    desk.joined("bob").await;
    let given = desk.run_as("alice", &["give", "bob", TOKEN], "").await;
    check(&given, 0, &["bob has /desk/token"]);
    bob.line_with("holding /desk/token");
    assert_eq!(interrupted(bob).await, Some(0));

    let bob = desk.start_as("bob", &["decline", TOKEN]);
    desk.joined("bob").await;
    let declined = desk.run_as("alice", &["give", "bob", TOKEN], "").await;
    check(
        &declined,
        1,
        &["bob does not want /desk/token", "released /desk/token"],
    );
    bob.line_with("declined /desk/token");
    assert_eq!(ended(bob).await, Some(0));
    let alone = desk
        .run_as("bob", &["accept", "--within", "20ms", TOKEN], "")
        .await;
    check(&alone, 1, &["nobody offered /desk/token to bob within 0.1 s"]);
    desk.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_owner_answers_at_its_terminal() {
    let desk = Desk::start("open").await;
    let grab = ["grab", "--answer", TOKEN];
    // The answers wait until they are asked for.
    let alice = desk.run_as("alice", &grab, "n in a minute\ny\n");
    let asks = async {
        owned_by(&desk.carol, "alice").await;
        let declined = desk
            .run_as("bob", &["request", "--text", "please", TOKEN], "")
            .await;
        check(&declined, 1, &["in a minute", "declined (104)"]);
        let bob = desk.start_as("bob", &["request", "--json", TOKEN]);
        bob.line_with(r#""state":"grabbed""#);
        bob
    };
    let (alice, bob) = tokio::join!(alice, asks);
    let words = [
        "bob (level 1) asks for it: please",
        "bob is told no",
        "no longer holding /desk/token: bob has it now",
    ];
    check(&alice, 0, &words);
    assert_eq!(interrupted(bob).await, Some(0));
    desk.end().await;
}

/// Waits until a peer owns the token.
async fn owned_by(client: &Client, owner: &str) {
    let token = client.token(TOKEN).await.expect("joined before");
    let mut events = token.events();
    let owned = async {
        while token.status().await.expect("an operator may").owner.as_deref() != Some(owner) {
            events.next().await.expect("the token stays");
        }
    };
    timeout(PATIENCE, owned).await.expect("it grabs in time");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_is_inhibited_and_broken() {
    let desk = Desk::start("open").await;
    let alice = desk.start_as("alice", &["inhibit", TOKEN]);
    alice.line_with("nobody can own /desk/token");
    let refused = desk.run_as("bob", &["grab", TOKEN], "").await;
    check(&refused, 1, &["holders  alice", "held (101)"]);
    let shown = desk.run_as("bob", &["token", TOKEN], "").await;
    check(&shown, 0, &["owner     nobody: alice inhibits it"]);
    let broken = desk.run_as("carol", &["break", TOKEN], "").await;
    check(&broken, 0, &["broke /desk/token: alice no longer has it"]);
    alice.line_with("lost /desk/token");
    assert_eq!(ended(alice).await, Some(1));
    let short = desk
        .run_as("alice", &["inhibit", "--for", "20ms", TOKEN], "")
        .await;
    check(&short, 0, &["/desk/token can be grabbed again"]);
    let nothing = desk.run_as("carol", &["break", TOKEN], "").await;
    check(&nothing, 0, &["nobody had /desk/token"]);
    desk.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn peers_are_invited_and_expelled() {
    let mut desk = Desk::start("open").await;
    let bob = desk.start_as("bob", &["grab", TOKEN]);
    desk.joined("bob").await;
    bob.line_with("holding");
    let invited = desk.run_as("carol", &["invite", "bob", "/desk"], "").await;
    check(&invited, 0, &["bob is invited to /desk"]);
    let expel = ["expel", "bob", "/desk", "--text", "lunch", "--for", "1m"];
    let expelled = desk.run_as("carol", &expel, "").await;
    check(&expelled, 0, &["bob is expelled from /desk"]);
    bob.line_with("lost /desk/token: you may no longer be here");
    assert_eq!(ended(bob).await, Some(1));
    let out = desk.run_as("bob", &["grab", TOKEN], "").await;
    check(&out, 1, &["expelled", "denied (200)"]);
    desk.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn contexts_are_made_and_deleted() {
    let desk = Desk::start("open").await;
    for (line, words) in [
        (
            &["create", "session", "/desk/lab"][..],
            "session /desk/lab is there",
        ),
        (
            &[
                "create",
                "token",
                "/desk/lab/key",
                "--manager",
                "first-come",
                "--lease",
                "3m",
            ],
            "token /desk/lab/key is there",
        ),
        (
            &[
                "create",
                "channel",
                "/desk/lab/arm",
                "--guard",
                "/desk/lab/key",
                "--guarded",
                "go,grip",
            ],
            "channel /desk/lab/arm is there",
        ),
        (&["tree", "/desk/lab"], "go grip guarded by /desk/lab/key"),
        (&["token", "/desk/lab/key"], "3 min"),
        (
            &["delete", "/desk/lab"],
            "/desk/lab is deleted, with all below it",
        ),
    ] {
        check(&desk.run_as("carol", line, "").await, 0, &[words]);
    }
    let gone = desk.run_as("carol", &["tree", "/desk/lab"], "").await;
    check(&gone, 1, &["unknown-path"]);
    let denied = desk.run_as("bob", &["delete", "/chat"], "").await;
    check(&denied, 1, &["refused: delete /chat"]);
    let wrong = desk.run_as("carol", &["create", "chanel", "/desk/x"], "").await;
    check(&wrong, 2, &["write session, channel or token"]);
    desk.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_chair_answers_the_hub_s_questions() {
    let chairs = Map::new().with("users", vec!["alice".into()]);
    let moderated = Map::new().with("kind", "moderated").with("chairs", chairs);
    let desk = Desk::start(moderated).await;
    let alone = desk.run_as("bob", &["grab", TOKEN], "").await;
    check(&alone, 1, &["there is no peer to ask"]);
    let mut events = desk.carol.token(TOKEN).await.expect("joined before").events();
    let manage = desk.run_as("alice", &["manage", TOKEN], "n not now\ny\n");
    let asks = async {
        joined(&mut events, "alice").await;
        let refused = desk.run_as("bob", &["grab", TOKEN], "").await;
        check(&refused, 1, &["not now"]);
        let bob = desk.start_as("bob", &["grab", TOKEN]);
        bob.line_with("holding /desk/token");
        bob
    };
    let (manage, bob) = tokio::join!(manage, asks);
    check(
        &manage,
        0,
        &["bob (level 1) wants to grab /desk/token", "denied", "allowed"],
    );
    assert_eq!(interrupted(bob).await, Some(0));
    desk.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn where_no_camera_answers_the_newest_picture_is_taken_and_said_to_be_old() {
    let desk = Desk::start("open").await;
    let spec = Map::new()
        .with("kind", "channel")
        .with("manager", "open")
        .with("keep", Map::new().with("latest", true));
    desk.carol
        .create("/desk/eye", spec)
        .await
        .expect("an operator may");
    let _eye = desk.carol.channel("/desk/eye").await.expect("made just now");
    let mut image = Parcel::new(Family::Message, "image")
        .context(Path::parse("/desk/eye").expect("a path"))
        .content(
            Map::new()
                .with("media-type", "image/jpeg")
                .with("image", Value::Binary(b"a picture".to_vec().into())),
        );
    image.receipt = Some(true);
    desk.carol.request(image).await.expect("it is passed on");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("eye.jpg");
    let file = file.to_str().expect("text");
    let snap = ["snap", "eye", "--session", "/desk", "--output", file];
    let kept = desk.run_as("alice", &[&snap[..], &["--json"]].concat(), "").await;
    check(&kept, 0, &[r#""kept":true"#, r#""age-ms":"#, r#""taken":""#]);
    assert_eq!(std::fs::read(file).expect("it is written"), b"a picture");
    let kept = desk.run_as("alice", &snap, "").await;
    check(
        &kept,
        0,
        &["no camera answers: this is the newest picture in the channel, and "],
    );
    let strict = [&snap[..], &["--fresh", "--timeout", "500ms"]].concat();
    let refused = desk.run_as("alice", &strict, "").await;
    check(&refused, 1, &["no camera answers in /desk/eye within 0.5 s"]);
    desk.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_looks_for_an_arm_at_a_fleet_is_pointed_to_the_fleet() {
    let desk = Desk::start("open").await;
    let run = ["run", "--channel", "/nowhere/arm", "-"];
    let nowhere = desk.run_as("alice", &run, "home").await;
    check(
        &nowhere,
        1,
        &["`mom tree` shows what there is", "unknown-path (210)"],
    );
    let fleet = Map::new().with("kind", "session").with("manager", "open");
    desk.carol.create("/fleet", fleet).await.expect("an operator may");
    for args in [
        &run[..],
        &["jog", "--channel", "/nowhere/arm", "50", "0", "0", "0", "0"],
        &["snap", "--session", "/nowhere"],
        &["camera", "x", "--session", "/nowhere"],
    ] {
        let told = desk.run_as("alice", args, "home").await;
        check(
            &told,
            1,
            &["this hub has a fleet: mom fleet list", "unknown-path (210)"],
        );
    }
    desk.end().await;
}
