//! Every request is answered exactly once, at once or later, and nobody else is.

use std::collections::BTreeMap;

use mom_hub::{Effect, Hub, Input, PeerId};
use mom_proto::{Family, Parcel, Path, Value, Verb};

use crate::seen::Seen;

/// A request that was made.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Asked {
    pub(crate) peer: PeerId,
    pub(crate) id: u64,
    /// None = a login, or what is not a verb.
    pub(crate) verb: Option<Verb>,
    pub(crate) path: Option<Path>,
    pub(crate) name: String,
    /// Whether a grab wants to wait, and for ever.
    pub(crate) waits: bool,
    pub(crate) unlimited: bool,
    /// Whether it names a peer.
    pub(crate) names: bool,
    /// Whether it was not answered at once.
    pub(crate) later: bool,
}

/// A message without an answer.
#[derive(Clone, Debug)]
pub(crate) struct Waiting {
    pub(crate) id: u64,
    pub(crate) path: Path,
    pub(crate) name: String,
}

/// Requests without an answer.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    open: BTreeMap<(PeerId, u64), Asked>,
}

impl Answers {
    /// Notes what an input asks.
    pub(crate) fn ask(&mut self, input: &Input) {
        let asked = match input {
            Input::Login { peer, id, .. } => Asked::of(*peer, id.unwrap(), None),
            Input::Request { peer, parcel, .. } => Asked::of(*peer, parcel.id.unwrap(), Some(parcel)),
            _ => return,
        };
        let before = self.open.insert((asked.peer, asked.id), asked);
        assert_eq!(before, None, "ids rise in a log, so no two requests are the same");
    }

    /// What is answered by this effect.
    pub(crate) fn answer(&mut self, effect: &Effect, seen: &mut Seen) -> Option<Asked> {
        let (to, id) = match effect {
            Effect::Reply { to, parcel }
            | Effect::Stats { to, parcel, .. }
            | Effect::Inquire { to, parcel, .. } => {
                assert!(matches!(parcel.family, Family::Reply | Family::Error));
                seen.note(parcel.name());
                (*to, parcel.reference.unwrap())
            }
            Effect::Send { from, parcel, .. } => (*from, parcel.id.unwrap()),
            _ => return None,
        };
        let asked = self.open.remove(&(to, id));
        let asked =
            asked.unwrap_or_else(|| panic!("{to:?} has asked {id}, and was not answered before: {effect:?}"));
        let message = matches!(asked.verb, Some(Verb::Send | Verb::Stop | Verb::Unstop));
        let ok = matches!(effect, Effect::Reply { parcel, .. } if parcel.family == Family::Reply);
        assert!(!(message && ok), "receipts are the broker's");
        if let (Effect::Send { .. }, Some(Verb::Send)) = (effect, asked.verb) {
            let mut before = self.open.range((to, 0)..(to, id)).map(|(_, before)| before);
            let passed = before.find(|before| before.verb == asked.verb && before.path == asked.path);
            assert_eq!(passed, None, "messages of one sender keep their order: {asked:?}");
        }
        if asked.later {
            seen.note("answered later");
        }
        Some(asked)
    }

    /// What is not answered by now is answered later; of a peer that is gone nobody waits for an answer.
    pub(crate) fn settle(&mut self, hub: &Hub) {
        self.open.retain(|(peer, _), _| hub.peer_name(*peer).is_some());
        self.open.values_mut().for_each(|asked| asked.later = true);
    }

    /// The messages of a peer that wait, in their order.
    pub(crate) fn messages_of(&self, peer: PeerId) -> Vec<Waiting> {
        let own = self.open.values().filter(|asked| asked.peer == peer);
        let waiting = own.filter_map(|asked| {
            asked.verb.filter(|verb| verb.family() == Family::Message)?;
            Some(Waiting {
                id: asked.id,
                path: asked.path.clone()?,
                name: asked.name.clone(),
            })
        });
        waiting.collect()
    }

    /// What this is the answer to.
    pub(crate) fn asked(&self, peer: PeerId, id: Option<u64>) -> Option<&Asked> {
        self.open.get(&(peer, id?))
    }

    /// The requests of a peer on a token that an event may be about, the most probable first.
    pub(crate) fn meant(&self, peer: PeerId, path: &Path, verb: Verb, input: Option<&Input>) -> Vec<u64> {
        let fits = |asked: &&Asked| {
            let waits = asked.waits || verb != Verb::Grab;
            waits && asked.verb == Some(verb) && asked.peer == peer && asked.path.as_ref() == Some(path)
        };
        let mut ids: Vec<u64> = self.open.values().filter(fits).map(|asked| asked.id).collect();
        if let Some(Input::Request { parcel, .. }) = input {
            // The one that is just carried out, then the oldest.
            ids.sort_by_key(|id| Some(*id) != parcel.id);
        }
        ids
    }

    /// After a very long time only those are open that wait for ever.
    pub(crate) fn check_end(&self) {
        for asked in self.open.values() {
            assert!(asked.unlimited, "never answered: {asked:?}");
        }
    }
}

impl Asked {
    fn of(peer: PeerId, id: u64, parcel: Option<&Parcel>) -> Asked {
        let content = parcel.map(|parcel| parcel.value()).unwrap_or(Value::Null);
        let verb = parcel.and_then(|parcel| Verb::of(parcel.family, &parcel.name).ok());
        let wait = content.get("wait").filter(|_| verb == Some(Verb::Grab));
        Asked {
            peer,
            id,
            verb,
            path: parcel.and_then(|parcel| parcel.context.clone()),
            name: parcel.map(|parcel| parcel.name().to_owned()).unwrap_or_default(),
            waits: wait.is_some(),
            unlimited: wait.and_then(Value::as_str).is_some(),
            names: content.get("peer").is_some(),
            later: false,
        }
    }

    /// Whether `ok` to it means that its peer owns the token.
    pub(crate) fn grants(&self) -> bool {
        match self.verb {
            Some(Verb::Grab | Verb::Request) => true,
            Some(Verb::Accept) => !self.names,
            _ => false,
        }
    }
}
