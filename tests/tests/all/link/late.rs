//! What moves a device, lets it move or changes who drives it is of its moment: said before a cut, nobody hears it after the link
//! goes on.

use std::time::Duration;

use mom_broker::Broker;
use mom_client::{After, Client, ClientError, ErrorKind, Event, Events, Message, Reconnect};
use mom_proto::codec::Form;
use mom_proto::{Code, Family, Map, Parcel, Value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::lab;
use mom_tests::linked::Linked;
use mom_tests::programs::PATIENCE;
use mom_tests::raw::{Raw, at};
use tokio::time::timeout;

use super::{GRACE, chat, command, int, lose, resent, resume};

const ARM: &str = "/robot/arm";
const TOKEN: &str = "/robot/token";

/// Alice, whose connections go through a network that fails.
async fn behind(network: &FaultyNetwork) -> Client {
    let quick = Reconnect {
        first: Duration::from_millis(1),
        most: Duration::from_millis(10),
        give_up_after: None,
    };
    let builder = Client::builder(format!("bin://{}", network.address))
        .user("alice")
        .password("alice")
        .link(Duration::from_secs(60))
        .reconnect(quick);
    builder.connect().await.expect("alice")
}

async fn in_time<T>(future: impl Future<Output = T>) -> T {
    timeout(PATIENCE, future).await.expect("in time")
}

async fn until_resumed(events: &mut Events) {
    let mut down = false;
    loop {
        match in_time(events.next()).await.expect("the channel stays") {
            Event::LinkDown => down = true,
            Event::Resumed => return assert!(down),
            _ => {}
        }
    }
}

/// The messages of alice that come to a member, up to the one of this name.
async fn heard(raw: &mut Raw, last: &str) -> Vec<String> {
    let mut names = Vec::new();
    while names.last().is_none_or(|name| name != last) {
        let parcel = in_time(raw.next()).await.expect("it stays");
        if parcel.family == Family::Message && parcel.sender.as_deref() == Some("alice") {
            let text = parcel.value().as_str().unwrap_or_default().to_owned();
            names.push(format!("{} {text}", parcel.name()).trim_end().to_owned());
        }
    }
    names
}

fn said(message: Message) -> tokio::task::JoinHandle<Result<(), ClientError>> {
    tokio::spawn(async move { message.send_acknowledged().await.map(drop) })
}

/// From a client: in a guarded channel, in one that is not, whether a caller waits for the answer or not.
#[tokio::test]
async fn a_client_says_no_command_again_after_a_cut() {
    let broker = lab::start().await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    let mut bob = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    bob.join(&["/robot", ARM, "/chat"]).await;
    let alice = behind(&network).await;
    let arm = alice.channel(ARM).await.expect("anybody may");
    let talk = alice.channel("/chat").await.expect("anybody may");
    let token = alice.token(TOKEN).await.expect("anybody may look");
    let guard = token.grab().await.expect("it is free");
    let mut events = talk.events();
    network.stall();
    let mut awaited = Vec::new();
    for channel in [&arm, &talk] {
        channel.send("command", "before").await.expect("it waits");
        awaited.push(said(channel.message("command").content("before, and awaited")));
    }
    awaited.push(said(arm.message("unstop")));
    arm.send("unstop", Value::Null).await.expect("it waits");
    talk.send("say", "before").await.expect("it waits");
    // They are on their way, for all that alice knows.
    tokio::task::yield_now().await;
    network.sever();
    until_resumed(&mut events).await;
    for waiting in awaited {
        let error = in_time(waiting)
            .await
            .expect("no panic")
            .expect_err("nobody has it");
        assert!(
            matches!(error.kind(), ErrorKind::Unknown | ErrorKind::Connection),
            "{error}"
        );
    }
    arm.send("command", "after").await.expect("hers still");
    talk.send("command", "after").await.expect("anybody may");
    talk.send("end", Value::Null).await.expect("anybody may");
    assert_eq!(
        heard(&mut bob, "end").await,
        ["say before", "command after", "command after", "end"],
        "and nothing else of before"
    );
    guard.release().await.expect("hers all the time");
    broker.stop().await;
}

/// While there is no connection, the caller hears so at once.
#[tokio::test]
async fn what_would_be_late_is_refused_while_there_is_no_connection() {
    let broker = lab::start().await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    let alice = behind(&network).await;
    let arm = alice.channel(ARM).await.expect("anybody may");
    let talk = alice.channel("/chat").await.expect("anybody may");
    let guard = alice.token(TOKEN).await.expect("anybody").grab().await;
    let guard = guard.expect("it is free");
    let mut events = arm.events();
    // Nobody takes the next connection.
    drop(network);
    loop {
        if let Event::LinkDown = in_time(events.next()).await.expect("the channel stays") {
            break;
        }
    }
    for late in [
        arm.send("command", "late").await,
        arm.send("unstop", Value::Null).await,
        talk.send("command", "late").await,
        guard.give("bob").await.map(drop),
    ] {
        let error = late.expect_err("too late");
        assert_eq!(error.kind(), ErrorKind::Connection, "{error}");
        assert!(error.to_string().contains("too late"), "{error}");
    }
    arm.send("stop", Value::Null).await.expect("it is never too late");
    broker.stop().await;
}

/// From the hub: a device that had not read a command or an unstop does not hear it when it comes back.
#[tokio::test]
async fn a_device_hears_no_command_and_no_unstop_of_before() {
    let broker = lab::start().await;
    let address = broker.local_addr();
    let mut alice = Raw::login(address, Form::Json, "alice").await;
    alice.join(&["/robot", ARM, "/chat"]).await;
    let say = |name: &str, path: &str| Parcel::new(Family::Message, name).context(at(path));
    let mut arm = Linked::login(address, Form::Binary, "arm", GRACE).await;
    for path in ["/robot", ARM, "/chat"] {
        arm.about(Family::Context, "join", path).await;
    }
    alice.send_parcel(&say("stop", ARM)).await;
    let mut unstop = say("unstop", ARM);
    unstop.extra.set("stop", alice.newest_stop(ARM).await);
    for parcel in [unstop.clone(), say("command", "/chat")] {
        alice.send_parcel(&parcel).await;
    }
    alice.check_alive().await;
    let link = lose(arm);
    alice.next_of(Family::Event, "lost").await;
    for parcel in [unstop, say("command", "/chat"), say("say", "/chat")] {
        alice.send_parcel(&parcel).await;
    }
    let mut dropped = 0;
    while dropped < 2 {
        let told = alice.next_of(Family::Event, "dropped").await.value();
        assert_eq!(told.get("reason").and_then(Value::as_str), Some("lost"));
        dropped += int(&told, "count");
    }
    let (mut arm, _) = resume(&link, address, Form::Binary).await;
    alice.send_parcel(&say("end", "/chat")).await;
    let mut names = Vec::new();
    while names.last().is_none_or(|name| name != "end") {
        let parcel = in_time(arm.next()).await.expect("it stays");
        if parcel.family == Family::Message {
            names.push(parcel.name().to_owned());
        }
    }
    assert_eq!(names, ["stop", "say", "end"]);
    broker.stop().await;
}

/// Should a peer say such things again, the hub refuses them until it has heard that all that follows is new.
#[tokio::test]
async fn the_hub_refuses_what_is_said_again() {
    let broker = lab::start().await;
    let address = broker.local_addr();
    let mut carol = Linked::login(address, Form::Json, "carol", GRACE).await;
    for path in ["/robot", ARM, "/chat"] {
        carol.about(Family::Context, "join", path).await;
    }
    let fence = int(&carol.about(Family::Token, "grab", TOKEN).await, "fence");
    let link = lose(carol);
    let (mut carol, _) = resume(&link, address, Form::Binary).await;
    let token = |name: &str| Parcel::new(Family::Token, name).context(at(TOKEN));
    let to = |peer: &str| Map::new().with("to", peer).with("peer", peer);
    let late = || {
        [
            (chat("hello"), None),
            (command("grip open"), Some(Code::OLDER_FENCE)),
            (
                Parcel::new(Family::Message, "command").context(at("/chat")),
                Some(Code::TOO_LATE),
            ),
            (
                Parcel::new(Family::Message, "unstop").context(at(ARM)),
                Some(Code::TOO_LATE),
            ),
            (Parcel::new(Family::Message, "stop").context(at(ARM)), None),
            (token("give").content(to("arm")), Some(Code::TOO_LATE)),
            (token("accept").content(to("arm")), Some(Code::TOO_LATE)),
            (token("inhibit"), Some(Code::TOO_LATE)),
            (token("release"), Some(Code::TOO_LATE)),
            (token("renew"), None),
        ]
    };
    for (mut parcel, code) in late() {
        let what = format!("{} {}", parcel.family, parcel.name());
        if parcel.family == Family::Message {
            parcel.receipt = Some(true);
        }
        let answer = in_time(carol.ask(parcel)).await;
        assert_eq!(answer.err().map(|error| error.code), code, "{what}");
    }
    let mut older = token("release");
    older.fence = u64::try_from(fence - 1).ok();
    let error = carol.ask(older.clone()).await.expect_err("of an earlier one");
    assert_eq!(error.code, Code::OLDER_FENCE, "{error}");
    carol.raw.send_parcel(&resent()).await;
    // That holds at any time.
    let error = carol.ask(older).await.expect_err("of an earlier one");
    assert_eq!(error.code, Code::OLDER_FENCE, "{error}");
    let mut unstop = Parcel::new(Family::Message, "unstop").context(at(ARM));
    unstop.extra.set("stop", carol.raw.newest_stop(ARM).await);
    unstop.receipt = Some(true);
    carol.ask(unstop).await.expect("it is new");
    carol.ask(token("release")).await.expect("hers all the time");
    broker.stop().await;
}

/// What comes of twenty commands that an owner says in one go before it gives the token back.
async fn twenty(broker: &Broker, client: Client, after: Option<Duration>) {
    const COUNT: usize = 20;
    let mut bob = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    bob.join(&["/robot", ARM]).await;
    let arm = client.channel(ARM).await.expect("anybody may");
    let mut events = arm.events();
    let token = client.token(TOKEN).await.expect("anybody may look");
    let guard = token.grab().await.expect("it is free");
    let large = "x".repeat(20_000);
    for number in 0..COUNT {
        // Large and small, of all priorities: none is left behind.
        let text = if number % 3 == 0 {
            large.as_str()
        } else {
            "grip open"
        };
        let priority = i32::try_from(number).expect("few") - 10;
        let command = arm.message("command").content(text).priority(priority);
        command.send().await.expect("it waits");
    }
    let released = match after {
        None => guard.release().await,
        Some(most) => guard.release_after(After::Taken, most).await,
    };
    released.expect("it was hers");
    let mut heard = 0;
    loop {
        let parcel = in_time(bob.next()).await.expect("he stays");
        heard += usize::from(parcel.is(Family::Message, "command"));
        if parcel.is(Family::Event, "released") {
            break;
        }
    }
    // What has not left for bob when the token is free does not leave any more, and its sender is told.
    while heard < COUNT {
        match in_time(events.next()).await.expect("the channel stays") {
            Event::Refused(..) => heard += 1,
            Event::Dropped { count, parcel, .. } => {
                let receiver = parcel.value().get("receiver").cloned();
                if receiver == Some("bob".into()) {
                    heard += usize::try_from(count).expect("few");
                }
            }
            _ => {}
        }
    }
    assert_eq!(heard, COUNT, "each once");
}

#[tokio::test]
async fn what_is_said_before_a_release_is_heard_before_it() {
    let broker = lab::start().await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    for after in [None, Some(Duration::from_secs(10))] {
        twenty(&broker, behind(&network).await, after).await;
        let builder = Client::builder(format!("tcp://{}", broker.local_addr()));
        let plain = builder.user("alice").password("alice").nickname("ally");
        twenty(&broker, plain.connect().await.expect("alice"), after).await;
    }
    broker.stop().await;
}

/// Nobody answers any more: the token is given back all the same, as soon as there is a connection.
#[tokio::test]
async fn who_waits_for_the_hub_before_a_release_waits_no_longer_than_it_wants() {
    let broker = lab::start().await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    let alice = behind(&network).await;
    let arm = alice.channel(ARM).await.expect("anybody may");
    let token = alice.token(TOKEN).await.expect("anybody may look");
    let guard = token.grab().await.expect("it is free");
    network.stall();
    arm.send("command", "grip open").await.expect("it waits");
    let releasing = tokio::spawn(guard.release_after(After::Taken, Duration::from_millis(50)));
    let mut events = arm.events();
    tokio::time::sleep(Duration::from_millis(100)).await; // tidy: the time that the caller gives is over
    network.sever();
    until_resumed(&mut events).await;
    let error = in_time(releasing).await.expect("no panic").expect_err("in vain");
    assert_eq!(error.kind(), ErrorKind::TimedOut, "{error}");
    let status = token.status().await.expect("anybody may look");
    assert_eq!(status.owner, None);
    broker.stop().await;
}
