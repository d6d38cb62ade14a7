//! The ABB IRB 1400 of M49: its numbers, and its kinematics forwards and backwards.
//!
//! # Where the numbers come from
//!
//! | number | source |
//! |---|---|
//! | 475, 150, 600, 120 mm, and 805 mm from elbow to flange | a public MATLAB script on the kinematics of the "ABB-IRB 1400", its author
//! not named (`d1`, `a1`, `a2`, `a3`, `d4`) |
//! | 805 = 720 + 85 mm; the same four others | the IRB 1410, whose arm is the same: O. Malla, M. Shanmugavel, "Simplified model to study
//! the kinematics of manipulators with parallelogram linkages", Industrial Robot 51 (2024), and their code |
//! | limits of joints 1 to 3 | the script on the IRB 1400 above: ±170°, ±70°, −65° to 70° |
//! | limits of joints 4 to 6 | the IRB 1410 by Malla and Shanmugavel: ±150°, ±115°, ±300° |
//! | signs, zeros and the coupling of joints 2 and 3 | poses that RobotStudio computed for the IRB 1410, listed with that code; the tests
//! hold them |
//! | the gripper's length and how it is mounted | assumed |
//! | where the arm stands | chosen so that the hand reaches all of M50's box upright |
//! | 5° from a singularity | assumed |
//!
//! ABB's own data sheet of the IRB 1400 was not at hand. The linkage also limits the angle between upper arm and
//! forearm; no source at hand gives that limit, so it is left out.
//!
//! # The parallelogram
//!
//! The motor of joint 3 sits beside the shoulder and moves the forearm through a parallelogram. Joint 3 is
//! therefore the forearm's angle to the ground, whatever joint 2 does, while the formulas for an arm whose motors
//! sit in their joints need the angle at the elbow: joint 3 − joint 2.

use std::sync::{Arc, LazyLock};

use rs_opw_kinematics::glam::{DMat3, DQuat, DVec3};
use rs_opw_kinematics::kinematic_traits::{J2, J3, Kinematics, Pose as Flange};
use rs_opw_kinematics::kinematics_impl::OPWKinematics;
use rs_opw_kinematics::parallelogram::Parallelogram;
use rs_opw_kinematics::parameters::opw_kinematics::Parameters;

use crate::pose::{HandAxes, Pose, Xyz, along};

/// The angles of the six joints, degrees, as the controller counts them.
///
/// All zero: the upper arm upright, the forearm and the hand level and straight ahead.
///
/// 1. turns the arm about the vertical, counter-clockwise seen from above;
/// 2. leans the upper arm forwards from the vertical;
/// 3. lowers the forearm from the level, independently of joint 2;
/// 4. turns the forearm about its length;
/// 5. bends the hand from the forearm's line, downwards where joint 4 is at 0;
/// 6. turns the hand about its length.
pub type Joints = [f64; 6];

/// The middle of the arm's foot in the table's frame, mm. The table is 400 mm high and stands on the same floor.
pub const FOOT: Xyz = [-960.0, 0.0, -400.0];
/// mm of the shoulder (axis of joint 2) above the foot.
pub const SHOULDER_HEIGHT: f64 = 475.0;
/// mm of the shoulder in front of the axis of joint 1.
pub const SHOULDER_FORWARD: f64 = 150.0;
/// mm from the shoulder to the elbow (axis of joint 3).
pub const UPPER_ARM: f64 = 600.0;
/// mm of the forearm's axis (of joint 4) above the elbow.
pub const ELBOW_OFFSET: f64 = 120.0;
/// mm from the elbow to the wrist (axis of joint 5) along the forearm.
pub const FOREARM: f64 = 720.0;
/// mm from the wrist to the flange.
pub const FLANGE: f64 = 85.0;
/// mm from the flange to the point between the fingertips.
pub const GRIPPER: f64 = 150.0;

/// Degrees between which each joint turns.
pub const LIMITS: [[f64; 2]; 6] = [
    [-170.0, 170.0],
    [-70.0, 70.0],
    [-65.0, 70.0],
    [-150.0, 150.0],
    [-115.0, 115.0],
    [-300.0, 300.0],
];

/// The arm of these sizes. The crate expects the forearm upright at zero, which is where the 90° of joint 3 come from.
///
/// Only `inverse` and `forward` are used: the crate's `Parallelogram` couples the joints right in both, but its
/// `inverse_continuing` compares solutions that are not yet coupled with previous joints that are.
static ARM: LazyLock<Parallelogram> = LazyLock::new(|| Parallelogram {
    robot: Arc::new(OPWKinematics::new(Parameters {
        a1: SHOULDER_FORWARD,
        a2: -ELBOW_OFFSET,
        b: 0.0,
        c1: SHOULDER_HEIGHT,
        c2: UPPER_ARM,
        c3: FOREARM,
        c4: FLANGE,
        offsets: [0.0, 0.0, -std::f64::consts::FRAC_PI_2, 0.0, 0.0, 0.0],
        sign_corrections: [1; 6],
        dof: 6,
    })),
    scaling: 1.0,
    driven: J2,
    coupled: J3,
});

/// Every way in which the arm can hold the pose, up to eight; each angle in ±180°, limits not regarded.
pub(super) fn solutions(pose: &Pose) -> Vec<Joints> {
    let axes = pose.frame();
    let flange = along(pose.position(), axes.approach, -GRIPPER);
    let [jaw, across, approach] = [axes.jaw, axes.across, axes.approach].map(DVec3::from_array);
    // The gripper is mounted half a turn round, so that joint 6 stands at 0 with the jaw line along x.
    let rotation = DQuat::from_mat3(&DMat3::from_cols(-jaw, across, approach));
    let Ok(flange) = Flange::try_from_parts(DVec3::from_array(flange) - DVec3::from_array(FOOT), rotation)
    else {
        return Vec::new();
    };
    let turned = |angle: f64| (angle.to_degrees() + 180.0).rem_euclid(360.0) - 180.0;
    let solutions = ARM.inverse(&flange).into_iter();
    solutions.map(|joints| joints.map(turned)).collect()
}

/// The point between the fingertips and the hand's axes, for joints of any angle; the forward kinematics.
///
/// Angles that are not finite count as 0.
#[must_use]
pub fn hand(joints: &Joints) -> (Xyz, HandAxes) {
    let finite = |angle: f64| if angle.is_finite() { angle % 360.0 } else { 0.0 };
    let flange = ARM.forward(&joints.map(|angle| finite(angle).to_radians()));
    let rotation = DMat3::from_quat(flange.rotation);
    let axes = HandAxes {
        jaw: (-rotation.x_axis).to_array(),
        across: rotation.y_axis.to_array(),
        approach: rotation.z_axis.to_array(),
    };
    let at = (flange.translation + DVec3::from_array(FOOT)).to_array();
    (along(at, axes.approach, GRIPPER), axes)
}

/// Where the arm's parts are for some joints, in the table's frame; what is needed to draw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Links {
    /// The middle of the foot.
    pub foot: Xyz,
    /// The middle of the axis of joint 2.
    pub shoulder: Xyz,
    /// The middle of the axis of joint 3.
    pub elbow: Xyz,
    /// The beginning of the forearm's axis, [`ELBOW_OFFSET`] from the elbow.
    pub forearm: Xyz,
    /// The middle of the wrist, where the axes of joints 4, 5 and 6 meet.
    pub wrist: Xyz,
    /// The flange's middle.
    pub flange: Xyz,
    /// The point between the fingertips.
    pub tip: Xyz,
}

/// Where the arm's parts are for some joints.
#[must_use]
pub fn links(joints: &Joints) -> Links {
    let [turn, lean, lowered, ..] = joints.map(f64::to_radians);
    // A direction that rises from the level by so much, in the plane of the upper arm and the forearm.
    let rising = |angle: f64| [angle.cos() * turn.cos(), angle.cos() * turn.sin(), angle.sin()];
    let right = std::f64::consts::FRAC_PI_2;
    let shoulder = along(
        along(FOOT, rising(right), SHOULDER_HEIGHT),
        rising(0.0),
        SHOULDER_FORWARD,
    );
    let elbow = along(shoulder, rising(right - lean), UPPER_ARM);
    let forearm = along(elbow, rising(right - lowered), ELBOW_OFFSET);
    let (tip, axes) = hand(joints);
    Links {
        foot: FOOT,
        shoulder,
        elbow,
        forearm,
        wrist: along(forearm, rising(-lowered), FOREARM),
        flange: along(tip, axes.approach, -GRIPPER),
        tip,
    }
}
