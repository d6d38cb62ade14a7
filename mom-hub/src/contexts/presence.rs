//! Who hears of whom (M30, design §7).

use mom_managers::PeerFacts;
use mom_proto::event;
use mom_proto::{ContextNumber, Map};

use crate::Effect;
use crate::tree::context::Presence;
use crate::values::count;
use crate::world::events::peer_map;
use crate::world::{Timer, World};

impl World {
    /// Tells the members of a context of one that has joined or left, as the context has it.
    pub(super) fn push_presence(
        &mut self,
        number: ContextNumber,
        name: &str,
        who: &PeerFacts,
        out: &mut Vec<Effect>,
    ) {
        let Some(context) = self.tree.get(number) else {
            return self.fault("reporting a join or leave of a context that does not exist");
        };
        let (presence, next_count) = (context.presence, context.next_count);
        if presence == Presence::None {
            return;
        }
        if self.is_named(number, who) {
            self.push_who(number, name, peer_map(who), out);
        } else if self.now < next_count {
            self.hold_count(number);
        } else {
            self.push_count_as(number, name, out);
        }
    }

    /// Tells the members of a context what has become of one of them, where each is told of by name.
    pub(super) fn push_by_name(
        &mut self,
        number: ContextNumber,
        name: &str,
        (who, content): (&PeerFacts, Map),
        out: &mut Vec<Effect>,
    ) {
        // It may have been deleted since.
        let Some(presence) = self.tree.get(number).map(|context| context.presence) else {
            return;
        };
        if presence != Presence::None && self.is_named(number, who) {
            self.push_who(number, name, content, out);
        }
    }

    fn push_who(&self, number: ContextNumber, name: &str, who: Map, out: &mut Vec<Effect>) {
        if let Some(context) = self.tree.get(number) {
            self.push_event(name, &context.path, self.tree.members_of(number), who, out);
        }
    }

    /// Whether a context tells of this one by name now. A peer that comes and goes again and again is counted, lest others hear of
    /// nothing else; that counts for each user alone, so nobody hides by it who else comes or goes.
    fn is_named(&mut self, number: ContextNumber, who: &PeerFacts) -> bool {
        let above = self.settings.counts_above;
        let Some(context) = self.tree.get(number) else {
            return false;
        };
        let many = context.presence == Presence::Counts && context.members.len() > above;
        !many && self.count_presence(number, &who.user).is_ok()
    }

    /// Has a count follow when it is time for one.
    pub(crate) fn hold_count(&mut self, number: ContextNumber) {
        if let Some(context) = self.tree.get_mut(number).filter(|context| !context.count_due) {
            context.count_due = true;
            self.timers.insert((context.next_count, Timer::Count(number)));
        }
    }

    /// Sends the count that was held back, also if so many have left that each is told of by name again.
    pub(crate) fn push_count(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        // The context may have been deleted since.
        if let Some(context) = self.tree.get_mut(number) {
            context.count_due = false;
            self.push_count_as(number, event::JOINED, out);
        }
    }

    fn push_count_as(&mut self, number: ContextNumber, name: &str, out: &mut Vec<Effect>) {
        let next = self.now + self.settings.counts_every;
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        context.next_count = next;
        let (path, content) = (context.path.clone(), count_map(context.members.len()));
        self.push_event(name, &path, self.tree.members_of(number), content, out);
    }
}

fn count_map(members: usize) -> Map {
    Map::new().with("count", count(members))
}
