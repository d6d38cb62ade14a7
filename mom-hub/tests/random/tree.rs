//! Who is where, as a broker and its peers know it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_hub::{Admission, Effect, Hub, Ingress, Input, Member, PeerId, Receivers, Route, admit};
use mom_managers::Rate;
use mom_proto::{ContextNumber, Family, Parcel, Path, Time, Value, WireError};

use crate::lab::{ADMIN, PATHS};
use crate::log::at;
use crate::look::ask;

pub(crate) type Members = BTreeMap<Path, BTreeSet<String>>;

/// A message as its channel's route admits it.
pub(crate) type Admitted = Result<(Receivers, Option<Rate>, Parcel), WireError>;

/// A peer that is there.
#[derive(Clone, Debug)]
pub(crate) struct Person {
    pub(crate) name: String,
    pub(crate) user: String,
    pub(crate) level: i32,
}

/// Routes by effects; members by asking, after each change.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    pub(crate) routes: BTreeMap<ContextNumber, Arc<Route>>,
    /// Before the present step.
    pub(crate) routes_before: Vec<Arc<Route>>,
    before: Members,
    after: Members,
    pub(crate) people: BTreeMap<PeerId, Person>,
    /// Who has got another user in this step, and who it was.
    pub(crate) former: Option<(PeerId, String)>,
    /// While true nobody asks who is where.
    pub(crate) blind: bool,
}

impl Tree {
    pub(crate) fn new(hub: &mut Hub) -> Tree {
        let routes = hub.routes().into_iter();
        Tree {
            routes: routes.map(|route| (route.number, route)).collect(),
            after: members(hub, 0),
            ..Tree::default()
        }
    }

    /// Looks at who is where, all at once.
    pub(crate) fn look(&mut self, hub: &mut Hub, now: u64) {
        self.after = members(hub, now);
    }

    /// Before the effects of a step are followed; with its members, if they may have changed.
    pub(crate) fn begin(&mut self, members: Option<Members>) {
        self.before = match members {
            Some(members) => std::mem::replace(&mut self.after, members),
            None => self.after.clone(),
        };
        self.routes_before = self.routes.values().cloned().collect();
        self.former = None;
    }

    /// What the broker's fast path would do with a message; none = the hub decides.
    pub(crate) fn admit(&self, hub: &Hub, now: u64, input: &Input) -> Option<Admitted> {
        let Input::Request { peer, parcel, clock } = input else {
            return None;
        };
        let path = parcel
            .context
            .as_ref()
            .filter(|_| parcel.family == Family::Message)?;
        let route = self.routes.values().find(|route| route.path == *path)?;
        hub.peer_name(*peer)?;
        let mut parcel = (**parcel).clone();
        let wall = Time::from_micros(i64::try_from(now).unwrap()).unwrap();
        match admit(
            route,
            *peer,
            &mut parcel,
            &Ingress {
                now,
                wall,
                clock: *clock,
                waited: 0,
            },
        ) {
            Ok(Admission::Consult) => None,
            Ok(Admission::Pass(receivers, rate)) => Some(Ok((receivers, rate, parcel))),
            Err(error) => Some(Err(error)),
        }
    }

    /// Swaps routes as a broker does.
    pub(crate) fn route(&mut self, effect: &Effect) {
        match effect {
            Effect::Route(route) => drop(self.routes.insert(route.number, Arc::clone(route))),
            Effect::RouteGone(number) => drop(self.routes.remove(number)),
            _ => {}
        }
    }

    /// What a route takes away it takes before anybody hears of it.
    pub(crate) fn check_taken(&self, event: &Parcel) {
        let (path, content) = (event.context.as_ref().unwrap(), event.value());
        let fence = content.get("fence").and_then(Value::as_int);
        let gone = content.get("peer").and_then(Value::as_str);
        for route in self.routes.values() {
            let guard = route.guard.as_ref().filter(|guard| guard.token == *path);
            if let (Some(guard), "released") = (guard, event.name()) {
                let newer = i64::try_from(guard.fence).ok() > fence;
                assert!(
                    guard.owner.is_none() || newer,
                    "{path} is lost, and yet {guard:?}"
                );
            }
            // A number is not given twice, while a path may be made anew at once.
            if Some(route.number) == event.number {
                let still = route
                    .members
                    .iter()
                    .any(|member| Some(&*member.facts.name) == gone);
                assert!(
                    !(event.name() == "left" && still),
                    "{gone:?} has left, and yet {route:?}"
                );
                assert_ne!(event.name(), "deleted", "{path}: {route:?}");
            }
        }
    }

    /// That receivers are members of a context before or after the step, or among those.
    pub(crate) fn check_receivers(&self, to: &[PeerId], path: &Path, also: &[String]) {
        assert!(!to.is_empty(), "given to a peer");
        if self.blind {
            return;
        }
        // What the operator may not see it cannot check.
        let (before, after) = (self.before.get(path), self.after.get(path));
        let (Some(before), Some(after)) = (before.or(after), after.or(before)) else {
            return;
        };
        for peer in to.iter().filter(|peer| **peer != ADMIN) {
            let former = self.former.iter().filter(|(known, _)| known == peer);
            let former = former.map(|(_, name)| name);
            let now = self.people.get(peer).map(|person| &person.name);
            let names: Vec<&String> = former.chain(now).collect();
            let concerned =
                |name: &&String| before.contains(*name) || after.contains(*name) || also.contains(name);
            assert!(
                names.iter().any(concerned),
                "{names:?} is told about {path}, none of its business"
            );
        }
    }

    /// The names of peers.
    pub(crate) fn names(&self, peers: &[PeerId]) -> Vec<String> {
        let names = peers.iter().filter_map(|peer| self.people.get(peer));
        names.map(|person| person.name.clone()).collect()
    }

    /// The members of the channels that a token guards.
    pub(crate) fn guarded_members(&self, token: &Path) -> Vec<String> {
        let routes = self.routes.values().chain(&self.routes_before);
        let guarded = routes.filter(|route| route.guard.as_ref().is_some_and(|guard| guard.token == *token));
        guarded
            .flat_map(|route| route.members.iter().map(|member| member.facts.name.to_string()))
            .collect()
    }

    /// The members of a context, as far as the operator may know.
    pub(crate) fn present(&self, path: &Path) -> Option<&BTreeSet<String>> {
        self.after.get(path)
    }

    /// The members of a context before and after the step.
    pub(crate) fn members_of(&self, path: &Path) -> Vec<String> {
        let both = self.before.get(path).into_iter().chain(self.after.get(path));
        both.flatten().cloned().collect()
    }

    pub(crate) fn check_send(&self, receivers: &Receivers, route: &Arc<Route>) {
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

    /// The routes that effects told of are those of the tree.
    pub(crate) fn check(&self, hub: &Hub) {
        let truth: BTreeMap<ContextNumber, Arc<Route>> = hub
            .routes()
            .into_iter()
            .map(|route| (route.number, route))
            .collect();
        assert_eq!(self.routes, truth, "routes agree with the tree");
        for route in truth.values().filter(|_| !self.blind) {
            let members = route.members.iter();
            let listed: BTreeSet<String> = members.map(|member| member.facts.name.to_string()).collect();
            if let Some(members) = self.after.get(&route.path) {
                assert_eq!(*members, listed, "members of {}", route.path);
            }
        }
    }

    pub(crate) fn person(&self, name: &str) -> Option<(PeerId, &Person)> {
        let mut people = self.people.iter();
        let found = people.find(|(_, person)| person.name == name);
        found.map(|(peer, person)| (*peer, person))
    }
}

/// The members of all contexts that the operator may look at, itself aside.
pub(crate) fn members(hub: &mut Hub, now: u64) -> Members {
    let mut all = Members::new();
    for path in PATHS.map(at) {
        let Ok(content) = ask(hub, now, Family::Context, "members", &path) else {
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

/// Whether one route has all that another has, and guards the same; verdicts that stand aside.
fn adds(one: &Route, other: &Route) -> bool {
    let kept = |member: &Arc<Member>| {
        other
            .member(member.peer)
            .is_some_and(|kept| kept.facts == member.facts)
    };
    one.guard == other.guard && one.members.iter().all(kept)
}
