//! What a writer is given.

use std::sync::Arc;

use bytes::Buf;
use mom_proto::Parcel;
use mom_proto::codec::Encoded;

/// One parcel on its way out: encoded for a socket, as it is for a peer in the same process.
#[derive(Clone, Debug)]
pub enum Outgoing {
    /// A frame, or what is left of it.
    Encoded(Encoded),
    /// A parcel that needs no encoding.
    Parcel(Arc<Parcel>),
}

impl Outgoing {
    /// The bytes that it occupies while it waits.
    pub fn len(&self) -> usize {
        match self {
            Outgoing::Encoded(encoded) => encoded.len(),
            // Shared with all other receivers; a fixed charge keeps the bound a bound.
            Outgoing::Parcel(parcel) => 256 + parcel.content.as_ref().map_or(0, |content| content.size()),
        }
    }

    /// Whether all of it is written.
    pub fn is_empty(&self) -> bool {
        matches!(self, Outgoing::Encoded(encoded) if encoded.is_empty())
    }

    /// Takes `written` bytes from its front; gives back how many of them were not its own.
    pub(crate) fn advance(&mut self, written: usize) -> usize {
        let Outgoing::Encoded(encoded) = self else {
            return written;
        };
        let head = written.min(encoded.head.len());
        encoded.head.advance(head);
        let body = (written - head).min(encoded.body.len());
        encoded.body.advance(body);
        written - head - body
    }
}

impl AsRef<Outgoing> for Outgoing {
    fn as_ref(&self) -> &Outgoing {
        self
    }
}

impl AsMut<Outgoing> for Outgoing {
    fn as_mut(&mut self) -> &mut Outgoing {
        self
    }
}
