//! Markers in drawn images: found to a small part of a pixel, or refused with the reason.

use mom_calibrate::marker::{MarkerError, Spot, find};
use mom_calibrate::{COLOUR, Picture};
use proptest::prelude::*;

const SIZE: [usize; 2] = [96, 72];

/// A canvas whose pixels are sampled at 16 × 16 places.
struct Drawing {
    picture: Picture,
}

impl Drawing {
    fn new(background: impl Fn(usize, usize) -> [u8; 3]) -> Drawing {
        let [width, height] = SIZE;
        let pixels = (0..width * height)
            .map(|i| background(i % width, i / width))
            .collect();
        Drawing {
            picture: Picture {
                width,
                height,
                pixels,
            },
        }
    }

    /// Fills what is inside with a colour.
    fn fill(mut self, colour: [u8; 3], inside: impl Fn(f64, f64) -> bool) -> Drawing {
        const FINE: usize = 16;
        for (i, pixel) in self.picture.pixels.iter_mut().enumerate() {
            let at = |place: usize, sample: usize| place as f64 + (sample as f64 + 0.5) / FINE as f64;
            let samples = (0..FINE * FINE)
                .filter(|sample| inside(at(i % SIZE[0], sample % FINE), at(i / SIZE[0], sample / FINE)));
            let share = samples.count() as f64 / (FINE * FINE) as f64;
            for (part, new) in pixel.iter_mut().zip(colour) {
                *part = (f64::from(*part) * (1.0 - share) + f64::from(new) * share).round() as u8;
            }
        }
        self
    }

    fn disc(self, [x, y]: [f64; 2], radius: f64, colour: [u8; 3]) -> Drawing {
        self.fill(colour, |u, v| (u - x).hypot(v - y) <= radius)
    }

    fn find(&self) -> Result<Spot, MarkerError> {
        find(&self.picture, COLOUR)
    }
}

/// Paint, steel, blocks.
const BEHIND: [[u8; 3]; 6] = [
    [243, 112, 33],
    [78, 84, 94],
    [176, 183, 192],
    [214, 64, 56],
    [52, 112, 205],
    [241, 196, 40],
];

fn grey(_: usize, _: usize) -> [u8; 3] {
    [222, 226, 230]
}

fn off(spot: Spot, [x, y]: [f64; 2]) -> f64 {
    (spot.middle[0] - x).hypot(spot.middle[1] - y)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn the_middle_of_a_disc(x in 20.0..70.0, y in 20.0..50.0, radius in 3.0..14.0_f64) {
        let spot = Drawing::new(grey).disc([x, y], radius, COLOUR).find().expect("seen");
        prop_assert!(off(spot, [x, y]) < 0.02, "{:?}", spot);
        let area = std::f64::consts::PI * radius * radius;
        prop_assert!((spot.area / area - 1.0).abs() < 0.03, "{} {}", spot.area, area);
    }

    /// What is behind differs from side to side. Only where it changes along the rim itself, nobody can tell what is
    /// behind the rim.
    #[test]
    fn the_middle_before_what_the_lab_has(
        x in 20.0..70.0,
        y in 20.0..50.0,
        radius in 4.0..12.0_f64,
        edge in 15.0..75.0,
        left in prop::sample::select(&BEHIND[..]),
        right in prop::sample::select(&BEHIND[..]),
    ) {
        let along_the_rim = (f64::abs(x - edge) - radius).abs() < 4.0;
        let most = if along_the_rim { 0.3 } else { 0.06 };
        let split = |u: usize, _| if (u as f64) < edge { left } else { right };
        let spot = Drawing::new(split).disc([x, y], radius, COLOUR).find().expect("seen");
        prop_assert!(off(spot, [x, y]) < most, "{:?} before {:?} and {:?}", spot, left, right);
    }

    #[test]
    fn noise_of_the_sensor_is_averaged(x in 20.0..70.0, y in 20.0..50.0, radius in 4.0..12.0_f64, seed in 0_u64..100) {
        let mut drawing = Drawing::new(grey).disc([x, y], radius, COLOUR);
        let mut random = fastrand::Rng::with_seed(seed);
        for pixel in &mut drawing.picture.pixels {
            *pixel = pixel.map(|part| part.saturating_add_signed(random.i8(-4..=4)));
        }
        let spot = drawing.find().expect("seen");
        prop_assert!(off(spot, [x, y]) < 0.05, "{:?}", spot);
    }
}

#[test]
fn what_is_not_seen_whole_and_alone_is_left_out() {
    let middle = [48.0, 36.0];
    let seen = |drawing: Drawing| drawing.find().expect_err("left out");
    assert_eq!(seen(Drawing::new(grey)), MarkerError::NotSeen);
    // Colours of blocks are not the marker's.
    for colour in [[229, 120, 160], [132, 82, 176], [214, 64, 56]] {
        assert_eq!(
            seen(Drawing::new(grey).disc(middle, 9.0, colour)),
            MarkerError::NotSeen,
            "{colour:?}"
        );
    }
    assert_eq!(
        seen(Drawing::new(grey).disc(middle, 1.2, COLOUR)),
        MarkerError::NotSeen
    );
    for border in [[4.0, 36.0], [48.0, 2.0], [93.0, 36.0], [48.0, 70.0]] {
        assert_eq!(
            seen(Drawing::new(grey).disc(border, 6.0, COLOUR)),
            MarkerError::AtBorder,
            "{border:?}"
        );
    }
    let two = Drawing::new(grey)
        .disc([25.0, 36.0], 6.0, COLOUR)
        .disc([70.0, 30.0], 5.0, COLOUR);
    assert_eq!(seen(two), MarkerError::Several(2));
    // A speck is none.
    let speck = Drawing::new(grey)
        .disc([25.0, 36.0], 8.0, COLOUR)
        .disc([70.0, 30.0], 2.0, COLOUR);
    assert!(speck.find().is_ok());
}

/// The more is hidden, the surer it is left out; what passes is not far off.
#[test]
fn a_marker_behind_an_edge_is_left_out() {
    let (middle, radius) = ([48.3, 35.8], 9.0);
    for (turn, cut) in (0..8).flat_map(|turn| (0..18).map(move |cut| (turn, cut))) {
        let (sin, cos) = (f64::from(turn) * 0.7).sin_cos();
        let hidden = f64::from(cut);
        let drawing = Drawing::new(grey)
            .disc(middle, radius, COLOUR)
            .fill([78, 84, 94], |x, y| {
                (x - middle[0]) * cos + (y - middle[1]) * sin > radius - hidden
            });
        match drawing.find() {
            Ok(spot) => assert!(off(spot, middle) < 1.0, "{hidden} hidden: {spot:?}"),
            Err(MarkerError::Hidden) => assert!(cut > 0),
            Err(error) => assert!(
                error == MarkerError::NotSeen && cut > 15,
                "{hidden} hidden: {error}"
            ),
        }
        assert!(hidden < 4.0 || drawing.find().is_err(), "{hidden} hidden");
    }
}

#[test]
fn bytes_that_are_no_image_are_an_error() {
    assert!(Picture::decode(b"nonsense").is_err());
    assert!(Picture::decode(&[]).is_err());
}
