//! One parcel in the wire forms that its receivers need.

use std::sync::Arc;

use mom_proto::codec::{Encoded, Form, Scratch};
use mom_proto::{Code, HARD_DEPTH, Limit, Parcel, WireError, xml};
use mom_system::Workers;

use crate::traffic::later_xml::LaterXml;
use crate::traffic::replay::Replay;

/// A larger parcel is written in XML outside the channel's critical section, when its first receiver comes to it.
const INLINE: usize = 4 * 1024;

/// What a parcel may become on its way to a receiver.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// How deep content may nest that has to be opened.
    pub(crate) depth: usize,
    /// The size of a parcel that receivers were promised.
    pub(crate) parcel: Limit,
}

/// What encodes the parcels of one channel.
#[derive(Debug)]
pub(crate) struct Encoder {
    bounds: Bounds,
    workers: Arc<Workers>,
    scratch: Scratch,
}

/// A parcel encoded once for each form among its receivers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Encodings {
    xml: Xml,
    binary: Option<Encoded>,
    local: Option<Arc<Parcel>>,
    replay: Option<Arc<Replay>>,
}

/// The XML form of a parcel.
#[derive(Clone, Debug, Default)]
enum Xml {
    /// Nobody needs it.
    #[default]
    None,
    Written(Encoded),
    /// Its content is no value, or too large as XML.
    Bad,
    Later(Arc<LaterXml>),
}

/// What has to be done before a packet can leave.
#[derive(Debug)]
pub(crate) enum Unready {
    /// It has to be written in XML.
    Xml(Arc<LaterXml>),
    /// It stands for others, the next of which have to take its place.
    Replay(Arc<Replay>),
}

impl Encoder {
    pub(crate) fn new(bounds: Bounds, workers: Arc<Workers>) -> Encoder {
        Encoder {
            bounds,
            workers,
            scratch: Scratch::pooled(),
        }
    }

    /// One for another thread, with memory of its own.
    pub(crate) fn another(&self) -> Encoder {
        Encoder {
            bounds: self.bounds,
            workers: Arc::clone(&self.workers),
            scratch: Scratch::default(),
        }
    }

    /// Whether receivers take a frame of this size.
    pub(crate) fn allows(&self, size: usize) -> bool {
        self.bounds.parcel.allows(size)
    }

    /// Encodes what a peer says. What cannot be written in XML fails for receivers of that form alone.
    ///
    /// # Errors
    /// `too-long` for what came within the limit of a parcel and, with what the hub adds, is beyond it: its receivers
    /// would close.
    pub(crate) fn encode(
        &mut self,
        parcel: Parcel,
        forms: impl Iterator<Item = Option<Form>>,
    ) -> Result<Encodings, WireError> {
        let mut encodings = Encodings::default();
        let mut local = false;
        for form in forms {
            match form {
                None => local = true,
                Some(Form::Xml) if matches!(encodings.xml, Xml::None) => encodings.xml = self.xml(&parcel),
                Some(Form::Binary) if encodings.binary.is_none() => {
                    let binary = Form::Binary.encode_with(&parcel, &mut self.scratch)?;
                    encodings.binary = Some(self.within_limit(binary)?);
                }
                Some(_) => {}
            }
        }
        encodings.local = local.then(|| Arc::new(parcel));
        Ok(encodings)
    }

    fn within_limit(&self, binary: Encoded) -> Result<Encoded, WireError> {
        // The limit is of what follows the length.
        let (size, most) = (binary.len().saturating_sub(4), self.bounds.parcel);
        if most.allows(size) {
            return Ok(binary);
        }
        let text = format!(
            "with the hub's stamps the message has {size} bytes, and its receivers take {most}; send {} less",
            size - most.get()
        );
        Err(WireError::new(Code::TOO_LONG, text))
    }

    fn xml(&self, parcel: &Parcel) -> Xml {
        let size = parcel.size();
        if size > INLINE {
            let workers = Arc::clone(&self.workers);
            return Xml::Later(Arc::new(LaterXml::new(
                parcel.clone(),
                size,
                self.bounds,
                workers,
            )));
        }
        match xml::encode_within(parcel, self.bounds.depth, self.bounds.parcel) {
            Ok(written) => Xml::Written(written),
            Err(_) => Xml::Bad,
        }
    }
}

impl Encodings {
    /// Encodes what the hub itself says.
    pub(crate) fn new(
        parcel: Parcel,
        forms: impl Iterator<Item = Option<Form>>,
    ) -> Result<Encodings, WireError> {
        let mut encodings = Encodings::default();
        let mut local = false;
        for form in forms {
            match form {
                None => local = true,
                Some(Form::Xml) if matches!(encodings.xml, Xml::None) => {
                    let written = xml::encode_within(&parcel, HARD_DEPTH, Limit::Unlimited)?;
                    encodings.xml = Xml::Written(written);
                }
                Some(Form::Binary) if encodings.binary.is_none() => {
                    encodings.binary = Some(Form::Binary.encode(&parcel)?);
                }
                Some(_) => {}
            }
        }
        encodings.local = local.then(|| Arc::new(parcel));
        Ok(encodings)
    }

    /// Frames of the binary form that are encoded already.
    pub(crate) fn of_run(frames: Encoded) -> Encodings {
        Encodings {
            binary: Some(frames),
            ..Encodings::default()
        }
    }

    /// What stands for messages that are kept.
    pub(crate) fn of_replay(replay: Replay) -> Encodings {
        Encodings {
            replay: Some(Arc::new(replay)),
            ..Encodings::default()
        }
    }

    /// The frames for a receiver of this form, none inside this process or while they are not ready.
    pub(crate) fn frames(&self, form: Option<Form>) -> Option<&Encoded> {
        match (form?, &self.xml) {
            (Form::Binary, _) => self.binary.as_ref(),
            (Form::Xml, Xml::Written(written)) => Some(written),
            (Form::Xml, Xml::Later(later)) => later.written()?,
            (Form::Xml, Xml::None | Xml::Bad) => None,
        }
    }

    /// What has to be done before it can leave in this form.
    pub(crate) fn unready(&self, form: Option<Form>) -> Option<Unready> {
        match (&self.replay, form, &self.xml) {
            (Some(replay), ..) => Some(Unready::Replay(Arc::clone(replay))),
            (None, Some(Form::Xml), Xml::Later(later)) if later.written().is_none() => {
                Some(Unready::Xml(Arc::clone(later)))
            }
            _ => None,
        }
    }

    /// Whether it can never leave in this form.
    pub(crate) fn is_bad(&self, form: Option<Form>) -> bool {
        form == Some(Form::Xml)
            && match &self.xml {
                Xml::Bad => true,
                Xml::Later(later) => matches!(later.written(), Some(None)),
                Xml::None | Xml::Written(_) => false,
            }
    }

    /// The memory that it takes, however many share it.
    pub(crate) fn memory(&self) -> usize {
        const SLOTS: usize = 256;
        let xml = match &self.xml {
            Xml::None | Xml::Bad => 0,
            Xml::Written(written) => written.len(),
            Xml::Later(later) => SLOTS + later.size(),
        };
        let binary = self.binary.as_ref().map_or(0, Encoded::len);
        let local = self.local.as_ref().map_or(0, |parcel| SLOTS + parcel.size());
        // What is kept is charged where it is kept.
        let replay = self.replay.as_ref().map_or(0, |replay| replay.charge());
        xml + binary + local + replay
    }

    /// The parcel for a receiver inside this process.
    pub(crate) fn local(&self) -> Option<&Arc<Parcel>> {
        self.local.as_ref()
    }

    /// What a receiver of this form is charged, the same from the first moment to the last. Inside this process parcels
    /// are shared with all others, but the bound has to be a bound.
    pub(crate) fn charge(&self, form: Option<Form>) -> usize {
        const SLOTS: usize = 256;
        match (form, &self.xml, &self.replay) {
            (_, _, Some(replay)) => replay.charge(),
            (Some(Form::Xml), Xml::Later(later), _) => SLOTS + later.size(),
            (Some(Form::Xml), Xml::Written(written), _) => written.len(),
            (Some(Form::Binary), ..) => self.binary.as_ref().map_or(0, Encoded::len),
            (None, ..) => SLOTS + self.local.as_ref().map_or(0, |parcel| parcel.size()),
            (Some(Form::Xml), Xml::None | Xml::Bad, _) => 0,
        }
    }
}
