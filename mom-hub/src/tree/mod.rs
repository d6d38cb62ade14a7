//! What there is: contexts by number and by path, the peers, and who is where.
//!
//! Nothing here decides or tells anybody; the rooms above do.

pub(crate) mod clock;
pub(crate) mod context;
pub(crate) mod installation;
pub(crate) mod keep;
pub(crate) mod latch;
pub(crate) mod member;
pub(crate) mod peers;
pub(crate) mod spec;
pub(crate) mod stop_row;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;
use std::sync::Arc;

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
    /// Channels by the path of the token that guards them, whether that is there or not.
    guards: BTreeMap<Path, BTreeSet<ContextNumber>>,
    /// Contexts that name a peer as their creator or as one who was invited.
    naming: BTreeMap<PeerId, BTreeSet<ContextNumber>>,
    /// What peers of a user have made.
    made: BTreeMap<Arc<str>, Made>,
    last: u64,
}

/// What peers of one user have made.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Made {
    pub(crate) contexts: usize,
    /// Bytes of the managers that they wrote for them.
    pub(crate) managing: usize,
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
        if let Some(user) = &context.made_by {
            let made = self.made.entry(Arc::clone(user)).or_default();
            made.contexts += 1;
            made.managing += context.managing;
        }
        if let Some(creator) = context.creator {
            self.name_peer(creator, context.number);
        }
        let (parent, permanent) = (context.parent, context.permanent);
        self.contexts.insert(context.number, context);
        if permanent {
            self.count_permanent(parent, 1);
        }
    }

    /// Removes a context without children.
    pub(crate) fn remove(&mut self, number: ContextNumber) -> Option<Context> {
        let context = self.contexts.remove(&number)?;
        self.by_path.remove(&context.path);
        if let Some(parent) = context.parent.and_then(|parent| self.contexts.get_mut(&parent)) {
            parent.children.remove(context.path.name());
        }
        if context.permanent {
            self.count_permanent(context.parent, -1);
        }
        if let Some(user) = &context.made_by
            && let Some(made) = self.made.get_mut(user)
        {
            made.contexts -= 1;
            made.managing -= context.managing;
            if made.contexts == 0 {
                self.made.remove(user);
            }
        }
        for peer in context.creator.iter().chain(context.invited.keys()) {
            if let Some(naming) = self.naming.get_mut(peer) {
                naming.remove(&number);
                if naming.is_empty() {
                    self.naming.remove(peer);
                }
            }
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
    /// Looks only at children of the nearest context above, and at the first of them: a typo must not cost a walk over
    /// the tree.
    pub(crate) fn nearest_path(&self, path: &Path) -> Option<Path> {
        // What is there but is not to be told of is not a suggestion for itself.
        let above = self.find_or_above(&path.parent()?)?;
        let mut missing = path.segments().skip(above.path.segments().count());
        let mistyped = missing.next()?;
        let others = above.children.keys().map(|child| &**child);
        let child = nearest(mistyped, others.filter(|child| *child != mistyped))?;
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

    /// Notes that a context names a peer, as its creator or as one who was invited.
    pub(crate) fn name_peer(&mut self, peer: PeerId, number: ContextNumber) {
        self.naming.entry(peer).or_default().insert(number);
    }

    /// Forgets the contexts that a peer has made, and its invitations, so many of them at most: it goes, or another user
    /// takes over its connection. True if that was all.
    pub(crate) fn forget(&mut self, peer: PeerId, most: usize) -> bool {
        let Some(naming) = self.naming.get_mut(&peer) else {
            return true;
        };
        for number in std::iter::from_fn(|| naming.pop_first()).take(most) {
            if let Some(context) = self.contexts.get_mut(&number) {
                context.creator = context.creator.filter(|creator| *creator != peer);
                context.invited.remove(&peer);
            }
        }
        let all = naming.is_empty();
        if all {
            self.naming.remove(&peer);
        }
        all
    }

    /// Channels that name a token of this path as their guard.
    pub(crate) fn guarded_by(&self, token: &Path) -> impl Iterator<Item = ContextNumber> {
        self.guards.get(token).into_iter().flatten().copied()
    }

    /// Notes that a channel names a token as its guard.
    pub(crate) fn add_guard(&mut self, token: Path, channel: ContextNumber) {
        self.guards.entry(token).or_default().insert(channel);
    }

    /// Takes that back.
    pub(crate) fn remove_guard(&mut self, token: &Path, channel: ContextNumber) {
        if let Some(channels) = self.guards.get_mut(token) {
            channels.remove(&channel);
            if channels.is_empty() {
                self.guards.remove(token);
            }
        }
    }

    /// What is there that peers of this user have made.
    pub(crate) fn made_by(&self, user: &str) -> Made {
        self.made.get(user).copied().unwrap_or_default()
    }

    /// Checks that neither a context nor one below it belongs to the configuration.
    ///
    /// # Errors
    /// `permanent`.
    pub(crate) fn check_not_permanent(&self, number: ContextNumber) -> Result<(), WireError> {
        let Some(context) = self.get(number) else {
            return Ok(());
        };
        let what = match (context.permanent, context.permanent_below) {
            (false, 0) => return Ok(()),
            (true, _) => context.path.to_string(),
            (false, _) => format!("something below {}", context.path),
        };
        let text = format!("{what} is part of the configuration and cannot be deleted");
        Err(WireError::new(Code::PERMANENT, text).slot("context"))
    }

    /// Says that a context belongs to the configuration from now on.
    pub(crate) fn make_permanent(&mut self, number: ContextNumber) {
        let Some(context) = self.contexts.get_mut(&number) else {
            return;
        };
        if !context.permanent {
            context.permanent = true;
            let parent = context.parent;
            self.count_permanent(parent, 1);
        }
    }

    fn count_permanent(&mut self, mut above: Option<ContextNumber>, by: isize) {
        while let Some(context) = above.and_then(|number| self.contexts.get_mut(&number)) {
            context.permanent_below = context.permanent_below.saturating_add_signed(by);
            above = context.parent;
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.contexts.len()
    }

    /// The contexts below a path in the order of their paths, from the one after `after` on.
    pub(crate) fn below(&self, path: &Path, after: Option<&Path>) -> impl Iterator<Item = ContextNumber> {
        let (first, end) = bounds_below(path);
        let start = after.map_or(first, |after| after.as_str().to_owned());
        let range = (Bound::Excluded(start.as_str()), Bound::Excluded(end.as_str()));
        self.by_path.range::<str, _>(range).map(|(_, number)| *number)
    }

    /// The context that was made last.
    pub(crate) fn newest(&self) -> ContextNumber {
        let newest = self.contexts.last_key_value();
        newest.map_or(ContextNumber(0), |(number, _)| *number)
    }

    /// The first context that was made after this one and is there.
    pub(crate) fn made_after(&self, number: ContextNumber) -> Option<ContextNumber> {
        let later = (Bound::Excluded(number), Bound::Unbounded);
        self.contexts.range(later).next().map(|(number, _)| *number)
    }

    /// The last context below a path, which has none below it.
    pub(crate) fn last_below(&self, path: &Path) -> Option<ContextNumber> {
        let (start, end) = bounds_below(path);
        let range = (Bound::Excluded(start.as_str()), Bound::Excluded(end.as_str()));
        self.by_path
            .range::<str, _>(range)
            .next_back()
            .map(|(_, number)| *number)
    }
}

/// Texts before and after the paths of all that lies below a path.
fn bounds_below(path: &Path) -> (String, String) {
    let above = path.as_str().trim_end_matches('/');
    // The character after the slash.
    (format!("{above}/"), format!("{above}0"))
}
