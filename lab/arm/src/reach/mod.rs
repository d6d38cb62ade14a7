//! What the joints of the arm allow: the inverse kinematics of an ABB IRB 1400 (M49) and its limits.
//!
//! A pose can be held in up to eight ways. The arm stays in the configuration in which it stands at home: facing the
//! table, the elbow up, the hand bent downwards (joint 5 positive). Along a leg it takes the joints nearest to
//! the last ones. Between two configurations lies a singularity, or for joint 4 a limit, and both are refused before
//! anything moves; so each pose has one set of joints, by whatever way the hand comes.
//!
//! With the hand upright every pose of the workspace can be held; a tilted hand not everywhere, as with the real arm.
//! The shoulder's singularity, the wrist above the axis of joint 1, lies outside the workspace.

use crate::pose::{Pose, Xyz, along};
use mom_device::{DeviceError, ErrorName};

mod irb1400;
#[cfg(test)]
mod tests;

pub use irb1400::{
    ELBOW_OFFSET, FLANGE, FOOT, FOREARM, GRIPPER, Joints, LIMITS, Links, SHOULDER_FORWARD, SHOULDER_HEIGHT,
    UPPER_ARM, hand, links,
};

/// Degrees of joint 5, or of the elbow from a straight line, below which the arm is singular.
const SINGULAR: f64 = 5.0;
/// mm and degrees between the poses at which a leg is checked; small against every limit's change, and against
/// twice [`SINGULAR`], so that no leg steps over the wrist's singularity. Beyond the elbow's nothing can be reached.
const STEP: f64 = 10.0;
const TURN_STEP: f64 = 2.0;
/// Degrees by which no joint changes in one step outside the singularities.
const MOST_CHANGE: f64 = 60.0;

/// The joints that hold the pose in the configuration of home; limits are not regarded.
///
/// # Errors
///
/// [`ErrorName::JointLimit`] where no joints can hold the pose because it is too far or too near.
pub fn joints(pose: &Pose) -> Result<Joints, DeviceError> {
    let at_home = |joints: &Joints| joints[0].abs() < 90.0 && elbow(joints) >= 0.0 && joints[4] >= 0.0;
    let mut joints = irb1400::solutions(pose)
        .into_iter()
        .find(at_home)
        .ok_or_else(|| out_of_reach(pose))?;
    // With the hand upright joint 4 is at 0, and joint 6 follows the spin from where the jaw line lies along x.
    joints[5] = nearest_turn(joints[5], joints[0] - pose.spin - joints[3]);
    Ok(joints)
}

/// Checks that the joints can hold the pose.
///
/// # Errors
///
/// [`ErrorName::JointLimit`] with the joint, its angle and its limits, or [`ErrorName::Singularity`].
///
/// ```
/// use mom_arm::{Pose, reach};
/// use mom_device::ErrorName;
///
/// assert!(reach::check(&Pose::new(300.0, 300.0, 0.0, 0.0, 0.0)).is_ok());
/// let leaning_back = Pose::new(300.0, 0.0, 450.0, 90.0, 45.0);
/// assert_eq!(reach::check(&leaning_back).unwrap_err().name(), ErrorName::JointLimit);
/// ```
pub fn check(pose: &Pose) -> Result<(), DeviceError> {
    allow(&joints(pose)?)
}

/// Checks a straight leg from one pose to another, both ends included.
///
/// # Errors
///
/// As [`check`], for the first pose on the way that the joints cannot hold. [`DeviceError::reachable`] is how far
/// the hand could go on this way.
pub fn check_leg(from: &Pose, to: &Pose) -> Result<(), DeviceError> {
    walk(from, to, |_| ())
}

/// Goes along a straight leg in small steps and shows the joints of each.
fn walk(from: &Pose, to: &Pose, mut visit: impl FnMut(&Joints)) -> Result<(), DeviceError> {
    let steps = (from.distance(to) / STEP)
        .max(from.turn(to) / TURN_STEP)
        .ceil()
        .max(1.0);
    let mut last = joints(from)?;
    allow(&last)?;
    visit(&last);
    let mut step = 1.0;
    while step <= steps {
        match follow(&from.between(to, step / steps), &last) {
            Ok(joints) => last = joints,
            Err(error) => {
                let reachable = furthest(from, to, [(step - 1.0) / steps, step / steps], &last);
                return Err(with_way_to(error, reachable));
            }
        }
        visit(&last);
        step += 1.0;
    }
    Ok(())
}

/// The error, with the pose as far as which the hand could go; also in words.
fn with_way_to(error: DeviceError, pose: Pose) -> DeviceError {
    let Pose { x, y, z, spin, tilt } = pose;
    let text = format!("{error}; on this way the hand can go as far as {x} {y} {z} {spin} {tilt}");
    error.in_words(text).with_reachable(pose)
}

/// The allowed joints that hold the pose and are nearest to the last ones.
fn follow(pose: &Pose, last: &Joints) -> Result<Joints, DeviceError> {
    let change =
        |joints: &Joints| -> f64 { joints.iter().zip(last).map(|(new, old)| (new - old).abs()).sum() };
    let joints = irb1400::solutions(pose)
        .into_iter()
        .map(|mut joints| {
            for (joint, last) in joints.iter_mut().zip(last) {
                *joint = nearest_turn(*joint, *last);
            }
            joints
        })
        .min_by(|a, b| change(a).total_cmp(&change(b)))
        .ok_or_else(|| out_of_reach(pose))?;
    allow(&joints)?;
    for (number, (new, old)) in (1..).zip(joints.iter().zip(last)) {
        if (new - old).abs() > MOST_CHANGE {
            let text = format!("joint {number} would jump from {old:.0} to {new:.0} degrees on the way");
            return Err(DeviceError::new(ErrorName::Singularity, text));
        }
    }
    Ok(joints)
}

/// The furthest pose on a leg that can be held, in whole tenths of mm and degrees; `between` are the fractions of
/// the way that can still be held and that cannot, one step apart, and `last` are the joints at the first.
fn furthest(from: &Pose, to: &Pose, between: [f64; 2], last: &Joints) -> Pose {
    let [start, end] = between;
    let (mut can, mut cannot) = (start, end);
    for _ in 0..12 {
        let middle = can.midpoint(cannot);
        match follow(&from.between(to, middle), last) {
            Ok(_) => can = middle,
            Err(_) => cannot = middle,
        }
    }
    // Rounded it may lie just beyond the limit: then a little further back.
    let back = (end - start) / 50.0;
    (0..=50)
        .map(|tries| from.between(to, (can - back * f64::from(tries)).max(0.0)))
        .map(|pose| in_tenths(&pose))
        .find(|pose| follow(pose, last).is_ok())
        .unwrap_or(*from)
}

fn in_tenths(pose: &Pose) -> Pose {
    // Adding 0 makes a 0 of a −0.
    let round = |number: f64| (number * 10.0).round() / 10.0 + 0.0;
    Pose::new(
        round(pose.x),
        round(pose.y),
        round(pose.z),
        round(pose.spin),
        round(pose.tilt),
    )
}

/// Checks the joints against singularities and limits.
fn allow(joints: &Joints) -> Result<(), DeviceError> {
    let straight = elbow(joints);
    if straight < SINGULAR {
        let text = format!(
            "the upper arm and the forearm would line up ({straight:.1} degrees between them, at least {SINGULAR} \
             are needed); come nearer to the arm"
        );
        return Err(DeviceError::new(ErrorName::Singularity, text));
    }
    if joints[4].abs() < SINGULAR {
        let text = format!(
            "the hand would line up with the forearm (joint 5 at {:.1} degrees, at least {SINGULAR} are needed); \
             choose another tilt",
            joints[4]
        );
        return Err(DeviceError::new(ErrorName::Singularity, text));
    }
    for (number, (angle, [low, high])) in (1..).zip(joints.iter().zip(LIMITS)) {
        if !(low..=high).contains(angle) {
            let text =
                format!("joint {number} would be at {angle:.1} degrees, but it turns from {low} to {high}");
            return Err(DeviceError::new(ErrorName::JointLimit, text));
        }
    }
    Ok(())
}

/// Degrees from the upper arm's line down to the line from elbow to wrist: 0 is a stretched arm.
fn elbow(joints: &Joints) -> f64 {
    let offset = ELBOW_OFFSET.atan2(FOREARM).to_degrees();
    nearest_turn(90.0 - joints[1] + joints[2] - offset, 0.0)
}

/// The angle plus as many whole turns as bring it nearest to another one.
fn nearest_turn(angle: f64, near: f64) -> f64 {
    angle + ((near - angle) / 360.0).round() * 360.0
}

fn out_of_reach(pose: &Pose) -> DeviceError {
    let wrist = along(pose.position(), pose.frame().approach, -GRIPPER - FLANGE);
    let [x, y, z]: Xyz = std::array::from_fn(|axis| wrist[axis] - FOOT[axis]);
    let far = (x.hypot(y) - SHOULDER_FORWARD).hypot(z - SHOULDER_HEIGHT);
    let forearm = FOREARM.hypot(ELBOW_OFFSET);
    let (nearest, furthest) = (forearm - UPPER_ARM, forearm + UPPER_ARM);
    let text = format!(
        "the wrist would be {far:.0} mm from the shoulder, but the arm reaches from {nearest:.0} to {furthest:.0} mm"
    );
    DeviceError::new(ErrorName::JointLimit, text)
}
