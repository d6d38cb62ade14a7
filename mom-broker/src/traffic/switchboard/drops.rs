//! What receivers and senders are told of messages that were dropped on their way (design §5, §7).

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::DropReason;
use mom_proto::{ContextNumber, Family, HUB, Map, Parcel, Path, event};

use super::{Switchboard, Touched};
use crate::traffic::channel::{HUB_PEER, stamped};
use crate::traffic::outbox::{Dropped, Outbox};

/// Receivers of whom a sender hears one by one; of more, devices alone. It hears that before all data, and nobody has
/// it hear of nothing else by many peers that read nothing, or are gone for a while.
const RECEIVERS: usize = 8;

/// What one receiver did not get, as its sender is told.
struct Missed {
    count: u64,
    receiver: Arc<str>,
    is_device: bool,
    path: Path,
}

impl Switchboard {
    /// Tells of everything that was dropped lately.
    pub(crate) fn report_drops(&self, touched: &mut Touched) {
        let outboxes: Vec<Arc<Outbox>> = self.outboxes.iter().map(|outbox| Arc::clone(&outbox)).collect();
        self.report_drops_of(outboxes.iter().map(|outbox| &**outbox), touched);
    }

    /// The same, on the way to these.
    pub(super) fn report_drops_of<'a>(
        &self,
        outboxes: impl IntoIterator<Item = &'a Outbox>,
        touched: &mut Touched,
    ) {
        let mut missed: BTreeMap<Dropped, Vec<Missed>> = BTreeMap::new();
        for outbox in outboxes {
            self.tell_receiver(outbox, &mut missed, touched);
        }
        for (dropped, missed) in missed {
            self.tell_sender(dropped, missed, touched);
        }
    }

    /// Tells a receiver what it did not get, and notes it for the senders.
    fn tell_receiver(
        &self,
        outbox: &Outbox,
        missed: &mut BTreeMap<Dropped, Vec<Missed>>,
        touched: &mut Touched,
    ) {
        // A device hears of all senders together: what is said of each goes before its owner's commands.
        let together = outbox.is_device();
        let mut of_all: BTreeMap<Dropped, (Path, u64)> = BTreeMap::new();
        let mut events: BTreeMap<ContextNumber, u64> = BTreeMap::new();
        for (dropped, count) in outbox.take_drops() {
            if together && dropped.sender == HUB_PEER {
                *events.entry(dropped.context).or_default() += count;
                continue;
            }
            let Some(channel) = self.channel(dropped.context) else {
                continue;
            };
            let path = channel.note_dropped(outbox.peer, dropped, count);
            let sender = dropped.sender;
            let told = Missed {
                count,
                receiver: outbox.name(),
                is_device: together,
                path,
            };
            if sender != outbox.peer && together {
                let all = Dropped {
                    sender: outbox.peer,
                    ..dropped
                };
                of_all.entry(all).or_insert((told.path.clone(), 0)).1 += count;
            } else if sender != outbox.peer {
                let content = self.of_one(dropped, &told);
                self.tell_of_drops(outbox.peer, dropped, &told.path, content, touched);
            }
            missed.entry(dropped).or_default().push(told);
        }
        for (dropped, (path, count)) in of_all {
            let content = of(dropped, count).with("receiver", &*outbox.name());
            self.tell_of_drops(outbox.peer, dropped, &path, content, touched);
        }
        for (context, count) in events {
            self.tell_of_events(outbox, (context, count), touched);
        }
    }

    /// Tells a device that it did not hear of others in a context so many times. Where it does not get that either, it
    /// is told so the next time.
    fn tell_of_events(&self, outbox: &Outbox, (context, count): (ContextNumber, u64), touched: &mut Touched) {
        // It may have been deleted since.
        let path = self.hub.lock().path(context).cloned().unwrap_or_else(Path::root);
        let content = Map::new()
            .with("reason", DropReason::Full.word())
            .with("count", i64::try_from(count).unwrap_or(i64::MAX))
            .with("sender", HUB)
            .with("receiver", &*outbox.name());
        let mut parcel = Parcel::new(Family::Event, event::DROPPED)
            .context(path)
            .content(content);
        parcel.number = Some(context);
        self.tell_news(outbox.peer, parcel, touched);
    }

    /// Tells a sender who did not get what: each receiver by itself, or many together.
    fn tell_sender(&self, dropped: Dropped, missed: Vec<Missed>, touched: &mut Touched) {
        let many = missed.iter().filter(|missed| !missed.is_device).count() > RECEIVERS;
        let (together, alone): (Vec<Missed>, Vec<Missed>) =
            missed.into_iter().partition(|missed| many && !missed.is_device);
        for told in alone {
            let content = self.of_one(dropped, &told);
            self.tell_of_drops(dropped.sender, dropped, &told.path, content, touched);
        }
        if let Some(first) = together.first() {
            let count = together.iter().map(|missed| missed.count).sum();
            let receivers = i64::try_from(together.len()).unwrap_or(i64::MAX);
            let content = of(dropped, count)
                .with("receivers", receivers)
                .with("sender", &*self.name_of(dropped.sender));
            self.tell_of_drops(dropped.sender, dropped, &first.path, content, touched);
        }
    }

    fn of_one(&self, dropped: Dropped, missed: &Missed) -> Map {
        of(dropped, missed.count)
            .with("receiver", &*missed.receiver)
            .with("sender", &*self.name_of(dropped.sender))
    }

    fn name_of(&self, peer: PeerId) -> Arc<str> {
        self.outbox(peer).map(|outbox| outbox.name()).unwrap_or_default()
    }

    fn tell_of_drops(
        &self,
        peer: PeerId,
        dropped: Dropped,
        path: &Path,
        content: Map,
        touched: &mut Touched,
    ) {
        let mut parcel = Parcel::new(Family::Event, event::DROPPED)
            .context(path.clone())
            .content(content);
        parcel.number = Some(dropped.context);
        self.tell_news(peer, parcel, touched);
    }

    fn tell_news(&self, peer: PeerId, parcel: Parcel, touched: &mut Touched) {
        let parcel = Arc::new(stamped(parcel, self.clock.wall()));
        self.push_to_all(&[peer], &parcel, touched);
    }
}

/// What is said of messages that were dropped.
fn of(dropped: Dropped, count: u64) -> Map {
    Map::new()
        .with("reason", dropped.reason.word())
        .with("delivery", dropped.class.word())
        .with("count", i64::try_from(count).unwrap_or(i64::MAX))
}
