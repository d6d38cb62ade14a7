//! The robot's clock beside the middle's own, and the round trip.

use alloc::collections::VecDeque;

use super::Offset;

/// Data packets whose time of leaving is remembered, and measurements that are kept.
const SENT: usize = 256;
const KEPT: usize = 64;

/// The most that two clocks drift apart: 100 µs in a second.
const DRIFT: u64 = 10_000;

#[derive(Default)]
pub(super) struct Clock {
    /// Data packets: sequence and time of leaving.
    sent: VecDeque<(u64, u64)>,
    /// The robot's clock, ms, which its stamps are the low bits of.
    robot: Option<i64>,
    /// When, offset, error.
    kept: VecDeque<(u64, Offset)>,
    /// The newest data packet of which a round trip was measured.
    measured: Option<u64>,
    round_trip: Option<u64>,
}

impl Clock {
    /// A data packet leaves.
    pub(super) fn leaves(&mut self, sequence: u64, now: u64) {
        if self.sent.len() == SENT {
            self.sent.pop_front();
        }
        self.sent.push_back((sequence, now));
    }

    /// A data packet of the robot, stamped `stamp`, is here, and says that it heard the one of `sequence`.
    pub(super) fn heard(&mut self, stamp: u32, sequence: u64, now: u64) {
        let robot = match self.robot {
            None => i64::from(stamp),
            Some(last) => last + i64::from(stamp.wrapping_sub(last as u32).cast_signed()),
        };
        self.robot = Some(robot);
        let Ok(at) = self
            .sent
            .binary_search_by_key(&sequence, |&(sequence, _)| sequence)
        else {
            return;
        };
        let Some(&(_, left)) = self.sent.get(at) else {
            return;
        };
        let way = now.saturating_sub(left);
        let middle = (left + way / 2).cast_signed();
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        // A stamp is a whole ms, so the moment is up to one later.
        let (offset, error) = (robot * 1000 - middle, way.div_ceil(2) + 1000);
        self.kept.push_back((now, Offset { offset, error }));
        if self.measured.is_none_or(|measured| sequence > measured) {
            self.measured = Some(sequence);
            self.round_trip = Some(self.round_trip.map_or(way, |round| (round * 7 + way) / 8));
        }
    }

    /// The measurement with the least error now.
    pub(super) fn offset(&self, now: u64) -> Option<Offset> {
        let aged = self.kept.iter().map(|&(at, kept)| Offset {
            error: kept.error + now.saturating_sub(at).div_ceil(DRIFT),
            ..kept
        });
        aged.min_by_key(|offset| offset.error)
    }

    pub(super) fn round_trip(&self) -> Option<u64> {
        self.round_trip
    }
}
