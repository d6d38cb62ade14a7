//! Axes: what a value is on the page, and where the lines go.

use crate::page::{HEIGHT, LEFT, TOP, WIDTH};

/// Space to the right of what is drawn.
const RIGHT: f64 = 24.0;

/// One axis of a plot.
#[derive(Clone, Debug)]
pub struct Axis {
    label: String,
    log: bool,
    range: Option<(f64, f64)>,
}

impl Axis {
    /// Equal steps are equal differences.
    pub fn linear(label: impl Into<String>) -> Axis {
        Axis {
            label: label.into(),
            log: false,
            range: None,
        }
    }

    /// Equal steps are equal factors; what is not above 0 is left out.
    pub fn log(label: impl Into<String>) -> Axis {
        Axis {
            log: true,
            ..Axis::linear(label)
        }
    }

    /// From where to where, whatever is drawn; by default as far as what is drawn.
    pub fn from_to(mut self, least: f64, most: f64) -> Axis {
        self.range = Some((least, most));
        self
    }

    pub(crate) fn label(&self) -> &str {
        &self.label
    }

    /// Whether a value has a place on it.
    pub(crate) fn takes(&self, value: f64) -> bool {
        value.is_finite() && (!self.log || value > 0.0)
    }

    /// The axis over these values, rounded outwards.
    pub(crate) fn over(&self, values: impl Iterator<Item = f64>) -> Span {
        let taken = values.filter(|value| self.takes(*value));
        let (least, most) = self.range.unwrap_or_else(|| {
            taken.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
                (least.min(value), most.max(value))
            })
        });
        // Nothing is drawn then; an axis there is all the same.
        let (least, most) = if least.is_finite() {
            (least, most)
        } else {
            (1.0, 10.0)
        };
        match self.log {
            true => Span::of_factors(least, most, self.range.is_some()),
            false => Span::of_steps(least, most, self.range.is_some()),
        }
    }
}

/// An axis with its ends and lines.
#[derive(Debug)]
pub(crate) struct Span {
    log: bool,
    from: f64,
    to: f64,
    pub(crate) ticks: Vec<f64>,
}

impl Span {
    fn of_steps(least: f64, most: f64, exact: bool) -> Span {
        // A difference goes to 0 where 0 is near.
        let least = if !exact && least > 0.0 && least < most / 2.0 {
            0.0
        } else {
            least
        };
        let wide = if most > least {
            most - least
        } else {
            least.abs().max(1.0)
        };
        let rough = wide / 6.0;
        let decade = 10_f64.powf(rough.log10().floor());
        let factor = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .find(|factor| decade * factor >= rough);
        let step = decade * factor.unwrap_or(10.0);
        let (from, to) = match exact {
            true => (least, least + wide),
            false => (
                (least / step).floor() * step,
                ((least + wide) / step).ceil() * step,
            ),
        };
        let first = (from / step).ceil();
        let count = ((to / step) - first + 1e-9).floor();
        let ticks = (0..=count as usize).map(|number| (first + number as f64) * step);
        Span {
            log: false,
            from,
            to,
            ticks: ticks.collect(),
        }
    }

    fn of_factors(least: f64, most: f64, exact: bool) -> Span {
        let (first, last) = (least.log10().floor(), most.log10().ceil());
        let last = last.max(first + 1.0);
        let few = last - first <= 2.0;
        let within = |tick: f64| !exact || (tick >= least * 0.999 && tick <= most * 1.001);
        let mut ticks = Vec::new();
        let mut power = first;
        while power <= last {
            let decade = 10_f64.powf(power);
            let factors: &[f64] = if few && power < last {
                &[1.0, 2.0, 5.0]
            } else {
                &[1.0]
            };
            ticks.extend(
                factors
                    .iter()
                    .map(|factor| decade * factor)
                    .filter(|tick| within(*tick)),
            );
            power += 1.0;
        }
        let (from, to) = match exact && least < most {
            true => (least, most),
            false => (10_f64.powf(first), 10_f64.powf(last)),
        };
        Span {
            log: true,
            from,
            to,
            ticks,
        }
    }

    /// The part of the axis below a value; 0 and 1 at its ends and beyond.
    fn part(&self, value: f64) -> f64 {
        let part = match self.log {
            true => (value / self.from).log10() / (self.to / self.from).log10(),
            false => (value - self.from) / (self.to - self.from),
        };
        part.clamp(0.0, 1.0)
    }

    /// The place from left to right.
    pub(crate) fn x(&self, value: f64) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * self.part(value)
    }

    /// The place from top to bottom.
    pub(crate) fn y(&self, value: f64) -> f64 {
        TOP + HEIGHT * (1.0 - self.part(value))
    }
}

/// A number as a label: as many digits as it needs, with a space between thousands.
pub fn plain(value: f64) -> String {
    let digits = match value.abs() {
        0.0 => 0,
        size if size >= 100.0 => 0,
        size => (2.0 - size.log10().floor()).clamp(0.0, 9.0) as usize,
    };
    let text = format!("{value:.digits$}");
    let text = match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.'),
        false => &text,
    };
    let whole = text.find('.').unwrap_or(text.len());
    let mut spaced = String::new();
    for (at, c) in text.char_indices() {
        let left = whole.saturating_sub(at);
        if at > 0 && left > 0 && left % 3 == 0 && !spaced.ends_with('-') && whole > 4 {
            // A narrow blank at which no line breaks.
            spaced.push('\u{202f}');
        }
        spaced.push(c);
    }
    spaced
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_as_labels() {
        for (value, text) in [
            (0.0, "0"),
            (0.05, "0.05"),
            (0.2, "0.2"),
            (1.0, "1"),
            (2.5, "2.5"),
            (33.6, "33.6"),
            (1000.0, "1000"),
            (10_000.0, "10\u{202f}000"),
            (1_234_567.0, "1\u{202f}234\u{202f}567"),
            (-20_000.0, "-20\u{202f}000"),
            (0.000_1, "0.0001"),
        ] {
            assert_eq!(plain(value), text);
        }
    }

    #[test]
    fn linear_axes_end_at_round_numbers() {
        let span = Axis::linear("").over([0.3, 9.7].into_iter());
        assert_eq!(span.ticks, [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(
            (span.y(0.0), span.y(10.0), span.y(11.0)),
            (TOP + HEIGHT, TOP, TOP)
        );
        let exact = Axis::linear("").from_to(0.0, 1.0).over([7.0].into_iter());
        assert_eq!(exact.ticks, [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        let one = Axis::linear("").over([5.0].into_iter());
        assert!(one.ticks.len() > 2, "{one:?}");
    }

    #[test]
    fn logarithmic_axes_end_at_decades() {
        let span = Axis::log("").over([0.0, 3.0, 4_000.0].into_iter());
        assert_eq!(span.ticks, [1.0, 10.0, 100.0, 1000.0, 10_000.0]);
        assert_eq!(span.x(100.0), LEFT + (WIDTH - LEFT - RIGHT) / 2.0);
        let few = Axis::log("").over([2.0, 40.0].into_iter());
        assert_eq!(few.ticks, [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]);
        assert!(!Axis::log("").takes(0.0) && Axis::linear("").takes(0.0));
        assert_eq!(Axis::log("").over([].into_iter()).ticks.first(), Some(&1.0));
    }
}
