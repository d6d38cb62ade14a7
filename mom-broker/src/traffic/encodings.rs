//! One parcel in the wire forms that its receivers need.

use std::sync::Arc;

use bytes::Bytes;
use mom_proto::codec::{Encoded, Form, Scratch};
use mom_proto::{Code, HARD_DEPTH, Limit, Parcel, WireError, binary};
use mom_system::Workers;

use crate::traffic::later_text::LaterText;
use crate::traffic::replay::Replay;

/// A larger parcel is written as text outside the channel's critical section, when its first receiver comes to it.
const INLINE: usize = 4 * 1024;
/// What the slots of a parcel in memory are charged.
const SLOTS: usize = 256;

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
    xml: Text,
    json: Text,
    binary: Option<Encoded>,
    local: Option<Arc<Parcel>>,
    replay: Option<Arc<Replay>>,
}

/// A parcel in one of the text forms.
#[derive(Clone, Debug, Default)]
enum Text {
    /// Nobody needs it.
    #[default]
    None,
    Written(Encoded),
    /// Its content is no value, or too large in this form.
    Bad,
    Later(Arc<LaterText>),
}

/// What has to be done before a packet can leave.
#[derive(Debug)]
pub(crate) enum Unready {
    /// It has to be written in a text form.
    Text(Arc<LaterText>),
    /// It stands for others, the next of which have to take its place.
    Replay(Arc<Replay>),
    /// It was made for receivers of other forms, before this one has come back and speaks another.
    Foreign,
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

    /// Encodes what a peer says. What cannot be written in a text form fails for receivers of that form alone.
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
                Some(form) if encodings.holds(form) => {}
                Some(form) => match encodings.text_mut(form) {
                    Some(text) => *text = self.text(form, &parcel),
                    None => {
                        let binary = form.encode_with(&parcel, &mut self.scratch)?;
                        encodings.binary = Some(self.within_limit(binary)?);
                    }
                },
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

    fn text(&self, form: Form, parcel: &Parcel) -> Text {
        let size = parcel.size();
        if size > INLINE {
            let workers = Arc::clone(&self.workers);
            let later = LaterText::new(form, parcel.clone(), size, self.bounds, workers);
            return Text::Later(Arc::new(later));
        }
        match form.encode_within(parcel, self.bounds.depth, self.bounds.parcel) {
            Ok(written) => Text::Written(written),
            Err(_) => Text::Bad,
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
                Some(form) if encodings.holds(form) => {}
                Some(form) => {
                    let written = form.encode_within(&parcel, HARD_DEPTH, Limit::Unlimited)?;
                    match encodings.text_mut(form) {
                        Some(text) => *text = Text::Written(written),
                        None => encodings.binary = Some(written),
                    }
                }
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

    /// What is left of a run after so many bytes, and how many parcels that are.
    pub(crate) fn rest_of_run(&self, sent: usize) -> (Encodings, u32) {
        let head = self
            .binary
            .as_ref()
            .map(|frames| frames.head.clone())
            .unwrap_or_default();
        let head = head.slice(sent.min(head.len())..);
        let count = binary::cut(&head, head.len()).1;
        let rest = Encoded {
            head,
            body: Bytes::new(),
        };
        (Encodings::of_run(rest), count)
    }

    /// What stands for messages that are kept.
    pub(crate) fn of_replay(replay: Replay) -> Encodings {
        Encodings {
            replay: Some(Arc::new(replay)),
            ..Encodings::default()
        }
    }

    /// The place of this form, none if it is the binary one.
    fn text(&self, form: Form) -> Option<&Text> {
        match form {
            Form::Xml => Some(&self.xml),
            Form::Json => Some(&self.json),
            Form::Binary => None,
        }
    }

    fn text_mut(&mut self, form: Form) -> Option<&mut Text> {
        match form {
            Form::Xml => Some(&mut self.xml),
            Form::Json => Some(&mut self.json),
            Form::Binary => None,
        }
    }

    /// Whether it is encoded in this form, or failed to be.
    fn holds(&self, form: Form) -> bool {
        match self.text(form) {
            Some(text) => !matches!(text, Text::None),
            None => self.binary.is_some(),
        }
    }

    /// The frames for a receiver of this form, none inside this process or while they are not ready.
    pub(crate) fn frames(&self, form: Option<Form>) -> Option<&Encoded> {
        match self.text(form?) {
            None => self.binary.as_ref(),
            Some(Text::Written(written)) => Some(written),
            Some(Text::Later(later)) => later.written()?,
            Some(Text::None | Text::Bad) => None,
        }
    }

    /// What has to be done before it can leave in this form.
    pub(crate) fn unready(&self, form: Option<Form>) -> Option<Unready> {
        if let Some(replay) = &self.replay {
            return Some(Unready::Replay(Arc::clone(replay)));
        }
        match self.text(form?) {
            Some(Text::Later(later)) if later.written().is_none() => Some(Unready::Text(Arc::clone(later))),
            Some(Text::None) => Some(Unready::Foreign),
            None if self.binary.is_none() => Some(Unready::Foreign),
            _ => None,
        }
    }

    /// Whether it can never leave in this form.
    pub(crate) fn is_bad(&self, form: Option<Form>) -> bool {
        match form.and_then(|form| self.text(form)) {
            Some(Text::Bad) => true,
            Some(Text::Later(later)) => matches!(later.written(), Some(None)),
            Some(Text::None | Text::Written(_)) | None => false,
        }
    }

    /// The memory that it takes, however many share it.
    pub(crate) fn memory(&self) -> usize {
        let binary = self.binary.as_ref().map_or(0, Encoded::len);
        let local = self.local.as_ref().map_or(0, |parcel| SLOTS + parcel.size());
        // What is kept is charged where it is kept.
        let replay = self.replay.as_ref().map_or(0, |replay| replay.charge());
        self.xml.size() + self.json.size() + binary + local + replay
    }

    /// The parcels in it, read again from whatever form they are in.
    ///
    /// # Errors
    /// What no form can hold.
    pub(crate) fn parcels(&self) -> Result<Vec<Parcel>, WireError> {
        if let Some(parcel) = &self.local {
            return Ok(vec![(**parcel).clone()]);
        }
        if let Some(frames) = &self.binary {
            return Form::Binary.read(&frames.to_vec());
        }
        for (form, text) in [(Form::Xml, &self.xml), (Form::Json, &self.json)] {
            match text {
                Text::Written(written) => return form.read(&written.to_vec()),
                Text::Later(later) => return Ok(vec![later.parcel().clone()]),
                Text::None | Text::Bad => {}
            }
        }
        Ok(Vec::new())
    }

    /// The parcel for a receiver inside this process.
    pub(crate) fn local(&self) -> Option<&Arc<Parcel>> {
        self.local.as_ref()
    }

    /// What a receiver of this form is charged, the same from the first moment to the last. Inside this process parcels
    /// are shared with all others, but the bound has to be a bound.
    pub(crate) fn charge(&self, form: Option<Form>) -> usize {
        if let Some(replay) = &self.replay {
            return replay.charge();
        }
        match form.map(|form| self.text(form)) {
            None => SLOTS + self.local.as_ref().map_or(0, |parcel| parcel.size()),
            Some(None) if self.binary.is_none() => self.memory(),
            Some(None) => self.binary.as_ref().map_or(0, Encoded::len),
            Some(Some(Text::None)) => self.memory(),
            Some(Some(text)) => text.size(),
        }
    }
}

impl Text {
    /// What it is charged, the same before and after it is written.
    fn size(&self) -> usize {
        match self {
            Text::None | Text::Bad => 0,
            Text::Written(written) => written.len(),
            Text::Later(later) => SLOTS + later.size(),
        }
    }
}
