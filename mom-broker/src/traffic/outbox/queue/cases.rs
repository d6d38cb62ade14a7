//! The cases of what overtakes, replaces and outlives, with the queue of one receiver.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use mom_cases::{Case, Dialect, Item, Replay, replay};
use mom_hub::PeerId;
use mom_net::{Allowance, Ledger, Piece, Taken};
use mom_proto::codec::{Encoded, Form};
use mom_proto::{ContextNumber, Delivery, Family, HUB, Parcel, ReadCount, Time, outlives_loss};
use mom_system::Clock;
use mom_system::sync::atomic::AtomicU64;

use super::{Packet, PeerQueue};
use crate::traffic::channel::{control, expires_at, lane_of};
use crate::traffic::encodings::Encodings;
use crate::traffic::outbox::{Charged, Origin};

const DIALECT: Dialect = Dialect {
    queue: "hub",
    says_resent: false,
    says_unknown: false,
};

const LIMIT: usize = 1 << 20;

/// How large chunks are.
const CHUNK: usize = 32 * 1024;

/// What a packet counts beside its frames.
const PLACE: usize = 64;

#[test]
fn an_outbox_keeps_to_the_table() {
    replay(DIALECT, |_: &Case| Receiver::new());
}

/// A receiver and what waits for it.
struct Receiver {
    queue: PeerQueue,
    ledger: Ledger<Packet>,
    clock: Clock,
    said: Vec<Said>,
    contexts: Vec<String>,
    senders: Vec<String>,
    /// Fences by which guarded messages pass.
    gates: HashMap<ContextNumber, Arc<AtomicU64>>,
}

struct Said {
    label: String,
    packet: Arc<Packet>,
    left: bool,
    told: bool,
}

/// The place of a name in a list, which gets it if it is new; from 1.
fn number(names: &mut Vec<String>, name: &str) -> u64 {
    let known = names.iter().position(|known| known == name);
    let at = known.unwrap_or_else(|| {
        names.push(name.to_owned());
        names.len() - 1
    });
    at as u64 + 1
}

impl Receiver {
    fn new() -> Receiver {
        let clock = Clock::manual(Time::default());
        clock.advance(Duration::from_secs(1));
        Receiver {
            queue: PeerQueue::new(Some(Form::Binary), LIMIT),
            ledger: Ledger::new(LIMIT),
            clock,
            said: Vec::new(),
            contexts: Vec::new(),
            senders: Vec::new(),
            gates: HashMap::new(),
        }
    }

    fn packet(&mut self, item: &Item) -> Packet {
        let family = Family::from_word(&item.family).expect("a family");
        let mut parcel = Parcel::new(family, item.name.as_str());
        (parcel.priority, parcel.expires) = (item.priority, item.expires);
        parcel.delivery = item.delivery.as_deref().and_then(Delivery::from_word);
        // Drops are told by sender: only where one message replaces another of the same, the sender matters.
        let sender = match (&item.sender, parcel.delivery) {
            (Some(sender), _) => sender.as_str(),
            (None, Some(Delivery::Latest)) => "alice",
            (None, _) => item.is.as_str(),
        };
        let origin = Origin {
            context: ContextNumber(number(&mut self.contexts, &item.context)),
            sender: PeerId(number(&mut self.senders, sender)),
            name: item.name.as_str().into(),
        };
        let encodings = Encodings::of_run(Encoded {
            head: Bytes::from(vec![7; 64 + item.bytes]),
            body: Bytes::new(),
        });
        if family != Family::Message || sender == HUB {
            let packet = control(family, encodings, origin, None);
            return Arc::into_inner(packet).expect("nobody else has it");
        }
        let gate = self
            .gates
            .entry(origin.context)
            .or_insert(Arc::new(AtomicU64::new(7)));
        Packet {
            charged: Charged::Nowhere,
            encodings,
            lane: lane_of(&parcel, item.guarded),
            delivery: parcel.delivery.unwrap_or_default(),
            origin,
            expires_at: expires_at(&parcel, self.clock.now()).filter(|_| item.name != "stop"),
            gate: item.guarded.then(|| (Arc::clone(gate), 7)),
            count: 1,
            counts: true,
            outlives_loss: outlives_loss(&parcel, item.guarded),
        }
    }

    /// Has the link take one piece, and takes back the rest of what was taken; gives what it is a piece of, and whether it is the
    /// last of it.
    fn write(&mut self) -> Option<(String, bool)> {
        let mut batch: VecDeque<Piece<Packet>> = VecDeque::new();
        let all = Allowance {
            bytes: usize::MAX,
            piece: CHUNK,
            stops: usize::MAX,
        };
        self.queue.take(self.clock.now(), all, &mut batch);
        let mut piece = batch.pop_front()?;
        piece.advance(piece.left());
        self.ledger.note(&piece, Some(Form::Binary));
        self.queue.put_back(&mut batch);
        let packet = piece.item().expect("nothing is given up");
        let said = self
            .said
            .iter_mut()
            .find(|said| Arc::ptr_eq(&said.packet, packet));
        let said = said.expect("it was said");
        said.left |= piece.is_last();
        Some((said.label.clone(), piece.is_last()))
    }
}

impl Replay for Receiver {
    fn put(&mut self, item: &Item) {
        let packet = Arc::new(self.packet(item));
        self.said.push(Said {
            label: item.is.clone(),
            packet: Arc::clone(&packet),
            left: false,
            told: false,
        });
        assert_ne!(
            self.queue.push(packet, &self.clock),
            Taken::Overflow,
            "{}",
            item.is
        );
    }

    fn fill(&mut self, label: &str) {
        let item = Item {
            bytes: LIMIT - self.queue.queue.data_bytes() - PLACE - 64,
            ..Item::reliable(label)
        };
        self.put(&item);
        assert_eq!(self.queue.queue.data_bytes(), LIMIT);
    }

    fn begin(&mut self) -> Option<String> {
        let (label, last) = self.write()?;
        assert!(!last, "it was all of {label}");
        Some(label)
    }

    fn take(&mut self) -> Option<String> {
        loop {
            if let (label, true) = self.write()? {
                return Some(label);
            }
        }
    }

    fn lose(&mut self) {
        drop(self.queue.lose(&mut self.ledger));
    }

    fn resume(&mut self, read: u64) {
        let read = ReadCount {
            parcels: read,
            checksum: None,
        };
        self.queue
            .resend(&mut self.ledger, read)
            .expect("a count that can be");
        self.queue.find();
    }

    fn told(&mut self) -> BTreeMap<String, String> {
        let mut told = BTreeMap::new();
        for (dropped, count) in self.queue.take_drops() {
            for _ in 0..count {
                let fits = |said: &&mut Said| {
                    let origin = &said.packet.origin;
                    let same = (origin.context, origin.sender) == (dropped.context, dropped.sender);
                    same && said.packet.delivery == dropped.class && !said.told
                };
                // Of those that are alike the oldest that has not left.
                let mut alike: Vec<&mut Said> = self.said.iter_mut().filter(fits).collect();
                alike.sort_by_key(|said| said.left);
                let said = alike.into_iter().next().expect("it was said");
                said.told = true;
                told.insert(said.label.clone(), dropped.reason.word().to_owned());
            }
        }
        told
    }

    fn left_over(&mut self) -> Option<String> {
        let queue = &self.queue.queue;
        let counts = (queue.bytes(), queue.data_bytes(), queue.reliable_bytes());
        let right = counts == (0, 0, 0) && queue.is_empty();
        (!right).then(|| format!("{counts:?} bytes"))
    }

    fn pass(&mut self, millis: u64) {
        self.clock.advance(Duration::from_millis(millis));
    }
}
