//! The question to a manager.

use std::sync::Arc;

use mom_proto::{ContextKind, Micros, Path, Time, Verb};

/// What the hub knows of a peer (M13).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PeerFacts {
    /// The name that the hub gave it.
    pub name: Arc<str>,
    /// The user it logged in as.
    pub user: Arc<str>,
    /// Its authority level; higher is more.
    pub level: i32,
    /// The groups of its user.
    pub groups: Arc<[String]>,
}

/// The owner of a token, as managers see it.
#[derive(Clone, Copy, Debug)]
pub struct Owner<'a> {
    /// The peer's name.
    pub name: &'a str,
    /// The user it is logged in as.
    pub user: &'a str,
    /// The groups of that user.
    pub groups: &'a [String],
    /// The peer's level now.
    pub level: i32,
    /// Whether it is the peer that asks.
    pub asks: bool,
}

/// The state of a token.
#[derive(Clone, Copy, Debug, Default)]
pub struct TokenFacts<'a> {
    /// Who owns it.
    pub owner: Option<Owner<'a>>,
    /// When the lease ends if nobody renews; none = without end.
    pub lease_end: Option<Micros>,
    /// When the present ownership began.
    pub since: Micros,
    /// The number of waiting peers, without the asking one.
    pub waiting: usize,
}

/// The other tokens of the hub, for managers whose answer depends on them.
pub trait Tokens: std::fmt::Debug {
    /// The state of the token at this path, as [`Question::token`] has it for its own; none if there is no such token.
    fn token(&self, path: &Path) -> Option<TokenFacts<'_>>;
}

/// No tokens at all.
#[derive(Clone, Copy, Debug)]
pub struct NoTokens;

impl Tokens for NoTokens {
    fn token(&self, _path: &Path) -> Option<TokenFacts<'_>> {
        None
    }
}

/// What a deferred question was answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GivenAnswer {
    /// The label of the [`Defer`](crate::Defer).
    pub label: Arc<str>,
    /// The peer that answered; none if nobody did in time, or nobody could be asked.
    pub by: Option<Arc<str>>,
    /// Yes or no.
    pub allow: bool,
    /// Whether it may stand for later questions of the same kind.
    pub stands: bool,
    /// Plain words, for a no.
    pub text: String,
}

/// One request, without its content.
#[derive(Clone, Copy, Debug)]
pub struct Question<'a> {
    /// The asking peer.
    pub peer: &'a PeerFacts,
    /// The verb.
    pub verb: Verb,
    /// The context acted on; for `create` the path to be made.
    pub context: &'a Path,
    /// Its kind; for `create` the kind to be made.
    pub kind: ContextKind,
    /// The name of the message, for sends.
    pub message: Option<&'a str>,
    /// The size of the content in bytes, as far as it is known.
    pub size: usize,
    /// The age at ingress and its error, both in µs, where there is an estimate.
    pub age: Option<(i64, u64)>,
    /// The state of the token, if the context is one.
    pub token: Option<TokenFacts<'a>>,
    /// The other tokens of the hub. A peer that is being granted one counts as its owner.
    pub others: &'a dyn Tokens,
    /// Whether a member has invited the peer to this context lately.
    pub invited: bool,
    /// Whether the peer made this context.
    pub created: bool,
    /// Answers to earlier deferrals of this request; the last one of a label counts.
    pub answers: &'a [GivenAnswer],
    /// Whether this request was counted already, or is not to be: it was deferred before, by this manager or another, or
    /// nobody makes it, and what would come of it is only to be told.
    pub repeated: bool,
    /// The time.
    pub now: Micros,
    /// Wall time, for rules that name times of the day; it does not jump.
    pub wall: Time,
}

impl Question<'_> {
    /// The answer to this manager's earlier deferral of the same request.
    pub fn given(&self, label: &str) -> Option<&GivenAnswer> {
        self.answers.iter().rev().find(|given| &*given.label == label)
    }
}
