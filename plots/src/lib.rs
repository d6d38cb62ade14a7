//! Draws: plots of measurements as SVG, readable on light and on dark ground.
//!
//! [`Plot`] has points and lines over linear or logarithmic axes, with labelled marks for numbers to compare with;
//! [`Bars`] are bars in groups. Both give the text of a file.
//!
//! ```
//! use mom_plots::{Axis, Plot, Series, quantiles};
//!
//! let times = quantiles(&[0.4, 0.6, 1.4]);
//! let plot = Plot::new("Connect time", Axis::log("s"), Axis::linear("share of the clients"))
//!     .with(Series::steps("measured", times))
//!     .mark_x(0.6, "median of the paper");
//! assert!(plot.to_svg().starts_with("<svg"));
//! ```

mod axis;
mod bars;
mod page;
mod plot;

pub use axis::{Axis, plain};
pub use bars::{Bar, Bars, Group};
pub use plot::{Plot, Series};

/// The share of the values that are not above each of them, from the least value to the greatest: a quantile curve.
pub fn quantiles(values: &[f64]) -> Vec<(f64, f64)> {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let count = sorted.len() as f64;
    let with_share = |(at, value): (usize, f64)| (value, (at + 1) as f64 / count);
    sorted.into_iter().enumerate().map(with_share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_rise_to_one_and_leave_out_what_is_no_number() {
        assert_eq!(
            quantiles(&[3.0, 1.0, f64::NAN, 2.0, 2.0]),
            [(1.0, 0.25), (2.0, 0.5), (2.0, 0.75), (3.0, 1.0)]
        );
        assert!(quantiles(&[]).is_empty());
    }
}
