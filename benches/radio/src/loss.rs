//! What is lost between two places.

/// Where a station is, in m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Position {
    /// East.
    pub x: f64,
    /// North.
    pub y: f64,
}

impl Position {
    /// A place in the plane.
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Position {
        Position { x, y }
    }

    /// How far another place is, in m.
    #[must_use]
    pub fn distance(self, other: Position) -> f64 {
        (self.x - other.x).hypot(self.y - other.y)
    }
}

/// How likely an attempt at a frame is lost. An acknowledgement never is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Nothing is lost but by collisions.
    None,
    /// This share of the attempts, 0 to 1, wherever the stations are.
    Flat(f64),
    /// By the distance.
    Distance(PathLoss),
}

impl Loss {
    /// The probability that an attempt over a distance, in m, is lost at a rate, in bit/s.
    #[must_use]
    pub fn probability(&self, distance: f64, rate: u32) -> f64 {
        match self {
            Loss::None => 0.0,
            Loss::Flat(share) => share.clamp(0.0, 1.0),
            Loss::Distance(path) => 1.0 - path.success(distance, rate),
        }
    }
}

/// The log-distance model of path loss, and a logistic curve of what is received at which signal-to-noise ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathLoss {
    /// Power of the sender, dBm.
    pub power: f64,
    /// Noise at the receiver, dBm.
    pub noise: f64,
    /// Loss over the first metre, dB.
    pub first_metre: f64,
    /// The exponent: 2 in free space, 2 to 6 indoors.
    pub exponent: f64,
    /// The signal-to-noise ratio at which half of the frames are received at 1 Mbit/s, dB.
    pub half_at: f64,
    /// How soft the edge is: the scale of the logistic curve, dB.
    pub softness: f64,
}

/// 15 dBm, noise of −91 dBm, 40.2 dB over the first metre (free space at 2.44 GHz), exponent 3, half of the frames at 4 dB, scale 2.2 dB.
impl Default for PathLoss {
    fn default() -> PathLoss {
        PathLoss {
            power: 15.0,
            noise: -91.0,
            first_metre: 40.2,
            exponent: 3.0,
            half_at: 4.0,
            softness: 2.2,
        }
    }
}

impl PathLoss {
    /// The signal-to-noise ratio at a distance in m, dB. Below a metre it is that of a metre.
    #[must_use]
    pub fn signal_to_noise(&self, distance: f64) -> f64 {
        let decades = distance.max(1.0).log10();
        self.power - self.first_metre - 10.0 * self.exponent * decades - self.noise
    }

    /// The share of frames that is received over a distance in m, at a rate in bit/s: a rate twice as high needs 3 dB more.
    ///
    /// ```
    /// let path = mom_radio::PathLoss::default();
    /// assert!(path.success(5.0, 2_000_000) > 0.999);
    /// assert!(path.success(500.0, 2_000_000) < 0.001);
    /// ```
    #[must_use]
    pub fn success(&self, distance: f64, rate: u32) -> f64 {
        let needed = self.half_at + 10.0 * (f64::from(rate.max(1)) / 1e6).log10();
        let above = self.signal_to_noise(distance) - needed;
        1.0 / (1.0 + (-above / self.softness.max(f64::MIN_POSITIVE)).exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_of_the_frames_are_received_where_it_says_so() {
        let path = PathLoss::default();
        // 15 − 40.2 − 30 log d + 91 = 4, so log d = 61.8 / 30.
        let half = 10f64.powf(61.8 / 30.0);
        assert!((path.signal_to_noise(half) - 4.0).abs() < 1e-9);
        assert!((path.success(half, 1_000_000) - 0.5).abs() < 1e-9);
        // 3.01 dB above the ratio that 2 Mbit/s has half of its frames at.
        let expected = 1.0 / (1.0 + (10.0 * 2f64.log10() / 2.2).exp());
        assert!((path.success(half, 2_000_000) - expected).abs() < 1e-9);
        assert_eq!(path.signal_to_noise(0.0), path.signal_to_noise(1.0));
    }

    proptest::proptest! {
        #[test]
        fn loss_rises_with_the_distance_and_the_rate(near in 0.0..1000.0f64, further in 0.0..1000.0f64, rate in 1u32..11_000_000) {
            let loss = Loss::Distance(PathLoss::default());
            let (one, other) = (loss.probability(near, rate), loss.probability(near + further, rate));
            proptest::prop_assert!((0.0..=1.0).contains(&one) && one <= other && other <= 1.0);
            proptest::prop_assert!(one <= loss.probability(near, rate * 2));
            let flat = Loss::Flat(0.3);
            proptest::prop_assert_eq!(flat.probability(near, rate), flat.probability(near + further, rate));
        }
    }
}
