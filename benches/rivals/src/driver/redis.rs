//! Redis: its third protocol (RESP3), where one connection may subscribe and publish.

use mom_benches::{Driver, Error, Link, Message, Scan, Scanner, Template, Topic, decimal};

use super::until;

const END: &[u8] = b"\r\n";

/// Drives redis-server's publish and subscribe.
#[derive(Clone, Debug)]
pub struct RedisDriver {
    address: String,
}

impl RedisDriver {
    /// A driver for a server at this address.
    pub fn new(address: &str) -> RedisDriver {
        RedisDriver {
            address: address.to_owned(),
        }
    }
}

/// A command as an array of bulk strings.
fn command(words: &[&str]) -> Vec<u8> {
    let mut out = format!("*{}\r\n", words.len());
    for word in words {
        out += &format!("${}\r\n{word}\r\n", word.len());
    }
    out.into_bytes()
}

impl Driver for RedisDriver {
    /// Who sends switches the replies to `PUBLISH` off: they would be read by nobody, and cost the server time.
    fn connect(&self, hears: &[Topic], says: &[Topic]) -> Result<Link, Error> {
        let mut link = Link::connect(&self.address)?;
        link.write(&command(&["HELLO", "3"]))?;
        link.write(&command(&["PING"]))?;
        until(&mut link, b"+PONG\r\n")?;
        for topic in hears {
            link.write(&command(&["SUBSCRIBE", topic.word()]))?;
            until(&mut link, b":")?;
            until(&mut link, END)?;
        }
        if !says.is_empty() {
            link.write(&command(&["CLIENT", "REPLY", "OFF"]))?;
        }
        Ok(link)
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        let mut before = command(&["PUBLISH", message.topic.word()]);
        before[1] = b'3';
        before.extend_from_slice(format!("${}\r\n", message.payload).as_bytes());
        Ok(Template::around(&before, message.payload, END))
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        Box::new(RedisScanner)
    }
}

struct RedisScanner;

/// What comes before a message's channel; all subjects have the same length.
const PUSH: &[u8] = b">3\r\n$7\r\nmessage\r\n$5\r\n";
const SUBJECT: usize = 5;

impl Scanner for RedisScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let before = PUSH.len() + SUBJECT + END.len();
        let known = bytes.len().min(PUSH.len());
        if bytes[..known] != PUSH[..known] {
            let text = String::from_utf8_lossy(&bytes[..bytes.len().min(60)]).into_owned();
            return Err(Error::Unexpected(text));
        }
        let Some(rest) = bytes.get(before..) else {
            return Ok(Scan::Incomplete);
        };
        let Some(end) = memchr::memchr(b'\n', rest) else {
            return Ok(Scan::Incomplete);
        };
        let (line, rest) = rest.split_at(end + 1);
        let digits = line.strip_prefix(b"$").map(<[u8]>::trim_ascii_end);
        let payload = digits
            .and_then(decimal)
            .ok_or_else(|| Error::Unexpected(String::from_utf8_lossy(line).into_owned()))?;
        match rest.get(..payload + END.len()) {
            None => Ok(Scan::Incomplete),
            Some(found) => {
                let number = Template::last_number(&found[..payload])?;
                Ok(Scan::Parcel(before + line.len() + found.len(), number))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pushes_are_found_and_errors_told() {
        let driver = RedisDriver::new("127.0.0.1:1");
        let mut sent = Vec::new();
        driver.template(Message::forth(16)).unwrap().append(7, &mut sent);
        assert_eq!(
            sent,
            b"*3\r\n$7\r\nPUBLISH\r\n$5\r\nforth\r\n$16\r\n........aaaaaaah\r\n"
        );
        let heard = b">3\r\n$7\r\nmessage\r\n$5\r\nforth\r\n$16\r\n........aaaaaaah\r\n";
        let mut scanner = driver.scanner();
        assert_eq!(scanner.scan(heard).unwrap(), Scan::Parcel(heard.len(), 7));
        for cut in 0..heard.len() {
            assert_eq!(scanner.scan(&heard[..cut]).unwrap(), Scan::Incomplete, "{cut}");
        }
        assert!(scanner.scan(b"-ERR no\r\n").is_err());
    }

    #[test]
    fn subjects_have_the_length_that_the_scanner_takes() {
        assert!(Topic::ALL.iter().all(|topic| topic.word().len() == SUBJECT));
    }
}
