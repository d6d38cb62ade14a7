//! The third paper: the protocol between a thin robot and the computer that thinks for it, over a modelled link in virtual time, and over
//! the kernel's own TCP.

pub(super) mod acks;
pub(super) mod delay;
pub(super) mod filter;
pub(super) mod path;
mod probe;
pub(super) mod sizes;
mod world;

use std::fmt;

/// T, µs (S10).
const PERIOD: u64 = 20_000;
const MS: u64 = 1000;
const SECOND: u64 = 1_000_000;

/// A mean with the half of its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Mean {
    mean: f64,
    half: f64,
}

impl Mean {
    /// Of independent runs, by Student's distribution.
    fn of(values: &[f64]) -> Mean {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let half = match values.len() {
            0 | 1 => f64::NAN,
            _ => student(count - 1.0) * (squares / (count - 1.0) / count).sqrt(),
        };
        Mean { mean, half }
    }
}

impl fmt::Display for Mean {
    /// With the digits that are asked for.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(1);
        let plus = if f.sign_plus() && self.mean >= 0.0 {
            "+"
        } else {
            ""
        };
        match (self.mean.is_nan(), self.half.is_nan()) {
            (true, _) => f.write_str("none"),
            (_, true) => write!(f, "{plus}{:.digits$}", self.mean),
            _ => write!(f, "{plus}{:.digits$} ± {:.digits$}", self.mean, self.half),
        }
    }
}

/// The value that Student's distribution exceeds in either direction in 5 % of the draws (Cornish and Fisher's series).
fn student(freedom: f64) -> f64 {
    if freedom < 3.0 {
        // The series is too short there.
        return if freedom < 2.0 { 12.706 } else { 4.303 };
    }
    let z: f64 = 1.959_964;
    let first = (z.powi(3) + z) / 4.0;
    let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    z + first / freedom + second / freedom.powi(2) + third / freedom.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_students() {
        for (freedom, tabled) in [
            (1.0, 12.706),
            (2.0, 4.303),
            (4.0, 2.776),
            (9.0, 2.262),
            (29.0, 2.045),
        ] {
            assert!((student(freedom) - tabled).abs() < 0.01, "{freedom}");
        }
        let mean = Mean::of(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(format!("{mean:.2}"), "3.00 ± 1.96");
        assert_eq!(Mean::of(&[7.0]).to_string(), "7.0");
        assert_eq!(Mean::of(&[]).to_string(), "none");
    }
}
