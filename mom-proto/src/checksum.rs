//! How much of one direction of a link was read: a count, and a checksum by which the other end sees that it is of the same parcels.

use crate::{Map, Parcel, Value};

/// Of the parcels that a link counts, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checksum(u32);

/// What one end of a link has read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadCount {
    /// How many parcels.
    pub parcels: u64,
    /// [`Checksum::value`] of them; none where it is not known.
    pub checksum: Option<u32>,
}

// FNV-1a of 32 bits, by words instead of bytes.
const BASIS: u32 = 0x811c_9dc5;
const PRIME: u32 = 0x0100_0193;

impl Default for Checksum {
    fn default() -> Checksum {
        Checksum(BASIS)
    }
}

impl Checksum {
    /// Goes on with a parcel, of which this is [`Parcel::checksum_word`].
    #[must_use]
    pub fn with(self, word: u32) -> Checksum {
        Checksum((self.0 ^ word).wrapping_mul(PRIME))
    }

    /// As it travels.
    pub fn value(self) -> u32 {
        self.0
    }
}

impl Parcel {
    /// What stands for it in a [`Checksum`]: the lower 32 bits of its id, or of its reference where it has no id.
    pub fn checksum_word(&self) -> u32 {
        word(self.id.or(self.reference))
    }
}

impl ReadCount {
    /// Nothing so far.
    pub fn new() -> ReadCount {
        ReadCount {
            parcels: 0,
            checksum: Some(BASIS),
        }
    }

    /// Counts one more; of what nobody could read the word is not known, nor is any checksum after it.
    pub fn count(&mut self, word: Option<u32>) {
        self.parcels += 1;
        let checksum = self.checksum.zip(word);
        self.checksum = checksum.map(|(sum, word)| Checksum(sum).with(word).0);
    }

    /// As it stands in content.
    #[must_use]
    pub fn put(self, content: Map) -> Map {
        let content = content.with("read", i64::try_from(self.parcels).unwrap_or(i64::MAX));
        match self.checksum {
            Some(checksum) => content.with("checksum", i64::from(checksum)),
            None => content,
        }
    }

    /// From content; none if that does not say how much was read.
    pub fn of(content: &Map) -> Option<ReadCount> {
        let int = |key| content.get(key).and_then(Value::as_int);
        Some(ReadCount {
            parcels: int("read").and_then(|read| u64::try_from(read).ok())?,
            checksum: int("checksum").and_then(|checksum| u32::try_from(checksum).ok()),
        })
    }
}

pub(crate) fn word(number: Option<u64>) -> u32 {
    // The lower bits are meant.
    number.unwrap_or_default() as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Family;

    /// docs/PROTOCOL.md has these numbers.
    #[test]
    fn the_example_of_the_protocol() {
        let sums: Vec<u32> = [1, 2, 1 << 32 | 3]
            .into_iter()
            .scan(Checksum::default(), |sum, id| {
                *sum = sum.with(Parcel::new(Family::Message, "say").id(id).checksum_word());
                Some(sum.value())
            })
            .collect();
        assert_eq!(Checksum::default().value(), 2_166_136_261);
        assert_eq!(sums, [67_918_732, 3_983_810_698, 1_456_420_779]);
    }
}
