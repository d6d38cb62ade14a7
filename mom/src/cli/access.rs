//! Arguments of the commands that say who may, who did, and what another configuration would do.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use mom_pages::duration;

/// `mom audit`
#[derive(Args, Debug)]
pub(crate) struct AuditArgs {
    /// The facts of this context and all below it; of / also logins and what the hub itself did
    #[arg(default_value = "/", value_name = "PATH")]
    pub(crate) path: String,
    /// Only those in which this peer acted or was involved
    #[arg(long, value_name = "PEER")]
    pub(crate) peer: Option<String>,
    /// Only those of peers of this user
    #[arg(long, value_name = "USER")]
    pub(crate) about: Option<String>,
    /// Only these kinds: refused, granted, lost, login, gone, created, ...
    #[arg(long, value_name = "WHAT", value_delimiter = ',')]
    pub(crate) what: Vec<String>,
    /// Only those that asked for this verb
    #[arg(long, value_name = "VERB")]
    pub(crate) verb: Option<String>,
    /// Only those that this rule decided, or any rule of this manager
    #[arg(long, value_name = "RULE")]
    pub(crate) rule: Option<String>,
    /// Only refusals of this code, such as held
    #[arg(long, value_name = "CODE")]
    pub(crate) code: Option<String>,
    /// Only those in which some text contains this
    #[arg(long, value_name = "TEXT")]
    pub(crate) text: Option<String>,
    /// Only those of the last time so long: 30s, 10m, 2h
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub(crate) since: Option<Duration>,
    /// At most so many, the newest
    #[arg(long, short = 'n', value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub(crate) count: u64,
    /// Show also those that come, until Ctrl-C
    #[arg(long, short)]
    pub(crate) follow: bool,
}

pub(super) const AUDIT: &str = "\
It needs the right audit for PATH; facts about contexts below for which you do not have it are left out. Without
[audit] path in its configuration the hub has only the last 4096 facts since its start. Times are UTC.

Examples:
  mom audit
  mom audit /robot/token --since 1h        who had it, who was refused it
  mom audit --what refused --about bob     why bob could not
  mom audit --follow --rule lab            what the manager lab decides, as it does
  mom audit --json | jq -r '[.at, .peer, .code] | @tsv'";

/// `mom explain`
#[derive(Args, Debug)]
pub(crate) struct ExplainArgs {
    /// The context; for create the path to be made
    #[arg(value_name = "PATH")]
    pub(crate) path: String,
    /// The verb, such as grab or send; without it all that can be asked of the context
    #[arg(value_name = "VERB")]
    pub(crate) verb: Option<String>,
    /// The name of the message, for send
    #[arg(long, value_name = "NAME", requires = "verb")]
    pub(crate) message: Option<String>,
    /// The kind of the new context, for create: session, channel or token
    #[arg(long, value_name = "KIND", requires = "verb")]
    pub(crate) kind: Option<String>,
    /// About this user instead of yourself; may be repeated where no verb is named
    #[arg(long, value_name = "USER")]
    pub(crate) about: Vec<String>,
    /// About this peer instead of yourself
    #[arg(long, value_name = "PEER", conflicts_with = "about")]
    pub(crate) peer: Option<String>,
}

pub(super) const EXPLAIN: &str = "\
The hub says what it would answer now, by which rule, and in which line of its configuration that stands. Everybody may
ask about themselves; about others it needs the right explain for PATH. A user who is connected is judged as the
peer that came first: what it has joined and owns counts.

Examples:
  mom explain /robot/token                 all that you may do there
  mom explain /robot/token grab
  mom explain /robot/arm send --message command --about bob
  mom explain /robot/token --about alice --about bob
  mom explain / create --json | jq .rule";

/// `mom what-if`
#[derive(Args, Debug)]
pub(crate) struct WhatIfArgs {
    /// The configuration to try; - reads it from standard input
    #[arg(required_unless_present = "show")]
    pub(crate) file: Option<PathBuf>,
    /// List also the same decisions by another rule
    #[arg(long)]
    pub(crate) rules: bool,
    /// Print the configuration that the hub goes by, to begin from
    #[arg(long, conflicts_with_all = ["file", "rules"])]
    pub(crate) show: bool,
}

pub(super) const WHAT_IF: &str = "\
The hub decides again, by the configuration in FILE, all that it has recorded since its start, and tells what would have
come out otherwise. Nothing changes. It needs the right what-if for /, and a hub that records: [record] path in its
configuration, or mom-broker --record. Users, levels and groups are those of the hub's users file.

Examples:
  mom what-if --show > try.toml
  mom what-if try.toml
  mom what-if --json try.toml | jq .differences

Exit codes: 0 nothing differs, 1 something does, or it failed.";
