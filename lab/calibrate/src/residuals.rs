//! The picture of the residuals, as SVG: a dot where the marker was measured, and an arrow from where the matrix has it.

use std::fmt::Write as _;

use crate::Calibration;

/// The longest arrow, pixels of the picture.
const LONGEST: f64 = 60.0;
/// Room above the image for the words.
const HEAD: f64 = 52.0;

/// Draws the residuals of a calibration over a frame of the image's size. Arrows are enlarged, which the picture says.
#[must_use]
pub fn svg(calibration: &Calibration, title: &str, width: f64, height: f64) -> String {
    let enlarged = enlargement(calibration.max);
    let mut svg = String::new();
    let outliers = match calibration.outliers() {
        0 => String::new(),
        count => format!(", {count} left out (red)"),
    };
    // Writing to a string cannot fail.
    let _ = write!(
        svg,
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {full}" width="{width}" height="{full}" font-family="sans-serif">
<rect width="{width}" height="{full}" fill="#ffffff"/>
<text x="8" y="20" font-size="15" fill="#1e2a3a">{title}</text>
<text x="8" y="40" font-size="12" fill="#4a5568">RMS {rms:.3} px, largest {max:.3} px, {used} poses{outliers}; arrows enlarged {enlarged} times</text>
<g transform="translate(0 {HEAD})">
<rect width="{width}" height="{height}" fill="#f4f6f8" stroke="#8a94a3"/>
<path d="M{x} 0V{height}M0 {y}H{width}" stroke="#d5dbe3" fill="none"/>
"##,
        full = height + HEAD,
        title = escaped(title),
        rms = calibration.rms,
        max = calibration.max,
        used = calibration.used(),
        x = width / 2.0,
        y = height / 2.0,
    );
    for residual in &calibration.residuals {
        let [u, v] = residual.observation.pixel;
        let colour = if residual.used { "#1f6fc4" } else { "#c62f2f" };
        let long = residual.length() * enlarged;
        // That of an outlier may leave the picture; its direction is enough.
        let shown = if long > LONGEST { LONGEST / long } else { 1.0 } * enlarged;
        if long.is_finite() && long > 0.5 {
            let [dx, dy] = residual.error.map(|part| part * shown);
            let (tip_x, tip_y) = (u + dx, v + dy);
            let head = |turn: f64| {
                let (sin, cos) = (dy.atan2(dx) + turn).sin_cos();
                format!("{:.2} {:.2}", tip_x - 6.0 * cos, tip_y - 6.0 * sin)
            };
            let _ = writeln!(
                svg,
                r#"<path d="M{u:.2} {v:.2}L{tip_x:.2} {tip_y:.2}M{}L{tip_x:.2} {tip_y:.2}L{}" stroke="{colour}" stroke-width="1.5" fill="none"/>"#,
                head(0.45),
                head(-0.45),
            );
        }
        let _ = writeln!(svg, r#"<circle cx="{u:.2}" cy="{v:.2}" r="3" fill="{colour}"/>"#);
    }
    svg.push_str("</g>\n</svg>\n");
    svg
}

/// 1, 2 or 5 times a power of ten, so that the longest arrow of those used is as long as it may be.
fn enlargement(max: f64) -> f64 {
    if !(max.is_finite() && max > 0.0) {
        return 1.0;
    }
    let most = (LONGEST / max).clamp(1.0, 1e6);
    let power = 10.0_f64.powf(most.log10().floor());
    let step = [5.0, 2.0].into_iter().find(|step| step * power <= most);
    power * step.unwrap_or(1.0)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Observation, Projection, Residual};

    #[test]
    fn arrows_are_enlarged_by_a_round_number() {
        for (max, expected) in [
            (0.0, 1.0),
            (100.0, 1.0),
            (25.0, 2.0),
            (6.1, 5.0),
            (0.05, 1000.0),
            (0.012, 5000.0),
        ] {
            assert_eq!(enlargement(max), expected, "{max}");
        }
    }

    #[test]
    fn a_dot_for_each_measurement_and_outliers_in_red() {
        let residual = |error, used| Residual {
            observation: Observation {
                world: [0.0; 3],
                pixel: [100.0, 50.0],
            },
            error,
            used,
        };
        let calibration = Calibration {
            projection: Projection::new(crate::experiment::LAB_X).expect("a camera"),
            rms: 0.1,
            max: 0.1,
            condition: 10.0,
            residuals: vec![
                residual([0.1, 0.0], true),
                residual([0.0, 0.0], true),
                residual([30.0, 40.0], false),
                residual([f64::INFINITY; 2], false),
            ],
        };
        let drawn = svg(&calibration, "camera <x>", 640.0, 480.0);
        assert_eq!(drawn.matches("<circle").count(), 4);
        assert_eq!(
            drawn.matches("#c62f2f").count(),
            3,
            "two dots and an arrow: {drawn}"
        );
        assert!(drawn.contains("camera &lt;x&gt;"), "{drawn}");
        assert!(
            drawn.contains("2 left out") && drawn.contains("enlarged 500 times"),
            "{drawn}"
        );
        assert!(drawn.contains("M100.00 50.00L150.00 50.00"), "{drawn}");
        assert!(
            drawn.contains("M100.00 50.00L136.00 98.00"),
            "at most 60 long: {drawn}"
        );
    }
}
