//! What holds for any bytes. The property tests and the fuzz target both call `any_bytes`.
//!
//! It compares the parser with a second one, which looks at all the bytes at once and follows the rules of `Parser`'s
//! documentation one after the other, byte by byte of the text rather than of the state.

use mom_brs::file::EXTENDED;
use mom_brs::{Code, Direction, Frame, LONGEST, PAPER, Parameter, Parser, Table};

/// Reads bytes in every way that there is, and panics if two of them differ or if a rule does not hold.
///
/// The first byte chooses the table and the direction, and whether the others stand for the characters of the wire, so that
/// random bytes come upon frames; the second one chooses the cuts and the silence.
pub(crate) fn any_bytes(data: &[u8]) {
    let [choice, cuts, bytes @ ..] = data else { return };
    let table: &'static Table = if choice & 1 == 0 { &PAPER } else { &EXTENDED };
    let direction = if choice & 2 == 0 {
        Direction::Command
    } else {
        Direction::Reply
    };
    let written: Vec<u8>;
    let bytes = if choice & 4 == 0 {
        bytes
    } else {
        written = bytes.iter().flat_map(|byte| characters(*byte)).copied().collect();
        &written
    };
    let (frames, parser) = read_one_by_one(table, direction, bytes);
    compare_with_rules(table, direction, bytes, &frames, &parser);
    read_cut(table, direction, bytes, usize::from(*cuts), &frames, &parser);
    read_with_silence(table, direction, bytes, usize::from(*cuts));
    read_after_silence(table, direction, parser);
}

/// Pieces of frames, for bytes to stand for.
fn characters(byte: u8) -> &'static [u8] {
    const PIECES: [&[u8]; 33] = [
        b"0",
        b"1",
        b"2",
        b"4",
        b"5",
        b"6",
        b"7",
        b"9",
        b"-",
        b" ",
        b"  ",
        b"x",
        b"\n",
        b"00",
        b"04",
        b"06",
        b"07",
        b"10",
        b"12",
        b"55",
        b"90",
        b" 00100",
        b" -0050",
        b" 00000",
        b" 99999",
        b" 006",
        b" -04",
        b"06 00050 -0050",
        b"06 00000 00000",
        b"07 00005",
        b"04 00005",
        b"10 01000 -1000",
        b"\xe2\x80\x93",
    ];
    PIECES[usize::from(byte) % PIECES.len()]
}

/// A frame, and the place behind its last byte.
type Ended = (usize, Frame);

fn read_one_by_one(table: &'static Table, direction: Direction, bytes: &[u8]) -> (Vec<Ended>, Parser) {
    let mut parser = Parser::new(table, direction);
    let mut frames = Vec::new();
    let mut clamped = 0;
    for (at, byte) in bytes.iter().enumerate() {
        if let Some(frame) = parser.push(*byte) {
            clamped += frame.clamped_values();
            frames.push((at + 1, frame));
        }
        assert!(parser.buffered() < LONGEST, "a whole frame waits");
        assert!(parser.astray() <= parser.faults().skipped);
        let faults = parser.faults();
        let framed: usize = frames.iter().map(|(_, frame)| frame.encode().len()).sum();
        let counted = framed + count(faults.unknown_bytes) + count(faults.skipped) + parser.buffered();
        assert_eq!(counted, at + 1, "every byte is in exactly one place");
        assert_eq!(faults.clamped, clamped);
        assert_eq!(faults.cut, 0, "nobody was silent");
    }
    (frames, parser)
}

fn compare_with_rules(
    table: &'static Table,
    direction: Direction,
    bytes: &[u8],
    frames: &[Ended],
    parser: &Parser,
) {
    let rules = Rules::new(table, direction, bytes).read();
    let read: Vec<(usize, Code)> = frames.iter().map(|(end, frame)| (*end, frame.code())).collect();
    assert_eq!(read, rules.frames, "the frames that the rules find");
    let faults = parser.faults();
    let counts = [faults.unknown, faults.unknown_bytes, faults.skipped].map(count);
    assert_eq!(counts, [rules.unknown, rules.unknown_bytes, rules.skipped]);
    assert_eq!(parser.buffered(), bytes.len() - rules.at);
    for (end, frame) in frames {
        let encoded = frame.encode();
        let taken = &bytes[end - encoded.len()..*end];
        if frame.is_clamped() {
            continue;
        }
        // `-0000` is the one number that is written in two ways.
        let taken = String::from_utf8_lossy(taken).replace(" -0000", " 00000");
        assert_eq!(
            encoded.as_str(),
            taken,
            "the bytes of the frame are the bytes read"
        );
    }
}

fn read_cut(
    table: &'static Table,
    direction: Direction,
    bytes: &[u8],
    cuts: usize,
    frames: &[Ended],
    parser: &Parser,
) {
    let mut cut = Parser::new(table, direction);
    let mut read = Vec::new();
    let mut rest = bytes;
    let mut length = cuts;
    while !rest.is_empty() {
        // Pieces of 0 to 16 bytes, of another length each time.
        let (piece, after) = rest.split_at((length % 17).min(rest.len()));
        read.extend(cut.feed(piece));
        rest = after;
        length = (length * 5 + 3) % 256;
    }
    let whole: Vec<Frame> = frames.iter().map(|(_, frame)| *frame).collect();
    assert_eq!(read, whole, "the frames do not depend on the cuts");
    assert_eq!(cut.faults(), parser.faults());
    assert_eq!(cut.buffered(), parser.buffered());
}

/// What comes after a silence is read as by a new parser.
fn read_with_silence(table: &'static Table, direction: Direction, bytes: &[u8], cuts: usize) {
    let (before, after) = bytes.split_at(cuts.min(bytes.len()));
    let (_, mut parser) = read_one_by_one(table, direction, before);
    let half = parser.buffered();
    let faults = parser.faults();
    parser.idle();
    assert_eq!((parser.buffered(), parser.is_amid()), (0, false));
    assert_eq!(count(parser.faults().skipped - faults.skipped), half);
    assert_eq!(count(parser.faults().cut), usize::from(half > 0));
    let mut new = Parser::new(table, direction);
    let (read, expected): (Vec<_>, Vec<_>) = (parser.feed(after).collect(), new.feed(after).collect());
    assert_eq!(read, expected);
}

/// After anything and a silence, every frame is read.
fn read_after_silence(table: &'static Table, direction: Direction, mut parser: Parser) {
    parser.idle();
    let faults = parser.faults();
    for command in table.commands() {
        let Some(parameters) = command.said(direction) else {
            continue;
        };
        for value in [
            |parameter: &Parameter| parameter.min,
            |parameter: &Parameter| parameter.max,
        ] {
            let values: Vec<i32> = parameters.iter().map(value).collect();
            let frame = Frame::said(command, direction, &values).expect("as many as there are parameters");
            let read: Vec<Frame> = parser.feed(&frame.encode()).collect();
            assert_eq!(read, [frame], "a frame at the place of a code");
        }
    }
    assert_eq!(parser.faults(), faults, "nothing was wrong");
}

fn count(count: u32) -> usize {
    usize::try_from(count).unwrap_or(usize::MAX)
}

/// The rules, followed on all bytes at once.
struct Rules<'a> {
    table: &'static Table,
    direction: Direction,
    bytes: &'a [u8],
    /// Up to here everything is in its place.
    at: usize,
    frames: Vec<(usize, Code)>,
    unknown: usize,
    unknown_bytes: usize,
    skipped: usize,
}

/// What stands at a place.
enum Stands {
    /// A frame of this many bytes.
    Frame(Code, usize),
    /// An unknown code.
    Unknown,
    /// What more bytes could make a frame or a code.
    Half,
    Nothing,
}

impl<'a> Rules<'a> {
    fn new(table: &'static Table, direction: Direction, bytes: &'a [u8]) -> Rules<'a> {
        let (at, frames, unknown, unknown_bytes, skipped) = (0, Vec::new(), 0, 0, 0);
        Rules {
            table,
            direction,
            bytes,
            at,
            frames,
            unknown,
            unknown_bytes,
            skipped,
        }
    }

    fn read(mut self) -> Self {
        let mut place_of_code = true;
        while self.at < self.bytes.len() {
            let plausible = place_of_code || self.is_plausible() || self.may_be_stop();
            match self.stands() {
                Stands::Frame(code, length) if plausible => {
                    self.at += length;
                    self.frames.push((self.at, code));
                    place_of_code = true;
                }
                Stands::Unknown if place_of_code => {
                    if self.pass_unknown() {
                        break;
                    }
                }
                Stands::Half if plausible => break,
                _ => {
                    self.at += 1;
                    self.skipped += 1;
                    place_of_code = false;
                }
            }
        }
        self
    }

    /// Whether a code may be looked for here, after bytes that were skipped.
    fn is_plausible(&self) -> bool {
        match self.bytes[self.at - 1] {
            b'-' | b'0'..=b'9' => false,
            b' ' => self.parameters().is_none_or(|(_, parameters)| parameters > 0),
            _ => true,
        }
    }

    /// Whether a stop stands here, or may.
    fn may_be_stop(&self) -> bool {
        let stop = b"06 00000 00000";
        let bytes = &self.bytes[self.at..];
        let length = bytes.len().min(stop.len());
        self.direction == Direction::Command && stop.starts_with(&bytes[..length])
    }

    /// Passes an unknown code and its parameters; whether the bytes end within one of them.
    fn pass_unknown(&mut self) -> bool {
        self.unknown += 1;
        let start = self.at;
        self.at += 2;
        while matches(&self.bytes[self.at..], 1) == Some(true) {
            self.at += 6;
        }
        self.unknown_bytes += self.at - start;
        let rest = &self.bytes[self.at..];
        !rest.is_empty() && matches(rest, 1) == Some(false)
    }

    /// The known code here, and how many parameters it has.
    fn parameters(&self) -> Option<(Code, usize)> {
        let text = self.bytes.get(self.at..self.at + 2)?;
        let number = std::str::from_utf8(text).ok()?.parse::<u8>().ok()?;
        let code = text
            .iter()
            .all(u8::is_ascii_digit)
            .then_some(Code::new(number)?)?;
        let command = self.table.get(code)?;
        Some((code, command.said(self.direction)?.len()))
    }

    fn stands(&self) -> Stands {
        let bytes = &self.bytes[self.at..];
        let digits = bytes
            .iter()
            .take(2)
            .take_while(|byte| byte.is_ascii_digit())
            .count();
        match (digits, self.parameters()) {
            (1, _) if bytes.len() == 1 => Stands::Half,
            (2, None) => Stands::Unknown,
            (2, Some((code, parameters))) => match matches(&bytes[2..], parameters) {
                Some(true) => Stands::Frame(code, 2 + 6 * parameters),
                Some(false) => Stands::Half,
                None => Stands::Nothing,
            },
            _ => Stands::Nothing,
        }
    }
}

/// Whether bytes begin with so many parameters; `Some(false)` if they end too early to say.
fn matches(bytes: &[u8], parameters: usize) -> Option<bool> {
    let length = 6 * parameters;
    for (at, byte) in bytes.iter().take(length).enumerate() {
        let good = match at % 6 {
            0 => *byte == b' ',
            1 => *byte == b'-' || byte.is_ascii_digit(),
            _ => byte.is_ascii_digit(),
        };
        if !good {
            return None;
        }
    }
    Some(bytes.len() >= length)
}
