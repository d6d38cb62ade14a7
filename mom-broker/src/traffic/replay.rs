//! What a channel keeps, on its way to one who has joined.
//!
//! In the channel's critical section only references are taken. The joiner's own writer makes parcels of them, a few at a
//! time, when they come to the front of its outbox; what is said later waits behind them.

use std::sync::Arc;

use mom_hub::PeerId;
use mom_net::Lane;
use mom_proto::codec::Form;
use mom_proto::{ContextNumber, Delivery, Micros, Parcel};
use mom_system::Clock;

use crate::traffic::channel::expires_at;
use crate::traffic::encodings::{Encoder, Encodings};
use crate::traffic::history::Kept;
use crate::traffic::memory::Account;
use crate::traffic::outbox::{Charged, Origin, Packet};

/// What is made of it at once, in messages and in bytes.
const STEP: usize = 64;
const STEP_BYTES: usize = 256 * 1024;

/// Kept messages for one joiner, oldest first.
#[derive(Debug)]
pub(crate) struct Replay {
    context: ContextNumber,
    kept: Arc<[Arc<Kept>]>,
    /// How many have gone.
    from: usize,
    encoder: Encoder,
}

impl Replay {
    pub(crate) fn new(context: ContextNumber, kept: Arc<[Arc<Kept>]>, encoder: Encoder) -> Replay {
        Replay {
            context,
            kept,
            from: 0,
            encoder,
        }
    }

    /// How many messages are left.
    pub(crate) fn count(&self) -> u32 {
        u32::try_from(self.kept.len() - self.from).unwrap_or(u32::MAX)
    }

    /// They are kept anyhow; this is the list.
    pub(crate) fn charge(&self) -> usize {
        self.kept.len() * size_of::<Arc<Kept>>()
    }

    /// All of it as it waits in an outbox.
    pub(crate) fn into_packet(self, account: Option<&Arc<Account>>) -> Arc<Packet> {
        let (origin, count) = (self.origin("history".into()), self.count());
        let encodings = Encodings::of_replay(self);
        Arc::new(Packet {
            charged: Charged::to(account, &encodings),
            lane: Lane::Data(0),
            // Who cannot take it all has the newest.
            delivery: Delivery::Fleeting,
            origin,
            expires_at: None,
            gate: None,
            count,
            counts: true,
            outlives_loss: true,
            encodings,
        })
    }

    /// The next messages as packets for a receiver of this form, and what is left after them.
    pub(crate) fn step(
        &self,
        form: Option<Form>,
        clock: &Clock,
        account: Option<&Arc<Account>>,
    ) -> Vec<Arc<Packet>> {
        let now = clock.now();
        let wall = clock.wall_at(now);
        let mut encoder = self.encoder.another();
        let mut packets = Vec::new();
        let (mut from, mut bytes) = (self.from, 0);
        while let Some(kept) = self.kept.get(from)
            && from < self.from + STEP
            && bytes < STEP_BYTES
        {
            from += 1;
            bytes += kept.size();
            // What a form cannot hold was refused when it came, or its receivers were of other forms then.
            let packet = kept
                .at(now, wall)
                .and_then(|parcel| self.packet(parcel, form, now, &mut encoder, account));
            packets.extend(packet);
        }
        if from < self.kept.len() {
            let rest = Replay {
                context: self.context,
                kept: Arc::clone(&self.kept),
                from,
                encoder,
            };
            packets.push(rest.into_packet(account));
        }
        packets
    }

    fn origin(&self, name: Arc<str>) -> Origin {
        Origin {
            context: self.context,
            sender: PeerId(0),
            name,
        }
    }

    fn packet(
        &self,
        parcel: Parcel,
        form: Option<Form>,
        now: Micros,
        encoder: &mut Encoder,
        account: Option<&Arc<Account>>,
    ) -> Option<Arc<Packet>> {
        let lane = Lane::Data(parcel.priority.unwrap_or_default());
        let expires_at = expires_at(&parcel, now);
        let origin = self.origin(Arc::clone(&parcel.name));
        let encodings = encoder.encode(parcel, std::iter::once(form)).ok()?;
        Some(Arc::new(Packet {
            charged: Charged::to(account, &encodings),
            encodings,
            lane,
            delivery: Delivery::Fleeting,
            origin,
            expires_at,
            gate: None,
            count: 1,
            counts: true,
            outlives_loss: true,
        }))
    }
}
