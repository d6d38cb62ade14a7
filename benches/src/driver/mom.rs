//! MOM's own protocol, binary and XML.

use std::io::Write;

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::xml::XmlDecoder;
use mom_proto::{ContextNumber, Family, Limits, Map, Parcel, Path, Time, Value, WireError};

use super::{Driver, Link, NUMBER, Scan, Scanner, Template};
use crate::Error;

/// One frame of so many is decoded whole, to be sure that the others are what they look like.
const SAMPLE: u32 = 1024;

/// The sender's clock stands still: what it says does not matter, that it says something does.
const STAMP: i64 = 1_795_255_200_000_123;

/// Drives a MOM broker: each peer logs in and joins one channel, messages go to all others there.
#[derive(Clone, Debug)]
pub struct MomDriver {
    address: String,
    form: Form,
    user: String,
    channel: Path,
    number: ContextNumber,
}

impl MomDriver {
    /// A driver for a broker at this address, for one user, its password being its name.
    ///
    /// # Errors
    /// A broker that does not let the user in, or into the channel.
    pub fn new(address: &str, form: Form, user: &str, channel: &Path) -> Result<MomDriver, Error> {
        let mut driver = MomDriver {
            address: address.to_owned(),
            form,
            user: user.to_owned(),
            channel: channel.clone(),
            number: ContextNumber(0),
        };
        let (_, joined) = driver.join()?;
        let number = match &joined {
            Value::Map(map) => map.get("number").and_then(Value::as_int),
            _ => None,
        };
        let number = number.and_then(|number| u64::try_from(number).ok());
        driver.number = ContextNumber(
            number.ok_or_else(|| Error::Unexpected(format!("a join without a number: {joined:?}")))?,
        );
        Ok(driver)
    }

    fn join(&self) -> Result<(Link, Value), Error> {
        let mut link = Link::connect(&self.address)?;
        let limits = Limits::default();
        let mut decoder = match self.form {
            Form::Binary => Decoder::Binary(Box::new(BinaryDecoder::for_peer(&limits))),
            Form::Xml => Decoder::Xml(Box::new(XmlDecoder::new(&limits))),
        };
        if self.form == Form::Binary {
            link.stream.write_all(&PREFACE).map_err(Error::io("write"))?;
        }
        let credentials = Map::new()
            .with("name", self.user.as_str())
            .with("password", self.user.as_str());
        let login = Parcel::new(Family::Login, "login")
            .context(Path::root())
            .id(1)
            .content(credentials);
        let join = Parcel::new(Family::Context, "join")
            .context(self.channel.clone())
            .id(2);
        let mut input = BytesMut::new();
        let mut joined = Value::Null;
        for request in [login, join] {
            let sent = self.form.encode(&request).map_err(Error::hub("a request"))?;
            link.stream
                .write_all(&sent.to_vec())
                .map_err(Error::io("write"))?;
            joined = reply(&mut link, &mut decoder, &mut input, &request)?;
        }
        link.received = input.to_vec();
        Ok((link, joined))
    }

    fn message(&self, content: Value) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, "state").content(content);
        match self.form {
            Form::Binary => parcel.number = Some(self.number),
            Form::Xml => parcel.context = Some(self.channel.clone()),
        }
        parcel.timestamp = Time::from_micros(STAMP);
        parcel.echo = Some(false);
        parcel
    }
}

impl Driver for MomDriver {
    fn connect(&self) -> Result<Link, Error> {
        self.join().map(|(link, _)| link)
    }

    fn template(&self, payload: usize) -> Result<Template, Error> {
        let content = match self.form {
            Form::Binary => Value::Binary(Bytes::from(vec![b'.'; payload])),
            Form::Xml => Value::from(".".repeat(payload)),
        };
        let encoded = self.form.encode(&self.message(content));
        let frame = encoded.map_err(Error::hub("a message"))?.to_vec();
        // The content ends the parcel in both forms.
        let after = match self.form {
            Form::Binary => 0,
            Form::Xml => XML_END.len(),
        };
        let number_at = frame.len() - after - payload;
        Ok(Template::new(frame, number_at))
    }

    fn scanner(&self, payload: usize) -> Box<dyn Scanner> {
        let payload = payload.max(NUMBER);
        let samples = Samples::new(self.form, payload);
        match self.form {
            Form::Binary => Box::new(BinaryScanner { payload, samples }),
            Form::Xml => Box::new(XmlScanner { payload, samples }),
        }
    }
}

/// Waits for the reply to a request.
fn reply(
    link: &mut Link,
    decoder: &mut Decoder,
    input: &mut BytesMut,
    request: &Parcel,
) -> Result<Value, Error> {
    let what = || format!("{} of {}", request.name(), request.family.word());
    loop {
        match decoder.decode(input).map_err(Error::hub(what()))? {
            Some(Frame::Parcel(parcel)) => match parcel.family {
                Family::Error => {
                    let error = WireError::from_parcel(&parcel);
                    return Err(Error::Hub { what: what(), error });
                }
                Family::Reply if parcel.reference == request.id => return Ok(parcel.value()),
                _ => {}
            },
            Some(Frame::Malformed { error, .. }) => return Err(Error::Hub { what: what(), error }),
            None => input.extend_from_slice(link.receive()?),
        }
    }
}

/// Decodes some frames whole.
struct Samples {
    decoder: Decoder,
    payload: usize,
    seen: u32,
}

impl Samples {
    fn new(form: Form, payload: usize) -> Samples {
        let mut decoder = Decoder::new(form, &Limits::default());
        if form == Form::Binary {
            // Its own greeting is read already; a preface and nothing after it is no frame.
            let greeted = decoder.decode(&mut BytesMut::from(&PREFACE[..]));
            debug_assert!(matches!(greeted, Ok(None)));
        }
        Samples {
            decoder,
            payload,
            seen: 0,
        }
    }

    /// Checks one message of so many.
    fn message(&mut self, frame: &[u8]) -> Result<(), Error> {
        self.seen = self.seen.wrapping_add(1);
        if self.seen % SAMPLE != 1 {
            return Ok(());
        }
        let parcel = self.decode(frame)?;
        let length = match parcel.value() {
            Value::Binary(bytes) => bytes.len(),
            Value::String(text) => text.len(),
            _ => 0,
        };
        let good = parcel.is(Family::Message, "state")
            && length == self.payload
            && parcel.sender.is_some()
            && parcel.received.is_some()
            && parcel.timestamp == Time::from_micros(STAMP);
        match good {
            true => Ok(()),
            false => Err(Error::Unexpected(format!(
                "a message that was not sent: {parcel:?}"
            ))),
        }
    }

    /// Looks at a frame that is no message: whatever tells of a loss ends the measurement.
    fn other(&mut self, frame: &[u8]) -> Result<Scan, Error> {
        let parcel = self.decode(frame)?;
        match parcel.family {
            Family::Error => Err(Error::Hub {
                what: "while measuring".to_owned(),
                error: WireError::from_parcel(&parcel),
            }),
            Family::Event if parcel.name() == mom_proto::event::DROPPED => {
                Err(Error::Unexpected(format!("dropped: {:?}", parcel.value())))
            }
            _ => Ok(Scan::Other(frame.len())),
        }
    }

    fn decode(&mut self, frame: &[u8]) -> Result<Parcel, Error> {
        let decoded = self.decoder.decode(&mut BytesMut::from(frame));
        match decoded.map_err(Error::hub("a frame"))? {
            Some(Frame::Parcel(parcel)) => Ok(*parcel),
            other => Err(Error::Unexpected(format!("{other:?} for a frame"))),
        }
    }
}

struct BinaryScanner {
    payload: usize,
    samples: Samples,
}

/// The kind of a frame that holds a whole parcel.
const WHOLE: u8 = 0;
/// The presence bit of the slot family, which messages leave out; the bitmap is a varint of seven bits a byte.
const FAMILY_BYTE: usize = 1;
const FAMILY_BIT: u8 = 1 << 3;

impl Scanner for BinaryScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some((length, rest)) = bytes.split_first_chunk::<4>() else {
            return Ok(Scan::Incomplete);
        };
        let Some(frame) = rest.get(..u32::from_be_bytes(*length) as usize) else {
            return Ok(Scan::Incomplete);
        };
        let size = frame.len() + 4;
        let message = match frame {
            [WHOLE, bitmap @ ..] if bitmap.len() > self.payload => {
                bitmap[0] < 0x80 || bitmap[FAMILY_BYTE] & FAMILY_BIT == 0
            }
            _ => false,
        };
        if !message {
            return self.samples.other(&bytes[..size]);
        }
        self.samples.message(&bytes[..size])?;
        numbered(&frame[frame.len() - self.payload..], size)
    }
}

struct XmlScanner {
    payload: usize,
    samples: Samples,
}

const XML_MESSAGE: &[u8] = b"<parcel><family>message</family>";
const XML_END: &[u8] = b"</content></parcel>";

impl Scanner for XmlScanner {
    fn scan(&mut self, bytes: &[u8]) -> Result<Scan, Error> {
        let Some(size) = entity(bytes)? else {
            return Ok(Scan::Incomplete);
        };
        let (head, body) = bytes[..size.whole].split_at(size.header);
        let content = body
            .strip_prefix(XML_MESSAGE)
            .and_then(|rest| rest.strip_suffix(XML_END))
            .and_then(|rest| rest.get(rest.len().checked_sub(self.payload)?..));
        match content {
            Some(content) => {
                self.samples.message(&bytes[..size.whole])?;
                numbered(content, head.len() + body.len())
            }
            None => self.samples.other(&bytes[..size.whole]),
        }
    }
}

fn numbered(content: &[u8], size: usize) -> Result<Scan, Error> {
    match Template::number(content) {
        Some(number) => Ok(Scan::Parcel(size, number)),
        None => Err(Error::Unexpected("a message without a number".to_owned())),
    }
}

/// The lengths of an XML entity, in bytes.
struct Entity {
    header: usize,
    whole: usize,
}

/// The entity at the front, if all of it is there.
fn entity(bytes: &[u8]) -> Result<Option<Entity>, Error> {
    const END: &[u8] = b"\r\n\r\n";
    const LENGTH: &str = "Content-Length: ";
    let Some(end) = bytes.windows(END.len()).position(|window| window == END) else {
        return Ok(None);
    };
    let length = std::str::from_utf8(&bytes[..end])
        .ok()
        .and_then(|lines| lines.lines().find_map(|line| line.strip_prefix(LENGTH)))
        .and_then(|digits| digits.parse::<usize>().ok());
    let length = length.ok_or_else(|| Error::Unexpected("an entity without a length".to_owned()))?;
    let header = end + END.len();
    let whole = header + length;
    Ok((whole <= bytes.len()).then_some(Entity { header, whole }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn driver(form: Form) -> MomDriver {
        MomDriver {
            address: "127.0.0.1:1".to_owned(),
            form,
            user: "peer".to_owned(),
            channel: Path::parse("/bench").unwrap(),
            number: ContextNumber(2),
        }
    }

    /// What the hub makes of a template with this number, or any other parcel.
    fn frame(form: Form, parcel: &Parcel) -> Vec<u8> {
        form.encode(parcel).unwrap().to_vec()
    }

    fn delivered(form: Form, payload: usize, number: u32) -> Parcel {
        let mut text = Vec::new();
        Template::new(vec![b'.'; payload], 0).append(number, &mut text);
        let content = match form {
            Form::Binary => Value::Binary(text.into()),
            Form::Xml => Value::from(String::from_utf8(text).unwrap()),
        };
        let mut parcel = driver(form).message(content);
        parcel.context = Some(Path::parse("/bench").unwrap());
        parcel.sender = Some("peer~2".into());
        parcel.received = Time::from_micros(STAMP);
        parcel.age = Some(0);
        parcel
    }

    #[test]
    fn messages_are_found_by_number() {
        for form in [Form::Binary, Form::Xml] {
            for payload in [8, 16, 300, 70_000] {
                let bytes = frame(form, &delivered(form, payload, 77));
                let mut scanner = driver(form).scanner(payload);
                for cut in [1, 5, bytes.len() - 1] {
                    assert_eq!(scanner.scan(&bytes[..cut]).unwrap(), Scan::Incomplete, "{form:?}");
                }
                let more = [&bytes[..], b"next"].concat();
                assert_eq!(scanner.scan(&more).unwrap(), Scan::Parcel(bytes.len(), 77));
            }
        }
    }

    #[test]
    fn templates_are_what_the_hub_reads() {
        for form in [Form::Binary, Form::Xml] {
            let mut bytes = Vec::new();
            driver(form).template(16).unwrap().append(5, &mut bytes);
            let parcel = Samples::new(form, 16).decode(&bytes).unwrap();
            let expected = b"aaaaaaaf........";
            match parcel.value() {
                Value::Binary(content) => assert_eq!(content, &expected[..]),
                Value::String(content) => assert_eq!(content.as_bytes(), expected),
                other => panic!("{other:?}"),
            }
            assert_eq!(parcel.echo, Some(false));
        }
    }

    #[test]
    fn losses_and_strangers_end_the_measurement() {
        for form in [Form::Binary, Form::Xml] {
            let mut scanner = driver(form).scanner(16);
            let pong = frame(form, &Parcel::new(Family::Time, "ping").id(0));
            assert_eq!(scanner.scan(&pong).unwrap(), Scan::Other(pong.len()));
            let dropped = Parcel::new(Family::Event, "dropped").content(Map::new().with("count", 3));
            let error = WireError::new(mom_proto::Code::NOT_MEMBER, "join first").to_parcel(None);
            let mut unnumbered = delivered(form, 16, 1);
            unnumbered.content = Some("................".into());
            let mut unsent = delivered(form, 16, 1);
            unsent.sender = None;
            for parcel in [dropped, error, unnumbered, unsent] {
                let bytes = frame(form, &parcel);
                assert!(driver(form).scanner(16).scan(&bytes).is_err(), "{parcel:?}");
            }
        }
    }
}
