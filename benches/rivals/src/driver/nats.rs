//! NATS: lines of text, payloads by length.

use mom_benches::{Driver, Error, Link, Message, Scan, Scanner, Template, Topic, decimal};

use super::until;

const END: &[u8] = b"\r\n";

/// Drives nats-server.
#[derive(Clone, Debug)]
pub struct NatsDriver {
    address: String,
}

impl NatsDriver {
    /// A driver for a server at this address.
    pub fn new(address: &str) -> NatsDriver {
        NatsDriver {
            address: address.to_owned(),
        }
    }
}

impl Driver for NatsDriver {
    fn connect(&self, hears: &[Topic], _says: &[Topic]) -> Result<Link, Error> {
        let mut link = Link::connect(&self.address)?;
        until(&mut link, END)?;
        let mut hello = "CONNECT {\"verbose\":false,\"pedantic\":false,\"tls_required\":false,\
                         \"name\":\"bench\",\"lang\":\"raw\",\"version\":\"1\",\"protocol\":1}\r\n"
            .to_owned();
        for (number, topic) in hears.iter().enumerate() {
            hello += &format!("SUB {} {}\r\n", topic.word(), number + 1);
        }
        link.write((hello + "PING\r\n").as_bytes())?;
        loop {
            let line = until(&mut link, END)?;
            match &*line {
                b"PONG\r\n" => return Ok(link),
                b"PING\r\n" => link.write(b"PONG\r\n")?,
                line if line.starts_with(b"-ERR") => return Err(told(line)),
                _ => {}
            }
        }
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        let before = format!("PUB {} {}\r\n", message.topic.word(), message.payload);
        Ok(Template::around(before.as_bytes(), message.payload, END))
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        Box::new(NatsScanner)
    }
}

struct NatsScanner;

impl Scanner for NatsScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some(end) = memchr::memchr(b'\n', bytes) else {
            return Ok(Scan::Incomplete);
        };
        let (line, rest) = bytes.split_at(end + 1);
        if !line.starts_with(b"MSG ") {
            return match line.starts_with(b"-ERR") {
                true => Err(told(line)),
                false => Ok(Scan::Other(line.len())),
            };
        }
        let digits = line.trim_ascii_end().rsplit(|byte| *byte == b' ').next();
        let payload = digits.and_then(decimal).ok_or_else(|| told(line))?;
        match rest.get(..payload + END.len()) {
            None => Ok(Scan::Incomplete),
            Some(found) => {
                let number = Template::last_number(&found[..payload])?;
                Ok(Scan::Parcel(line.len() + found.len(), number))
            }
        }
    }
}

fn told(line: &[u8]) -> Error {
    Error::Unexpected(String::from_utf8_lossy(line).trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parcels_are_found_among_lines() {
        let driver = NatsDriver::new("127.0.0.1:1");
        let mut sent = Vec::new();
        driver.template(Message::forth(16)).unwrap().append(7, &mut sent);
        assert_eq!(sent, b"PUB forth 16\r\n........aaaaaaah\r\n");
        let heard = b"PING\r\nMSG forth 1 16\r\n........aaaaaaah\r\n";
        let mut scanner = driver.scanner();
        assert_eq!(scanner.scan(heard).unwrap(), Scan::Other(6));
        assert_eq!(
            scanner.scan(&heard[6..]).unwrap(),
            Scan::Parcel(heard.len() - 6, 7)
        );
        for cut in 6..heard.len() {
            assert_eq!(scanner.scan(&heard[6..cut]).unwrap(), Scan::Incomplete, "{cut}");
        }
        assert!(scanner.scan(b"-ERR 'Slow Consumer'\r\n").is_err());
        assert!(scanner.scan(b"MSG forth 1 x\r\n").is_err());
    }
}
