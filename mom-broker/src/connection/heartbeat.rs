//! Signs of life: whether a peer is there, and what its clock says.

use std::sync::atomic::Ordering;
use std::time::Duration;

use mom_hub::PeerClock;
use mom_proto::{Micros, Parcel, Verb, WireError};
use tokio::time::Instant;

use super::Connection;
use super::measure::Measure;
use crate::traffic::switchboard::{Touched, flush};

impl Connection {
    /// For how long a peer may say nothing.
    pub(super) fn gone(&self) -> Duration {
        Duration::from_millis(self.services.limits.gone)
    }

    /// When the connection ends if nothing is heard.
    pub(super) fn deadline(&self) -> Instant {
        match self.logged_in {
            true => self.heard_at + self.gone(),
            false => self.arrival.login_by,
        }
    }

    /// Asks a peer that says or hears nothing else whether it is there, and one that stamps its answers for its
    /// clock.
    pub(super) fn beat(&mut self, received: u64) {
        let (now, beat) = (
            Instant::now(),
            Duration::from_millis(self.services.limits.heartbeat),
        );
        self.beat_at = now + beat;
        let quiet = !self.outbox.active.swap(false, Ordering::Relaxed);
        // A peer that only listens has to be asked too, or it would be taken for gone.
        let silent = !self.outbox.heard.lately.swap(false, Ordering::Relaxed);
        let mut touched = Touched::new();
        self.tell_read(received, &mut touched);
        flush(&mut touched);
        if quiet || silent || self.pings.are_stamped() {
            let ping = self.pings.next(&self.services.board.clock);
            self.services.board.tell(self.peer(), ping, &mut touched);
            flush(&mut touched);
            // A ping alone is not activity, or the next one would wait twice as long.
            self.outbox.active.store(false, Ordering::Relaxed);
        } else if self.heard_at + beat > now {
            // It is asked as soon as it has been silent for so long, not up to twice as long.
            self.beat_at = self.heard_at + beat;
        }
    }

    /// Handles a sign of life.
    ///
    /// # Errors
    /// A count that cannot be: the connection ends.
    pub(super) fn time(&mut self, parcel: &Parcel, touched: &mut Touched) -> Result<(), WireError> {
        match Verb::of(parcel.family, &parcel.name) {
            Ok(Verb::Ping) => {
                let pong = Measure::pong(parcel, &self.services.board.clock);
                let told_at = self.link.as_ref().map_or(0, |served| served.told_at);
                self.tell_read(told_at, touched);
                self.services.board.tell(self.peer(), pong, touched);
                if self.logged_in && self.measure.begins(parcel, &self.pings) {
                    self.ping(touched);
                }
            }
            Ok(Verb::Ack) => return self.acknowledged(parcel),
            Ok(Verb::Resent) => {
                if let Some(served) = &mut self.link {
                    served.resending = false;
                }
            }
            Ok(_) => {
                let clock = &self.services.board.clock;
                let (again, round_trip) = self.measure.learn(parcel, &mut self.pings, clock);
                if let Some(micros) = round_trip {
                    self.outbox.heard.note_round_trip(micros);
                }
                if again && self.logged_in {
                    self.ping(touched);
                }
            }
            Err(error) => self.refuse(&error, parcel.id, touched),
        }
        Ok(())
    }

    pub(super) fn peer_clock(&self, now: Micros) -> Option<PeerClock> {
        self.measure.offset(now).map(|offset| PeerClock {
            offset,
            future: self.services.limits.future.saturating_mul(1000),
        })
    }

    fn ping(&mut self, touched: &mut Touched) {
        let ping = self.pings.next(&self.services.board.clock);
        self.services.board.tell(self.peer(), ping, touched);
    }
}
