//! A wireless network of 1 to 2 Mbit/s that all stations share (W19), in virtual time, without IO and without a clock.
//!
//! Stations send messages to each other, as datagrams or over TCP ([`Transport`]). A [`Radio`] says when each arrives, or that it is lost:
//! by the airtime of its frames and acknowledgements, by who sends when, by collisions, by loss over the distance ([`Loss`]), and by what
//! IP and TCP make of that. The same seed gives the same events. `docs/radio.md` has the equations and says where each number is from.
//!
//! ```
//! use mom_radio::{Fate, Position, Radio, Settings, Transport};
//!
//! let mut radio = Radio::new(Settings { rate: 1_000_000, ..Settings::default() });
//! let base = radio.add(Position::new(0.0, 0.0));
//! let robot = radio.add(Position::new(10.0, 0.0));
//! radio.send(1000, base, robot, 2, Transport::Tcp)?;
//! let outcome = radio.poll(1_000_000).expect("nothing is lost here");
//! // 192 µs of preamble, and 78 octets of 8 µs.
//! assert_eq!((outcome.at, outcome.fate), (1000 + 816, Fate::Delivered { attempts: 1 }));
//! # Ok::<(), mom_radio::SendError>(())
//! ```

mod loss;
mod medium;
mod messages;
mod radio;
mod settings;
mod stream;

pub use loss::{Loss, PathLoss, Position};
pub use radio::Radio;
pub use settings::{Access, Settings};

/// A time, or a duration, in µs.
pub type Micros = i64;

/// A station of a [`Radio`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Station(usize);

/// A message that was sent; each of a [`Radio`] is another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MessageId(u64);

/// How a message goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// UDP: 8 octets of UDP and 20 of IP; in fragments above the MTU, and lost if one of them is.
    Datagram,
    /// TCP: 20 octets of TCP and 20 of IP, over a connection that is there already. It arrives in order, or when the connection is
    /// [closed](Radio::close), not at all.
    Tcp,
}

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// It is there.
    Delivered {
        /// How often its frames were on the air.
        attempts: u32,
    },
    /// It never will be.
    Lost(Reason),
}

/// Why a message is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Reason {
    /// A frame of it was on the air as often as is allowed.
    GivenUp,
    /// The sender's queue was full.
    Overflow,
    /// The connection was closed.
    Closed,
}

/// A message, and what became of it. Each message that was sent has one, sooner or later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// The message.
    pub message: MessageId,
    /// Who sent it.
    pub from: Station,
    /// To whom.
    pub to: Station,
    /// When it was sent.
    pub sent: Micros,
    /// When it arrived or was lost.
    pub at: Micros,
    /// Which of these.
    pub fate: Fate,
}

/// Why a message is not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SendError {
    /// The network has no such station.
    #[error("the network has no station {}", .0.0)]
    NoStation(Station),
    /// It is for its sender.
    #[error("station {} sends to itself", .0.0)]
    ToItself(Station),
    /// It is longer than a datagram can be, or than 16 MiB.
    #[error("{0} octets are too many for one message")]
    TooLong(u32),
    /// Events after this time have been told already.
    #[error("{now} µs is before {past} µs, which has passed")]
    Past {
        /// When it was to be sent.
        now: Micros,
        /// How far the network is.
        past: Micros,
    },
}

/// What happened on a network so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames that went on the air, repeated ones each time.
    pub attempts: u64,
    /// How often several went on the air at once.
    pub collisions: u64,
    /// Attempts that were lost on the way, without a collision.
    pub losses: u64,
    /// Frames that were given up.
    pub given_up: u64,
    /// Frames that found a queue full.
    pub overflows: u64,
    /// Segments that TCP sent again.
    pub repeated: u64,
    /// Acknowledgements of TCP that went alone.
    pub pure_acks: u64,
    /// µs for which frames and acknowledgements were on the air, with the pause between them.
    pub busy: Micros,
}
