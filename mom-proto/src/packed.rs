//! Content that is compressed on its way (M16): each by itself, so that a hub passes it on as it came, and a receiver that joins
//! late or loses one can read the next.

use std::cell::RefCell;

use bytes::Bytes;
use zstd::bulk::{Compressor, Decompressor};

use crate::{Code, WireError};

/// Smaller content stays as it is: what could be saved is less than a packet's headers.
const SMALLEST: usize = 512;

/// Of larger content this much is tried first, from its middle: pictures and what is compressed already cost no more than that.
const SAMPLE: usize = 4096;

/// The level of zstd; `cargo bench --manifest-path benches/Cargo.toml --bench compression` compares some.
const LEVEL: i32 = 1;

thread_local! {
    // Their tables take longer to make than a message of a few KiB takes to compress.
    static PACKER: RefCell<Option<Compressor<'static>>> = const { RefCell::new(None) };
    static UNPACKER: RefCell<Option<Decompressor<'static>>> = const { RefCell::new(None) };
}

/// A value as MessagePack, compressed; unchecked until it is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packed {
    bytes: Bytes,
    length: usize,
}

impl Packed {
    /// Compresses a value that is encoded as MessagePack; none where that does not pay.
    pub fn pack(content: &[u8]) -> Option<Packed> {
        if content.len() < SMALLEST {
            return None;
        }
        if content.len() > 4 * SAMPLE {
            let middle = content.len() / 2;
            let sample = &content[middle..middle + SAMPLE];
            pays(sample.len(), compress(sample)?.len()).then_some(())?;
        }
        let bytes = compress(content)?;
        pays(content.len(), bytes.len()).then(|| Packed {
            bytes: bytes.into(),
            length: content.len(),
        })
    }

    /// What has come of a content that is said to have so many bytes.
    pub(crate) fn received(bytes: Bytes, length: usize) -> Packed {
        Packed { bytes, length }
    }

    /// The compressed bytes.
    pub fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// The same in memory of its own, for what is kept longer than what it came with.
    pub fn own(&mut self) {
        self.bytes = Bytes::copy_from_slice(&self.bytes);
    }

    /// The bytes that it unpacks to.
    pub fn length(&self) -> usize {
        self.length
    }

    /// The value as MessagePack.
    ///
    /// # Errors
    /// `bad-content` for what is not a frame of zstd, or one of another length than was said. No more memory than that is taken.
    pub fn unpack(&self) -> Result<Bytes, WireError> {
        let unpacked = UNPACKER.with_borrow_mut(|unpacker| {
            let unpacker = match unpacker {
                Some(unpacker) => unpacker,
                None => unpacker.insert(Decompressor::new()?),
            };
            unpacker.decompress(&self.bytes, self.length)
        });
        match unpacked {
            Ok(unpacked) if unpacked.len() == self.length => Ok(unpacked.into()),
            Ok(unpacked) => Err(broken(&format!(
                "{} bytes were announced and {} came",
                self.length,
                unpacked.len()
            ))),
            Err(error) => Err(broken(&error.to_string())),
        }
    }
}

fn broken(why: &str) -> WireError {
    WireError::new(
        Code::BAD_CONTENT,
        format!("the content cannot be decompressed: {why}"),
    )
}

/// Less than an eighth is not worth the receiver's time.
fn pays(before: usize, after: usize) -> bool {
    after <= before - before / 8
}

/// None where there is no memory for it.
fn compress(content: &[u8]) -> Option<Vec<u8>> {
    PACKER.with_borrow_mut(|packer| {
        let packer = match packer {
            Some(packer) => packer,
            None => packer.insert(Compressor::new(LEVEL).ok()?),
        };
        packer.compress(content).ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(bytes: usize) -> Vec<u8> {
        let mut state = 0x2545_f491_4f6c_dd1d_u64;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state.to_le_bytes()[3]
        };
        (0..bytes).map(|_| next()).collect()
    }

    #[test]
    fn what_pays_is_packed_and_comes_back() {
        for size in [SMALLEST, 10_000, 100_000] {
            let text: Vec<u8> = b"MoveL [[512.0,0.0,712.0],[1,0,0,0]], vslow, fine, tool0;\n"
                .iter()
                .copied()
                .cycle()
                .take(size)
                .collect();
            let packed = Packed::pack(&text).expect("it pays");
            assert!(packed.bytes().len() * 2 < size, "{}", packed.bytes().len());
            assert_eq!(packed.length(), size);
            assert_eq!(packed.unpack().unwrap(), text);
        }
    }

    #[test]
    fn what_does_not_pay_stays_as_it_is() {
        assert_eq!(Packed::pack(&[0; SMALLEST - 1]), None, "too small");
        assert_eq!(Packed::pack(&noise(2000)), None);
        // As a picture: its head could be compressed, its body not.
        let picture = [vec![0; 4096], noise(200_000)].concat();
        assert_eq!(Packed::pack(&picture), None);
    }

    #[test]
    fn what_is_no_frame_or_of_another_length_is_refused() {
        let packed = Packed::pack(&[7; 5000]).unwrap();
        let whole = packed.bytes().clone();
        for (bytes, length) in [
            (whole.clone(), 4999),
            (whole.clone(), 5001),
            (whole.slice(..whole.len() - 1), 5000),
            (Bytes::from_static(b"nothing of the kind"), 5000),
            (Bytes::new(), 5000),
        ] {
            let error = Packed::received(bytes, length).unpack().unwrap_err();
            assert_eq!(error.code, Code::BAD_CONTENT, "{error}");
        }
    }
}
