//! The audio processor's jitter buffer (S2, S13): blocks of sound come in parts and at odd times, and leave one each 20 ms.

use crate::{FRAGMENT, Fragment, Sound};

/// Blocks that are lost in a row after which the sound is over.
const OVER: u8 = 5;
/// Blocks more than are wanted that may wait, before one is left out as the clocks differ.
const SPARE: usize = 2;

/// Keeps blocks of sound until they are to be played: at most `DEPTH` of them, each of `BLOCK` bytes and 8 fragments at most.
///
/// The first block of a sound waits for twice the jitter that was seen, and for the two periods in which the next one comes at the
/// latest. What is late is dropped; where all were late, as after a gap of the network, the sound waits anew.
#[derive(Clone, Debug)]
pub struct Playout<const BLOCK: usize, const DEPTH: usize> {
    slots: [Held<BLOCK>; DEPTH],
    phase: Phase,
    /// The block that is played next.
    next: u16,
    /// When the newest block began to arrive, and its number.
    newest: Option<(u64, u16)>,
    /// The mean deviation of arrivals from one each 20 ms, µs (RFC 3550, 6.4.1).
    jitter: u32,
    /// The period of the middle's packets, µs: blocks come together if it is longer than they are.
    period: u32,
    /// Blocks that lacked in a row.
    lacked: u8,
    counts: PlayoutCounts,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Silent,
    /// Since then the first block waits.
    Waits(u64),
    Plays,
}

/// What became of blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlayoutCounts {
    /// They were played.
    pub played: u32,
    /// They were not there, or lacked a part, when they were to be played.
    pub lost: u32,
    /// They came after that.
    pub late: u32,
    /// They were left out, as the middle's clock is faster.
    pub skipped: u32,
    /// They were larger than a block may be.
    pub large: u32,
}

/// What is to be played for the next 20 ms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Played<'a> {
    /// This block.
    Block(&'a [u8]),
    /// Something that hides that a block lacks.
    Lost,
}

#[derive(Clone, Copy, Debug)]
struct Held<const BLOCK: usize> {
    /// 0 for a slot that is free.
    total: u16,
    blob: u16,
    /// A bit for each part that lacks.
    lacks: u8,
    bytes: [u8; BLOCK],
}

impl<const BLOCK: usize> Held<BLOCK> {
    const FREE: Self = Held {
        total: 0,
        blob: 0,
        lacks: 0,
        bytes: [0; BLOCK],
    };

    fn is(&self, blob: u16) -> bool {
        self.total != 0 && self.blob == blob
    }
}

impl<const BLOCK: usize, const DEPTH: usize> Default for Playout<BLOCK, DEPTH> {
    fn default() -> Self {
        Playout {
            slots: [Held::FREE; DEPTH],
            phase: Phase::Silent,
            next: 0,
            newest: None,
            jitter: 0,
            period: Sound::PERIOD as u32,
            lacked: 0,
            counts: PlayoutCounts::default(),
        }
    }
}

impl<const BLOCK: usize, const DEPTH: usize> Playout<BLOCK, DEPTH> {
    /// Says that the middle's packets come so often, ms.
    pub fn set_period(&mut self, ms: u16) {
        self.period = u32::from(ms) * 1000;
    }

    /// A part of a block is here.
    pub fn push(&mut self, now: u64, fragment: &Fragment<'_>) {
        let total = fragment.total as usize;
        if total > BLOCK || total > 8 * FRAGMENT {
            self.counts.large = self.counts.large.saturating_add(1);
            return;
        }
        self.measure(now, fragment.blob);
        let ahead = fragment.blob.wrapping_sub(self.next) as i16;
        match self.phase {
            Phase::Silent => self.begin(now, fragment.blob),
            // One that was overtaken by the first that arrived.
            Phase::Waits(_) if ahead < 0 && self.fits(fragment.blob) => self.next = fragment.blob,
            // All that is late now would be late for ever.
            Phase::Plays if ahead < 0 && self.is_empty() && self.lacked > 0 => {
                self.counts.late = self.counts.late.saturating_add(1);
                self.begin(now, fragment.blob);
            }
            _ if ahead < 0 => {
                self.counts.late = self.counts.late.saturating_add(1);
                return;
            }
            _ if usize::from(ahead as u16) >= DEPTH => self.begin(now, fragment.blob),
            _ => {}
        }
        self.keep(fragment, total);
    }

    /// What is to be played for the next 20 ms; `None` while there is no sound. To be called each 20 ms.
    pub fn take(&mut self, now: u64) -> Option<Played<'_>> {
        match self.phase {
            Phase::Silent => return None,
            Phase::Waits(since) if now.saturating_sub(since) < self.patience() => return None,
            Phase::Waits(_) | Phase::Plays => self.phase = Phase::Plays,
        }
        // As many as come together may wait beside those that are wanted.
        let most = (self.patience() + self.together()) / Sound::PERIOD;
        if self.waiting() > most as usize + 1 + SPARE {
            self.drop_next();
            self.counts.skipped = self.counts.skipped.saturating_add(1);
        }
        let (blob, place) = (self.next, usize::from(self.next) % DEPTH.max(1));
        self.next = blob.wrapping_add(1);
        let slot = self.slots.get_mut(place).filter(|slot| slot.is(blob));
        let total = slot.map_or(0, |slot| match slot.lacks {
            0 => core::mem::take(&mut slot.total),
            // What lacks a part is free again, and nothing.
            _ => {
                slot.total = 0;
                0
            }
        });
        if total > 0 {
            self.lacked = 0;
            self.counts.played = self.counts.played.saturating_add(1);
            let bytes = self.slots.get(place).map(|slot| &slot.bytes);
            return bytes?.get(..usize::from(total)).map(Played::Block);
        }
        self.lacked = self.lacked.saturating_add(1);
        if self.lacked > OVER && self.is_empty() {
            // Those that lacked came after its end.
            self.counts.lost = self.counts.lost.saturating_sub(u32::from(OVER));
            self.silence();
            return None;
        }
        self.counts.lost = self.counts.lost.saturating_add(1);
        Some(Played::Lost)
    }

    /// Whether nothing is played, and nothing waits to be.
    #[must_use]
    pub fn is_silent(&self) -> bool {
        self.phase == Phase::Silent
    }

    /// Ends the sound, as at the end of a session.
    pub fn silence(&mut self) {
        self.slots.iter_mut().for_each(|slot| slot.total = 0);
        (self.phase, self.newest, self.lacked) = (Phase::Silent, None, 0);
    }

    /// What became of blocks.
    #[must_use]
    pub fn counts(&self) -> PlayoutCounts {
        self.counts
    }

    /// How far arrivals deviate from one each 20 ms, µs.
    #[must_use]
    pub fn jitter(&self) -> u32 {
        self.jitter
    }

    /// For how long the first block waits, µs; less than would fill the buffer.
    fn patience(&self) -> u64 {
        let wanted = 2 * u64::from(self.jitter) + 2 * self.together();
        let room = Sound::PERIOD * (DEPTH as u64).saturating_sub(2);
        wanted.min(room.saturating_sub(self.together()))
    }

    /// The time between two arrivals, µs: what sounds meanwhile comes together.
    fn together(&self) -> u64 {
        u64::from(self.period).max(Sound::PERIOD)
    }

    fn begin(&mut self, now: u64, blob: u16) {
        self.slots.iter_mut().for_each(|slot| slot.total = 0);
        (self.phase, self.next, self.lacked) = (Phase::Waits(now), blob, 0);
    }

    /// Whether all that waits still has room if this block is the first.
    fn fits(&self, blob: u16) -> bool {
        self.slots
            .iter()
            .filter(|slot| slot.total != 0)
            .all(|slot| usize::from(slot.blob.wrapping_sub(blob)) < DEPTH)
    }

    fn is_empty(&self) -> bool {
        self.slots.iter().all(|slot| slot.total == 0)
    }

    fn waiting(&self) -> usize {
        self.slots.iter().filter(|slot| slot.total != 0).count()
    }

    fn drop_next(&mut self) {
        let (next, place) = (self.next, usize::from(self.next) % DEPTH.max(1));
        if let Some(slot) = self.slots.get_mut(place).filter(|slot| slot.is(next)) {
            slot.total = 0;
        }
        self.next = next.wrapping_add(1);
    }

    fn measure(&mut self, now: u64, blob: u16) {
        let Some((before, newest)) = self.newest else {
            self.newest = Some((now, blob));
            return;
        };
        let blobs = blob.wrapping_sub(newest) as i16;
        if blobs <= 0 {
            return;
        }
        let expected = Sound::PERIOD * u64::from(blobs as u16);
        let deviation = now.saturating_sub(before).abs_diff(expected).min(1_000_000) as u32;
        self.jitter = self.jitter - self.jitter / 16 + deviation / 16;
        self.newest = Some((now, blob));
    }

    fn keep(&mut self, fragment: &Fragment<'_>, total: usize) {
        let place = usize::from(fragment.blob) % DEPTH.max(1);
        let Some(slot) = self.slots.get_mut(place) else {
            return;
        };
        if !slot.is(fragment.blob) {
            let parts = total.div_ceil(FRAGMENT);
            // At most 8 parts: see `push`.
            slot.lacks = (0xFF_u16 >> (8 - parts.clamp(1, 8))) as u8;
            (slot.blob, slot.total) = (fragment.blob, total as u16);
        }
        let start = fragment.offset as usize;
        let end = start.saturating_add(fragment.bytes.len());
        if let Some(to) = slot.bytes.get_mut(start..end) {
            to.copy_from_slice(fragment.bytes);
            slot.lacks &= !(1 << (fragment.place() % 8));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::vec;
    use std::vec::Vec;

    use super::*;

    const BLOCK: usize = 960;
    type Buffer = Playout<BLOCK, 8>;

    fn block(number: u16) -> Vec<u8> {
        vec![number as u8; BLOCK]
    }

    fn push(buffer: &mut Buffer, now: u64, number: u16, parts: &[u32]) {
        let bytes = block(number);
        for part in parts {
            let offset = part * FRAGMENT as u32;
            let fragment = Fragment {
                element: 0,
                blob: number,
                offset,
                total: BLOCK as u32,
                bytes: &bytes[offset as usize..][..FRAGMENT],
            };
            buffer.push(now, &fragment);
        }
    }

    /// Plays what arrives at these ms; `Some(n)` for block n, `None` for one that lacked. What plays before and after is left out.
    fn played(arrivals: &[(u64, u16)]) -> (Vec<Option<u8>>, PlayoutCounts) {
        let mut buffer = Buffer::default();
        let mut out = Vec::new();
        let end = arrivals.iter().map(|(at, _)| *at).max().unwrap_or(0) + 400;
        for ms in 0..end {
            for (_, number) in arrivals.iter().filter(|(at, _)| *at == ms) {
                push(&mut buffer, ms * 1000, *number, &[0, 1]);
            }
            if ms % 20 == 0 {
                match buffer.take(ms * 1000) {
                    Some(Played::Block(bytes)) => out.push(bytes.first().copied()),
                    Some(Played::Lost) => out.push(None),
                    None => {}
                }
            }
        }
        assert!(buffer.is_silent());
        while out.last() == Some(&None) {
            out.pop();
        }
        (out, buffer.counts())
    }

    #[test]
    fn blocks_that_come_at_odd_times_are_played_in_order_and_without_a_gap() {
        // Up to 30 ms late, and overtaken (S12 has the same for motion).
        let (out, counts) = played(&[
            (0, 65_534),
            (47, 0),
            (44, 65_535),
            (60, 1),
            (101, 2),
            (103, 3),
            (120, 4),
        ]);
        assert_eq!(out, [254, 255, 0, 1, 2, 3, 4].map(Some));
        assert_eq!((counts.played, counts.lost, counts.late), (7, 0, 0));
    }

    #[test]
    fn at_the_longest_period_blocks_come_ten_at_a_time_and_none_is_left_out() {
        for first in 1..=10_u16 {
            let mut buffer = Playout::<BLOCK, 32>::default();
            buffer.set_period(200);
            let (mut sent, mut heard) = (0, Vec::new());
            for ms in 0..5000_u64 {
                if ms % 200 == 0 {
                    let until = first + 10 * (ms / 200) as u16;
                    for number in sent..until.min(200) {
                        let bytes = block(number);
                        for part in [0, 1] {
                            let offset = part * FRAGMENT;
                            buffer.push(
                                ms * 1000,
                                &Fragment {
                                    element: 0,
                                    blob: number,
                                    offset: offset as u32,
                                    total: BLOCK as u32,
                                    bytes: &bytes[offset..][..FRAGMENT],
                                },
                            );
                        }
                    }
                    sent = until.min(200);
                }
                if ms % 20 == 7
                    && let Some(Played::Block(bytes)) = buffer.take(ms * 1000)
                {
                    heard.push(bytes[0]);
                }
            }
            assert_eq!(
                heard,
                (0..200).collect::<Vec<u8>>(),
                "{first}: {:?}",
                buffer.counts()
            );
        }
    }

    #[test]
    fn a_block_that_lacks_a_part_is_lost_and_the_others_are_played() {
        let mut buffer = Buffer::default();
        for number in 0..4 {
            push(
                &mut buffer,
                0,
                number,
                if number == 1 { &[1] } else { &[1, 0, 0] },
            );
        }
        let mut all = Vec::new();
        for at in 0..10 {
            match buffer.take(at * Sound::PERIOD) {
                Some(Played::Block(bytes)) => {
                    assert!(bytes.iter().all(|byte| *byte == bytes[0]) && bytes.len() == BLOCK);
                    all.push(Some(bytes[0]));
                }
                Some(Played::Lost) => all.push(None),
                None => {}
            }
        }
        assert_eq!(all.get(..4), Some(&[Some(0), None, Some(2), Some(3)][..]));
    }

    #[test]
    fn after_a_gap_the_sound_waits_anew_instead_of_being_late_for_ever() {
        let before = (0..10).map(|number| (u64::from(number) * 20, number));
        let after = (10..20).map(|number| (u64::from(number) * 20 + 70, number));
        let arrivals: Vec<(u64, u16)> = before.chain(after).collect();
        let (out, counts) = played(&arrivals);
        let heard: Vec<u8> = out.into_iter().flatten().collect();
        assert_eq!(heard[..10], [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
        assert!(heard.len() >= 18, "{heard:?} {counts:?}");
    }

    #[test]
    fn whose_clock_is_faster_loses_a_block_now_and_then_and_never_fills_the_buffer() {
        let mut buffer = Buffer::default();
        for ms in 0..60_000_u64 {
            // 3 % faster: far more than any quartz.
            if ms * 103 / 2000 != (ms + 1) * 103 / 2000 {
                push(&mut buffer, ms * 1000, (ms * 103 / 2000) as u16, &[0, 1]);
            }
            if ms % 20 == 0 {
                let _ = buffer.take(ms * 1000);
            }
        }
        let counts = buffer.counts();
        assert!((60..=120).contains(&counts.skipped), "{counts:?}");
        assert!(counts.lost <= 2 && counts.late == 0, "{counts:?}");
    }

    #[test]
    fn a_block_that_is_too_large_and_a_session_that_ends_leave_nothing() {
        let mut buffer = Buffer::default();
        let large = Fragment {
            element: 0,
            blob: 0,
            offset: 0,
            total: 4 * FRAGMENT as u32,
            bytes: &[0; FRAGMENT],
        };
        buffer.push(0, &large);
        assert!(buffer.is_silent() && buffer.counts().large == 1);
        push(&mut buffer, 0, 9, &[0, 1]);
        buffer.silence();
        assert!(buffer.is_silent() && buffer.take(1_000_000).is_none());
    }
}
