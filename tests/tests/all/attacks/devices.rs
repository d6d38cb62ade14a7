//! A device is neither put out nor kept waiting for its owner by those who own nothing.

use std::net::SocketAddr;
use std::time::Duration;

use mom_broker::{Broker, Clock, Config};
use mom_proto::codec::Form;
use mom_proto::{Code, Delivery, Family, Limit, Map, Parcel, Value, WireError, from_value};
use mom_tests::attacks::configuration;
use mom_tests::canary::fence_of;
use mom_tests::raw::{Raw, at, message};

const ARM: &str = "/robot/arm";
const NOTE: usize = 60 * 1024;

async fn start(stalled: u64) -> (Broker, SocketAddr) {
    start_with(|config| config.limits.stalled = stalled).await
}

async fn start_with(change: impl FnOnce(&mut Config)) -> (Broker, SocketAddr) {
    let mut config = Config::load(&configuration()).expect("a right configuration");
    change(&mut config);
    let broker = Broker::start_at(config, Clock::system())
        .await
        .expect("it starts");
    let address = broker.local_addr();
    (broker, address)
}

/// A robot that reads nothing until it is told to.
async fn robot(address: SocketAddr) -> Raw {
    let mut robot = Raw::connect_small(address, Form::Binary).await;
    robot.log_in("arm").await;
    robot.join(&["/robot"]).await;
    let join = Parcel::new(Family::Context, "join").context(at(ARM));
    let joined = robot.ask(join.content(Map::new().with("device", true))).await;
    joined.expect("it may be a device");
    robot
}

/// A peer in its channel.
async fn member(address: SocketAddr, user: &str) -> Raw {
    let mut member = Raw::login(address, Form::Binary, user).await;
    member.join(&["/robot", ARM]).await;
    member
}

fn note(priority: i32) -> Parcel {
    let mut note = message("note", ARM, Value::Binary(vec![7; NOTE].into()));
    note.priority = Some(priority);
    note.echo = Some(false);
    note
}

async fn own(operator: &mut Raw) -> u64 {
    let granted = operator.ask_about(Family::Token, "grab", "/robot/token").await;
    fence_of(&granted.expect("a free token"))
}

fn command(fence: u64, number: u64) -> Parcel {
    let mut command = message("command", ARM, format!("move {number}").as_str());
    command.fence = Some(fence);
    command.receipt = Some(true);
    command.echo = Some(false);
    command
}

/// What of the owner comes before what others have sent with the highest priority.
#[tokio::test]
async fn nobodys_priority_goes_before_the_owners_commands() {
    let (broker, address) = start(60_000).await;
    let mut robot = robot(address).await;
    let mut operator = member(address, "alice").await;
    let fence = own(&mut operator).await;
    let mut bob = member(address, "bob").await;
    for _ in 0..15 {
        let mut note = note(100);
        note.receipt = Some(true);
        bob.ask(note).await.expect("there is room");
    }
    operator.ask(command(fence, 1)).await.expect("it is taken");
    // What the network holds by then cannot be overtaken.
    let mut before = 0;
    loop {
        let parcel = robot.next().await.expect("it is not closed");
        if parcel.is(Family::Message, "command") {
            break;
        }
        before += usize::from(parcel.is(Family::Message, "note"));
    }
    assert!(before <= 8, "{before} of 15 notes came before the command");
    broker.stop().await;
}

/// Whether a message without a receipt is refused, by an error of its own that names the slow robot.
async fn is_refused(sender: &mut Raw, note: Parcel) -> bool {
    let id = sender.post(note).await;
    let pong = sender.post(Parcel::new(Family::Time, "ping")).await;
    let mut refused = false;
    loop {
        let parcel = sender.next().await.expect("it stays");
        if parcel.reference == Some(id) {
            let error = WireError::from_parcel(&parcel);
            assert_eq!(error.code, Code::TRY_LATER, "{error}");
            let slow = error.get("slow").and_then(Value::as_list);
            assert_eq!(slow, Some(&[Value::from("arm")][..]), "{error}");
            refused = true;
        }
        if parcel.reference == Some(pong) {
            return refused;
        }
    }
}

/// A robot that reads too slowly for what a peer sends stays, and hears its owner; who sends hears that it does not
/// get it, and others do.
#[tokio::test]
async fn a_device_is_not_put_out_by_who_owns_nothing() {
    let (broker, address) = start(1).await;
    let mut robot = robot(address).await;
    let mut operator = member(address, "alice").await;
    let fence = own(&mut operator).await;
    let [mut bob, mut carol, mut viewer] = [
        member(address, "bob").await,
        member(address, "carol").await,
        member(address, "carol").await,
    ];
    let viewers = viewer.name().to_owned();
    let seen = tokio::spawn(async move {
        let mut notes = 0;
        while let Some(Some(parcel)) = viewer.next_within(Duration::from_secs(600)).await {
            if parcel.is(Family::Message, "last") {
                break;
            }
            notes += usize::from(parcel.is(Family::Message, "note"));
        }
        notes
    });
    // Not to those who read only what they wait for: they would be too slow.
    let note = |priority| {
        let mut note = note(priority);
        note.address = Some(vec!["arm".into(), viewers.as_str().into()]);
        note
    };
    let mut refused = 0;
    for sent in 0..200 {
        refused += u64::from(is_refused(&mut bob, note(100)).await);
        if sent % 50 == 0 {
            let told = operator.ask(command(fence, sent)).await.expect("it is taken");
            assert_eq!(
                told.value().get("dropped"),
                Some(&Value::List(Vec::new())),
                "{sent}"
            );
        }
    }
    assert!(refused > 100, "{refused}");
    // Bob has his share, and carol has hers.
    let mut small = note(0);
    small.receipt = Some(true);
    let told = carol.ask(small).await.expect("it is taken").value();
    assert_eq!(told.get("dropped"), Some(&Value::List(Vec::new())), "{told:?}");
    let mut large = note(0);
    large.receipt = Some(true);
    let told = bob.ask(large).await.expect("others get it").value();
    assert_eq!(
        told.get("slow"),
        Some(&vec![Value::from("arm")].into()),
        "{told:?}"
    );
    let mut last = message("last", ARM, 1);
    last.address = Some(vec!["arm".into(), viewers.as_str().into()]);
    last.receipt = Some(true);
    carol.ask(last).await.expect("it is taken");
    assert_eq!(seen.await.expect("it reads"), 202, "others get all");
    // It was never closed: the commands come first, and what was taken for it comes.
    for number in [0, 50, 100, 150] {
        let command = robot.next_of(Family::Message, "command").await;
        assert_eq!(command.value(), Value::from(format!("move {number}").as_str()));
    }
    robot.next_of(Family::Message, "last").await;
    broker.check();
    broker.stop().await;
}

/// What another peer has waiting for it does not count when its owner says something.
#[tokio::test]
async fn a_large_message_of_anothers_is_no_reason_to_close_it() {
    let (broker, address) = start(1).await;
    let mut robot = robot(address).await;
    let mut operator = member(address, "alice").await;
    let fence = own(&mut operator).await;
    let mut bob = member(address, "bob").await;
    let mut map = message("map", ARM, Value::Binary(vec![7; 6 << 20].into()));
    map.address = Some(vec!["arm".into()]);
    map.receipt = Some(true);
    bob.ask(map).await.expect("there is room");
    for number in 0..5 {
        let told = operator.ask(command(fence, number)).await;
        let told = told.expect("it is taken").value();
        assert_eq!(told.get("dropped"), Some(&Value::List(Vec::new())), "{number}");
        bob.check_alive().await;
    }
    for number in 0..5 {
        let command = robot.next_of(Family::Message, "command").await;
        assert_eq!(command.value(), Value::from(format!("move {number}").as_str()));
    }
    robot.next_of(Family::Message, "map").await;
    broker.check();
    broker.stop().await;
}

/// Stops wait where a newer one takes their place, and not in the network, where everything would be behind them.
#[tokio::test]
async fn stops_again_and_again_are_no_queue_before_a_device() {
    let (broker, address) = start(60_000).await;
    let mut robot = robot(address).await;
    let mut bob = member(address, "bob").await;
    for _ in 0..1500 {
        let stop = Parcel::new(Family::Context, "stop").context(at(ARM));
        let stop = bob.ask(stop.content(Map::new().with("within", 1))).await;
        stop.expect("everybody may");
    }
    let mut alice = member(address, "alice").await;
    let own = alice.name().to_owned();
    let stop = Parcel::new(Family::Context, "stop").context(at(ARM));
    let stop = alice.ask(stop.content(Map::new().with("within", 1))).await;
    stop.expect("everybody may");
    let mut before = 0;
    loop {
        let stop = robot.next_of(Family::Message, "stop").await;
        if stop.sender.as_deref() == Some(own.as_str()) {
            break;
        }
        before += 1;
    }
    assert!(before < 500, "{before} of 1500 stops are before the newest");
    broker.stop().await;
}

/// Of who comes and goes, and of who has its token, a device hears before its owner's commands: nobody has it hear of nothing else.
#[tokio::test]
async fn nobody_fills_what_the_hub_itself_has_to_say_to_a_device() {
    let (broker, address) = start_with(|config| {
        config.limits.outbox = 256 << 10;
        config.limits.requests = Limit::Unlimited;
    })
    .await;
    let mut robot = robot(address).await;
    let mut bob = member(address, "bob").await;
    let mut ask = async |verbs: [(Family, &str); 2], path: &str, times: usize| {
        let mut refused = 0;
        for (family, verb) in verbs.into_iter().cycle().take(times) {
            refused += usize::from(bob.ask_about(family, verb, path).await.is_err());
        }
        refused
    };
    let comings = [(Family::Context, "leave"), (Family::Context, "join")];
    assert_eq!(ask(comings, ARM, 6000).await, 0);
    let grabs = [(Family::Token, "grab"), (Family::Token, "release")];
    let refused = ask(grabs, "/robot/token", 3000).await;
    // A release of what is not held is refused, too.
    assert!(refused > 2000, "{refused} of 3000");
    let mut operator = member(address, "alice").await;
    let fence = own(&mut operator).await;
    operator.ask(command(fence, 1)).await.expect("it is taken");
    let mut before = 0;
    loop {
        let parcel = robot.next().await.expect("it is not closed");
        if parcel.is(Family::Message, "command") {
            break;
        }
        before += usize::from(parcel.family == Family::Event);
    }
    assert!(before < 1000, "{before} events came before the command");
    broker.stop().await;
}

/// Where its channel says how fast it reads, no more waits for a device of what others say than it reads in a second.
#[tokio::test]
async fn no_more_waits_for_a_device_than_it_reads_in_a_second() {
    let (broker, address) = start(60_000).await;
    let mut bob = Raw::login(address, Form::Binary, "bob").await;
    bob.join(&["/free"]).await;
    let radio = Parcel::new(Family::Context, "create").context(at("/free/radio"));
    let radio = |pace: i64| {
        radio
            .clone()
            .content(Map::new().with("kind", "channel").with("pace", pace))
    };
    let error = bob.ask(radio(999)).await.expect_err("nothing reads so slowly");
    assert_eq!(error.code, Code::BAD_CONTENT);
    assert_eq!(error.get("slot"), Some(&Value::from("content/pace")));
    bob.ask(radio(60_000)).await.expect("they may make one");
    let mut rover = Raw::connect_small(address, Form::Binary).await;
    rover.log_in("arm").await;
    rover.join(&["/free"]).await;
    let join = Parcel::new(Family::Context, "join").context(at("/free/radio"));
    let joined = rover.ask(join.content(Map::new().with("device", true))).await;
    joined.expect("it may be a device");
    bob.join(&["/free/radio"]).await;
    let mut dropped = 0;
    for _ in 0..200 {
        let mut note = message("note", "/free/radio", Value::Binary(vec![7; 5000].into()));
        (note.echo, note.receipt) = (Some(false), Some(true));
        let told = bob.ask(note).await.expect("others would get it").value();
        dropped += usize::from(told.get("slow").is_some());
    }
    // The network between them holds some.
    assert!(dropped > 100, "of 1 MB {dropped} of 200 notes were refused");
    rover.next_of(Family::Message, "note").await;
    broker.stop().await;
}

/// Invites the arm to 150 channels; to how many it may.
async fn invite_again_and_again(bob: &mut Raw) -> usize {
    bob.join(&["/free"]).await;
    let mut invited = 0;
    for number in 0..150 {
        let room = at(&format!("/free/room-{number}"));
        let create = Parcel::new(Family::Context, "create").context(room.clone());
        let made = bob.ask(create.content(Map::new().with("kind", "channel"))).await;
        made.expect("permitted");
        bob.join(&[room.as_str()]).await;
        let invite = Parcel::new(Family::Context, "invite").context(room);
        let invite = invite.content(Map::new().with("peer", "arm"));
        invited += usize::from(bob.ask(invite).await.is_ok());
    }
    invited
}

/// What others want of an owner, and of its device, and what was dropped on its way to that, is told in a few words, and not without end.
#[tokio::test]
async fn nobody_fills_what_an_owner_and_a_device_hear_of_others() {
    let (broker, address) = start_with(|config| config.limits.outbox = 256 << 10).await;
    let mut robot = robot(address).await;
    let mut operator = Raw::connect_small(address, Form::Binary).await;
    operator.log_in("alice").await;
    operator.join(&["/robot", ARM]).await;
    let fence = own(&mut operator).await;
    let mut bobs = Vec::new();
    for _ in 0..60 {
        let mut bob = member(address, "bob").await;
        for _ in 0..4 {
            let wish = Map::new()
                .with("within", 1)
                .with("text", "x".repeat(60_000).as_str());
            let request = Parcel::new(Family::Token, "request").context(at("/robot/token"));
            bob.post(request.content(wish)).await;
        }
        bobs.push(bob);
    }
    let invited = invite_again_and_again(&mut bobs[0]).await;
    assert!((100..150).contains(&invited), "{invited}");
    // Newer states replace older ones, of each sender; the first ones fill what is under way.
    for round in 0..8 {
        for bob in &mut bobs {
            let mut state = message("state", ARM, Value::Binary(vec![7; 2000].into()));
            (state.delivery, state.address) = (Some(Delivery::Latest), Some(vec!["arm".into()]));
            state.receipt = Some(round == 7);
            bob.post(state).await;
        }
    }
    for bob in &mut bobs {
        bob.next_of(Family::Reply, "ok").await;
    }
    operator
        .ask(command(fence, 1))
        .await
        .expect("it is taken, and the owner was not closed");
    let (mut bytes, mut drops) = (0, 0);
    loop {
        let parcel = robot.next().await.expect("it is not closed");
        if parcel.is(Family::Message, "command") {
            break;
        }
        bytes += if parcel.family == Family::Event {
            parcel.size()
        } else {
            0
        };
        drops += usize::from(parcel.is(Family::Event, "dropped"));
    }
    assert!(
        bytes < 100_000 && drops < 20,
        "{bytes} bytes of events, {drops} of drops"
    );
    broker.stop().await;
}

/// Who has lost its link gets no commands, and their owner hears of that; not of each of many.
#[tokio::test]
async fn nobody_has_an_owner_hear_of_each_of_many_that_are_gone() {
    let (broker, address) = start_with(|config| config.limits.outbox = 256 << 10).await;
    let mut robot = robot(address).await;
    let mut operator = member(address, "alice").await;
    let fence = own(&mut operator).await;
    for _ in 0..100 {
        let mut bob = Raw::connect_small(address, Form::Binary).await;
        let content = Map::new()
            .with("name", "bob")
            .with("password", "bob")
            .with("link", true);
        let login = Parcel::new(Family::Login, "login").content(content);
        let welcome = bob.ask(login).await.expect("he may");
        assert!(welcome.value().get("link").is_some(), "{welcome:?}");
        bob.join(&["/robot", ARM]).await;
    }
    let mut told = (0, 0, 0);
    for number in 0..20 {
        operator.ask(command(fence, number)).await.expect("it is taken");
        robot.next_of(Family::Message, "command").await;
        while let Some(Some(parcel)) = operator.next_within(Duration::from_millis(300)).await {
            if parcel.is(Family::Event, "dropped") {
                let content = parcel.value();
                told.0 += 1;
                told.1 += content.get("receivers").and_then(Value::as_int).unwrap_or(1);
                told.2 += content.get("count").and_then(Value::as_int).unwrap_or_default();
            }
        }
    }
    let (events, receivers, count) = told;
    assert!(receivers >= 1500 && count >= 1500, "{told:?}");
    assert!(events <= 60, "{events} events of {receivers} receivers");
    broker.check();
    broker.stop().await;
}

/// Makes and deletes in a hall, asks the arm as a chair there, comes and goes; gives who is still there.
async fn do_much(bob: &mut Raw, address: SocketAddr) -> Vec<Raw> {
    let about = |family, name: &str, path: &str, content: Map| {
        let parcel = Parcel::new(family, name).context(at(path));
        parcel.content(content)
    };
    let token = |number: usize| format!("/hall/{}{number}", "n".repeat(800));
    for number in 0..150 {
        let kind = Map::new().with("kind", "token");
        let create = about(Family::Context, "create", &token(number), kind);
        bob.ask(create).await.expect("everybody may");
    }
    for number in 0..150 {
        let delete = about(Family::Context, "delete", &token(number), Map::new());
        bob.ask(delete).await.expect("it is his");
    }
    let chairs = Map::new().with("users", vec!["arm".into()]);
    let manager = Map::new()
        .with("kind", "moderated")
        .with("chairs", chairs)
        .with("within", 1)
        .with("verbs", vec!["grab".into()]);
    let asking = Map::new().with("kind", "token").with("manager", manager);
    let create = about(Family::Context, "create", "/hall/asking", asking);
    bob.ask(create).await.expect("everybody may");
    let mut ghosts = Vec::new();
    for _ in 0..20 {
        let mut ghost = Raw::login(address, Form::Binary, "bob").await;
        ghost.join(&["/hall", "/robot", "/hall/asking"]).await;
        ghost
            .post(about(Family::Token, "grab", "/hall/asking", Map::new()))
            .await;
        for _ in 0..10 {
            ghost
                .ask_about(Family::Context, "leave", "/hall")
                .await
                .expect("he is there");
            ghost.join(&["/hall", "/hall/asking"]).await;
        }
        ghosts.push(ghost);
    }
    ghosts
}

/// Whatever others do where a slow device is, and however long its names are: of that no more than the hub lets go ahead comes before the
/// owner's commands, the device is not closed for it, and it hears that it has missed some.
#[tokio::test]
async fn what_others_do_comes_behind_the_owners_commands() {
    let hall = Map::new().with("path", "/hall").with("kind", "session");
    let (broker, address) = start_with(|config| {
        let mut contexts = config.contexts.iter_mut();
        let arm = contexts.find(|spec| spec.path.as_deref() == Some(ARM));
        arm.expect("the arm's channel").pace = Some(6000);
        config.limits.outbox = 256 << 10;
        config.contexts.push(from_value(hall.into()).expect("a context"));
    })
    .await;
    let mut robot = robot(address).await;
    robot.join(&["/hall"]).await;
    let mut operator = member(address, "alice").await;
    let fence = own(&mut operator).await;
    let mut bob = member(address, "bob").await;
    bob.join(&["/hall"]).await;
    let ghosts = do_much(&mut bob, address).await;
    operator.ask(command(fence, 1)).await.expect("it is taken");
    let (mut ahead, mut bytes) = (0, 0);
    loop {
        let parcel = robot.next().await.expect("it is not closed");
        if parcel.is(Family::Message, "command") {
            break;
        }
        ahead += 1;
        bytes += parcel.size();
    }
    // What the network holds, and half a second of what the device reads.
    assert!(bytes <= 16 << 10, "{ahead} of {bytes} bytes");
    let missed = loop {
        let parcel = robot.next_within(Duration::from_secs(20)).await;
        let parcel = parcel.flatten().expect("it is told");
        let content = parcel.value();
        let sender = content.get("sender").and_then(Value::as_str);
        if parcel.is(Family::Event, "dropped") && sender == Some("hub") {
            break content.get("count").and_then(Value::as_int).unwrap_or_default();
        }
    };
    assert!(missed > 0);
    drop(ghosts);
    broker.check();
    broker.stop().await;
}
