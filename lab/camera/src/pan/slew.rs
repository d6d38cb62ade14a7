//! How the mount turns: both axes at constant speed, as a pure function of time.

use super::aim::Aim;

/// µs since the server began.
pub type CameraTime = i64;

/// Degrees/s of the pan axis, at most.
pub const PAN_SPEED: f64 = 60.0;
/// Degrees/s of the tilt axis, at most.
pub const TILT_SPEED: f64 = 40.0;

/// A turn from one aim to another; the slower axis sets its duration, the other keeps step with it.
///
/// ```
/// use mom_camera::pan::{Aim, Slew};
///
/// let slew = Slew::new(Aim::new(0.0, 0.0), Aim::new(30.0, 10.0), 1_000_000);
/// assert_eq!(slew.ends(), 1_500_000);
/// assert_eq!(slew.at(1_250_000), Aim::new(15.0, 5.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slew {
    from: Aim,
    to: Aim,
    begins: CameraTime,
    ends: CameraTime,
}

impl Slew {
    /// A turn that begins at a time, in µs.
    #[must_use]
    pub fn new(from: Aim, to: Aim, begins: CameraTime) -> Self {
        let seconds = ((to.pan - from.pan).abs() / PAN_SPEED).max((to.tilt - from.tilt).abs() / TILT_SPEED);
        // Rounded up, so that no speed is exceeded.
        let lasts = (seconds * 1e6).ceil() as CameraTime;
        Self {
            from,
            to,
            begins,
            ends: begins.saturating_add(lasts),
        }
    }

    /// None: it stands.
    #[must_use]
    pub fn rest(aim: Aim) -> Self {
        Self::new(aim, aim, 0)
    }

    /// Where it looks at this time; before the beginning the first aim, after the end the last.
    #[must_use]
    pub fn at(&self, now: CameraTime) -> Aim {
        if now >= self.ends {
            return self.to;
        }
        let passed = now.saturating_sub(self.begins).max(0) as f64;
        let part = passed / (self.ends - self.begins) as f64;
        let mix = |from: f64, to: f64| from + (to - from) * part;
        Aim::new(mix(self.from.pan, self.to.pan), mix(self.from.tilt, self.to.tilt))
    }

    /// Where it ends.
    #[must_use]
    pub fn target(&self) -> Aim {
        self.to
    }

    /// When it ends.
    #[must_use]
    pub fn ends(&self) -> CameraTime {
        self.ends
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::aim::{PANS, TILTS};
    use super::*;

    #[test]
    fn the_slower_axis_sets_the_duration() {
        let from = Aim::new(0.0, 0.0);
        for (to, lasts) in [
            (from, 0),
            (Aim::new(60.0, 0.0), 1_000_000),
            (Aim::new(-60.0, -40.0), 1_000_000),
            (Aim::new(6.0, -20.0), 500_000),
        ] {
            assert_eq!(Slew::new(from, to, 7).ends(), 7 + lasts, "{to}");
        }
    }

    proptest! {
        #[test]
        fn it_is_never_faster_than_its_motors_and_never_out_of_reach(
            from in (PANS, TILTS), to in (PANS, TILTS), early in 0..9_000_000_i64, span in 1..2_000_000_i64,
        ) {
            let aim = |(pan, tilt): (f64, f64)| Aim::new(pan, tilt);
            let slew = Slew::new(aim(from), aim(to), 1000);
            let (a, b) = (slew.at(early), slew.at(early + span));
            let seconds = span as f64 / 1e6;
            prop_assert!((a.pan - b.pan).abs() <= PAN_SPEED * seconds + 1e-9, "{a} {b}");
            prop_assert!((a.tilt - b.tilt).abs() <= TILT_SPEED * seconds + 1e-9, "{a} {b}");
            prop_assert!(a.check().is_ok() && b.check().is_ok(), "{a} {b}");
            prop_assert_eq!(slew.at(0), aim(from));
            prop_assert_eq!(slew.at(slew.ends()), aim(to));
        }
    }
}
