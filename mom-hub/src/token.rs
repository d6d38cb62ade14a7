//! The state of a token (M28, M29, design §6). Only `ownership.rs` changes its owner.

use std::collections::BTreeSet;

use mom_managers::{Expiry, Micros, Terms};
use mom_proto::{Content, ContextNumber, Path};

use crate::PeerId;

/// A token.
#[derive(Debug)]
pub(crate) struct Token {
    pub(crate) owner: Option<Ownership>,
    /// Of the latest grant; 0 before the first. Only rises.
    pub(crate) fence: u64,
    pub(crate) terms: Terms,
    pub(crate) safe: Option<SafeState>,
    /// The channels that it guards.
    pub(crate) guarded: BTreeSet<ContextNumber>,
}

/// Who owns a token, since when, until when.
#[derive(Clone, Debug)]
pub(crate) struct Ownership {
    pub(crate) peer: PeerId,
    pub(crate) since: Micros,
    pub(crate) lease_end: Option<Micros>,
}

/// What is sent when ownership ends; without one, `halt` to every guarded channel.
#[derive(Clone, Debug)]
pub(crate) struct SafeState {
    pub(crate) channel: Path,
    pub(crate) name: String,
    pub(crate) content: Option<Content>,
}

impl Token {
    /// The end of a lease that begins now.
    pub(crate) fn lease_from(&self, now: Micros) -> Option<Micros> {
        self.terms.lease.map(|lease| now.saturating_add(lease))
    }

    /// Whether the owner's lease is over, so that the next grab takes the token.
    pub(crate) fn lapsed(&self, now: Micros) -> bool {
        self.owner
            .as_ref()
            .and_then(|owner| owner.lease_end)
            .is_some_and(|end| now >= end)
    }

    /// When the hub has to end the ownership by itself.
    pub(crate) fn deadline(&self) -> Option<Micros> {
        let owner = self.owner.as_ref()?;
        owner.lease_end.filter(|_| self.terms.expiry == Expiry::Eager)
    }
}
