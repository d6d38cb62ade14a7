//! To the hub, as the user who asks.

use std::env;

use mom_client::{Client, ClientError, Code};

use crate::cli::Global;
use crate::failure::Failure;

/// Whether a command outlives a lost connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stay {
    /// It ends with the connection.
    Once,
    /// It connects again and goes on.
    Reconnecting,
}

/// Connects and logs in.
pub(crate) async fn connect(global: &Global, stay: Stay) -> Result<Client, Failure> {
    let user = global
        .user
        .as_deref()
        .filter(|user| !user.is_empty())
        .ok_or_else(|| {
            Failure::usage(
                "the hub has to know who you are",
                "name yourself with --user alice, or once and for all: export MOM_USER=alice",
            )
        })?;
    let password = password(user, &global.hub)?;
    let builder = Client::builder(&global.hub).user(user).password(&password);
    let builder = match stay {
        Stay::Once => builder.no_reconnect(),
        Stay::Reconnecting => builder,
    };
    builder
        .connect()
        .await
        .map_err(|error| explain(&global.hub, user, error))
}

/// From the environment, or asked for at the terminal: as an argument everyone on the machine could read it.
fn password(user: &str, hub: &str) -> Result<String, Failure> {
    if let Ok(password) = env::var("MOM_PASSWORD") {
        return Ok(password);
    }
    rpassword::prompt_password(format!("Password of {user} at {hub}: ")).map_err(|error| {
        Failure::usage(
            format!("there is no terminal to ask for the password ({error})"),
            "give it in the environment: export MOM_PASSWORD=...",
        )
    })
}

fn explain(hub: &str, user: &str, error: ClientError) -> Failure {
    match error {
        ClientError::Local(error) => Failure::usage(
            format!("--hub {hub}: {}", error.text),
            "an address looks like bin://127.0.0.1:7666 (binary) or tcp://127.0.0.1:7666 (XML)",
        ),
        ClientError::Connection(text) => Failure::new(
            format!(
                "cannot reach a hub at {hub}: {}",
                text.strip_prefix("the link failed: ").unwrap_or(&text)
            ),
            "start one with: mom lab\nor name another one: --hub bin://HOST:PORT, or MOM_HUB",
        ),
        ClientError::Refused(error) if error.code == Code::BAD_LOGIN => Failure::new(
            format!("the hub at {hub} does not know {user} with this password"),
            "check --user and MOM_PASSWORD; in the lab of `mom lab` a password is its user's name",
        ),
        other => Failure::of_client(format!("log in to {hub} as {user}"), other),
    }
}
