//! What the codecs read and write, in memory, on one thread.

use bytes::{Bytes, BytesMut};
use mom_proto::binary::PREFACE;
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::{ContextNumber, Family, Limits, Parcel, Path, Time, Value, WireError};

/// The sizes of binary content that are measured.
pub const SIZES: [usize; 4] = [16, 300, 1024, 64 * 1024];

/// One parcel with binary content, as a hub hands it on: sender, stamps, context.
///
/// ```
/// use mom_benches::codecs::Coding;
/// use mom_proto::codec::Form;
/// let mut coding = Coding::new(Form::Binary, 16)?;
/// assert_eq!(coding.encode()?, coding.size());
/// assert_eq!(coding.decode_many()? % coding.size(), 0);
/// # Ok::<(), mom_proto::WireError>(())
/// ```
pub struct Coding {
    form: Form,
    parcel: Parcel,
    size: usize,
    /// Frames one after the other, as they come from a socket.
    many: Vec<u8>,
    input: BytesMut,
    decoder: Decoder,
}

/// Bytes that a broker reads at once.
const CHUNK: usize = 64 * 1024;

impl Coding {
    /// A parcel with content of so many bytes.
    ///
    /// # Errors
    /// Not for sizes that a parcel can have.
    pub fn new(form: Form, content: usize) -> Result<Coding, WireError> {
        let mut parcel = Parcel::new(Family::Message, "state")
            .context(Path::parse("/robot/arm")?)
            .id(1_234_567)
            .content(Value::Binary(Bytes::from(vec![0xa5; content])));
        parcel.number = Some(ContextNumber(3));
        parcel.sender = Some("arm".into());
        parcel.timestamp = Time::from_micros(1_795_255_200_000_123);
        parcel.received = Time::from_micros(1_795_255_200_000_456);
        parcel.age = Some(333);
        let frame = form.encode(&parcel)?.to_vec();
        let mut decoder = Decoder::new(form, &Limits::default());
        if form == Form::Binary {
            decoder.decode(&mut BytesMut::from(&PREFACE[..]))?;
        }
        Ok(Coding {
            form,
            parcel,
            size: frame.len(),
            many: frame.repeat((CHUNK / frame.len()).max(1)),
            input: BytesMut::new(),
            decoder,
        })
    }

    /// Bytes of the parcel on the wire.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Encodes it once from its value; gives the bytes written.
    ///
    /// # Errors
    /// As [`Form::encode`].
    pub fn encode(&self) -> Result<usize, WireError> {
        let encoded = self.form.encode(std::hint::black_box(&self.parcel))?;
        Ok(std::hint::black_box(encoded).len())
    }

    /// Decodes as many as come from a socket at once, content unopened where the form allows; gives the bytes
    /// read. The copy into the input is measured too, as a socket makes it.
    ///
    /// # Errors
    /// A frame that is not read back.
    pub fn decode_many(&mut self) -> Result<usize, WireError> {
        self.input.extend_from_slice(&self.many);
        for _ in 0..self.many.len() / self.size {
            match self.decoder.decode(&mut self.input)? {
                Some(Frame::Parcel(parcel)) => drop(std::hint::black_box(parcel)),
                Some(Frame::Malformed { error, .. }) => return Err(error),
                None => {
                    let text = "a frame that is not whole";
                    return Err(WireError::new(mom_proto::Code::BAD_FRAME, text));
                }
            }
        }
        Ok(self.many.len())
    }
}
