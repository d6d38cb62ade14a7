//! The doors of the hub: what carries the bytes of a form, and what else can be said there.

use std::io;
use std::time::Duration;

use bytes::BytesMut;
use fastrand::Rng;
use mom_net::Door;
use mom_proto::codec::Form;

use super::pipe::{Pipe, Route};
use crate::asking::upgrade;
use crate::bridge::Way;
use crate::bridge::websocket::take;

const LAST: u8 = 0x80;
const TEXT: u8 = 1;
const BINARY: u8 = 2;
const CLOSE: u8 = 8;
const PING: u8 = 9;

/// Brought up by one request of a tunnel: less than a stranger may, and less than a peer may.
const MOST_BEFORE_LOGIN: usize = 8 * 1024;
const MOST_UP: usize = 120 * 1024;

/// All ways into the hub, each with the forms that it carries.
pub(super) fn ways() -> Vec<(Form, Way)> {
    let doors = [Door::Stream, Door::WebSocket, Door::Tunnel { polled: true }];
    let forms = Form::ALL.into_iter().chain([Form::Packed]);
    let mut ways = Vec::new();
    for form in forms {
        for door in doors {
            let ways_of = [false, true].map(|tls| (form, Way { door, tls }));
            if form != Form::Xml || door != Door::WebSocket {
                ways.extend(ways_of);
            }
        }
    }
    ways
}

/// A way to the hub that is open.
#[derive(Debug)]
pub(super) struct Line {
    pipe: Pipe,
    route: Route,
    carrier: Carrier,
}

#[derive(Debug)]
enum Carrier {
    Stream,
    WebSocket {
        text: bool,
        /// A message was begun and not ended.
        in_message: bool,
        arrived: BytesMut,
    },
    Tunnel {
        id: String,
        at: usize,
        heard: usize,
        most: usize,
        down: Option<Pipe>,
    },
}

impl Line {
    pub(super) async fn open(route: Route, form: Form, door: Door) -> io::Result<Line> {
        let mut pipe = Pipe::open(route).await?;
        let carrier = match door {
            Door::Stream => Carrier::Stream,
            Door::WebSocket => {
                let text = form == Form::Json;
                let lines = upgrade(if text { "mom.json.v1" } else { "mom.bin.v1" });
                let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
                let answer = pipe.ask("GET /mom", &lines, b"").await?;
                if answer.status != 101 {
                    return Err(io::Error::other("no WebSocket"));
                }
                Carrier::WebSocket {
                    text,
                    in_message: false,
                    arrived: answer.body,
                }
            }
            Door::Tunnel { .. } => {
                let answer = pipe.ask("POST /tunnel", &["Host: 127.0.0.1"], b"").await?;
                let id = answer.header("mom-tunnel");
                Carrier::Tunnel {
                    id: id.ok_or_else(|| io::Error::other("no tunnel"))?.to_owned(),
                    at: 0,
                    heard: 0,
                    most: MOST_BEFORE_LOGIN,
                    down: None,
                }
            }
        };
        Ok(Line { pipe, route, carrier })
    }

    /// Whether nobody sees when its peer has gone, but by silence.
    pub(super) fn is_tunnel(&self) -> bool {
        matches!(self.carrier, Carrier::Tunnel { .. })
    }

    pub(super) async fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self.carrier {
            Carrier::Stream => self.pipe.write(bytes).await,
            Carrier::WebSocket { text, in_message, .. } => {
                let framed = match *text {
                    true => lines(bytes, in_message),
                    false => bytes
                        .chunks(60_000)
                        .flat_map(|piece| frame(LAST | BINARY, piece))
                        .collect(),
                };
                self.pipe.write(&framed).await
            }
            Carrier::Tunnel { id, at, most, .. } => {
                let mut left = bytes;
                while !left.is_empty() {
                    let piece = &left[..left.len().min(*most)];
                    let first = format!("POST /tunnel/{id}?at={at}");
                    let answer = self.pipe.ask(&first, &["Host: 127.0.0.1"], piece).await?;
                    if let Some(new) = answer.header("mom-tunnel") {
                        *id = new.to_owned();
                        *most = MOST_UP;
                    }
                    match answer.status {
                        200 => {
                            *at += piece.len();
                            left = &left[piece.len()..];
                        }
                        // It has more than it has read: the same again, until the peer has had enough.
                        503 => tokio::time::sleep(Duration::from_millis(5)).await, // tidy: what a client has to do then
                        status => return Err(io::Error::other(format!("{status}"))),
                    }
                }
                Ok(())
            }
        }
    }

    /// Reads what there is, at most so many bytes at once; the end is an error.
    pub(super) async fn read(&mut self, into: &mut BytesMut, most: usize) -> io::Result<()> {
        match &mut self.carrier {
            Carrier::Stream => self.pipe.read(into, most).await,
            Carrier::WebSocket { arrived, text, .. } => {
                self.pipe.read(arrived, most).await?;
                while let Some((first, payload)) = take(arrived) {
                    match first & 0x0f {
                        CLOSE => return Err(io::ErrorKind::UnexpectedEof.into()),
                        0..=BINARY => into.extend_from_slice(&payload),
                        // A pong may come between the parts of a message.
                        _ => continue,
                    }
                    if *text && first & LAST != 0 {
                        into.extend_from_slice(b"\n");
                    }
                }
                Ok(())
            }
            Carrier::Tunnel { id, heard, down, .. } => {
                // Who does not wait for the answer does not read it as the next one's.
                let mut pipe = match down.take() {
                    Some(pipe) => pipe,
                    None => Pipe::open(self.route).await?,
                };
                let first = format!("GET /tunnel/{id}?at={heard}&wait=1");
                let answer = pipe.ask(&first, &["Host: 127.0.0.1"], b"").await?;
                *down = Some(pipe);
                if answer.status != 200 || answer.header("mom-end").is_some() {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                *heard += answer.body.len();
                into.extend_from_slice(&answer.body);
                Ok(())
            }
        }
    }

    /// What can be said at this door beside the bytes that it carries; it may end by that.
    pub(super) async fn stray(&mut self, rng: &mut Rng) -> io::Result<()> {
        match &mut self.carrier {
            Carrier::Stream => match self.route.tls {
                // Records without content, and one that is none.
                true if rng.u8(..8) == 0 => self.pipe.write_below(&[23, 3, 3, 0, 1, 0]).await,
                true => self.pipe.write(b"").await,
                false => Ok(()),
            },
            Carrier::WebSocket { .. } => self.pipe.write(&stray_frame(rng)).await,
            Carrier::Tunnel { id, at, heard, .. } => {
                let request = match rng.u8(..8) {
                    0 => format!("POST /tunnel/{id}?at={}", *at + 7),
                    1 => format!("POST /tunnel/{id}?at={}", at.saturating_sub(3)),
                    2 => format!("POST /tunnel/{id}?at={at}&ack={heard}"),
                    3 => format!("GET /tunnel/{}?at=0&wait=0", "0".repeat(32)),
                    4 => format!("GET /tunnel/{id}?at={}&wait=0", *heard + 1000),
                    5 => format!("POST /tunnel/{id}?at={at}&end=1"),
                    6 => "GET /metrics".to_owned(),
                    _ => format!("DELETE /tunnel/{id}"),
                };
                let body: &[u8] = if request.contains("at=") && request.starts_with("POST") {
                    b""
                } else {
                    b"?"
                };
                self.pipe
                    .ask(&request, &["Host: 127.0.0.1"], body)
                    .await
                    .map(|_| ())
            }
        }
    }

    /// Bytes at the door itself, which is nobody's form.
    pub(super) async fn send_below(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.pipe.write(bytes).await
    }

    /// A stream that is asked for and not read, as of a browser that was closed.
    pub(super) async fn abandon(&mut self) -> io::Result<()> {
        let Carrier::Tunnel { id, heard, .. } = &self.carrier else {
            return Ok(());
        };
        let first = format!("GET /tunnel/{id}?at={heard}");
        let request = crate::asking::request(&first, &["Host: 127.0.0.1"], b"");
        Pipe::open(self.route).await?.write(&request).await
    }

    pub(super) async fn half_close(&mut self) -> io::Result<()> {
        self.pipe.half_close().await
    }

    /// A close as of a browser that leaves the page; elsewhere nothing.
    pub(super) async fn close(&mut self) -> io::Result<()> {
        match &self.carrier {
            Carrier::WebSocket { .. } => {
                self.pipe
                    .write(&frame(LAST | CLOSE, &1001_u16.to_be_bytes()))
                    .await
            }
            Carrier::Tunnel { id, at, .. } => {
                let first = format!("POST /tunnel/{id}?at={at}&end=1");
                self.pipe.ask(&first, &["Host: 127.0.0.1"], b"").await.map(|_| ())
            }
            Carrier::Stream => Ok(()),
        }
    }

    pub(super) fn reset(self) {
        self.pipe.reset();
    }
}

/// Messages of text, a line each; one that is not whole yet begins it.
fn lines(bytes: &[u8], in_message: &mut bool) -> Vec<u8> {
    let mut framed = Vec::with_capacity(bytes.len() + 64);
    for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
        let (line, ended) = match piece.strip_suffix(b"\n") {
            Some(line) => (line, LAST),
            None => (piece, 0),
        };
        let mut pieces = line.chunks(60_000).peekable();
        if pieces.peek().is_none() {
            framed.extend(frame(kind(*in_message) | ended, &[]));
            *in_message = ended == 0;
        }
        while let Some(piece) = pieces.next() {
            let last = if pieces.peek().is_none() { ended } else { 0 };
            framed.extend(frame(kind(*in_message) | last, piece));
            *in_message = last == 0;
        }
    }
    framed
}

fn kind(in_message: bool) -> u8 {
    if in_message { 0 } else { TEXT }
}

/// A frame of a client, whose mask changes nothing.
fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let size = u16::try_from(payload.len()).expect("a small frame");
    match u8::try_from(size).ok().filter(|size| *size < 126) {
        Some(size) => [&[first, 0x80 | size][..], &[0; 4], payload].concat(),
        None => [&[first, 0x80 | 126][..], &size.to_be_bytes(), &[0; 4], payload].concat(),
    }
}

/// Control frames, and what RFC 6455 forbids.
fn stray_frame(rng: &mut Rng) -> Vec<u8> {
    let text = vec![b'p'; rng.usize(..126)];
    match rng.u8(..80) {
        0 => frame(LAST | PING, &[0; 300]),
        1 => frame(PING, b"cut"),
        2 => frame(LAST | 3, b"?"),
        3 => frame(LAST | 0x40 | BINARY, b"?"),
        4 => [&[LAST | TEXT, 2][..], b"{}"].concat(),
        5 => frame(LAST | CLOSE, &[3]),
        6 => frame(LAST | CLOSE, &[0x03, 0xe8, 0xff, 0xfe]),
        7 => frame(LAST | TEXT, &[0xff, 0xfe]),
        8 => vec![
            LAST | BINARY,
            0xff,
            0x7f,
            0xff,
            0xff,
            0xff,
            0xff,
            0xff,
            0xff,
            0xff,
        ],
        9 => frame(LAST | CLOSE, b""),
        10 => frame(0, b""),
        11 => frame(BINARY, b""),
        12..40 => frame(LAST | (PING + 1), &text),
        _ => frame(LAST | PING, &text),
    }
}
