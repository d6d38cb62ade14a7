//! From one pose to the next: the path rule (M52).
//!
//! - Down: first level, then straight down.
//! - Up: first straight up, then level.
//! - No change of height: direct.
//!
//! The hand turns (spin and tilt) during the level leg, so always at the upper of the two heights,
//! away from what stands on the table, and comes down already turned. Where there is no way to go
//! on the level, it turns on the spot, at the upper height as well.

use crate::pose::Pose;
use crate::reach;
use crate::workspace::WORKSPACE;
use mom_device::DeviceError;

/// The ends of the straight legs from one pose to another, in order: none if there is nothing to
/// move, at most two.
///
/// ```
/// use mom_arm::{Pose, path};
///
/// let high = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);
/// let low = Pose::new(100.0, 50.0, 20.0, 90.0, 0.0);
/// assert_eq!(path::legs(&high, &low), [Pose { z: 300.0, ..low }, low]);
/// assert_eq!(path::legs(&low, &high), [Pose { z: 300.0, ..low }, high]);
/// ```
#[must_use]
pub fn legs(from: &Pose, to: &Pose) -> Vec<Pose> {
    let corner = if to.z < from.z {
        Pose { z: from.z, ..*to }
    } else {
        Pose { z: to.z, ..*from }
    };
    let mut legs = Vec::with_capacity(2);
    let mut at = from;
    for end in [&corner, to] {
        if end != at {
            legs.push(*end);
            at = end;
        }
    }
    legs
}

/// Checks every leg from a pose inside the workspace to another, before anything moves (M52).
///
/// The workspace is a box in all five numbers and the corner of the way takes its numbers from the
/// two ends, so with them it lies inside; the joints' limits are no box, so the way is walked.
///
/// # Errors
///
/// That the workspace or the joints do not allow it, as [`Workspace::check`] and [`reach::check_leg`] say, with the
/// nearest pose that can be reached.
///
/// [`Workspace::check`]: crate::workspace::Workspace::check
pub fn check(from: &Pose, to: &Pose) -> Result<(), DeviceError> {
    WORKSPACE.check(to).map_err(|error| {
        let nearest = WORKSPACE.nearest(to);
        match check_legs(from, &nearest) {
            Ok(()) => error.with_reachable(nearest),
            Err(joints) => match joints.reachable() {
                Some(nearest) => error.with_reachable(nearest.clone()),
                None => error,
            },
        }
    })?;
    check_legs(from, to)
}

fn check_legs(from: &Pose, to: &Pose) -> Result<(), DeviceError> {
    let mut at = *from;
    for end in legs(from, to) {
        reach::check_leg(&at, &end)?;
        at = end;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_client::{Value, from_value};
    use mom_device::ErrorName;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose> {
        let turn = prop_oneof![Just(0.0), -45.0..=45.0];
        let z = prop_oneof![Just(100.0), 0.0..=450.0];
        let x = prop_oneof![Just(50.0), -300.0..=300.0];
        (x.clone(), x, z, turn.clone(), turn).prop_map(|(x, y, z, spin, tilt)| Pose::new(x, y, z, spin, tilt))
    }

    #[test]
    fn legs_by_the_rule() {
        let high = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);
        for (to, want) in [
            (high, vec![]),
            (Pose { x: 10.0, ..high }, vec![Pose { x: 10.0, ..high }]),
            (Pose { z: 10.0, ..high }, vec![Pose { z: 10.0, ..high }]),
            (
                Pose {
                    z: 400.0,
                    spin: 90.0,
                    ..high
                },
                vec![
                    Pose { z: 400.0, ..high },
                    Pose {
                        z: 400.0,
                        spin: 90.0,
                        ..high
                    },
                ],
            ),
            (
                Pose {
                    z: 10.0,
                    spin: 90.0,
                    ..high
                },
                vec![
                    Pose { spin: 90.0, ..high },
                    Pose {
                        z: 10.0,
                        spin: 90.0,
                        ..high
                    },
                ],
            ),
        ] {
            assert_eq!(legs(&high, &to), want, "{to:?}");
        }
    }

    #[test]
    fn check_looks_at_every_leg() {
        let home = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);
        for (from, to, want) in [
            (home, Pose::new(100.0, 50.0, 200.0, 0.0, 0.0), None),
            (
                home,
                Pose::new(100.0, 301.0, 200.0, 0.0, 0.0),
                Some(ErrorName::WorkspaceBoundary),
            ),
            (
                home,
                Pose::new(300.0, 0.0, 0.0, 90.0, 45.0),
                Some(ErrorName::JointLimit),
            ),
            // On the way hand and forearm line up; beyond, only another configuration could hold the hand.
            (
                Pose::new(-100.0, 0.0, 0.0, 90.0, 45.0),
                Pose::new(-100.0, 0.0, 0.0, 90.0, -45.0),
                Some(ErrorName::Singularity),
            ),
        ] {
            assert_eq!(
                check(&from, &to).err().map(|error| error.name()),
                want,
                "{from:?} {to:?}"
            );
        }
    }

    #[test]
    fn a_refusal_names_the_nearest_pose_that_can_be_reached() {
        let home = Pose::new(0.0, 0.0, 300.0, 0.0, 0.0);
        for (to, want) in [
            // Outside the workspace: its edge.
            (
                Pose::new(100.0, 320.0, 200.0, 0.0, 50.0),
                Some(Pose::new(100.0, 300.0, 200.0, 0.0, 45.0)),
            ),
            // Nowhere: where the hand is.
            (Pose::new(f64::NAN, 0.0, 200.0, 0.0, 0.0), Some(home)),
        ] {
            let error = check(&home, &to).unwrap_err();
            assert_eq!(error.name(), ErrorName::WorkspaceBoundary);
            assert_eq!(error.reachable().cloned(), want.map(Value::from), "{error}");
        }
        // Outside, and at its edge out of the joints' reach; inside, and out of their reach.
        for x in [310.0, 300.0] {
            let error = check(&home, &Pose::new(x, 0.0, 450.0, 90.0, 45.0)).unwrap_err();
            let reachable: Pose = from_value(error.reachable().unwrap().clone()).unwrap();
            assert_eq!(check(&home, &reachable), Ok(()), "{error}");
            assert!(home.distance(&reachable) > 200.0, "{error}");
        }
    }

    proptest! {
        #[test]
        fn every_leg_is_level_or_upright_and_turns_only_at_the_upper_height(from in pose(), to in pose()) {
            let top = from.z.max(to.z);
            let mut at = from;
            for end in legs(&from, &to) {
                let (level, turns) = (at.horizontal_distance(&end), at.turn(&end));
                if at.z == end.z {
                    prop_assert_eq!(at.z, top);
                } else {
                    prop_assert_eq!((level, turns), (0.0, 0.0));
                }
                at = end;
            }
            prop_assert_eq!(at, to);
        }
    }
}
