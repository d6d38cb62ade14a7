//! The hub from outside: inputs, deadlines, and a few questions.

mod appraise;
mod check;
mod configure;
pub(crate) mod input;
pub(crate) mod judge;
mod login;
mod wall;

use std::sync::Arc;

use mom_managers::Registry;
use mom_proto::{ContextNumber, Family, Micros, Path, Value};

use crate::asking::questions::{Due, Questions};
use crate::contexts::make::{SetupError, make_root, manager_word};
use crate::stops::end_call;
use crate::tree::context::Role;
use crate::tree::latch::StopRecord;
use crate::verbs;
use crate::world::{Timer, World};
use crate::{ContextSpec, Effect, Input, PeerId, Route, Settings};

/// The deterministic state machine that decides everything.
#[derive(Debug)]
pub struct Hub {
    world: World,
    questions: Questions,
}

impl Hub {
    /// A hub with a managed root and the contexts of the configuration, which stay for good.
    ///
    /// # Errors
    /// The entry at fault and what is wrong with it.
    pub fn new(
        settings: Settings,
        registry: Registry,
        root: &Value,
        contexts: &[ContextSpec],
    ) -> Result<Hub, SetupError> {
        let manager = registry
            .build(root)
            .map_err(|error| SetupError { entry: None, error })?;
        let mut world = World::new(settings, registry);
        let number = world.tree.next_number();
        world.tree.insert(make_root(number, manager, manager_word(root)));
        for (entry, spec) in contexts.iter().enumerate() {
            world.make_configured(spec).map_err(|error| SetupError {
                entry: Some(entry),
                error,
            })?;
        }
        Ok(Hub {
            world,
            questions: Questions::default(),
        })
    }

    /// How the devices of the channels that are there stand. A broker that could not read what was kept keeps this instead, or a second
    /// restart would take those of which nobody has spoken since for free. One that is made later is stopped up to that restart only.
    pub fn stop_records(&self) -> Vec<StopRecord> {
        let contexts = self.world.tree.iter();
        let channels = contexts.filter(|context| matches!(context.role, Role::Channel(_)));
        channels
            .map(|channel| self.world.stops.record(&channel.path))
            .collect()
    }

    /// The routes of all channels, for a broker that has just made the hub.
    pub fn routes(&self) -> Vec<Arc<Route>> {
        self.world.routes()
    }

    /// Takes one input at a time that never goes back, and appends what is to be done.
    ///
    /// Deadlines up to and at `now` act first. Routes that an input takes something from come before its other
    /// effects, those that it only adds to come after them.
    pub fn handle(&mut self, now: Micros, input: Input, out: &mut Vec<Effect>) {
        self.world.now = self.world.now.max(now);
        self.handle_due(out);
        let start = out.len();
        self.handle_input(input, out);
        verbs::run_waiting(&mut self.world, &mut self.questions, out);
        self.world.push_changed_routes(start, out);
        // Deadlines that the input itself has made due, as a grab does that begins to wait after the lease is over.
        self.handle_due(out);
        self.world.push_faults(out);
    }

    fn handle_input(&mut self, input: Input, out: &mut Vec<Effect>) {
        let Hub { world, questions } = self;
        match input {
            Input::Login {
                peer,
                user,
                nickname,
                id,
            } => login::log_in(world, questions, (peer, user, nickname), id, out),
            Input::Gone { peer } => verbs::depart(world, questions, peer, out),
            Input::Lost { peer, grace } => {
                let due = verbs::lose(world, questions, peer, grace, out);
                verbs::run_all(world, questions, due, out);
            }
            Input::Resumed { peer } => verbs::resume(world, peer, out),
            Input::Request { peer, parcel, clock } => {
                // Only messages have an age, and one may still wait when something else is asked.
                let message = parcel.family == Family::Message;
                if let Some(known) = world.peers.get_mut(peer).filter(|_| message) {
                    known.clock = clock.map(|clock| (clock, world.now));
                }
                verbs::run(world, questions, Due::new(peer, *parcel), out);
            }
            Input::Stored { ticket, ok } => {
                if let Some(storing) = world.stops.storing.remove(&ticket) {
                    world.take_kept(storing, ok, out);
                    return;
                }
                // The queue has advanced first; now the requests that came while this was stored.
                if let Some(token) = world.take_stored(ticket, ok, out) {
                    verbs::run_waiting(world, questions, out);
                    verbs::run_held_back(world, questions, token, out);
                }
            }
            Input::Configure(configuration) => configure::configure(world, questions, *configuration, out),
            Input::Tick => {}
            Input::Wall { ahead } => wall::step(world, ahead, out),
        }
    }

    fn handle_due(&mut self, out: &mut Vec<Effect>) {
        while let Some(&(deadline, timer)) = self.world.timers.first()
            && deadline <= self.world.now
        {
            self.world.timers.remove(&(deadline, timer));
            let start = out.len();
            self.handle_timer(timer, out);
            verbs::run_waiting(&mut self.world, &mut self.questions, out);
            self.world.push_changed_routes(start, out);
        }
    }

    fn handle_timer(&mut self, timer: Timer, out: &mut Vec<Effect>) {
        let Hub { world, questions } = self;
        match timer {
            Timer::Lease(token) => world.end_at_deadline(token, out),
            Timer::Count(context) => world.push_count(context, out),
            Timer::Wait(token, ticket) => world.end_wait(token, ticket, out),
            Timer::Turn(token) => world.advance_queue(token, out),
            Timer::Offer(token) => world.end_offer(token, "timed-out", out),
            Timer::Request(token, ticket) => world.end_asked(token, ticket, out),
            Timer::Answer(question) => {
                let due = questions.unanswered(world, question, out);
                verbs::run_all(world, questions, due, out);
            }
            Timer::Call(call) => end_call(world, call, out),
            Timer::Step => {
                for left in world.go_on(out) {
                    verbs::follow(world, questions, left, out);
                }
            }
            Timer::Reserved(token) => world.end_reservation(token, out),
            Timer::Grace(peer) => verbs::end_grace(world, questions, peer, out),
        }
    }

    /// When the hub wants to be called at the latest.
    pub fn deadline(&self) -> Option<Micros> {
        self.world.timers.first().map(|(deadline, _)| *deadline)
    }

    /// The path of a context.
    pub fn path(&self, number: ContextNumber) -> Option<&Path> {
        self.world.tree.get(number).map(|context| &context.path)
    }

    /// The name of a peer that has logged in.
    pub fn peer_name(&self, peer: PeerId) -> Option<Arc<str>> {
        let peer = self.world.peers.get(peer);
        peer.map(|peer| Arc::clone(&peer.facts.name))
    }
}
