//! The contexts of devices, made where they are missing.

use mom_client::{Client, ClientError, Code, Map, Path, Value};

use crate::COMMAND;

/// Makes a session, unless it is there.
///
/// # Errors
///
/// The hub's refusal, which says what is missing; a lost connection.
pub async fn ensure_session(client: &Client, path: &str) -> Result<(), ClientError> {
    ensure(client, path, Map::new().with("kind", "session")).await
}

/// Makes a token and the channel in which it guards the commands, unless they are there. `manager` is that of a token that is made;
/// without it, that of the session.
///
/// # Errors
///
/// As [`ensure_session`].
pub async fn ensure_guarded(
    client: &Client,
    channel: &str,
    token: &str,
    manager: Option<&str>,
) -> Result<(), ClientError> {
    let spec = Map::new().with("kind", "token");
    let spec = match manager {
        Some(manager) => spec.with("manager", manager),
        None => spec,
    };
    ensure(client, token, spec).await?;
    let guard = Map::new()
        .with("token", token)
        .with("names", vec![Value::from(COMMAND)]);
    ensure(
        client,
        channel,
        Map::new().with("kind", "channel").with("guard", guard),
    )
    .await
}

/// Makes the sessions above a context, unless they are there.
///
/// # Errors
///
/// As [`ensure_session`]; a path that is none.
pub async fn ensure_above(client: &Client, path: &str) -> Result<(), ClientError> {
    let path = Path::parse(path)?;
    let above: Vec<Path> = std::iter::successors(path.parent(), Path::parent).collect();
    for session in above.iter().rev().filter(|session| !session.is_root()) {
        ensure_session(client, session.as_str()).await?;
    }
    Ok(())
}

/// Whether a context could not be entered because it, or one above it, is not there.
#[must_use]
pub fn is_missing(error: &ClientError) -> bool {
    error.code() == Some(&Code::UNKNOWN_PATH)
}

/// Makes a context, unless it is there.
///
/// # Errors
///
/// As [`ensure_session`].
pub async fn ensure(client: &Client, path: &str, spec: Map) -> Result<(), ClientError> {
    match client.create(path, spec).await {
        Err(error) if error.code() == Some(&Code::EXISTS) => Ok(()),
        // Who may not make it needs not, if it is there.
        Err(error) if error.code() == Some(&Code::DENIED) => match client.info(path).await {
            Ok(_) => Ok(()),
            Err(_) => Err(missing(path, error)),
        },
        made => made.map(drop),
    }
}

/// What is missing, and who can make it, before the hub's reason.
fn missing(path: &str, refused: ClientError) -> ClientError {
    match refused {
        ClientError::Refused(mut error) => {
            error.text = format!(
                "{path} is missing; who may create contexts there makes it, or the hub's configuration has it: {}",
                error.text
            );
            ClientError::Refused(error)
        }
        other => other,
    }
}
