//! MQTT 3.1.1, quality of service 0: at most once, as all here.

use mom_benches::{Driver, Error, Link, Message, Scan, Scanner, Template, Topic};

const CONNACK: u8 = 0x20;
const PUBLISH: u8 = 0x30;
const SUBACK: u8 = 0x90;

/// Drives an MQTT broker.
#[derive(Clone, Debug)]
pub struct MqttDriver {
    address: String,
}

impl MqttDriver {
    /// A driver for a broker at this address.
    pub fn new(address: &str) -> MqttDriver {
        MqttDriver {
            address: address.to_owned(),
        }
    }
}

/// A packet's first byte and the length of what follows, seven bits a byte, the lowest first.
fn head(kind: u8, mut length: usize) -> Vec<u8> {
    let mut out = vec![kind];
    loop {
        let byte = (length % 128) as u8;
        length /= 128;
        match length {
            0 => {
                out.push(byte);
                return out;
            }
            _ => out.push(byte | 0x80),
        }
    }
}

/// The head's own length and that of the whole packet, as far as they are there.
fn lengths(bytes: &[u8]) -> Result<Option<(usize, usize)>, Error> {
    let mut length = 0;
    for (index, byte) in bytes.iter().skip(1).take(4).enumerate() {
        length |= usize::from(byte & 0x7f) << (7 * index);
        if byte & 0x80 == 0 {
            let head = 2 + index;
            return Ok(Some((head, head + length)));
        }
    }
    match bytes.len() {
        0..5 => Ok(None),
        _ => Err(Error::Unexpected("a packet without a length".to_owned())),
    }
}

fn text(text: &str) -> Vec<u8> {
    let length = u16::try_from(text.len()).expect("texts here are short");
    [&length.to_be_bytes(), text.as_bytes()].concat()
}

fn expect(link: &mut Link, kind: u8) -> Result<(), Error> {
    loop {
        if let Some((_, whole)) = lengths(&link.received)?
            && link.received.len() >= whole
        {
            let packet: Vec<u8> = link.received.drain(..whole).collect();
            let good = packet[0] == kind && packet.last().is_some_and(|code| *code == 0);
            return match good {
                true => Ok(()),
                false => Err(Error::Unexpected(format!("{packet:?} in place of {kind:#x}"))),
            };
        }
        link.receive()?;
    }
}

impl Driver for MqttDriver {
    fn connect(&self, hears: &[Topic], _says: &[Topic]) -> Result<Link, Error> {
        let mut link = Link::connect(&self.address)?;
        // Version 4, a clean session, no keep-alive, no name of its own.
        let body = [&text("MQTT")[..], &[4, 2, 0, 0], &text("")].concat();
        link.write(&[head(0x10, body.len()), body].concat())?;
        expect(&mut link, CONNACK)?;
        for topic in hears {
            let body = [&[0, 1][..], &text(topic.word()), &[0]].concat();
            link.write(&[head(0x82, body.len()), body].concat())?;
            expect(&mut link, SUBACK)?;
        }
        Ok(link)
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        let topic = text(message.topic.word());
        let before = [head(PUBLISH, topic.len() + message.payload), topic].concat();
        Ok(Template::around(&before, message.payload, &[]))
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        Box::new(MqttScanner)
    }
}

struct MqttScanner;

impl Scanner for MqttScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some((head, whole)) = lengths(bytes)? else {
            return Ok(Scan::Incomplete);
        };
        match bytes.get(head..whole) {
            None => Ok(Scan::Incomplete),
            Some(body) if bytes[0] & 0xf0 == PUBLISH => Ok(Scan::Parcel(whole, Template::last_number(body)?)),
            Some(_) => Ok(Scan::Other(whole)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_of_any_length_are_found() {
        let driver = MqttDriver::new("127.0.0.1:1");
        for payload in [8, 119, 120, 121, 20_000, 300_000] {
            let mut packet = Vec::new();
            driver
                .template(Message::forth(payload))
                .unwrap()
                .append(7, &mut packet);
            let mut scanner = driver.scanner();
            assert_eq!(scanner.scan(&packet).unwrap(), Scan::Parcel(packet.len(), 7));
            for cut in [0, 1, 2, packet.len() - 1] {
                assert_eq!(scanner.scan(&packet[..cut]).unwrap(), Scan::Incomplete, "{cut}");
            }
        }
        assert_eq!(driver.scanner().scan(&[0xd0, 0]).unwrap(), Scan::Other(2));
        assert!(driver.scanner().scan(&[PUBLISH, 255, 255, 255, 255]).is_err());
    }
}
