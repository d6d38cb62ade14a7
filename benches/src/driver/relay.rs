//! The relay's protocol: a big-endian u32 length, then so many bytes.

use super::{Driver, Link, Message, Scan, Scanner, Template, Topic};
use crate::Error;

const PREFIX: usize = 4;

/// Drives the relay: the least that any hub has to do.
#[derive(Clone, Debug)]
pub struct RelayDriver {
    address: String,
}

impl RelayDriver {
    /// A driver for a relay at this address.
    pub fn new(address: &str) -> RelayDriver {
        RelayDriver {
            address: address.to_owned(),
        }
    }
}

impl Driver for RelayDriver {
    /// The relay greets with an empty frame once the peer hears all others.
    fn connect(&self, _hears: &[Topic], _says: &[Topic]) -> Result<Link, Error> {
        let mut link = Link::connect(&self.address)?;
        while link.received.len() < PREFIX {
            link.receive()?;
        }
        match link.received.drain(..PREFIX).eq([0; PREFIX]) {
            true => Ok(link),
            false => Err(Error::Unexpected(
                "a greeting that is not an empty frame".to_owned(),
            )),
        }
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        let payload = message.payload;
        let length =
            u32::try_from(payload).map_err(|_| Error::Unexpected(format!("a payload of {payload} bytes")))?;
        Ok(Template::around(&length.to_be_bytes(), payload, &[]))
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        Box::new(RelayScanner)
    }
}

struct RelayScanner;

impl Scanner for RelayScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some((length, rest)) = bytes.split_first_chunk::<PREFIX>() else {
            return Ok(Scan::Incomplete);
        };
        let length = u32::from_be_bytes(*length) as usize;
        match rest.get(..length) {
            None => Ok(Scan::Incomplete),
            Some(payload) => Ok(Scan::Parcel(PREFIX + length, Template::last_number(payload)?)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_are_found_again() {
        let driver = RelayDriver::new("127.0.0.1:1");
        let mut bytes = Vec::new();
        driver.template(Message::forth(16)).unwrap().append(7, &mut bytes);
        let mut scanner = driver.scanner();
        assert_eq!(scanner.scan(&bytes[..3]).unwrap(), Scan::Incomplete);
        assert_eq!(scanner.scan(&bytes[..19]).unwrap(), Scan::Incomplete);
        assert_eq!(scanner.scan(&bytes).unwrap(), Scan::Parcel(20, 7));
        bytes[12] = b'.';
        assert!(scanner.scan(&bytes).is_err());
    }
}
