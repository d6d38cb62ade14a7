//! The states of the paper, why a connection ends, and what becomes of a command.

use std::fmt;
use std::sync::Arc;

use super::{MOST_UNANSWERED, MOST_WAITING};

/// What a connection is, seen from the base station (W11).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// Nobody asked for a connection, or as many attempts as [`Options::attempts`](super::Options::attempts) allows
    /// have failed. There is none, and none is attempted.
    Disconnected,
    /// A connection is wanted and there is none: one is being made, or the next attempt waits for its time.
    Trying,
    /// The TCP connection is up, and the robot does not take commands: it has said nothing yet (a NULL is under way; a
    /// listening robot that serves another station lets TCP connect too), or only who holds it, or takes no more bytes.
    Connected,
    /// The TCP connection is up, the robot has said something, and bytes can be written: it takes commands.
    Writable,
}

impl State {
    /// The word for it, as in the paper.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            State::Disconnected => "disconnected",
            State::Trying => "trying",
            State::Connected => "connected",
            State::Writable => "writable",
        }
    }

    /// Whether there is a TCP connection.
    #[must_use]
    pub const fn is_up(self) -> bool {
        matches!(self, State::Connected | State::Writable)
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.word())
    }
}

/// Why an attempt failed, or a connection ended.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum End {
    /// The attempt failed, in the words of the operating system or the resolver.
    Unreachable(Arc<str>),
    /// The attempt took too long.
    TimedOut,
    /// The robot closed it.
    Closed,
    /// It broke, in the words of the operating system.
    Broken(Arc<str>),
    /// A NULL had no reply, or the robot read nothing, within three periods in which the base station listened.
    Silent,
    /// More of what it sent was skipped than was read: [`mom_brs::MOST_ASTRAY`] bytes.
    Astray,
    /// It answered more than it was asked, or sent more than is read of a robot, for seconds.
    Flooding,
    /// Nobody wants it any more.
    Unwanted,
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            End::Unreachable(text) => write!(f, "cannot connect: {text}"),
            End::TimedOut => f.write_str("cannot connect: no answer in time"),
            End::Closed => f.write_str("the robot closed the connection"),
            End::Broken(text) => write!(f, "the connection broke: {text}"),
            End::Silent => f.write_str("the robot is silent"),
            End::Astray => f.write_str("the robot sent an invalid frame"),
            End::Flooding => f.write_str("the robot sent more than was requested"),
            End::Unwanted => f.write_str("disconnected on request"),
        }
    }
}

/// Why a frame is not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// There is no connection, or the robot has said nothing on it yet. A robot that serves another station would carry
    /// out what is sent now at some later time.
    #[error("it is {0}, so it takes no commands")]
    NotWritable(State),
    /// As many frames wait as may wait.
    #[error("{MOST_WAITING} commands are already queued for it")]
    Full,
    /// Too many NULLs have no reply yet.
    #[error("{MOST_UNANSWERED} NULLs have no reply yet")]
    Unanswered,
    /// It is a reply, or a command that base stations never send.
    #[error("it is not a command")]
    NoCommand,
}

/// What became of a frame that is not refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// It goes out, after those that wait.
    Queued,
    /// It goes out, and so many commands that waited do not: it overrides them, or has taken the place of one.
    Replaced(usize),
}
