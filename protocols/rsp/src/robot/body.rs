//! What a robot's own program gives to its end of the protocol.

use crate::{Fragment, Key};

/// The robot's own program: what is done with what arrives.
///
/// Its functions are called from [`receive`](super::Robot::receive), [`poll`](super::Robot::poll) and
/// [`end`](super::Robot::end), with elements of the right kind and bytes of the size that the model says. Numbers are as on
/// the wire, big-endian; of elements of type bytes it gets the bytes without their number.
pub trait Body {
    /// Fills the bytes with what nobody can foresee: nonces and sessions are made of it.
    fn random(&mut self, bytes: &mut [u8]);

    /// The motion filter has a new output (S12), one each period and never two within 7/8 of it: of an absolute effector its value, of an
    /// incremental one the step. Nothing new is not a call: hold. When nobody commands the effector, its safe value, at once.
    fn effector(&mut self, element: u8, value: &[u8]);

    /// Executes a command or a memory command: once for each id (S19, S20).
    fn command(&mut self, element: u8, data: &[u8]);

    /// A part of a blob is here; parts come in any order and may be lost.
    fn fragment(&mut self, fragment: Fragment<'_>) {
        let _ = fragment;
    }

    /// The next part of a blob for the middle, written into `into`, which takes [`FRAGMENT`](crate::FRAGMENT) bytes; `None` when
    /// there is none. It is sent behind a data packet, as far as the budget of the period goes.
    fn next_fragment(&mut self, into: &mut [u8]) -> Option<Outgoing> {
        let _ = into;
        None
    }

    /// An element was activated or deactivated (S6, S7). What a deactivated command has begun ends now, as does what a deactivated
    /// effector plays: so a robot is stopped.
    fn active(&mut self, element: u8, active: bool) {
        let _ = (element, active);
    }

    /// A session began; or it is over, and all effectors have their safe values: what commands have begun ends now, too. The next one
    /// numbers its blobs anew: what puts them together is cleared.
    fn session(&mut self, up: bool) {
        let _ = up;
    }

    /// The session ended before the middle said that an event or a memory event has arrived. It will not be sent again.
    fn unknown(&mut self, element: u8) {
        let _ = element;
    }
}

/// What [`Body::next_fragment`] has written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outgoing {
    /// The element that the blob is of.
    pub element: u8,
    /// Numbers the blobs of this element: each one more than the one before.
    pub blob: u16,
    /// Where the part is in the blob: a multiple of [`FRAGMENT`](crate::FRAGMENT).
    pub offset: u32,
    /// Bytes of the whole blob.
    pub total: u32,
    /// Bytes that were written: [`FRAGMENT`](crate::FRAGMENT), fewer only at the end of the blob.
    pub len: u16,
}

/// How a robot's end works.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The key that is shared with the middle; `None` for packets in the open. One needs the feature `cipher`.
    pub key: Option<Key>,
    /// After so many ms without a data packet the effectors get their safe values and the session is over; 0 for never. A middle in paper
    /// mode is trusted for ever.
    pub watchdog: u16,
    /// Bytes of fragments that are sent each period at most.
    pub budget: u16,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            key: None,
            watchdog: 500,
            budget: 1000,
        }
    }
}

/// Why there can be no robot's end with these buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotFault {
    /// `E` is not the number of its elements.
    Elements,
    /// `V` is less than [`values`](super::values) of the model.
    Values,
    /// `S` is less than [`slot`](super::slot) of the model, or `B` is more than 255.
    Buffers,
    /// A key needs the feature `cipher`.
    Cipher,
}

impl core::fmt::Display for RobotFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            RobotFault::Elements => "the robot has another number of elements than the model",
            RobotFault::Values => "the robot has too few bytes for the values of the model",
            RobotFault::Buffers => "the robot's buffers of memory events are too small, or too many",
            RobotFault::Cipher => "a key needs the feature `cipher`",
        })
    }
}

impl core::error::Error for RobotFault {}
