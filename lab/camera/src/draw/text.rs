//! Letters as strokes on a grid of 5×7 points, enough for numbers and captions.

use tiny_skia::PathBuilder;

use super::canvas::{Canvas, Ink};
use crate::geometry::Pixel;

/// From one letter to the next, in grid steps.
const ADVANCE: f32 = 6.0;
/// From the top of a letter to its foot, in grid steps.
const HEIGHT: f32 = 6.0;

/// The strokes of each letter: runs of points, each an x of 0 to 4 and a y of 0 (top) to 6, a space between runs.
const STROKES: [(char, &str); 43] = [
    ('0', "103041453616050110"),
    ('1', "112026 1636"),
    ('2', "01103041420646"),
    ('3', "004023334445361605"),
    ('4', "36300444"),
    ('5', "4000023243453606"),
    ('6', "30100105163645443303"),
    ('7', "004016"),
    ('8', "13020110304142331304051636454433"),
    ('9', "43130201103041453616"),
    ('A', "0602204246 0444"),
    ('B', "06003041423303 3344453606"),
    ('C', "4130100105163645"),
    ('D', "00062644422000"),
    ('E', "40000646 0333"),
    ('F', "400006 0333"),
    ('G', "41301001051636454323"),
    ('H', "0006 4046 0343"),
    ('I', "1030 2026 1636"),
    ('J', "4045361605"),
    ('K', "0006 400346"),
    ('L', "000646"),
    ('M', "0600234046"),
    ('N', "06004640"),
    ('O', "103041453616050110"),
    ('P', "06003041423303"),
    ('Q', "103041453616050110 2446"),
    ('R', "06003041423303 2346"),
    ('S', "413010010213334445361605"),
    ('T', "0040 2026"),
    ('U', "000516364540"),
    ('V', "002640"),
    ('W', "0016223640"),
    ('X', "0046 4006"),
    ('Y', "002340 2326"),
    ('Z', "00400646"),
    ('-', "1333"),
    ('+', "0343 2125"),
    ('.', "2526"),
    (',', "2516"),
    (':', "2122 2526"),
    ('/', "0640"),
    ('°', "1021120110"),
];

/// The width of a text in pixels at `step` pixels per grid step.
pub(crate) fn text_width(text: &str, step: f32) -> f32 {
    (text.chars().count() as f32 * ADVANCE - (ADVANCE - 4.0)).max(0.0) * step
}

/// The height of a line in pixels at `step` pixels per grid step.
pub(crate) fn text_height(step: f32) -> f32 {
    HEIGHT * step
}

impl Canvas<'_> {
    /// Writes a line with its upper left corner at `at`; letters that are not known leave a gap.
    pub(crate) fn text(&mut self, text: &str, at: Pixel, step: f32, ink: Ink) {
        let mut path = PathBuilder::new();
        for (i, letter) in text.chars().enumerate() {
            let left = at.0 + i as f32 * ADVANCE * step;
            push_letter(&mut path, letter.to_ascii_uppercase(), (left, at.1), step);
        }
        self.stroke_path(path.finish(), ink, (step * 0.95).max(0.8));
    }

    /// Writes a line with its middle at `at`.
    pub(crate) fn text_around(&mut self, text: &str, at: Pixel, step: f32, ink: Ink) {
        let corner = (
            at.0 - text_width(text, step) / 2.0,
            at.1 - text_height(step) / 2.0,
        );
        self.text(text, corner, step, ink);
    }
}

fn push_letter(path: &mut PathBuilder, letter: char, at: Pixel, step: f32) {
    let Some((_, runs)) = STROKES.iter().find(|(known, _)| *known == letter) else {
        return;
    };
    for run in runs.split(' ') {
        for (i, point) in run.as_bytes().chunks_exact(2).enumerate() {
            let x = at.0 + f32::from(point[0] - b'0') * step;
            let y = at.1 + f32::from(point[1] - b'0') * step;
            if i == 0 {
                path.move_to(x, y);
            } else {
                path.line_to(x, y);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_is_on_the_grid_and_there_once() {
        for (i, (letter, runs)) in STROKES.iter().enumerate() {
            assert!(
                STROKES[..i].iter().all(|(other, _)| other != letter),
                "{letter} twice"
            );
            for run in runs.split(' ') {
                let points: Vec<u8> = run.bytes().collect();
                assert!(
                    points.len() >= 4 && points.len().is_multiple_of(2),
                    "{letter}: {run}"
                );
                let on_grid = points
                    .chunks(2)
                    .all(|p| (b'0'..=b'4').contains(&p[0]) && (b'0'..=b'6').contains(&p[1]));
                assert!(on_grid, "{letter}: {run}");
            }
        }
    }

    #[test]
    fn a_text_is_as_wide_as_its_letters() {
        let check = |text: &str, expected: f32| assert_eq!(text_width(text, 2.0), expected, "{text:?}");
        check("", 0.0);
        check("A", 8.0);
        check("AB", 20.0);
        check("12°", 32.0);
    }
}
