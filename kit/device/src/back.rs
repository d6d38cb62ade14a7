//! Coming back to a channel that went, as all do when a hub without a store restarts.

use std::time::Duration;

use mom_client::{Channel, ClientError, Code, Event};
use tokio::time::sleep;

/// Until it is tried again, at first and at most.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
const MOST_PAUSE: Duration = Duration::from_secs(10);

/// Tries to enter a channel that is gone, and whatever else there is to enter, until it is back.
///
/// # Errors
///
/// Its client is closed.
pub async fn come_back<F, T>(mut enter: impl FnMut() -> F) -> Result<T, ClientError>
where
    F: Future<Output = Result<T, ClientError>>,
{
    let mut pause = FIRST_PAUSE;
    let mut told = false;
    loop {
        sleep(pause).await;
        pause = (pause * 2).min(MOST_PAUSE);
        match enter().await {
            Err(ClientError::Closed(why)) => return Err(ClientError::Closed(why)),
            // It waits for that one's end, however long it takes.
            Err(error) if error.code() == Some(&Code::OCCUPIED) && !told => {
                told = true;
                tracing::warn!(%error, "another device is there");
            }
            Err(error) => tracing::debug!(%error, "a channel is not back"),
            entered => return entered,
        }
    }
}

/// Stays in a channel for as long as its client lives, also when that goes and comes back, and hands its events on.
pub async fn stay<F>(mut channel: Channel, mut enter: impl FnMut() -> F, mut hear: impl FnMut(Event))
where
    F: Future<Output = Result<Channel, ClientError>>,
{
    loop {
        let mut events = channel.events();
        drop(channel);
        while let Some(event) = events.next().await {
            hear(event);
        }
        drop(events);
        match come_back(&mut enter).await {
            Ok(back) => channel = back,
            Err(_) => return,
        }
    }
}
