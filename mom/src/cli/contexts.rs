//! Arguments of the commands that make and delete contexts.

use std::time::Duration;

use clap::Args;
use mom_client::ContextKind;

use mom_pages::duration;

/// `mom create`
#[derive(Args, Debug)]
pub(crate) struct CreateArgs {
    /// session, channel or token
    #[arg(value_parser = kind)]
    pub(crate) kind: ContextKind,
    /// Its path; the session above it exists
    pub(crate) path: String,
    /// Who decides: a manager of the hub's configuration, or a kind without parameters, such as open
    #[arg(long, value_name = "NAME")]
    pub(crate) manager: Option<String>,
    /// Channels: the token that its senders have to own
    #[arg(long, value_name = "TOKEN")]
    pub(crate) guard: Option<String>,
    /// Channels: the messages for which they have to; * is all
    #[arg(
        long,
        value_name = "NAME",
        value_delimiter = ',',
        default_value = "command",
        requires = "guard"
    )]
    pub(crate) guarded: Vec<String>,
    /// Tokens: how long one owns it without renewal: 30s, 5m
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) lease: Option<Duration>,
    /// It goes with its last member
    #[arg(long)]
    pub(crate) transient: bool,
    /// More, as JSON; docs/PROTOCOL.md has the keys
    #[arg(long, value_name = "JSON")]
    pub(crate) spec: Option<String>,
}

pub(super) const CREATE: &str = "\
Examples:
  mom create session /lab
  mom create token /lab/key --manager first-come --lease 3m
  mom create channel /lab/arm --guard /lab/key
  mom create channel /lab/scan --spec '{\"delivery\": \"latest\", \"keep\": {\"latest\": true}}'";

fn kind(text: &str) -> Result<ContextKind, String> {
    ContextKind::from_word(text).ok_or_else(|| "write session, channel or token".to_owned())
}

/// `mom delete`
#[derive(Args, Debug)]
pub(crate) struct DeleteArgs {
    /// The context; all below it goes as well
    pub(crate) path: String,
}

pub(super) const DELETE: &str = "\
Examples:
  mom delete /lab/arm
  mom delete /lab                          with all its channels and tokens";
