//! What a sender says behind a message of its own that waits for room.

use std::time::{Duration, Instant};

use mom_proto::codec::Form;
use mom_proto::{Delivery, Family, Parcel, Value, WireError};
use mom_tests::linked::Linked;
use mom_tests::raw::{Raw, at, message};

use super::{BULK, QUIET, Scene, answer_within, block, number_of};

/// A sender whose message waits is heard, and hears the hub: its pings are answered, its tokens are renewed, and its stop goes out at
/// once. Its stop takes back what would let the device move again behind it, and all else keeps its order.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_passes_the_message_of_its_own_sender_that_waits() {
    for form in Form::ALL {
        let mut scene = Scene::new(form).await;
        scene.alice.join(&["/robot"]).await;
        let about = |verb| Parcel::new(Family::Token, verb).context(at("/robot/token"));
        scene.alice.ask(about("grab")).await.expect("it is free");
        let waiting = scene.fill().await;
        let alice = &mut scene.alice;
        let said = |name: &str, number: i64| {
            let mut parcel = message(name, BULK, number);
            (parcel.receipt, parcel.echo) = (Some(true), Some(false));
            parcel
        };
        let line = alice.post(said("line", 1)).await;
        let unstop = alice.post(said("unstop", 2)).await;
        alice
            .ask(Parcel::new(Family::Time, "ping"))
            .await
            .expect("a pong");
        alice.ask(about("renew")).await.expect("it is hers");
        let stop = alice.ask(said("stop", 3)).await.expect("it does not wait");
        assert_eq!(stop.value().get("delivered"), Some(&Value::Int(2)), "{form:?}");
        let error = alice.answer(unstop).await.expect_err("the stop came after it");
        assert_eq!(error.code.word(), "withdrawn", "{form:?}");
        let mut again = said("unstop", 4);
        // Carol would miss the stop.
        let mut other = Raw::login(scene.broker.local_addr(), form, "carol").await;
        again.extra.set("stop", other.newest_stop(BULK).await);
        let alice = &mut scene.alice;
        let again = alice.post(again).await;
        let release = alice.post(about("release")).await;
        let renewed = alice.post(about("renew")).await;
        let silent = answer_within(alice, again, QUIET).await;
        assert!(
            silent.is_none(),
            "{form:?}: it was handled before its turn: {silent:?}"
        );

        let next = scene.next;
        let order = |parcel: &Parcel| match parcel.name() {
            "line" | "stop" | "unstop" => parcel.value().as_int(),
            "block" if number_of(parcel) == next => Some(0),
            _ => None,
        };
        // Bob begins to read, and carol has read all along.
        let mut heard = Vec::new();
        while heard.len() < 4 {
            heard.extend(order(&scene.hear_while_bob_reads().await));
        }
        let place = |number| heard.iter().position(|heard| *heard == number);
        assert_eq!(place(3), Some(0), "{form:?}: the stop first, not {heard:?}");
        assert!(place(0) < place(1), "{form:?}: {heard:?}");
        let alice = &mut scene.alice;
        for (what, id) in [("the block", waiting), ("line", line), ("unstop", again)] {
            let answer = alice.answer(id).await;
            assert!(answer.is_ok(), "{form:?}: {what}: {answer:?}");
        }
        alice.answer(release).await.expect("it was hers");
        let error = alice
            .answer(renewed)
            .await
            .expect_err("it was said behind the release");
        assert_eq!(error.code.word(), "not-owner", "{form:?}");
        scene.end().await;
    }
}

/// What is read behind a message that waits has a bound, and comes in its order.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn so_much_is_read_behind_a_message_that_waits() {
    let mut scene = Scene::with(Form::Json, |config| {
        // However busy the machine is, nobody is late.
        (config.limits.send_wait, config.limits.stalled) = (60_000, 120_000);
    })
    .await;
    let waiting = scene.fill().await;
    let mut lines = Vec::new();
    for number in 0..300 {
        if number == 100 {
            let pong = scene.alice.ask(Parcel::new(Family::Time, "ping")).await;
            pong.expect("it is read");
        }
        let mut line = message("line", BULK, number);
        (line.receipt, line.echo) = (Some(true), Some(false));
        lines.push(scene.alice.post(line).await);
    }
    let ping = scene.alice.post(Parcel::new(Family::Time, "ping")).await;
    let silent = answer_within(&mut scene.alice, ping, QUIET).await;
    assert!(silent.is_none(), "behind more than is read: {silent:?}");
    Scene::check_hears(&mut scene.bob, 0..scene.next + 1).await;
    for number in 0..300 {
        let line = scene.bob.next_of(Family::Message, "line").await;
        assert_eq!(line.value(), Value::Int(number), "lost, twice, or out of order");
    }
    scene.alice.answer(waiting).await.expect("there is room now");
    // The ping passes what is still behind when it is read.
    let mut answers: Vec<_> = lines.into_iter().chain([ping]).collect();
    while !answers.is_empty() {
        let heard = scene.alice.next().await.expect("not closed");
        answers.retain(|id| heard.reference != Some(*id));
    }
    scene.end().await;
}

/// Who waits is asked whether it is there as everybody is, and stays as long as it says so.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_waits_is_gone_when_it_is_silent() {
    let gone = Duration::from_secs(2);
    let mut scene = Scene::with(Form::Binary, |config| {
        (config.limits.heartbeat, config.limits.gone) = (200, 2000);
    })
    .await;
    let ping = || Parcel::new(Family::Time, "ping");
    let id = loop {
        scene.bob.post(ping()).await;
        scene.carol.post(ping()).await;
        let id = scene.alice.post(block(scene.next)).await;
        match answer_within(&mut scene.alice, id, QUIET).await {
            Some(receipt) => scene.note_taken(&receipt.expect("there is room")),
            None => break id,
        }
    };
    let since = Instant::now();
    while since.elapsed() < gone + QUIET {
        scene.bob.post(ping()).await;
        scene.carol.post(ping()).await;
        let pinged = scene.alice.post(ping()).await;
        // Sooner than bob would be taken for gone, so that there would be room.
        let pong = answer_within(&mut scene.alice, pinged, gone * 3 / 4).await;
        assert!(pong.is_some(), "it is heard all the time");
        let answer = answer_within(&mut scene.alice, id, QUIET).await;
        assert!(answer.is_none(), "nobody reads: {answer:?}");
    }
    // Now it says nothing more, and the hub does not wait for room to see that.
    let error = loop {
        scene.bob.post(ping()).await;
        scene.carol.post(ping()).await;
        let heard = match scene.alice.next_within(QUIET).await {
            Some(heard) => heard.expect("an error before the end"),
            None => continue,
        };
        assert_ne!(heard.reference, Some(id), "nobody reads");
        if heard.family == Family::Error {
            break WireError::from_parcel(&heard);
        }
    };
    assert_eq!(error.code.word(), "silent");
    scene.end().await;
}

/// A connection that is lost while its message waits: what has not had its turn comes again over the next one, and once; a stop that has
/// passed it is not counted before it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_waits_comes_again_after_a_loss_and_once() {
    let mut scene = Scene::new(Form::Binary).await;
    scene.fill().await;
    let address = scene.broker.local_addr();
    let mut dora = Linked::login(address, Form::Binary, "alice", 60_000).await;
    dora.about(Family::Context, "join", BULK).await;
    // Small, so that all of it is read behind the first; alice was there before, and so it waits.
    let said = |name: &str, number: i64| {
        let mut parcel = message(name, BULK, number);
        (parcel.receipt, parcel.echo) = (Some(name == "stop"), Some(false));
        parcel
    };
    let waits = [said("mine", 1), said("mine", 2)];
    for parcel in &waits {
        dora.raw.post(parcel.clone()).await;
    }
    dora.ask(said("stop", 3)).await.expect("it does not wait");
    scene.carol.next_of(Family::Message, "stop").await;
    let link = dora.link;
    dora.raw.reset();
    scene.carol.next_of(Family::Event, "lost").await;
    let (mut dora, reply) = link
        .resume(address, Form::Binary)
        .await
        .unwrap_or_else(|(error, _)| panic!("{error}"));
    assert_eq!(
        reply.get("read"),
        Some(&Value::Int(1)),
        "the join, and nothing that waited"
    );
    for parcel in waits.into_iter().chain([said("stop", 3)]) {
        dora.raw.post(parcel).await;
    }
    dora.raw.send_parcel(&Parcel::new(Family::Time, "resent")).await;
    let mut end = said("end", 4);
    end.delivery = Some(Delivery::Fleeting);
    dora.raw.post(end).await;
    let mut heard = Vec::new();
    while heard.last() != Some(&4) {
        let next = scene.hear_while_bob_reads().await;
        if matches!(next.name(), "mine" | "end") {
            heard.push(next.value().as_int().expect("a number"));
        }
    }
    assert_eq!(heard, [1, 2, 4]);
    scene.end().await;
}

/// Who closes its connection while its message waits has said all that came before.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_end_of_a_stream_comes_behind_what_waits() {
    for form in Form::ALL {
        let mut scene = Scene::new(form).await;
        scene.fill().await;
        // The last two are so large that the text forms do not decode them at once.
        for (number, size) in [(1, 10), (2, 20_000), (3, 20_000)] {
            let line = format!("{number}{}", " ".repeat(size));
            let mut line = message("line", BULK, line);
            line.echo = Some(false);
            scene.alice.post(line).await;
        }
        let Scene {
            broker,
            alice,
            mut bob,
            carol,
            next,
            ..
        } = scene;
        drop(alice);
        Scene::check_hears(&mut bob, 0..next + 1).await;
        for number in ["1", "2", "3"] {
            let line = bob.next_of(Family::Message, "line").await.value();
            assert_eq!(line.as_str().map(str::trim), Some(number), "{form:?}");
        }
        bob.reset();
        carol.reset();
        broker.stop().await;
    }
}
