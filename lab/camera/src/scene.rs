//! What a camera sees: the arm's state, read from the arm's parcels.

use nalgebra::Rotation3;
use serde::de::{Deserializer, IgnoredAny};
use serde::{Deserialize, Serialize};

use crate::geometry::Direction;
use crate::pan::Aim;

/// The opening of the jaws when the arm says only "open", mm.
const OPEN: f64 = 80.0;
/// Coordinates further from the origin than this are drawn at this distance, mm.
const FARTHEST: f64 = 10_000.0;
/// The longest edge of a block that is drawn, mm.
const LARGEST: f64 = 2_000.0;

/// More letters of a block's name are left out.
const LONGEST: usize = 40;
/// More blocks and poses than these are not drawn, so that no scene can hold the camera up.
pub(crate) const MOST_BLOCKS: usize = 64;
pub(crate) const MOST_POSES: usize = 200;

/// Everything that is drawn.
///
/// It is read from the content of the arm's `state` parcels. Missing fields have their defaults and unknown fields
/// are ignored, so that a camera and an arm of different versions understand each other.
///
/// ```
/// use mom_camera::Scene;
///
/// let scene: Scene = serde_json::from_str(
///     r#"{"seq": 7, "pose": {"x": 100, "y": 50, "z": 200}, "gripper": {"grip": "close", "opening": 40},
///         "blocks": [{"name": "a", "x": 0, "y": 0, "z": 20, "size": 40, "colour": [200, 40, 40]}]}"#,
/// )?;
/// assert_eq!(scene.pose.z, 200.0);
/// assert_eq!(scene.gripper.opening, 40.0);
/// assert_eq!(scene.blocks[0].size, [40.0; 3]);
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Scene {
    /// The pose of the gripper.
    pub pose: DrawnPose,
    /// How far the jaws are open.
    pub gripper: DrawnGripper,
    /// The blocks on the table and between the jaws.
    pub blocks: Vec<DrawnBlock>,
    /// The path to draw and its poses, oldest first (M44).
    pub trail: Vec<DrawnPose>,
    /// Where the gripper is by now, if it moves (M34); no state of the robot tells it.
    #[serde(skip)]
    pub predicted: Option<DrawnPose>,
    /// Where the camera looks that turns; no state of the robot tells it either.
    #[serde(skip)]
    pub aim: Aim,
}

/// The pose of the gripper's tip in the table's frame (M50).
///
/// At spin 0 and tilt 0 the gripper points straight down and its jaws close along the x axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DrawnPose {
    /// Along the table's x axis, mm.
    pub x: f64,
    /// Along the table's y axis, mm.
    pub y: f64,
    /// Above the table, mm.
    pub z: f64,
    /// About the vertical, degrees, counter-clockwise seen from above.
    pub spin: f64,
    /// From the vertical, degrees, about the jaw line, which stays parallel to the table; at spin 0 a positive tilt
    /// points the fingers away from the viewer at the front, towards positive y.
    pub tilt: f64,
}

/// The gripper's jaws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DrawnGripper {
    /// The distance between the jaws, mm.
    pub opening: f64,
}

/// A block; its place is that of its middle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DrawnBlock {
    /// Its name at the robot.
    pub name: String,
    /// Along the table's x axis, mm.
    pub x: f64,
    /// Along the table's y axis, mm.
    pub y: f64,
    /// Above the table, mm; half its height when it lies on the table.
    pub z: f64,
    /// The lengths of the edges along the block's own axes, mm; one number for a cube.
    #[serde(deserialize_with = "edges")]
    pub size: [f64; 3],
    /// About the vertical, degrees, counter-clockwise seen from above.
    pub yaw: f64,
    /// About its own first level axis, degrees, while it is carried.
    pub tilt: f64,
    /// A list of three numbers, a name such as `red`, or `#rrggbb`.
    #[serde(alias = "color")]
    pub colour: Colour,
}

/// A colour as red, green and blue, 0 to 255 each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Colour(pub [u8; 3]);

impl Default for DrawnPose {
    fn default() -> Self {
        DrawnPose {
            x: 0.0,
            y: 0.0,
            z: 200.0,
            spin: 0.0,
            tilt: 0.0,
        }
    }
}

impl Default for DrawnGripper {
    fn default() -> Self {
        DrawnGripper { opening: OPEN }
    }
}

impl Default for DrawnBlock {
    fn default() -> Self {
        DrawnBlock {
            name: String::new(),
            x: 0.0,
            y: 0.0,
            z: 20.0,
            tilt: 0.0,
            size: [40.0; 3],
            yaw: 0.0,
            colour: Colour::default(),
        }
    }
}

impl Default for Colour {
    fn default() -> Self {
        Colour([150, 156, 166])
    }
}

impl Colour {
    /// The colour of a name or of `#rrggbb`; grey if there is none.
    pub fn from_name(name: &str) -> Colour {
        let name = name.trim().to_ascii_lowercase();
        let named = NAMES
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, rgb)| *rgb);
        named.or_else(|| from_hex(&name)).map(Colour).unwrap_or_default()
    }
}

/// Shades that go together and stand off from the grey table, rather than the screen's pure ones.
const NAMES: [(&str, [u8; 3]); 13] = [
    ("red", [214, 64, 56]),
    ("green", [62, 160, 85]),
    ("blue", [52, 112, 205]),
    ("yellow", [241, 196, 40]),
    ("orange", [238, 130, 38]),
    ("purple", [132, 82, 176]),
    ("violet", [132, 82, 176]),
    ("cyan", [44, 172, 190]),
    ("pink", [229, 120, 160]),
    ("brown", [140, 96, 62]),
    ("white", [244, 244, 240]),
    ("black", [48, 50, 56]),
    ("wood", [214, 178, 126]),
];

fn from_hex(text: &str) -> Option<[u8; 3]> {
    let digits = text.strip_prefix('#').filter(|d| d.len() == 6 && d.is_ascii())?;
    let byte = |i: usize| u8::from_str_radix(&digits[i..i + 2], 16).ok();
    Some([byte(0)?, byte(2)?, byte(4)?])
}

impl Scene {
    /// The scene with numbers that can be drawn: finite and bounded.
    pub(crate) fn drawable(&self, blocks: usize, trail: usize) -> Scene {
        let newest = self.trail.len().saturating_sub(trail);
        Scene {
            pose: self.pose.drawable(),
            gripper: DrawnGripper {
                opening: finite(self.gripper.opening).clamp(0.0, 120.0),
            },
            blocks: self
                .blocks
                .iter()
                .take(blocks)
                .map(DrawnBlock::drawable)
                .collect(),
            trail: self.trail[newest..].iter().map(DrawnPose::drawable).collect(),
            predicted: self.predicted.as_ref().map(DrawnPose::drawable),
            aim: self.aim,
        }
    }
}

impl DrawnPose {
    /// The pose with finite numbers; others become 0.
    pub(crate) fn drawable(&self) -> DrawnPose {
        let DrawnPose { x, y, z, spin, tilt } = *self;
        DrawnPose {
            x: place(x),
            y: place(y),
            z: place(z),
            spin: angle(spin),
            tilt: angle(tilt),
        }
    }
}

impl DrawnBlock {
    fn drawable(&self) -> DrawnBlock {
        DrawnBlock {
            name: self.name.chars().take(LONGEST).collect(),
            x: place(self.x),
            y: place(self.y),
            z: place(self.z),
            size: self.size.map(|edge| finite(edge).abs().clamp(1.0, LARGEST)),
            yaw: angle(self.yaw),
            tilt: angle(self.tilt),
            colour: self.colour,
        }
    }
}

/// Half the block's edges, from its middle.
pub(crate) fn half_edges(block: &DrawnBlock) -> [Direction; 3] {
    let yaw = Rotation3::from_axis_angle(&Direction::z_axis(), block.yaw.to_radians());
    let tilt = Rotation3::from_axis_angle(&Direction::x_axis(), block.tilt.to_radians());
    let axes = [Direction::x(), Direction::y(), Direction::z()];
    std::array::from_fn(|i| yaw * tilt * axes[i] * (block.size[i] / 2.0))
}

fn finite(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

fn place(value: f64) -> f64 {
    finite(value).clamp(-FARTHEST, FARTHEST)
}

fn angle(value: f64) -> f64 {
    finite(value) % 360.0
}

/// Three edges, or one for a cube.
fn edges<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 3], D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum BlockForm {
        Cube(f64),
        Edges([f64; 3]),
    }
    Ok(match BlockForm::deserialize(deserializer)? {
        BlockForm::Cube(edge) => [edge; 3],
        BlockForm::Edges(edges) => edges,
    })
}

impl<'de> Deserialize<'de> for DrawnGripper {
    /// Millimetres, a word (`open`, `closed`), whether it is open, or a map with `opening`.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum GripForm {
            Open(bool),
            Opening(f64),
            Word(String),
            Map { opening: f64 },
            Other(IgnoredAny),
        }
        let opening = match GripForm::deserialize(deserializer)? {
            GripForm::Opening(opening) | GripForm::Map { opening } => opening,
            GripForm::Open(open) => f64::from(u8::from(open)) * OPEN,
            GripForm::Word(word) if word.to_ascii_lowercase().starts_with("clos") => 0.0,
            GripForm::Word(_) | GripForm::Other(_) => OPEN,
        };
        Ok(DrawnGripper { opening })
    }
}

impl<'de> Deserialize<'de> for Colour {
    /// A name, `#rrggbb`, or a list of three numbers.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum ColourForm {
            Name(String),
            Rgb([u8; 3]),
            Other(IgnoredAny),
        }
        Ok(match ColourForm::deserialize(deserializer)? {
            ColourForm::Name(name) => Colour::from_name(&name),
            ColourForm::Rgb(rgb) => Colour(rgb),
            ColourForm::Other(_) => Colour::default(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_of_the_arm_is_read() {
        let scene: Scene = serde_json::from_str(
            r#"{"seq": 3, "pose": {"x": 1, "y": 2.5, "z": 3, "spin": 4, "tilt": -5},
                "gripper": {"grip": "close", "opening": 40.0}, "holding": "red", "moving": true, "stopped": false,
                "executing": {"id": 1, "statement": 1, "of": 2}, "waiting": 0,
                "blocks": [{"name": "red", "colour": [200, 40, 41], "size": 40, "x": 1, "y": 2.5, "z": 3, "yaw": 4,
                            "tilt": 5}]}"#,
        )
        .unwrap();
        let block = DrawnBlock {
            name: "red".to_owned(),
            x: 1.0,
            y: 2.5,
            z: 3.0,
            size: [40.0; 3],
            yaw: 4.0,
            tilt: 5.0,
            colour: Colour([200, 40, 41]),
        };
        let expected = Scene {
            pose: DrawnPose {
                x: 1.0,
                y: 2.5,
                z: 3.0,
                spin: 4.0,
                tilt: -5.0,
            },
            gripper: DrawnGripper { opening: 40.0 },
            blocks: vec![block],
            trail: vec![],
            predicted: None,
            aim: Aim::default(),
        };
        assert_eq!(scene, expected);
        let again: Scene = serde_json::from_str(&serde_json::to_string(&scene).unwrap()).unwrap();
        assert_eq!(again, scene);
    }

    #[test]
    fn what_is_missing_has_its_default() {
        assert_eq!(serde_json::from_str::<Scene>("{}").unwrap(), Scene::default());
        let scene: Scene = serde_json::from_str(r#"{"blocks": [{"x": 7}], "trail": [{"z": 9}]}"#).unwrap();
        assert_eq!(
            scene.blocks,
            [DrawnBlock {
                x: 7.0,
                ..DrawnBlock::default()
            }]
        );
        assert_eq!(
            scene.trail,
            [DrawnPose {
                z: 9.0,
                ..DrawnPose::default()
            }]
        );
    }

    #[test]
    fn grippers_and_colours_have_several_forms() {
        let opening = |json: &str| serde_json::from_str::<DrawnGripper>(json).unwrap().opening;
        for (json, expected) in [
            ("25", 25.0),
            (r#"{"opening": 12.5, "force": 3}"#, 12.5),
            (r#""open""#, OPEN),
            (r#""close""#, 0.0),
            (r#""Closed""#, 0.0),
            ("true", OPEN),
            ("false", 0.0),
            ("null", OPEN),
        ] {
            assert_eq!(opening(json), expected, "{json}");
        }
        let colour = |json: &str| serde_json::from_str::<Colour>(json).unwrap().0;
        for (json, expected) in [
            ("[1, 2, 3]", [1, 2, 3]),
            (r##""#0a0B0c""##, [10, 11, 12]),
            (r#""Red""#, NAMES[0].1),
            (r#""no such""#, Colour::default().0),
            (r##""#12é4""##, Colour::default().0),
            ("[1, 2, 300]", Colour::default().0),
        ] {
            assert_eq!(colour(json), expected, "{json}");
        }
    }
}
