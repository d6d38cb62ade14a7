//! What a course waits for, and until when, ms.

use mom_client::Lost;

use crate::end::How;
use crate::heard::Report;

/// What is waited for.
#[derive(Debug)]
pub(super) enum Wait {
    Nothing,
    /// The state that a relative command is based on.
    State {
        since: u64,
    },
    /// That the device asks for its command.
    Next {
        since: u64,
    },
    Receipt {
        until: u64,
    },
    Answer {
        until: u64,
    },
    /// A command that the device has taken, by its id: when it last said something.
    Running {
        heard: u64,
        id: Option<u64>,
    },
    /// Whatever is in the way passes.
    Obstacle {
        report: Report,
        until: u64,
        /// When it is sent again without a word of the device.
        again: Option<u64>,
    },
    /// The hub's word, whether the token is lost; how it ends else.
    Asked {
        until: u64,
        end: How,
    },
    /// That the device says that it has ended what was begun under the token.
    Loss {
        until: u64,
        lost: Lost,
    },
    /// The hub has the token back.
    Release {
        until: u64,
    },
    /// The device says that it has ended the command; how often it was told to stop.
    Ended {
        until: u64,
        stops: u32,
    },
}
