//! What the middle's end tells its program, and what it is told.

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

use crate::Key;

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// There is a session. All elements are active, and nothing is confirmed.
    Up,
    /// Nothing was heard for too long: the session is over, and another one is asked for.
    Lost,
    /// The session was ended, by either end; nothing is asked for until [`start`](super::Middle::start).
    Ended,
    /// The robot gives no session; it is asked again. Told once for each reason in a row; who comes later asks for
    /// [`refusal`](super::Middle::refusal).
    Refused(Refusal),
    /// A sensor or monitor was heard: [`read`](super::Middle::read) it. At most one waits for each element.
    Changed {
        /// The element.
        element: u8,
    },
    /// An event or memory event; each once, those of an element in order (S21, S22).
    Raised {
        /// The element.
        element: u8,
        /// Its id.
        id: u8,
        /// Its data.
        data: Vec<u8>,
        /// When the packet left, ms of the robot's clock.
        stamp: u32,
        /// When it arrived, µs.
        at: u64,
    },
    /// A command was executed (S19, S20).
    Done {
        /// The element.
        element: u8,
        /// What [`command`](super::Middle::command) gave.
        ticket: u32,
        /// From its first packet to its acknowledgement, µs.
        after: u64,
    },
    /// A memory command was sent and not acknowledged, in paper mode: it may be executed, or not.
    Failed {
        /// The element.
        element: u8,
        /// What [`command`](super::Middle::command) gave.
        ticket: u32,
    },
    /// The session is over, or the command was deactivated, before it was acknowledged: it was executed once, or not at all. It is never
    /// sent again.
    Unknown {
        /// The element.
        element: u8,
        /// What [`command`](super::Middle::command) gave.
        ticket: u32,
    },
    /// The robot has confirmed that an element is active, or is not (S7).
    Active {
        /// The element.
        element: u8,
        /// Whether it is.
        active: bool,
    },
    /// A blob is complete.
    Blob {
        /// The element.
        element: u8,
        /// Its number.
        blob: u16,
        /// Its bytes.
        bytes: Vec<u8>,
    },
}

/// Why a robot gives no session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reason {
    /// Its model is another one.
    Model,
    /// It has a session.
    Busy,
    /// It speaks another version.
    Version,
}

/// A refusal, with what was wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub reason: Reason,
    /// The elements that differ between the two models, by name, as far as the robot could tell; those that one of them lacks are among
    /// them.
    pub differs: Vec<String>,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.reason {
            Reason::Busy => f.write_str("the robot has another session"),
            Reason::Version => f.write_str("the robot speaks another version of the protocol"),
            Reason::Model if self.differs.is_empty() => f.write_str("the robot has another model"),
            Reason::Model => write!(
                f,
                "the robot has another model, which differs in {}",
                self.differs.join(", ")
            ),
        }
    }
}

/// A value that was heard, or confirmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading<'v> {
    /// The bytes, as on the wire; of elements of type bytes without their number.
    pub value: &'v [u8],
    /// When it was heard or confirmed, µs.
    pub at: u64,
    /// When the packet left that told it, ms of the robot's clock.
    pub stamp: u32,
}

/// What the robot's clock shows beside the middle's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offset {
    /// The robot's clock less the middle's, µs.
    pub offset: i64,
    /// The truth is at most so far from it, µs, if both directions have any delays and the clocks drift apart by no more than 100 ppm.
    pub error: u64,
}

/// Where a middle's end is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// It asks for nothing.
    Idle,
    /// It asks for a session.
    Calling,
    /// It has a session.
    Up,
    /// It waits for the robot's word that the session is over.
    Ending,
}

/// How a middle's end works.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The key that is shared with the robot; `None` for packets in the open. One needs the feature `cipher`.
    pub key: Option<Key>,
    /// Time between two data packets of either end, ms: one of [`PERIODS`](crate::PERIODS) (S10).
    pub period: u16,
    /// To the letter of the paper (S19 to S23): no watchdog, all activated elements in each packet, memory commands and memory events sent
    /// once, increments as they are.
    pub paper: bool,
    /// After so many ms without a packet the session is lost.
    pub silence: u16,
    /// Bytes of fragments that are sent each period at most.
    pub budget: u16,
    /// Commands of one element that can wait behind the one that is under way.
    pub queue: usize,
    /// The largest blob that is put together or taken for sending, bytes.
    pub blob: usize,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            key: None,
            period: 20,
            paper: false,
            silence: 500,
            budget: 1000,
            queue: 16,
            blob: 1 << 20,
        }
    }
}

/// Why there can be no middle's end with these settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MiddleFault {
    /// The period is not one of [`PERIODS`](crate::PERIODS).
    Period,
    /// A key needs the feature `cipher`.
    Cipher,
}

impl fmt::Display for MiddleFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            MiddleFault::Period => "the period is not between 1 and 200 ms",
            MiddleFault::Cipher => "a key needs the feature `cipher`",
        })
    }
}

impl core::error::Error for MiddleFault {}
