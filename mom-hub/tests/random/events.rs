//! Events and answers about tokens, and what they say of owners, queues and agreements.

use mom_hub::{Input, PeerId};
use mom_proto::{Family, Parcel, Path, Value, Verb};

use crate::answers::Asked;
use crate::observer::Observer;
use crate::owners::{Grant, Lost, fence_of};
use crate::queues::Told;
use crate::robots::Scope;

/// A grant of this step, and whether the new owner was told.
pub(crate) struct Granted {
    pub(crate) path: Path,
    pub(crate) name: String,
    pub(crate) told: bool,
}

impl Observer {
    /// Takes in an event; where its safe state had to be heard, if it is a loss.
    pub(crate) fn event(
        &mut self,
        to: &[PeerId],
        parcel: &Parcel,
        input: Option<&Input>,
        granted: &mut Vec<Granted>,
    ) -> Option<Scope> {
        let path = parcel.context.clone().unwrap();
        self.seen.note(parcel.name());
        self.tree.check_taken(parcel);
        let mut safe = None;
        // Who may be told although it is not a member.
        let also = match parcel.name() {
            "released" => {
                let lost = self.owners.release(parcel, &mut self.seen);
                if self.owner_lost(&lost.owned.name).is_some() {
                    self.seen.note(format!("{} while lost", lost.reason));
                }
                self.check_expired(&path, &lost, input);
                safe = self.safe_scope(&path, &lost, parcel);
                [vec![lost.owned.name], self.tree.guarded_members(&path)].concat()
            }
            "grabbed" => {
                safe = self.safe_of_lost(&path, parcel);
                self.grabbed(to, parcel, granted)
            }
            "lost" | "resumed" => {
                let owner = self.owners.now.get(&path).map(|owned| owned.name.clone());
                let mine = owner.is_some() && owner == word(&parcel.value(), "peer");
                safe = (mine && parcel.name() == "lost").then(|| self.scope(&path));
                self.tree.guarded_members(&path)
            }
            "queued" => self.queued(to, parcel, input),
            "offer" | "requested" | "lapsed" | "inhibited" | "uninhibited" => self.agreed(parcel, input),
            "joined" | "left" => {
                self.came_or_went(parcel);
                Vec::new()
            }
            "deleted" => {
                self.owners.kept.remove(&path);
                self.tree.members_of(&path.parent().unwrap())
            }
            // The end of its turn is nobody's business but the owner's.
            "notice" => {
                let names = self.tree.names(to);
                let owner = self.owners.now.get(&path).map(|owned| &owned.name);
                assert_eq!(names.first(), owner, "{path}: {:?}", parcel.value());
                names
            }
            "invited" => self.tree.names(to),
            _ => Vec::new(),
        };
        self.tree.check_receivers(to, &path, &also);
        safe
    }

    /// A peer owns a token; who may be told.
    fn grabbed(&mut self, to: &[PeerId], parcel: &Parcel, granted: &mut Vec<Granted>) -> Vec<String> {
        let path = parcel.context.clone().unwrap();
        let content = parcel.value();
        let name = word(&content, "owner").unwrap();
        let mut also = self.tree.guarded_members(&path);
        let lost = self.grant(&path, &name, &content);
        let back = lost.is_some_and(|lost| lost.owned.from.as_ref() == Some(&name));
        let peer = self.tree.person(&name).map(|(peer, _)| peer);
        let told = back && peer.is_some_and(|peer| to.contains(&peer));
        also.extend(told.then(|| name.clone()));
        granted.push(Granted { path, name, told });
        also
    }

    /// A peer waits, or comes nearer; who may be told.
    fn queued(&mut self, to: &[PeerId], parcel: &Parcel, input: Option<&Input>) -> Vec<String> {
        let path = parcel.context.clone().unwrap();
        let (peer, [name]) = (to[0], &self.tree.names(to)[..]) else {
            panic!("each is told its own place");
        };
        let place = parcel.value().get("place").and_then(Value::as_int).unwrap();
        let rules = self.rules(&path);
        let told = Told {
            path: &path,
            name,
            level: self.tree.people[&peer].level,
            place: usize::try_from(place).unwrap(),
            ids: self.answers.meant(peer, &path, Verb::Grab, input),
            rules: rules.as_ref(),
            at: self.now,
        };
        self.queues.told(&told, &mut self.seen);
        vec![name.clone()]
    }

    /// Something between an owner and others; who may be told.
    fn agreed(&mut self, parcel: &Parcel, input: Option<&Input>) -> Vec<String> {
        let path = parcel.context.clone().unwrap();
        let owner = self.owners.now.get(&path).map(|owned| owned.name.clone());
        let asks = word(&parcel.value(), "peer").and_then(|name| self.tree.person(&name));
        let ids = asks.map(|(peer, _)| self.answers.meant(peer, &path, Verb::Request, input));
        let ids = ids.unwrap_or_default();
        // The one that is just carried out, if it is this peer's: else any that was held back, or waited for a chair.
        let just =
            |id: &&u64| matches!(input, Some(Input::Request { parcel, .. }) if parcel.id == Some(**id));
        let ids = ids.first().filter(just).map_or(&ids[..], std::slice::from_ref);
        self.handover
            .event(parcel, owner.as_deref(), ids, self.now, &mut self.seen);
        let mut also = self.tree.guarded_members(&path);
        also.extend(self.tree.members_of(&path.parent().unwrap()));
        also
    }

    fn came_or_went(&mut self, parcel: &Parcel) {
        let content = parcel.value();
        let counted = content.get("count").is_some();
        assert!(
            counted != content.get("peer").is_some(),
            "who, or how many: {content:?}"
        );
        if counted {
            self.seen.note("count");
        }
    }

    /// Takes in an answer: of a grant that nobody else may hear of there is no event.
    pub(crate) fn reply(&mut self, asked: &Asked, reply: &Parcel, granted: &mut [Granted]) {
        let Some(path) = asked.path.clone() else { return };
        if asked.verb == Some(Verb::Request) {
            self.handover.answered(&path, asked.id);
        }
        let Some(person) = self.tree.people.get(&asked.peer) else {
            return;
        };
        let name = person.name.clone();
        let ok = reply.family == Family::Reply;
        if reply.name() == "held" {
            self.check_held(reply);
        }
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

    /// Where a safe state had to be heard before a loss: not where the device is handed over by agreement.
    fn safe_scope(&self, path: &Path, lost: &Lost, released: &Parcel) -> Option<Scope> {
        let on_give = self.rules(path).is_some_and(|rules| rules.safe_on_give);
        let agreed = match &*lost.reason {
            "given" => true,
            "returned" => released.value().get("by").is_some(),
            _ => false,
        };
        if agreed && !on_give {
            return None;
        }
        Some(self.scope(path))
    }
}

fn word(content: &Value, key: &str) -> Option<String> {
    content.get(key).and_then(Value::as_str).map(str::to_owned)
}
