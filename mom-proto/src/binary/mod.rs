//! The binary form: small, quick to read, and able to grow (M17, M20, design §5).
//!
//! A connection begins with the preface `\x8fMOM`, major, minor, in both directions. Then come frames: a
//! big-endian u32 length of what follows, one byte for the kind, the rest. Kind 0 is a whole parcel, kind 1
//! a chunk of one. A reader skips unknown kinds from 128 on, and refuses lower ones.
//!
//! A parcel is a presence bitmap (LEB128), the slots whose bits are set in the order of their bits, and the
//! content as MessagePack up to the end of the frame. `docs/PROTOCOL.md` has the table of bits.
//!
//! | bit | slot | form |
//! |---|---|---|
//! | 0 | context, by number | varint |
//! | 1 | name | name |
//! | 2 | sender | name |
//! | 3 | timestamp | 8 bytes, big-endian signed µs |
//! | 4 | id | varint |
//! | 5 | content | the rest of the frame |
//! | 6 | fence | varint |
//! | 7 | received | 8 bytes, big-endian signed µs |
//! | 8 | age | zigzag varint, µs |
//! | 9 | age-error | varint, µs |
//! | 10 | family (absent = message) | 1 byte |
//! | 11 | reference | varint |
//! | 12 | priority | zigzag varint |
//! | 13 | address | varint count, names |
//! | 14 | expires | varint, ms |
//! | 15 | delivery | 1 byte |
//! | 16 | echo | 1 byte, 0 or 1 |
//! | 17 | receipt | 1 byte, 0 or 1 |
//! | 18 | context, by path | varint length, UTF-8 |
//! | 19 | all other slots | varint length, a MessagePack map |
//! | 20 | content is compressed | varint length, 1 byte (1 = zstd), varint bytes of the content as it was |
//! | 21–63 | to come | varint length, bytes to skip |
//!
//! A name is a varint k: odd means number k/2 of the [table of words](WORDS), even means k/2 bytes of UTF-8.
//! A parcel that gives a context both by number and by path binds the number to the path on this connection.

mod chunks;
mod decoder;
mod header;
mod plain;
mod wire;
mod words;

#[cfg(test)]
mod tests;

use bytes::Bytes;

pub use chunks::{ChunkHead, STREAMS, chunks};
pub use decoder::BinaryDecoder;
pub use plain::{ParcelRun, Plain, checksum_word, cut, first, whole};
pub use words::WORDS;

use crate::frame::{Encoded, Scratch};
use crate::{Content, PROTOCOL_VERSION, Packed, Parcel, WireError};

/// The first four bytes of a connection that speaks this form; no UTF-8 text begins so.
pub const PREFACE_MAGIC: [u8; 4] = *b"\x8fMOM";

/// The whole preface of this version.
pub const PREFACE: [u8; 6] = [
    PREFACE_MAGIC[0],
    PREFACE_MAGIC[1],
    PREFACE_MAGIC[2],
    PREFACE_MAGIC[3],
    PROTOCOL_VERSION.0,
    PROTOCOL_VERSION.1,
];

pub(crate) const KIND_PARCEL: u8 = 0;
pub(crate) const KIND_CHUNK: u8 = 1;
pub(crate) const FIRST_SKIPPABLE_KIND: u8 = 128;

// Up to here one copy into the header's memory is cheaper than a second piece for the writer.
const INLINE_CONTENT: usize = 4096;

/// Encodes a parcel as one frame.
///
/// # Errors
/// `not-encodable` for a value without a form, or a parcel of 4 GiB.
pub fn encode(parcel: &Parcel) -> Result<Encoded, WireError> {
    encode_with(parcel, &mut Scratch::default())
}

/// Encodes a parcel as one frame, in memory that is shared between frames.
///
/// # Errors
/// As [`encode`]; `bad-content` for content that cannot be decompressed.
pub fn encode_with(parcel: &Parcel, scratch: &mut Scratch) -> Result<Encoded, WireError> {
    let content = match &parcel.content {
        Some(content) => content.to_msgpack()?,
        None => Bytes::new(),
    };
    frame(parcel, content, None, scratch)
}

/// The same for a reader of compressed content: of a message that is not an image, and where it pays.
///
/// # Errors
/// As [`encode`].
pub(crate) fn encode_packed(parcel: &Parcel, scratch: &mut Scratch) -> Result<Encoded, WireError> {
    let content = match &parcel.content {
        Some(Content::Packed(packed)) => return frame(parcel, packed.bytes().clone(), Some(packed), scratch),
        Some(content) => content.to_msgpack()?,
        None => Bytes::new(),
    };
    match parcel.may_be_packed().then(|| Packed::pack(&content)).flatten() {
        Some(packed) => frame(parcel, packed.bytes().clone(), Some(&packed), scratch),
        None => frame(parcel, content, None, scratch),
    }
}

fn frame(
    parcel: &Parcel,
    content: Bytes,
    packed: Option<&Packed>,
    scratch: &mut Scratch,
) -> Result<Encoded, WireError> {
    let mut header = std::mem::take(&mut scratch.header);
    header.clear();
    header::write(parcel, packed, &mut header)?;
    let length = u32::try_from(1 + header.len() + content.len())
        .map_err(|_| WireError::new(crate::Code::NOT_ENCODABLE, "a parcel has less than 4 GiB"))?;
    let inline = content.len() <= INLINE_CONTENT;
    let room = scratch.room(5 + header.len() + if inline { content.len() } else { 0 });
    room.extend_from_slice(&length.to_be_bytes());
    room.extend_from_slice(&[KIND_PARCEL]);
    room.extend_from_slice(&header);
    let body = if inline {
        room.extend_from_slice(&content);
        Bytes::new()
    } else {
        content
    };
    let head = room.split().freeze();
    scratch.header = header;
    Ok(Encoded { head, body })
}
