//! Looks at a hub from outside and asserts what it promises.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_hub::{Admission, Effect, Hub, Input, Member, PeerId, Receivers, Route, admit};
use mom_proto::{ContextNumber, Family, Parcel, Path, Time, Value, WireError};

use crate::lab::{ADMIN, PATHS};
use crate::steps::at;

/// What has occurred, counted.
#[derive(Debug, Default)]
pub(crate) struct Seen(BTreeMap<String, u64>);

impl Seen {
    pub(crate) fn count(&self, what: &str) -> u64 {
        self.0.get(what).copied().unwrap_or_default()
    }

    pub(crate) fn add(&mut self, other: &Seen) {
        for (what, count) in &other.0 {
            *self.0.entry(what.clone()).or_default() += count;
        }
    }

    fn note(&mut self, what: impl Into<String>) {
        *self.0.entry(what.into()).or_default() += 1;
    }
}

/// A hub and what was seen of it.
pub(crate) struct Observer {
    hub: Hub,
    now: u64,
    /// As a broker holds them: changed by effects only.
    routes: BTreeMap<ContextNumber, Arc<Route>>,
    /// Owner and fence of each token, from events and replies only.
    owners: BTreeMap<Path, (String, u64)>,
    /// The highest fence of each path.
    fences: BTreeMap<Path, u64>,
    /// Before the present step, as are the names and routes that follow.
    members: Members,
    names: BTreeMap<PeerId, String>,
    routes_before: Vec<Arc<Route>>,
    /// Requests without an answer.
    open: BTreeSet<(PeerId, u64)>,
    pub(crate) effects: Vec<Vec<Effect>>,
    pub(crate) seen: Seen,
}

type Members = BTreeMap<Path, BTreeSet<String>>;

impl Observer {
    pub(crate) fn new(hub: Hub) -> Observer {
        let routes = hub
            .routes()
            .into_iter()
            .map(|route| (route.number, route))
            .collect();
        let mut observer = Observer {
            hub,
            now: 0,
            routes,
            owners: BTreeMap::new(),
            fences: BTreeMap::new(),
            members: BTreeMap::new(),
            names: BTreeMap::new(),
            routes_before: Vec::new(),
            open: BTreeSet::new(),
            effects: Vec::new(),
            seen: Seen::default(),
        };
        observer.members = observer.look_at_members();
        observer
    }

    /// Gives the hub an input and checks all that follows.
    pub(crate) fn take(&mut self, now: u64, input: &Input) {
        let mut effects = Vec::new();
        self.now = now;
        self.hub.handle(now, Input::Tick, &mut effects);
        self.hub.check();
        assert!(
            self.hub.deadline().is_none_or(|deadline| deadline > now),
            "deadlines have acted"
        );
        self.check_answers(None, &effects);
        self.follow(&effects, None);
        let by_route = self.admit_by_route(input);
        let start = effects.len();
        self.hub.handle(now, input.clone(), &mut effects);
        self.hub.check();
        self.check_answers(Some(input), &effects[start..]);
        self.follow(&effects[start..], Some(input));
        if let Some(by_route) = by_route {
            self.check_one_truth(by_route, &effects[start..]);
        }
        self.check_against_tree();
        self.effects.push(effects);
    }

    /// What the broker's fast path would do with a message.
    fn admit_by_route(&mut self, input: &Input) -> Option<Result<(Receivers, Parcel), WireError>> {
        let Input::Request { peer, parcel } = input else {
            return None;
        };
        let path = parcel
            .context
            .as_ref()
            .filter(|_| parcel.family == Family::Message)?;
        let route = self.routes.values().find(|route| route.path == *path)?;
        self.hub.peer_name(*peer)?;
        let mut parcel = (**parcel).clone();
        let wall = Time::from_micros(i64::try_from(self.now).unwrap()).unwrap();
        match admit(route, *peer, &mut parcel, self.now, wall) {
            Ok(Admission::Consult) => {
                self.seen.note("passed by the hub");
                None
            }
            Ok(Admission::Pass(receivers, _)) => {
                self.seen.note("passed by its route");
                Some(Ok((receivers, parcel)))
            }
            Err(error) => {
                self.seen.note("refused by its route");
                Some(Err(error))
            }
        }
    }

    /// A verdict that stands says what asking again would say.
    fn check_one_truth(&self, by_route: Result<(Receivers, Parcel), WireError>, effects: &[Effect]) {
        let by_hub = effects.iter().find_map(|effect| match effect {
            Effect::Send {
                parcel, receivers, ..
            } => Some(Ok((receivers.clone(), (**parcel).clone()))),
            Effect::Reply { parcel, .. } => Some(Err(WireError::from_parcel(parcel))),
            _ => None,
        });
        assert_eq!(by_hub, Some(by_route), "the route and the hub say the same");
    }

    /// Every request is answered exactly once, at once or later, and nobody else is.
    fn check_answers(&mut self, input: Option<&Input>, effects: &[Effect]) {
        let asked = match input {
            Some(Input::Login { peer, id, .. }) => Some((*peer, *id)),
            Some(Input::Request { peer, parcel }) => Some((*peer, parcel.id)),
            _ => None,
        };
        if let Some((peer, id)) = asked {
            assert!(
                self.open.insert((peer, id.unwrap())),
                "ids rise in a log, so no two requests are the same"
            );
        }
        let message =
            matches!(input, Some(Input::Request { parcel, .. }) if parcel.family == Family::Message);
        for effect in effects {
            let (to, id) = match effect {
                Effect::Reply { to, parcel } => {
                    assert!(matches!(parcel.family, Family::Reply | Family::Error));
                    self.seen.note(parcel.name());
                    (*to, parcel.reference.unwrap())
                }
                Effect::Send { from, parcel, .. } => (*from, parcel.id.unwrap()),
                _ => continue,
            };
            assert!(
                self.open.remove(&(to, id)),
                "{to:?} has asked {id}, and was not answered before: {effect:?}"
            );
            let later = asked != Some((to, Some(id)));
            if later {
                self.seen.note("answered later");
            }
            assert!(
                later
                    || !message
                    || !matches!(effect, Effect::Reply { parcel, .. } if parcel.family == Family::Reply),
                "receipts are the broker's"
            );
        }
        // Of a peer that is gone nobody waits for an answer.
        let hub = &self.hub;
        self.open.retain(|(peer, _)| hub.peer_name(*peer).is_some());
    }

    /// Follows the effects in their order, as a broker and its peers would.
    fn follow(&mut self, effects: &[Effect], input: Option<&Input>) {
        // A refusal changes nothing, as the routes tell; all else may have changed who is where.
        let refused = |effect: &Effect| {
            matches!(effect, Effect::Audit(_))
                || matches!(effect, Effect::Reply { parcel, .. } if parcel.family == Family::Error)
        };
        let after = match effects.iter().all(refused) {
            true => self.members.clone(),
            false => self.look_at_members(),
        };
        self.routes_before = self.routes.values().cloned().collect();
        let mut unsaid = false;
        let mut others = false;
        for effect in effects {
            // With timers several things happen at once, each with its own routes.
            others |= input.is_some()
                && !matches!(effect, Effect::Route(_) | Effect::RouteGone(_) | Effect::Audit(_));
            match effect {
                Effect::Route(route) => {
                    let known = self.routes.insert(route.number, Arc::clone(route));
                    let only_adds = known.is_none_or(|known| adds(&known, route));
                    assert!(
                        !others || only_adds,
                        "what a route takes away it takes before all else"
                    );
                }
                Effect::RouteGone(number) => drop(self.routes.remove(number)),
                Effect::Deliver { to, parcel } => {
                    assert!(!to.is_empty(), "given to somebody");
                    match parcel.family {
                        Family::Event => self.event(to, parcel, &after),
                        _ => {
                            unsaid = true;
                            self.seen.note(parcel.name());
                            self.check_receivers(to, parcel.context.as_ref().unwrap(), &after, &[]);
                        }
                    }
                    unsaid &= !parcel.is(Family::Event, "released");
                    let granted = parcel.is(Family::Event, "grabbed");
                    assert!(!(granted && unsaid), "safe, then released, then grabbed");
                }
                Effect::Reply { parcel, .. } => self.granted(parcel, input),
                Effect::Send { receivers, route, .. } => self.check_send(receivers, route),
                Effect::Close { .. } | Effect::Store { .. } | Effect::Audit(_) => {}
            }
        }
        assert!(!unsaid, "a safe state comes before the loss that it is for");
        self.members = after;
        if let Some(Input::Login { peer, .. }) = input {
            let name = self.hub.peer_name(*peer).unwrap().to_string();
            self.names.insert(*peer, name);
        }
    }

    fn event(&mut self, to: &[PeerId], parcel: &Parcel, after: &Members) {
        let path = parcel.context.clone().unwrap();
        let content = parcel.value();
        let word = |key: &str| content.get(key).and_then(Value::as_str).map(str::to_owned);
        let fence = content
            .get("fence")
            .and_then(Value::as_int)
            .and_then(|fence| u64::try_from(fence).ok());
        self.seen.note(parcel.name());
        let mut also = Vec::new();
        match parcel.name() {
            "released" => {
                let owner = word("owner").unwrap();
                self.seen.note(word("reason").unwrap());
                assert_eq!(
                    self.owners.remove(&path),
                    Some((owner.clone(), fence.unwrap())),
                    "who lost {path} had it"
                );
                also.push(owner);
            }
            "grabbed" => {
                assert!(!self.owners.contains_key(&path), "released before grabbed");
                self.grant(&path, word("owner").unwrap(), fence.unwrap());
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
                let parent = path.parent().unwrap();
                also.extend(self.members.get(&parent).into_iter().flatten().cloned());
            }
            _ => {}
        }
        // Of grabs and losses the members of the guarded channels are told too.
        let guarded = self.routes.values().chain(&self.routes_before).filter(|route| {
            matches!(parcel.name(), "grabbed" | "released")
                && route.guard.as_ref().is_some_and(|guard| guard.token == path)
        });
        also.extend(
            guarded.flat_map(|route| route.members.iter().map(|member| member.facts.name.to_string())),
        );
        self.check_receivers(to, &path, after, &also);
    }

    /// A grant is told in the reply; of one that nobody else may hear of there is no event.
    fn granted(&mut self, reply: &Parcel, input: Option<&Input>) {
        let Some(Input::Request { peer, parcel }) = input else {
            return;
        };
        if !parcel.is(Family::Token, "grab") || !reply.is(Family::Reply, "ok") {
            return;
        }
        let path = parcel.context.clone().unwrap();
        let name = self.hub.peer_name(*peer).unwrap().to_string();
        let fence = reply.value().get("fence").and_then(Value::as_int).unwrap();
        let fence = u64::try_from(fence).unwrap();
        match self.owners.get(&path) {
            Some(owner) => assert_eq!(*owner, (name, fence), "the owner of {path} is who was granted it"),
            None => self.grant(&path, name, fence),
        }
    }

    fn grant(&mut self, path: &Path, owner: String, fence: u64) {
        let highest = self.fences.insert(path.clone(), fence);
        assert!(
            highest.is_none_or(|highest| fence > highest),
            "fences of {path} only rise"
        );
        self.owners.insert(path.clone(), (owner, fence));
    }

    /// That receivers are members of a context before or after the step, or among those.
    fn check_receivers(&self, to: &[PeerId], path: &Path, after: &Members, also: &[String]) {
        // What the operator may not see it cannot check.
        let (Some(before), Some(after)) = (
            self.members.get(path).or(after.get(path)),
            after.get(path).or(self.members.get(path)),
        ) else {
            return;
        };
        for peer in to.iter().filter(|peer| **peer != ADMIN) {
            let now = self.hub.peer_name(*peer).map(|name| name.to_string());
            let names: Vec<&String> = self.names.get(peer).into_iter().chain(&now).collect();
            let concerned =
                |name: &&String| before.contains(*name) || after.contains(*name) || also.contains(name);
            assert!(
                names.iter().any(concerned),
                "{names:?} is told about {path}, none of its business"
            );
        }
    }

    fn check_send(&self, receivers: &Receivers, route: &Arc<Route>) {
        let present = &self.routes[&route.number];
        assert!(
            adds(present, route) && adds(route, present),
            "sent by the present route"
        );
        let places = match receivers {
            Receivers::All => vec![],
            Receivers::AllBut(place) => vec![*place],
            Receivers::These(places) => places.clone(),
        };
        assert!(
            places.iter().all(|place| *place < route.members.len()),
            "only members get it"
        );
    }

    /// The routes and owners that effects told of are those of the tree.
    fn check_against_tree(&mut self) {
        let truth: BTreeMap<ContextNumber, Arc<Route>> = self
            .hub
            .routes()
            .into_iter()
            .map(|route| (route.number, route))
            .collect();
        assert_eq!(self.routes, truth, "routes agree with the tree");
        for route in truth.values() {
            let listed: BTreeSet<String> = route
                .members
                .iter()
                .map(|member| member.facts.name.to_string())
                .collect();
            if let Some(members) = self.members.get(&route.path) {
                assert_eq!(*members, listed, "members of {}", route.path);
            }
            if let Some(guard) = &route.guard {
                let owner = guard
                    .owner
                    .as_ref()
                    .map(|owner| (owner.name.to_string(), guard.fence));
                assert_eq!(
                    self.owners.get(&guard.token),
                    owner.as_ref(),
                    "owner of {}",
                    guard.token
                );
            }
        }
        for path in PATHS.map(at) {
            let Ok(info) = self.ask(Family::Token, "info", &path) else {
                continue;
            };
            if info.get("kind").and_then(Value::as_str) == Some("token") {
                let owner = info.get("owner").and_then(Value::as_str);
                let known = self.owners.get(&path).map(|(owner, _)| owner.as_str());
                assert_eq!(owner, known, "owner of {path}");
            }
        }
    }

    fn look_at_members(&mut self) -> Members {
        let mut all = Members::new();
        for path in PATHS.map(at) {
            let Ok(content) = self.ask(Family::Context, "members", &path) else {
                continue;
            };
            let names = content
                .get("members")
                .and_then(Value::as_list)
                .unwrap_or_default()
                .iter();
            let names = names.filter_map(|member| member.get("peer")?.as_str().map(str::to_owned));
            all.insert(path, names.filter(|name| name != "admin").collect());
        }
        all
    }

    fn ask(&mut self, family: Family, verb: &str, path: &Path) -> Result<Value, WireError> {
        let mut effects = Vec::new();
        let request = Input::Request {
            peer: ADMIN,
            parcel: Box::new(Parcel::new(family, verb).context(path.clone())),
        };
        self.hub.handle(self.now, request, &mut effects);
        effects.retain(|effect| !matches!(effect, Effect::Audit(_)));
        match &effects[..] {
            [Effect::Reply { parcel, .. }] if parcel.family == Family::Reply => Ok(parcel.value()),
            [Effect::Reply { parcel, .. }] => Err(WireError::from_parcel(parcel)),
            other => panic!("looking changes nothing: {other:?}"),
        }
    }
}

/// Whether one route has all that another has, and guards the same; verdicts that stand aside.
fn adds(one: &Route, other: &Route) -> bool {
    let kept = |member: &Arc<Member>| {
        other
            .member(member.peer)
            .is_some_and(|kept| kept.facts == member.facts)
    };
    one.guard == other.guard && one.members.iter().all(kept)
}
