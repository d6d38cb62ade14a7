//! Sequence numbers of 16 bits (S15), their continuation to 64, and the window that knows which were heard.

use crate::Dropped;

/// Whether `a` comes after `b`, by RFC 1982.
#[must_use]
pub const fn is_newer(a: u16, b: u16) -> bool {
    let ahead = a.wrapping_sub(b);
    ahead != 0 && ahead < 0x8000
}

/// How many of the newest sequences are known to have been heard or not.
pub(crate) const WINDOW: u32 = 128;

/// What was heard in one direction of a session.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    /// The newest that was heard, continued to 64 bits.
    newest: u64,
    /// Bit n: `newest` − n was heard. 0 before the first.
    heard: u128,
}

impl Window {
    pub(crate) const NEW: Window = Window { newest: 0, heard: 0 };

    /// The sequence continued to 64 bits: of those with these low bits the one nearest to the newest heard.
    pub(crate) fn continued(&self, sequence: u16) -> Result<u64, Dropped> {
        let low = self.newest as u16;
        let ahead = i64::from(sequence.wrapping_sub(low).cast_signed());
        let full = self.newest.checked_add_signed(ahead).ok_or(Dropped::Old)?;
        let back = self.newest.saturating_sub(full);
        if back >= u64::from(WINDOW) {
            return Err(Dropped::Old);
        }
        match full <= self.newest && self.heard >> back & 1 == 1 {
            true => Err(Dropped::Replayed),
            false => Ok(full),
        }
    }

    /// Marks as heard what [`continued`](Self::continued) gave.
    pub(crate) fn mark(&mut self, full: u64) {
        if let Some(ahead) = full.checked_sub(self.newest).filter(|&ahead| ahead > 0) {
            let shift = u32::try_from(ahead).unwrap_or(u32::MAX);
            self.heard = self.heard.checked_shl(shift).unwrap_or(0);
            self.newest = full;
        }
        let back = self.newest - full;
        self.heard |= 1 << (back % u64::from(WINDOW));
    }

    /// The share of the last packets that was not heard, 0 to 1.
    #[cfg(feature = "middle")]
    pub(crate) fn loss(&self) -> f32 {
        if self.heard == 0 {
            return 0.0;
        }
        let sent = self.newest.saturating_add(1).min(u64::from(WINDOW));
        1.0 - self.heard.count_ones() as f32 / sent as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newer_is_by_rfc_1982() {
        assert!(is_newer(1, 0) && is_newer(0, 0xFFFF) && is_newer(0x7FFF, 0) && is_newer(5, 0xFFF0));
        assert!(!is_newer(0, 0) && !is_newer(0xFFFF, 0) && !is_newer(0x8000, 0));
    }

    #[test]
    fn the_window_continues_over_wraps_jumps_and_reordering() {
        let mut window = Window::NEW;
        for (sequence, full) in [
            (0, 0),
            (1, 1),
            (30_000, 30_000),
            (60_000, 60_000),
            (3, 65_539),
            (65_530, 65_530),
        ] {
            assert_eq!(window.continued(sequence), Ok(full), "{sequence}");
            window.mark(full);
            assert_eq!(window.continued(sequence), Err(Dropped::Replayed), "{sequence}");
        }
        assert_eq!(
            window.continued(65_411),
            Err(Dropped::Old),
            "128 back is out of the window"
        );
        assert_eq!(window.continued(65_412), Ok(65_412));
    }

    #[test]
    fn a_session_begins_near_0() {
        assert_eq!(Window::NEW.continued(0xFFFF), Err(Dropped::Old));
        assert_eq!(Window::NEW.continued(3), Ok(3));
    }
}
