//! The limits of the joints: an arm with a turning base, a shoulder, an elbow and a wrist.
//!
//! The arm of the demonstration has the build of an industrial arm of M49's size: its base stands
//! beside the table, the elbow is always up, and the wrist carries the hand. From the pose of the
//! hand follow the place of the wrist, the angles of shoulder and elbow by the law of cosines, and
//! the bend between forearm and hand. With the hand upright every pose of the workspace is within
//! the limits; a tilted hand is not everywhere, as with a real arm.

use crate::error::{ArmError, ErrorName};
use crate::pose::{Pose, along, dot};

/// x and y of the axis about which the base turns, mm.
pub const BASE: [f64; 2] = [-980.0, 0.0];
/// mm of the shoulder in front of the base's axis.
pub const SHOULDER_FORWARD: f64 = 150.0;
/// mm of the shoulder above the table.
pub const SHOULDER_HEIGHT: f64 = 475.0;
/// mm from shoulder to elbow.
pub const UPPER_ARM: f64 = 600.0;
/// mm from elbow to wrist.
pub const FOREARM: f64 = 730.0;
/// mm from wrist to fingertips.
pub const HAND: f64 = 235.0;

/// Degrees of the upper arm from the vertical, forward positive.
const SHOULDER_LIMITS: [f64; 2] = [-75.0, 75.0];
/// Degrees of the forearm from the level, upward positive.
const ELBOW_LIMITS: [f64; 2] = [-80.0, 65.0];
/// Degrees between forearm and hand.
const WRIST_LIMITS: [f64; 2] = [0.0, 115.0];
/// Degrees between forearm and hand below which the wrist is singular.
const SINGULAR_BEND: f64 = 5.0;

/// The joints that hold the hand in a pose, degrees; for drawing the arm, and for [`check`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joints {
    /// The base's turn from x, counter-clockwise seen from above.
    pub base: f64,
    /// The upper arm's lean from the vertical, forward positive.
    pub shoulder: f64,
    /// The forearm's angle from the level, upward positive.
    pub elbow: f64,
    /// The angle between forearm and hand; 0 is a straight line.
    pub wrist: f64,
}

/// The joints for a pose.
///
/// # Errors
///
/// [`ErrorName::JointLimit`] where no joints can hold the pose because it is too far or too near.
pub fn joints(pose: &Pose) -> Result<Joints, ArmError> {
    let approach = pose.frame().approach;
    let wrist = along(pose.position(), approach, -HAND);
    let base = (wrist[1] - BASE[1]).atan2(wrist[0] - BASE[0]);
    let forward = (wrist[0] - BASE[0]).hypot(wrist[1] - BASE[1]) - SHOULDER_FORWARD;
    let up = wrist[2] - SHOULDER_HEIGHT;
    let far = forward.hypot(up);
    let (nearest, furthest) = (FOREARM - UPPER_ARM, FOREARM + UPPER_ARM);
    if !(nearest..=furthest).contains(&far) {
        return Err(limit(format!(
            "the wrist would be {far:.0} mm from the shoulder, but the arm reaches from {nearest} to {furthest} mm"
        )));
    }
    let corner = (UPPER_ARM * UPPER_ARM + far * far - FOREARM * FOREARM) / (2.0 * UPPER_ARM * far);
    let raised = up.atan2(forward) + corner.clamp(-1.0, 1.0).acos();
    let pitch = (up - UPPER_ARM * raised.sin()).atan2(forward - UPPER_ARM * raised.cos());
    let forearm = [pitch.cos() * base.cos(), pitch.cos() * base.sin(), pitch.sin()];
    Ok(Joints {
        base: base.to_degrees(),
        shoulder: 90.0 - raised.to_degrees(),
        elbow: pitch.to_degrees(),
        wrist: dot(forearm, approach).clamp(-1.0, 1.0).acos().to_degrees(),
    })
}

/// Checks that the joints can hold the pose.
///
/// # Errors
///
/// [`ErrorName::JointLimit`] with the joint, its angle and its limits, or [`ErrorName::Singularity`].
///
/// ```
/// use mom_arm::{ErrorName, Pose, reach};
///
/// assert!(reach::check(&Pose::new(300.0, 300.0, 0.0, 0.0, 0.0)).is_ok());
/// let leaning_back = Pose::new(300.0, 0.0, 0.0, 90.0, 45.0);
/// assert_eq!(reach::check(&leaning_back).unwrap_err().name(), ErrorName::JointLimit);
/// ```
pub fn check(pose: &Pose) -> Result<(), ArmError> {
    let joints = joints(pose)?;
    for (joint, angle, [low, high]) in [
        ("shoulder", joints.shoulder, SHOULDER_LIMITS),
        ("elbow", joints.elbow, ELBOW_LIMITS),
        ("wrist", joints.wrist, WRIST_LIMITS),
    ] {
        if !(low..=high).contains(&angle) {
            return Err(limit(format!(
                "the {joint} would be at {angle:.0} degrees, but it turns from {low} to {high}"
            )));
        }
    }
    if joints.wrist < SINGULAR_BEND {
        return Err(ArmError::new(
            ErrorName::Singularity,
            format!(
                "the hand would line up with the forearm ({:.1} degrees between them, at least {SINGULAR_BEND} \
                 are needed); choose another tilt",
                joints.wrist
            ),
        ));
    }
    Ok(())
}

/// mm and degrees between the poses at which a leg is checked; small against every limit's change.
const STEP: f64 = 10.0;
const TURN_STEP: f64 = 2.0;

/// Checks a straight leg from one pose to another, both ends included.
///
/// # Errors
///
/// As [`check`], for the first pose on the way that the joints cannot hold.
pub fn check_leg(from: &Pose, to: &Pose) -> Result<(), ArmError> {
    let steps = (from.distance(to) / STEP)
        .max(from.turn(to) / TURN_STEP)
        .ceil()
        .max(1.0);
    let mut step = 0.0;
    while step <= steps {
        check(&from.between(to, step / steps))?;
        step += 1.0;
    }
    Ok(())
}

fn limit(text: String) -> ArmError {
    ArmError::new(ErrorName::JointLimit, text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upright_hand_reaches_the_whole_workspace() {
        for x in (-300..=300).step_by(20) {
            for y in (-300..=300).step_by(20) {
                for z in (0..=450).step_by(15) {
                    let pose = Pose::new(x.into(), y.into(), z.into(), 0.0, 0.0);
                    assert_eq!(check(&pose), Ok(()), "{pose:?}");
                }
            }
        }
    }

    #[test]
    fn joints_lead_back_to_the_wrist() {
        for pose in [
            Pose::new(0.0, 0.0, 300.0, 0.0, 0.0),
            Pose::new(-250.0, 200.0, 20.0, 70.0, 30.0),
            Pose::new(250.0, -299.0, 440.0, -120.0, -20.0),
        ] {
            let Joints {
                base,
                shoulder,
                elbow,
                wrist,
            } = joints(&pose).unwrap();
            let (base, shoulder, elbow) = (base.to_radians(), shoulder.to_radians(), elbow.to_radians());
            let forward = SHOULDER_FORWARD + UPPER_ARM * shoulder.sin() + FOREARM * elbow.cos();
            let up = SHOULDER_HEIGHT + UPPER_ARM * shoulder.cos() + FOREARM * elbow.sin();
            let at = [BASE[0] + forward * base.cos(), BASE[1] + forward * base.sin(), up];
            let tip = along(at, pose.frame().approach, HAND);
            for (got, want) in tip.into_iter().zip(pose.position()) {
                assert!((got - want).abs() < 1e-6, "{pose:?} {tip:?}");
            }
            let pointing = [elbow.cos() * base.cos(), elbow.cos() * base.sin(), elbow.sin()];
            assert!((dot(pointing, pose.frame().approach) - wrist.to_radians().cos()).abs() < 1e-9);
        }
    }

    #[test]
    fn a_tilted_hand_meets_the_limits() {
        for (pose, name, word) in [
            (
                Pose::new(300.0, 0.0, 0.0, 90.0, 45.0),
                ErrorName::JointLimit,
                "1330",
            ),
            (
                Pose::new(-300.0, 0.0, 0.0, -90.0, 45.0),
                ErrorName::JointLimit,
                "elbow",
            ),
            (
                Pose::new(200.0, 0.0, 450.0, 90.0, 45.0),
                ErrorName::JointLimit,
                "wrist",
            ),
            (singular(), ErrorName::Singularity, "line up"),
        ] {
            let error = check(&pose).unwrap_err();
            assert_eq!(error.name(), name, "{pose:?} {error}");
            assert!(error.text().contains(word), "{error}");
        }
    }

    #[test]
    fn a_leg_is_checked_between_its_ends() {
        let singular = singular();
        let (from, to) = (
            Pose {
                tilt: 0.0,
                ..singular
            },
            Pose {
                tilt: 45.0,
                ..singular
            },
        );
        assert_eq!((check(&from), check(&to)), (Ok(()), Ok(())));
        assert_eq!(check_leg(&from, &to).unwrap_err().name(), ErrorName::Singularity);
        assert_eq!(check_leg(&from, &from), Ok(()));
    }

    /// A pose in the middle of the table in which the hand and the forearm are one line.
    fn singular() -> Pose {
        let bend = |tilt: f64| joints(&Pose::new(0.0, 0.0, 0.0, -90.0, tilt)).unwrap().wrist;
        let tilt = (0..=450)
            .map(|tenth| f64::from(tenth) / 10.0)
            .min_by(|a, b| bend(*a).total_cmp(&bend(*b)));
        Pose::new(0.0, 0.0, 0.0, -90.0, tilt.unwrap())
    }
}
