//! How a circuit behaves.

use mom_brs::SILENCE;

use super::SECOND;

/// How a circuit behaves; the times are µs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Between two NULLs (W8).
    pub null_period: i64,
    /// After so much silence within a frame, what is half read is dropped.
    pub idle: i64,
    /// Before the second attempt; before each further one it doubles.
    pub first_backoff: i64,
    /// The most between two attempts.
    pub most_backoff: i64,
    /// An attempt takes no longer.
    pub connect_timeout: i64,
    /// After so many failed attempts in a row it gives up; `None`: never.
    pub attempts: Option<u32>,
    /// The most bytes that are read of a robot in a second. The rest stays in the network, which slows the sender down.
    pub read_rate: u32,
}

/// NULL every 10 s; the wire's [`SILENCE`]; attempts after 0.5 s to 10 s, each of 5 s, without end; 4 KiB/s, twenty times
/// what the paper's ten commands in a second amount to.
impl Default for Options {
    fn default() -> Options {
        Options {
            null_period: 10 * SECOND,
            idle: SILENCE.as_micros() as i64,
            first_backoff: SECOND / 2,
            most_backoff: 10 * SECOND,
            connect_timeout: 5 * SECOND,
            attempts: None,
            read_rate: 4096,
        }
    }
}
