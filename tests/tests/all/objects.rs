//! Commands in terms of objects, against the real lab (M62): what the model says is what the cameras see.

use std::time::Duration;

use mom_client::{Client, Event, Events, Family, Map, Parcel, Path, Value};
use mom_tests::programs::{PATIENCE, Running, run, text};
use serde_json::Value as Json;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// `mom lab` as a process, on a free port.
struct Lab {
    program: Running,
    hub: String,
}

/// What a command said, and its exit code.
#[derive(Debug)]
struct Said {
    code: Option<i32>,
    out: String,
    words: String,
}

fn environment<'a>(hub: &'a str, user: &'a str) -> [(&'a str, &'a str); 3] {
    [("MOM_HUB", hub), ("MOM_USER", user), ("MOM_PASSWORD", user)]
}

impl Lab {
    /// With all three blocks seen.
    async fn start() -> Lab {
        let started = spawn_blocking(|| {
            let (program, hub) = Running::lab();
            Lab { program, hub }
        });
        let lab = started.await.expect("the lab starts");
        let watcher = lab.join("carol").await;
        let objects = watcher.channel("/model/objects").await.expect("operators may");
        let mut events = objects.events();
        let mut seen = std::collections::BTreeSet::new();
        while seen.len() < 3 {
            for object in list(&next(&mut events, &["objects", "objects-changed"]).await.value()) {
                let name = object.get("name").and_then(Value::as_str);
                seen.insert(name.expect("it has one").to_owned());
            }
        }
        watcher.close().await;
        lab
    }

    async fn join(&self, user: &str) -> Client {
        let client = Client::builder(self.hub.as_str()).user(user).password(user);
        client.connect().await.expect("the lab knows its users")
    }

    async fn say(&self, user: &'static str, args: &[&str]) -> Said {
        let hub = self.hub.clone();
        let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        let ran = spawn_blocking(move || {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            run("mom", &args, &environment(&hub, user))
        });
        let output = ran.await.expect("it runs");
        Said {
            code: output.status.code(),
            out: text(&output.stdout),
            words: text(&output.stderr),
        }
    }

    /// An object, as `mom objects` tells it.
    async fn object(&self, name: &str) -> Json {
        let said = self.say("bob", &["objects", name, "--json"]).await;
        serde_json::from_str(&said.out).unwrap_or_else(|error| panic!("{error}: {said:?}"))
    }

    async fn end(self) {
        self.program.signal("INT");
        let ended = spawn_blocking(move || self.program.wait());
        assert_eq!(ended.await.expect("waited for").code(), Some(0));
    }
}

fn list(content: &Value) -> Vec<Value> {
    let list = content.get("objects").and_then(Value::as_list);
    list.unwrap_or_default().to_vec()
}

/// The next message of one of these names.
async fn next(events: &mut Events, names: &[&str]) -> Parcel {
    let wanted = async {
        loop {
            match events.next().await.expect("the client lives") {
                Event::Message(parcel) if names.contains(&parcel.name()) => return parcel,
                _ => {}
            }
        }
    };
    timeout(PATIENCE, wanted).await.expect("it comes")
}

fn near(object: &Json, place: [f64; 3]) -> bool {
    let off = ["x", "y", "z"].iter().zip(place).map(|(axis, wanted)| {
        let number = object[axis].as_f64().expect("a number");
        (number - wanted).abs()
    });
    off.fold(0.0, f64::max) < 3.0
}

#[tokio::test(flavor = "multi_thread")]
async fn blocks_are_put_and_brought_where_they_are_wanted() {
    let lab = Lab::start().await;
    let said = lab.say("bob", &["objects"]).await;
    assert_eq!((said.code, said.out.lines().count()), (Some(0), 3), "{said:?}");
    for line in said.out.lines() {
        assert!(
            line.contains("on the table") && line.contains("seen ") && line.contains("mm by "),
            "{line}"
        );
    }
    assert!(near(&lab.object("red").await, [-150.0, 100.0, 20.0]));

    let said = lab.say("bob", &["put", "red", "on", "blue"]).await;
    assert_eq!(said.code, Some(0), "{said:?}");
    assert!(
        said.out.starts_with("red is on blue (seen ")
            && said.out.contains(" s ago, ")
            && said.out.contains(" mm off)"),
        "{said:?}"
    );
    let red = lab.object("red").await;
    assert!(near(&red, [150.0, 100.0, 60.0]) && red["on"] == "blue", "{red}");
    // The arm agrees, which the model never asked.
    let bob = lab.join("bob").await;
    let mut arm = bob.channel("/robot/arm").await.expect("people may").events();
    let state = next(&mut arm, &["state"]).await.value();
    let blocks = state
        .get("blocks")
        .and_then(Value::as_list)
        .expect("it simulates some");
    let truth = blocks
        .iter()
        .find(|block| block.get("name").and_then(Value::as_str) == Some("red"));
    let height = truth.and_then(|red| red.get("z")).cloned();
    assert!(
        matches!(height, Some(Value::Double(z)) if (z - 60.0).abs() < 0.1),
        "{height:?}"
    );

    let said = lab
        .say(
            "bob",
            &["bring", "green", "to", "100", "-50", "--yaw", "45", "--json"],
        )
        .await;
    assert_eq!(said.code, Some(0), "{said:?}");
    let told: Json = serde_json::from_str(said.out.trim()).expect("JSON");
    assert!(
        near(&told, [100.0, -50.0, 20.0]) && told["off"].as_f64() < Some(3.0),
        "{told}"
    );
    let turned = lab.object("green").await["yaw"].as_f64().expect("a number");
    assert!((turned - 45.0).abs() < 3.0, "{turned}");

    what_is_in_the_way_is_said(&lab, &bob).await;
    lab.end().await;
}

/// In each case nothing moves, and nobody takes the token.
async fn what_is_in_the_way_is_said(lab: &Lab, bob: &Client) {
    let token = bob.token("/robot/token").await.expect("people may");
    let fence = token.status().await.expect("told").fence;
    for (line, words) in [
        ("put blue on green", "red lies on blue"),
        ("put green on blue", "red lies on blue"),
        (
            "put redd on green",
            "there is no object \"redd\"; did you mean red (seen ",
        ),
        ("put red on red", "red cannot lie on itself"),
        ("bring green to 150 120", "no room for green at 150 120: "),
    ] {
        let said = lab.say("bob", &line.split(' ').collect::<Vec<_>>()).await;
        assert_eq!((said.code, said.out.as_str()), (Some(1), ""), "{line}: {said:?}");
        assert!(said.words.contains(words), "{line}: {said:?}");
    }
    let after = token.status().await.expect("told").fence;
    assert_eq!(after, fence);
    // Whether the arm reaches a place is the arm's own answer.
    let said = lab.say("bob", &["bring", "green", "to", "0", "320"]).await;
    assert_eq!(said.code, Some(1));
    assert!(said.words.contains("y is 320 mm, but the workspace"), "{said:?}");
    for wrong in [
        &["put", "red", "onto", "blue"][..],
        &["bring", "red", "to", "x", "1"],
    ] {
        assert_eq!(lab.say("bob", wrong).await.code, Some(2), "{wrong:?}");
    }
}

/// Who joins late gets all objects, and from then on what differs, numbered without a gap.
#[tokio::test(flavor = "multi_thread")]
async fn a_late_joiner_gets_all_and_then_what_differs() {
    let lab = Lab::start().await;
    let bob = lab.join("bob").await;
    let channel = bob.channel("/model/objects").await.expect("people may");
    let mut events = channel.events();
    let snapshot = next(&mut events, &["objects"]).await.value();
    assert_eq!(list(&snapshot).len(), 3);
    assert!(
        list(&snapshot)
            .iter()
            .all(|object| object.get("age").is_some() && object.get("seen").is_some())
    );
    let mut seq = snapshot.get("seq").and_then(Value::as_int).expect("numbered");
    let carrying = {
        let hub = lab.hub.clone();
        spawn_blocking(move || run("mom", &["put", "red", "on", "blue"], &environment(&hub, "alice")))
    };
    let (mut held, mut let_go, mut landed) = (false, false, false);
    while !(held && let_go && landed) {
        let change = next(&mut events, &["objects-changed"]).await.value();
        let number = change.get("seq").and_then(Value::as_int).expect("numbered");
        assert_eq!(number, seq + 1);
        seq = number;
        for object in list(&change) {
            let is_red = object.get("name").and_then(Value::as_str) == Some("red");
            let now_held = object.get("held").and_then(Value::as_bool);
            assert!(is_red || now_held.is_none(), "{object:?}");
            held |= now_held == Some(true);
            let_go |= held && now_held == Some(false);
            let height = object.get("z").cloned();
            landed |= is_red && matches!(height, Some(Value::Double(z)) if (z - 60.0).abs() < 3.0);
        }
    }
    assert!(carrying.await.expect("it runs").status.success());
    lab.end().await;
}

/// Sends a write of an object.
async fn write(client: &Client, content: Map) {
    let mut parcel = Parcel::new(Family::Message, "write").content(content);
    parcel.context = Path::parse("/model/objects").ok();
    client.send(parcel).await.expect("sent");
}

/// It stays as it was written.
async fn what_no_camera_knows_is_not_driven_to(lab: &Lab, bob: &Client, events: &mut Events) {
    let guard = bob
        .token("/robot/token")
        .await
        .expect("people may")
        .grab()
        .await
        .expect("it is free");
    write(bob, Map::new().with("name", "cup").with("x", 0).with("y", -200)).await;
    next(events, &["objects"]).await;
    guard.release().await.expect("it is his");
    let cup = lab.object("cup").await;
    assert_eq!(
        (&cup["written-by"], cup["y"].as_f64()),
        (&"bob".into(), Some(-200.0)),
        "{cup}"
    );
    let said = lab.say("bob", &["bring", "cup", "to", "0", "-100"]).await;
    assert_eq!(said.code, Some(1));
    assert!(
        said.words
            .contains("no camera has seen cup since bob wrote its place"),
        "{said:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn owners_of_tokens_write_and_nobody_else() {
    let lab = Lab::start().await;
    let (alice, bob) = (lab.join("alice").await, lab.join("bob").await);
    let channel = bob.channel("/model/objects").await.expect("people may");
    let mut events = channel.events();
    let green = || Map::new().with("name", "green").with("x", 10).with("y", 20);
    let owned = alice
        .token("/model/green")
        .await
        .expect("people may")
        .grab()
        .await;
    let owned = owned.expect("it is free");
    write(&bob, green()).await;
    let refused = next(&mut events, &["write-refused"]).await.value();
    let word = |key: &str| {
        refused
            .get(key)
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned()
    };
    assert_eq!(
        (word("name"), word("owner")),
        ("not-owner".to_owned(), "alice".to_owned())
    );
    assert!(
        word("text").contains("/robot/token is free, /model/green is alice's"),
        "{refused:?}"
    );

    // The owner's word holds until a camera sees the block again, which is soon.
    let joined = alice.channel("/model/objects").await.expect("people may");
    write(&alice, green().with("x", 11)).await;
    let by = loop {
        let change = next(&mut events, &["objects-changed"]).await.value();
        let mut changes = list(&change).into_iter();
        let by = changes.find_map(|object| {
            object
                .get("written-by")
                .and_then(Value::as_str)
                .map(str::to_owned)
        });
        if let Some(by) = by {
            break by;
        }
    };
    assert_eq!(by, "alice");
    loop {
        let change = next(&mut events, &["objects-changed"]).await.value();
        if list(&change)
            .iter()
            .any(|object| object.get("written-by") == Some(&Value::Null))
        {
            break;
        }
    }
    drop(joined);
    owned.release().await.expect("it is hers");

    what_no_camera_knows_is_not_driven_to(&lab, &bob, &mut events).await;
    // Only the model says where objects are.
    let mut forged = Parcel::new(Family::Message, "objects-changed").context(channel.path().clone());
    forged.receipt = Some(true);
    assert!(bob.request(forged).await.is_err(), "the hub refuses it");
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_write_right_behind_its_grab_is_the_owners() {
    let lab = Lab::start().await;
    let alice = lab.join("alice").await;
    let channel = alice.channel("/model/objects").await.expect("people may");
    let token = alice.token("/model/green").await.expect("people may");
    let mut events = channel.events();
    next(&mut events, &["objects"]).await;
    for round in 0..200 {
        let green = Map::new().with("name", "green").with("x", round).with("y", 20);
        let (owned, ()) = tokio::join!(token.grab(), write(&alice, green));
        let owned = owned.expect("it is free");
        let answer = next(&mut events, &["objects", "write-refused"]).await;
        assert_eq!(answer.name(), "objects", "round {round}: {:?}", answer.value());
        owned.release().await.expect("it is hers");
    }
    lab.end().await;
}

/// Carol has the higher level, and takes the robot while red is in the jaws: alice's command says so at its end.
#[tokio::test(flavor = "multi_thread")]
async fn a_plan_that_is_broken_off_says_where_the_block_is() {
    let lab = Lab::start().await;
    let carol = lab.join("carol").await;
    let mut arm = carol.channel("/robot/arm").await.expect("operators may").events();
    let token = carol.token("/robot/token").await.expect("operators may");
    let hub = lab.hub.clone();
    let carrying =
        spawn_blocking(move || run("mom", &["put", "red", "on", "blue"], &environment(&hub, "alice")));
    loop {
        let state = next(&mut arm, &["state"]).await.value();
        if state.get("holding").and_then(Value::as_str) == Some("red") {
            break;
        }
    }
    let guard = token.grab().await.expect("hers is the higher level");
    let ended = timeout(Duration::from_secs(20), carrying)
        .await
        .expect("at once")
        .expect("it runs");
    let words = text(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1));
    assert!(
        words.contains("lost /robot/token: carol has a higher level and took it"),
        "{words}"
    );
    let last = words.lines().last().unwrap_or_default();
    // How far it was carried by then is a matter of the machine's speed.
    assert!(last.contains("red is in the jaws, at "), "{words}");

    // Nobody takes what is held, and who asks is told.
    let said = lab.say("carol", &["put", "red", "on", "green"]).await;
    assert!(said.words.contains("red is in the jaws already"), "{said:?}");
    let said = lab.say("carol", &["put", "green", "on", "blue"]).await;
    assert!(said.words.contains("the jaws hold red already"), "{said:?}");
    guard.release().await.expect("it is hers");
    lab.end().await;
}
