//! Each door of the hub with MOM's own client at both ends: what a program meets that takes another address.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use mom_client::{Channel, Client, ClientError, Event, Value};
use tokio::sync::Notify;
use tokio::time::timeout;

use crate::{Delays, Error, PATIENCE, Process, USER};

/// Messages under way at most.
const WINDOW: u64 = 256;

/// What one door came to.
#[derive(Clone, Debug)]
pub struct DoorFigures {
    /// Round trips of 256 B between two peers.
    pub trips: Delays,
    /// Messages per second from one peer to another, of the sizes asked for.
    pub rates: Vec<f64>,
    /// What the hub's process grew by for each idle peer, KiB.
    pub memory: Option<f64>,
}

/// Measures the door of an address.
///
/// # Errors
/// A hub that refuses, or a message that does not come.
pub async fn by_client(
    address: &str,
    hub: &Process,
    sizes: &[usize],
    time: Duration,
    idle: usize,
) -> Result<DoorFigures, Error> {
    let (near, far) = (connect(address).await?, connect(address).await?);
    let trips = round_trips(&near, &far, time).await?;
    let mut rates = Vec::new();
    for size in sizes {
        rates.push(stream(&near, &far, *size, time).await?);
    }
    let before = hub.memory();
    let mut peers = Vec::new();
    for _ in 0..idle {
        let peer = connect(address).await?;
        join(&peer, "/bench").await?;
        peers.push(peer);
    }
    let grown = before
        .zip(hub.memory())
        .map(|(before, after)| after.saturating_sub(before));
    Ok(DoorFigures {
        trips,
        rates,
        memory: grown.map(|grown| grown as f64 / idle.max(1) as f64 / 1024.0),
    })
}

fn failed(what: &'static str) -> impl FnOnce(ClientError) -> Error {
    move |error| Error::Unexpected(format!("{what}: {error}"))
}

async fn connect(address: &str) -> Result<Client, Error> {
    let client = Client::builder(address).user(USER).password(USER).no_reconnect();
    client.connect().await.map_err(failed("a login"))
}

async fn join(client: &Client, path: &str) -> Result<Channel, Error> {
    client.channel(path).await.map_err(failed("a join"))
}

fn payload(size: usize) -> Value {
    Value::Binary(Bytes::from(vec![b'.'; size]))
}

async fn round_trips(near: &Client, far: &Client, time: Duration) -> Result<Delays, Error> {
    let (forth, heard) = (join(near, "/bench").await?, join(far, "/bench").await?);
    let (said, back) = (join(far, "/back").await?, join(near, "/back").await?);
    let mut asked = heard.events();
    let answering = tokio::spawn(async move {
        while let Some(event) = asked.next().await {
            if matches!(event, Event::Message(_)) && said.send("state", payload(256)).await.is_err() {
                return;
            }
        }
    });
    let mut answers = back.events();
    let (begin, mut delays) = (Instant::now(), Vec::new());
    while begin.elapsed() < time {
        let start = Instant::now();
        let sent = forth.message("state").content(payload(256)).no_echo().send();
        sent.await.map_err(failed("a message"))?;
        let answer = async { while !matches!(answers.next().await, Some(Event::Message(_)) | None) {} };
        let answered = timeout(PATIENCE, answer).await;
        answered.map_err(|_| Error::Unexpected("a round trip that does not end".to_owned()))?;
        delays.push(start.elapsed());
    }
    answering.abort();
    Ok(Delays::of(delays))
}

async fn stream(near: &Client, far: &Client, size: usize, time: Duration) -> Result<f64, Error> {
    let (forth, heard) = (join(near, "/bench").await?, join(far, "/bench").await?);
    let mut events = heard.events();
    let (count, moved) = (Arc::new(AtomicU64::new(0)), Arc::new(Notify::new()));
    let (counted, moving) = (Arc::clone(&count), Arc::clone(&moved));
    let counting = tokio::spawn(async move {
        while let Some(event) = events.next().await {
            if matches!(event, Event::Message(_)) {
                counted.fetch_add(1, Ordering::AcqRel);
                moving.notify_one();
            }
        }
    });
    let (begin, mut sent) = (Instant::now(), 0);
    while begin.elapsed() < time {
        while sent - count.load(Ordering::Acquire) >= WINDOW {
            let room = timeout(PATIENCE, moved.notified()).await;
            room.map_err(|_| Error::Unexpected("a stream that stands still".to_owned()))?;
        }
        let message = forth.message("state").content(payload(size)).no_echo().send();
        message.await.map_err(failed("a message"))?;
        sent += 1;
    }
    let rate = count.load(Ordering::Acquire) as f64 / begin.elapsed().as_secs_f64();
    counting.abort();
    Ok(rate)
}
