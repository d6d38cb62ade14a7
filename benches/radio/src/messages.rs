//! The messages whose fate is open.

use std::collections::{BTreeMap, VecDeque};

use crate::{Fate, MessageId, Micros, Outcome, Reason, Station};

#[derive(Debug)]
struct Open {
    from: Station,
    to: Station,
    sent: Micros,
    /// Parts that have not arrived.
    missing: u32,
    attempts: u32,
}

/// Tells the fate of each message once.
#[derive(Debug, Default)]
pub(crate) struct Messages {
    next: u64,
    open: BTreeMap<MessageId, Open>,
    told: VecDeque<Outcome>,
}

impl Messages {
    pub(crate) fn add(&mut self, now: Micros, from: Station, to: Station, parts: u32) -> MessageId {
        let message = MessageId(self.next);
        self.next += 1;
        let open = Open {
            from,
            to,
            sent: now,
            missing: parts,
            attempts: 0,
        };
        self.open.insert(message, open);
        message
    }

    /// Frames of it were so often on the air; nothing where its fate is known.
    pub(crate) fn attempted(&mut self, message: MessageId, attempts: u32) {
        if let Some(open) = self.open.get_mut(&message) {
            open.attempts += attempts;
        }
    }

    /// A part of it has arrived.
    pub(crate) fn arrived(&mut self, now: Micros, message: MessageId) {
        let Some(open) = self.open.get_mut(&message) else {
            return;
        };
        open.missing = open.missing.saturating_sub(1);
        if open.missing == 0 {
            let attempts = open.attempts;
            self.tell(now, message, Fate::Delivered { attempts });
        }
    }

    pub(crate) fn lost(&mut self, now: Micros, message: MessageId, why: Reason) {
        self.tell(now, message, Fate::Lost(why));
    }

    fn tell(&mut self, now: Micros, message: MessageId, fate: Fate) {
        let Some(open) = self.open.remove(&message) else {
            return;
        };
        self.told.push_back(Outcome {
            message,
            from: open.from,
            to: open.to,
            sent: open.sent,
            at: now,
            fate,
        });
    }

    /// The next fate that nobody has heard of.
    pub(crate) fn next(&mut self) -> Option<Outcome> {
        self.told.pop_front()
    }

    pub(crate) fn first(&self) -> Option<&Outcome> {
        self.told.front()
    }

    pub(crate) fn undecided(&self) -> usize {
        self.open.len()
    }
}
