//! The clock of a peer, measured by the hub's own pings (M34, design §7).

use mom_proto::{ClockOffset, Exchange, Family, Map, Micros, OffsetEstimator, Parcel, Path, Time, Value};
use mom_system::Clock;

/// Exchanges right after the first answer, one after the other; from then on one each heartbeat.
const QUICK: usize = 4;

/// The oldest ping without an answer and the newest, by id and time.
#[derive(Clone, Copy, Debug)]
struct Asked {
    oldest: (u64, Time),
    newest: (u64, Time),
}

/// The pings to one peer.
#[derive(Debug, Default)]
pub(crate) struct Pings {
    next: u64,
    /// Those whose answers are waited for; none in between.
    asked: Option<Box<Asked>>,
    /// The peer answers with its stamps, so that asking is worth it.
    stamps: bool,
}

/// What a reader knows of its peer's clock.
#[derive(Debug, Default)]
pub(crate) struct Measure {
    estimator: OffsetEstimator,
}

impl Pings {
    /// The next ping, sent now. The answer to the oldest that is not answered is of use, too: where the way there and
    /// back takes longer than the time between two, the answer to the newest never comes in time.
    pub(crate) fn next(&mut self, clock: &Clock) -> Parcel {
        let (id, sent) = (self.next, clock.wall());
        self.next += 1;
        let newest = (id, sent);
        match &mut self.asked {
            Some(asked) => asked.newest = newest,
            None => {
                let oldest = newest;
                self.asked = Some(Box::new(Asked { oldest, newest }));
            }
        }
        let content = Map::new().with("sent", sent);
        Parcel::new(Family::Time, "ping")
            .context(Path::root())
            .id(id)
            .content(content)
    }

    /// Whether the peer answers with its stamps.
    pub(crate) fn are_stamped(&self) -> bool {
        self.stamps
    }

    fn answered(&mut self, pong: &Parcel) -> Option<Time> {
        let asked = self.asked.as_mut()?;
        let (answered, Asked { oldest, newest }) = (pong.reference?, **asked);
        if answered == newest.0 {
            self.asked = None;
            return Some(newest.1);
        }
        if answered >= oldest.0 {
            // A peer that answers one has answered those before it, or never will.
            asked.oldest = newest;
        }
        (answered == oldest.0).then_some(oldest.1)
    }
}

impl Measure {
    /// The answer to a ping of the peer.
    pub(crate) fn pong(ping: &Parcel, clock: &Clock) -> Parcel {
        let content = Map::new()
            .with("received", clock.wall())
            .with("sent", clock.wall());
        let mut pong = Parcel::new(Family::Time, "pong")
            .context(Path::root())
            .content(content);
        pong.reference = ping.id;
        pong
    }

    /// Whether a ping of the peer shows that it stamps, while nothing is known of its clock yet.
    pub(crate) fn begins(&self, ping: &Parcel, pings: &Pings) -> bool {
        self.estimator.exchanges() == 0
            && !pings.are_stamped()
            && matches!(ping.value().get("sent"), Some(Value::Time(_)))
    }

    /// Learns from the answer to a ping; whether to ask again at once, and the round trip in µs.
    pub(crate) fn learn(
        &mut self,
        pong: &Parcel,
        pings: &mut Pings,
        clock: &Clock,
    ) -> (bool, Option<Micros>) {
        let Some(sent) = pings.answered(pong) else {
            return (false, None);
        };
        let heard = clock.wall();
        // Negative where the clock was set meanwhile.
        let round_trip = Micros::try_from(heard.micros() - sent.micros()).ok();
        // Without stamps it is a sign of life and nothing else.
        let Some(exchange) = Exchange::of(sent, pong, heard) else {
            return (false, round_trip);
        };
        pings.stamps = true;
        let again = self.estimator.push(exchange, clock.now()) && self.estimator.exchanges() < QUICK;
        (again, round_trip)
    }

    /// The peer's clock minus the hub's; none if it is not known.
    pub(crate) fn offset(&self, now: Micros) -> Option<ClockOffset> {
        self.estimator.at(now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where pings go out more often than answers come back, each measures by the oldest of them.
    #[test]
    fn an_answer_that_comes_after_the_next_ping_is_of_use() {
        let (clock, mut pings) = (Clock::system(), Pings::default());
        let first = pings.next(&clock);
        let later: Vec<Parcel> = (0..5).map(|_| pings.next(&clock)).collect();
        let pong = |ping: &Parcel| {
            let mut pong = Parcel::new(Family::Time, "pong");
            pong.reference = ping.id;
            pong
        };
        assert!(pings.answered(&pong(&first)).is_some());
        assert_eq!(pings.answered(&pong(&first)), None, "it was answered");
        assert_eq!(pings.answered(&pong(&later[2])), None, "it is a sign of life");
        assert!(pings.answered(&pong(&later[4])).is_some());
        assert_eq!(pings.answered(&pong(&later[4])), None, "it was answered");
        // Who has left one out is measured by the next.
        let next = [pings.next(&clock), pings.next(&clock), pings.next(&clock)];
        assert_eq!(pings.answered(&pong(&next[1])), None);
        assert!(pings.answered(&pong(&next[2])).is_some());
    }
}
