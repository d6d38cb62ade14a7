//! One parcel in the wire forms that its receivers need.

use std::sync::Arc;

use bytes::Bytes;
use mom_proto::codec::{Encoded, Form, Scratch};
use mom_proto::{Code, Content, HARD_DEPTH, Limit, Parcel, WireError, binary};
use mom_system::Workers;

use crate::traffic::later_frame::LaterFrame;
use crate::traffic::memory::Account;
use crate::traffic::replay::Replay;

/// A larger parcel is written in another form outside the channel's critical section, when its first receiver comes to it.
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
    /// In the binary form, as almost all is.
    binary: Option<Encoded>,
    xml: OtherForm,
    json: OtherForm,
    /// In the binary form, decompressed.
    unpacked: OtherForm,
    /// In the binary form, compressed.
    packed: OtherForm,
    local: Option<Arc<Parcel>>,
    replay: Option<Arc<Replay>>,
    /// Its word in the checksum of a link.
    checksum_word: u32,
}

/// A parcel in another form than it came in.
#[derive(Clone, Debug, Default)]
enum OtherForm {
    /// Nobody needs it.
    #[default]
    None,
    Written(Box<Encoded>),
    /// Its content is not a value, or too large in this form.
    Bad,
    Later(Arc<LaterFrame>),
}

/// What is there for a receiver.
enum Found<'a> {
    Nothing,
    Frames(&'a Encoded),
    Bad,
    Later(&'a Arc<LaterFrame>),
}

/// What has to be done before a packet can leave.
#[derive(Debug)]
pub(crate) enum Unready {
    /// It has to be written in another form.
    Later(Arc<LaterFrame>),
    /// It stands for others, the next of which have to take its place.
    Replay(Arc<Replay>),
    /// It was made for receivers of other forms, before this one has come back and speaks another.
    Foreign,
}

impl Bounds {
    /// A parcel in a form that it has to be opened for; none if it is not a value, or too large in this form.
    pub(crate) fn write(&self, form: Form, parcel: &Parcel) -> Option<Encoded> {
        let written = form.encode_within(parcel, self.depth, self.parcel).ok()?;
        // The text forms have kept to the limit. Here it is of what follows the length.
        let fits = !form.is_binary() || self.parcel.allows(written.len().saturating_sub(4));
        fits.then_some(written)
    }
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
        let mut encodings = Encodings {
            checksum_word: parcel.checksum_word(),
            ..Encodings::default()
        };
        let mut local = false;
        let is_packed = matches!(parcel.content, Some(Content::Packed(_)));
        for form in forms {
            let form = match form {
                None => {
                    local = true;
                    continue;
                }
                // Little is not worth a second encoding.
                Some(Form::Packed) if !is_packed && !is_worth_packing(&parcel) => Form::Binary,
                Some(form) => form,
            };
            if encodings.has(form) {
                continue;
            }
            match form {
                Form::Binary if !is_packed => {
                    let binary = form.encode_with(&parcel, &mut self.scratch)?;
                    encodings.binary = Some(self.within_limit(binary)?);
                }
                Form::Packed if is_packed => {
                    let packed = form.encode_with(&parcel, &mut self.scratch)?;
                    encodings.packed = OtherForm::Written(Box::new(self.within_limit(packed)?));
                }
                form => *encodings.place(form) = self.other_form(form, &parcel),
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

    fn other_form(&self, form: Form, parcel: &Parcel) -> OtherForm {
        let size = parcel.size();
        if size > INLINE {
            let workers = Arc::clone(&self.workers);
            let later = LaterFrame::new(form, parcel.clone(), size, self.bounds, workers);
            return OtherForm::Later(Arc::new(later));
        }
        match self.bounds.write(form, parcel) {
            Some(written) => OtherForm::Written(Box::new(written)),
            None => OtherForm::Bad,
        }
    }
}

/// Whether the hub itself compresses it: not in the channel's critical section, so only what is worth a thread's time.
fn is_worth_packing(parcel: &Parcel) -> bool {
    parcel.may_be_packed() && parcel.size() > INLINE
}

impl Encodings {
    /// Encodes what the hub itself says.
    pub(crate) fn new(
        parcel: Parcel,
        forms: impl Iterator<Item = Option<Form>>,
    ) -> Result<Encodings, WireError> {
        let mut encodings = Encodings {
            checksum_word: parcel.checksum_word(),
            ..Encodings::default()
        };
        let mut local = false;
        for form in forms {
            let form = match form {
                None => {
                    local = true;
                    continue;
                }
                // Only messages are worth it.
                Some(Form::Packed) => Form::Binary,
                Some(form) => form,
            };
            if encodings.has(form) {
                continue;
            }
            let written = form.encode_within(&parcel, HARD_DEPTH, Limit::Unlimited)?;
            match form {
                Form::Binary => encodings.binary = Some(written),
                form => *encodings.place(form) = OtherForm::Written(Box::new(written)),
            }
        }
        encodings.local = local.then(|| Arc::new(parcel));
        Ok(encodings)
    }

    /// Frames of the binary form that are encoded already.
    pub(crate) fn of_run(frames: Encoded) -> Encodings {
        Encodings {
            checksum_word: binary::checksum_word(&frames.head),
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

    /// [`Parcel::checksum_word`] of it, or of the first of a run.
    pub(crate) fn checksum_word(&self) -> u32 {
        self.checksum_word
    }

    fn other(&self, form: Form) -> &OtherForm {
        match form {
            Form::Xml => &self.xml,
            Form::Json => &self.json,
            Form::Binary => &self.unpacked,
            Form::Packed => &self.packed,
        }
    }

    fn place(&mut self, form: Form) -> &mut OtherForm {
        match form {
            Form::Xml => &mut self.xml,
            Form::Json => &mut self.json,
            Form::Binary => &mut self.unpacked,
            Form::Packed => &mut self.packed,
        }
    }

    /// Whether it is encoded in just this form, or failed to be.
    fn has(&self, form: Form) -> bool {
        (form == Form::Binary && self.binary.is_some()) || !matches!(self.other(form), OtherForm::None)
    }

    /// What a receiver of this form gets.
    fn find(&self, form: Form) -> Found<'_> {
        match (self.other(form), form) {
            (OtherForm::Written(written), _) => Found::Frames(written),
            (OtherForm::Bad, _) => Found::Bad,
            (OtherForm::Later(later), _) => Found::Later(later),
            (OtherForm::None, Form::Binary) => self.binary.as_ref().map_or(Found::Nothing, Found::Frames),
            (OtherForm::None, Form::Packed) => self.find(Form::Binary),
            (OtherForm::None, Form::Xml | Form::Json) => Found::Nothing,
        }
    }

    /// The frames for a receiver of this form, none inside this process or while they are not ready.
    pub(crate) fn frames(&self, form: Option<Form>) -> Option<&Encoded> {
        match self.find(form?) {
            Found::Frames(frames) => Some(frames),
            Found::Later(later) => later.written()?,
            Found::Nothing | Found::Bad => None,
        }
    }

    /// What has to be done before it can leave in this form.
    pub(crate) fn unready(&self, form: Option<Form>) -> Option<Unready> {
        if let Some(replay) = &self.replay {
            return Some(Unready::Replay(Arc::clone(replay)));
        }
        match self.find(form?) {
            Found::Later(later) if later.written().is_none() => Some(Unready::Later(Arc::clone(later))),
            Found::Nothing => Some(Unready::Foreign),
            Found::Frames(_) | Found::Bad | Found::Later(_) => None,
        }
    }

    /// Whether it can never leave in this form.
    pub(crate) fn is_bad(&self, form: Option<Form>) -> bool {
        match form.map(|form| self.find(form)) {
            Some(Found::Bad) => true,
            Some(Found::Later(later)) => matches!(later.written(), Some(None)),
            Some(Found::Nothing | Found::Frames(_)) | None => false,
        }
    }

    /// The memory that it takes, however many share it.
    pub(crate) fn memory(&self) -> usize {
        let binary = self.binary.as_ref().map_or(0, Encoded::len);
        let local = self.local.as_ref().map_or(0, |parcel| SLOTS + parcel.size());
        // What is kept is charged where it is kept.
        let replay = self.replay.as_ref().map_or(0, |replay| replay.charge());
        let others = [&self.xml, &self.json, &self.unpacked, &self.packed];
        others.iter().map(|other| other.size()).sum::<usize>() + binary + local + replay
    }

    /// Charges there what is written later, beside [`Encodings::memory`].
    pub(crate) fn charge_to(&self, account: &Arc<Account>) {
        for other in [&self.xml, &self.json, &self.unpacked, &self.packed] {
            if let OtherForm::Later(later) = other {
                later.charge_to(account);
            }
        }
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
        for form in [Form::Packed, Form::Binary, Form::Xml, Form::Json] {
            match self.other(form) {
                OtherForm::Written(written) => return form.read(&written.to_vec()),
                OtherForm::Later(later) => return Ok(vec![later.parcel().clone()]),
                OtherForm::None | OtherForm::Bad => {}
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
        match form.map(|form| self.find(form)) {
            None => SLOTS + self.local.as_ref().map_or(0, |parcel| parcel.size()),
            Some(Found::Frames(frames)) => frames.len(),
            Some(Found::Later(later)) => SLOTS + later.size(),
            Some(Found::Bad) => 0,
            Some(Found::Nothing) => self.memory(),
        }
    }
}

impl OtherForm {
    /// What it is charged, the same before and after it is written.
    fn size(&self) -> usize {
        match self {
            OtherForm::None | OtherForm::Bad => 0,
            OtherForm::Written(written) => written.len(),
            OtherForm::Later(later) => SLOTS + later.size(),
        }
    }
}
