//! The clock of a peer, measured by the hub's own pings (M34, design §7).

use mom_proto::{ClockOffset, Exchange, Family, Map, Micros, OffsetEstimator, Parcel, Path, Time, Value};
use mom_system::Clock;

/// Exchanges right after the first answer, one after the other; from then on one each heartbeat.
const QUICK: usize = 4;

/// The pings to one peer.
#[derive(Debug, Default)]
pub(crate) struct Pings {
    next: u64,
    /// When the last one was sent, if it is not answered.
    asked: Option<Time>,
    /// The peer answers with its stamps, so that asking is worth it.
    stamps: bool,
}

/// What a reader knows of its peer's clock.
#[derive(Debug, Default)]
pub(crate) struct Measure {
    estimator: OffsetEstimator,
}

impl Pings {
    /// The next ping, sent now. An answer to the one before is of no use any more.
    pub(crate) fn next(&mut self, clock: &Clock) -> Parcel {
        let (id, sent) = (self.next, clock.wall());
        self.next += 1;
        self.asked = Some(sent);
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
        let last = self.next.checked_sub(1)?;
        self.asked.take_if(|_| pong.reference == Some(last))
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
