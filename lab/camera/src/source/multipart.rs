//! `multipart/x-mixed-replace`, the form in which cameras stream pictures (MJPEG), without IO.
//!
//! What cameras send is seldom quite what RFC 2046 asks for, so this reads what they mean: the boundary quoted or not,
//! with its two dashes or without, parts with a length or without, lines that end with LF alone.

use bytes::{Bytes, BytesMut};
use memchr::{memchr, memmem};

/// The most bytes between two parts, and before the first.
const MOST_BETWEEN: usize = 64 << 10;
/// The most bytes of a part's headers.
const MOST_HEADERS: usize = 8 << 10;
/// The longest boundary; RFC 2046 has 70.
const LONGEST_BOUNDARY: usize = 200;
/// The most bytes after a boundary on its line.
const MOST_AFTER: usize = 64;

/// What is wrong with a stream of parts.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MultipartError {
    /// The content type names no boundary that can be used.
    #[error("the content type names no boundary of 1 to 200 characters")]
    Boundary,
    /// No boundary came.
    #[error("there is no boundary in {MOST_BETWEEN} bytes")]
    Missing,
    /// The headers of a part do not end.
    #[error("the headers of a part are longer than {MOST_HEADERS} bytes")]
    Headers,
    /// The length of a part is not a number.
    #[error("the length of a part is not a number")]
    Length,
    /// A part is larger than allowed.
    #[error("a part is larger than {0} bytes")]
    TooLarge(usize),
}

/// Splits a stream into the bodies of its parts.
///
/// Bytes go in by [`push`](Multipart::push), however they are split; after each, [`next_part`](Multipart::next_part)
/// gives the parts that are complete. It keeps at most the largest part and what was pushed last.
#[derive(Debug)]
pub struct Multipart {
    /// The boundary as the content type has it.
    boundary: Vec<u8>,
    /// The boundary as the stream has it, known from its first line on.
    delimiter: Option<Vec<u8>>,
    largest: usize,
    buffer: BytesMut,
    state: State,
    /// Bytes of the buffer in which the end of a part was looked for already.
    scanned: usize,
    /// Bytes that were left out since the last part.
    skipped: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Before a boundary.
    Between,
    Headers,
    /// In a part, of this length if its headers name one.
    Body(Option<usize>),
    /// After the last boundary.
    Ended,
}

/// What follows a boundary.
enum After {
    /// Another part, whose headers begin after so many bytes.
    Part(usize),
    Last,
    /// It was no boundary.
    None,
    /// More bytes are needed to know.
    Unknown,
}

impl Multipart {
    /// For the boundary that a content type names, and parts of at most `largest` bytes.
    ///
    /// # Errors
    /// [`MultipartError::Boundary`].
    pub fn new(content_type: &str, largest: usize) -> Result<Multipart, MultipartError> {
        let boundary = boundary(content_type).filter(|name| (1..=LONGEST_BOUNDARY).contains(&name.len()));
        Ok(Multipart {
            boundary: boundary.ok_or(MultipartError::Boundary)?.as_bytes().to_vec(),
            delimiter: None,
            largest,
            buffer: BytesMut::new(),
            state: State::Between,
            scanned: 0,
            skipped: 0,
        })
    }

    /// Takes the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.state != State::Ended {
            self.buffer.extend_from_slice(bytes);
        }
    }

    /// Whether the last boundary has come.
    pub fn is_ended(&self) -> bool {
        self.state == State::Ended
    }

    /// The body of the next part, if it is complete.
    ///
    /// # Errors
    /// [`MultipartError`]; the stream cannot be read further then.
    pub fn next_part(&mut self) -> Result<Option<Bytes>, MultipartError> {
        loop {
            let progress = match self.state {
                State::Between => self.find_boundary()?,
                State::Headers => self.read_headers()?,
                State::Body(length) => match self.read_body(length)? {
                    Some(part) => return Ok(Some(part)),
                    None => false,
                },
                State::Ended => false,
            };
            if !progress {
                return Ok(None);
            }
        }
    }

    /// Goes on to the next line; whether the state or the buffer has changed.
    fn find_boundary(&mut self) -> Result<bool, MultipartError> {
        let Some(end) = memchr(b'\n', &self.buffer) else {
            return match self.skipped + self.buffer.len() > MOST_BETWEEN {
                true => Err(MultipartError::Missing),
                false => Ok(false),
            };
        };
        let line = self.buffer.split_to(end + 1);
        self.state = match self.after_line(line.trim_ascii_end()) {
            After::Part(_) => State::Headers,
            After::Last => State::Ended,
            After::None | After::Unknown => State::Between,
        };
        match self.state {
            State::Between => self.skipped += line.len(),
            _ => self.skipped = 0,
        }
        if self.skipped > MOST_BETWEEN {
            return Err(MultipartError::Missing);
        }
        if self.is_ended() {
            self.buffer.clear();
        }
        Ok(true)
    }

    /// What a line between two parts is. The first boundary decides whether the stream writes the dashes.
    fn after_line(&mut self, line: &[u8]) -> After {
        let spellings = match &self.delimiter {
            Some(delimiter) => vec![delimiter.clone()],
            None => vec![[b"--", &self.boundary[..]].concat(), self.boundary.clone()],
        };
        for spelling in spellings {
            let after = match line.strip_prefix(&spelling[..]) {
                Some(b"") => After::Part(0),
                Some(b"--") => After::Last,
                _ => continue,
            };
            self.delimiter = Some(spelling);
            return after;
        }
        After::None
    }

    fn read_headers(&mut self) -> Result<bool, MultipartError> {
        let Some(end) = end_of_headers(&self.buffer) else {
            return match self.buffer.len() > MOST_HEADERS {
                true => Err(MultipartError::Headers),
                false => Ok(false),
            };
        };
        if end > MOST_HEADERS {
            return Err(MultipartError::Headers);
        }
        let headers = self.buffer.split_to(end);
        let length = length_of(&headers)?;
        if length.is_some_and(|length| length > self.largest) {
            return Err(MultipartError::TooLarge(self.largest));
        }
        (self.state, self.scanned) = (State::Body(length), 0);
        Ok(true)
    }

    fn read_body(&mut self, length: Option<usize>) -> Result<Option<Bytes>, MultipartError> {
        let end = match length {
            Some(length) if self.buffer.len() < length => return Ok(None),
            Some(length) => Some((length, length, State::Between)),
            None => self.find_end(),
        };
        let Some((body, next, state)) = end else {
            // What may still be the boundary and its line end does not count.
            let line = self.delimiter.as_ref().map_or(0, Vec::len) + MOST_AFTER;
            return match self.buffer.len() > self.largest + line {
                true => Err(MultipartError::TooLarge(self.largest)),
                false => Ok(None),
            };
        };
        if body > self.largest {
            return Err(MultipartError::TooLarge(self.largest));
        }
        let mut part = self.buffer.split_to(next);
        part.truncate(body);
        self.state = state;
        if self.is_ended() {
            self.buffer.clear();
        }
        Ok(Some(part.freeze()))
    }

    /// The end of a part without a length: where its body ends, where the headers of the next begin, and what follows.
    fn find_end(&mut self) -> Option<(usize, usize, State)> {
        let delimiter = self.delimiter.as_deref().unwrap_or_default();
        let finder = memmem::Finder::new(delimiter);
        let mut from = self.scanned;
        while let Some(found) = finder.find(&self.buffer[from..]).map(|found| from + found) {
            let before = &self.buffer[..found];
            let after = match before.is_empty() || before.ends_with(b"\n") {
                true => after_delimiter(&self.buffer[found + delimiter.len()..]),
                false => After::None,
            };
            let line_end = match before {
                [.., b'\r', b'\n'] => 2,
                [.., b'\n'] => 1,
                _ => 0,
            };
            let next = found + delimiter.len();
            match after {
                After::Part(rest) => return Some((found - line_end, next + rest, State::Headers)),
                After::Last => return Some((found - line_end, next, State::Ended)),
                After::Unknown => {
                    self.scanned = found;
                    return None;
                }
                After::None => from = found + 1,
            }
        }
        self.scanned = self.buffer.len().saturating_sub(delimiter.len()).max(from);
        None
    }
}

/// What the bytes after a boundary say.
fn after_delimiter(rest: &[u8]) -> After {
    if rest.starts_with(b"--") {
        return After::Last;
    }
    let line = memchr(b'\n', rest);
    match line {
        Some(end) if rest[..end].trim_ascii().is_empty() => After::Part(end + 1),
        Some(_) => After::None,
        None if rest.len() > MOST_AFTER => After::None,
        None if rest == b"-" || rest.trim_ascii().is_empty() => After::Unknown,
        None => After::None,
    }
}

/// The boundary parameter of a content type; cameras write characters in it that RFC 2045 wants quoted.
fn boundary(content_type: &str) -> Option<&str> {
    let parameters = content_type.split(';').skip(1);
    let (_, value) = parameters
        .filter_map(|parameter| parameter.split_once('='))
        .find(|(name, _)| name.trim().eq_ignore_ascii_case("boundary"))?;
    Some(value.trim().trim_matches('"').trim())
}

/// Where the blank line after the headers ends. There may be no headers at all.
fn end_of_headers(bytes: &[u8]) -> Option<usize> {
    let mut begin = 0;
    while let Some(end) = memchr(b'\n', &bytes[begin..]) {
        let line = &bytes[begin..begin + end];
        begin += end + 1;
        if line.trim_ascii().is_empty() {
            return Some(begin);
        }
    }
    None
}

fn length_of(headers: &[u8]) -> Result<Option<usize>, MultipartError> {
    for line in headers.split(|byte| *byte == b'\n') {
        let mut halves = line.splitn(2, |byte| *byte == b':');
        let name = halves.next().unwrap_or_default().trim_ascii();
        if name.eq_ignore_ascii_case(b"content-length") {
            let value = halves.next().unwrap_or_default().trim_ascii();
            let number = str::from_utf8(value).ok().and_then(|text| text.parse().ok());
            return number.map(Some).ok_or(MultipartError::Length);
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The parts of a stream that comes in these pieces, or what is wrong with it.
    fn parts<'a>(
        content_type: &str,
        pieces: impl IntoIterator<Item = &'a [u8]>,
        largest: usize,
    ) -> Result<(Vec<Bytes>, bool), MultipartError> {
        let mut multipart = Multipart::new(content_type, largest)?;
        let mut parts = Vec::new();
        for piece in pieces {
            multipart.push(piece);
            while let Some(part) = multipart.next_part()? {
                parts.push(part);
            }
            assert!(multipart.buffer.len() <= largest.max(MOST_BETWEEN) + MOST_HEADERS + piece.len());
        }
        Ok((parts, multipart.is_ended()))
    }

    fn check(content_type: &str, stream: &str, expected: &[&str], ended: bool) {
        let expected: Vec<Bytes> = expected
            .iter()
            .map(|part| Bytes::copy_from_slice(part.as_bytes()))
            .collect();
        let whole = parts(content_type, [stream.as_bytes()], 1000);
        assert_eq!(whole, Ok((expected.clone(), ended)), "{stream:?}");
        let single = parts(content_type, stream.as_bytes().chunks(1), 1000);
        assert_eq!(single, Ok((expected, ended)), "byte by byte {stream:?}");
    }

    #[test]
    fn all_that_cameras_write_is_read() {
        let plain = "multipart/x-mixed-replace; boundary=cut";
        check(
            plain,
            "--cut\r\n\r\none\r\n--cut\r\nA: b\r\n\r\ntwo\r\n--cut--\r\nrest",
            &["one", "two"],
            true,
        );
        check(
            plain,
            "--cut\nContent-Length: 3\n\none--cut\n\ntwo\n--cut\n",
            &["one", "two"],
            false,
        );
        check(
            plain,
            "cut\r\ncontent-length:3\r\n\r\none\r\ncut\r\n\r\n--cut\r\n\r\ncut\r\n",
            &["one", "--cut\r\n"],
            false,
        );
        check(
            plain,
            "\r\nhello\r\n--cut  \r\n\r\none\r\n--cut \r\n\r\ntwo",
            &["one"],
            false,
        );
        check(
            plain,
            "--cut\r\n\r\n\r\n--cutter\r\n--cut\r\n\r\n--cut\r\n",
            &["\r\n--cutter", ""],
            false,
        );
        let quoted = "Multipart/x-mixed-replace;charset=x; BOUNDARY=\"--cut here\"";
        check(quoted, "--cut here\r\n\r\none\r\n--cut here--", &["one"], true);
        check(
            quoted,
            "----cut here\r\n\r\none\r\n----cut here\r\n",
            &["one"],
            false,
        );
    }

    #[test]
    fn a_wrong_length_loses_one_part_only() {
        let plain = "multipart/x-mixed-replace;boundary=cut";
        let stream = "--cut\r\nContent-Length: 2\r\n\r\nlong\r\n--cut\r\n\r\ntwo\r\n--cut\r\n";
        check(plain, stream, &["lo", "two"], false);
    }

    #[test]
    fn what_has_no_end_is_refused() {
        let plain = "multipart/x-mixed-replace; boundary=cut";
        let long = vec![b'x'; 100_000];
        let lines = b"x\n".repeat(50_000);
        let large = [b"--cut\r\n\r\n", &long[..]].concat();
        let headers = [b"--cut\r\n", &lines[..]].concat();
        let announced = b"--cut\r\nContent-Length: 1001\r\n\r\n".to_vec();
        let word = b"--cut\r\nContent-Length: -4\r\n\r\n".to_vec();
        for (stream, expected) in [
            (&long, MultipartError::Missing),
            (&lines, MultipartError::Missing),
            (&large, MultipartError::TooLarge(1000)),
            (&headers, MultipartError::Headers),
            (&announced, MultipartError::TooLarge(1000)),
            (&word, MultipartError::Length),
        ] {
            for size in [1, 7, 100_000] {
                assert_eq!(parts(plain, stream.chunks(size), 1000), Err(expected.clone()));
            }
        }
        for content_type in [
            "multipart/x-mixed-replace",
            "a/b; boundary=",
            "a/b; boundary=\"\"",
        ] {
            assert_eq!(parts(content_type, [], 10), Err(MultipartError::Boundary));
        }
    }

    fn a_part() -> impl Strategy<Value = (Vec<u8>, bool)> {
        // Many dashes, line ends and pieces of the boundary.
        let piece = prop_oneof![
            prop::collection::vec(any::<u8>(), 0..4),
            prop::sample::select(vec![&b"\r\n"[..], b"\n", b"--", b"cut", b"\r\n--cu", b"-"])
                .prop_map(<[u8]>::to_vec),
        ];
        (
            prop::collection::vec(piece, 0..12).prop_map(|pieces| pieces.concat()),
            any::<bool>(),
        )
    }

    proptest! {
        /// However the stream is split, the parts are those that were sent.
        #[test]
        fn parts_survive_any_split(
            sent in prop::collection::vec(a_part(), 0..5),
            dashes in any::<bool>(),
            cuts in prop::collection::vec(1_usize..40, 1..20),
        ) {
            // A part without a length must not hold a whole boundary.
            let sent: Vec<(Vec<u8>, bool)> = sent
                .into_iter()
                .map(|(body, length)| {
                    let whole = memmem::find(&body, b"cut").is_some();
                    (body, length || whole)
                })
                .collect();
            let mark: &[u8] = if dashes { b"--cut" } else { b"cut" };
            let mut stream = mark.to_vec();
            for (body, length) in &sent {
                stream.extend_from_slice(b"\r\n");
                if *length {
                    stream.extend_from_slice(format!("Content-Length: {}\r\n", body.len()).as_bytes());
                }
                stream.extend_from_slice(b"\r\n");
                stream.extend_from_slice(body);
                stream.extend_from_slice(b"\r\n");
                stream.extend_from_slice(mark);
            }
            stream.extend_from_slice(b"--\r\n");
            let mut pieces = Vec::new();
            let mut rest = &stream[..];
            for cut in cuts.iter().cycle() {
                if rest.is_empty() {
                    break;
                }
                let (piece, more) = rest.split_at((*cut).min(rest.len()));
                pieces.push(piece);
                rest = more;
            }
            let (got, ended) = parts("a/b; boundary=cut", pieces, 1000).unwrap();
            let bodies: Vec<Bytes> = sent.into_iter().map(|(body, _)| body.into()).collect();
            prop_assert_eq!(got, bodies);
            prop_assert!(ended);
        }

        /// No bytes make it panic, or keep more than it may.
        #[test]
        fn garbage_is_an_error_at_worst(pieces in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..300), 0..20)) {
            let _ = parts("a/b; boundary=c", pieces.iter().map(Vec::as_slice), 100);
        }
    }
}
