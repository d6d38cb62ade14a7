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
            Outgoing::Parcel(parcel) => 256 + content_len(parcel),
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

fn content_len(parcel: &Parcel) -> usize {
    match &parcel.content {
        Some(mom_proto::Content::Encoded(bytes)) => bytes.len(),
        Some(mom_proto::Content::Value(value)) => value_len(value),
        None => 0,
    }
}

fn value_len(value: &mom_proto::Value) -> usize {
    use mom_proto::Value;
    match value {
        Value::String(text) => text.len(),
        Value::Binary(bytes) => bytes.len(),
        Value::List(list) => list.iter().map(|item| 8 + value_len(item)).sum(),
        Value::Map(map) => map
            .iter()
            .map(|(key, item)| 8 + key.len() + value_len(item))
            .sum(),
        _ => 8,
    }
}
