//! A message that is part of a trace: hub and clients write spans of it, and what it says goes through unchanged.

use std::io::{self, Write};
use std::sync::{Arc, Mutex};

use mom_client::{Client, Event, TraceParent};
use mom_proto::TRACE;
use mom_tests::lab;
use mom_tests::raw::PATIENCE;
use tokio::time::timeout;
use tracing_subscriber::EnvFilter;

const TRACEPARENT: &str = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";

/// What is logged.
#[derive(Clone, Debug, Default)]
struct Lines(Arc<Mutex<Vec<u8>>>);

impl Write for Lines {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().expect("no panic").extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Lines {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.0.lock().expect("no panic")).into_owned()
    }
}

async fn log_in(broker: &mom_broker::Broker, scheme: &str, user: &str) -> Client {
    let client = Client::builder(format!("{scheme}://{}", broker.local_addr()));
    client
        .user(user)
        .password(user)
        .connect()
        .await
        .expect("a user of the lab")
}

/// All of it is in one thread, so one subscriber sees all three.
#[tokio::test]
async fn one_message_makes_spans_at_both_ends_and_in_the_hub() {
    let lines = Lines::default();
    let writer = lines.clone();
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(EnvFilter::new("off,mom::trace=debug"))
        .with_writer(move || writer.clone())
        .with_ansi(false)
        .finish();
    let _guard = tracing::subscriber::set_default(subscriber);
    let broker = lab::start().await;
    let alice = log_in(&broker, "tcp", "alice").await;
    let bob = log_in(&broker, "ws", "bob").await;
    let from = alice.channel("/chat").await.expect("people may");
    let heard = bob.channel("/chat").await.expect("people may");
    let mut events = heard.events();
    let next = async |events: &mut mom_client::Events| loop {
        let event = timeout(PATIENCE, events.next()).await.expect("in time");
        if let Event::Message(parcel) = event.expect("the channel stays") {
            return parcel;
        }
    };
    let plain = from.message("say").content("no trace").no_echo();
    plain.send_acknowledged().await.expect("people may");
    next(&mut events).await;
    assert_eq!(lines.text(), "", "no cost and no line without a trace");

    let traced = from.message("say").trace(TRACEPARENT).no_echo();
    traced.send_acknowledged().await.expect("people may");
    let parcel = next(&mut events).await;
    assert_eq!(
        parcel.extra.get(TRACE).and_then(|value| value.as_str()),
        Some(TRACEPARENT)
    );
    assert!(TraceParent::of(&parcel).is_some_and(|trace| trace.is_sampled()));
    let text = lines.text();
    for (span, what) in [
        ("send{", "sent"),
        ("pass{", "passed on"),
        ("receive{", "received"),
    ] {
        let line = text
            .lines()
            .find(|line| line.contains(span) && line.contains(what));
        let line = line.unwrap_or_else(|| panic!("{span} in {text}"));
        for part in [
            "0af7651916cd43dd8448eb211c80319c",
            "b7ad6b7169203331",
            "/chat",
            "say",
        ] {
            assert!(line.contains(part), "{part} in {line}");
        }
    }
    // What is not traceparent goes through as well, and is not a trace.
    let before = lines.text();
    let odd = from.message("say").trace("mine").no_echo();
    odd.send_acknowledged().await.expect("it is a slot as any other");
    let parcel = next(&mut events).await;
    assert_eq!(
        parcel.extra.get(TRACE).and_then(|value| value.as_str()),
        Some("mine")
    );
    assert_eq!(lines.text(), before);
    broker.stop().await;
}
