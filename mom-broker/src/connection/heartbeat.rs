//! Signs of life: whether a peer is there, and what its clock says.

use std::sync::atomic::Ordering;
use std::time::Duration;

use mom_hub::PeerClock;
use mom_net::Reader;
use mom_proto::{Code, Content, Micros, Parcel, Verb, WireError};
use tokio::time::Instant;

use super::login::login_timeout;
use super::measure::Measure;
use super::{Connection, End};
use crate::traffic::switchboard::{Touched, flush};

/// Bytes in a second that come at least while a parcel is not whole: as many as a link has that is of any use, and so many that what is
/// held of half a parcel has to be paid for.
const LEAST_RATE: u64 = 1024;

/// What is here of parcels that are not whole.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unfinished {
    /// When one of them has to be whole: later by each byte of theirs that comes.
    until: Instant,
    /// Their bytes that were counted in.
    counted: usize,
}

impl Connection {
    /// For how long a peer may say nothing.
    fn gone(&self) -> Duration {
        Duration::from_millis(self.services.limits.gone)
    }

    /// When the connection ends if nothing is heard.
    fn deadline(&self) -> Instant {
        if !self.logged_in {
            return self.arrival.login_by;
        }
        let silent = self.heard_at + self.gone();
        let unfinished = self.arrival.unfinished.as_ref();
        unfinished.map_or(silent, |unfinished| silent.min(unfinished.until))
    }

    /// Notes that bytes have come: signs of life, whatever they are of.
    pub(super) fn note_arrived(&mut self, reader: &Reader) {
        self.outbox.note_heard(reader.received());
        self.outbox.heard.lately.store(true, Ordering::Relaxed);
        self.heard_at = Instant::now();
    }

    /// Notes how many bytes are here of parcels that are not whole, and whether another has come whole since: no ping, where parcels
    /// come in chunks, for pings keep no half parcel alive (threat 37).
    pub(super) fn watch_unfinished(&mut self, held: usize, whole: bool) {
        if held == 0 || whole {
            self.arrival.unfinished = None;
        }
        if held > 0 {
            let until = Instant::now() + self.gone();
            let unfinished = self.arrival.unfinished.get_or_insert_with(|| {
                let counted = held;
                Unfinished { until, counted }
            });
            let come = held.saturating_sub(unfinished.counted) as u64;
            unfinished.until += Duration::from_micros(come.saturating_mul(1_000_000) / LEAST_RATE);
            unfinished.counted = held;
        }
    }

    /// For so long nobody could be heard.
    pub(super) fn excuse(&mut self, time: Duration) {
        self.heard_at = (self.heard_at + time).min(Instant::now());
        if let Some(unfinished) = &mut self.arrival.unfinished {
            unfinished.until += time;
        }
    }

    /// When to look whether the peer is there, while it is read.
    pub(super) fn look_at(&self) -> Instant {
        self.deadline().min(self.beat_at)
    }

    /// Looks whether the peer is there, as was to be done at `at`.
    ///
    /// # Errors
    /// It is not: the connection ends.
    pub(super) fn look(&mut self, at: Instant, reader: &Reader) -> Result<(), End> {
        let now = Instant::now();
        // While this thread was late it heard nobody.
        self.excuse(now.saturating_duration_since(at));
        if now < self.deadline() {
            self.beat(reader.brought());
            return Ok(());
        }
        let error = match self.logged_in {
            true => self.silent(now),
            false => login_timeout(self.services.limits.login_time),
        };
        Err(Some(error).into())
    }

    fn silent(&self, now: Instant) -> WireError {
        let text = match &self.arrival.unfinished {
            Some(unfinished) if unfinished.until <= now => {
                format!("a parcel was not complete in time; send at least {LEAST_RATE} bytes a second")
            }
            _ => {
                let gone = self.gone().as_secs_f64();
                format!("nothing was received for {gone} s; send time ping before that")
            }
        };
        WireError::new(Code::SILENT, text)
    }

    /// Asks a peer that says or hears nothing else whether it is there, and one that stamps its answers for its
    /// clock.
    fn beat(&mut self, brought: u64) {
        let (now, beat) = (
            Instant::now(),
            Duration::from_millis(self.services.limits.heartbeat),
        );
        self.beat_at = now + beat;
        let quiet = !self.outbox.active.swap(false, Ordering::Relaxed);
        // A peer that only listens has to be asked too, or it would be taken for gone.
        let silent = !self.outbox.heard.lately.swap(false, Ordering::Relaxed);
        let mut touched = Touched::new();
        self.tell_read(brought, &mut touched);
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
        let large = |content: &Content| content.size() > Verb::SIGN_OF_LIFE;
        let bare;
        let parcel = match parcel.content.as_ref().is_some_and(large) {
            // A measuring peer says nothing by it.
            true => {
                bare = Parcel {
                    content: None,
                    ..parcel.clone()
                };
                &bare
            }
            false => parcel,
        };
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
