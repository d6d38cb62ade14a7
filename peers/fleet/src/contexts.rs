//! The contexts of robots, made where they are missing.

use mom_client::{Channel, Client, ClientError, Code, Map, Value};

/// The message that carries a script.
const COMMAND: &str = "command";

/// Makes a session, unless it is there.
///
/// # Errors
///
/// The hub's refusal, a lost connection.
pub async fn ensure_session(client: &Client, path: &str) -> Result<(), ClientError> {
    ensure(client, path, Map::new().with("kind", "session")).await
}

/// Makes the contexts of a robot, such as `/fleet/7`, where they are missing: the session, the token, and the channel `robot`, which the
/// token guards. Joins the channel as its device.
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
) -> Result<Channel, ClientError> {
    let session = Map::new().with("kind", "session").with("presence", "none");
    ensure(client, path, session).await?;
    let spec = Map::new().with("kind", "token");
    let spec = match manager {
        Some(manager) => spec.with("manager", manager),
        None => spec,
    };
    ensure(client, token, spec).await?;
    let guard = Map::new()
        .with("token", token)
        .with("names", vec![Value::from(COMMAND)]);
    let channel = format!("{path}/robot");
    let spec = Map::new().with("kind", "channel").with("guard", guard);
    ensure(client, &channel, spec).await?;
    client.channel_as_device(&channel).await
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

/// Makes a context, unless it is there.
async fn ensure(client: &Client, path: &str, spec: Map) -> Result<(), ClientError> {
    match client.create(path, spec).await {
        Err(error) if error.code() == Some(&Code::EXISTS) => Ok(()),
        // Who may not make it needs not, if it is there.
        Err(error) if error.code() == Some(&Code::DENIED) => match client.info(path).await {
            Ok(_) => Ok(()),
            Err(_) => Err(error),
        },
        made => made.map(drop),
    }
}
