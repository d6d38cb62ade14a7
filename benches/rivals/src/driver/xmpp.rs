//! XMPP (RFC 6120) and its rooms (XEP-0045), as far as two peers in a room need it.

use std::sync::atomic::{AtomicU64, Ordering};

use memchr::memmem;
use mom_benches::{Driver, Error, Link, Message, Scan, Scanner, Template, Topic};

use super::until;

/// The host of the configuration under measurement.
pub(crate) const HOST: &str = "localhost";
/// Where its rooms are.
pub(crate) const ROOMS: &str = "rooms.localhost";

/// Drives a server's rooms: a topic is a room, everybody in it hears everybody, also itself.
#[derive(Debug)]
pub struct XmppDriver {
    address: String,
    /// Nicknames in a room are unique.
    occupants: AtomicU64,
}

impl XmppDriver {
    /// A driver for a server at this address that lets anonymous users in.
    pub fn new(address: &str) -> XmppDriver {
        XmppDriver {
            address: address.to_owned(),
            occupants: AtomicU64::new(0),
        }
    }
}

fn open_stream(link: &mut Link) -> Result<(), Error> {
    let head = format!(
        "<stream:stream to='{HOST}' version='1.0' xmlns='jabber:client' \
         xmlns:stream='http://etherx.jabber.org/streams'>"
    );
    link.write(head.as_bytes())?;
    until(link, b"</stream:features>").map(drop)
}

impl Driver for XmppDriver {
    fn connect(&self, hears: &[Topic], says: &[Topic]) -> Result<Link, Error> {
        let mut link = Link::connect(&self.address)?;
        open_stream(&mut link)?;
        link.write(b"<auth xmlns='urn:ietf:params:xml:ns:xmpp-sasl' mechanism='ANONYMOUS'/>")?;
        until(&mut link, b"<success")?;
        until(&mut link, b">")?;
        open_stream(&mut link)?;
        link.write(b"<iq type='set' id='b1'><bind xmlns='urn:ietf:params:xml:ns:xmpp-bind'/></iq>")?;
        until(&mut link, b"</bind>")?;
        until(&mut link, b"</iq>")?;
        for topic in hears.iter().chain(says) {
            let number = self.occupants.fetch_add(1, Ordering::Relaxed);
            let room = format!(
                "<presence to='{}@{ROOMS}/p{number}'><x xmlns='http://jabber.org/protocol/muc'>\
                 <history maxstanzas='0'/></x></presence>",
                topic.word()
            );
            link.write(room.as_bytes())?;
            // After one's own presence comes the room's subject, and then what is said.
            until(&mut link, b"<subject")?;
            until(&mut link, b"</message>")?;
        }
        Ok(link)
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        let before = format!(
            "<message to='{}@{ROOMS}' type='groupchat'><body>",
            message.topic.word()
        );
        Ok(Template::around(
            before.as_bytes(),
            message.payload,
            b"</body></message>",
        ))
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        Box::new(XmppScanner)
    }

    fn reflects(&self) -> bool {
        true
    }
}

struct XmppScanner;

impl Scanner for XmppScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let after = |end: &[u8]| memmem::find(bytes, end).map(|at| at + end.len());
        let stanza = match bytes {
            [b'<', b'm', ..] => after(b"</message>"),
            [b'<', b'p', ..] => after(b"</presence>"),
            [b'<', b'i', ..] => after(b"</iq>"),
            [b'<', b'r' | b'/', ..] => None,
            [b'<'] | [] => return Ok(Scan::Incomplete),
            [b'<', ..] => return Err(told(bytes)),
            // White space keeps a connection alive.
            [_, ..] => return Ok(Scan::Other(1)),
        };
        let Some(length) = stanza else {
            return match bytes.starts_with(b"</stream") || memmem::find(bytes, b"stream:error").is_some() {
                true => Err(told(bytes)),
                false => Ok(Scan::Incomplete),
            };
        };
        let stanza = &bytes[..length];
        let opening = memchr::memchr(b'>', stanza).map_or(stanza, |end| &stanza[..end]);
        if memmem::find(opening, b"type='error'").is_some() {
            return Err(told(stanza));
        }
        match memmem::find(stanza, b"</body>") {
            Some(end) => Ok(Scan::Parcel(length, Template::last_number(&stanza[..end])?)),
            None => Ok(Scan::Other(length)),
        }
    }
}

fn told(bytes: &[u8]) -> Error {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(300)]).into_owned();
    Error::Unexpected(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stanzas_are_found_whole() {
        let driver = XmppDriver::new("127.0.0.1:1");
        let mut sent = Vec::new();
        driver.template(Message::forth(16)).unwrap().append(7, &mut sent);
        assert_eq!(
            sent,
            b"<message to='forth@rooms.localhost' type='groupchat'><body>........aaaaaaah</body></message>"
        );
        let mut scanner = driver.scanner();
        assert_eq!(scanner.scan(&sent).unwrap(), Scan::Parcel(sent.len(), 7));
        assert_eq!(scanner.scan(&sent[..sent.len() - 1]).unwrap(), Scan::Incomplete);
        let presence = b"<presence from='a'><x/></presence>";
        assert_eq!(scanner.scan(presence).unwrap(), Scan::Other(presence.len()));
        assert_eq!(scanner.scan(b" <message").unwrap(), Scan::Other(1));
        assert!(scanner.scan(b"<message type='error'><body/></message>").is_err());
        assert!(scanner.scan(b"</stream:stream>").is_err());
    }
}
