//! Follows the effects of an input in their order, as a broker and its peers would.

use mom_hub::{Effect, Input, PeerId};
use mom_proto::{Family, Parcel, Path, Value, Verb};

use crate::answers::Asked;
use crate::look::Looks;
use crate::observer::Observer;
use crate::owners::{Grant, Lost, fence_of};
use crate::queues::Told;
use crate::robots::Scope;
use crate::tree::{Person, members};

/// A grant of this step, and whether the new owner was told.
struct Granted {
    path: Path,
    name: String,
    told: bool,
}

impl Observer {
    #[expect(clippy::too_many_lines, reason = "one case for each effect, in their order")]
    pub(crate) fn follow(&mut self, effects: &[Effect], input: Option<&Input>) {
        let quiet = self.is_quiet(effects, input);
        let members = (!quiet).then(|| members(&mut self.hub, self.now));
        self.tree.begin(members);
        self.meet(input);
        self.note_breaks(effects);
        let mut granted = Vec::new();
        let mut unsaid = false;
        for effect in effects {
            self.tree.route(effect);
            let asked = self.answers.answer(effect, &mut self.seen);
            let mut safe = None;
            match effect {
                Effect::Deliver { to, parcel } if parcel.family == Family::Event => {
                    safe = self.event(to, parcel, input, &mut granted);
                    unsaid &= !parcel.is(Family::Event, "released");
                    let granted = parcel.is(Family::Event, "grabbed");
                    assert!(!(granted && unsaid), "safe, then released, then grabbed");
                }
                Effect::Deliver { to, parcel } if parcel.family == Family::Manager => {
                    assert!(!to.is_empty(), "somebody is asked");
                    self.seen.note("consult");
                }
                Effect::Deliver { to, parcel } => {
                    unsaid = true;
                    self.seen.note(parcel.name());
                    let path = parcel.context.as_ref().unwrap();
                    self.tree.check_receivers(to, path, &[]);
                }
                Effect::Reply { parcel, .. } => {
                    let asked = asked.as_ref().unwrap();
                    self.reply(asked, parcel, &mut granted);
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
                Effect::Close { .. } => self.seen.note("closed"),
                _ => {}
            }
            let joined = asked.is_some_and(|asked| asked.verb == Some(Verb::Join));
            self.robots.take(effect, joined, safe, &mut self.seen);
        }
        assert!(!unsaid, "a safe state comes before the loss that it is for");
        for grant in granted {
            assert!(
                grant.told,
                "{} is told that {} is its own",
                grant.name, grant.path
            );
        }
        self.answers.settle(&self.hub);
        let hub = &self.hub;
        self.tree.people.retain(|peer, _| hub.peer_name(*peer).is_some());
        self.tree.check(&self.hub);
        if !quiet {
            self.check_tokens();
        }
    }

    /// A grant is being stored: to who is called from the queue, or to somebody by other ways.
    fn promise(&mut self, path: &Path, name: &str) {
        if !self.rules(path).is_some_and(|rules| rules.calm) {
            return;
        }
        let lost = self.owners.lost.get(path);
        let returns = lost.is_some_and(|lost| lost.owned.from.as_deref() == Some(name));
        let owned = self.owners.now.contains_key(path);
        let called = !owned && !returns && !self.handover.converted(path, name);
        self.queues.stored(path, name, called);
    }

    /// Whether the effects tell of no change: a refusal at once changes nothing, and neither does a message.
    fn is_quiet(&self, effects: &[Effect], input: Option<&Input>) -> bool {
        let requests = match input {
            None | Some(Input::Tick) => true,
            Some(Input::Request { .. }) => true,
            Some(_) => false,
        };
        requests
            && effects.iter().all(|effect| match effect {
                Effect::Audit(_) | Effect::Send { .. } => true,
                Effect::Reply { to, parcel } => {
                    let asked = match input {
                        Some(Input::Request { peer, parcel, .. }) => Some((*peer, parcel.id)),
                        _ => None,
                    };
                    parcel.family == Family::Error && asked == Some((*to, parcel.reference))
                }
                _ => false,
            })
    }

    /// Notes who comes, and who is somebody else now.
    fn meet(&mut self, input: Option<&Input>) {
        match input {
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
                self.tree.former = before.map(|before| (*peer, before.name));
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

    /// Takes in an event; where its safe state had to be heard, if it is a loss.
    #[expect(clippy::too_many_lines, reason = "one case for each effect, in their order")]
    fn event(
        &mut self,
        to: &[PeerId],
        parcel: &Parcel,
        input: Option<&Input>,
        granted: &mut Vec<Granted>,
    ) -> Option<Scope> {
        let path = parcel.context.clone().unwrap();
        let content = parcel.value();
        let word = |key: &str| content.get(key).and_then(Value::as_str).map(str::to_owned);
        self.seen.note(parcel.name());
        self.tree.check_taken(parcel);
        let mut also = Vec::new();
        let mut safe = None;
        match parcel.name() {
            "released" => {
                let lost = self.owners.release(parcel, &mut self.seen);
                also.push(lost.owned.name.clone());
                also.extend(self.tree.guarded_members(&path));
                self.check_expired(&path, &lost, input);
                safe = self.safe_scope(&path, &lost);
            }
            "grabbed" => {
                also.extend(self.tree.guarded_members(&path));
                let name = word("owner").unwrap();
                let lost = self.grant(&path, &name, &content);
                let back = lost.is_some_and(|lost| lost.owned.from.as_ref() == Some(&name));
                let peer = self.tree.person(&name).map(|(peer, _)| peer);
                let told = back && peer.is_some_and(|peer| to.contains(&peer));
                also.extend(told.then(|| name.clone()));
                granted.push(Granted {
                    path: path.clone(),
                    name,
                    told,
                });
            }
            "queued" => {
                let (peer, [name]) = (to[0], &self.tree.names(to)[..]) else {
                    panic!("each is told its own place");
                };
                also.push(name.clone());
                let rules = self.rules(&path);
                let told = Told {
                    path: &path,
                    name,
                    level: self.tree.people[&peer].level,
                    place: usize::try_from(content.get("place").and_then(Value::as_int).unwrap()).unwrap(),
                    ids: self.answers.meant(peer, &path, Verb::Grab, input),
                    rules: rules.as_ref(),
                    at: self.now,
                };
                self.queues.told(&told, &mut self.seen);
            }
            "offer" | "requested" | "lapsed" | "inhibited" | "uninhibited" => {
                also.extend(self.tree.guarded_members(&path));
                also.extend(self.tree.members_of(&path.parent().unwrap()));
                let owner = self.owners.now.get(&path).map(|owned| owned.name.clone());
                let asks = word("peer").and_then(|name| self.tree.person(&name));
                let ids = asks.map(|(peer, _)| self.answers.meant(peer, &path, Verb::Request, input));
                let id = ids.and_then(|ids| ids.first().copied());
                self.handover
                    .event(parcel, owner.as_deref(), id, self.now, &mut self.seen);
            }
            "joined" | "left" => {
                let counted = content.get("count").is_some();
                assert!(
                    counted != content.get("peer").is_some(),
                    "who, or how many: {content:?}"
                );
                if counted {
                    self.seen.note("count");
                }
            }
            "deleted" => {
                self.owners.kept.remove(&path);
                also.extend(self.tree.members_of(&path.parent().unwrap()));
            }
            // The end of its turn is nobody's business but the owner's.
            "notice" => {
                let names = self.tree.names(to);
                let owner = self.owners.now.get(&path).map(|owned| &owned.name);
                assert_eq!(names.first(), owner, "{path}: {content:?}");
                also.extend(names);
            }
            "invited" => also.extend(self.tree.names(to)),
            _ => {}
        }
        self.tree.check_receivers(to, &path, &also);
        safe
    }

    /// Takes in an answer: of a grant that nobody else may hear of there is no event.
    fn reply(&mut self, asked: &Asked, reply: &Parcel, granted: &mut [Granted]) {
        let Some(path) = asked.path.clone() else { return };
        if asked.verb == Some(Verb::Request) {
            self.handover.answered(&path, asked.id);
        }
        let Some(person) = self.tree.people.get(&asked.peer) else {
            return;
        };
        let name = person.name.clone();
        let ok = reply.family == Family::Reply;
        let content = reply.value();
        if ok && asked.grants() {
            match self.owners.now.contains_key(&path) {
                true => self.renew(&path, &name, &content),
                false => {
                    self.grant(&path, &name, &content);
                }
            }
            let mine = |grant: &&mut Granted| grant.path == path && grant.name == name;
            if let Some(grant) = granted.iter_mut().rev().find(mine) {
                grant.told = true;
            }
        } else if ok && asked.verb == Some(Verb::Renew) {
            self.renew(&path, &name, &content);
        }
        let over = ["storage-failed", "no-offer", "not-member"].contains(&reply.name());
        if asked.verb == Some(Verb::Accept) && !asked.names && (ok || over) {
            self.handover.accepted(&path, &name);
        }
    }

    fn renew(&mut self, path: &Path, name: &str, told: &Value) {
        let rules = self.rules(path);
        let grant = Grant {
            path,
            name,
            user: "",
            told,
            rules: rules.as_ref(),
            at: self.now,
        };
        self.owners.renewed(&grant);
    }

    fn grant(&mut self, path: &Path, name: &str, told: &Value) -> Option<Lost> {
        let rules = self.rules(path);
        let (_, person) = self.tree.person(name).unwrap();
        let person = person.clone();
        let grant = Grant {
            path,
            name,
            user: &person.user,
            told,
            rules: rules.as_ref(),
            at: self.now,
        };
        let lost = self.owners.grant(&grant);
        // Some managers keep a free token from those who wait for it.
        let calm = rules.is_some_and(|rules| rules.calm);
        if calm && !self.handover.converted(path, name) {
            self.queues.granted(path, name, lost.as_ref());
        }
        let preempted = lost.as_ref().filter(|lost| lost.reason == "preempted");
        // Where it was stored first, levels may have changed meanwhile.
        if let (Some(lost), false) = (preempted, self.start.durable) {
            let (_, old) = self.tree.person(&lost.owned.name).unwrap();
            assert!(
                person.level > old.level,
                "an equal level cannot preempt: {lost:?}"
            );
        }
        self.seen.note(match fence_of(told) >> 20 {
            epoch if epoch == self.start.epoch => "granted",
            _ => "granted beyond the epoch",
        });
        lost
    }

    /// Nothing ends before its time.
    fn check_expired(&mut self, path: &Path, lost: &Lost, input: Option<&Input>) {
        let Some(rules) = self.rules(path).filter(|_| lost.reason == "expired") else {
            return;
        };
        let over = |end: Option<u64>| end.is_some_and(|end| self.now >= end);
        let owned = &lost.owned;
        let asked = input.is_some() || self.queues.waits(path);
        let lease = over(owned.lease_end) && (rules.eager || asked);
        let turn = over(self.queues.turn_end(path, owned, &rules));
        let bounded = path.as_str() == "/yard/chaired";
        assert!(
            lease || turn || bounded || over(owned.alive_until),
            "{path} is lost early: {owned:?}"
        );
        for (what, is) in [
            ("lease over", lease),
            ("turn over", turn),
            ("not alive", over(owned.alive_until)),
        ] {
            if is {
                self.seen.note(what);
            }
        }
    }

    fn safe_scope(&self, path: &Path, lost: &Lost) -> Option<Scope> {
        let rules = self.rules(path);
        let (on_give, only) = match rules {
            Some(rules) => (rules.safe_on_give, rules.safe),
            None => (false, None),
        };
        if lost.reason == "given" && !on_give {
            return None;
        }
        Some(only.map_or(Scope::Everywhere, Scope::Only))
    }

    /// Owners, queues, offers and holds are as the hub says when it is asked.
    fn check_tokens(&mut self) {
        let looks = Looks::at(&mut self.hub, self.now);
        for (path, look) in &looks.seen {
            let stored = self.disk.awaits(path);
            let owner = self.owners.now.get(path).map(|owned| &owned.name);
            assert_eq!(owner, look.owner.as_ref(), "owner of {path}");
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
    }
}
