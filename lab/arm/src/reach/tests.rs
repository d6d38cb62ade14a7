//! The kinematics against poses that RobotStudio computed, against a chain of transforms, and along random legs.

use mom_client::from_value;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use rs_opw_kinematics::glam::{DAffine3, DMat3, DQuat, DVec3};

use super::*;
use crate::pose::HOME;
use crate::pose::{HandAxes, dot};
use crate::workspace::WORKSPACE;

/// Joints, and where RobotStudio has the flange of an IRB 1410 at them: mm from its foot and a quaternion, w first;
/// listed with the code of Malla and Shanmugavel (2024).
const ROBOT_STUDIO: [(Joints, Xyz, [f64; 4]); 5] = [
    (
        [30.80, -12.13, 15.33, -40.00, 59.80, -28.00],
        [691.027_481, 356.960_035, 921.353_218],
        [0.129_239_3, -0.572_731_1, 0.746_819_7, -0.312_308_5],
    ),
    (
        [-11.33, 27.07, 19.00, -30.00, 39.87, 80.00],
        [1_160.639_820, -260.405_415, 822.484_566],
        [0.334_258_4, 0.562_950_2, 0.755_295_0, -0.029_796_3],
    ),
    (
        [-38.53, 5.60, 15.33, -62.00, 9.20, -24.00],
        [785.632_415, -641.006_224, 969.131_560],
        [0.217_540_1, -0.288_867_9, 0.763_718_2, -0.534_758_0],
    ),
    (
        [43.07, 4.67, 30.00, 6.00, -4.60, -44.00],
        [701.179_733, 654.412_292, 780.442_154],
        [0.533_800_5, -0.547_804_8, 0.643_869_3, 0.019_981_0],
    ),
    (
        [2.27, 0.93, 8.00, -62.00, -73.60, 28.00],
        [914.994_193, 108.270_208, 1_128.116_863],
        [0.818_602_0, -0.460_420_6, 0.290_974_6, 0.182_311_2],
    ),
];

/// The forward kinematics as a chain of transforms, joint by joint, written without the crate's formulas.
///
/// The upper arm turns by joint 2 and the forearm by joint 3, both about the same direction: a parallelogram.
fn chain(joints: &Joints) -> (Links, HandAxes) {
    let [j1, j2, j3, j4, j5, j6] = joints.map(f64::to_radians);
    let by = |x: f64, y: f64, z: f64| DAffine3::from_translation(DVec3::new(x, y, z));
    let (x, y, z) = (
        DAffine3::from_rotation_x,
        DAffine3::from_rotation_y,
        DAffine3::from_rotation_z,
    );
    let foot = by(FOOT[0], FOOT[1], FOOT[2]);
    let shoulder = foot * z(j1) * by(SHOULDER_FORWARD, 0.0, SHOULDER_HEIGHT);
    let elbow = shoulder * y(j2) * by(0.0, 0.0, UPPER_ARM) * y(-j2);
    let forearm = elbow * y(j3) * by(0.0, 0.0, ELBOW_OFFSET);
    let wrist = forearm * x(j4) * by(FOREARM, 0.0, 0.0);
    let flange = wrist * y(j5) * by(FLANGE, 0.0, 0.0) * x(j6);
    // The gripper's axis is the flange's; its jaw line lies as the flange's z.
    let tip = flange * by(GRIPPER, 0.0, 0.0);
    let at = |frame: DAffine3| frame.translation.to_array();
    let axes = HandAxes {
        jaw: tip.transform_vector3(DVec3::Z).to_array(),
        across: tip.transform_vector3(DVec3::Y).to_array(),
        approach: tip.transform_vector3(DVec3::X).to_array(),
    };
    let links = Links {
        foot: at(foot),
        shoulder: at(shoulder),
        elbow: at(elbow),
        forearm: at(forearm),
        wrist: at(wrist),
        flange: at(flange),
        tip: at(tip),
    };
    (links, axes)
}

fn apart(a: Xyz, b: Xyz) -> f64 {
    DVec3::from_array(a).distance(DVec3::from_array(b))
}

fn axes_apart(a: HandAxes, b: HandAxes) -> f64 {
    apart(a.jaw, b.jaw)
        .max(apart(a.across, b.across))
        .max(apart(a.approach, b.approach))
}

#[test]
fn the_arm_is_the_one_that_robot_studio_knows() {
    for (joints, at, [w, x, y, z]) in ROBOT_STUDIO {
        let links = links(&joints);
        let from_foot: Xyz = std::array::from_fn(|axis| links.flange[axis] - FOOT[axis]);
        // The joints are listed in hundredths of a degree; 0.005° is 0.1 mm at the arm's length.
        assert!(
            apart(from_foot, at) < 0.15,
            "{joints:?}: {from_foot:?}, not {at:?}"
        );
        // The gripper is mounted half a turn round on the flange.
        let flange = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w));
        let want = HandAxes {
            jaw: (-flange.x_axis).to_array(),
            across: flange.y_axis.to_array(),
            approach: flange.z_axis.to_array(),
        };
        assert!(axes_apart(hand(&joints).1, want) < 2e-4, "{joints:?}");
    }
}

/// What makes it a parallelogram: joint 2 alone moves the forearm, but never turns it.
#[test]
fn the_forearm_keeps_its_angle_to_the_ground_when_joint_2_moves() {
    let forearm = |lean: f64| {
        let links = links(&[20.0, lean, 35.0, 10.0, 50.0, -70.0]);
        let along: Xyz = std::array::from_fn(|axis| links.wrist[axis] - links.forearm[axis]);
        (along, links.wrist, hand(&[20.0, lean, 35.0, 10.0, 50.0, -70.0]).1)
    };
    let (along, wrist, axes) = forearm(-30.0);
    for lean in [-10.0, 0.0, 25.0, 60.0] {
        let (other, moved, turned) = forearm(lean);
        assert!(
            apart(along, other) < 1e-9 && axes_apart(axes, turned) < 1e-9,
            "{lean}"
        );
        assert!(apart(wrist, moved) > 100.0, "{lean}");
    }
    assert!((along[2] / FOREARM + 35_f64.to_radians().sin()).abs() < 1e-12);
}

#[test]
fn zero_is_upright_and_level() {
    let links = links(&[0.0; 6]);
    let [x, _, z] = FOOT;
    assert!(apart(links.elbow, [x + 150.0, 0.0, z + 1075.0]) < 1e-9);
    assert!(apart(links.wrist, [x + 870.0, 0.0, z + 1195.0]) < 1e-9);
    assert!(apart(links.flange, [x + 955.0, 0.0, z + 1195.0]) < 1e-9);
}

#[test]
fn home_is_far_from_every_limit() {
    let joints = joints(&HOME).unwrap();
    assert!(
        (joints[0], joints[3], joints[5]) == (0.0, 0.0, 0.0) || joints[5].abs() < 1e-9,
        "{joints:?}"
    );
    for (angle, [low, high]) in joints.into_iter().zip(LIMITS) {
        assert!((low + 30.0..=high - 30.0).contains(&angle), "{joints:?}");
    }
}

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
    for spin in [-180.0, -90.0, 90.0, 180.0] {
        for (x, y) in [(-300.0, -300.0), (-300.0, 300.0), (300.0, -300.0), (300.0, 300.0)] {
            assert_eq!(check(&Pose::new(x, y, 0.0, spin, 0.0)), Ok(()));
            assert_eq!(check(&Pose::new(x, y, 450.0, spin, 0.0)), Ok(()));
        }
    }
}

#[test]
fn a_tilted_hand_meets_the_limits() {
    for (pose, name, word) in [
        (
            Pose::new(300.0, 0.0, 450.0, 90.0, 45.0),
            ErrorName::JointLimit,
            "1330",
        ),
        (
            Pose::new(0.0, 0.0, 450.0, 90.0, 45.0),
            ErrorName::JointLimit,
            "joint 5 would be at",
        ),
        (
            stretched(),
            ErrorName::Singularity,
            "the upper arm and the forearm would line up",
        ),
        (lined_up(), ErrorName::Singularity, "the hand would line up"),
        (
            Pose::new(f64::NAN, 0.0, 0.0, 0.0, 0.0),
            ErrorName::JointLimit,
            "NaN",
        ),
        (
            Pose::new(1e300, 0.0, 0.0, 0.0, 0.0),
            ErrorName::JointLimit,
            "1330",
        ),
    ] {
        let error = check(&pose).unwrap_err();
        assert_eq!(error.name(), name, "{pose:?} {error}");
        assert!(error.text().contains(word), "{pose:?} {error}");
    }
}

/// A pose at the far edge in which the arm is almost stretched.
fn stretched() -> Pose {
    let stretch = |tilt: f64| joints(&Pose::new(300.0, 0.0, 450.0, 90.0, tilt)).map(|joints| elbow(&joints));
    let tilt = (0..450).map(|tenth| f64::from(tenth) / 10.0);
    let tilt = tilt.take_while(|tilt| stretch(*tilt).is_ok()).last().unwrap();
    Pose::new(300.0, 0.0, 450.0, 90.0, tilt)
}

/// A pose near the arm in which the hand and the forearm are almost one line.
fn lined_up() -> Pose {
    let bend = |tilt: f64| joints(&Pose::new(-300.0, 0.0, 0.0, -90.0, tilt)).unwrap()[4];
    let tilt = (0..=450)
        .map(|tenth| f64::from(tenth) / 10.0)
        .min_by(|a, b| bend(*a).total_cmp(&bend(*b)));
    Pose::new(-300.0, 0.0, 0.0, -90.0, tilt.unwrap())
}

#[test]
fn a_refused_leg_says_how_far_it_can_go() {
    for (from, to, word) in [
        (HOME, Pose::new(300.0, 0.0, 450.0, 90.0, 45.0), "joint 5"),
        (
            Pose::new(300.0, 0.0, 450.0, 90.0, 0.0),
            Pose::new(600.0, 0.0, 450.0, 90.0, 0.0),
            "reaches from 130 to 1330",
        ),
        (HOME, lined_up(), "the hand would line up"),
        (HOME, Pose::new(-300.0, -300.0, 450.0, 90.0, 45.0), "joint 5"),
    ] {
        let error = check_leg(&from, &to).unwrap_err();
        let reachable: Pose = from_value(error.reachable().unwrap().clone()).unwrap();
        assert!(error.text().contains(word), "{error}");
        assert_eq!(check_leg(&from, &reachable), Ok(()), "{error}");
        let Pose { x, y, z, spin, tilt } = reachable;
        assert!(
            error
                .text()
                .ends_with(&format!("as far as {x} {y} {z} {spin} {tilt}")),
            "{error}"
        );
        // A little further it cannot go.
        let way = from.distance(&to).max(from.turn(&to));
        let gone = from.distance(&reachable).max(from.turn(&reachable)) / way;
        assert!(check(&from.between(&to, gone + 0.03)).is_err(), "{error}");
    }
}

#[test]
fn a_leg_is_checked_between_its_ends() {
    // Both ends can be held; half-way the hand leans back, out of the arm's reach.
    let (from, to) = (
        Pose::new(300.0, 0.0, 450.0, 0.0, 45.0),
        Pose::new(300.0, 0.0, 450.0, 180.0, 45.0),
    );
    assert_eq!((check(&from), check(&to)), (Ok(()), Ok(())));
    assert!(check_leg(&from, &to).is_err());
    assert_eq!(check_leg(&from, &from), Ok(()));
}

fn any_pose() -> impl Strategy<Value = Pose> {
    let tilt = prop_oneof![1 => Just(0.0), 3 => -45.0..=45.0];
    (-300.0..=300.0, -300.0..=300.0, 0.0..=450.0, -180.0..=180.0, tilt)
        .prop_map(|(x, y, z, spin, tilt)| Pose::new(x, y, z, spin, tilt))
}

fn any_joints() -> impl Strategy<Value = Joints> {
    LIMITS.map(|[low, high]| low..=high)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn inverse_and_forward_kinematics_agree(pose in any_pose()) {
        if let Ok(joints) = joints(&pose) {
            let (tip, axes) = hand(&joints);
            prop_assert!(apart(tip, pose.position()) < 1e-6, "{:?} {:?}", joints, tip);
            prop_assert!(axes_apart(axes, pose.frame()) < 1e-8, "{:?} {:?}", joints, axes);
            // Five degrees of freedom: the jaw line is level.
            prop_assert!(axes.jaw[2].abs() < 1e-9);
        }
    }

    #[test]
    fn the_crate_agrees_with_a_chain_of_transforms(joints in any_joints()) {
        let (want, axes) = chain(&joints);
        let got = links(&joints);
        for (got, want) in [
            (got.shoulder, want.shoulder), (got.elbow, want.elbow), (got.forearm, want.forearm),
            (got.wrist, want.wrist), (got.flange, want.flange), (got.tip, want.tip),
        ] {
            prop_assert!(apart(got, want) < 1e-6, "{:?} {:?}", got, want);
        }
        prop_assert!(axes_apart(hand(&joints).1, axes) < 1e-9);
    }

    #[test]
    fn joints_never_jump_along_a_leg(to in any_pose()) {
        let mut last: Option<Joints> = None;
        let mut most = 0.0_f64;
        let walked = walk(&HOME, &to, |joints| {
            for (new, old) in joints.iter().zip(last.unwrap_or(*joints)) {
                most = most.max((new - old).abs());
            }
            last = Some(*joints);
        });
        prop_assert!(most < 45.0, "{} degrees in one step of {} mm", most, STEP);
        // The configuration is that of home all the way, so the pose alone determines the joints.
        let end = last.unwrap();
        let (tip, _) = hand(&end);
        prop_assert!(elbow(&end) > 0.0 && end[4] > 0.0 && end[0].abs() < 90.0);
        if walked.is_ok() {
            prop_assert!(apart(tip, to.position()) < 1e-6);
            for (followed, direct) in end.iter().zip(joints(&to).unwrap()) {
                prop_assert!((followed - direct).abs() < 1e-6, "{:?}", end);
            }
            prop_assert_eq!(check(&to), Ok(()));
        }
    }

    #[test]
    fn the_shoulder_is_never_singular(pose in any_pose()) {
        prop_assert_eq!(WORKSPACE.check(&pose), Ok(()));
        if let Ok(joints) = joints(&pose) {
            let wrist = links(&joints).wrist;
            prop_assert!((wrist[0] - FOOT[0]).hypot(wrist[1] - FOOT[1]) > 400.0);
            let forearm = links(&joints).forearm;
            let along: Xyz = std::array::from_fn(|axis| (wrist[axis] - forearm[axis]) / FOREARM);
            prop_assert!((dot(along, pose.frame().approach) - joints[4].to_radians().cos()).abs() < 1e-9);
        }
    }

    #[test]
    fn any_numbers_get_an_answer(joints in proptest::array::uniform6(proptest::num::f64::ANY), pose in proptest::array::uniform5(proptest::num::f64::ANY)) {
        let (tip, _) = hand(&joints);
        prop_assert!(tip.into_iter().all(f64::is_finite));
        let [x, y, z, spin, tilt] = pose;
        let _ = check(&Pose::new(x, y, z, spin, tilt));
    }
}

#[test]
fn tilted_hands_reach_most_of_the_workspace() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let held = (0..2000)
        .filter(|_| {
            let pose = any_pose().new_tree(&mut runner).unwrap().current();
            check(&pose).is_ok()
        })
        .count();
    assert!(held > 1940, "{held} of 2000");
}
