//! MOM's own protocol, in all its forms.

use bytes::{Bytes, BytesMut};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::{ContextNumber, Delivery, Family, Limits, Map, Parcel, Path, Time, Value, WireError};

use super::mom_scan::{BinaryScanner, JSON_END, JsonScanner, XML_END, XmlScanner};
use super::{Driver, Link, Message, NUMBER, Scanner, Template, Topic, now};
use crate::Error;

/// The token that guards commands.
const TOKEN: &str = "/cell/token";

/// Drives a MOM broker: each peer logs in as a guest and joins the channels of its topics.
#[derive(Clone, Debug)]
pub struct MomDriver {
    address: String,
    form: Form,
    /// The channels of all topics, in their order, with their numbers.
    channels: Vec<(Path, ContextNumber)>,
}

/// The channel of a topic in the configuration under measurement.
fn channel(topic: Topic) -> &'static str {
    match topic {
        Topic::Forth => "/bench",
        Topic::Back => "/back",
        Topic::Image => "/camera",
        Topic::Stop => "/stop",
        Topic::Command => "/cell/arm",
        Topic::Bulk => "/bulk",
    }
}

impl MomDriver {
    /// A driver for a broker at this address, with the configuration of [`crate::broker_folder`].
    ///
    /// # Errors
    /// A broker that does not let guests in, or into a channel.
    pub fn new(address: &str, form: Form) -> Result<MomDriver, Error> {
        let mut session = Session::login(address, form)?;
        let mut channels = Vec::new();
        for topic in Topic::ALL {
            let joined = session.join(topic)?;
            let number = match &joined {
                Value::Map(map) => map.get("number").and_then(Value::as_int),
                _ => None,
            };
            let number = number.and_then(|number| u64::try_from(number).ok());
            let number =
                number.ok_or_else(|| Error::Unexpected(format!("a join without a number: {joined:?}")))?;
            channels.push((path(channel(topic))?, ContextNumber(number)));
        }
        Ok(MomDriver {
            address: address.to_owned(),
            form,
            channels,
        })
    }

    fn message(&self, topic: Topic, content: Value) -> Parcel {
        let (path, number) = &self.channels[topic as usize];
        let name = match topic {
            Topic::Forth | Topic::Back | Topic::Bulk => "state",
            Topic::Image => "image",
            Topic::Stop => "stop",
            Topic::Command => "command",
        };
        let mut parcel = Parcel::new(Family::Message, name).content(content);
        match self.form {
            Form::Binary | Form::Packed => parcel.number = Some(*number),
            Form::Xml | Form::Json => parcel.context = Some(path.clone()),
        }
        if topic == Topic::Image {
            parcel.delivery = Some(Delivery::Latest);
        }
        parcel.timestamp = Time::from_micros(now());
        parcel
    }
}

impl Driver for MomDriver {
    fn connect(&self, hears: &[Topic], says: &[Topic]) -> Result<Link, Error> {
        let mut session = Session::login(&self.address, self.form)?;
        for topic in hears.iter().chain(says) {
            session.join(*topic)?;
        }
        if says.contains(&Topic::Command) {
            // The owner of the run before may just be leaving.
            let grab = Parcel::new(Family::Token, "grab").context(path(TOKEN)?);
            session.ask(grab.content(Map::new().with("wait", 5000)))?;
        }
        session.link.received = session.input.to_vec();
        Ok(session.link)
    }

    fn template(&self, message: Message) -> Result<Template, Error> {
        let payload = message.payload.max(NUMBER);
        let content = match self.form {
            Form::Binary | Form::Packed => Value::Binary(Bytes::from(vec![b'.'; payload])),
            Form::Xml | Form::Json => Value::from(".".repeat(payload)),
        };
        let mut parcel = self.message(message.topic, content);
        parcel.echo = Some(message.echo);
        let stamp = parcel.timestamp.map(Time::micros);
        let encoded = self.form.encode(&parcel);
        let frame = encoded.map_err(Error::hub("a message"))?.to_vec();
        // The content ends the parcel in all forms.
        let after = match self.form {
            Form::Binary | Form::Packed => 0,
            Form::Xml => XML_END.len(),
            Form::Json => JSON_END.len(),
        };
        let number_at = frame.len() - after - NUMBER;
        // Where age matters the time is that of sending, else one for all: the clock is not what is measured.
        let timed = matches!(message.topic, Topic::Image | Topic::Stop) && self.form == Form::Binary;
        let stamp = stamp.filter(|_| timed).map(i64::to_be_bytes);
        let stamp_at = stamp.and_then(|stamp| memchr::memmem::find(&frame, &stamp));
        let template = Template::new(frame, number_at);
        Ok(match stamp_at {
            Some(at) => template.stamped(at),
            None => template,
        })
    }

    fn scanner(&self) -> Box<dyn Scanner> {
        match self.form {
            Form::Binary | Form::Packed => Box::new(BinaryScanner::new()),
            Form::Xml => Box::new(XmlScanner::new()),
            Form::Json => Box::new(JsonScanner::new()),
        }
    }
}

/// A connection while it asks.
struct Session {
    link: Link,
    form: Form,
    decoder: Decoder,
    input: BytesMut,
    last: u64,
}

impl Session {
    fn login(address: &str, form: Form) -> Result<Session, Error> {
        let limits = Limits::default();
        let mut session = Session {
            link: Link::connect(address)?,
            form,
            decoder: match form {
                Form::Binary | Form::Packed => Decoder::Binary(Box::new(BinaryDecoder::for_peer(&limits))),
                Form::Xml | Form::Json => Decoder::new(form, &limits),
            },
            input: BytesMut::new(),
            last: 0,
        };
        if form == Form::Binary {
            session.link.write(&PREFACE)?;
        }
        let login = Parcel::new(Family::Login, "login").context(Path::root());
        session.ask(login.content(Map::new().with("guest", true)))?;
        Ok(session)
    }

    /// Joins the channel of a topic, and what is above it.
    fn join(&mut self, topic: Topic) -> Result<Value, Error> {
        let channel = channel(topic);
        let levels = channel.match_indices('/').skip(1).map(|(end, _)| &channel[..end]);
        let mut joined = Value::Null;
        for level in levels.chain([channel]) {
            joined = self.ask(Parcel::new(Family::Context, "join").context(path(level)?))?;
        }
        Ok(joined)
    }

    /// Sends a request and waits for the reply to it.
    fn ask(&mut self, request: Parcel) -> Result<Value, Error> {
        self.last += 1;
        let request = request.id(self.last);
        let what = || format!("{} of {}", request.name(), request.family.word());
        let sent = self.form.encode(&request).map_err(Error::hub("a request"))?;
        self.link.write(&sent.to_vec())?;
        loop {
            match self.decoder.decode(&mut self.input).map_err(Error::hub(what()))? {
                Some(Frame::Parcel(parcel)) => match parcel.family {
                    Family::Error => {
                        let error = WireError::from_parcel(&parcel);
                        return Err(Error::Hub { what: what(), error });
                    }
                    Family::Reply if parcel.reference == request.id => return Ok(parcel.value()),
                    _ => {}
                },
                Some(Frame::Malformed { error, .. }) => return Err(Error::Hub { what: what(), error }),
                None => {
                    self.link.receive()?;
                    self.input.extend_from_slice(&self.link.received);
                    self.link.received.clear();
                }
            }
        }
    }
}

fn path(text: &str) -> Result<Path, Error> {
    Path::parse(text).map_err(Error::hub("a path of the configuration"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::driver::Scan;

    fn driver(form: Form) -> MomDriver {
        let channels = Topic::ALL.map(|topic| (path(channel(topic)).unwrap(), ContextNumber(2)));
        MomDriver {
            address: "127.0.0.1:1".to_owned(),
            form,
            channels: channels.to_vec(),
        }
    }

    /// What the hub makes of a template with this number, or any other parcel.
    fn frame(form: Form, parcel: &Parcel) -> Vec<u8> {
        form.encode(parcel).unwrap().to_vec()
    }

    fn delivered(form: Form, payload: usize, number: u32) -> Parcel {
        let mut text = Vec::new();
        Template::around(&[], payload, &[]).append(number, &mut text);
        let content = match form {
            Form::Binary | Form::Packed => Value::Binary(text.into()),
            Form::Xml | Form::Json => Value::from(String::from_utf8(text).unwrap()),
        };
        let mut parcel = driver(form).message(Topic::Forth, content);
        parcel.context = Some(Path::parse("/bench").unwrap());
        parcel.sender = Some("peer~2".into());
        parcel.received = parcel.timestamp;
        parcel.age = Some(0);
        parcel
    }

    #[test]
    fn messages_are_found_by_number() {
        for form in Form::ALL {
            for payload in [8, 16, 300, 70_000] {
                let bytes = frame(form, &delivered(form, payload, 77));
                let mut scanner = driver(form).scanner();
                for cut in [1, 5, bytes.len() - 1] {
                    assert_eq!(scanner.scan(&bytes[..cut]).unwrap(), Scan::Incomplete, "{form:?}");
                }
                let more = [&bytes[..], b"next"].concat();
                assert_eq!(scanner.scan(&more).unwrap(), Scan::Parcel(bytes.len(), 77));
            }
        }
    }

    #[test]
    fn chunks_are_joined_while_others_go_between() {
        let large = Form::Binary.encode(&delivered(Form::Binary, 300, 5)).unwrap();
        let small = frame(Form::Binary, &delivered(Form::Binary, 16, 6));
        // The last piece holds only the end of the number.
        for size in [large.len() - 4 - 3, 100, 64] {
            let mut scanner = driver(Form::Binary).scanner();
            let pieces = mom_proto::binary::chunks(&large, 3, size);
            for (index, piece) in pieces.iter().enumerate() {
                let last = index + 1 == pieces.len();
                let expected = match last {
                    true => Scan::Parcel(piece.len(), 5),
                    false => Scan::Other(piece.len()),
                };
                assert_eq!(scanner.scan(piece).unwrap(), expected);
                assert_eq!(scanner.scan(&small).unwrap(), Scan::Parcel(small.len(), 6));
            }
        }
    }

    #[test]
    fn templates_are_what_the_hub_reads() {
        for form in Form::ALL {
            let mut bytes = Vec::new();
            let driver = driver(form);
            driver.template(Message::forth(16)).unwrap().append(5, &mut bytes);
            let parcel = super::super::mom_scan::decode_one(form, &bytes).unwrap();
            let expected = b"........aaaaaaaf";
            match parcel.value() {
                Value::Binary(content) => assert_eq!(content, &expected[..]),
                Value::String(content) => assert_eq!(content.as_bytes(), expected),
                other => panic!("{other:?}"),
            }
            assert_eq!(parcel.echo, Some(false));
        }
    }

    #[test]
    fn images_and_stops_carry_the_time_of_sending() {
        let driver = driver(Form::Binary);
        for topic in [Topic::Image, Topic::Stop] {
            let message = Message {
                topic,
                payload: 16,
                echo: false,
            };
            let template = driver.template(message).unwrap();
            let before = now();
            let mut bytes = Vec::new();
            template.append(5, &mut bytes);
            let parcel = super::super::mom_scan::decode_one(Form::Binary, &bytes).unwrap();
            assert!(parcel.timestamp.unwrap().micros() >= before, "{parcel:?}");
        }
    }

    #[test]
    fn losses_and_strangers_end_the_measurement() {
        for form in Form::ALL {
            let mut scanner = driver(form).scanner();
            let pong = frame(form, &Parcel::new(Family::Time, "ping").id(0));
            assert_eq!(scanner.scan(&pong).unwrap(), Scan::Other(pong.len()));
            let mut halt = Parcel::new(Family::Message, "halt");
            halt.sender = Some("hub".into());
            let halt = frame(form, &halt);
            assert_eq!(scanner.scan(&halt).unwrap(), Scan::Other(halt.len()));
            let dropped = Parcel::new(Family::Event, "dropped").content(Map::new().with("count", 3));
            let dropped = frame(form, &dropped);
            assert_eq!(scanner.scan(&dropped).unwrap(), Scan::Dropped(dropped.len(), 3));
            let told = Map::new().with("reason", "receiver-gone").with("count", 3);
            let gone = frame(form, &Parcel::new(Family::Event, "dropped").content(told));
            assert_eq!(scanner.scan(&gone).unwrap(), Scan::Other(gone.len()));
            let error = WireError::new(mom_proto::Code::NOT_MEMBER, "join first").to_parcel(None);
            let mut unnumbered = delivered(form, 16, 1);
            unnumbered.content = Some("................".into());
            let mut unsent = delivered(form, 16, 1);
            unsent.sender = None;
            for parcel in [error, unnumbered, unsent] {
                let bytes = frame(form, &parcel);
                assert!(driver(form).scanner().scan(&bytes).is_err(), "{parcel:?}");
            }
        }
    }
}
