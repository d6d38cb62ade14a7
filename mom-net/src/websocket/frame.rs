//! The frames of RFC 6455: their heads, their masks, and what is in them.

use bytes::{BufMut, BytesMut};
use mom_proto::{Gcra, Micros, Pace};

/// What a frame is.
pub(super) const CONTINUATION: u8 = 0;
pub(super) const TEXT: u8 = 1;
pub(super) const BINARY: u8 = 2;
const CLOSE: u8 = 8;
const PING: u8 = 9;
const PONG: u8 = 10;

const LAST: u8 = 0x80;
const MASKED: u8 = 0x80;

/// The most that a control frame holds.
const CONTROL: u64 = 125;

/// Frames that bring no payload, control frames and empty ones: so many each second, and so many at once. No client needs a tenth of
/// it, and each of them is work that nothing else counts.
const IDLE: Pace = Pace::per_second(100, 1000);

/// Answers to pings that may wait: older ones than these say nothing that a newer one does not.
const ANSWERS: usize = 4096;

/// Why a link ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fault {
    /// A status of RFC 6455, 7.4.1.
    pub(super) status: u16,
    pub(super) text: &'static str,
}

/// The other side goes away for good.
pub(super) const LEFT: Fault = Fault {
    status: 1001,
    text: "the page was left",
};

/// All is well.
pub(super) const NORMAL: Fault = Fault {
    status: 1000,
    text: "",
};

const NO_TEXT: Fault = Fault {
    status: 1007,
    text: "text is UTF-8",
};

fn fault(text: &'static str) -> Fault {
    Fault { status: 1002, text }
}

/// The head of a frame to be sent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    bytes: [u8; 14],
    length: u8,
}

impl Head {
    pub(super) fn new(kind: u8, last: bool, payload: usize, mask: Option<[u8; 4]>) -> Head {
        let mut bytes = [0; 14];
        bytes[0] = kind | if last { LAST } else { 0 };
        let masked = if mask.is_some() { MASKED } else { 0 };
        let mut length = 2;
        match (u8::try_from(payload), u16::try_from(payload)) {
            (Ok(payload @ 0..=125), _) => bytes[1] = payload | masked,
            (_, Ok(payload)) => {
                bytes[1] = 126 | masked;
                bytes[2..4].copy_from_slice(&payload.to_be_bytes());
                length = 4;
            }
            (_, Err(_)) => {
                bytes[1] = 127 | masked;
                bytes[2..10].copy_from_slice(&(payload as u64).to_be_bytes());
                length = 10;
            }
        }
        if let Some(mask) = mask {
            bytes[length..length + 4].copy_from_slice(&mask);
            length += 4;
        }
        Head {
            bytes,
            length: length as u8,
        }
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }
}

/// Adds a whole frame.
pub(super) fn add(out: &mut BytesMut, kind: u8, last: bool, payload: &[&[u8]], mask: Option<[u8; 4]>) {
    let size = payload.iter().map(|piece| piece.len()).sum();
    out.extend_from_slice(Head::new(kind, last, size, mask).bytes());
    let from = out.len();
    for piece in payload {
        out.extend_from_slice(piece);
    }
    if let Some(mask) = mask {
        apply(&mut out[from..], mask, 0);
    }
}

/// Adds a frame that ends the link.
pub(super) fn add_close(out: &mut BytesMut, fault: Fault, mask: Option<[u8; 4]>) {
    let status = fault.status.to_be_bytes();
    add(out, CLOSE, true, &[&status, fault.text.as_bytes()], mask);
}

/// Masks bytes, or takes the mask off them; `at` = how many bytes of the frame went before.
pub(super) fn apply(bytes: &mut [u8], mask: [u8; 4], at: usize) {
    let turned: [u8; 4] = std::array::from_fn(|place| mask[(place + at) % 4]);
    let [a, b, c, d] = turned;
    let word = u64::from_ne_bytes([a, b, c, d, a, b, c, d]);
    let mut words = bytes.chunks_exact_mut(8);
    for chunk in &mut words {
        let mut eight = [0; 8];
        eight.copy_from_slice(chunk);
        chunk.copy_from_slice(&(u64::from_ne_bytes(eight) ^ word).to_ne_bytes());
    }
    for (place, byte) in words.into_remainder().iter_mut().enumerate() {
        *byte ^= turned[place % 4];
    }
}

/// What arrives.
#[derive(Debug, Default)]
pub(super) struct Incoming {
    /// The head of a frame as far as it is here.
    head: [u8; 14],
    have: u8,
    /// The frame whose payload arrives, if its head is here.
    frame: Option<Frame>,
    /// Fragments of a message have come, and more will.
    in_message: bool,
    /// Frames without payload that have come.
    idle: Gcra,
    /// The payload of a control frame.
    control: Vec<u8>,
    /// A character of a text whose end is still to come.
    character: Vec<u8>,
    /// Where messages are text, what is compressed comes in binary ones.
    pub(super) takes_binary: bool,
    /// The message that comes is binary.
    is_binary: bool,
    /// The other side has said that it says no more.
    pub(super) closed: bool,
    /// It has said that it will not come back, as browsers do for a page that is left; a network that fails says nothing.
    pub(super) left: bool,
}

#[derive(Clone, Copy, Debug)]
struct Frame {
    kind: u8,
    last: bool,
    mask: Option<[u8; 4]>,
    size: u64,
    left: u64,
}

/// What both ends of a link have agreed on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rules {
    /// Messages are text of one line each, else bytes.
    pub(super) text: bool,
    /// This is the client's end, which masks what it sends.
    pub(super) client: bool,
}

impl Rules {
    /// The mask of the next frame that is sent.
    pub(super) fn mask(self) -> Option<[u8; 4]> {
        self.client.then(|| {
            let mut mask = [0; 4];
            // A system without randomness; the mask protects proxies from pages, and no page is here.
            let _ = getrandom::fill(&mut mask);
            mask
        })
    }
}

impl Incoming {
    /// Takes frames apart: what is for the reader goes to `room`, answers to the other side to `out`. `now` counts from anywhere.
    pub(super) fn take(
        &mut self,
        mut arrived: &mut [u8],
        rules: Rules,
        room: &mut impl BufMut,
        out: &mut BytesMut,
        now: Micros,
    ) -> Result<(), Fault> {
        while !self.closed {
            let mut frame = match self.frame {
                Some(frame) => frame,
                None => match self.take_head(&mut arrived, rules)? {
                    Some(frame) => {
                        self.count_idle(&frame, now)?;
                        frame
                    }
                    None => return Ok(()),
                },
            };
            let here = usize::try_from(frame.left)
                .unwrap_or(usize::MAX)
                .min(arrived.len());
            let (payload, rest) = arrived.split_at_mut(here);
            arrived = rest;
            if let Some(mask) = frame.mask {
                apply(payload, mask, ((frame.size - frame.left) % 4) as usize);
            }
            frame.left -= here as u64;
            self.frame = Some(frame).filter(|frame| frame.left > 0);
            match frame.kind {
                CLOSE | PING | PONG => {
                    self.control.extend_from_slice(payload);
                    if frame.left == 0 {
                        self.heed(frame.kind, rules, out)?;
                    }
                }
                _ => {
                    self.in_message = !frame.last || frame.left > 0;
                    // One that comes in fragments is of the kind of its first.
                    if frame.kind != CONTINUATION {
                        self.is_binary = frame.kind == BINARY;
                    }
                    let is_text = rules.text && !self.is_binary;
                    if is_text {
                        self.check_text(payload)?;
                    }
                    put(payload, is_text, room);
                    if is_text && !self.in_message {
                        room.put_u8(b'\n');
                    }
                }
            }
            if frame.left > 0 {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Reads the head of the next frame, once all of it is here.
    fn take_head(&mut self, arrived: &mut &mut [u8], rules: Rules) -> Result<Option<Frame>, Fault> {
        loop {
            let have = usize::from(self.have);
            let need = match have {
                0 | 1 => 2,
                _ => head_length(self.head[1]),
            };
            if have == need {
                self.have = 0;
                return self.read_head(rules).map(Some);
            }
            let bytes = std::mem::take(arrived);
            let here = (need - have).min(bytes.len());
            let (more, rest) = bytes.split_at_mut(here);
            self.head[have..have + here].copy_from_slice(more);
            *arrived = rest;
            self.have += here as u8;
            if here == 0 {
                return Ok(None);
            }
        }
    }

    fn read_head(&self, rules: Rules) -> Result<Frame, Fault> {
        let head = self.head;
        let (kind, last) = (head[0] & 0x0f, head[0] & LAST != 0);
        if head[0] & 0x70 != 0 {
            return Err(fault("reserved bits are set, and no extension was agreed on"));
        }
        if (head[1] & MASKED != 0) == rules.client {
            return Err(fault("a client masks its frames, and a server does not"));
        }
        let size = match head[1] & 0x7f {
            126 => u64::from(u16::from_be_bytes([head[2], head[3]])),
            127 => {
                let mut size = [0; 8];
                size.copy_from_slice(&head[2..10]);
                u64::from_be_bytes(size)
            }
            size => u64::from(size),
        };
        if size > i64::MAX as u64 {
            return Err(fault("the frame is too large"));
        }
        match kind {
            CLOSE | PING | PONG if size > CONTROL || !last => {
                return Err(fault(
                    "a control frame must not be fragmented or exceed 125 bytes",
                ));
            }
            CLOSE | PING | PONG => {}
            CONTINUATION if !self.in_message => return Err(fault("there is no message to continue")),
            TEXT | BINARY if self.in_message => return Err(fault("the previous message is not complete")),
            TEXT if !rules.text => return Err(of_kind("mom.bin.v1 takes binary messages")),
            BINARY if rules.text && !self.takes_binary => {
                return Err(of_kind("mom.json.v1 takes text messages"));
            }
            CONTINUATION | TEXT | BINARY => {}
            _ => return Err(fault("a frame of this kind does not exist")),
        }
        let mask = (!rules.client).then(|| {
            let at = head_length(head[1]) - 4;
            [head[at], head[at + 1], head[at + 2], head[at + 3]]
        });
        Ok(Frame {
            kind,
            last,
            mask,
            size,
            left: size,
        })
    }

    /// Counts a frame that brings nothing.
    fn count_idle(&mut self, frame: &Frame, now: Micros) -> Result<(), Fault> {
        // An empty frame may end a message that came in fragments.
        let ends = frame.kind == CONTINUATION && frame.last;
        let idle = (frame.size == 0 && !ends) || matches!(frame.kind, PING | PONG);
        match idle && self.idle.take(&IDLE, 1, now).is_err() {
            true => Err(Fault {
                status: 1008,
                text: "at most 100 control frames and empty frames a second, and 1000 at once",
            }),
            false => Ok(()),
        }
    }

    /// Checks that a text is one, as far as it has come.
    fn check_text(&mut self, mut payload: &[u8]) -> Result<(), Fault> {
        // At most four bytes are one.
        while let Some((first, rest)) = payload.split_first().filter(|_| !self.character.is_empty()) {
            self.character.push(*first);
            payload = rest;
            match std::str::from_utf8(&self.character) {
                Ok(_) => self.character.clear(),
                Err(error) if error.error_len().is_some() => return Err(NO_TEXT),
                Err(_) => {}
            }
        }
        if let Err(error) = std::str::from_utf8(payload) {
            if error.error_len().is_some() {
                return Err(NO_TEXT);
            }
            self.character.extend_from_slice(&payload[error.valid_up_to()..]);
        }
        match self.in_message || self.character.is_empty() {
            true => Ok(()),
            false => Err(NO_TEXT),
        }
    }

    /// Does what a control frame asks for.
    fn heed(&mut self, kind: u8, rules: Rules, out: &mut BytesMut) -> Result<(), Fault> {
        let payload = std::mem::take(&mut self.control);
        match kind {
            PING if out.len() < ANSWERS => add(out, PONG, true, &[&payload], rules.mask()),
            CLOSE => {
                check_close(&payload)?;
                self.closed = true;
                self.left = payload.starts_with(&LEFT.status.to_be_bytes());
            }
            _ => {}
        }
        Ok(())
    }
}

/// Checks why the other side says that it closes: nothing, or a status that may be sent and words (RFC 6455, 5.5.1 and 7.4).
fn check_close(payload: &[u8]) -> Result<(), Fault> {
    let (status, words) = match payload {
        [] => return Ok(()),
        [first, second, words @ ..] => (u16::from_be_bytes([*first, *second]), words),
        [_] => return Err(fault("a status has two bytes")),
    };
    if !matches!(status, 1000..=1003 | 1007..=1014 | 3000..=4999) {
        return Err(fault("this status is not allowed in a close frame"));
    }
    std::str::from_utf8(words).map(drop).map_err(|_| NO_TEXT)
}

fn of_kind(text: &'static str) -> Fault {
    Fault { status: 1003, text }
}

/// How long a head is whose second byte this is.
fn head_length(second: u8) -> usize {
    let size = match second & 0x7f {
        126 => 2,
        127 => 8,
        _ => 0,
    };
    2 + size + if second & MASKED != 0 { 4 } else { 0 }
}

/// Passes payload to the reader. A line end inside a text is a blank of JSON, but would end a frame of the form that is
/// made of lines.
fn put(payload: &mut [u8], is_text: bool, room: &mut impl BufMut) {
    if is_text {
        let mut from = 0;
        while let Some(at) = memchr::memchr(b'\n', &payload[from..]) {
            payload[from + at] = b'\r';
            from += at + 1;
        }
    }
    room.put_slice(payload);
}
