//! All contexts, by number and by path.

pub(crate) mod context;
pub(crate) mod keep;
pub(crate) mod member;
pub(crate) mod peers;
pub(crate) mod spec;

use std::collections::BTreeMap;

use mom_proto::{ContextNumber, Path};

use crate::PeerId;
use crate::tree::context::Context;

/// The tree under one root (M21).
#[derive(Debug, Default)]
pub(crate) struct Tree {
    contexts: BTreeMap<ContextNumber, Context>,
    by_path: BTreeMap<Path, ContextNumber>,
    last: u64,
}

impl Tree {
    /// The number for the next context; never given twice.
    pub(crate) fn next_number(&mut self) -> ContextNumber {
        self.last += 1;
        ContextNumber(self.last)
    }

    pub(crate) fn insert(&mut self, context: Context) {
        if let Some(parent) = context.parent.and_then(|parent| self.contexts.get_mut(&parent)) {
            parent.children.insert(context.path.name().into(), context.number);
        }
        self.by_path.insert(context.path.clone(), context.number);
        self.contexts.insert(context.number, context);
    }

    /// Removes a context without children.
    pub(crate) fn remove(&mut self, number: ContextNumber) -> Option<Context> {
        let context = self.contexts.remove(&number)?;
        self.by_path.remove(&context.path);
        if let Some(parent) = context.parent.and_then(|parent| self.contexts.get_mut(&parent)) {
            parent.children.remove(context.path.name());
        }
        Some(context)
    }

    pub(crate) fn get(&self, number: ContextNumber) -> Option<&Context> {
        self.contexts.get(&number)
    }

    pub(crate) fn get_mut(&mut self, number: ContextNumber) -> Option<&mut Context> {
        self.contexts.get_mut(&number)
    }

    pub(crate) fn find(&self, path: &Path) -> Option<&Context> {
        self.by_path
            .get(path)
            .and_then(|number| self.contexts.get(number))
    }

    /// The context of this path, or the nearest above it.
    pub(crate) fn find_or_above(&self, path: &Path) -> Option<&Context> {
        let mut path = path.clone();
        loop {
            match self.find(&path) {
                Some(context) => return Some(context),
                None => path = path.parent()?,
            }
        }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Context> {
        self.contexts.values()
    }

    /// Forgets what a connection was known for, whose next user is another one.
    pub(crate) fn forget(&mut self, peer: PeerId) {
        for context in self.contexts.values_mut() {
            context.creator = context.creator.filter(|creator| *creator != peer);
            context.invited.remove(&peer);
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.contexts.len()
    }

    /// A context and all below it, deepest first.
    pub(crate) fn subtree(&self, number: ContextNumber) -> Vec<ContextNumber> {
        let mut order = vec![number];
        let mut next = 0;
        while let Some(context) = order.get(next).and_then(|number| self.contexts.get(number)) {
            order.extend(context.children.values());
            next += 1;
        }
        order.reverse();
        order
    }
}
