//! The robot as solids: the ABB IRB 1400 of M49 beside the table, and its gripper.
//!
//! The sizes are those of the arm's own kinematics (`reach` of `mom-arm`), which names their sources; a camera knows
//! no arm but by what it is sent, so they stand here once more. The inverse kinematics serves the drawing only: it
//! finds an elbow for every pose and stretches the forearm where the real arm would not reach.

use nalgebra::{Rotation3, Vector2};

use crate::geometry::{Direction, Point};
use crate::scene::{Colour, DrawnGripper, DrawnPose};
use crate::solid::{Ball, Solid};

/// The axis about which joint 1 turns, mm.
const BASE: [f64; 2] = [-960.0, 0.0];
/// The shoulder's distance from that axis and its height above the floor, mm.
const SHOULDER: [f64; 2] = [150.0, 475.0];
/// From the shoulder to the elbow, mm.
const UPPER: f64 = 600.0;
/// From the elbow up to the forearm's axis, and along it to the wrist, mm.
const FORE: [f64; 2] = [120.0, 720.0];
/// From the gripper's tip to the middle of the wrist, mm.
const WRIST: f64 = 235.0;
/// The floor on which the arm and the table stand, mm.
pub(crate) const FLOOR: f64 = -400.0;
/// The crank beside the shoulder, which moves the forearm by a rod behind the upper arm, mm; for the eye.
const CRANK: f64 = 170.0;

const PAINT: Colour = Colour([243, 112, 33]);
const DARK: Colour = Colour([78, 84, 94]);
const STEEL: Colour = Colour([176, 183, 192]);
const RUBBER: Colour = Colour([56, 60, 68]);

/// Where the middle of the marker is in the gripper's frame, mm: along the jaw line, across it, and from the tip towards
/// the wrist (M55).
///
/// It is a ball on a stalk, beside the hand, so that the cameras x, y and top see it in most poses.
pub const MARKER: [f64; 3] = [0.0, -140.0, 75.0];
/// The radius of the marker, mm.
pub const MARKER_RADIUS: f64 = 12.0;
/// The colour of the marker, which nothing else has. It shines, so that it has no shades.
pub const MARKER_COLOUR: Colour = Colour([255, 0, 255]);

/// The gripper's frame: the tip and three directions of length 1.
#[derive(Debug, Clone)]
pub(crate) struct ToolFrame {
    tip: Point,
    axes: [Direction; 3],
}

impl ToolFrame {
    /// The frame of a pose: `Rz(spin) Rx(tilt)`, so that the jaw line is always parallel to the table (M50).
    pub(crate) fn new(pose: &DrawnPose) -> ToolFrame {
        let spin = Rotation3::from_axis_angle(&Direction::z_axis(), pose.spin.to_radians());
        let tilt = Rotation3::from_axis_angle(&Direction::x_axis(), pose.tilt.to_radians());
        let rotation = spin * tilt;
        let axes = [Direction::x(), Direction::y(), Direction::z()].map(|axis| rotation * axis);
        ToolFrame {
            tip: Point::new(pose.x, pose.y, pose.z),
            axes,
        }
    }

    /// A point given in this frame: along the jaw line, across it, from the tip towards the wrist, mm.
    pub(crate) fn at(&self, [jaw, across, up]: [f64; 3]) -> Point {
        self.tip + self.axes[0] * jaw + self.axes[1] * across + self.axes[2] * up
    }

    fn cuboid(&self, middle: [f64; 3], half: [f64; 3], colour: Colour) -> Solid {
        let edges = std::array::from_fn(|i| self.axes[i] * half[i]);
        Solid::cuboid(self.at(middle), edges, colour)
    }

    fn cylinder(&self, from: (f64, f64), to: (f64, f64), colour: Colour) -> Solid {
        let end = |(up, radius): (f64, f64)| (self.at([0.0, 0.0, up]), radius);
        Solid::cylinder(end(from), end(to), colour)
    }
}

/// The gripper: two jaws, their palm, the flange and the marker.
pub(crate) fn gripper(tool: &ToolFrame, gripper: &DrawnGripper) -> Vec<Solid> {
    let finger = |sign: f64| {
        let middle = sign * (gripper.opening / 2.0 + 4.0);
        [
            tool.cuboid([middle, 0.0, 12.0], [4.0, 8.0, 12.0], RUBBER),
            tool.cuboid([middle, 0.0, 42.0], [4.0, 8.0, 18.0], STEEL),
        ]
    };
    let mut solids = Vec::with_capacity(8);
    solids.extend(finger(-1.0));
    solids.extend(finger(1.0));
    let palm = (gripper.opening / 2.0 + 10.0).max(50.0);
    solids.push(tool.cuboid([0.0, 0.0, 75.0], [palm, 20.0, 15.0], DARK));
    solids.push(tool.cylinder((90.0, 32.0), (136.0, 38.0), STEEL));
    solids.extend(marker(tool));
    solids
}

/// The marker and its stalk.
fn marker(tool: &ToolFrame) -> [Solid; 2] {
    let [jaw, across, up] = MARKER;
    // It ends before the ball, so that the line around it covers nothing of that.
    let (from, to) = (-20.0, across + MARKER_RADIUS + 2.0);
    let ball = Ball {
        middle: tool.at(MARKER),
        radius: MARKER_RADIUS,
    };
    [
        tool.cuboid([jaw, (from + to) / 2.0, up], [3.0, (from - to) / 2.0, 3.0], DARK),
        Solid::ball(ball, tool.axes[2], MARKER_COLOUR),
    ]
}

/// Where the camera on the forearm sits: mm from the wrist back along the forearm, and below the forearm's axis.
const MOUNT: [f64; 2] = [250.0, 90.0];
/// How far below the forearm's direction it looks, degrees: the gripper's tip is from 8 to 26 below it.
const MOUNT_TILT: f64 = 20.0;

/// The camera on the forearm, which the third joint moves (M54).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mounted {
    pub(crate) at: Point,
    pub(crate) ahead: Direction,
    pub(crate) up: Direction,
}

impl Mounted {
    pub(crate) fn new(tool: &ToolFrame) -> Mounted {
        let DrawnJoints {
            across, along, wrist, ..
        } = DrawnJoints::new(tool);
        let above = along.cross(&across);
        let (sin, cos) = MOUNT_TILT.to_radians().sin_cos();
        let [back, below] = MOUNT;
        Mounted {
            at: wrist - along * back - above * below,
            ahead: along * cos - above * sin,
            up: along * sin + above * cos,
        }
    }
}

/// The camera on the forearm, as the other cameras see it.
pub(crate) fn wrist_camera(tool: &ToolFrame) -> [Solid; 2] {
    let Mounted { at, ahead, up } = Mounted::new(tool);
    let DrawnJoints { across, along, .. } = DrawnJoints::new(tool);
    let (above, body) = (along.cross(&across), at - ahead * 24.0);
    let bracket = [along * 6.0, across * 6.0, above * 12.0];
    [
        Solid::cuboid(body + above * 26.0, bracket, DARK),
        Solid::cuboid(body, [ahead * 24.0, across * 18.0, up * 14.0], RUBBER),
    ]
}

/// The joints of the arm for a pose.
struct DrawnJoints {
    /// The direction from the base towards the wrist, along the table.
    ahead: Direction,
    /// The direction of the shoulder's and the elbow's axes.
    across: Direction,
    /// The direction of the forearm.
    along: Direction,
    shoulder: Point,
    elbow: Point,
    wrist: Point,
}

impl DrawnJoints {
    fn new(tool: &ToolFrame) -> DrawnJoints {
        let wrist = tool.at([0.0, 0.0, WRIST]);
        let base = Point::new(BASE[0], BASE[1], FLOOR);
        let ahead = Direction::new(wrist.x - base.x, wrist.y - base.y, 0.0).try_normalize(1e-9);
        let ahead = ahead.unwrap_or(Direction::x());
        let across = Direction::z().cross(&ahead);
        let rising = |angle: f64| ahead * angle.cos() + Direction::z() * angle.sin();
        let angle_of = |way: Direction| f64::atan2(way.z, ahead.dot(&way));
        let shoulder = base + ahead * SHOULDER[0] + Direction::z() * SHOULDER[1];
        // The forearm's axis passes above the elbow; the law of cosines needs the straight line to the wrist.
        let fore = Vector2::from(FORE);
        let (line, offset) = (fore.norm(), fore.x.atan2(fore.y));
        // Kept within the lengths for which there is a triangle.
        let distance = (wrist - shoulder)
            .norm()
            .clamp(line - UPPER + 30.0, line + UPPER - 1.0);
        let cosine = (UPPER * UPPER + distance * distance - line * line) / (2.0 * UPPER * distance);
        let raised = angle_of(wrist - shoulder) + cosine.clamp(-1.0, 1.0).acos();
        let elbow = shoulder + rising(raised) * UPPER;
        DrawnJoints {
            ahead,
            across,
            along: rising(angle_of(wrist - elbow) - offset),
            shoulder,
            elbow,
            wrist,
        }
    }
}

/// The arm above the table's height, from the turret to the wrist.
pub(crate) fn arm(tool: &ToolFrame) -> Vec<Solid> {
    let DrawnJoints {
        ahead,
        across,
        along,
        shoulder,
        elbow,
        wrist,
    } = DrawnJoints::new(tool);
    let base = |z: f64| Point::new(BASE[0], BASE[1], FLOOR + z);
    let joint = |middle: Point, half: f64, radius: f64, colour: Colour| {
        Solid::cylinder(
            (middle - across * half, radius),
            (middle + across * half, radius),
            colour,
        )
    };
    // Beams end at the rim of the joints rather than in their middle, so that a plane parts them (see `solid`).
    let beam = |from: (Point, f64, [f64; 2]), to: (Point, f64, [f64; 2]), colour: Colour| {
        let axis = (to.0 - from.0).try_normalize(1e-9).unwrap_or(ahead);
        Solid::beam(
            (from.0 + axis * from.1, from.2),
            (to.0 - axis * to.1, to.2),
            across,
            colour,
        )
    };
    let above = along.cross(&across);
    let forearm = elbow + above * FORE[0];
    let neck = forearm + along * 260.0;
    let crank = along * -CRANK;
    vec![
        Solid::cylinder((base(250.0), 146.0), (base(320.0), 136.0), PAINT),
        Solid::beam(
            (base(320.0) + ahead * 20.0, [105.0, 120.0]),
            (shoulder + ahead * -30.0 + Direction::z() * -50.0, [85.0, 75.0]),
            across,
            PAINT,
        ),
        joint(shoulder, 100.0, 78.0, DARK),
        beam((shoulder, 70.0, [48.0, 66.0]), (elbow, 60.0, [42.0, 50.0]), PAINT),
        // The parallelogram: the rod is parallel to the upper arm, and the crank to the forearm.
        beam(
            (shoulder, 78.0, [20.0, 30.0]),
            (shoulder + crank, -15.0, [20.0, 20.0]),
            DARK,
        ),
        beam(
            (shoulder + crank, 20.0, [12.0, 12.0]),
            (elbow + crank, 20.0, [12.0, 12.0]),
            STEEL,
        ),
        beam(
            (elbow, 68.0, [24.0, 34.0]),
            (elbow + crank, -15.0, [20.0, 20.0]),
            DARK,
        ),
        joint(elbow, 82.0, 62.0, DARK),
        Solid::beam(
            (forearm - along * 190.0, [46.0, 44.0]),
            (forearm - along * 80.0, [56.0, 54.0]),
            across,
            DARK,
        ),
        beam((forearm, -80.0, [56.0, 56.0]), (neck, 0.0, [44.0, 44.0]), PAINT),
        beam((neck, 0.0, [44.0, 44.0]), (wrist, 40.0, [34.0, 34.0]), PAINT),
        joint(wrist, 46.0, 42.0, DARK),
        tool.cylinder((136.0, 28.0), (WRIST - 38.0, 30.0), DARK),
    ]
}

/// The arm's foot, which the table may hide.
pub(crate) fn foot() -> Vec<Solid> {
    let base = |z: f64| Point::new(BASE[0], BASE[1], FLOOR + z);
    vec![
        Solid::cylinder((base(0.0), 230.0), (base(40.0), 230.0), DARK),
        Solid::cylinder((base(40.0), 165.0), (base(200.0), 145.0), PAINT),
        Solid::cylinder((base(200.0), 158.0), (base(250.0), 158.0), DARK),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The arm's own kinematics (`links` of `mom-arm`'s `reach`) says where shoulder, elbow and forearm are.
    #[test]
    fn the_arm_is_drawn_where_it_is() {
        for ([x, y, z, spin, tilt], shoulder, elbow, forearm) in [
            (
                [0.0, 0.0, 300.0, 0.0, 0.0],
                [-810.0, 0.0, 75.0],
                [-717.7375, 0.0, 667.8639],
                [-676.7937, 0.0, 780.6629],
            ),
            (
                [-250.0, 200.0, 20.0, 70.0, 30.0],
                [-812.7674, 28.6802, 75.0],
                [-709.6066, 48.7754, 665.7233],
                [-623.8144, 65.4873, 747.9450],
            ),
        ] {
            let tool = ToolFrame::new(&DrawnPose { x, y, z, spin, tilt });
            let drawn = DrawnJoints::new(&tool);
            let above = drawn.elbow + drawn.along.cross(&drawn.across) * FORE[0];
            for (got, want) in [(drawn.shoulder, shoulder), (drawn.elbow, elbow), (above, forearm)] {
                assert!((got - Point::from(want)).norm() < 1e-3, "{got} {want:?}");
            }
            assert!((above + drawn.along * FORE[1] - drawn.wrist).norm() < 1e-6);
        }
    }
}
