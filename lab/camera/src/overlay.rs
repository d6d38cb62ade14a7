//! What may be laid over an image, as lines in the world: the pose, where it is by now (M34), the path to it (M44), the
//! blocks' outlines.

use mom_client::{Map, Value};

use crate::geometry::Point;
use crate::robot::ToolFrame;
use crate::scene::{DrawnBlock, DrawnPose, MOST_BLOCKS, MOST_POSES, Scene, half_edges};

/// How far the pose's mark goes from the tip along the gripper and along the jaw line, mm.
const ALONG: f64 = 60.0;
const JAW: f64 = 30.0;

/// The overlay of the pose that the robot told.
pub(crate) const POSE: &str = "pose";
/// The overlay of the pose where it is by now.
pub(crate) const PREDICTED: &str = "predicted";

/// A line of several points in the world.
///
/// It goes beside the image: the viewer maps the points by the image's matrix, or leaves them out.
///
/// ```
/// use mom_camera::{Overlay, Scene};
///
/// let overlays = Overlay::of(&Scene::default());
/// assert_eq!(overlays[0].name, "pose");
/// assert_eq!(overlays[0].points[1], [0.0, 0.0, 200.0]);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Overlay {
    /// `pose`, `predicted`, `path`, or `block` and the block's name.
    pub name: String,
    /// The points in the table's frame, mm.
    pub points: Vec<[f64; 3]>,
}

impl Overlay {
    /// All overlays of a scene: the pose, the predicted one if the robot moves, the path if there is one, and each block.
    ///
    /// They have the limits of [`Renderer::render`](crate::Renderer::render): 64 blocks and 200 poses.
    pub fn of(scene: &Scene) -> Vec<Overlay> {
        let scene = scene.drawable(MOST_BLOCKS, MOST_POSES);
        let mut overlays = vec![pose(POSE, &scene.pose)];
        overlays.extend(
            scene
                .predicted
                .as_ref()
                .map(|predicted| pose(PREDICTED, predicted)),
        );
        if scene.trail.len() > 1 {
            overlays.push(Overlay {
                name: "path".to_owned(),
                points: scene.trail.iter().map(|pose| [pose.x, pose.y, pose.z]).collect(),
            });
        }
        overlays.extend(scene.blocks.iter().map(block));
        overlays
    }

    /// `{name, points: [[x, y, z], …]}`, to a tenth of a millimetre: XML writes each digit.
    pub(crate) fn to_map(&self) -> Map {
        let tenths = |mm: f64| Value::Double((mm * 10.0).round() / 10.0);
        let point = |point: &[f64; 3]| Value::from(point.iter().map(|mm| tenths(*mm)).collect::<Vec<_>>());
        Map::new()
            .with("name", self.name.as_str())
            .with("points", self.points.iter().map(point).collect::<Vec<_>>())
    }
}

/// Along the gripper to its tip, and across it from jaw to jaw.
fn pose(name: &str, pose: &DrawnPose) -> Overlay {
    let tool = ToolFrame::new(pose);
    let marks = [
        [0.0, 0.0, ALONG],
        [0.0, 0.0, 0.0],
        [-JAW, 0.0, 0.0],
        [JAW, 0.0, 0.0],
    ];
    Overlay {
        name: name.to_owned(),
        points: marks.map(|mark| numbers(&tool.at(mark))).to_vec(),
    }
}

/// One line over all twelve edges; some of them are passed twice.
fn block(block: &DrawnBlock) -> Overlay {
    let [a, b, c] = half_edges(block);
    let middle = Point::new(block.x, block.y, block.z);
    // The corners below, around the block, and then those above them.
    let corner = |i: usize| {
        let (x, y) = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][i % 4];
        let z = if i < 4 { -1.0 } else { 1.0 };
        numbers(&(middle + a * x + b * y + c * z))
    };
    let around = [0, 1, 2, 3, 0, 4, 5, 1, 5, 6, 2, 6, 7, 3, 7, 4];
    Overlay {
        name: format!("block {}", block.name).trim_end().to_owned(),
        points: around.map(corner).to_vec(),
    }
}

fn numbers(point: &Point) -> [f64; 3] {
    [point.x, point.y, point.z]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn scene(blocks: Vec<DrawnBlock>, trail: Vec<DrawnPose>) -> Scene {
        Scene {
            blocks,
            trail,
            ..Scene::default()
        }
    }

    #[test]
    fn the_line_of_a_block_passes_all_its_edges() {
        let red = DrawnBlock {
            name: "red".to_owned(),
            x: 100.0,
            size: [40.0, 60.0, 80.0],
            z: 40.0,
            ..DrawnBlock::default()
        };
        let overlays = Overlay::of(&scene(vec![red, DrawnBlock::default()], vec![]));
        let names: Vec<&str> = overlays.iter().map(|overlay| overlay.name.as_str()).collect();
        assert_eq!(names, ["pose", "block red", "block"]);
        let mut edges = BTreeSet::new();
        for pair in overlays[1].points.windows(2) {
            let changed: Vec<usize> = (0..3).filter(|i| pair[0][*i] != pair[1][*i]).collect();
            assert_eq!(changed.len(), 1, "{pair:?} is an edge");
            let mut ends = [pair[0], pair[1]].map(|point| point.map(|mm| mm as i64));
            ends.sort_unstable();
            edges.insert(ends);
        }
        assert_eq!(edges.len(), 12);
        let far = overlays[1]
            .points
            .iter()
            .copied()
            .reduce(|a, b| [0, 1, 2].map(|i| a[i].max(b[i])));
        assert_eq!(far, Some([120.0, 30.0, 80.0]));
    }

    #[test]
    fn a_predicted_pose_is_marked_beside_the_measured_one() {
        let mut moving = scene(vec![], vec![]);
        moving.predicted = Some(DrawnPose {
            x: 45.0,
            ..moving.pose
        });
        let overlays = Overlay::of(&moving);
        let tips = overlays
            .iter()
            .map(|overlay| (overlay.name.as_str(), overlay.points[1][0]));
        assert_eq!(tips.collect::<Vec<_>>(), [("pose", 0.0), ("predicted", 45.0)]);
    }

    #[test]
    fn the_path_is_there_once_something_has_moved() {
        let at = |x: f64| DrawnPose {
            x,
            ..DrawnPose::default()
        };
        assert_eq!(Overlay::of(&scene(vec![], vec![at(1.0)])).len(), 1);
        let overlays = Overlay::of(&scene(vec![], vec![at(1.0), at(f64::NAN), at(3.04)]));
        let path = [[1.0, 0.0, 200.0], [0.0, 0.0, 200.0], [3.04, 0.0, 200.0]];
        assert_eq!(overlays[1].points, path);
        let told = overlays[1].to_map();
        let points = told.get("points").and_then(Value::as_list).unwrap();
        let last = points[2].as_list().unwrap();
        assert_eq!(last[0], Value::Double(3.0), "to a tenth");
        let long = Overlay::of(&scene(vec![DrawnBlock::default(); 100], vec![at(1.0); 300]));
        assert_eq!((long.len(), long[1].points.len()), (66, 200));
    }
}
