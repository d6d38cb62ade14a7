//! What the hub decides, and how it is carried out.

use std::collections::VecDeque;
use std::sync::Arc;

use mom_hub::{Effect, Input, Inquiry, PeerId};
use mom_proto::{Parcel, Path, event};
use mom_system::sync::Mutex;

use crate::traffic::batch;
use crate::traffic::channel::Message;
use crate::traffic::inquiries::Inquired;
use crate::traffic::switchboard::statistics::MOST_PEERS;
use crate::traffic::switchboard::{Switchboard, Touched};

/// Decisions on their way out of the hub's lock: they are carried out in the order in which they were made, and
/// a thread that waits for the hub does not wait for that.
#[derive(Debug)]
pub(super) struct Decisions {
    /// The effects of decisions that nobody has begun to carry out, and how many decisions there were.
    made: Mutex<(VecDeque<Vec<Effect>>, u64)>,
    /// How many were carried out. Its holder carries out the next ones.
    carried_out: Mutex<u64>,
}

impl Default for Decisions {
    fn default() -> Decisions {
        Decisions {
            made: Mutex::new((VecDeque::new(), 0)),
            carried_out: Mutex::new(0),
        }
    }
}

impl Decisions {
    /// Takes in the effects of a decision, under the lock of the hub that made it; gives its number.
    fn add(&self, effects: Vec<Effect>) -> u64 {
        let mut made = self.made.lock();
        made.0.push_back(effects);
        made.1 += 1;
        made.1
    }

    /// The effects of the next decision.
    fn next(&self) -> Vec<Effect> {
        self.made.lock().0.pop_front().unwrap_or_default()
    }
}

/// Bytes of a reply that count as one peer told.
const LISTED: usize = 64;

/// What a question to the files of the broker counts for: threads that give way read them, and not for nothing.
const INQUIRY: usize = 64;

/// About so many requests are explained where all are asked about.
const TABLE: usize = 32;

/// What a decision costs everybody: the peers that are told, and the members whose routes are made anew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Work(pub(crate) u64);

impl Work {
    fn of(effects: &[Effect], connections: usize) -> Work {
        let one = |effect: &Effect| match effect {
            Effect::Deliver { to, .. } => to.len(),
            Effect::Route(route) => route.members.len(),
            Effect::Stats { parcel, channels, .. } if parcel.context.as_ref().is_some_and(Path::is_root) => {
                channels.len() + connections.min(MOST_PEERS)
            }
            Effect::Stats { channels, .. } => channels.len(),
            Effect::Inquire { inquiry, .. } => match &**inquiry {
                // Each answer is a question to the hub.
                Inquiry::Explain(asked) => asked.about.len() * if asked.verb.is_some() { 1 } else { TABLE },
                Inquiry::Audit { .. } | Inquiry::WhatIf { .. } => INQUIRY,
            },
            // Of a list, each entry was a question to a manager.
            Effect::Reply { parcel, .. } => parcel.size() / LISTED,
            Effect::RouteGone(_)
            | Effect::Send { .. }
            | Effect::Store { .. }
            | Effect::Keep { .. }
            | Effect::Audit(_)
            | Effect::Close { .. } => 1,
        };
        Work(effects.iter().map(one).sum::<usize>() as u64)
    }
}

impl Switchboard {
    /// Gives the hub an input and carries out what it wants; gives what that costs.
    pub(crate) fn decide(&self, input: Input, touched: &mut Touched) -> Work {
        let mut effects = Vec::new();
        let mut hub = self.hub.lock();
        let before = hub.deadline();
        self.tap.handle(&mut hub, input, &mut effects);
        let sooner = hub.deadline() != before;
        let work = Work::of(&effects, self.outboxes.len());
        // Under the hub's lock, so that replies and events leave in the order of decisions.
        let number = self.decisions.add(effects);
        drop(hub);
        if sooner {
            self.deadline_changed.notify_one();
        }
        self.carry_out_up_to(number, touched);
        work
    }

    /// Carries out all decisions up to this one; when it returns they are, by whomever.
    fn carry_out_up_to(&self, number: u64, touched: &mut Touched) {
        let mut carried_out = self.decisions.carried_out.lock();
        while *carried_out < number {
            let effects = self.decisions.next();
            self.carry_out(effects, touched);
            *carried_out += 1;
        }
    }

    fn carry_out(&self, effects: Vec<Effect>, touched: &mut Touched) {
        for effect in effects {
            match effect {
                Effect::Route(route) => touched.extend(self.swap_route(route)),
                Effect::RouteGone(number) => self.drop_route(number),
                Effect::Deliver { to, parcel } => self.spread(&to, &parcel, touched),
                Effect::Reply { to, parcel } => self.push_to_all(&[to], &parcel, touched),
                Effect::Stats {
                    to,
                    parcel,
                    channels,
                    peers,
                } => self.push_stats(to, &parcel, &channels, peers, touched),
                Effect::Inquire { to, parcel, inquiry } => self.inquire(to, &parcel, *inquiry, touched),
                Effect::Send {
                    from,
                    parcel,
                    receivers,
                    route,
                    rate,
                } => {
                    if let Some(channel) = self.channel(route.number) {
                        let message = Message::Admitted(parcel, &route, receivers, rate);
                        self.send_admitted(from, message, &channel, touched);
                    }
                }
                Effect::Store { record, ticket } => self.keep(record, ticket),
                Effect::Keep { record, ticket } => self.keep_stop(&record, ticket),
                Effect::Audit(_) => {}
                Effect::Close { peer, error } => {
                    if let Some(outbox) = self.outbox(peer) {
                        self.close(&outbox, error);
                    }
                }
            }
        }
    }

    /// Leaves a question to the thread that reads the files; says so if that takes no more of them.
    fn inquire(&self, to: PeerId, reply: &Arc<Parcel>, inquiry: Inquiry, touched: &mut Touched) {
        let inquired = Inquired {
            to,
            reply: Arc::clone(reply),
            inquiry,
        };
        if let Err(error) = self.inquiries.ask(inquired) {
            self.tell(to, error.to_parcel(reply.reference), touched);
        }
    }

    /// Gives an event to its receivers. Who comes and goes is written a moment later, together with what others
    /// cause, where many are told: a peer that joins does not make a system call for each of them.
    fn spread(&self, to: &[PeerId], parcel: &Arc<Parcel>, touched: &mut Touched) {
        let presence = [event::JOINED, event::LEFT, event::CREATED, event::DELETED];
        if to.len() < batch::RECEIVERS || !presence.contains(&parcel.name()) {
            return self.push_to_all(to, parcel, touched);
        }
        let mut later = Touched::new();
        self.push_to_all(to, parcel, &mut later);
        self.batch_writer.defer(later);
    }
}
