//! An outbox whose connection may be lost and come back: what it has sent is counted and kept until it was read.

use std::sync::{Arc, Weak};

use mom_net::{BadCount, Flow, Ledger, Rewound, Writer};
use mom_proto::codec::Form;
use mom_proto::{Compression, ContextNumber, Path, ReadCount};
use mom_system::sync::atomic::Ordering;

use super::{Outbox, Packet, place_of};

/// What an outbox knows of its link.
#[derive(Debug)]
pub(super) struct LinkLedger {
    pub(super) ledger: Ledger<Packet>,
    /// Where the paths of contexts are known, once the peer has come back in another form.
    pub(super) paths: Option<Weak<dyn Paths>>,
    /// What was agreed on for its connections.
    compression: Option<Compression>,
}

/// What knows the paths of contexts.
pub(crate) trait Paths: std::fmt::Debug + Send + Sync {
    /// The path of a channel, none if it was deleted.
    fn path(&self, number: ContextNumber) -> Option<Path>;
}

impl Outbox {
    /// The connection; none while it is lost.
    pub(crate) fn writer(&self) -> Option<Arc<Writer>> {
        self.way().writer.clone()
    }

    /// Whether its connection can be resumed.
    pub(crate) fn is_linked(&self) -> bool {
        self.way().link.is_some()
    }

    /// Counts what leaves from here on, but for the next parcel, and keeps so many bytes; false if something waits, of
    /// which nobody could say on which side of the beginning it is.
    pub(crate) fn begin_link(&self, limit: usize) -> bool {
        self.flush();
        let mut way = self.way();
        if !self.queue.lock().is_empty() {
            return false;
        }
        way.link = Some(Box::new(LinkLedger {
            ledger: Ledger::after_next(limit),
            paths: None,
            compression: None,
        }));
        true
    }

    /// From now on, gives the peer compressed content where that pays. Before its first login is answered: what is for it was
    /// encoded in one form only.
    pub(crate) fn begin_packing(&self) {
        let mut way = self.way();
        if let Some(link) = &mut way.link {
            link.compression = Some(Compression::Zstd);
        }
        self.queue.lock().begin_packing();
        self.form.store(place_of(Some(Form::Packed)), Ordering::Relaxed);
    }

    /// From the next boundary between frames on, compresses all that is written, on this connection and those that its link goes on with.
    pub(crate) fn begin_stream(&self, compression: Compression) {
        let mut way = self.way();
        if let Some(link) = &mut way.link {
            link.compression = Some(compression);
        }
        if let Some(writer) = &way.writer {
            writer.compress(compression);
        }
    }

    /// The stream that its link has agreed on.
    pub(crate) fn stream(&self) -> Option<Compression> {
        let way = self.way();
        let compression = way.link.as_ref().and_then(|link| link.compression);
        compression.filter(|compression| compression.is_stream())
    }

    /// Whether the peer gives and takes compressed content.
    pub(crate) fn packs(&self) -> bool {
        self.form() == Some(Form::Packed)
    }

    /// Ends the link: the next end of the connection is the end of the peer.
    pub(crate) fn end_link(&self) {
        let link = self.way().link.take();
        // What it kept is freed where nobody waits.
        drop(link);
    }

    /// How many parcels the peer is known to have read.
    pub(crate) fn acknowledged_count(&self) -> u64 {
        let way = self.way();
        way.link.as_ref().map_or(0, |link| link.ledger.acknowledged())
    }

    /// Takes in how many parcels the peer has read.
    ///
    /// # Errors
    /// A count that cannot be.
    pub(crate) fn acknowledge(&self, read: ReadCount) -> Result<(), BadCount> {
        let mut way = self.way();
        match &mut way.link {
            Some(link) => self.queue.lock().acknowledge(&mut link.ledger, read),
            None => Ok(()),
        }
    }

    /// The connection is lost. Gives what has written to it, if what it was given last ends with a whole parcel.
    pub(crate) fn detach(&self) -> Option<Arc<Writer>> {
        let mut way = self.way();
        let writer = way.writer.take();
        way.flow = Flow::default();
        let link = way.link.as_mut()?;
        let (is_whole, dropped) = self.queue.lock().lose(&mut link.ledger);
        drop(way);
        drop(dropped);
        self.call_all();
        writer.filter(|_| is_whole)
    }

    /// Puts what the peer has not read in front of what waits, for a connection that goes on with this writer. Nothing is
    /// written before [`Outbox::attach`].
    ///
    /// # Errors
    /// A count that cannot be.
    pub(crate) fn resend(
        &self,
        read: ReadCount,
        writer: &Writer,
        paths: Weak<dyn Paths>,
    ) -> Result<Rewound, BadCount> {
        let mut way = self.way();
        let Some(link) = &mut way.link else {
            return Ok(Rewound::Lost(0));
        };
        let mut queue = self.queue.lock();
        let rewound = queue.resend(&mut link.ledger, read)?;
        let form = match writer.form() {
            Some(Form::Binary) if link.compression == Some(Compression::Zstd) => Some(Form::Packed),
            form => form,
        };
        if form != self.form() {
            link.paths = Some(paths);
            // Senders that encode for it from here on do so in the new form.
            self.form.store(place_of(form), Ordering::Relaxed);
            queue.change_form(form);
        }
        Ok(rewound)
    }

    /// Goes on with this connection.
    pub(crate) fn attach(&self, writer: Arc<Writer>) {
        let mut way = self.way();
        let compression = way.link.as_ref().and_then(|link| link.compression);
        if let Some(compression) = compression.filter(|compression| compression.is_stream()) {
            writer.compress(compression);
        }
        way.writer = Some(writer);
        drop(way);
        self.queue.lock().find();
        self.touched.store(true, Ordering::Release);
        self.wake.notify_one();
    }

    /// Waits until all that waits is written, or the connection is lost.
    pub(crate) async fn drained(&self) {
        while let Some(writer) = self.writer() {
            self.flush();
            if self.is_closed() || self.queue.lock().is_empty() || writer.ready().await.is_err() {
                return;
            }
        }
    }

    /// Whether its connection has failed, and nobody has noted so yet.
    pub(crate) fn is_broken(&self) -> bool {
        self.way().writer.is_none()
    }

    /// Gives up its connection, for another outbox to go on with.
    pub(crate) fn take_writer(&self) -> Option<Arc<Writer>> {
        self.way().writer.take()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use mom_hub::PeerId;
    use mom_net::Lane;
    use mom_proto::codec::Frame;
    use mom_proto::{Delivery, Family, Parcel};
    use mom_system::Clock;

    use super::*;
    use crate::traffic::encodings::Encodings;
    use crate::traffic::outbox::{Charged, Origin};

    fn packet() -> Packet {
        let parcel = Parcel::new(Family::Message, "say").id(1);
        Packet {
            charged: Charged::Nowhere,
            encodings: Encodings::new(parcel, std::iter::once(None)).expect("no form needed"),
            lane: Lane::Data(0),
            delivery: Delivery::Reliable,
            origin: Origin {
                context: ContextNumber(1),
                sender: PeerId(2),
                name: "say".into(),
            },
            expires_at: None,
            gate: None,
            count: 1,
            counts: true,
            outlives_loss: true,
        }
    }

    /// Who comes to write meanwhile leaves it to who has the way, and nobody comes again.
    #[tokio::test]
    async fn what_comes_while_an_acknowledgement_is_taken_in_leaves_at_once() {
        let (here, mut there) = mom_net::pair();
        let outbox = Arc::new(Outbox::new(PeerId(1), Clock::system(), here.writer, 1 << 20));
        let writing = Arc::clone(&outbox);
        tokio::spawn(async move { writing.run().await });
        // Its writer waits to be woken.
        tokio::task::yield_now().await;
        let way = outbox.way();
        let (_, first) = outbox.push(Arc::new(packet()));
        assert!(first);
        outbox.flush();
        drop(way);
        let came = tokio::time::timeout(Duration::from_secs(20), there.reader.next()).await;
        let came = came.expect("it leaves").expect("a link");
        assert!(matches!(came, Some(Frame::Parcel(parcel)) if parcel.name() == "say"));
    }
}
