//! The invariants, stated and asserted (design §4).

use std::collections::BTreeSet;

use mom_proto::ContextNumber;

use crate::Hub;
use crate::context::Context;

impl Hub {
    /// Asserts what holds after every input; every test calls it after each.
    ///
    /// - One owner at most, and it is there and knows that it owns.
    /// - The members of a context are members of its parent, and know it.
    /// - An owner is a member of its token's parent.
    /// - A fence is 0 or above all of the epochs before, and an owned token has one.
    /// - Guards and the tokens they name know each other.
    /// - A timer waits for exactly each eager lease.
    ///
    /// # Panics
    /// If one of them does not hold: the hub's own fault.
    pub fn check(&self) {
        self.tree.iter().for_each(|context| self.check_context(context));
        for (id, peer) in self.peers.iter() {
            assert_eq!(
                self.peers.id_of(&peer.facts.name),
                Some(id),
                "names and peers agree"
            );
            for number in &peer.joined {
                let context = self.tree.get(*number).expect("a joined context exists");
                assert!(
                    context.members.contains_key(&id),
                    "{} is a member of {}",
                    peer.facts.name,
                    context.path
                );
            }
            for number in &peer.owns {
                let owner = self.token(*number).and_then(|token| token.owner.as_ref());
                assert_eq!(
                    owner.map(|owner| owner.peer),
                    Some(id),
                    "{} owns what it knows",
                    peer.facts.name
                );
            }
        }
        assert!(
            self.changed.is_empty() && self.grown.is_empty(),
            "changed routes were given out"
        );
    }

    fn check_context(&self, context: &Context) {
        let path = &context.path;
        assert_eq!(
            self.tree.find(path).map(|found| found.number),
            Some(context.number),
            "{path} is found"
        );
        let parent = context.parent.and_then(|parent| self.tree.get(parent));
        assert_eq!(
            parent.map(|parent| &parent.path),
            path.parent().as_ref(),
            "{path} lies in its parent"
        );
        for (id, member) in &context.members {
            let peer = self.peers.get(*id).expect("a member is there");
            assert!(
                peer.joined.contains(&context.number),
                "{} knows that it joined {path}",
                member.facts.name
            );
            assert_eq!(
                peer.facts, member.facts,
                "facts of a member of {path} are of today"
            );
            let in_parent = parent.is_none_or(|parent| parent.members.contains_key(id));
            assert!(
                in_parent,
                "{} joined {path} through its parent (M23)",
                member.facts.name
            );
        }
        let guard = context.channel().and_then(|channel| channel.guard.as_ref());
        let token = guard
            .and_then(|guard| self.tree.find(&guard.token))
            .and_then(|context| context.token());
        if let (Some(guard), Some(token)) = (guard, token) {
            {
                assert!(
                    token.guarded.contains(&context.number),
                    "{} knows that it guards {path}",
                    guard.token
                );
            }
        }
        self.check_token(context);
    }

    fn check_token(&self, context: &Context) {
        let Some(token) = context.token() else { return };
        let path = &context.path;
        let epoch = self.settings.epoch << 20;
        assert!(
            token.fence == 0 || token.fence > epoch,
            "the fence of {path} is of this epoch"
        );
        let guarded: BTreeSet<ContextNumber> = token
            .guarded
            .iter()
            .copied()
            .filter(|channel| self.tree.get(*channel).is_some())
            .collect();
        assert_eq!(guarded, token.guarded, "{path} guards channels that exist");
        let deadline = token
            .deadline()
            .map(|deadline| (deadline, crate::hub::Timer::Lease(context.number)));
        let timers: Vec<_> = self
            .timers
            .iter()
            .filter(|(_, timer)| *timer == crate::hub::Timer::Lease(context.number))
            .collect();
        assert_eq!(
            timers,
            deadline.iter().collect::<Vec<_>>(),
            "one timer for the eager lease of {path}"
        );
        let Some(owner) = &token.owner else { return };
        assert!(token.fence > 0, "an owned token has a fence");
        let peer = self.peers.get(owner.peer).expect("an owner is there");
        assert!(
            peer.owns.contains(&context.number),
            "{} knows that it owns {path}",
            peer.facts.name
        );
        let parent = context.parent.expect("a token has a parent");
        assert!(
            peer.joined.contains(&parent),
            "{} is in the parent of {path}",
            peer.facts.name
        );
    }
}
