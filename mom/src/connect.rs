//! Connects to the hub as the chosen user.

use std::time::Duration;
use std::{env, fmt, fs};

use mom_client::{Address, Builder, Client, ClientError, Code, Identity, Key, Proof, WireError};

use crate::failure::Failure;
use crate::global::GlobalArgs;
use crate::output::Output;

/// How often whatever moves says that it is there: a silent link is lost after three times that.
pub(crate) const HEARTBEAT: Duration = Duration::from_millis(500);

/// Whether a command outlives a lost connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stay {
    /// It ends with the connection.
    Once,
    /// The same, and both sides know soon of a loss: a device moves as it says.
    Driving,
    /// It waits for a hub that is not there yet, connects again and goes on.
    Reconnecting,
    /// The same, and it knows soon of a loss.
    Ready,
}

/// Connects and logs in.
pub(crate) async fn connect(global: &GlobalArgs, stay: Stay) -> Result<Client, Failure> {
    // Nobody is asked for a password for nothing.
    global.hub.parse::<Address>().map_err(wrong_address)?;
    let who = UserLogin::of(global)?;
    let builder = || {
        let builder = who.prove(Client::builder(&global.hub)).compress(global.compress);
        match stay {
            Stay::Driving | Stay::Ready => builder.heartbeat(HEARTBEAT),
            Stay::Once | Stay::Reconnecting => builder,
        }
    };
    // The hub hears once of what fails.
    let first = || match global.report {
        true => builder().report_failures("mom", env!("CARGO_PKG_VERSION")),
        false => builder(),
    };
    let connected = match stay {
        Stay::Once | Stay::Driving => first().no_reconnect().connect().await,
        Stay::Reconnecting | Stay::Ready => match first().connect().await {
            Err(error @ (ClientError::Connection(_) | ClientError::TimedOut { .. })) => {
                let absent = explain(&global.hub, &who, error);
                Output::new(global.json).remark(format_args!("{absent}; waiting for it, Ctrl-C ends"));
                builder().wait_for_hub().connect().await
            }
            connected => connected,
        },
    };
    connected.map_err(|error| explain(&global.hub, &who, error))
}

/// The user and the proof.
struct UserLogin<'a> {
    user: Option<&'a str>,
    proof: Proof,
}

impl<'a> UserLogin<'a> {
    fn of(global: &'a GlobalArgs) -> Result<UserLogin<'a>, Failure> {
        if global.guest {
            return Ok(UserLogin {
                user: None,
                proof: Proof::Guest,
            });
        }
        if let Some(file) = &global.jwt {
            let token = fs::read_to_string(file)
                .map_err(|error| Failure::plain(format!("cannot read {}: {error}", file.display())))?;
            return Ok(UserLogin {
                user: None,
                proof: Proof::Token(token.trim().to_owned()),
            });
        }
        let user = global.user.as_deref().filter(|user| !user.is_empty());
        let user = user.ok_or_else(|| {
            Failure::usage(
                "the hub has to know who you are",
                "name yourself with --user alice, or once and for all: export MOM_USER=alice",
            )
        })?;
        let proof = match (&global.key, &global.certificate) {
            (Some(key), Some(certificate)) => Proof::Certificate(Identity {
                certificate: certificate.clone(),
                key: key.clone(),
            }),
            (Some(file), None) => Proof::Key(Key::from_file(file).map_err(|error| {
                let text = error
                    .wire()
                    .map_or_else(|| error.to_string(), |error| error.text.clone());
                Failure::usage(text, "make a key with: mom keygen --out FILE")
            })?),
            (None, _) => Proof::Password(password(user, &global.hub)?),
        };
        Ok(UserLogin {
            user: Some(user),
            proof,
        })
    }

    fn prove(&self, builder: Builder) -> Builder {
        let builder = builder.proof(self.proof.clone());
        match self.user {
            Some(user) => builder.user(user),
            None => builder,
        }
    }

    /// As it stands in a sentence.
    fn name(&self) -> &str {
        self.user.unwrap_or(match self.proof {
            Proof::Guest => "a guest",
            _ => "the bearer of the token",
        })
    }
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

fn wrong_address(error: impl fmt::Display) -> Failure {
    Failure::usage(
        format!("wrong address: {error}"),
        "it comes from --hub, or from MOM_HUB",
    )
}

fn explain(hub: &str, who: &UserLogin<'_>, error: ClientError) -> Failure {
    match error {
        ClientError::Connection(text) if text.contains("certificate") => Failure::new(
            format!(
                "do not trust the hub at {hub}: {}",
                text.strip_prefix("the link failed: ").unwrap_or(&text)
            ),
            "if nobody has signed its certificate, name that in the address: --hub 'bins://HOST:PORT?pin=FINGERPRINT'\n\
             the hub's log has the fingerprint, and `mom lab` prints it",
        ),
        ClientError::Connection(text) if text.contains("the proxy ") => Failure::new(
            format!(
                "cannot reach a hub at {hub}: {}",
                text.strip_prefix("the link failed: ").unwrap_or(&text)
            ),
            "the environment names that proxy (HTTPS_PROXY, HTTP_PROXY, ALL_PROXY): ask who runs it, or name the hub in NO_PROXY\n\
             to see which doors are open: mom doctor HOST:PORT",
        ),
        ClientError::Connection(text) => Failure::new(
            format!(
                "cannot reach a hub at {hub}: {}",
                text.strip_prefix("the link failed: ").unwrap_or(&text)
            ),
            "start one with: mom lab\nor name another one: --hub bin://HOST:PORT, or MOM_HUB",
        ),
        ClientError::Local(error) if error.code == Code::INSECURE => Failure::Refused {
            what: format!("log in to {hub} as {}", who.name()),
            error,
        },
        ClientError::Refused(error) if error.code == Code::BAD_LOGIN => unknown(hub, who, &error),
        other => Failure::of_client(format!("log in to {hub} as {}", who.name()), other),
    }
}

/// The hub refuses the proof.
fn unknown(hub: &str, who: &UserLogin<'_>, error: &WireError) -> Failure {
    let known = |what: &str| format!("the hub at {hub} does not know {} with this {what}", who.name());
    match &who.proof {
        Proof::Password(_) => Failure::new(
            known("password"),
            "check --user and MOM_PASSWORD; in the lab of `mom lab` a password is its user's name",
        ),
        Proof::Key(key) => Failure::new(
            known("key"),
            format!(
                "the user's entry in the hub's users file must have: keys = [\"{}\"]",
                key.public()
            ),
        ),
        _ => Failure::plain(format!("the hub at {hub} does not let you in: {}", error.text)),
    }
}
