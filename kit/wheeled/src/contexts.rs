//! The contexts of robots, made where they are missing.

use mom_client::{Card, Channel, Client, ClientError, Map};
use mom_device::{ensure, ensure_guarded};

/// Makes the contexts of a robot, such as `/fleet/7`, where they are missing: the session, the token, and the channel `robot`, which the
/// token guards. Joins the channel as its device, with what it can do.
///
/// `manager` is that of a token that is made; without it, that of the session.
///
/// # Errors
///
/// The hub's refusal, a lost connection.
pub async fn enter(
    client: &Client,
    path: &str,
    token: &str,
    manager: Option<&str>,
    card: &Card,
) -> Result<Channel, ClientError> {
    let session = Map::new().with("kind", "session").with("presence", "none");
    ensure(client, path, session).await?;
    let channel = format!("{path}/robot");
    ensure_guarded(client, &channel, token, manager).await?;
    client.channel_with_card(&channel, card).await
}

/// Makes the channel that has every robot's newest state, where it is missing, and joins it.
///
/// # Errors
///
/// The hub's refusal, a lost connection.
pub async fn enter_status(client: &Client, path: &str) -> Result<Channel, ClientError> {
    let spec = Map::new()
        .with("kind", "channel")
        .with("delivery", "latest")
        .with("keep", Map::new().with("latest", true));
    ensure(client, path, spec).await?;
    client.channel(path).await
}
