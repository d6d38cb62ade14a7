//! Which trace a message is part of (W3C Trace Context).

use crate::{Family, Parcel, Value};

/// The slot that says it, in the form of the header `traceparent`.
pub const TRACE: &str = "trace";

/// The bytes of `00-TRACE-SPAN-FLAGS`; later versions may say more behind it.
const LENGTH: usize = 55;

/// What a message says of its trace. The hub passes the slot on as it came, whatever it says.
///
/// ```
/// use mom_proto::{Family, Parcel, TRACE, TraceParent};
///
/// let mut parcel = Parcel::new(Family::Message, "command");
/// parcel.extra.set(TRACE, "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01");
/// let trace = TraceParent::of(&parcel).unwrap();
/// assert_eq!(trace.trace_id(), "0af7651916cd43dd8448eb211c80319c");
/// assert_eq!((trace.span_id(), trace.is_sampled()), ("b7ad6b7169203331", true));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceParent<'a> {
    text: &'a str,
}

impl<'a> TraceParent<'a> {
    /// That of a message, none without the slot or if it says nothing of the kind.
    pub fn of(parcel: &'a Parcel) -> Option<TraceParent<'a>> {
        if parcel.extra.is_empty() || parcel.family != Family::Message {
            return None;
        }
        parcel
            .extra
            .get(TRACE)
            .and_then(Value::as_str)
            .and_then(TraceParent::read)
    }

    /// Reads a `traceparent`.
    pub fn read(text: &'a str) -> Option<TraceParent<'a>> {
        let bytes = text.as_bytes();
        let hex = |byte: &u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
        let dash = |at: usize| bytes[at] == b'-';
        let right = text.is_ascii()
            && (bytes.len() == LENGTH || (bytes.len() > LENGTH && dash(LENGTH) && &bytes[..2] != b"00"))
            && (dash(2) && dash(35) && dash(52))
            && [&bytes[..2], &bytes[3..35], &bytes[36..52], &bytes[53..55]]
                .iter()
                .all(|part| part.iter().all(hex))
            && &bytes[..2] != b"ff";
        let trace = right.then_some(TraceParent { text })?;
        let is_some = |id: &str| id.bytes().any(|byte| byte != b'0');
        (is_some(trace.trace_id()) && is_some(trace.span_id())).then_some(trace)
    }

    /// The trace, 32 hexadecimal digits.
    pub fn trace_id(&self) -> &'a str {
        &self.text[3..35]
    }

    /// The span of the sender, of which whatever becomes of the message is a part; 16 hexadecimal digits.
    pub fn span_id(&self) -> &'a str {
        &self.text[36..52]
    }

    /// Whether the sender records it.
    pub fn is_sampled(&self) -> bool {
        matches!(
            self.text.as_bytes()[54],
            b'1' | b'3' | b'5' | b'7' | b'9' | b'b' | b'd' | b'f'
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RIGHT: &str = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-00";

    #[test]
    fn what_is_no_traceparent_is_none() {
        assert!(TraceParent::read(RIGHT).is_some_and(|trace| !trace.is_sampled()));
        assert!(TraceParent::read(&format!("01{}-more", &RIGHT[2..])).is_some());
        for bad in [
            "",
            &RIGHT[1..],
            &format!("{RIGHT}-more"),
            &format!("01{}more", &RIGHT[2..]),
            &format!("ff{}", &RIGHT[2..]),
            &RIGHT.to_uppercase(),
            &RIGHT.replace("0af7651916cd43dd8448eb211c80319c", &"0".repeat(32)),
            &RIGHT.replace("b7ad6b7169203331", &"0".repeat(16)),
            &RIGHT.replace('f', "ü"),
            &RIGHT.replace('-', "0"),
        ] {
            assert_eq!(TraceParent::read(bad), None, "{bad}");
        }
    }

    #[test]
    fn only_messages_have_one() {
        let mut parcel = Parcel::new(Family::Event, "x");
        parcel.extra.set(TRACE, RIGHT);
        assert_eq!(TraceParent::of(&parcel), None);
        parcel.family = Family::Message;
        assert!(TraceParent::of(&parcel).is_some());
        parcel.extra.set(TRACE, 1);
        assert_eq!(TraceParent::of(&parcel), None);
    }
}
