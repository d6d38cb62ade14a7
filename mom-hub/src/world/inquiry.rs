//! Questions that the hub lets peers ask and the broker answers, because the answer stands in files.

use mom_proto::{Content, ContextKind, Path, Verb};

use crate::PeerId;

/// What a peer asks, and may.
#[derive(Clone, Debug, PartialEq)]
pub enum Inquiry {
    /// The facts about a context and all below it, as the content of the request chooses.
    Audit {
        /// The context.
        path: Path,
        /// The content.
        content: Option<Content>,
    },
    /// Who may do what.
    Explain(Explain),
    /// What the configuration in the content would have decided; without one, which configuration holds.
    WhatIf {
        /// The content.
        content: Option<Content>,
    },
}

/// Who may do what at a path.
#[derive(Clone, Debug, PartialEq)]
pub struct Explain {
    /// Where.
    pub path: Path,
    /// About whom.
    pub about: Vec<About>,
    /// What; none = all that can be asked there.
    pub verb: Option<Verb>,
    /// The name of the message, for `send`.
    pub message: Option<String>,
    /// The kind to be made, for `create`.
    pub kind: Option<ContextKind>,
}

/// Whom something is explained about.
#[derive(Clone, Debug, PartialEq)]
pub enum About {
    /// A peer that is here.
    Peer(PeerId),
    /// A user of whom no peer is here.
    User(String),
}
