//! Scripts in the controller's own language: the RAPID text of M51.
//!
//! A real IRB 1400 has no `move`; the program that stands between the hub and the controller writes RAPID. Each leg
//! of the path rule (M52) becomes a `MoveL` to a `robtarget`, of which only the target varies (M51), and each
//! `grip` a digital output (M49):
//!
//! ```text
//! ! move 100 50 200 0 0
//! MoveL [[100,50,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],vslow,fine,grippertool\WObj:=table;
//! MoveL [[100,50,200],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],vslow,fine,grippertool\WObj:=table;
//! ```
//!
//! A `robtarget` has four parts, as ABB's RAPID Reference Manual (Basic Characteristics, data types `robtarget` and
//! `confdata`) says: the tool's position in mm; its orientation as a quaternion, the real part first; the quarter
//! turns in which joints 1, 4 and 6 stand, 0 for 0 to 90° and −1 for −90 to 0°, and a fourth number that is not
//! used; and the external axes, `9E9` for each that there is not. All are given in the frame of the work object
//! `table`, whose origin is the middle of the table's surface. The tool `grippertool` has its z along the fingers
//! and its x along the jaw line.
//!
//! The names `vslow`, `grippertool` and `table` are the paper's; the output's name, [`GRIPPER_OUTPUT`], is ours.

use rs_opw_kinematics::glam::{DMat3, DQuat, DVec3};

use crate::action::Action;
use crate::controller::{Grip, Instruction};
use crate::path;
use crate::pose::{HOME, Pose};
use crate::reach;
use crate::script::{Script, Statement};
use mom_device::DeviceError;

/// The digital output that closes the gripper.
pub const GRIPPER_OUTPUT: &str = "do_gripper";

/// The data that the lines refer to, for the module of a real controller: the speed of M49, the tool with its point
/// [`GRIPPER`](crate::reach::GRIPPER) mm in front of the flange and half a turn round, and the table as it stands before the arm's foot.
/// The tool's mass and its middle are assumed: measure yours.
pub const DECLARATIONS: &str = "\
CONST speeddata vslow:=[150,90,150,90];
PERS tooldata grippertool:=[TRUE,[[0,0,150],[0,0,0,1]],[1.5,[0,0,60],[1,0,0,0],0,0,0]];
PERS wobjdata table:=[FALSE,TRUE,\"\",[[960,0,400],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];
";

/// The RAPID line of one instruction, which a driver sends to the controller.
///
/// # Errors
///
/// That the joints cannot reach the pose, as [`reach::joints`] says.
///
/// ```
/// use mom_arm::{Pose, controller::Instruction, rapid};
///
/// let slide = Instruction::Glide(Pose::new(100.0, 50.0, 300.0, 0.0, 0.0), 10_000);
/// assert!(rapid::instruction(&slide)?.contains(r",vslow\T:=0.01,fine,grippertool"));
/// # Ok::<(), mom_device::DeviceError>(())
/// ```
pub fn instruction(instruction: &Instruction) -> Result<String, DeviceError> {
    match instruction {
        Instruction::Move(pose) => move_line(pose),
        // The optional argument T replaces the speed by the time that the motion takes.
        Instruction::Glide(pose, time) => {
            let seconds = decimal(*time as f64 / 1e6, 3);
            Ok(move_line(pose)?.replacen(",vslow", &format!(r",vslow\T:={seconds}"), 1))
        }
        Instruction::Grip(grip) => Ok(grip_line(*grip)),
    }
}

/// The RAPID lines of each statement of a script that begins with the hand at `from`, in the order in which the
/// controller carries them out.
///
/// A `move` has a line for each leg: none if the hand is already there, at most two.
///
/// # Errors
///
/// As [`path::check`], with the statement's number: what cannot be carried out has no text.
///
/// ```
/// use mom_arm::{pose::HOME, rapid};
///
/// let lines = rapid::lines(&"grip close; move 100 50 300 0 0; wait 500".parse()?, &HOME)?;
/// assert_eq!(lines[0], ["SetDO do_gripper,1;"]);
/// assert_eq!(
///     lines[1],
///     [r"MoveL [[100,50,300],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],vslow,fine,grippertool\WObj:=table;"]
/// );
/// assert_eq!(lines[2], ["WaitTime 0.5;"]);
/// # Ok::<(), mom_device::DeviceError>(())
/// ```
pub fn lines(script: &Script, from: &Pose) -> Result<Vec<Vec<String>>, DeviceError> {
    let mut at = *from;
    let mut all = Vec::with_capacity(script.statements().len());
    for (number, statement) in (1..).zip(script.statements()) {
        let here = at;
        let mut go = |to: Pose| {
            path::check(&at, &to)?;
            let legs = path::legs(&at, &to);
            at = to;
            legs.iter().map(move_line).collect()
        };
        let lines: Result<Vec<String>, DeviceError> = match statement {
            Statement::Do(Action::Move(pose)) => go(*pose),
            Statement::Do(Action::By(by)) => go(here.plus(by)),
            Statement::Do(Action::Home) => go(HOME),
            Statement::Do(Action::Grip(grip)) => Ok(vec![grip_line(*grip)]),
            Statement::Wait(ms) => Ok(vec![format!("WaitTime {};", decimal(f64::from(*ms) / 1000.0, 3))]),
            // The controller follows targets; where the hand is after it is not known before.
            Statement::Do(Action::Jog(..)) => Ok(vec!["! a velocity has no text in RAPID".to_owned()]),
            Statement::Do(Action::Reset) => {
                at = HOME;
                Ok(vec!["! only the simulated arm can be put back".to_owned()])
            }
        };
        all.push(lines.map_err(|error| error.at_statement(number))?);
    }
    Ok(all)
}

/// The same as one text: before the lines of each statement the statement itself, as a comment.
///
/// # Errors
///
/// As [`lines`].
pub fn text(script: &Script, from: &Pose) -> Result<String, DeviceError> {
    let mut text = String::new();
    for (statement, lines) in script.statements().iter().zip(lines(script, from)?) {
        text.push_str(&format!("! {statement}\n"));
        for line in lines {
            text.push_str(&line);
            text.push('\n');
        }
    }
    Ok(text)
}

fn grip_line(grip: Grip) -> String {
    let closed = match grip {
        Grip::Open => 0,
        Grip::Close => 1,
    };
    format!("SetDO {GRIPPER_OUTPUT},{closed};")
}

fn move_line(to: &Pose) -> Result<String, DeviceError> {
    let position = list(to.position().map(|mm| decimal(mm, 3)));
    let orientation = list(quaternion(to).map(|part| decimal(part, 7)));
    let joints = reach::joints(to)?;
    let configuration = list([quarter(joints[0]), quarter(joints[3]), quarter(joints[5]), 0]);
    let external = list(["9E9"; 6]);
    Ok(format!(
        r"MoveL [{position},{orientation},{configuration},{external}],vslow,fine,grippertool\WObj:=table;"
    ))
}

/// The tool's orientation as a quaternion, the real part first and not negative.
fn quaternion(pose: &Pose) -> [f64; 4] {
    let axes = pose.frame();
    let [jaw, across, approach] = [axes.jaw, axes.across, axes.approach].map(DVec3::from_array);
    let DQuat { x, y, z, w } = DQuat::from_mat3(&DMat3::from_cols(jaw, -across, approach));
    // q and −q are the same orientation; the sign is that of the first part that is not 0.
    let first = [w, x, y, z].into_iter().find(|part| part.abs() > 1e-9);
    let sign = first.unwrap_or(1.0).signum();
    [w, x, y, z].map(|part| part * sign)
}

/// The quarter turn in which an angle in degrees lies; what is 0 but for rounding counts as 0.
fn quarter(angle: f64) -> i32 {
    ((angle + 1e-3) / 90.0).floor() as i32
}

/// At most so many decimals, without zeros at the end.
fn decimal(value: f64, places: usize) -> String {
    let text = format!("{value:.places$}");
    let short = text.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" {
        "0".to_owned()
    } else {
        short.to_owned()
    }
}

fn list<T: ToString>(parts: impl IntoIterator<Item = T>) -> String {
    let parts: Vec<String> = parts.into_iter().map(|part| part.to_string()).collect();
    format!("[{}]", parts.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;
    use mom_device::ErrorName;
    use proptest::prelude::*;

    const TAIL: &str = r",[9E9,9E9,9E9,9E9,9E9,9E9]],vslow,fine,grippertool\WObj:=table;";

    fn of(script: &str) -> Result<Vec<Vec<String>>, DeviceError> {
        lines(&script.parse()?, &HOME)
    }

    #[test]
    fn a_script_in_rapid() {
        for (script, want) in [
            (
                // The paper's waypoint: the gripper first, then the move; down is level first.
                "grip open; move 100 50 200 0 0",
                vec![
                    vec!["SetDO do_gripper,0;"],
                    vec![
                        "MoveL [[100,50,300],[0,1,0,0],[0,0,0,0]",
                        "MoveL [[100,50,200],[0,1,0,0],[0,0,0,0]",
                    ],
                ],
            ),
            (
                // Up is upright first.
                "grip close; move -12.3456 -50 400 90 0",
                vec![
                    vec!["SetDO do_gripper,1;"],
                    vec![
                        "MoveL [[0,0,400],[0,1,0,0],[0,0,0,0]",
                        "MoveL [[-12.346,-50,400],[0,0.7071068,0.7071068,0],[-1,0,-2,0]",
                    ],
                ],
            ),
            ("wait 1250; home", vec![vec!["WaitTime 1.25;"], vec![]]),
            (
                "move 0 0 100 0 0; reset; move 0 0 200 0 0",
                vec![
                    vec!["MoveL [[0,0,100],[0,1,0,0],[0,0,0,0]"],
                    vec!["! only the simulated arm can be put back"],
                    vec!["MoveL [[0,0,200],[0,1,0,0],[0,0,0,0]"],
                ],
            ),
            (
                // 135° about x: the hand leans towards the viewer, so the forearm turns to the negative side.
                "move 0 0 300 0 -45",
                vec![vec!["MoveL [[0,0,300],[0.3826834,0.9238795,0,0],[0,-1,0,0]"]],
            ),
        ] {
            let want: Vec<Vec<String>> = want
                .into_iter()
                .map(|lines| {
                    let full = |line: &str| {
                        let tail = if line.starts_with("MoveL") { TAIL } else { "" };
                        format!("{line}{tail}")
                    };
                    lines.into_iter().map(full).collect()
                })
                .collect();
            assert_eq!(of(script).unwrap(), want, "{script}");
        }
    }

    #[test]
    fn the_text_names_each_statement() {
        let script = "grip close; wait 20".parse().unwrap();
        assert_eq!(
            text(&script, &HOME).unwrap(),
            "! grip close\nSetDO do_gripper,1;\n! wait 20\nWaitTime 0.02;\n"
        );
    }

    /// The declarations say in RAPID what the kinematics compute with.
    #[test]
    fn the_declarations_are_those_of_the_simulated_arm() {
        use crate::motion::{SPEED, TURN_SPEED};
        use crate::reach::{FOOT, GRIPPER};
        let [x, y, z] = FOOT.map(|mm| 0.0 - mm);
        for part in [
            format!("vslow:=[{SPEED},{TURN_SPEED},"),
            format!("[[0,0,{GRIPPER}],[0,0,0,1]]"),
            format!("[[{x},{y},{z}],[1,0,0,0]]"),
        ] {
            assert!(DECLARATIONS.contains(&part), "{part}");
        }
        // The tool's x, which is the jaw line, is the flange's x half a turn round (joints at home).
        let joints = reach::joints(&HOME).unwrap();
        assert!(joints[5].abs() < 1e-6, "{joints:?}");
    }

    #[test]
    fn what_cannot_be_carried_out_has_no_text() {
        for (script, name) in [
            ("wait 1; move 0 0 451 0 0", ErrorName::WorkspaceBoundary),
            ("home; move 300 0 450 90 45", ErrorName::JointLimit),
        ] {
            let error = of(script).unwrap_err();
            assert_eq!((error.name(), error.statement()), (name, Some(2)), "{error}");
        }
    }

    #[test]
    fn quarters_of_a_turn() {
        for (angle, want) in [
            (0.0, 0),
            (-1e-12, 0),
            (89.0, 0),
            (90.0, 1),
            (-1.0, -1),
            (-91.0, -2),
            (200.0, 2),
        ] {
            assert_eq!(quarter(angle), want, "{angle}");
        }
    }

    proptest! {
        #[test]
        fn the_quaternion_is_the_hands_orientation(spin in -180.0..=180.0, tilt in -45.0..=45.0) {
            let pose = Pose::new(0.0, 0.0, 300.0, spin, tilt);
            let [w, x, y, z] = quaternion(&pose);
            let rotation = DQuat::from_xyzw(x, y, z, w);
            let axes = pose.frame();
            for (axis, want) in [(DVec3::X, axes.jaw), (DVec3::Z, axes.approach)] {
                prop_assert!((rotation * axis).distance(DVec3::from_array(want)) < 1e-9);
            }
            prop_assert!(w >= -1e-9 && (rotation.length() - 1.0).abs() < 1e-9);
        }
    }
}
