//! What of a device's queue others than the owner of its token may fill: it is not closed because of what somebody sends to it.
//!
//! What needs no token may fill three quarters of the bound, and what one user says of it a quarter. More is refused, to its sender: the
//! rest is for the owner's commands.

use std::sync::Arc;

use mom_net::{Item as _, Lane};
use mom_proto::{Delivery, Micros};

use super::PeerQueue;
use crate::traffic::memory::Account;
use crate::traffic::outbox::Packet;

/// Who has how much is looked up at most so often, µs: that takes as long as much waits.
const LOOK: Micros = 20_000;

/// Who has how much waiting, as of the last look, with what came since. What has left since counts until the next.
#[derive(Debug, Default)]
pub(super) struct Shares {
    looked_at: Option<Micros>,
    users: Vec<(Arc<Account>, usize)>,
    /// Of all, also of who has no account.
    all: usize,
    /// Bytes that the device reads in a second.
    pace: Option<u32>,
}

/// Whether what waits is within the shares: it may not be dropped, and needs no token.
fn is_shared(packet: &Packet) -> bool {
    matches!(packet.lane, Lane::Data(_)) && packet.gate.is_none() && packet.delivery == Delivery::Reliable
}

impl PeerQueue {
    /// It is a device's from now on, which reads so many bytes in a second, if that is known.
    pub(crate) fn note_device(&mut self, pace: Option<u32>) {
        let shares = self.shares.get_or_insert_default();
        shares.pace = pace.or(shares.pace);
    }

    /// Whether it is a device's.
    pub(crate) fn is_device(&self) -> bool {
        self.shares.is_some()
    }

    /// The bytes that wait for a device, may not be dropped and are not its owner's: it is not slow for those. None if one more is beyond
    /// what its sender may have waiting.
    pub(super) fn share_out(&mut self, packet: &Packet, now: Micros) -> Option<usize> {
        let Some(shares) = &mut self.shares else {
            return Some(0);
        };
        let most = shares.pace.and_then(|pace| usize::try_from(pace).ok());
        let (form, limit) = (self.queue.form(), self.queue.limit());
        let limit = most.map_or(limit, |most| limit.min(most));
        let size = packet.charge(form);
        let few = self.queue.data_bytes() + size <= limit / 4;
        if shares.looked_at.is_none_or(|at| now.saturating_sub(at) >= LOOK) {
            **shares = Shares {
                pace: shares.pace,
                ..Shares::default()
            };
            if few {
                return Some(0);
            }
            shares.looked_at = Some(now);
            let waiting = self.queue.data().filter(|waiting| is_shared(waiting));
            waiting.for_each(|waiting| shares.add(waiting.account(), waiting.charge(form)));
        }
        if is_shared(packet) {
            // One message of any size where none waits: of this user, and of all.
            let beyond = |held: usize, most: usize| held > 0 && held + size > most;
            if !few && (beyond(shares.all, limit / 4 * 3) || beyond(shares.of(packet.account()), limit / 4)) {
                return None;
            }
            shares.add(packet.account(), size);
        }
        Some(shares.all)
    }
}

impl Shares {
    fn of(&self, account: Option<&Arc<Account>>) -> usize {
        let own =
            |(known, _): &&(Arc<Account>, usize)| account.is_some_and(|account| Arc::ptr_eq(known, account));
        self.users.iter().find(own).map_or(0, |(_, held)| *held)
    }

    fn add(&mut self, account: Option<&Arc<Account>>, bytes: usize) {
        self.all += bytes;
        let Some(account) = account else { return };
        match self
            .users
            .iter_mut()
            .find(|(known, _)| Arc::ptr_eq(known, account))
        {
            Some((_, held)) => *held += bytes,
            None => self.users.push((Arc::clone(account), bytes)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use bytes::Bytes;
    use mom_net::Taken;
    use mom_proto::codec::Encoded;
    use mom_proto::{Limits, Time};
    use mom_system::Clock;
    use mom_system::sync::atomic::AtomicU64;

    use super::super::tests::{data, pop, queue};
    use super::*;
    use crate::traffic::encodings::Encodings;
    use crate::traffic::memory::Memory;
    use crate::traffic::outbox::Charged;

    /// One of 1000 bytes, charged to this account.
    fn note(account: &Arc<Account>) -> Packet {
        let packet = Arc::into_inner(data("note", Delivery::Reliable)).expect("nobody else has it");
        Packet {
            charged: Charged::to(Some(account), &packet.encodings),
            ..packet
        }
    }

    #[test]
    fn a_user_has_a_quarter_all_have_three_and_the_owner_the_rest() {
        share(20_000, None);
    }

    #[test]
    fn of_what_it_reads_in_a_second_where_that_is_less() {
        share(4 << 20, Some(20_000));
        share(20_000, Some(4 << 20));
    }

    fn share(limit: usize, pace: Option<u32>) {
        let clock = Clock::manual(Time::default());
        let memory = Memory::default();
        let users = ["a", "b", "c", "d", "e"].map(|user| memory.account(&user.into()));
        let mut queue = queue(limit);
        queue.note_device(pace);
        let mut push = |packet: Packet| queue.push(Arc::new(packet), &clock);
        let mut taken = Vec::new();
        for user in &users {
            taken.push((0..20).filter(|_| push(note(user)) == Taken::Yes).count());
        }
        assert_eq!(taken, [5, 5, 5, 0, 0]);
        let gate = Arc::new(AtomicU64::new(7));
        let command = |account| Packet {
            gate: Some((Arc::clone(&gate), 7)),
            ..note(account)
        };
        assert!((0..5).all(|_| push(command(&users[0])) == Taken::Yes));
        // Whatever has left since counts no more.
        for _ in 0..12 {
            pop(&mut queue, 0).expect("it waits");
        }
        clock.advance(Duration::from_millis(30));
        assert_eq!(queue.push(Arc::new(note(&users[3])), &clock), Taken::Yes);
    }

    /// What somebody else has waiting, begun or not, is no reason to close it when its owner says something.
    #[test]
    fn a_device_is_slow_for_what_its_owner_says_only() {
        let clock = Clock::manual(Time::default());
        let memory = Memory::default();
        let [stranger, owner] = ["a", "b"].map(|user| memory.account(&user.into()));
        let mut queue = queue(1500);
        queue.set_limits(&Limits {
            outbox: 1500,
            burst: 1500,
            stalled: 5000,
            ..Limits::default()
        });
        queue.note_device(None);
        let large = Packet {
            count: 100,
            encodings: Encodings::of_run(Encoded {
                head: vec![7; 100_000].into(),
                body: Bytes::new(),
            }),
            ..note(&stranger)
        };
        assert_eq!(queue.push(Arc::new(large), &clock), Taken::Yes);
        let gate = Arc::new(AtomicU64::new(7));
        let command = |queue: &mut PeerQueue| {
            clock.advance(Duration::from_secs(6));
            let command = Packet {
                gate: Some((Arc::clone(&gate), 7)),
                lane: Lane::Data(1000),
                ..note(&owner)
            };
            queue.push(Arc::new(command), &clock)
        };
        assert_eq!(command(&mut queue), Taken::Yes);
        assert!(pop(&mut queue, 0).is_some(), "the command leaves first");
        assert_eq!(command(&mut queue), Taken::Yes);
        // It does not read what its owner says.
        assert_eq!(command(&mut queue), Taken::Overflow);
    }

    #[test]
    fn one_of_any_size_goes_where_none_waits_and_not_only_what_is_connected_is_held_to_it() {
        let clock = Clock::manual(Time::default());
        let account = Memory::default().account(&"a".into());
        let mut queue = queue(1000);
        queue.note_device(None);
        queue.lost = true;
        let mut push = || queue.push(Arc::new(note(&account)), &clock);
        assert_eq!([push(), push()], [Taken::Yes, Taken::Overflow]);
    }
}
