//! Who hears of whom (M30, design §7).

use mom_proto::event;
use mom_proto::{ContextNumber, Map};

use crate::Effect;
use crate::tree::context::Presence;
use crate::values::count;
use crate::world::{Timer, World};

impl World {
    /// Tells the members of a context of one that has joined or left, as the context has it.
    pub(super) fn push_presence(
        &mut self,
        number: ContextNumber,
        name: &str,
        who: Map,
        out: &mut Vec<Effect>,
    ) {
        let (now, above, every) = (self.now, self.settings.counts_above, self.settings.counts_every);
        let Some(context) = self.tree.get_mut(number) else {
            return self.fault("a context that is not there was joined or left");
        };
        let members = context.members.len();
        let counted = match context.presence {
            Presence::None => return,
            Presence::All => false,
            Presence::Counts => members > above,
        };
        if counted && now < context.next_count {
            if !context.count_due {
                context.count_due = true;
                self.timers.insert((context.next_count, Timer::Count(number)));
            }
            return;
        }
        let path = context.path.clone();
        let content = if counted {
            context.next_count = now + every;
            count_map(members)
        } else {
            who
        };
        self.push_event(name, &path, self.tree.members_of(number), content, out);
    }

    /// Tells the members of a context what has become of one of them, where each is told of by name.
    pub(super) fn push_by_name(&self, number: ContextNumber, name: &str, who: Map, out: &mut Vec<Effect>) {
        let above = self.settings.counts_above;
        // It may have been deleted since.
        let Some(context) = self.tree.get(number) else {
            return;
        };
        let named = match context.presence {
            Presence::None => false,
            Presence::All => true,
            Presence::Counts => context.members.len() <= above,
        };
        if named {
            self.push_event(name, &context.path, self.tree.members_of(number), who, out);
        }
    }

    /// Sends the count that was held back, also if so many have left that each is told of by name again.
    pub(crate) fn push_count(&mut self, number: ContextNumber, out: &mut Vec<Effect>) {
        let next = self.now + self.settings.counts_every;
        // The context may have been deleted since.
        let Some(context) = self.tree.get_mut(number) else {
            return;
        };
        context.count_due = false;
        context.next_count = next;
        let (path, content) = (context.path.clone(), count_map(context.members.len()));
        self.push_event(event::JOINED, &path, self.tree.members_of(number), content, out);
    }
}

fn count_map(members: usize) -> Map {
    Map::new().with("count", count(members))
}
