//! What a link goes on with, and who may go on with it.

use mom_proto::codec::Form;
use mom_proto::{Code, Family, Limit, Parcel, ReadCount, Value, WireError};
use mom_tests::lab;
use mom_tests::linked::{Link, Linked};
use mom_tests::programs::PATIENCE;
use mom_tests::raw::{Raw, at};
use tokio::time::timeout;

use super::{GRACE, chat, chatting, int, lose, numbered, resent, resume, texts};

/// Messages and events that were not read, and an event that is new, come in another form, the events in their order.
#[tokio::test]
async fn what_was_not_read_comes_in_another_form_with_what_is_new() {
    for (first, then) in [(Form::Binary, Form::Json), (Form::Json, Form::Binary)] {
        let (broker, alice, mut bob) = chatting(first).await;
        let address = broker.local_addr();
        for text in numbered(0..5) {
            bob.send_parcel(&chat(&text)).await;
        }
        bob.check_alive().await;
        let mut carol = Raw::login(address, Form::Json, "carol").await;
        carol.join(&["/chat"]).await;
        let link = lose(alice);
        bob.next_of(Family::Event, "lost").await;
        let leave = Parcel::new(Family::Context, "leave").context(at("/chat"));
        carol.ask(leave).await.expect("she is there");
        let (mut alice, _) = resume(&link, address, then).await;
        alice.raw.send_parcel(&resent()).await;
        let (mut said, mut events) = (Vec::new(), Vec::new());
        while said.len() < 5 || events.len() < 2 {
            let parcel = timeout(PATIENCE, alice.next()).await;
            let parcel = parcel.expect("more comes").expect("it goes on");
            match parcel.name() {
                "say" => said.push(parcel.value().as_str().unwrap_or_default().to_owned()),
                name @ ("joined" | "left") => events.push(name.to_owned()),
                _ => {}
            }
        }
        assert_eq!(
            (said, &*events),
            (numbered(0..5), &["joined".to_owned(), "left".to_owned()][..])
        );
        broker.stop().await;
    }
}

/// An answer that was under way for long is of a connection that its peer has given up: the connection that goes on with the link stays.
#[tokio::test]
async fn a_late_answer_to_an_older_challenge_takes_nothing_over() {
    let (broker, alice, mut bob) = chatting(Form::Binary).await;
    let address = broker.local_addr();
    let link = lose(alice);
    bob.next_of(Family::Event, "lost").await;
    let mut late = Raw::connect(address, Form::Binary).await;
    let challenge = link.challenge(&mut late).await.expect("as any");
    let (mut alice, _) = resume(&link, address, Form::Binary).await;
    let error = link.answer(&mut late, &challenge).await.expect_err("too late");
    assert_eq!(error.code, Code::NOT_RESUMED);
    bob.send_parcel(&chat("here")).await;
    assert_eq!(texts(&mut alice, 1).await, ["here"]);
    // Nor does one that has read less than was acknowledged, and it ends nothing.
    let before = link.read;
    alice.acknowledge().await;
    alice.raw.send_parcel(&resent()).await;
    alice.raw.send_parcel(&chat("and here")).await;
    bob.next_of(Family::Message, "say").await;
    let link = alice.link.clone();
    let older = Link {
        read: before,
        ..link.clone()
    };
    let (error, _) = older
        .resume(address, Form::Binary)
        .await
        .expect_err("it has read more");
    assert_eq!(error.code, Code::NOT_RESUMED);
    bob.send_parcel(&chat("still")).await;
    assert_eq!(texts(&mut alice, 2).await, ["and here", "still"]);
    let (mut alice, _) = resume(&lose(alice), address, Form::Binary).await;
    bob.send_parcel(&chat("again")).await;
    assert_eq!(texts(&mut alice, 1).await, ["again"]);
    broker.stop().await;
}

/// A peer that has counted other parcels than the hub is told so before anything comes twice, and its link ends.
#[tokio::test]
async fn a_count_of_other_parcels_ends_the_link() {
    for form in [Form::Binary, Form::Json, Form::Xml] {
        for resumes in [false, true] {
            let (broker, mut alice, mut bob) = chatting(form).await;
            for text in numbered(0..5) {
                bob.send_parcel(&chat(&text)).await;
            }
            let before = alice.link.read;
            texts(&mut alice, 5).await;
            // What it has counted of the five is right, but for the first, which it has not.
            let mut shifted = ReadCount {
                parcels: before.parcels,
                ..alice.link.read
            };
            shifted.parcels += 4;
            let error = if resumes {
                let link = Link {
                    read: shifted,
                    ..lose(alice)
                };
                let refused = link.resume(broker.local_addr(), form).await;
                refused.expect_err("other parcels").0
            } else {
                let right = std::mem::replace(&mut alice.link.read, shifted);
                alice.acknowledge().await;
                alice.link.read = right;
                alice.raw.next_error().await
            };
            assert_eq!(error.code, Code::BAD_COUNT, "{form:?} {resumes}");
            let slot = |error: &WireError| error.get("slot").and_then(Value::as_str).map(str::to_owned);
            assert_eq!(slot(&error).as_deref(), Some("content/checksum"));
            bob.next_of(Family::Event, "left").await;
            broker.stop().await;
        }
    }
}

/// Who asks too much is not read for a moment after an answer. A connection that is lost then has read what was answered.
#[tokio::test]
async fn a_request_that_was_refused_is_not_answered_again_after_a_loss() {
    let broker = lab::start_with(|config| config.limits.requests = Limit::At(1)).await;
    let address = broker.local_addr();
    let mut alice = Linked::login(address, Form::Binary, "alice", GRACE).await;
    for _ in 0..200 {
        let info = Parcel::new(Family::Context, "info").context(at("/chat"));
        alice.raw.post(info).await;
    }
    let mut answered = 0;
    while answered < 30 {
        let parcel = alice.next().await.expect("it goes on");
        answered += i64::from(parcel.reference.is_some() && parcel.family != Family::Time);
    }
    let reply = lose(alice).resume(address, Form::Binary).await;
    let (_, reply) = reply.unwrap_or_else(|(error, _)| panic!("{error}"));
    let read = int(&reply, "read");
    assert!(
        read >= answered,
        "{answered} were answered, and {read} are said to be read"
    );
    broker.stop().await;
}
