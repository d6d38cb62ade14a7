//! Connections that are lost and may come back: what is due at once, what goes on meanwhile, and how it ends.

use std::collections::{BTreeMap, BTreeSet};

use mom_hub::{Effect, Hub, Input, PeerId, Route};
use mom_proto::{Code, ContextNumber, Family, Parcel, Path, Value};

use crate::answers::Waiting;
use crate::lab::PATHS;
use crate::log::at;
use crate::look::ask;
use crate::observer::Observer;
use crate::robots::Scope;

/// Who told of by name where a context says `counts`.
const COUNTS_ABOVE: i64 = 2;

/// A time that is never over, µs.
const NEVER: u64 = 1 << 60;

/// Who is lost, and who was closed.
#[derive(Debug, Default)]
pub(crate) struct Links {
    /// Until when each may come back.
    pub(crate) lost: BTreeMap<PeerId, u64>,
    closed: BTreeSet<PeerId>,
    /// What the present input changes.
    news: Option<News>,
    /// The channels where a command was the last word, and not a safe state.
    moving: BTreeSet<ContextNumber>,
}

/// A peer is lost, or is back.
#[derive(Clone, Debug)]
struct News {
    peer: PeerId,
    /// Its messages that wait for an answer, in their order.
    waiting: Vec<Waiting>,
}

impl Links {
    /// How much is left of the time in which a peer may come back, ms.
    pub(crate) fn left(&self, peer: PeerId, now: u64) -> Option<i64> {
        let until = self.lost.get(&peer)?;
        i64::try_from(until.saturating_sub(now).div_ceil(1000)).ok()
    }

    /// Takes in who is told to move, and to halt.
    pub(crate) fn take(&mut self, effect: &Effect) {
        match effect {
            Effect::Send { parcel, route, .. } => {
                self.moving.extend(parcel.fence.map(|_| route.number));
            }
            Effect::Deliver { parcel, .. } if parcel.family == Family::Message => {
                self.moving.remove(&parcel.number.unwrap());
            }
            // Nobody is there who could move.
            Effect::Route(route) if route.members.is_empty() => drop(self.moving.remove(&route.number)),
            Effect::RouteGone(number) => drop(self.moving.remove(number)),
            _ => {}
        }
    }

    /// After a step: who is gone is not lost.
    pub(crate) fn keep(&mut self, hub: &Hub) {
        self.lost.retain(|peer, _| hub.peer_name(*peer).is_some());
    }
}

impl Observer {
    /// Notes who is lost from now on, or back.
    pub(crate) fn meet_link(&mut self, input: &Input) {
        self.links.news = None;
        let (peer, changed) = match input {
            Input::Lost { peer, grace } => {
                let until = self.now + grace;
                let known = self.tree.people.contains_key(peer);
                if !known {
                    return self.seen.note("lost by nobody");
                }
                let new = !self.links.lost.contains_key(peer);
                self.links.lost.extend(new.then_some((*peer, until)));
                (*peer, new)
            }
            Input::Resumed { peer } => (*peer, self.links.lost.remove(peer).is_some()),
            Input::Gone { peer } if self.links.lost.contains_key(peer) => {
                return self.seen.note("gone while lost");
            }
            _ => return,
        };
        let waiting = self.answers.messages_of(peer);
        self.links.news = changed.then_some(News { peer, waiting });
        match (input, changed) {
            (Input::Lost { .. }, true) => self.robots.lose(peer),
            (Input::Resumed { .. }, true) => self.robots.resume(peer),
            (Input::Lost { .. }, false) => self.seen.note("lost twice"),
            _ => self.seen.note("resumed without a loss"),
        }
    }

    /// What a loss or a return brings, and what no other input brings.
    pub(crate) fn check_link(&mut self, input: &Input, effects: &[Effect]) {
        let (peer, lost) = match input {
            Input::Lost { peer, .. } => (*peer, true),
            Input::Resumed { peer } => (*peer, false),
            _ => return self.check_gates(None),
        };
        let Some(news) = self.links.news.take() else {
            assert!(effects.is_empty(), "nothing has changed: {effects:?}");
            return self.check_gates(None);
        };
        let name = self.tree.people[&peer].name.clone();
        let owned = self.owners.now.iter().filter(|(_, owned)| owned.name == name);
        let owned: BTreeSet<Path> = owned.map(|(path, _)| path.clone()).collect();
        self.check_gates(lost.then_some(&owned));
        let rest = match lost {
            true => self.check_halts(&owned, effects),
            false => effects,
        };
        let rest = self.check_news((peer, &name), &owned, rest);
        match lost {
            true => self.check_refused(&news, rest),
            false => assert!(rest.iter().all(is_quiet), "news and nothing else: {rest:?}"),
        }
        self.check_lists();
    }

    /// The gates of these tokens are closed for all that was let in before, and no other gate.
    fn check_gates(&self, closed: Option<&BTreeSet<Path>>) {
        for before in &self.tree.routes_before {
            let Some(now) = self.tree.routes.get(&before.number) else {
                continue;
            };
            let (Some((token, old)), Some((same, new))) = (gate(before), gate(now)) else {
                continue;
            };
            if (token, old.0) != (same, new.0) {
                continue;
            }
            let more = u64::from(closed.is_some_and(|closed| closed.contains(token)));
            assert_eq!(old.1 + more, new.1, "the gate of {} under {token}", now.path);
        }
    }

    /// The safe state of all devices comes first; gives what follows.
    fn check_halts<'a>(&mut self, owned: &BTreeSet<Path>, effects: &'a [Effect]) -> &'a [Effect] {
        let first = effects.iter().position(|effect| !is_quiet(effect));
        let rest = &effects[first.unwrap_or(effects.len())..];
        let due: BTreeSet<ContextNumber> = self.halted(owned).collect();
        let (halts, rest) = rest.split_at(due.len().min(rest.len()));
        let told: BTreeSet<ContextNumber> = halts.iter().filter_map(halt).map(|(number, _)| number).collect();
        assert_eq!(told, due, "devices are safe first: {effects:?}");
        for (number, to) in halts.iter().filter_map(halt) {
            let members: Vec<PeerId> = self.tree.routes[&number]
                .members
                .iter()
                .map(|member| member.peer)
                .collect();
            assert_eq!(to, members, "all hear the safe state");
            self.seen.note("halted at a loss");
        }
        assert!(
            !rest.iter().any(|effect| halt(effect).is_some()),
            "each once: {rest:?}"
        );
        rest
    }

    /// The channels where members have to hear the safe state of these tokens.
    fn halted(&self, owned: &BTreeSet<Path>) -> impl Iterator<Item = ContextNumber> {
        let guarded = self.tree.routes.values().filter(|route| {
            let token = route.guard.as_ref().map(|guard| &guard.token);
            let token = token.filter(|token| owned.contains(*token));
            token.is_some_and(|token| match self.scope(token) {
                Scope::Everywhere => true,
                Scope::Only(path) => path == route.path,
            })
        });
        guarded
            .filter(|route| !route.members.is_empty())
            .map(|route| route.number)
    }

    /// Where the safe state of a token is heard.
    pub(crate) fn scope(&self, token: &Path) -> Scope {
        let only = self.rules(token).and_then(|rules| rules.safe);
        only.map_or(Scope::Everywhere, Scope::Only)
    }

    /// Those hear of it who have to; gives what follows.
    fn check_news<'a>(
        &mut self,
        (peer, name): (PeerId, &str),
        owned: &BTreeSet<Path>,
        effects: &'a [Effect],
    ) -> &'a [Effect] {
        let left = self.links.left(peer, self.now);
        let word = if left.is_some() { "lost" } else { "resumed" };
        let first = effects.iter().position(|effect| !is_quiet(effect));
        let effects = &effects[first.unwrap_or(effects.len())..];
        let end = effects.iter().position(|effect| event(effect, word).is_none());
        let (news, rest) = effects.split_at(end.unwrap_or(effects.len()));
        let mut told = BTreeMap::new();
        for (to, parcel) in news.iter().filter_map(|effect| event(effect, word)) {
            let content = parcel.value();
            let who = content.get("peer").and_then(Value::as_str);
            let within = content.get("within").and_then(Value::as_int);
            assert_eq!(
                (who, within),
                (Some(name), left),
                "who is {word}, and for how long"
            );
            let names: BTreeSet<String> = self.tree.names(to).into_iter().collect();
            let before = told.insert(parcel.context.clone().unwrap(), names);
            assert_eq!(before, None, "each is told once");
        }
        for path in PATHS.map(at) {
            let told = told.remove(&path).unwrap_or_default();
            if let Some(due) = self.due(&path, name, owned) {
                assert_eq!(told, due, "who hears at {path} that {name} is {word}");
            }
        }
        assert!(told.is_empty(), "told where nothing can be: {told:?}");
        rest
    }

    /// Who has to hear in a context of the loss or the return of a peer; none = the operator may not know.
    fn due(&mut self, path: &Path, name: &str, owned: &BTreeSet<Path>) -> Option<BTreeSet<String>> {
        let members = self.tree.present(path)?.clone();
        if owned.contains(path) {
            let guarded = self.tree.routes.values();
            let guarded =
                guarded.filter(|route| route.guard.as_ref().is_some_and(|guard| guard.token == *path));
            let guarded = guarded.flat_map(|route| &route.members);
            let names = guarded.map(|member| member.facts.name.to_string());
            return Some(members.into_iter().chain(names).collect());
        }
        let info = ask(&mut self.hub, self.now, Family::Context, "info", path).ok()?;
        let count = info.get("members").and_then(Value::as_int).unwrap();
        let named = match info.get("presence").and_then(Value::as_str).unwrap() {
            "all" => true,
            "counts" => count <= COUNTS_ABOVE,
            _ => false,
        };
        let due = named && members.contains(name);
        Some(if due { members } else { BTreeSet::new() })
    }

    /// No command that waits for an answer is let in later; all else that waits is asked about anew.
    fn check_refused(&mut self, news: &News, effects: &[Effect]) {
        let mut refused = BTreeSet::new();
        let mut answered = BTreeSet::new();
        let (mut consults, mut due) = (BTreeSet::new(), BTreeSet::new());
        for effect in effects {
            match effect {
                Effect::Reply { to, parcel } => {
                    assert_eq!(*to, news.peer, "only it is refused something: {parcel:?}");
                    let id = parcel.reference.unwrap();
                    match parcel.name() {
                        "older-fence" => refused.insert(id),
                        _ => answered.insert(id),
                    };
                }
                Effect::Send { parcel, .. } => drop(answered.insert(parcel.id.unwrap())),
                Effect::Deliver { parcel, .. } => {
                    assert!(parcel.is(Family::Manager, "consult"), "{parcel:?}");
                    consults.insert(parcel.context.clone().unwrap());
                }
                other => assert!(is_quiet(other), "refusals and questions only: {other:?}"),
            }
        }
        for waiting in &news.waiting {
            let guards = self.tree.routes.values();
            let mut guards =
                guards.filter_map(|route| route.guard.as_ref().filter(|_| route.path == waiting.path));
            let guarded = guards.any(|guard| guard.covers(&waiting.name));
            assert_eq!(
                refused.remove(&waiting.id),
                guarded,
                "a command does not wait on: {waiting:?}"
            );
            if guarded {
                self.seen.note("refused at a loss");
                continue;
            }
            if !answered.contains(&waiting.id) {
                due.insert(waiting.path.clone());
                self.seen.note("asked anew at a loss");
            }
        }
        assert!(refused.is_empty(), "refused without cause: {refused:?}");
        assert!(due.is_subset(&consults), "a peer is asked anew: {effects:?}");
    }

    /// Lists of members say who is lost, and for how long.
    fn check_lists(&mut self) {
        for path in PATHS.map(at) {
            let Ok(content) = ask(&mut self.hub, self.now, Family::Context, "members", &path) else {
                continue;
            };
            let members = content
                .get("members")
                .and_then(Value::as_list)
                .unwrap_or_default();
            for member in members {
                let name = member.get("peer").and_then(Value::as_str).unwrap();
                let peer = self.tree.person(name).map(|(peer, _)| peer);
                let left = peer.and_then(|peer| self.links.left(peer, self.now));
                let told = member.get("lost").and_then(Value::as_int);
                assert_eq!(told, left, "whether {name} is lost, in {path}");
            }
        }
    }

    /// How long the owner of a token may still come back, if it is lost, ms.
    pub(crate) fn owner_lost(&self, owner: &str) -> Option<i64> {
        let (peer, _) = self.tree.person(owner)?;
        self.links.left(peer, self.now)
    }

    /// Who is held up by an owner that is lost hears so.
    pub(crate) fn check_held(&mut self, refusal: &Parcel) {
        let content = refusal.value();
        let Some(owner) = content.get("owner").and_then(Value::as_str) else {
            return;
        };
        let told = content.get("owner-lost").and_then(Value::as_int);
        assert_eq!(
            told,
            self.owner_lost(owner),
            "until when {owner} may come back: {content:?}"
        );
        if told.is_some() {
            self.seen.note("held by a lost owner");
        }
    }

    /// Where the safe state had to be heard before a grant: who is lost has no device in hand, although it was agreed.
    pub(crate) fn safe_of_lost(&mut self, path: &Path, grabbed: &Parcel) -> Option<Scope> {
        let content = grabbed.value();
        self.owner_lost(content.get("owner").and_then(Value::as_str).unwrap())?;
        self.seen.note("granted while lost");
        let lost = self.owners.lost.get(path);
        if lost.is_some_and(|lost| lost.reason == "given") {
            self.seen.note("handed to who is lost");
        }
        Some(self.scope(path))
    }

    /// A connection is closed once; for its loss not before its time, and not later.
    pub(crate) fn close(&mut self, effect: &Effect, input: Option<&Input>) {
        let Effect::Close { peer, error } = effect else {
            return;
        };
        assert!(self.links.closed.insert(*peer), "{peer:?} is closed once");
        self.seen.note("closed");
        let until = self.links.lost.get(peer).copied();
        if error
            .as_ref()
            .is_some_and(|error| error.code == Code::DISCONNECTED)
        {
            assert_eq!(input.map(|_| ()), None, "its time is over, and nobody says so");
            assert!(
                until.is_some_and(|until| until <= self.now),
                "{peer:?} may come back until {until:?}"
            );
            // It leaves with others that go, in steps; back it comes no more.
            self.links.lost.remove(peer);
            self.seen.note("not resumed in time");
        } else if until.is_some() {
            self.seen.note("closed while lost");
        }
    }

    /// Who has not come back in time is gone as if its connection had ended then, and is closed.
    pub(crate) fn check_like_gone(&mut self, effects: &[Effect]) {
        let closed = effects.iter().filter_map(|effect| match effect {
            Effect::Close { peer, .. } => Some(*peer),
            _ => None,
        });
        let [peer] = closed.collect::<Vec<_>>()[..] else {
            return;
        };
        let mut hub = self.start.hub();
        let mut others = Vec::new();
        for (at, input) in &self.inputs {
            let input = match input {
                Input::Lost { peer: known, .. } if *known == peer => Input::Lost { peer, grace: NEVER },
                other => other.clone(),
            };
            hub.handle(*at, input, &mut Vec::new());
        }
        hub.handle(self.now, Input::Tick, &mut others);
        // What else was due had its turn before it, or after.
        if others.is_empty() {
            hub.handle(self.now, Input::Gone { peer }, &mut others);
            let close = effects
                .iter()
                .position(|effect| matches!(effect, Effect::Close { .. }));
            let mut effects = effects.to_vec();
            effects.remove(close.expect("it is closed"));
            // After it may come what those have asked for who waited for its tokens.
            assert_eq!(effects, others, "as if its connection had ended");
            self.seen.note("gone like others");
        }
    }

    /// Nobody is awaited for longer than its time, and no device moves for it meanwhile.
    pub(crate) fn check_grace(&self) {
        let owned = self.owners.now.iter();
        let owned = owned.filter(|(_, owned)| self.owner_lost(&owned.name).is_some());
        let owned: BTreeSet<Path> = owned.map(|(path, _)| path.clone()).collect();
        let moving = self
            .halted(&owned)
            .find(|number| self.links.moving.contains(number));
        assert_eq!(
            moving, None,
            "moves for an owner that is lost, of one of {owned:?}"
        );
        let over = self.links.lost.iter().find(|(_, until)| **until <= self.now);
        assert_eq!(over, None, "not resumed in time, and yet there");
    }
}

/// What is reported to nobody.
fn is_quiet(effect: &Effect) -> bool {
    matches!(effect, Effect::Route(_) | Effect::Audit(_))
}

/// A safe state: where, and who hears it.
fn halt(effect: &Effect) -> Option<(ContextNumber, Vec<PeerId>)> {
    match effect {
        Effect::Deliver { to, parcel } if parcel.family == Family::Message => {
            Some((parcel.number.unwrap(), to.clone()))
        }
        _ => None,
    }
}

fn event<'a>(effect: &'a Effect, word: &str) -> Option<(&'a [PeerId], &'a Parcel)> {
    match effect {
        Effect::Deliver { to, parcel } if parcel.is(Family::Event, word) => Some((to, parcel)),
        _ => None,
    }
}

/// The token of a channel, its fence, and how often it was made safe under it.
pub(crate) fn gate(route: &Route) -> Option<(&Path, (u64, u64))> {
    let guard = route.guard.as_ref()?;
    let owner = guard.owner.as_ref()?;
    Some((&guard.token, (guard.fence, owner.halts)))
}
