//! What there is: contexts by number and by path, the peers, and who is where.
//!
//! Nothing here decides or tells anybody; the rooms above do.

pub(crate) mod clock;
pub(crate) mod context;
pub(crate) mod keep;
pub(crate) mod member;
pub(crate) mod peers;
pub(crate) mod spec;

use std::collections::BTreeMap;

use mom_proto::nearest::nearest;
use mom_proto::{Code, ContextKind, ContextNumber, Path, WireError};

use crate::PeerId;
use crate::token::state::Token;
use context::Context;

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

    /// The root, which is there from the start to the end.
    pub(crate) fn root(&self) -> Option<&Context> {
        self.find(&Path::root())
    }

    pub(crate) fn token(&self, number: ContextNumber) -> Option<&Token> {
        self.get(number).and_then(Context::token)
    }

    pub(crate) fn token_mut(&mut self, number: ContextNumber) -> Option<&mut Token> {
        self.get_mut(number).and_then(Context::token_mut)
    }

    /// The token of this path and its context's number.
    pub(crate) fn token_at(&self, path: &Path) -> Option<(ContextNumber, &Token)> {
        let context = self.find(path)?;
        context.token().map(|token| (context.number, token))
    }

    /// The members of a context, in the order of their numbers.
    pub(crate) fn members_of(&self, number: ContextNumber) -> Vec<PeerId> {
        self.get(number)
            .map(|context| context.members.keys().copied().collect())
            .unwrap_or_default()
    }

    pub(crate) fn is_member(&self, peer: PeerId, number: ContextNumber) -> bool {
        self.get(number)
            .is_some_and(|context| context.members.contains_key(&peer))
    }

    /// The context whose manager decides for this one: itself, or the nearest above that has one.
    pub(crate) fn managing(&self, at: ContextNumber) -> Option<&Context> {
        let mut context = self.get(at)?;
        while context.manager.is_none() {
            context = self.get(context.parent?)?;
        }
        Some(context)
    }

    /// The session in which a path is to be made.
    ///
    /// # Errors
    /// `exists` for the root, `unknown-path`, `wrong-kind`.
    pub(crate) fn parent_for(&self, path: &Path) -> Result<ContextNumber, WireError> {
        let Some(above) = path.parent() else {
            return Err(WireError::new(Code::EXISTS, "the root is there already").slot("context"));
        };
        let parent = self.find(&above).ok_or_else(|| self.unknown_path(&above, None))?;
        match parent.kind() {
            ContextKind::Session => Ok(parent.number),
            kind => {
                let text = format!("{above} is a {kind}; only sessions have contexts in them");
                Err(WireError::new(Code::WRONG_KIND, text).slot("context"))
            }
        }
    }

    /// The error for a path that nothing is at, with the nearest one that is.
    pub(crate) fn unknown_path(&self, path: &Path, kind: Option<ContextKind>) -> WireError {
        let what = kind.map_or("context", ContextKind::word);
        WireError::new(Code::UNKNOWN_PATH, format!("there is no {what} {path}"))
            .slot("context")
            .nearest_opt(self.nearest_path(path).as_ref().map(Path::as_str))
    }

    /// The path that was probably meant: one segment of this one mistyped.
    ///
    /// Looks only at children of the nearest context above, and at the first thousand of them: a typo must not
    /// cost a walk over the tree.
    pub(crate) fn nearest_path(&self, path: &Path) -> Option<Path> {
        const CHILDREN: usize = 1000;
        let above = self.find_or_above(path)?;
        let mut missing = path.segments().skip(above.path.segments().count());
        let mistyped = missing.next()?;
        let child = nearest(
            mistyped,
            above.children.keys().take(CHILDREN).map(|child| &**child),
        )?;
        let found = above.path.child(child).ok()?;
        let full = missing.try_fold(found.clone(), |path, segment| path.child(segment));
        Some(
            full.ok()
                .filter(|full| self.find(full).is_some())
                .unwrap_or(found),
        )
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Context> {
        self.contexts.values()
    }

    pub(crate) fn iter_mut(&mut self) -> impl Iterator<Item = &mut Context> {
        self.contexts.values_mut()
    }

    /// Forgets the creator and the invitations of a connection that another user takes over.
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
