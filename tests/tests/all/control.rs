//! Waiting for, giving, asking for, sharing and breaking tokens, through the client and a real broker.

use std::time::Duration;

use mom_broker::Broker;
use mom_client::{Client, Code, Event, Events, Map, Token};
use mom_tests::lab;
use mom_tests::programs::PATIENCE;
use tokio::sync::mpsc;
use tokio::time::timeout;

const TOKEN: &str = "/desk/token";

/// A broker with a token that everybody in the lab may grab, and two peers that have joined it.
struct Desk {
    broker: Broker,
    alice: Client,
    bob: Client,
    carol: Client,
}

impl Desk {
    async fn start() -> Desk {
        let broker = lab::start().await;
        let carol = log_in(&broker, "carol").await;
        let open = || Map::new().with("manager", "open");
        let session = open().with("kind", "session");
        carol.create("/desk", session).await.expect("an operator may");
        let token = open().with("kind", "token").with("lease", 180_000);
        carol.create(TOKEN, token).await.expect("an operator may");
        Desk {
            alice: log_in(&broker, "alice").await,
            bob: log_in(&broker, "bob").await,
            carol,
            broker,
        }
    }

    async fn tokens(&self) -> (Token, Token) {
        let (alice, bob) = tokio::join!(self.alice.token(TOKEN), self.bob.token(TOKEN));
        (alice.expect("the desk is open"), bob.expect("the desk is open"))
    }

    async fn end(self) {
        self.broker.stop().await;
    }
}

async fn log_in(broker: &Broker, name: &str) -> Client {
    let builder = Client::builder(format!("bin://{}", broker.local_addr()));
    let connected = builder.user(name).password(name).connect().await;
    connected.expect("a user of the lab")
}

/// The first event that is looked for.
async fn find<T>(events: &mut Events, what: &str, find: impl Fn(Event) -> Option<T>) -> T {
    let found = timeout(PATIENCE, async {
        loop {
            let event = events.next().await.expect("the context stays");
            if let Some(found) = find(event) {
                return found;
            }
        }
    });
    found.await.unwrap_or_else(|_| panic!("{what} never came"))
}

#[tokio::test]
async fn who_waits_is_told_its_place_and_has_its_turn() {
    let desk = Desk::start().await;
    let (alice, bob) = desk.tokens().await;
    let guard = alice.grab().await.expect("free");
    let refused = bob.grab().await.expect_err("held");
    let refusal = refused.refusal().expect("the hub refuses");
    assert_eq!(
        (refusal.code, refusal.owner, refusal.place),
        (&Code::HELD, Some("alice"), Some(1))
    );
    let (places, mut told) = mpsc::unbounded_channel();
    let wait = bob.grab().wait(PATIENCE).on_place(move |place| {
        let _ = places.send(place.place);
    });
    let (granted, fence) = tokio::join!(wait, async {
        assert_eq!(told.recv().await, Some(1));
        let queue = alice.status().await.expect("a member may ask").queue;
        assert_eq!((queue.len(), queue[0].member.peer.as_str()), (1, "bob"));
        let fence = guard.fence();
        guard.release().await.expect("the owner may");
        fence
    });
    assert!(granted.expect("it is bob's turn").fence() > fence);
    desk.end().await;
}

#[tokio::test]
async fn a_wait_ends_in_time_or_when_it_is_given_up() {
    let desk = Desk::start().await;
    let (alice, bob) = desk.tokens().await;
    let _guard = alice.grab().await.expect("free");
    let late = bob.grab().wait(Duration::from_millis(50)).await;
    let late = late.expect_err("alice holds it");
    assert_eq!(
        (late.code(), late.refusal().and_then(|refusal| refusal.owner)),
        (Some(&Code::TIMED_OUT), Some("alice"))
    );
    let (places, mut told) = mpsc::unbounded_channel();
    let wait = bob.grab().wait_forever().on_place(move |place| {
        let _ = places.send(place.place);
    });
    tokio::select! {
        _ = wait => panic!("alice holds it"),
        place = told.recv() => assert_eq!(place, Some(1)),
    }
    // The withdrawal goes before this question.
    assert_eq!(bob.status().await.expect("a member may ask").queue, []);
    desk.end().await;
}

#[tokio::test]
async fn what_is_given_for_a_time_comes_back() {
    let desk = Desk::start().await;
    let (alice, bob) = desk.tokens().await;
    let mut offers = bob.events();
    let guard = alice.grab().await.expect("free");
    let given = guard
        .give("bob")
        .time(Duration::from_millis(100))
        .commands(5)
        .await;
    let mut given = given.expect("bob is here");
    let commands = find(&mut offers, "the offer", |event| match event {
        Event::Offer { to, commands, .. } if to == "bob" => Some(commands),
        _ => None,
    });
    assert_eq!(commands.await, Some(5));
    let offer = alice.status().await.expect("a member may ask").offer;
    let offer = offer.map(|offer| (offer.to, offer.time, offer.commands));
    let time = Some(Duration::from_millis(100));
    assert_eq!(offer, Some(("bob".to_owned(), time, Some(5))));
    let mut theirs = bob.accept().await.expect("offered");
    assert_eq!(theirs.delegation().map(|from| from.from.as_str()), Some("alice"));
    given.accepted().await.expect("bob has it");
    assert!(guard.is_lost());
    let status = alice.status().await.expect("a member may ask");
    let from = status.delegated.map(|delegated| delegated.from);
    assert!(status.owner.as_deref() != Some("bob") || from.as_deref() == Some("alice"));
    assert_eq!(theirs.lost().await.reason, "returned");
    let again = given.returned().await.expect("it comes back");
    assert!(again.fence() > theirs.fence());
    again.release().await.expect("alice owns it");
    desk.end().await;
}

#[tokio::test]
async fn an_offer_is_declined_or_in_vain() {
    let desk = Desk::start().await;
    let (alice, bob) = desk.tokens().await;
    let mut offers = bob.events();
    let guard = alice.grab().await.expect("free");
    let mut given = guard.give("bob").await.expect("bob is here");
    find(&mut offers, "the offer", |event| {
        matches!(event, Event::Offer { .. }).then_some(())
    })
    .await;
    bob.decline().await.expect("offered");
    assert_eq!(given.accepted().await.expect_err("declined").reason, "declined");
    let late = guard.give("bob").within(Duration::from_millis(20)).await;
    let mut late = late.expect("bob is here");
    assert_eq!(late.accepted().await.expect_err("too late").reason, "timed-out");
    let refused = bob.accept().await.expect_err("over");
    assert_eq!(refused.code(), Some(&Code::NO_OFFER));
    assert!(!guard.is_lost());
    desk.end().await;
}

#[tokio::test]
async fn an_owner_hands_over_to_who_asks_or_does_not() {
    let desk = Desk::start().await;
    let (alice, bob) = desk.tokens().await;
    let mut asked = alice.events();
    let mut guard = alice.grab().await.expect("free");
    let request = |event| match event {
        Event::Requested { member, text, .. } => Some((member.peer, text)),
        _ => None,
    };
    let (declined, ()) = tokio::join!(bob.request().text("please"), async {
        let (peer, text) = find(&mut asked, "the request", request).await;
        assert_eq!((peer.as_str(), text.as_deref()), ("bob", Some("please")));
        let requests = alice.status().await.expect("a member may ask").requests;
        assert_eq!((requests.len(), requests[0].peer.as_str()), (1, "bob"));
        alice.decline_request(&peer, "soon").await.expect("asked");
    });
    assert_eq!(declined.expect_err("declined").code(), Some(&Code::DECLINED));
    let (granted, ()) = tokio::join!(bob.request(), async {
        let (peer, _) = find(&mut asked, "the request", request).await;
        alice.accept_request(&peer).await.expect("asked");
    });
    assert!(granted.expect("handed over").fence() > guard.fence());
    assert_eq!(guard.lost().await.reason, "given");
    desk.end().await;
}

#[tokio::test]
async fn a_shared_hold_keeps_everybody_off_until_it_ends() {
    let desk = Desk::start().await;
    let (alice, bob) = desk.tokens().await;
    let one = alice.inhibit().await.expect("free");
    let mut two = bob.inhibit().await.expect("shared");
    let held = bob.grab().await.expect_err("nobody may");
    let holders = held.refusal().map(|refusal| refusal.holders.len());
    assert_eq!(holders, Some(2));
    one.release().await.expect("alice takes part");
    assert_eq!(alice.status().await.expect("a member may ask").holders, ["bob"]);
    assert_eq!(alice.break_hold().await.expect("the desk is open"), ["bob"]);
    assert_eq!(two.lost().await.reason, "broken");
    let mut guard = alice.grab().await.expect("free");
    assert_eq!(bob.break_hold().await.expect("the desk is open"), ["alice"]);
    assert_eq!(guard.lost().await.reason, "broken");
    desk.end().await;
}

#[tokio::test]
async fn who_is_expelled_is_out_and_who_is_invited_is_told() {
    let desk = Desk::start().await;
    let bob = desk.bob.token(TOKEN).await.expect("the desk is open");
    let mut guard = bob.grab().await.expect("free");
    let mut events = bob.events();
    let minute = Some(Duration::from_secs(60));
    let expelled = desk.carol.expel("/desk", "bob", "lunch", minute).await;
    expelled.expect("the desk is open");
    assert_eq!(guard.lost().await.reason, "revoked");
    while timeout(PATIENCE, events.next()).await.expect("it ends").is_some() {}
    desk.bob.token(TOKEN).await.expect_err("kept out");
    let mut others = desk.alice.unaddressed();
    let invited = desk.carol.invite("/desk", "alice").await;
    invited.expect("the desk is open");
    let by = find(&mut others, "the invitation", |event| match event {
        Event::Invited { by, .. } => Some(by),
        _ => None,
    });
    assert_eq!(by.await, "carol");
    desk.end().await;
}

#[tokio::test]
async fn the_creator_of_a_context_answers_for_it() {
    let desk = Desk::start().await;
    let mut consults = desk.carol.consults();
    let spec = Map::new().with("kind", "channel").with("manager", "self");
    desk.carol
        .create("/desk/talk", spec)
        .await
        .expect("the desk is open");
    let (refused, ()) = tokio::join!(desk.bob.channel("/desk/talk"), async {
        let consult = consults.next().await.expect("a question");
        assert_eq!((consult.verb.as_str(), consult.user.as_str()), ("join", "bob"));
        consult.deny("not today").await.expect("in time");
    });
    let words = refused.expect_err("denied").to_string();
    assert!(words.contains("not today"), "{words}");
    let (joined, ()) = tokio::join!(desk.bob.channel("/desk/talk"), async {
        let consult = consults.next().await.expect("a question");
        let late = consult.clone();
        consult.allow_from_now_on().await.expect("in time");
        let error = late.allow().await.expect_err("answered already");
        assert_eq!(error.code(), Some(&Code::TOO_LATE));
    });
    joined.expect("allowed");
    desk.end().await;
}
