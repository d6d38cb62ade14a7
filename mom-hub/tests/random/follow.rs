//! Follows the effects of an input in their order, as a broker and its peers would.

use mom_hub::{Effect, Input, PeerId};
use mom_proto::{Family, Parcel, Path, Value, Verb};

use crate::answers::Asked;
use crate::events::Granted;
use crate::look::Looks;
use crate::observer::Observer;
use crate::robots::Scope;
use crate::tree::{Person, members};

/// What the effects of a step have told so far.
#[derive(Default)]
struct Story {
    granted: Vec<Granted>,
    /// Whether a context was deleted: a device is safe then although nobody has lost its token.
    deleted: bool,
    /// Whether a safe state was told, and not yet the loss that it is for.
    unsaid: bool,
}

/// How much may have changed in a step.
#[derive(Clone, Copy, PartialEq)]
enum Stir {
    Nothing,
    /// Tokens: who owns, waits, asks or is asked.
    Tokens,
    /// Who is where, and what there is.
    All,
}

impl Observer {
    pub(crate) fn follow(&mut self, effects: &[Effect], input: Option<&Input>) {
        // A deadline that has not come tells nothing.
        if effects.is_empty() && input.is_none() {
            return;
        }
        let stir = self.stir(effects, input);
        let members = (stir == Stir::All).then(|| members(&mut self.hub, self.now));
        self.tree.begin(members);
        self.meet(input);
        self.note_breaks(effects);
        let mut story = Story::default();
        for effect in effects {
            self.tree.route(effect);
            self.links.take(effect);
            story.deleted |= matches!(effect, Effect::RouteGone(_));
            let asked = self.answers.answer(effect, &mut self.seen);
            let safe = self.effect(effect, asked.as_ref(), input, &mut story);
            let joined = asked.is_some_and(|asked| asked.verb == Some(Verb::Join));
            self.robots.take(effect, joined, safe, &mut self.seen);
        }
        story.check_told();
        self.answers.settle(&self.hub);
        let hub = &self.hub;
        self.tree.people.retain(|peer, _| hub.peer_name(*peer).is_some());
        self.links.keep(hub);
        self.tree.check(&self.hub);
        if stir != Stir::Nothing {
            self.look_at_tokens(stir == Stir::All);
        }
    }

    /// Takes in one effect; where its safe state had to be heard, if it is a loss.
    fn effect(
        &mut self,
        effect: &Effect,
        asked: Option<&Asked>,
        input: Option<&Input>,
        story: &mut Story,
    ) -> Option<Scope> {
        match effect {
            Effect::Deliver { to, parcel } => return self.delivered(to, parcel, input, story),
            Effect::Reply { parcel, .. } => {
                let asked = asked.unwrap();
                self.reply(asked, parcel, &mut story.granted);
                // Only then: who is granted what it waited for is the first of the queue until it hears so.
                if let Some(path) = &asked.path {
                    self.queues.answered(path, asked.id);
                }
            }
            Effect::Send {
                parcel,
                receivers,
                route,
                ..
            } => {
                self.tree.check_send(receivers, route);
                if let (Some(guard), Some(_)) = (&route.guard, parcel.fence) {
                    self.handover.check_sent(&guard.token);
                }
            }
            Effect::Store { record, ticket } => {
                assert!(
                    self.start.durable,
                    "nothing is stored without a store: {record:?}"
                );
                self.disk.take(effect, self.store.0, self.store.1);
                if let (Some(owner), Some(_)) = (&record.owner, ticket) {
                    self.promise(&record.path, &owner.name);
                }
                self.seen.note("stored");
            }
            Effect::Close { .. } => self.close(effect, input),
            _ => {}
        }
        None
    }

    fn delivered(
        &mut self,
        to: &[PeerId],
        parcel: &Parcel,
        input: Option<&Input>,
        story: &mut Story,
    ) -> Option<Scope> {
        match parcel.family {
            Family::Event => {
                let safe = self.event(to, parcel, input, &mut story.granted);
                story.unsaid &= !parcel.is(Family::Event, "released");
                let granted = parcel.is(Family::Event, "grabbed");
                assert!(!(granted && story.unsaid), "safe, then released, then grabbed");
                safe
            }
            Family::Manager => {
                assert!(!to.is_empty(), "a peer is asked");
                self.seen.note("consult");
                self.asked_about(parcel, input);
                None
            }
            _ => {
                // The one of an owner that is lost and stays the owner is looked at by itself.
                story.unsaid = !story.deleted && !matches!(input, Some(Input::Lost { .. }));
                self.seen.note(parcel.name());
                let path = parcel.context.as_ref().unwrap();
                self.tree.check_receivers(to, path, &[]);
                None
            }
        }
    }

    /// A peer is asked about a grab, which may wait.
    fn asked_about(&mut self, consult: &Parcel, input: Option<&Input>) {
        let content = consult.value();
        let word = |key: &str| content.get(key).and_then(Value::as_str).unwrap_or_default();
        let (Some(path), "grab") = (&consult.context, word("verb")) else {
            return;
        };
        let own = |input: &Input| matches!(input, Input::Request { parcel, .. } if parcel.context.as_ref() == Some(path));
        if self
            .queues
            .asked_about(path, word("peer"), input.is_some_and(own))
        {
            self.seen.note("asked about after it has waited");
        }
    }

    /// A grant is being stored: to who is called from the queue, or to a peer by other ways.
    fn promise(&mut self, path: &Path, name: &str) {
        if !self.rules(path).is_some_and(|rules| rules.calm) {
            self.queues.promise(path, name);
            return;
        }
        let lost = self.owners.lost.get(path);
        let returns = lost.is_some_and(|lost| {
            // What was broken or taken does not go back to who gave it; that one may be called like all others.
            let kept = matches!(&*lost.reason, "broken" | "deleted" | "preempted");
            lost.owned.from.as_deref() == Some(name) && !kept
        });
        let owned = self.owners.now.contains_key(path);
        let called = !owned && !returns && !self.handover.converted(path, name);
        self.queues.stored(path, name, called);
    }

    /// How much a step may have changed. A refusal at once changes nothing, and neither does a message; and what is
    /// about tokens, messages and verdicts moves nobody.
    fn stir(&self, effects: &[Effect], input: Option<&Input>) -> Stir {
        let asks = match input {
            _ if self.tree.blind => return Stir::Nothing,
            None | Some(Input::Tick | Input::Stored { .. } | Input::Lost { .. } | Input::Resumed { .. }) => {
                None
            }
            Some(Input::Request { peer, parcel, .. }) => Some((*peer, parcel.id)),
            Some(_) => return Stir::All,
        };
        let moves = |effect: &Effect| match effect {
            Effect::RouteGone(_) | Effect::Close { .. } => true,
            Effect::Deliver { parcel, .. } => {
                let moves = ["joined", "left", "created", "deleted", "expelled"];
                parcel.family == Family::Event && moves.contains(&parcel.name())
            }
            Effect::Reply { to, parcel } if parcel.family == Family::Reply => {
                let asked = self.answers.asked(*to, parcel.reference);
                let family = asked.and_then(|asked| asked.verb).map(Verb::family);
                !matches!(family, Some(Family::Token | Family::Manager))
            }
            _ => false,
        };
        let quiet = |effect: &Effect| match effect {
            Effect::Audit(_) | Effect::Send { .. } => true,
            Effect::Reply { to, parcel } => {
                parcel.family == Family::Error && asks == Some((*to, parcel.reference))
            }
            _ => false,
        };
        if effects.iter().any(moves) {
            return Stir::All;
        }
        let stored = matches!(input, Some(Input::Stored { .. }));
        match stored || !effects.iter().all(quiet) {
            true => Stir::Tokens,
            false => Stir::Nothing,
        }
    }

    /// Notes who comes, and who has another user now.
    fn meet(&mut self, input: Option<&Input>) {
        match input {
            Some(input @ (Input::Lost { .. } | Input::Resumed { .. } | Input::Gone { .. })) => {
                self.meet_link(input);
            }
            Some(Input::Login { peer, user, .. }) => {
                let Some(name) = self.hub.peer_name(*peer) else {
                    return;
                };
                let person = Person {
                    name: name.to_string(),
                    user: user.name.clone(),
                    level: user.level,
                };
                let before = self.tree.people.insert(*peer, person);
                // Another peer has lost nothing.
                if before.as_ref().is_some_and(|before| before.user != user.name) {
                    self.links.lost.remove(peer);
                    self.robots.resume(*peer);
                }
                self.tree.former = before.map(|before| (*peer, before.name));
            }
            // What was about to go back does not: whose it was comes in turn like all others.
            Some(Input::Stored { ticket, ok: false }) => {
                if let Some(path) = self.disk.path_of(*ticket) {
                    self.owners.lost.remove(path);
                }
            }
            Some(Input::Configure(configuration)) => {
                self.queues.mix();
                for (peer, user) in &configuration.users {
                    if let (Some(user), Some(person)) = (user, self.tree.people.get_mut(peer)) {
                        person.level = user.level;
                    }
                }
            }
            _ => {}
        }
    }

    /// Who breaks a token takes it from who had it before a restart, too.
    fn note_breaks(&mut self, effects: &[Effect]) {
        for effect in effects {
            if let Effect::Reply { to, parcel } = effect {
                let broken = self.answers.asked(*to, parcel.reference);
                let broken = broken.filter(|asked| asked.verb == Some(Verb::Break));
                if let Some(path) = broken.and_then(|asked| asked.path.as_ref())
                    && parcel.family == Family::Reply
                {
                    self.owners.kept.remove(path);
                }
            }
        }
    }

    /// Owners, queues, offers and holds are as the hub says when it is asked.
    /// `all` = also those that may have been made since.
    pub(crate) fn look_at_tokens(&mut self, all: bool) {
        let looks = match all {
            true => Looks::at(&mut self.hub, self.now),
            false => self.looks.again(&mut self.hub, self.now),
        };
        for (path, look) in &looks.seen {
            let stored = self.disk.awaits(path);
            let owner = self.owners.now.get(path).map(|owned| &owned.name);
            assert_eq!(owner, look.owner.as_ref(), "owner of {path}");
            let lost = owner.and_then(|owner| self.owner_lost(owner));
            assert_eq!(
                lost, look.owner_lost,
                "until when the owner of {path} may come back"
            );
            self.queues.check(path, look, self.rules(path).as_ref(), stored);
            self.handover.check(path, look, stored, self.now);
        }
        for route in self.tree.routes.values() {
            let Some(guard) = &route.guard else { continue };
            let owner = guard.owner.as_ref().map(|owner| owner.name.to_string());
            let known = self.owners.now.get(&guard.token);
            assert_eq!(
                known.map(|owned| (owned.name.clone(), owned.fence)),
                owner.map(|owner| (owner, guard.fence)),
                "owner of {}",
                guard.token
            );
        }
        let disk = &self.disk;
        self.owners
            .now
            .keys()
            .for_each(|path| assert!(!looks.lack(path), "{path} is gone, and yet owned"));
        self.owners.lost.retain(|path, _| disk.awaits(path));
        self.queues.keep(&looks);
        self.handover.keep(&looks);
        self.looks = looks;
    }
}

impl Story {
    fn check_told(&self) {
        assert!(!self.unsaid, "a safe state comes before the loss that it is for");
        for grant in &self.granted {
            assert!(
                grant.told,
                "{} is told that {} is its own",
                grant.name, grant.path
            );
        }
    }
}
