//! What the loops of peers do alike around their servers.

use std::collections::BTreeMap;
use std::future::pending;
use std::time::SystemTime;

use mom_client::{Client, Parcel, Time};
use tokio::task::JoinHandle;

/// Waits for the work that is under way, for ever if none is; none if it failed, which is logged as of this program.
pub async fn done<T>(program: &str, work: &mut Option<JoinHandle<T>>) -> Option<T> {
    let ended = match work {
        Some(work) => work.await,
        None => pending().await,
    };
    *work = None;
    ended
        .inspect_err(|error| tracing::error!(%error, "the {program}'s work broke down"))
        .ok()
}

/// Sends what a server has to say; what cannot be sent is logged.
pub async fn send(client: &Client, out: &mut Vec<Parcel>) {
    for parcel in out.drain(..) {
        if let Err(error) = client.send(parcel).await {
            tracing::warn!(%error, "a message was not sent");
        }
    }
}

/// The users of all peers in these contexts, as far as the hub tells them.
pub async fn users(client: Client, contexts: Vec<String>) -> BTreeMap<String, String> {
    let mut users = BTreeMap::new();
    for path in contexts {
        match client.members(&path).await {
            Ok(members) => users.extend(members.into_iter().map(|member| (member.peer, member.user))),
            Err(error) => tracing::warn!(%error, path, "the hub does not tell whose the peers are"),
        }
    }
    users
}

/// The time of day by the hub's clock, which all its peers share; by the own one until the hub's is known.
#[must_use]
pub fn wall(client: &Client) -> Time {
    if let Some((time, _)) = client.clock().now() {
        return time;
    }
    let since = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    let micros = i64::try_from(since.as_micros()).ok();
    micros.and_then(Time::from_micros).unwrap_or_default()
}
