//! What is done where the hub runs out of memory.

use std::cmp::Reverse;
use std::sync::Arc;

use mom_proto::{Code, Delivery, WireError};

use crate::traffic::channel::Channel;
use crate::traffic::memory::Account;
use crate::traffic::outbox::Outbox;
use crate::traffic::switchboard::Switchboard;

/// A queue that holds less is left alone.
const SMALL: usize = 64 * 1024;

impl Switchboard {
    /// Lets the largest queues lose what may be dropped, and puts out who has been charged most for too long; to be called
    /// again while [`Memory::excess`](crate::traffic::memory::Memory::excess) is not 0.
    pub(crate) fn relieve(&self) {
        if let Some(most) = self.memory.settle(self.clock.now()) {
            self.put_out(&most);
        }
        let excess = self.memory.excess();
        if excess == 0 {
            return;
        }
        let outboxes = self
            .outboxes
            .iter()
            .map(|outbox| (outbox.queued(), Arc::clone(&outbox)));
        let mut largest: Vec<(usize, Arc<Outbox>)> = outboxes.filter(|(queued, _)| *queued > SMALL).collect();
        largest.sort_by_key(|(queued, _)| Reverse(*queued));
        let mut freed = 0;
        for (_, outbox) in largest {
            if freed >= excess {
                return;
            }
            freed += outbox.drop_for_memory(|packet| packet.delivery != Delivery::Reliable);
        }
    }

    /// Ends all connections of a user, and forgets all that waits or is kept of it.
    fn put_out(&self, account: &Arc<Account>) {
        tracing::warn!(
            user = account.user(),
            bytes = account.held(),
            "disconnected: no memory left for this user's queued messages"
        );
        let outboxes: Vec<Arc<Outbox>> = self.outboxes.iter().map(|outbox| Arc::clone(&outbox)).collect();
        for outbox in &outboxes {
            if outbox.account().is_some_and(|other| Arc::ptr_eq(&other, account)) {
                let text = "the hub's memory was exhausted, and this user's queued messages took more of it than any other's";
                self.close(outbox, Some(WireError::new(Code::OUT_OF_MEMORY, text)));
            }
            outbox.drop_for_memory(|packet| packet.is_of(account));
        }
        let channels: Vec<Arc<Channel>> = self.channels.iter().map(|channel| Arc::clone(&channel)).collect();
        channels.iter().for_each(|channel| channel.forget(account));
    }
}
