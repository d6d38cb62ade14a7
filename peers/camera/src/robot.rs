//! The robot as solids: an industrial arm of the kind of M49 beside the table, and its gripper.
//!
//! The proportions are those of an ABB IRB 1400. The inverse kinematics serves the drawing only: it finds an elbow
//! for every pose and stretches the forearm where the real arm would not reach.

use nalgebra::{Rotation3, Vector2};

use crate::geometry::{Direction, Point};
use crate::scene::{Colour, DrawnGripper, DrawnPose};
use crate::solid::Solid;
use crate::view::WRIST_MOUNT;

/// The axis about which the base turns, mm.
const BASE: [f64; 2] = [-1000.0, 0.0];
/// The shoulder's distance from the base's axis and its height above the table, mm.
const SHOULDER: [f64; 2] = [150.0, 475.0];
/// The lengths of the upper arm and of the forearm, mm.
const UPPER: f64 = 600.0;
const FORE: f64 = 730.0;
/// From the gripper's tip to the middle of the wrist, mm.
const WRIST: f64 = 235.0;
/// The floor on which the arm stands, mm.
pub(crate) const FLOOR: f64 = -420.0;

const PAINT: Colour = Colour([243, 112, 33]);
const DARK: Colour = Colour([78, 84, 94]);
const STEEL: Colour = Colour([176, 183, 192]);
const RUBBER: Colour = Colour([56, 60, 68]);

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

    /// The direction across the jaw line and the gripper's axis.
    pub(crate) fn across(&self) -> Direction {
        self.axes[1]
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

/// The gripper: two jaws, their palm and the flange.
pub(crate) fn gripper(tool: &ToolFrame, gripper: &DrawnGripper) -> Vec<Solid> {
    let finger = |sign: f64| {
        let middle = sign * (gripper.opening / 2.0 + 4.0);
        [
            tool.cuboid([middle, 0.0, 12.0], [4.0, 8.0, 12.0], RUBBER),
            tool.cuboid([middle, 0.0, 42.0], [4.0, 8.0, 18.0], STEEL),
        ]
    };
    let mut solids = Vec::with_capacity(6);
    solids.extend(finger(-1.0));
    solids.extend(finger(1.0));
    let palm = (gripper.opening / 2.0 + 10.0).max(50.0);
    solids.push(tool.cuboid([0.0, 0.0, 75.0], [palm, 20.0, 15.0], DARK));
    solids.push(tool.cylinder((90.0, 32.0), (136.0, 38.0), STEEL));
    solids
}

/// The camera on the gripper, as the other cameras see it.
pub(crate) fn wrist_camera(tool: &ToolFrame) -> Vec<Solid> {
    let [jaw, across, up] = WRIST_MOUNT;
    let (from, to) = (36.0, across - 14.0);
    vec![
        tool.cuboid(
            [jaw, (from + to) / 2.0, 138.0],
            [7.0, (to - from) / 2.0, 5.0],
            DARK,
        ),
        tool.cuboid([jaw, across, up - 24.0], [18.0, 14.0, 24.0], RUBBER),
    ]
}

/// The joints of the arm for a pose.
struct DrawnJoints {
    /// The direction from the base towards the wrist, along the table.
    ahead: Direction,
    /// The direction of the shoulder's and the elbow's axes.
    across: Direction,
    shoulder: Point,
    elbow: Point,
    wrist: Point,
}

impl DrawnJoints {
    fn new(tool: &ToolFrame) -> DrawnJoints {
        let wrist = tool.at([0.0, 0.0, WRIST]);
        let base = Point::new(BASE[0], BASE[1], 0.0);
        let ahead = Direction::new(wrist.x - base.x, wrist.y - base.y, 0.0).try_normalize(1e-9);
        let ahead = ahead.unwrap_or(Direction::x());
        let across = Direction::z().cross(&ahead);
        let shoulder = base + ahead * SHOULDER[0] + Direction::z() * SHOULDER[1];
        let reach = Vector2::new(ahead.dot(&(wrist - shoulder)), wrist.z - shoulder.z);
        // The law of cosines, kept within the lengths for which there is a triangle.
        let distance = reach.norm().clamp(FORE - UPPER + 30.0, FORE + UPPER - 1.0);
        let cosine = (UPPER * UPPER + distance * distance - FORE * FORE) / (2.0 * UPPER * distance);
        let angle = reach.y.atan2(reach.x) + cosine.clamp(-1.0, 1.0).acos();
        let elbow = shoulder + (ahead * angle.cos() + Direction::z() * angle.sin()) * UPPER;
        DrawnJoints {
            ahead,
            across,
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
        shoulder,
        elbow,
        wrist,
    } = DrawnJoints::new(tool);
    let base = |z: f64| Point::new(BASE[0], BASE[1], z);
    let joint = |middle: Point, half: f64, radius: f64, colour: Colour| {
        Solid::cylinder(
            (middle - across * half, radius),
            (middle + across * half, radius),
            colour,
        )
    };
    // Beams end at the rim of the joints rather than in their middle, so that a plane parts them (see `solid`).
    let beam = |from: (Point, f64, [f64; 2]), to: (Point, f64, [f64; 2])| {
        let axis = (to.0 - from.0).try_normalize(1e-9).unwrap_or(ahead);
        Solid::beam(
            (from.0 + axis * from.1, from.2),
            (to.0 - axis * to.1, to.2),
            across,
            PAINT,
        )
    };
    let axis = (wrist - elbow).try_normalize(1e-9).unwrap_or(ahead);
    let neck = elbow + axis * 250.0;
    vec![
        Solid::cylinder((base(0.0), 150.0), (base(190.0), 140.0), PAINT),
        Solid::cylinder((base(190.0), 158.0), (base(228.0), 158.0), DARK),
        Solid::cylinder((base(228.0), 146.0), (base(300.0), 136.0), PAINT),
        Solid::beam(
            (base(300.0) + ahead * 20.0, [105.0, 120.0]),
            (shoulder + ahead * -30.0 + Direction::z() * -50.0, [85.0, 75.0]),
            across,
            PAINT,
        ),
        joint(shoulder, 100.0, 78.0, DARK),
        beam((shoulder, 70.0, [48.0, 66.0]), (elbow, 60.0, [42.0, 50.0])),
        joint(elbow, 82.0, 68.0, DARK),
        Solid::beam(
            (elbow - axis * 150.0, [52.0, 46.0]),
            (elbow - axis * 62.0, [58.0, 56.0]),
            across,
            DARK,
        ),
        beam((elbow, 60.0, [54.0, 56.0]), (neck, 0.0, [44.0, 44.0])),
        beam((neck, 0.0, [44.0, 44.0]), (wrist, 40.0, [34.0, 34.0])),
        joint(wrist, 46.0, 42.0, DARK),
        tool.cylinder((136.0, 28.0), (WRIST - 38.0, 30.0), DARK),
    ]
}

/// The arm's foot below the table's height, which the table may hide.
pub(crate) fn foot() -> Vec<Solid> {
    let base = |z: f64| Point::new(BASE[0], BASE[1], z);
    vec![
        Solid::cylinder((base(FLOOR), 230.0), (base(FLOOR + 40.0), 230.0), DARK),
        Solid::cylinder((base(FLOOR + 40.0), 175.0), (base(0.0), 150.0), PAINT),
    ]
}
