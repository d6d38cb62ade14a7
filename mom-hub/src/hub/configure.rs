//! A new configuration on a living hub (design §6): what it takes away is lost at once, everywhere.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_managers::Answer;
use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Path, Verb, WireError};

use crate::asking::consult::Wish;
use crate::contexts::make::manager_word;
use crate::hub::input::Configuration;
use crate::tree::context::Role;
use crate::tree::spec::ContextSpec;
use crate::{Audit, Effect, Hub, PeerId, User};

impl Hub {
    /// Takes over a configuration that was checked before.
    pub(crate) fn handle_configuration(&mut self, new: Configuration, out: &mut Vec<Effect>) {
        let Configuration {
            registry,
            root,
            contexts,
            limits,
            users,
        } = new;
        self.registry = registry;
        self.settings.limits = limits;
        if let Err(error) = self.manage_root(&root) {
            debug_assert!(false, "a configuration is checked before: {error}");
        }
        self.audit(Audit::new("configured"), out);
        self.take_contexts(&contexts, out);
        self.renew_managers();
        self.forget_standing();
        for (peer, user) in users {
            self.change_user(peer, user, out);
        }
        self.review(out);
    }

    fn manage_root(&mut self, root: &mom_proto::Value) -> Result<(), WireError> {
        let manager = self.registry.build(root)?;
        let number = self.tree.find(&Path::root()).map(|root| root.number);
        if let Some(context) = number.and_then(|number| self.tree.get_mut(number)) {
            context.manager = Some(manager);
            context.manager_word = Some(manager_word(root));
            context.manager_spec = Some(root.clone());
        }
        Ok(())
    }

    /// Deletes what the file names no more, makes what is new, and changes the rest in place.
    fn take_contexts(&mut self, contexts: &[ContextSpec], out: &mut Vec<Effect>) {
        let mut named: BTreeMap<Path, &ContextSpec> = BTreeMap::new();
        for spec in contexts {
            if let Some(Ok(path)) = spec.path.as_deref().map(Path::parse) {
                named.insert(path, spec);
            }
        }
        let gone: Vec<(ContextNumber, Path)> = self
            .tree
            .iter()
            .filter(|context| context.permanent && context.parent.is_some())
            .filter(|context| {
                let kind = named.get(&context.path).map(|spec| spec.kind.as_str());
                kind != Some(context.kind().word())
            })
            .map(|context| (context.number, context.path.clone()))
            .collect();
        for (number, _) in gone.iter().rev() {
            // A child may have gone with its parent.
            if self.tree.get(*number).is_some() {
                self.delete(*number, None, out);
            }
        }
        for spec in contexts {
            let Some(Ok(path)) = spec.path.as_deref().map(Path::parse) else {
                continue;
            };
            let known = self.tree.find(&path);
            let same = known.filter(|known| known.kind().word() == spec.kind);
            let result = match (known.map(|known| known.number), same.map(|same| same.number)) {
                (_, Some(number)) => self.change_context(number, spec, out),
                // A peer has made something else at this path meanwhile; the file goes first.
                (Some(number), None) => {
                    self.delete(number, None, out);
                    self.make_and_tell(spec, out)
                }
                (None, None) => self.make_and_tell(spec, out),
            };
            if let Err(error) = result {
                let fact = Audit {
                    context: Some(path),
                    code: Some(error.code.clone()),
                    text: Some(error.text),
                    ..Audit::new("refused")
                };
                self.audit(fact, out);
            }
        }
    }

    fn make_and_tell(&mut self, spec: &ContextSpec, out: &mut Vec<Effect>) -> Result<(), WireError> {
        self.make_configured(spec)?;
        let path = spec.path.as_deref().map(Path::parse).transpose()?;
        let number = path
            .and_then(|path| self.tree.find(&path))
            .map(|context| context.number);
        if let Some(number) = number {
            self.grown.insert(number);
            self.push_created(number, None, out);
        }
        Ok(())
    }

    /// Gives a context what the file says of it now; members, owner and fence stay.
    fn change_context(
        &mut self,
        number: ContextNumber,
        spec: &ContextSpec,
        out: &mut Vec<Effect>,
    ) -> Result<(), WireError> {
        let manager = spec
            .manager
            .as_ref()
            .map(|spec| self.registry.build(spec))
            .transpose()?;
        let parent = self.tree.get(number).and_then(|context| context.parent);
        let managed = match &manager {
            Some(manager) => manager.terms(),
            None => parent.map(|parent| self.terms_above(parent)).unwrap_or_default(),
        };
        let role = self.make_role(spec, managed)?;
        self.lose_guarding(number, &role, out);
        self.unguard(number);
        let now = self.now;
        let Some(context) = self.tree.get_mut(number) else {
            return Ok(());
        };
        context.manager = manager;
        context.manager_word = spec.manager.as_ref().map(manager_word);
        context.manager_spec.clone_from(&spec.manager);
        context.presence = spec.presence.unwrap_or_default();
        context.transient = spec.transient;
        context.permanent = true;
        // The file manages it now, and not who made it.
        context.creator = None;
        let mut changed = false;
        match (&mut context.role, role) {
            (Role::Token(token), Role::Token(new)) => {
                changed = token.terms != new.terms;
                if let Some(owner) = token
                    .owner
                    .as_mut()
                    .filter(|_| token.terms.deadman != new.terms.deadman)
                {
                    // It holds for the owner of now too; a new lease begins with the next renewal.
                    owner.alive_until = new.terms.deadman.map(|deadman| now.saturating_add(deadman));
                }
                token.terms = new.terms;
                token.safe = new.safe;
                token.safe_on_give = new.safe_on_give;
            }
            (old, new) => *old = new,
        }
        self.link_guards(number);
        self.changed.insert(number);
        if changed {
            self.correct_record(number, out);
        }
        self.retime(number);
        self.change_guarded_routes(number);
        Ok(())
    }

    /// Takes the token of a channel from its owner if another one, or none, guards it from now on: what the owner has
    /// set in motion there must not go on with nobody to answer for it.
    fn lose_guarding(&mut self, channel: ContextNumber, new: &Role, out: &mut Vec<Effect>) {
        let guard = |role: &Role| match role {
            Role::Channel(channel) => channel.guard.as_ref().map(|guard| guard.token.clone()),
            _ => None,
        };
        let old = self.tree.get(channel).and_then(|context| guard(&context.role));
        let token = old.filter(|old| guard(new).as_ref() != Some(old));
        let token = token
            .and_then(|token| self.tree.find(&token))
            .map(|token| token.number);
        if let Some(token) = token {
            self.lose(token, Reason::Revoked, None, out);
        }
    }

    /// Makes the managers anew that peers have named: what they name may mean something else now. One that is no
    /// more leaves its context closed.
    fn renew_managers(&mut self) {
        let made: Vec<(ContextNumber, mom_proto::Value)> = self
            .tree
            .iter()
            .filter(|context| !context.permanent)
            .filter_map(|context| Some((context.number, context.manager_spec.clone()?)))
            .collect();
        for (number, spec) in made {
            let manager = self
                .registry
                .build(&spec)
                .or_else(|_| self.registry.build(&mom_proto::Value::from("closed")));
            if let (Ok(manager), Some(context)) = (manager, self.tree.get_mut(number)) {
                context.manager = Some(manager);
            }
        }
    }

    /// Drops all verdicts that stand.
    fn forget_standing(&mut self) {
        let channels: Vec<ContextNumber> = self
            .tree
            .iter()
            .filter(|context| context.channel().is_some())
            .map(|context| context.number)
            .collect();
        for number in channels {
            if let Some(context) = self.tree.get_mut(number) {
                for member in context.members.values_mut() {
                    *member = Arc::new(member.unjudged(Arc::clone(&member.facts)));
                }
            }
            self.changed.insert(number);
        }
    }

    fn change_user(&mut self, peer: PeerId, user: Option<User>, out: &mut Vec<Effect>) {
        if self.peers.get(peer).is_none() {
            return;
        }
        if let Some(user) = user {
            self.refresh(peer, user);
            return;
        }
        let root = self.tree.find(&Path::root()).map(|root| root.number);
        if let Some(root) = root {
            let text = "this user was removed from the configuration, or what it has logged in with";
            self.expel(root, peer, None, Some(text), out);
        }
    }

    /// Asks the managers again about everybody who is somewhere or owns something: what would be refused now is
    /// over.
    fn review(&mut self, out: &mut Vec<Effect>) {
        let peers: Vec<PeerId> = self.peers.iter().map(|(peer, _)| peer).collect();
        for peer in peers {
            let places = |places: &BTreeSet<ContextNumber>| places.iter().copied().collect::<Vec<_>>();
            let Some((joined, owns)) = self
                .peers
                .get(peer)
                .map(|known| (places(&known.joined), places(&known.owns)))
            else {
                continue;
            };
            for token in owns {
                // Who was given it needs no right to grab, and who may not renew cannot keep it.
                if self.owner_of(token) == Some(peer) && self.refused(peer, Verb::Renew, token) {
                    self.lose(token, Reason::Revoked, None, out);
                }
            }
            self.review_promises(peer, out);
            for place in joined {
                let within = self
                    .tree
                    .get(place)
                    .is_some_and(|context| context.parent.is_some());
                if within && self.is_member(peer, place) && self.refused(peer, Verb::Join, place) {
                    let text = "the configuration has changed: this peer may not be here any more";
                    self.expel(place, peer, None, Some(text), out);
                }
            }
        }
    }

    /// Ends the part of a peer in shared holds, and grants to it that are being stored, where it may not any more.
    fn review_promises(&mut self, peer: PeerId, out: &mut Vec<Effect>) {
        let known = self.peers.get(peer);
        let involved: Vec<ContextNumber> = known
            .map(|known| known.involved.iter().copied().collect())
            .unwrap_or_default();
        for number in involved {
            let token = self.token(number);
            let holds = token.is_some_and(|token| token.holders.contains_key(&peer));
            let promised = token.is_some_and(|token| token.promised() == Some(peer));
            if holds && self.refused(peer, Verb::Inhibit, number) {
                self.uninhibit(number, peer, Reason::Revoked.word(), out);
            }
            if promised && self.refused(peer, Verb::Renew, number) {
                let text = "the configuration has changed: this peer may not own it any more";
                let error = WireError::new(Code::DENIED, text);
                self.call_off_for(number, peer, &error, Reason::Revoked.word(), out);
            }
        }
    }

    /// Whether a manager says no for good; one that has to ask first, or says later, leaves what is as it is.
    pub(crate) fn refused(&mut self, peer: PeerId, verb: Verb, at: ContextNumber) -> bool {
        let verdict = self.consult(peer, &Wish::new(verb, at));
        matches!(verdict.answer, Answer::Deny(denial) if !denial.code.may_retry())
    }
}
