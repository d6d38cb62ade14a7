//! What a radio network is like, and how long a frame takes on it.

use crate::{Loss, Micros};

/// How stations that want to send at the same time get their turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// By the distributed coordination function of IEEE 802.11: after DIFS, each waits a random number of slots; who draws the
    /// same number collides.
    Random,
    /// One after the other in the order of their numbers; each waits DIFS and the mean of what it would draw. Nothing collides.
    Fair,
}

/// The settings of a [`Radio`](crate::Radio). Times are µs, lengths are octets.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Bit/s of data frames (W19).
    pub rate: u32,
    /// Bit/s of acknowledgements, which every station understands.
    pub basic_rate: u32,
    /// The same seed gives the same events.
    pub seed: u64,
    /// How stations get their turns.
    pub access: Access,
    /// What is lost on the way.
    pub loss: Loss,
    /// A slot of the backoff.
    pub slot: Micros,
    /// Between a frame and its acknowledgement.
    pub sifs: Micros,
    /// Preamble and PLCP header, before each frame and each acknowledgement.
    pub preamble: Micros,
    /// What a data frame has around its IP packet.
    pub frame_overhead: u32,
    /// The first contention window: slots are drawn from 0 to this.
    pub window: u32,
    /// The largest contention window.
    pub most_window: u32,
    /// Attempts at a frame before it is given up.
    pub attempts: u32,
    /// Frames that a station queues; more are dropped.
    pub queue: usize,
    /// The longest IP packet. Longer datagrams go in fragments.
    pub mtu: u32,
    /// TCP: how long an acknowledgement waits for data that goes the same way.
    pub delayed_ack: Micros,
    /// TCP: the time without an acknowledgement after which a segment is sent again, before the round trip is known.
    pub first_timeout: Micros,
    /// TCP: the least that such a time is more than the round trip.
    pub least_timeout: Micros,
    /// TCP: the most such time; it doubles with each repetition.
    pub most_timeout: Micros,
    /// TCP: segments that are under way at most; one, while one is repeated.
    pub segments: usize,
}

/// 2 Mbit/s with acknowledgements at 1 Mbit/s, random access and no loss; the figures of IEEE 802.11-1997 for direct sequence,
/// where it has one; `docs/radio.md` says which are chosen.
impl Default for Settings {
    fn default() -> Settings {
        Settings {
            rate: 2_000_000,
            basic_rate: 1_000_000,
            seed: 1,
            access: Access::Random,
            loss: Loss::None,
            slot: 20,
            sifs: 10,
            preamble: 192,
            frame_overhead: 36,
            window: 31,
            most_window: 1023,
            attempts: 7,
            queue: 100,
            mtu: 1500,
            delayed_ack: 200_000,
            first_timeout: 1_000_000,
            least_timeout: 200_000,
            most_timeout: 60_000_000,
            segments: 4,
        }
    }
}

/// Octets of an acknowledgement on the radio.
const ACK: u32 = 14;

impl Settings {
    /// How long a data frame with an IP packet of so many octets takes, with its preamble.
    ///
    /// ```
    /// use mom_radio::Settings;
    ///
    /// let settings = Settings { rate: 1_000_000, ..Settings::default() };
    /// // NULL of the fleet: 192 µs, then (36 + 20 + 20 + 2) octets of 8 µs.
    /// assert_eq!(settings.frame_time(42), 192 + 78 * 8);
    /// ```
    #[must_use]
    pub fn frame_time(&self, packet: u32) -> Micros {
        self.preamble + bits_time(packet.saturating_add(self.frame_overhead), self.rate)
    }

    /// How long an acknowledgement takes, with its preamble.
    #[must_use]
    pub fn ack_time(&self) -> Micros {
        self.preamble + bits_time(ACK, self.basic_rate)
    }

    /// The pause after which a station may send, or begins to count slots.
    #[must_use]
    pub fn difs(&self) -> Micros {
        self.sifs + 2 * self.slot
    }

    /// How long a frame with an IP packet of so many octets occupies the network: DIFS, the frame, SIFS and the acknowledgement.
    /// A backoff comes on top.
    #[must_use]
    pub fn exchange_time(&self, packet: u32) -> Micros {
        self.difs() + self.frame_time(packet) + self.sifs + self.ack_time()
    }

    /// The mean of the first backoff.
    #[must_use]
    pub fn mean_backoff(&self) -> Micros {
        Micros::from(self.window) * self.slot / 2
    }
}

/// How long so many octets take; a µs that is begun counts.
fn bits_time(octets: u32, rate: u32) -> Micros {
    let micros = (u64::from(octets) * 8 * 1_000_000).div_ceil(u64::from(rate.max(1)));
    Micros::try_from(micros).unwrap_or(Micros::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn airtimes_are_those_computed_by_hand() {
        let at = |rate| Settings {
            rate,
            ..Settings::default()
        };
        let two = at(2_000_000);
        // (36 + 42) × 8 / 2 = 312.
        assert_eq!(two.frame_time(42), 192 + 312);
        // 14 × 8 = 112, at the basic rate.
        assert_eq!(two.ack_time(), 304);
        assert_eq!(two.difs(), 50);
        assert_eq!(two.exchange_time(42), 50 + 504 + 10 + 304);
        assert_eq!(two.mean_backoff(), 310);
        // (36 + 1500) × 8 = 12 288.
        assert_eq!(at(1_000_000).exchange_time(1500), 50 + 192 + 12_288 + 10 + 304);
        // 78 × 8 / 11 = 56.7 µs: the last one is begun.
        assert_eq!(at(11_000_000).frame_time(42), 192 + 57);
        assert!(at(0).frame_time(42) > 0, "no rate is not a division by zero");
    }
}
