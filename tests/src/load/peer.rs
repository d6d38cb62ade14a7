//! A peer of the load: says what comes to its mind, hears what it wants to, and leaves as it likes.

use std::io;
use std::time::Duration;

use bytes::BytesMut;
use mom_net::Door;
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Decoder, Form, Frame};
use mom_proto::{Code, Family, Limits, Map, Parcel};
use tokio::time::timeout;

use super::Mind;
use super::chance::{Link, one_in};
use super::doors::Line;
use super::frames::{Shape, shaped};
use super::pipe::Route;

/// How long it waits for the hub to take what it says: that may hold a sender back that reads nothing.
const PATIENCE: Duration = Duration::from_millis(500);

/// How long it waits for the answer to a login.
const LOGIN: Duration = Duration::from_secs(5);

/// The most that is said in one turn: a generator has a bound, too.
const MOST: usize = 12 << 20;

/// How a peer reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Habit {
    All,
    Seldom,
    ByteByByte,
    Nothing,
}

impl Habit {
    pub(super) const ALL: [Habit; 4] = [Habit::All, Habit::Seldom, Habit::ByteByByte, Habit::Nothing];
}

/// How a peer leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    End,
    Reset,
    HalfClosed,
    Closed,
    InFrame,
    Logout,
}

impl Way {
    pub(super) const ALL: [Way; 6] = [
        Way::End,
        Way::Reset,
        Way::HalfClosed,
        Way::Closed,
        Way::InFrame,
        Way::Logout,
    ];
}

#[derive(Debug)]
pub(super) struct Peer {
    line: Line,
    form: Form,
    decoder: Decoder,
    input: BytesMut,
    habit: Habit,
    logged_in: bool,
    /// It goes on with a link.
    pub(super) is_back: bool,
    last_id: u64,
    pub(super) link: Option<Link>,
}

impl Peer {
    /// One that has come through a door and says what a form begins with.
    pub(super) async fn come(route: Route, form: Form, door: Door, habit: Habit) -> io::Result<Peer> {
        let mut line = Line::open(route, form, door).await?;
        let limits = Limits::default();
        let mut decoder = match form.is_binary() {
            true => Decoder::Binary(Box::new(BinaryDecoder::for_peer(&limits))),
            false => Decoder::new(form, &limits),
        };
        // A later login may agree on it.
        decoder.take_packed();
        if form.is_binary() {
            line.send(&PREFACE).await?;
        }
        Ok(Peer {
            line,
            form,
            decoder,
            input: BytesMut::new(),
            habit,
            logged_in: false,
            is_back: false,
            last_id: 0,
            link: None,
        })
    }

    /// Stays, as one that has logged in or as a stranger.
    pub(super) async fn settle(&mut self, mind: &mut Mind, back: bool) -> bool {
        if !back && one_in(&mut mind.rng, 8) {
            mind.done("stranger");
            return true;
        }
        self.logged_in = matches!(timeout(LOGIN, self.log_in(mind, back)).await, Ok(true));
        self.logged_in && matches!(timeout(PATIENCE, self.join(mind)).await, Ok(Ok(())))
    }

    async fn join(&mut self, mind: &mut Mind) -> io::Result<()> {
        for join in mind.joins() {
            self.send_parcel(&join).await?;
        }
        Ok(())
    }

    pub(super) fn decoder(&mut self) -> &mut Decoder {
        &mut self.decoder
    }

    pub(super) fn is_packed(&self) -> bool {
        self.form == Form::Packed
    }

    /// A few things said, and what is heard; whether it stays.
    pub(super) async fn turn(&mut self, mind: &mut Mind) -> bool {
        let bytes = self.words(mind);
        let said = timeout(PATIENCE, self.say(mind, &bytes)).await;
        if !matches!(said, Ok(Ok(()))) {
            return false;
        }
        let stays = match self.habit {
            Habit::Nothing => true,
            Habit::Seldom if mind.rng.bool() => true,
            Habit::Seldom | Habit::All => self.hear(mind, 1 << 20, 1000).await,
            Habit::ByteByByte => self.hear(mind, 3, 200).await,
        };
        // Who hears nothing stays for longer, so that much can wait for it.
        stays && !one_in(&mut mind.rng, if self.habit == Habit::Nothing { 400 } else { 40 })
    }

    /// The bytes of some parcels, most of them right.
    fn words(&mut self, mind: &mut Mind) -> Vec<u8> {
        if one_in(&mut mind.rng, 20) {
            return self.storm(mind);
        }
        let mut bytes = Vec::new();
        for _ in 0..mind.rng.usize(1..20) {
            if bytes.len() > MOST / 3 {
                break;
            }
            mind.steps += 1;
            self.last_id += 1;
            let (parcel, verb) = mind.parcel(self.last_id, self.form);
            // What has no form on the wire is not said.
            let Ok(frame) = self.form.encode(&parcel) else {
                continue;
            };
            let shape = self.shape(mind);
            mind.said(parcel.family, verb, shape);
            let frame = shaped(&mut mind.rng, self.form, shape, frame.to_vec());
            bytes.extend(frame);
        }
        bytes
    }

    /// The same large message again and again, which nothing may drop: a peer that reads nothing has much waiting.
    fn storm(&mut self, mind: &mut Mind) -> Vec<u8> {
        let parcel = mind.large();
        let Ok(frame) = self.form.encode(&parcel) else {
            return Vec::new();
        };
        let frame = frame.to_vec();
        let times = (mind.rng.usize(..MOST / 2) / frame.len()).max(1);
        mind.steps += 1;
        mind.done("storm");
        frame.repeat(times)
    }

    fn shape(&self, mind: &mut Mind) -> Shape {
        let shape = match mind.rng.u8(..64) {
            0 => mind.shapes[usize::from(self.form.is_binary())].draw(&mut mind.rng),
            1..8 => [Shape::Chunked, Shape::Aborted, Shape::Unknown, Shape::Empty][mind.rng.usize(..4)],
            _ => Shape::Whole,
        };
        if shape.is_of(self.form) {
            shape
        } else {
            Shape::Whole
        }
    }

    async fn say(&mut self, mind: &mut Mind, bytes: &[u8]) -> io::Result<()> {
        match mind.rng.u8(..12) {
            0 => {
                self.line.stray(&mut mind.rng).await?;
                mind.done("stray");
            }
            1 if self.line.is_tunnel() => self.line.abandon().await?,
            _ => {}
        }
        match bytes.len() < 600 && one_in(&mut mind.rng, 4) {
            true => {
                for byte in bytes.chunks(1) {
                    self.line.send(byte).await?;
                }
                Ok(())
            }
            false => self.line.send(bytes).await,
        }
    }

    /// Hears what there is, so many bytes at once and so many times at most; whether the connection goes on.
    async fn hear(&mut self, mind: &mut Mind, piece: usize, times: usize) -> bool {
        // A tunnel waits for an answer each time.
        let (patience, times) = match self.line.is_tunnel() {
            true => (PATIENCE, times.min(2)),
            false => (Duration::ZERO, times),
        };
        for _ in 0..times {
            match timeout(patience, self.line.read(&mut self.input, piece)).await {
                Err(_) => return true,
                Ok(Err(_)) => return false,
                Ok(Ok(())) => {}
            }
            while let Some(parcel) = self.next(mind) {
                let Some(parcel) = parcel else { return false };
                if parcel.is(Family::Time, "ping") {
                    let mut pong = Parcel::new(Family::Time, "pong");
                    pong.reference = parcel.id;
                    if !matches!(timeout(PATIENCE, self.send_parcel(&pong)).await, Ok(Ok(()))) {
                        return false;
                    }
                }
            }
        }
        true
    }

    /// A parcel that has come, if one has; none in it if the hub speaks another form to refuse a stranger.
    ///
    /// # Panics
    /// If what the hub says is not well-formed.
    fn next(&mut self, mind: &mut Mind) -> Option<Option<Parcel>> {
        let parcel = match self.decoder.decode(&mut self.input) {
            Ok(None) => return None,
            Ok(Some(Frame::Parcel(parcel))) => *parcel,
            // To whom has begun in no form the hub says so in its own.
            Ok(Some(Frame::Malformed { .. })) if !self.logged_in => return Some(None),
            Ok(Some(Frame::Malformed { error, .. })) => panic!("the hub says to {self:?}: {error}"),
            Err(_) if !self.logged_in => return Some(None),
            // The numbers of contexts hold for all connections of a link, and this generator forgets them.
            Err(error) if self.is_back && error.code == Code::BAD_FRAME => return Some(None),
            Err(error) => panic!("the hub says to {self:?}: {error}"),
        };
        if let Some(link) = self.link.as_mut().filter(|_| parcel.family != Family::Time) {
            link.read.count(Some(parcel.checksum_word()));
        }
        mind.known.hear(&parcel);
        Some(Some(parcel))
    }

    pub(super) async fn send_parcel(&mut self, parcel: &Parcel) -> io::Result<()> {
        match self.form.encode(parcel) {
            Ok(frame) => self.line.send(&frame.to_vec()).await,
            Err(error) => Err(io::Error::other(error)),
        }
    }

    /// Asks something of family `login`, and waits for the answer.
    pub(super) async fn ask(&mut self, mind: &mut Mind, name: &str, content: Map) -> Option<Parcel> {
        self.last_id += 1;
        let id = self.last_id;
        let asked = Parcel::new(Family::Login, name).content(content).id(id);
        self.send_parcel(&asked).await.ok()?;
        loop {
            while let Some(parcel) = self.next(mind) {
                let parcel = parcel?;
                if parcel.reference == Some(id) {
                    return Some(parcel);
                }
            }
            self.line.read(&mut self.input, 1 << 16).await.ok()?;
        }
    }

    /// Leaves in this way; its link is for another to go on with.
    pub(super) async fn leave(mut self, mind: &mut Mind, way: Way) {
        self.give_up(mind);
        let parting = async {
            match way {
                Way::End | Way::Reset => {}
                Way::HalfClosed => {
                    self.line.half_close().await?;
                    let read = self.line.read(&mut self.input, 1 << 16);
                    let _ = timeout(Duration::from_millis(20), read).await;
                }
                Way::Closed => {
                    self.line.close().await?;
                    // And goes on, though nobody hears it.
                    self.line.send_below(b"after the end").await?;
                }
                Way::InFrame => {
                    let parcel = Parcel::new(Family::Message, "cut").content("x".repeat(5000));
                    let frame = self.form.encode(&parcel).map(|frame| frame.to_vec());
                    let frame = frame.unwrap_or_default();
                    self.line.send(&frame[..mind.rng.usize(..frame.len())]).await?;
                }
                Way::Logout => {
                    let logout = Parcel::new(Family::Login, "logout");
                    self.send_parcel(&logout).await?;
                    self.send_parcel(&Parcel::new(Family::Time, "ping")).await?;
                }
            }
            io::Result::Ok(())
        };
        // It may be gone already.
        let _ = timeout(PATIENCE, parting).await;
        if way == Way::Reset || mind.rng.bool() {
            self.line.reset();
        }
    }
}
