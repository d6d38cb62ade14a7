//! Varints, names and fixed numbers of the binary form.

use std::sync::Arc;

use bytes::Bytes;

use super::words::{NameCache, number_of, word};
use crate::{Code, WireError, xml_violation};

pub(crate) fn put_varint(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push((number & 0x7f) as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

pub(crate) fn put_zigzag(out: &mut Vec<u8>, number: i64) {
    put_varint(out, ((number << 1) ^ (number >> 63)) as u64);
}

pub(crate) fn put_name(out: &mut Vec<u8>, name: &str) {
    match number_of(name) {
        Some(number) => put_varint(out, number << 1 | 1),
        None => {
            put_varint(out, (name.len() as u64) << 1);
            out.extend_from_slice(name.as_bytes());
        }
    }
}

/// Reads a frame's body from its front, knowing the position for errors.
pub(crate) struct FieldReader<'a> {
    bytes: &'a Bytes,
    position: usize,
}

impl<'a> FieldReader<'a> {
    /// Reads `bytes`, of which the first `position` are read already.
    pub(crate) fn at(bytes: &'a Bytes, position: usize) -> FieldReader<'a> {
        FieldReader { bytes, position }
    }

    pub(crate) fn position(&self) -> usize {
        self.position
    }

    pub(crate) fn byte(&mut self) -> Result<u8, WireError> {
        Ok(self.take(1)?[0])
    }

    pub(crate) fn long(&mut self) -> Result<i64, WireError> {
        let mut long = [0; 8];
        long.copy_from_slice(self.take(8)?);
        Ok(i64::from_be_bytes(long))
    }

    pub(crate) fn varint(&mut self) -> Result<u64, WireError> {
        let start = self.position;
        let mut number = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                break;
            }
            number |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(number);
            }
        }
        Err(bad(start, "a number of more than 64 bits"))
    }

    pub(crate) fn zigzag(&mut self) -> Result<i64, WireError> {
        let number = self.varint()?;
        Ok((number >> 1) as i64 ^ -((number & 1) as i64))
    }

    pub(crate) fn name(&mut self, names: &mut NameCache) -> Result<Arc<str>, WireError> {
        let start = self.position;
        let key = self.varint()?;
        if key & 1 == 1 {
            return word(key >> 1).ok_or_else(|| bad(start, "the number of a word that is not in the table"));
        }
        let text = self.text_of(key >> 1)?;
        Ok(names.share(text))
    }

    pub(crate) fn text(&mut self) -> Result<&'a str, WireError> {
        let length = self.varint()?;
        self.text_of(length)
    }

    pub(crate) fn block(&mut self) -> Result<Bytes, WireError> {
        let length = self.varint()?;
        let length = self.length(length)?;
        let start = self.position;
        self.take(length)?;
        Ok(self.bytes.slice(start..start + length))
    }

    pub(crate) fn rest(&mut self) -> Bytes {
        let rest = self.bytes.slice(self.position..);
        self.position = self.bytes.len();
        rest
    }

    fn text_of(&mut self, length: u64) -> Result<&'a str, WireError> {
        let length = self.length(length)?;
        let start = self.position;
        let bytes = self.take(length)?;
        let text = std::str::from_utf8(bytes).map_err(|error| encoding(start + error.valid_up_to()))?;
        match xml_violation(text) {
            None => Ok(text),
            Some(at) => Err(encoding(start + at)),
        }
    }

    fn length(&self, length: u64) -> Result<usize, WireError> {
        usize::try_from(length).map_err(|_| bad(self.position, "a length beyond the frame"))
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], WireError> {
        let slice = self.bytes[self.position..].get(..length);
        let slice = slice.ok_or_else(|| bad(self.bytes.len(), "the frame ends inside a slot"))?;
        self.position += length;
        Ok(slice)
    }
}

pub(crate) fn bad(position: usize, what: &str) -> WireError {
    WireError::new(
        Code::BAD_SLOT,
        format!("a binary header that cannot be read: {what}"),
    )
    .position(position)
}

fn encoding(position: usize) -> WireError {
    WireError::new(Code::BAD_ENCODING, "text that is not UTF-8 of XML characters").position(position)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
        for number in [0, 1, 127, 128, 300, 1 << 53, u64::MAX - 1, u64::MAX] {
            let mut out = Vec::new();
            put_varint(&mut out, number);
            put_zigzag(&mut out, number as i64);
            let bytes = Bytes::from(out);
            let mut reader = FieldReader::at(&bytes, 0);
            assert_eq!(
                (reader.varint(), reader.zigzag()),
                (Ok(number), Ok(number as i64))
            );
        }
    }

    #[test]
    fn overlong_numbers_are_refused() {
        for bytes in [
            &[0xff; 11][..],
            &[0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x02],
            &[0x80],
        ] {
            let bytes = Bytes::copy_from_slice(bytes);
            assert!(FieldReader::at(&bytes, 0).varint().is_err());
        }
    }
}
