//! The bytes that carry parcels, whole and in pieces, right and wrong.

use fastrand::Rng;
use mom_proto::binary::ChunkHead;
use mom_proto::codec::Form;
use mom_proto::{Family, Parcel};

/// How a parcel goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// As one frame.
    Whole,
    /// In chunks, some of them empty, with another frame between them.
    Chunked,
    /// In chunks, and then not.
    Aborted,
    /// In chunks without an end.
    Unended,
    /// A chunk that must not come here.
    WrongChunk,
    /// Of a kind that nobody knows.
    Unknown,
    /// As long as nothing.
    Empty,
    /// A right frame in which some bytes are others.
    Changed,
    /// Nothing of the kind.
    Garbage,
    /// What the form forbids.
    Odd,
    /// As far as it goes; then others follow.
    Cut,
}

impl Shape {
    pub(super) const ALL: [Shape; 11] = [
        Shape::Whole,
        Shape::Chunked,
        Shape::Aborted,
        Shape::Unended,
        Shape::WrongChunk,
        Shape::Unknown,
        Shape::Empty,
        Shape::Changed,
        Shape::Garbage,
        Shape::Odd,
        Shape::Cut,
    ];

    /// Those of a form.
    pub(super) fn of(form: Form) -> Vec<Shape> {
        Shape::ALL.into_iter().filter(|shape| shape.is_of(form)).collect()
    }

    /// Whether the form has such frames.
    pub(super) fn is_of(self, form: Form) -> bool {
        let chunks = [
            Shape::Chunked,
            Shape::Aborted,
            Shape::Unended,
            Shape::WrongChunk,
            Shape::Unknown,
        ];
        form.is_binary() || !chunks.contains(&self)
    }
}

/// Bodies of XML that are refused.
const ODD_XML: [&str; 9] = [
    "<!DOCTYPE p [<!ENTITY a \"aaaa\">]><parcel><family>time</family><name>&a;</name></parcel>",
    "<?xml version=\"1.0\"?><!-- x --><parcel/>",
    "<parcel><family>time</family><family>time</family><name>ping</name></parcel>",
    "<parcel><family>time</family><name>ping</name><id> 1</id></parcel>",
    "<parcel a=\"1\" b=\"2\"></parcel>",
    "<parcel><![CDATA[x]]></parcel>",
    "<parcel><family>message</family><name>n</name><content type=\"binary\"><cid>none</cid></content></parcel>",
    "<parcel><family>time</family><name>&#x0;</name></parcel>",
    "",
];

/// Lines of JSON that are refused, or accepted against all expectation.
const ODD_JSON: [&str; 9] = [
    "{}",
    "[1]",
    "{\"family\":\"time\",\"name\":\"ping\",\"id\":1.0}",
    "{\"family\":\"time\",\"family\":\"time\",\"name\":\"ping\"}",
    "{\"family\":\"time\",\"name\":\"\\ud800\"}",
    "{\"family\":\"time\",\"name\":\"ping\",\"content\":{\"$what\":1}}",
    "{\"family\":\"time\",\"name\":\"ping\",\"content\":{\"$int\":\"99999999999999999999\"}}",
    "{\"family\":\"time\",\"name\":\"ping\",\"content\":1e999}",
    "\u{feff}{}",
];

/// The bytes of one frame in this shape.
pub(super) fn shaped(rng: &mut Rng, form: Form, shape: Shape, frame: Vec<u8>) -> Vec<u8> {
    match shape {
        Shape::Whole => frame,
        Shape::Chunked => chunks(rng, &frame, End::Last),
        Shape::Unended => chunks(rng, &frame, End::None),
        Shape::Aborted => chunks(rng, &frame, End::Abort),
        Shape::WrongChunk => {
            let head = match rng.u8(..4) {
                0 => ChunkHead::abort(77),
                1 => ChunkHead::new(78, None, true, 0),
                2 => ChunkHead::new(79, Some(0), true, 0),
                _ => ChunkHead::new(80, Some(usize::MAX >> 8), false, 0),
            };
            head.bytes().to_vec()
        }
        Shape::Unknown => {
            let kind = rng.u8(2..);
            [&[0, 0, 0, 5, kind, 1, 2, 3, 4][..], &frame].concat()
        }
        Shape::Empty => match form {
            Form::Xml => b"\r\n\r\n".to_vec(),
            Form::Json => b"\n\r\n".to_vec(),
            Form::Binary | Form::Packed => [[0; 4], [0, 0, 0, 1]].concat(),
        },
        Shape::Changed => {
            let mut changed = frame;
            for _ in 0..rng.usize(1..4) {
                let at = rng.usize(..changed.len());
                changed[at] = rng.u8(..);
            }
            changed
        }
        Shape::Garbage => (0..rng.usize(1..2000)).map(|_| rng.u8(..)).collect(),
        Shape::Odd => odd(rng, form),
        Shape::Cut => {
            let cut = rng.usize(..frame.len());
            frame[..cut].to_vec()
        }
    }
}

fn odd(rng: &mut Rng, form: Form) -> Vec<u8> {
    match form {
        Form::Xml => {
            let body = ODD_XML[rng.usize(..ODD_XML.len())];
            let kind = ["application/xml", "multipart/related; boundary=b", "text/html"][rng.usize(..3)];
            format!(
                "Content-Type: {kind}\r\nContent-Length: {}\r\n\r\n{body}",
                body.len()
            )
            .into_bytes()
        }
        Form::Json => format!("{}\n", ODD_JSON[rng.usize(..ODD_JSON.len())]).into_bytes(),
        // A parcel with all bits of presence, and what is not a slot behind them.
        Form::Binary | Form::Packed => {
            let count = rng.u8(1..64);
            let mut frame = vec![0, 0, 0, count, 0];
            frame.extend((1..count).map(|_| rng.u8(..)));
            frame
        }
    }
}

/// A frame in chunks, in one of two streams: the other one begins within it.
fn chunks(rng: &mut Rng, frame: &[u8], end: End) -> Vec<u8> {
    let (stream, other) = (rng.u64(1..1 << 20), rng.u64(1 << 20..1 << 21));
    let payload = frame.get(4..).unwrap_or_default();
    let piece = (payload.len() / rng.usize(1..9)).max(1);
    let mut bytes = Vec::with_capacity(frame.len() + 256);
    bytes.extend_from_slice(ChunkHead::new(stream, Some(payload.len()), false, 0).bytes());
    let ping = Form::Binary.encode(&Parcel::new(Family::Time, "ping"));
    let ping = ping.map(|ping| ping.to_vec().split_off(4)).unwrap_or_default();
    bytes.extend_from_slice(ChunkHead::new(other, Some(ping.len()), false, ping.len()).bytes());
    bytes.extend_from_slice(&ping);
    let count = payload.len().div_ceil(piece);
    // Without an end, the last piece is left out.
    let count = if end == End::Last {
        count
    } else {
        count.saturating_sub(1)
    };
    for piece in payload.chunks(piece).take(count) {
        bytes.extend_from_slice(ChunkHead::new(stream, None, false, piece.len()).bytes());
        bytes.extend_from_slice(piece);
    }
    for stream in [other, stream] {
        match end {
            End::Last => bytes.extend_from_slice(ChunkHead::new(stream, None, true, 0).bytes()),
            End::Abort => bytes.extend_from_slice(ChunkHead::abort(stream).bytes()),
            End::None => {}
        }
    }
    bytes
}

/// How streams of chunks end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Last,
    Abort,
    None,
}
