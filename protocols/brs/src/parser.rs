//! From bytes, cut anywhere, to frames (W7).

use core::fmt;
use core::time::Duration;

use crate::LONGEST;
use crate::frame::Frame;
use crate::number::{GROUP, begins_group};
use crate::table::{Code, Direction, Table};

/// After so much silence what is half read is dropped, at both ends ([`Parser::idle`]).
///
/// A frame is written at once, so that its parts are milliseconds apart. It is less than a station lets pass between two orders
/// by hand, and less than half of the 500 ms after which a robot's watchdog stops it.
pub const SILENCE: Duration = Duration::from_millis(200);

/// Either end hangs up when [`Parser::astray`] is above this: the other does not write what it reads. A station may be telling its robot
/// to stand; a robot without a station stands.
///
/// More than the longest frame and what a person mistypes in a line, and less than five stops.
pub const MOST_ASTRAY: u32 = 64;

/// The stop, which is read wherever it stands.
const STOP: &[u8] = b"06 00000 00000";

/// Reads one direction of a connection: all bytes in their order, cut anywhere; the frames do not depend on the cuts.
///
/// A frame is given at its last byte. Memory is fixed, the work for each byte is bounded by the length of the longest
/// frame, and there is no input for which the parser panics.
///
/// # What is wrong, and what follows
///
/// The parser is at the *place of a code* at the beginning, after each frame, and after [`idle`](Parser::idle).
///
/// 1. **Unknown code.** Two digits at the place of a code that nobody says in this direction are counted as one
///    [`unknown`](Faults::unknown) frame. All parameters that follow belong to it, as every frame is written alike: as long as
///    a space and five characters of a number come, they are skipped too. What comes after them is the place of a code.
/// 2. **A byte that cannot be.** If the bytes since the place of a code are the beginning of no frame, the first of
///    them is [`skipped`](Faults::skipped), and further bytes, up to the next *plausible code*. Its place
///    - does not follow a digit or `-`, as that may be the middle of a number;
///    - does not follow a space, if the code has no parameters, as `00` may be the beginning of `00100`;
///    - holds a code that is sent in this direction, with all its parameters.
///
///    So a MOTOR is read only from 14 bytes that are exactly one, never from pieces of others' parameters. Line ends and words
///    between frames harm none of them, so that a person can type commands. One frame is plausible at any place, also after a
///    digit: a stop, `06 00000 00000`. A frame with one digit too many must not hide the stops behind it, and to stand by
///    mistake harms nobody.
/// 3. **Silence.** The bytes do not say that a sender died within a frame. The owner of the clock calls
///    [`idle`](Parser::idle) when nothing has come for [`SILENCE`], whenever the parser [is amid something](Parser::is_amid): what
///    is half read is dropped and skipped, and the next byte is at the place of a code.
/// 4. **Value out of range.** It becomes the nearest that the parameter can have, is [counted](Faults::clamped), and the frame
///    [says so](Frame::is_clamped).
///
/// A connection begins with a new parser.
///
/// ```
/// use mom_brs::{Direction, PAPER, Parser};
///
/// let mut parser = Parser::new(&PAPER, Direction::Command);
/// let mut read = |bytes: &[u8]| parser.feed(bytes).map(|frame| frame.to_string()).collect::<Vec<_>>();
/// assert!(read(b"06 00100 0").is_empty());
/// assert_eq!(read(b"010000"), ["06 00100 00100", "00"]);
/// // Nobody knows 55; the line end cannot be; 5000 is more than a motor takes.
/// assert_eq!(read(b"55 00001\n06 05000 00000"), ["06 01000 00000"]);
///
/// let faults = parser.faults();
/// assert_eq!((faults.unknown, faults.skipped, faults.clamped), (1, 1, 1));
/// ```
#[derive(Clone)]
pub struct Parser {
    table: &'static Table,
    direction: Direction,
    state: State,
    /// The beginning of a frame, or of a parameter of an unknown one: never more than can become one.
    buffer: [u8; LONGEST],
    length: usize,
    faults: Faults,
    last_unknown: Option<Code>,
    astray: u32,
}

/// What may begin at the first byte of the buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Any code.
    Code,
    /// Any code, or a parameter of the unknown frame before.
    Unknown,
    /// A plausible code after this byte.
    Skip(u8),
}

/// What bytes are, as far as there are any.
enum Judgement {
    /// The beginning of something.
    Beginning,
    /// A whole frame.
    Whole(Frame),
    /// A code that nobody says in this direction.
    Unknown(Code),
    /// A parameter of an unknown frame.
    Skippable,
    /// The beginning of nothing.
    Wrong,
}

/// What was wrong since the parser was made. No count wraps: at its highest value it stays.
///
/// Every byte pushed is in exactly one place: in a frame, in `unknown_bytes`, in `skipped`, or
/// [still in the buffer](Parser::buffered).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Faults {
    /// Frames of unknown codes.
    pub unknown: u32,
    /// The bytes of those.
    pub unknown_bytes: u32,
    /// Bytes that belong to no frame, those that were dropped for silence among them.
    pub skipped: u32,
    /// How often silence cut a frame.
    pub cut: u32,
    /// Values that were out of range.
    pub clamped: u32,
}

impl Faults {
    /// Whether nothing was wrong.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Faults::default()
    }
}

impl Parser {
    /// A parser at the place of a code.
    #[must_use]
    pub const fn new(table: &'static Table, direction: Direction) -> Parser {
        Parser {
            table,
            direction,
            state: State::Code,
            buffer: [0; LONGEST],
            length: 0,
            faults: Faults {
                unknown: 0,
                unknown_bytes: 0,
                skipped: 0,
                cut: 0,
                clamped: 0,
            },
            last_unknown: None,
            astray: 0,
        }
    }

    /// Takes the next byte; the frame that ends with it.
    pub fn push(&mut self, byte: u8) -> Option<Frame> {
        if let Some(next) = self.buffer.get_mut(self.length) {
            *next = byte;
            self.length += 1;
        }
        let mut start = 0;
        let mut frame = None;
        while let Some(bytes @ [first, ..]) = self.buffer.get(start..self.length) {
            let length = bytes.len();
            match self.judge(bytes) {
                Judgement::Beginning => break,
                Judgement::Whole(whole) => {
                    add(&mut self.faults.clamped, whole.clamped_values() as usize);
                    self.astray = self.astray.saturating_sub(count(length));
                    frame = Some(whole);
                    self.state = State::Code;
                    start = self.length;
                }
                Judgement::Unknown(code) => {
                    add(&mut self.faults.unknown, 1);
                    add(&mut self.faults.unknown_bytes, length);
                    self.last_unknown = Some(code);
                    self.state = State::Unknown;
                    start = self.length;
                }
                Judgement::Skippable => {
                    add(&mut self.faults.unknown_bytes, length);
                    start = self.length;
                }
                Judgement::Wrong => {
                    self.state = State::Skip(*first);
                    self.skip(1);
                    start += 1;
                }
            }
        }
        self.buffer.copy_within(start..self.length, 0);
        self.length -= start;
        frame
    }

    /// Takes bytes; the frames among them, as an iterator that has to be used up: a byte that it does not reach is not taken.
    pub fn feed<'a>(&'a mut self, bytes: &'a [u8]) -> Feed<'a> {
        Feed { parser: self, bytes }
    }

    /// Says that nothing has come for [`SILENCE`]: drops what is half read. The next byte is at the place of a code.
    pub fn idle(&mut self) {
        if self.length > 0 {
            add(&mut self.faults.cut, 1);
            self.skip(self.length);
        }
        self.length = 0;
        self.state = State::Code;
    }

    /// What was wrong since the parser was made.
    #[must_use]
    pub const fn faults(&self) -> Faults {
        self.faults
    }

    /// The last unknown code.
    #[must_use]
    pub const fn last_unknown(&self) -> Option<Code> {
        self.last_unknown
    }

    /// How many bytes are half a frame so far, or half a parameter of an unknown one: fewer than [`LONGEST`].
    #[must_use]
    pub const fn buffered(&self) -> usize {
        self.length
    }

    /// Whether a silence would change what the next byte is: a frame is half read, or its parameters or a plausible code are
    /// looked for.
    #[must_use]
    pub fn is_amid(&self) -> bool {
        self.length > 0 || self.state != State::Code
    }

    /// How many more bytes were skipped than were read in frames, since that was last balanced: 0 of a sender that is understood.
    ///
    /// Each frame takes its length from it, so that a line end after each frame is nothing, and a `00` that is found among bytes
    /// of something else does not make up for them.
    #[must_use]
    pub const fn astray(&self) -> u32 {
        self.astray
    }

    fn skip(&mut self, bytes: usize) {
        add(&mut self.faults.skipped, bytes);
        add(&mut self.astray, bytes);
    }

    fn judge(&self, bytes: &[u8]) -> Judgement {
        match self.state {
            State::Code => self.judge_frame(bytes, None),
            State::Unknown if bytes.first() == Some(&b' ') => match begins_group(bytes) {
                true if bytes.len() == GROUP => Judgement::Skippable,
                true => Judgement::Beginning,
                false => Judgement::Wrong,
            },
            State::Unknown => self.judge_frame(bytes, None),
            State::Skip(b'-' | b'0'..=b'9') => {
                match self.direction == Direction::Command && STOP.starts_with(bytes) {
                    true => self.judge_frame(bytes, Some(b'0')),
                    false => Judgement::Wrong,
                }
            }
            State::Skip(after) => self.judge_frame(bytes, Some(after)),
        }
    }

    /// What bytes are at the place of a code, or where a plausible code is looked for after a byte that was skipped.
    fn judge_frame(&self, bytes: &[u8], after: Option<u8>) -> Judgement {
        let &[tens, ref rest @ ..] = bytes else {
            return Judgement::Beginning;
        };
        if !tens.is_ascii_digit() {
            return Judgement::Wrong;
        }
        let &[units, ref rest @ ..] = rest else {
            return Judgement::Beginning;
        };
        if !units.is_ascii_digit() {
            return Judgement::Wrong;
        }
        let Some(code) = Code::new((tens - b'0') * 10 + (units - b'0')) else {
            return Judgement::Wrong;
        };
        let command = self.table.get(code);
        let said = command.and_then(|command| Some((command, command.said(self.direction)?)));
        let Some((command, parameters)) = said else {
            return match after {
                None => Judgement::Unknown(code),
                Some(_) => Judgement::Wrong,
            };
        };
        if parameters.is_empty() && after == Some(b' ') {
            return Judgement::Wrong;
        }
        let (groups, rest) = rest.as_chunks::<GROUP>();
        let good = groups.iter().all(|group| begins_group(group)) && begins_group(rest);
        match groups.len() == parameters.len() {
            true if good && rest.is_empty() => {
                Judgement::Whole(Frame::read(command, self.direction, parameters, groups))
            }
            false if good && groups.len() < parameters.len() => Judgement::Beginning,
            _ => Judgement::Wrong,
        }
    }
}

impl fmt::Debug for Parser {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Parser")
            .field("direction", &self.direction)
            .field("state", &self.state)
            .field("buffer", &self.buffer.get(..self.length).unwrap_or_default())
            .field("faults", &self.faults)
            .finish_non_exhaustive()
    }
}

fn add(sum: &mut u32, more: usize) {
    *sum = sum.saturating_add(count(more));
}

fn count(bytes: usize) -> u32 {
    u32::try_from(bytes).unwrap_or(u32::MAX)
}

/// The frames among the bytes that were given to [`Parser::feed`].
#[derive(Debug)]
#[must_use = "bytes are taken as the iterator is used up"]
pub struct Feed<'a> {
    parser: &'a mut Parser,
    bytes: &'a [u8],
}

impl Feed<'_> {
    /// The bytes that are not taken yet.
    #[must_use]
    pub const fn rest(&self) -> &[u8] {
        self.bytes
    }
}

impl Iterator for Feed<'_> {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        while let Some((byte, rest)) = self.bytes.split_first() {
            self.bytes = rest;
            if let Some(frame) = self.parser.push(*byte) {
                return Some(frame);
            }
        }
        None
    }
}

impl core::iter::FusedIterator for Feed<'_> {}

#[cfg(test)]
mod tests {
    use std::string::{String, ToString};
    use std::vec::Vec;

    use super::*;
    use crate::{Command, PAPER, Parameter};

    fn read(parser: &mut Parser, bytes: &str) -> Vec<String> {
        parser
            .feed(bytes.as_bytes())
            .map(|frame| frame.to_string())
            .collect()
    }

    fn commands() -> Parser {
        Parser::new(&PAPER, Direction::Command)
    }

    /// The frames of commands, and `unknown`, `unknown_bytes`, `skipped`, buffered.
    fn looked(bytes: &str) -> (Vec<String>, [usize; 4]) {
        let mut parser = commands();
        let frames = read(&mut parser, bytes);
        let faults = parser.faults();
        let counts = [faults.unknown, faults.unknown_bytes, faults.skipped].map(|count| count as usize);
        let [unknown, bytes, skipped] = counts;
        (frames, [unknown, bytes, skipped, parser.buffered()])
    }

    #[test]
    fn a_frame_is_given_at_its_last_byte() {
        let mut parser = commands();
        let bytes = b"06 00050 -0050";
        let (last, before) = bytes.split_last().unwrap();
        assert!(before.iter().all(|byte| parser.push(*byte).is_none()));
        assert_eq!(parser.buffered(), 13);
        assert_eq!(parser.push(*last).unwrap().values(), [50, -50]);
        assert_eq!((parser.buffered(), parser.faults().is_none()), (0, true));
    }

    #[test]
    fn joined_frames_are_as_many_as_they_were() {
        let (frames, counts) = looked("000406 00100 0010007 0000500");
        assert_eq!(frames, ["00", "04", "06 00100 00100", "07 00005", "00"]);
        assert_eq!(counts, [0; 4]);
    }

    #[test]
    fn an_unknown_code_is_skipped_with_its_parameters() {
        let (frames, counts) = looked("00550099 00100 -010000");
        assert_eq!(frames, ["00", "00", "00"]);
        assert_eq!(counts, [2, 16, 0, 0]);
        let mut parser = commands();
        read(&mut parser, "5599 00001");
        assert_eq!(parser.last_unknown(), Code::new(99));
    }

    #[test]
    fn what_only_the_other_direction_says_is_unknown() {
        let mut parser = Parser::new(&PAPER, Direction::Reply);
        assert_eq!(read(&mut parser, "06 00100 0010004 0000500"), ["04 00005", "00"]);
        assert_eq!((parser.faults().unknown, parser.faults().unknown_bytes), (1, 14));
        assert_eq!(parser.last_unknown(), Some(Code::MOTOR));
    }

    #[test]
    fn half_a_parameter_of_an_unknown_frame_is_skipped_as_what_cannot_be() {
        assert_eq!(looked("55 0012x00"), (Vec::from(["00".into()]), [1, 2, 6, 0]));
        assert_eq!(looked("55 0012"), (Vec::new(), [1, 2, 0, 5]));
    }

    #[test]
    fn frames_after_line_ends_and_words_are_read() {
        let (frames, counts) = looked("go!00\r\n06 00001 00002\n04 06 00003 00004");
        assert_eq!(frames, ["00", "06 00001 00002", "04", "06 00003 00004"]);
        assert_eq!(counts, [0, 0, 7, 0]);
    }

    #[test]
    fn no_code_is_found_within_a_parameter() {
        // `00` after the space, `06` after digits, `04` after a sign; the last one is a MOTOR but follows a digit.
        for bytes in [
            "x 00100",
            "x 00006 00100",
            "x -0400",
            "x106 00100 00100",
            "x-06 00100 00100",
        ] {
            // Behind a 0 more may make it a stop.
            let kept = usize::from(bytes.ends_with('0'));
            let skipped = bytes.len() - kept;
            assert_eq!(looked(bytes), (Vec::new(), [0, 0, skipped, kept]), "{bytes}");
        }
    }

    #[test]
    fn an_unknown_code_is_not_plausible() {
        assert_eq!(looked("x55 00100 0010000x"), (Vec::new(), [0, 0, 18, 0]));
    }

    #[test]
    fn a_frame_that_breaks_off_does_not_take_the_next_one_with_it() {
        let (frames, counts) = looked("06 00100 06 00050 00050");
        assert_eq!(frames, ["06 00050 00050"]);
        assert_eq!(counts, [0, 0, 9, 0]);
    }

    #[test]
    fn silence_drops_what_is_half_read() {
        let mut parser = commands();
        read(&mut parser, "06 00100");
        parser.idle();
        let faults = parser.faults();
        assert_eq!((faults.cut, faults.skipped, parser.buffered()), (1, 8, 0));
        parser.idle();
        assert_eq!(parser.faults(), faults);
        assert_eq!(read(&mut parser, "00"), ["00"]);
    }

    #[test]
    fn after_silence_any_byte_is_at_the_place_of_a_code() {
        let mut parser = commands();
        read(&mut parser, "x1");
        parser.idle();
        assert_eq!(read(&mut parser, "00"), ["00"]);
        // After an unknown frame, too: what follows the silence is not a parameter of it.
        read(&mut parser, "55");
        parser.idle();
        let unknown = parser.faults().unknown_bytes;
        read(&mut parser, " 00100");
        assert_eq!(parser.faults().unknown_bytes, unknown);
    }

    #[test]
    fn a_stop_is_read_behind_a_digit_too_many_and_nothing_else_is() {
        let stop = "06 00000 00000";
        for (digit, first) in [("-", 1), ("0", 0), ("1", 0), ("6", 0), ("66", 1)] {
            let (frames, _) = looked(&["06 01000 01000", digit, stop, stop].concat());
            // The digit may take the first digit of the first one with it, never more.
            let stops = frames.iter().filter(|frame| *frame == stop).count();
            assert_eq!(stops, 1 + first, "{digit}: {frames:?}");
        }
        assert_eq!(looked("x106 00000 00001"), (Vec::new(), [0, 0, 16, 0]));
        let mut replies = Parser::new(&PAPER, Direction::Reply);
        assert!(read(&mut replies, "x106 00000 00000").is_empty());
    }

    /// As long as nothing is buffered, too: bytes that cannot be are skipped at once, and leave the parser looking for a code.
    #[test]
    fn after_silence_the_next_frame_is_read_whatever_was_skipped() {
        for bytes in ["06 01000 010000", "x", "55", "06 0100", "77 00001 0000"] {
            let mut parser = commands();
            read(&mut parser, bytes);
            assert!(parser.is_amid(), "{bytes}");
            parser.idle();
            assert!(!parser.is_amid(), "{bytes}");
            assert_eq!(read(&mut parser, "06 00001 00002"), ["06 00001 00002"], "{bytes}");
            assert!(!parser.is_amid(), "{bytes}");
        }
    }

    #[test]
    fn who_skips_more_than_it_reads_is_astray() {
        let mut parser = commands();
        // A line end after each frame is nothing; a person's word is made up for by a command.
        for _ in 0..100 {
            read(&mut parser, "00\r\n06 00001 00001\n");
        }
        assert_eq!(parser.astray(), 1);
        // A digit too many before each frame: a NULL is found in all of them.
        for stops in 1..=6 {
            parser.idle();
            assert_eq!(read(&mut parser, "006 00000 00000"), ["00"]);
            assert_eq!(
                parser.astray() > MOST_ASTRAY,
                stops == 6,
                "{stops}: {}",
                parser.astray()
            );
        }
        parser.idle();
        assert_eq!(read(&mut parser, &"06 00001 00001".repeat(6)).len(), 6);
        assert_eq!(parser.astray(), 0);
    }

    #[test]
    fn values_out_of_range_are_clamped_and_counted() {
        let mut parser = commands();
        let frame = parser.feed(b"06 05000 -9999").next().unwrap();
        assert_eq!((frame.values(), frame.is_clamped()), (&[1000, -1000][..], true));
        assert_eq!(parser.faults().clamped, 2);
        assert!(parser.faults().skipped == 0 && !parser.faults().is_none());
    }

    #[test]
    fn what_is_not_used_up_is_not_taken() {
        let mut parser = commands();
        let mut feed = parser.feed(b"000400");
        assert_eq!(feed.next().map(|frame| frame.code()), Some(Code::NULL));
        assert_eq!(feed.rest(), b"0400");
        assert_eq!(feed.count(), 2);
    }

    #[test]
    fn a_parser_needs_about_as_much_memory_as_two_frames() {
        assert!(size_of::<Parser>() <= 112, "{}", size_of::<Parser>());
    }

    #[test]
    fn the_longest_frame_fits() {
        static LONG: Table = match Table::new(&[Command {
            code: Code::GOTO,
            name: "long",
            parameters: Some(&[
                Parameter::new("a", 0, 9),
                Parameter::new("b", 0, 9),
                Parameter::new("c", 0, 9),
                Parameter::new("d", 0, 9),
                Parameter::new("e", 0, 9),
                Parameter::new("f", 0, 9),
                Parameter::new("g", 0, 9),
                Parameter::new("h", 0, 9),
            ]),
            reply: None,
        }]) {
            Ok(table) => table,
            Err(_) => panic!("a table"),
        };
        let frame = Frame::new(&LONG.commands()[0], &[1, 2, 3, 4, 5, 6, 7, 8]).unwrap();
        assert_eq!(frame.encode().len(), LONGEST);
        let mut parser = Parser::new(&LONG, Direction::Command);
        assert_eq!(parser.feed(&frame.encode()).next(), Some(frame));
    }
}
