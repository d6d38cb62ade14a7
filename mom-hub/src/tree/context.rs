//! A context of the tree.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_managers::Manager;
use mom_proto::{ContextKind, ContextNumber, Delivery, Fence, Map, Micros, Overflow, Path, Time, Value};
use serde::Deserialize;

use super::keep::Keep;
use super::member::Member;
use crate::PeerId;
use crate::token::state::Token;
use crate::values::number;

/// The members that are told of joins and leaves (design §7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Presence {
    /// Every member, each time.
    #[default]
    All,
    /// Every member, but above 200 members only how many there are, at most once a second.
    Counts,
    /// Nobody.
    None,
}

/// One context.
#[derive(Debug)]
pub(crate) struct Context {
    pub(crate) number: ContextNumber,
    pub(crate) path: Path,
    pub(crate) parent: Option<ContextNumber>,
    pub(crate) children: BTreeMap<Arc<str>, ContextNumber>,
    pub(crate) members: BTreeMap<PeerId, Arc<Member>>,
    /// None = the nearest one above decides.
    pub(crate) manager: Option<Box<dyn Manager>>,
    /// How it was named, for `info`.
    pub(crate) manager_word: Option<String>,
    /// The specification of its manager, from which a new configuration makes it anew.
    pub(crate) manager_spec: Option<Value>,
    /// The peer that made it, while it is there.
    pub(crate) creator: Option<PeerId>,
    /// The user of that peer, who is charged with it as long as it exists.
    pub(crate) made_by: Option<Arc<str>>,
    /// Bytes of the manager that it was made with.
    pub(crate) managing: usize,
    /// Peers that were invited, and until when it counts.
    pub(crate) invited: BTreeMap<PeerId, Micros>,
    /// Users that were put out, and until when they may not join again.
    pub(crate) expelled: BTreeMap<Arc<str>, Micros>,
    pub(crate) presence: Presence,
    /// Bytes that the devices of a channel read in a second, as far as known.
    pub(crate) pace: Option<u32>,
    pub(crate) next_count: Micros,
    pub(crate) count_due: bool,
    /// Deleted with its last member.
    pub(crate) transient: bool,
    /// Of the configuration file: never deleted.
    pub(crate) permanent: bool,
    /// How many of those there are below it.
    pub(crate) permanent_below: usize,
    /// When a stop was lifted here last: what moves a device and was said before does not follow.
    pub(crate) lifted: Option<Time>,
    pub(crate) role: Role,
}

/// The kind of a context with its state.
#[derive(Debug)]
pub(crate) enum Role {
    Session,
    Channel(Channel),
    Token(Box<Token>),
}

#[derive(Debug)]
pub(crate) struct Channel {
    pub(crate) guard: Option<GuardSpec>,
    pub(crate) delivery: Delivery,
    pub(crate) overflow: Overflow,
    pub(crate) keep: Option<Keep>,
    /// Whether several devices may be here; none = only where no token guards it.
    pub(crate) several: Option<bool>,
}

#[derive(Clone, Debug)]
pub(crate) struct GuardSpec {
    pub(crate) token: Path,
    /// The fence of the last token that was deleted there, for as long as there is no other.
    pub(crate) lost_fence: Fence,
    pub(crate) names: Arc<[String]>,
}

impl GuardSpec {
    /// The guard in replies: `known` of the token's owner, the token and the guarded messages.
    pub(crate) fn describe(&self, known: Map) -> Map {
        let names: Vec<Value> = self.names.iter().map(|name| Value::from(name.as_str())).collect();
        known.with("token", self.token.as_str()).with("names", names)
    }
}

impl Context {
    pub(crate) fn kind(&self) -> ContextKind {
        match self.role {
            Role::Session => ContextKind::Session,
            Role::Channel(_) => ContextKind::Channel,
            Role::Token(_) => ContextKind::Token,
        }
    }

    pub(crate) fn channel(&self) -> Option<&Channel> {
        match &self.role {
            Role::Channel(channel) => Some(channel),
            _ => None,
        }
    }

    pub(crate) fn token(&self) -> Option<&Token> {
        match &self.role {
            Role::Token(token) => Some(token),
            _ => None,
        }
    }

    pub(crate) fn token_mut(&mut self) -> Option<&mut Token> {
        match &mut self.role {
            Role::Token(token) => Some(token),
            _ => None,
        }
    }

    /// Path, kind and number, which replies have of every context.
    pub(crate) fn summary(&self) -> Map {
        Map::new()
            .with("path", self.path.as_str())
            .with("kind", self.kind().word())
            .with("number", number(self.number.0))
    }
}
