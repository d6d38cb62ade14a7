//! One parcel in the wire forms that its receivers need.

use std::sync::Arc;

use mom_proto::codec::{Encoded, Form, Scratch};
use mom_proto::{Code, Content, HARD_DEPTH, Limit, Parcel, WireError, msgpack};

/// What a parcel may become for a receiver of another form.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bounds {
    /// How deep content may nest that has to be opened.
    pub(crate) depth: usize,
    /// The size of a parcel that receivers were promised.
    pub(crate) parcel: Limit,
}

/// A parcel encoded once for each form among its receivers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Encodings {
    xml: Option<Encoded>,
    binary: Option<Encoded>,
    local: Option<Arc<Parcel>>,
}

impl Encodings {
    /// Encodes what the hub itself says.
    pub(crate) fn new(
        parcel: Parcel,
        forms: impl Iterator<Item = Option<Form>>,
    ) -> Result<Encodings, WireError> {
        let bounds = Bounds {
            depth: HARD_DEPTH,
            parcel: Limit::Unlimited,
        };
        Encodings::with(parcel, forms, bounds, &mut Scratch::default())
    }

    /// Encodes what a peer says, within the bounds of what receivers take.
    pub(crate) fn with(
        parcel: Parcel,
        forms: impl Iterator<Item = Option<Form>>,
        bounds: Bounds,
        scratch: &mut Scratch,
    ) -> Result<Encodings, WireError> {
        let mut encodings = Encodings::default();
        let mut local = false;
        for form in forms {
            match form {
                None => local = true,
                Some(Form::Xml) if encodings.xml.is_none() => {
                    encodings.xml = Some(encode_xml(&parcel, bounds)?);
                }
                Some(Form::Binary) if encodings.binary.is_none() => {
                    encodings.binary = Some(Form::Binary.encode_with(&parcel, scratch)?);
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

    /// The frames for a receiver of this form, none inside this process.
    pub(crate) fn frames(&self, form: Option<Form>) -> Option<&Encoded> {
        match form? {
            Form::Xml => self.xml.as_ref(),
            Form::Binary => self.binary.as_ref(),
        }
    }

    /// The parcel for a receiver inside this process.
    pub(crate) fn local(&self) -> Option<&Arc<Parcel>> {
        self.local.as_ref()
    }

    /// What a receiver inside this process is charged: shared with all others, but the bound has to be a bound.
    pub(crate) fn local_size(&self) -> usize {
        let content = self.local.as_ref().and_then(|parcel| parcel.content.as_ref());
        256 + content.map_or(0, mom_proto::Content::size)
    }
}

/// Content that is encoded already was looked at by nobody so far.
fn encode_xml(parcel: &Parcel, bounds: Bounds) -> Result<Encoded, WireError> {
    let encoded = match &parcel.content {
        Some(Content::Encoded(bytes)) => {
            let content = Some(Content::Value(msgpack::decode(bytes, bounds.depth)?));
            Form::Xml.encode(&Parcel {
                content,
                ..parcel.clone()
            })
        }
        _ => Form::Xml.encode(parcel),
    }?;
    if bounds.parcel.allows(encoded.len()) {
        return Ok(encoded);
    }
    let text = format!(
        "in XML, which a receiver here speaks, this parcel has {} bytes; the limit is {}",
        encoded.len(),
        bounds.parcel
    );
    Err(WireError::new(Code::NOT_ENCODABLE, text))
}
