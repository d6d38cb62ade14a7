//! What a link goes on with, and who may go on with it.

use mom_proto::codec::Form;
use mom_proto::{Code, Family, Parcel};
use mom_tests::linked::Link;
use mom_tests::programs::PATIENCE;
use mom_tests::raw::{Raw, at};
use tokio::time::timeout;

use super::{chat, chatting, lose, numbered, resent, resume, texts};

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

/// An answer that was under way for long is of a connection that its peer has given up: whoever goes on with the link stays.
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
    alice.acknowledge().await;
    alice.raw.send_parcel(&resent()).await;
    alice.raw.send_parcel(&chat("and here")).await;
    bob.next_of(Family::Message, "say").await;
    let link = alice.link.clone();
    let older = Link {
        read: link.read - 1,
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
