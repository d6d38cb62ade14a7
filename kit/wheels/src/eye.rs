//! What a simulated robot sees (W22): the walls, the floor and a scale of headings, as a camera on its front would show them.
//!
//! A ray is cast for each column of pixels; how far it goes until it meets a wall says how much of the column is wall. There is
//! nothing else to see: robots do not see each other. The picture is a function of floor and pose alone, so that a robot that stands
//! sees the same again.
//!
//! | parameter | value | source |
//! |---|---|---|
//! | [`WIDTH`], [`HEIGHT`] | 320 × 240 pixels | assumed; W22 says only "video of few frames" |
//! | horizontal angle of view | 60° | assumed |
//! | height of the eye, of the walls | 100 mm, 400 mm | assumed |
//! | tiles of the floor, panels of the walls | 500 mm | assumed: they show that it drives |
//! | heading scale, at the top | a mark for each 15°, a long one for each 45°, and the colour of the wall at 0, 90, 180 and 270° | ours |

use crate::wall::Wall;
use crate::{Floor, Pose};

/// The width of the picture, pixels.
pub const WIDTH: u32 = 320;
/// The height of the picture, pixels.
pub const HEIGHT: u32 = 240;

/// Pixels: the half of the width over the tangent of the half of the angle of view, 30°.
const FOCAL: f64 = 160.0 * 1.732_050_807_568_877_2;
/// The row of what is as high as the eye.
const HORIZON: f64 = 120.0;
/// mm above the floor.
const EYE: f64 = 100.0;
/// mm, the height of the walls.
const WALL: f64 = 400.0;
/// mm, the side of a tile of the floor and the width of a panel of a wall.
const TILE: f64 = 500.0;
/// mm, the nearest at which a wall is seen.
const NEAREST: f64 = 1.0;
/// The longest side of a floor that is drawn, mm.
const LARGEST: f64 = 1e9;
/// mm at which things have half of their brightness.
const DIM: f64 = 6000.0;
/// Rows of the heading scale; marks of 45° and of 15° within it.
const SCALE: u32 = 14;
const LONG: u32 = 9;
const SHORT: u32 = 4;

const CEILING: Rgb = [196.0, 204.0, 214.0];
const TILES: [Rgb; 2] = [[150.0, 140.0, 128.0], [118.0, 110.0, 102.0]];
const STRIP: Rgb = [24.0, 26.0, 30.0];
const MARK: Rgb = [220.0, 220.0, 220.0];

type Rgb = [f64; 3];

/// What the ray of one column meets.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hit {
    wall: Wall,
    /// mm ahead, by which things become smaller: not along the ray.
    depth: f64,
    /// mm along the wall, from its end at the lower coordinate.
    along: f64,
    /// How many mm the ray goes along x and y for each mm ahead.
    ray: [f64; 2],
}

/// The picture of a robot at this pose: [`HEIGHT`] rows of [`WIDTH`] pixels, from the top left one on, a byte each of red, green and
/// blue. A pose beside the floor is taken to be at its edge, and what is not a number to be 0.
///
/// ```
/// use mom_wheels::{Floor, Pose, eye};
///
/// let picture = eye::draw(Floor::ARENA, Pose::new(2500.0, 2500.0, 0.0));
/// assert_eq!(picture.len(), (eye::WIDTH * eye::HEIGHT * 3) as usize);
/// assert_ne!(picture, eye::draw(Floor::ARENA, Pose::new(2500.0, 2500.0, 5.0)));
/// ```
#[must_use]
pub fn draw(floor: Floor, pose: Pose) -> Vec<u8> {
    let (floor, pose) = (real_floor(floor), pose_on(floor, pose));
    let columns: Vec<(Hit, Option<Mark>)> = (0..WIDTH)
        .map(|column| (hit(floor, pose, column), mark(pose, column)))
        .collect();
    let mut pixels = Vec::with_capacity((WIDTH * HEIGHT * 3) as usize);
    for row in 0..HEIGHT {
        for (hit, mark) in &columns {
            let colour = match row < SCALE {
                true => scale(*mark, row),
                false => seen(hit, pose, row),
            };
            pixels.extend(colour.map(|part| part.round().clamp(0.0, 255.0) as u8));
        }
    }
    pixels
}

/// How bright the floor is there, in percent, as a sensor close above it sees it. A place beside the floor is taken to be at its edge.
#[must_use]
pub fn brightness(floor: Floor, x: f64, y: f64) -> u8 {
    let Pose { x, y, .. } = pose_on(floor, Pose { x, y, heading: 0.0 });
    let [red, green, blue] = tile(x, y);
    ((red + green + blue) / 3.0 / 2.55).round().clamp(0.0, 100.0) as u8
}

/// A floor whose sides are numbers that a robot's distance to a wall makes a difference to.
fn real_floor(floor: Floor) -> Floor {
    let side = |side: f64| match side.is_finite() {
        true => side.clamp(2.0 * NEAREST, LARGEST),
        false => 2.0 * NEAREST,
    };
    Floor {
        width: side(floor.width),
        depth: side(floor.depth),
    }
}

/// The pose where walls can be seen from.
fn pose_on(floor: Floor, pose: Pose) -> Pose {
    let floor = real_floor(floor);
    let number = |value: f64| if value.is_finite() { value } else { 0.0 };
    Pose {
        x: number(pose.x).clamp(NEAREST, floor.width - NEAREST),
        y: number(pose.y).clamp(NEAREST, floor.depth - NEAREST),
        heading: number(pose.heading),
    }
}

/// How far right of the middle a place in the picture is, for each mm ahead.
fn aside(column: f64) -> f64 {
    (column - f64::from(WIDTH) / 2.0) / FOCAL
}

/// Casts the ray of a column.
fn hit(floor: Floor, pose: Pose, column: u32) -> Hit {
    let (sin, cos) = pose.heading.to_radians().sin_cos();
    let aside = aside(f64::from(column) + 0.5);
    let ray @ [x, y] = [cos + aside * sin, sin - aside * cos];
    // A ray along a wall never meets it.
    let across = if x > 0.0 {
        (Wall::East, (floor.width - pose.x) / x)
    } else {
        (Wall::West, if x < 0.0 { pose.x / -x } else { f64::INFINITY })
    };
    let up = if y > 0.0 {
        (Wall::North, (floor.depth - pose.y) / y)
    } else {
        (Wall::South, if y < 0.0 { pose.y / -y } else { f64::INFINITY })
    };
    let ((wall, depth), along) = if across.1 <= up.1 {
        (across, pose.y + y * across.1)
    } else {
        (up, pose.x + x * up.1)
    };
    Hit {
        wall,
        depth,
        along,
        ray,
    }
}

impl Hit {
    /// The rows between which the wall is seen.
    fn rows(&self) -> (f64, f64) {
        (
            HORIZON - FOCAL * (WALL - EYE) / self.depth,
            HORIZON + FOCAL * EYE / self.depth,
        )
    }
}

/// The colour of a pixel below the heading scale.
fn seen(hit: &Hit, pose: Pose, row: u32) -> Rgb {
    let (top, bottom) = hit.rows();
    let row = f64::from(row) + 0.5;
    if row < top {
        // Darker where it is further away.
        return lit(CEILING, FOCAL * (WALL - EYE) / (HORIZON - row).max(1.0));
    }
    if row < bottom {
        let shade = if is_even(hit.along) { 1.0 } else { 0.8 };
        return lit(colour(hit.wall), hit.depth).map(|part| part * shade);
    }
    let depth = FOCAL * EYE / (row - HORIZON).max(1.0);
    let [x, y] = [pose.x + hit.ray[0] * depth, pose.y + hit.ray[1] * depth];
    lit(tile(x, y), depth)
}

/// The colour of the floor's tile there.
fn tile(x: f64, y: f64) -> Rgb {
    let [light, dark] = TILES;
    if is_even(x) == is_even(y) { light } else { dark }
}

fn colour(wall: Wall) -> Rgb {
    match wall {
        Wall::East => [214.0, 92.0, 80.0],
        Wall::North => [96.0, 168.0, 92.0],
        Wall::West => [84.0, 132.0, 206.0],
        Wall::South => [216.0, 178.0, 72.0],
    }
}

fn lit(colour: Rgb, depth: f64) -> Rgb {
    colour.map(|part| part / (1.0 + depth / DIM))
}

/// Whether a place is in an even tile.
fn is_even(place: f64) -> bool {
    (place / TILE).floor().rem_euclid(2.0) == 0.0
}

/// A mark of the heading scale: how long, and its colour.
type Mark = (u32, Rgb);

/// The mark that stands at a column, if one does.
fn mark(pose: Pose, column: u32) -> Option<Mark> {
    let bearing = |column: u32| pose.heading - aside(f64::from(column)).atan().to_degrees();
    // Bearings fall from left to right.
    let (left, right) = (bearing(column), bearing(column + 1));
    let there = (left / 15.0).floor() * 15.0;
    let degrees = (there > right).then(|| there.rem_euclid(360.0).round() as u16)?;
    Some(match degrees {
        0 | 360 => (SCALE, colour(Wall::East)),
        90 => (SCALE, colour(Wall::North)),
        180 => (SCALE, colour(Wall::West)),
        270 => (SCALE, colour(Wall::South)),
        _ if degrees.is_multiple_of(45) => (LONG, MARK),
        _ => (SHORT, MARK),
    })
}

fn scale(mark: Option<Mark>, row: u32) -> Rgb {
    match mark {
        Some((length, colour)) if row < length => colour,
        _ => STRIP,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pixel(picture: &[u8], column: u32, row: u32) -> [u16; 3] {
        let place = ((row * WIDTH + column) * 3) as usize;
        [0, 1, 2].map(|part| u16::from(picture[place + part]))
    }

    /// The rows of a column that show the wall, of a robot that looks east from so far away.
    fn wall_rows(away: f64, column: u32) -> usize {
        let pose = Pose::new(5000.0 - away, 2500.0, 0.0);
        let picture = draw(Floor::ARENA, pose);
        let red = |row: &u32| {
            let [red, green, blue] = pixel(&picture, column, *row);
            red > green + green / 2 && red > blue + blue / 2
        };
        (SCALE..HEIGHT).filter(red).count()
    }

    #[test]
    fn a_near_wall_fills_more_of_a_column_than_a_far_one() {
        for column in [WIDTH / 2, WIDTH / 3] {
            let rows = [300.0, 1000.0, 3000.0].map(|away| wall_rows(away, column));
            assert!(
                rows.is_sorted_by(|near, far| near > far),
                "{rows:?} in column {column}"
            );
        }
        // 400 mm at 3 m, by the focal length.
        assert!((36..=38).contains(&wall_rows(3000.0, WIDTH / 2)));
    }

    #[test]
    fn a_corridor_looks_the_same_on_both_sides() {
        let corridor = Floor {
            width: 20_000.0,
            depth: 2000.0,
        };
        let pose = Pose::new(3000.0, 1000.0, 0.0);
        for column in 0..WIDTH / 2 {
            let (left, right) = (
                hit(corridor, pose, column),
                hit(corridor, pose, WIDTH - 1 - column),
            );
            assert!((left.depth - right.depth).abs() < 1e-6, "column {column}");
            let opposite = match left.wall {
                Wall::North => Wall::South,
                other => other,
            };
            assert_eq!(right.wall, opposite, "column {column}");
        }
        assert_eq!(hit(corridor, pose, 0).wall, Wall::North, "it is at the left");
        assert_eq!(hit(corridor, pose, WIDTH / 2).wall, Wall::East);
    }

    #[test]
    fn a_straight_wall_has_one_depth_and_what_is_ahead_is_in_the_middle() {
        let pose = Pose::new(4000.0, 2500.0, 0.0);
        for column in 0..WIDTH {
            let hit = hit(Floor::ARENA, pose, column);
            assert_eq!(hit.wall, Wall::East);
            assert!((hit.depth - 1000.0).abs() < 1e-6, "column {column}");
        }
        // North is ahead: its mark is in the middle, and all of the strip's height.
        let picture = draw(Floor::ARENA, Pose::new(2500.0, 2500.0, 90.0));
        let [red, green, blue] = pixel(&picture, WIDTH / 2, SCALE - 1);
        assert!(green > red && green > blue, "{red} {green} {blue}");
    }

    #[test]
    fn the_picture_moves_with_the_robot() {
        let pictures = [
            Pose::new(2500.0, 2500.0, 0.0),
            Pose::new(2550.0, 2500.0, 0.0),
            Pose::new(2500.0, 2550.0, 0.0),
            Pose::new(2500.0, 2500.0, 2.0),
        ]
        .map(|pose| draw(Floor::ARENA, pose));
        for (place, picture) in pictures.iter().enumerate() {
            for other in &pictures[place + 1..] {
                let differ = picture
                    .chunks(3)
                    .zip(other.chunks(3))
                    .filter(|(a, b)| a != b)
                    .count();
                assert!(differ > 500, "{differ} pixels");
            }
        }
    }

    fn any_number() -> impl Strategy<Value = f64> {
        prop_oneof![
            -1e4..1e4_f64,
            any::<f64>(),
            Just(0.0),
            Just(5000.0),
            Just(f64::NAN),
            Just(f64::INFINITY),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Whatever the pose and the floor: it draws, and each ray meets a wall that is ahead.
        #[test]
        fn every_pose_has_a_picture(x in any_number(), y in any_number(), heading in any_number(), width in any_number(), depth in any_number()) {
            let (floor, pose) = (Floor { width, depth }, Pose { x, y, heading });
            prop_assert_eq!(draw(floor, pose).len(), (WIDTH * HEIGHT * 3) as usize);
            let (floor, pose) = (real_floor(floor), pose_on(floor, pose));
            for column in 0..WIDTH {
                let depth = hit(floor, pose, column).depth;
                prop_assert!(depth > 0.0 && depth.is_finite(), "{} in column {}", depth, column);
            }
        }
    }
}
