//! The hub: its state, and the way in.

mod check;
mod configure;
pub(crate) mod input;
pub(crate) mod judge;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use mom_managers::{Micros, Registry};
use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Family, Map, PROTOCOL_VERSION, Parcel, Path, Value, Verb, WireError};

use crate::asking::questions::{Heard, Pending, Refusal};
use crate::contexts::make::{SetupError, make_root, manager_word};
use crate::token::state::Token;
use crate::tree::Tree;
use crate::tree::peers::Peers;
use crate::tree::spec::{self as args, ContextSpec};
use crate::verbs::{self, Request};
use crate::{Effect, Input, PeerId, Record, Settings, Ticket, User};

/// The deterministic state machine that decides everything.
#[derive(Debug)]
pub struct Hub {
    pub(crate) settings: Settings,
    pub(crate) registry: Registry,
    pub(crate) tree: Tree,
    pub(crate) peers: Peers,
    pub(crate) timers: BTreeSet<(Micros, Timer)>,
    pub(crate) now: Micros,
    /// The highest fence of all tokens that were deleted.
    pub(crate) deleted_fence: u64,
    /// Channels from whose routes the present input has taken something, or whose guard it has changed.
    pub(crate) changed: BTreeSet<ContextNumber>,
    /// Channels to whose routes it has only added.
    pub(crate) grown: BTreeSet<ContextNumber>,
    /// Changes of owner that wait until they are durable.
    pub(crate) storing: BTreeMap<Ticket, ContextNumber>,
    pub(crate) last_ticket: u64,
    /// Of each path what was durable before the start.
    pub(crate) records: BTreeMap<Path, Record>,
    pub(crate) last_waiter: u64,
    /// Requests that wait for a verdict, by the number of the question.
    pub(crate) pending: BTreeMap<u64, Pending>,
    pub(crate) last_question: u64,
    /// What was answered about the request that is carried out just now.
    pub(crate) answers: Vec<Heard>,
}

/// What the hub does by itself at some time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Timer {
    /// Ends the ownership of a token.
    Lease(ContextNumber),
    /// Sends a count of members that was held back.
    Count(ContextNumber),
    /// Ends the waiting of a grab.
    Wait(ContextNumber, u64),
    /// Ends an offer.
    Offer(ContextNumber),
    /// Ends a request to an owner.
    Request(ContextNumber, u64),
    /// Ends the waiting for a verdict.
    Answer(u64),
    /// Frees a token that was kept for its owner of before a restart.
    Reserved(ContextNumber),
}

impl Hub {
    /// A hub with a managed root and the contexts of the configuration, which stay for good.
    ///
    /// # Errors
    /// The entry at fault and what is wrong with it.
    pub fn new(
        mut settings: Settings,
        registry: Registry,
        root: &Value,
        contexts: &[ContextSpec],
    ) -> Result<Hub, SetupError> {
        let manager = registry
            .build(root)
            .map_err(|error| SetupError { entry: None, error })?;
        let records = std::mem::take(&mut settings.records);
        let mut hub = Hub {
            settings,
            registry,
            tree: Tree::default(),
            peers: Peers::default(),
            timers: BTreeSet::new(),
            now: 0,
            deleted_fence: 0,
            changed: BTreeSet::new(),
            grown: BTreeSet::new(),
            storing: BTreeMap::new(),
            last_ticket: 0,
            records: records
                .into_iter()
                .map(|record| (record.path.clone(), record))
                .collect(),
            last_waiter: 0,
            pending: BTreeMap::new(),
            last_question: 0,
            answers: Vec::new(),
        };
        let number = hub.tree.next_number();
        hub.tree.insert(make_root(number, manager, manager_word(root)));
        for (entry, spec) in contexts.iter().enumerate() {
            hub.make_configured(spec).map_err(|error| SetupError {
                entry: Some(entry),
                error,
            })?;
        }
        Ok(hub)
    }

    pub(crate) fn make_configured(&mut self, spec: &ContextSpec) -> Result<(), WireError> {
        let Some(path) = &spec.path else {
            return Err(args::bad(
                "path",
                "a context of the configuration needs its path".to_owned(),
            ));
        };
        self.make(args::path(path, "path")?, spec, None).map(|_| ())
    }

    /// The routes of all channels, for a broker that has just made the hub.
    pub fn routes(&self) -> Vec<Arc<crate::Route>> {
        self.tree
            .iter()
            .filter_map(|context| self.route(context.number))
            .map(Arc::new)
            .collect()
    }

    /// Takes one input at a time that never goes back, and appends what is to be done.
    ///
    /// Deadlines up to and at `now` act first. Routes that an input takes something from come before its other
    /// effects, those that it only adds to come after them.
    pub fn handle(&mut self, now: Micros, input: Input, out: &mut Vec<Effect>) {
        self.now = self.now.max(now);
        self.handle_due(out);
        let start = out.len();
        match input {
            Input::Login {
                peer,
                user,
                nickname,
                id,
            } => self.handle_login(peer, user, nickname, id, out),
            Input::Gone { peer } => self.handle_gone(peer, out),
            Input::Request { peer, parcel, clock } => {
                // Only messages have an age, and one may still wait when something else is asked.
                let message = parcel.family == Family::Message;
                if let Some(known) = self.peers.get_mut(peer).filter(|_| message) {
                    known.clock = clock.map(|clock| (clock, self.now));
                }
                self.handle_request(peer, *parcel, Vec::new(), out);
            }
            Input::Stored { ticket, ok } => self.handle_stored(ticket, ok, out),
            Input::Configure(configuration) => self.handle_configuration(*configuration, out),
            Input::Tick => {}
        }
        self.push_changed_routes(start, out);
        // What the input itself has let come due, as a grab does that waits where the lease was over already.
        self.handle_due(out);
    }

    fn handle_due(&mut self, out: &mut Vec<Effect>) {
        while let Some(&(deadline, timer)) = self.timers.first().filter(|(deadline, _)| *deadline <= self.now)
        {
            self.timers.remove(&(deadline, timer));
            let start = out.len();
            self.handle_timer(timer, out);
            self.push_changed_routes(start, out);
        }
    }

    /// When the hub wants to be called at the latest.
    pub fn deadline(&self) -> Option<Micros> {
        self.timers.first().map(|(deadline, _)| *deadline)
    }

    /// The path of a context.
    pub fn path(&self, number: ContextNumber) -> Option<&Path> {
        self.tree.get(number).map(|context| &context.path)
    }

    /// The name of a peer that has logged in.
    pub fn peer_name(&self, peer: PeerId) -> Option<Arc<str>> {
        self.peers.get(peer).map(|peer| Arc::clone(&peer.facts.name))
    }

    fn handle_timer(&mut self, timer: Timer, out: &mut Vec<Effect>) {
        match timer {
            Timer::Lease(token) => self.handle_deadline(token, out),
            Timer::Count(context) => self.push_count(context, out),
            Timer::Wait(token, ticket) => self.handle_waited(token, ticket, out),
            Timer::Offer(token) => self.end_offer(token, "timed-out", out),
            Timer::Request(token, ticket) => self.handle_asked(token, ticket, out),
            Timer::Answer(question) => self.handle_unanswered(question, out),
            Timer::Reserved(token) => self.end_reservation(token, out),
        }
    }

    fn handle_login(
        &mut self,
        peer: PeerId,
        user: User,
        nickname: Option<String>,
        id: Option<u64>,
        out: &mut Vec<Effect>,
    ) {
        if let Some(error) = self.kept_out(&user.name) {
            let parcel = Parcel::new(Family::Login, "login");
            let parcel = id.into_iter().fold(parcel, Parcel::id);
            self.push_refusal(peer, &parcel, &error, out);
            // The refusal says why.
            out.push(Effect::Close { peer, error: None });
            return;
        }
        let details = user.details.clone();
        let same_user = self.peers.get(peer).map(|known| *known.facts.user == *user.name);
        match same_user {
            Some(true) => self.refresh(peer, user),
            known => {
                // Another user on the same connection is another peer: it inherits nothing.
                if known.is_some() {
                    self.handle_gone(peer, out);
                    self.tree.forget(peer);
                }
                let name = nickname.unwrap_or_else(|| user.name.clone());
                self.peers.add(peer, user, &name, self.now);
                if let Some(root) = self.tree.find(&Path::root()).map(|root| root.number) {
                    self.add_member(root, peer, out);
                }
            }
        }
        let mut content = self.welcome(peer);
        details
            .into_iter()
            .for_each(|(key, value)| content.set(&key, value));
        self.push_ok(peer, id, &Path::root(), Some(content), out);
        let fact = self.fact("login", peer);
        self.audit(fact, out);
    }

    /// Puts the facts of a repeated login everywhere; verdicts about the old ones stand no more.
    pub(crate) fn refresh(&mut self, peer: PeerId, user: User) {
        let Some(facts) = self.peers.update(peer, user) else {
            return;
        };
        let joined: Vec<ContextNumber> = self
            .peers
            .get(peer)
            .map(|peer| peer.joined.iter().copied().collect())
            .unwrap_or_default();
        for number in joined {
            if let Some(context) = self.tree.get_mut(number) {
                if let Some(member) = context.members.get_mut(&peer) {
                    *member = Arc::new(member.unjudged(Arc::clone(&facts)).holding(false));
                }
                self.changed.insert(number);
            }
        }
        // Routes show the level of the owner, or of who lent it the token, also to channels that it has not joined.
        let known = self.peers.get(peer);
        let tokens = known.map(|peer| peer.owns.iter().chain(&peer.involved).copied().collect());
        let tokens: Vec<ContextNumber> = tokens.unwrap_or_default();
        tokens
            .into_iter()
            .for_each(|token| self.change_guarded_routes(token));
    }

    fn welcome(&self, peer: PeerId) -> Map {
        let Some(peer) = self.peers.get(peer) else {
            return Map::new();
        };
        let groups = peer
            .facts
            .groups
            .iter()
            .map(|group| Value::from(group.as_str()))
            .collect::<Vec<_>>();
        let (major, minor) = PROTOCOL_VERSION;
        crate::world::events::peer_map(&peer.facts)
            .with("groups", groups)
            .with(
                "protocol",
                Map::new()
                    .with("major", i32::from(major))
                    .with("minor", i32::from(minor)),
            )
            .with("limits", self.settings.limits.to_map())
            .with("time", self.wall())
    }

    pub(crate) fn handle_gone(&mut self, peer: PeerId, out: &mut Vec<Effect>) {
        if self.peers.get(peer).is_none() {
            return;
        }
        let fact = self.fact("gone", peer);
        if let Some(root) = self.tree.find(&Path::root()).map(|root| root.number) {
            self.leave(root, peer, Reason::Disconnected, out);
        }
        self.end_pending(peer, out);
        self.audit(fact, out);
        self.peers
            .remove(peer, self.now.saturating_add(self.settings.name_rest));
        self.end_questions(peer, out);
    }

    pub(crate) fn handle_request(
        &mut self,
        peer: PeerId,
        parcel: Parcel,
        answers: Vec<Heard>,
        out: &mut Vec<Effect>,
    ) {
        let start = out.len();
        let (verb, path) = match self.read_request(peer, &parcel) {
            Ok(read) => read,
            Err(error) => return self.push_refusal(peer, &parcel, &error, out),
        };
        let mut request = Request {
            peer,
            verb,
            path,
            parcel,
        };
        self.answers = answers;
        let result = verbs::carry_out(self, &mut request, out);
        let answers = std::mem::take(&mut self.answers);
        match result {
            Ok(()) => {}
            Err(Refusal::Error(error)) => {
                debug_assert_eq!(out.len(), start, "a refused request has no effects: {error}");
                self.push_refusal(peer, &request.parcel, &error, out);
            }
            Err(Refusal::Defer(deferred)) => {
                debug_assert_eq!(out.len(), start, "a deferred request has no effects");
                self.postpone(peer, request.parcel, answers, &deferred, out);
            }
        }
    }

    fn read_request(&self, peer: PeerId, parcel: &Parcel) -> Result<(Verb, Path), WireError> {
        if self.peers.get(peer).is_none() {
            let text = "log in first: family login, name login";
            return Err(WireError::new(Code::NOT_LOGGED_IN, text));
        }
        let verb = Verb::of(parcel.family, &parcel.name)?;
        Ok((verb, self.path_of(parcel, verb)?))
    }

    /// Puts the routes that an input changed around its other effects: what takes away comes first, so that
    /// nothing old follows news of it; what only adds comes last, so that a member is told before it hears.
    fn push_changed_routes(&mut self, start: usize, out: &mut Vec<Effect>) {
        let changed = std::mem::take(&mut self.changed);
        let grown = std::mem::take(&mut self.grown);
        out.extend(
            grown
                .difference(&changed)
                .filter_map(|number| self.route_effect(*number)),
        );
        if !changed.is_empty() {
            let first: Vec<Effect> = changed
                .iter()
                .filter_map(|number| self.route_effect(*number))
                .collect();
            out.splice(start..start, first);
        }
    }

    fn route_effect(&self, number: ContextNumber) -> Option<Effect> {
        match self.route(number) {
            Some(route) => Some(Effect::Route(Arc::new(route))),
            None if self.tree.get(number).is_none() => Some(Effect::RouteGone(number)),
            None => None,
        }
    }

    pub(crate) fn token_mut(&mut self, number: ContextNumber) -> Option<&mut Token> {
        self.tree.get_mut(number).and_then(|context| context.token_mut())
    }

    pub(crate) fn token(&self, number: ContextNumber) -> Option<&Token> {
        self.tree.get(number).and_then(|context| context.token())
    }
}
