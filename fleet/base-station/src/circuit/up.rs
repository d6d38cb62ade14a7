//! What is known of a TCP connection to a robot while it is up.

use std::collections::VecDeque;

use mom_brs::{Command, Direction, Frame, Parser, Table};

use super::waiting::Waiting;
use super::{MOST_UNANSWERED, Refusal};

/// A TCP connection.
#[derive(Debug)]
pub(super) struct Up {
    pub(super) parser: Parser,
    /// When the last bytes came.
    pub(super) last_bytes: i64,
    /// Whether the robot has said anything but who holds it.
    pub(super) heard: bool,
    /// Since when nothing can be written.
    pub(super) blocked: Option<Since>,
    /// When the next NULL is due.
    pub(super) next_null: i64,
    /// When the NULLs were sent that have no reply yet; replies come in this order.
    pub(super) unanswered: VecDeque<Since>,
    /// How many NULLs have been sent and answered on this connection, and how many had been sent before the last stop, if one was.
    pub(super) nulls_sent: u64,
    pub(super) nulls_answered: u64,
    pub(super) nulls_before_stop: Option<u64>,
    /// How many replies are owed, and how many have come that were not, beyond those that were.
    pub(super) owed: u32,
    pub(super) unasked: u32,
    /// Since when there has been more to read than is read.
    pub(super) flood: Option<i64>,
    /// For how long this side was late altogether: nobody listened, so that the robot was not silent.
    pub(super) late: i64,
    pub(super) waiting: Waiting,
}

impl Up {
    /// One that is up since now.
    pub(super) fn new(table: &'static Table, now: i64) -> Up {
        Up {
            parser: Parser::new(table, Direction::Reply),
            last_bytes: now,
            heard: false,
            blocked: None,
            next_null: now,
            unanswered: VecDeque::new(),
            nulls_sent: 0,
            nulls_answered: 0,
            nulls_before_stop: None,
            owed: 0,
            unasked: 0,
            flood: None,
            late: 0,
            waiting: Waiting::default(),
        }
    }

    /// Drops what waits for a stop, and a NULL that shows that it was read.
    pub(super) fn stop(&mut self) -> Result<(), Refusal> {
        self.waiting.clear();
        let frame = |command, values| Frame::new(command, values).map_err(|_| Refusal::NoCommand);
        self.waiting.push(frame(&Command::MOTOR, &[0, 0])?)?;
        if self.unanswered.len() < MOST_UNANSWERED {
            self.waiting.push(frame(&Command::NULL, &[])?)?;
        }
        Ok(())
    }
}

/// A moment, and how late this side had been until then.
#[derive(Clone, Copy, Debug)]
pub(super) struct Since {
    pub(super) at: i64,
    pub(super) late: i64,
}
