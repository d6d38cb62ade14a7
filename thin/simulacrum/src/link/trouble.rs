//! Why a robot has no session.

use std::io;
use std::net::SocketAddr;

use super::Simulacrum;

/// µs without a session after which there is something to be asked.
const PATIENCE: u64 = 2_000_000;

/// The way to a robot.
#[derive(Debug, Default)]
pub(super) struct Way {
    address: Option<SocketAddr>,
    /// Whether the system of that address said last that nobody listens there.
    closed: bool,
    told: String,
}

impl Way {
    pub(super) fn leads_to(&mut self, address: Option<SocketAddr>) {
        self.address = address;
    }

    /// Something came.
    pub(super) fn leads_on(&mut self) {
        self.closed = false;
    }

    /// Its socket says so of a moment.
    pub(super) fn fails(&mut self, error: &io::Error) {
        self.closed |= error.kind() == io::ErrorKind::ConnectionRefused;
    }
}

impl Simulacrum {
    /// Why there is no session, in words; none while there is one.
    #[must_use]
    pub fn trouble(&self) -> Option<String> {
        let now = self.now();
        let middle = self.0.middle.lock();
        if middle.state() == mom_rsp::middle::State::Up {
            return None;
        }
        let asked = middle
            .calling_since()
            .map_or(0, |since| now.saturating_sub(since));
        let refusal = middle.refusal().map(ToString::to_string);
        drop(middle);
        let way = self.0.way.lock();
        let address = way
            .address
            .map_or_else(|| "its address".to_owned(), |address| address.to_string());
        let why = match (refusal, asked >= PATIENCE) {
            (Some(refusal), _) => format!(": {refusal}"),
            (None, false) => String::new(),
            (None, true) if way.closed => {
                format!(
                    ": nothing listens at {address}; check the robot's address, and that its program runs"
                )
            }
            (None, true) => format!(
                ": no valid datagram comes from {address}; check the robot's address, that its program runs, and that it has the same key"
            ),
        };
        Some(format!("no session{why}"))
    }

    /// Says it in the log, once for each reason.
    pub(super) fn tell_trouble(&self) {
        // What is to be expected in the first moments is none.
        let trouble = self.trouble().unwrap_or_default();
        let mut way = self.0.way.lock();
        if trouble.contains(':') && trouble != way.told {
            tracing::warn!(robot = self.name(), "{trouble}");
        }
        if trouble.is_empty() || trouble.contains(':') {
            way.told = trouble;
        }
    }
}
