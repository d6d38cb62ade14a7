//! What of a device's queue others than the owner of its token may fill: it is not closed because of what others send to it.
//!
//! What needs no token may fill three quarters of the bound, and what one user says of it a quarter. More is refused, to its sender: the
//! rest is for the owner's commands. What the hub tells it of others goes before commands up to an eighth of what it
//! reads, and behind all messages beyond that, as far as there is room.

use std::sync::Arc;

use mom_net::{DropReason, Item as _, Lane, Taken};
use mom_proto::{Delivery, Gcra, Micros, Pace};
use mom_system::Clock;

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
    /// Of what the hub tells it of others.
    news: usize,
    /// How much of that has gone before commands.
    ahead: Gcra,
}

/// Bytes that a device is taken to read in a second where nobody says so.
const READS: u64 = 20_000;

/// Whether what waits is within the shares: it may not be dropped, and needs no token.
fn is_shared(packet: &Packet) -> bool {
    matches!(packet.lane, Lane::Data(_))
        && packet.gate.is_none()
        && packet.delivery == Delivery::Reliable
        && !packet.is_news()
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

    /// Puts in what the hub tells a device of others: as it is where little of that was told lately, and else `behind` all messages.
    /// Where much waits already it is dropped, and the device is told so.
    pub(crate) fn push_news(&mut self, packet: Arc<Packet>, behind: &Arc<Packet>, clock: &Clock) -> Taken {
        let form = self.queue.form();
        let (size, waits) = (as_count(packet.charge(form)), self.queue.has_data_at(behind.lane));
        if let Some(shares) = self.shares.as_mut().filter(|_| !waits) {
            // An eighth in the long run, half a second's worth at once.
            let reads = shares.pace.map_or(READS, u64::from);
            let pace = Pace::per_second((reads / 8).max(1), reads / 2);
            if shares.ahead.take(&pace, size, clock.now()).is_ok() {
                return self.push(packet, clock);
            }
        }
        match self.push(Arc::clone(behind), clock) {
            Taken::Overflow => {
                self.queue.note_dropped(behind, DropReason::Full);
                Taken::Dropped
            }
            taken => taken,
        }
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
                ahead: shares.ahead,
                ..Shares::default()
            };
            if few {
                return Some(0);
            }
            shares.looked_at = Some(now);
            for waiting in self.queue.data() {
                match waiting.is_news() {
                    true => shares.news += waiting.charge(form),
                    false if is_shared(waiting) => shares.add(waiting.account(), waiting.charge(form)),
                    false => {}
                }
            }
        }
        let beyond = |held: usize, most: usize| held > 0 && held + size > most;
        if packet.is_news() {
            // What is made and deleted is told as far as the outbox has room for it, however slow the device is.
            let most = match packet.delivery {
                Delivery::Reliable => self.queue.limit() / 2,
                Delivery::Latest | Delivery::Fleeting => limit / 4,
            };
            if !few && beyond(shares.news, most) {
                return None;
            }
            shares.news += size;
        }
        if is_shared(packet) {
            // One message of any size where none waits: of this user, and of all.
            if !few && (beyond(shares.all, limit / 4 * 3) || beyond(shares.of(packet.account()), limit / 4)) {
                return None;
            }
            shares.add(packet.account(), size);
        }
        Some(shares.all + shares.news)
    }
}

fn as_count(bytes: usize) -> u64 {
    u64::try_from(bytes).unwrap_or(u64::MAX)
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
    use mom_proto::codec::Encoded;
    use mom_proto::{Limits, Time};
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

    /// What another sender has waiting, begun or not, must not close it when its owner says something.
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

    /// Of what others do: an eighth of what it reads before commands, a quarter of that behind them, and the rest not at all.
    #[test]
    fn little_of_others_goes_before_commands_and_not_much_behind_them() {
        let clock = Clock::manual(Time::default());
        let mut queue = queue(100_000);
        queue.note_device(Some(20_000));
        let control = Packet {
            lane: Lane::Control,
            ..note(&Memory::default().account(&"a".into()))
        };
        let joined = Arc::new(control);
        let tell = |queue: &mut PeerQueue, count: usize, class: Delivery| {
            let news = Arc::new(joined.as_news(class));
            let taken = (0..count).map(|_| queue.push_news(Arc::clone(&joined), &news, &clock));
            taken.filter(|taken| *taken == Taken::Yes).count()
        };
        let ahead = 10;
        assert_eq!(tell(&mut queue, 50, Delivery::Fleeting), ahead + 5);
        assert_eq!(queue.take_drops().values().sum::<u64>(), 35);
        let gate = Arc::new(AtomicU64::new(7));
        let command = Packet {
            gate: Some((gate, 7)),
            lane: Lane::Data(1000),
            ..note(&Memory::default().account(&"b".into()))
        };
        assert_eq!(queue.push(Arc::new(command), &clock), Taken::Yes);
        // What is made and deleted has half of the outbox, however slow the device is.
        assert!((40..=50).contains(&tell(&mut queue, 200, Delivery::Reliable)));
        let lanes = std::iter::from_fn(|| pop(&mut queue, 0));
        let lanes: Vec<Lane> = lanes
            .filter_map(|piece| piece.item().map(|packet| packet.lane))
            .collect();
        let (control, behind) = lanes.split_at(ahead);
        assert!(control.iter().all(|lane| *lane == Lane::Control), "{lanes:?}");
        assert_eq!(behind[0], Lane::Data(1000));
        // As soon as none waits, and so much later as it has gone ahead of, there is room again.
        clock.advance(Duration::from_secs(1));
        assert_eq!(tell(&mut queue, 2, Delivery::Fleeting), 2);
        let lanes = std::iter::from_fn(|| pop(&mut queue, 0));
        let lanes: Vec<Lane> = lanes
            .filter_map(|piece| piece.item().map(|packet| packet.lane))
            .collect();
        assert_eq!(lanes, [Lane::Control, Lane::Control]);
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
