//! What every device does alike, replayed by a simulated robot on wheels.

use mom_device_cases::{Stage, Statements, replay};
use mom_wheeled::Rover;
use mom_wheels::{Chassis, Floor, Pose, Power, Simulated};

const STATEMENTS: Statements = Statements {
    go: "goto 2000 1000",
    back: "goto 1000 1000",
    wrong: "gogo 1 2",
    beyond: Some(("follow ada 500; wait 1", "syntax 5001")),
    relative: None,
    velocity: None,
};

/// Some are played for each of several events; none may be left out in silence.
#[test]
fn a_robot_on_wheels_does_what_every_device_does() {
    let rover = || {
        let pose = Pose::new(1000.0, 1000.0, 0.0);
        let robot = Simulated::new(Chassis::LINUXBOT, Power::LINUXBOT, Floor::ARENA, pose).expect("a robot");
        Stage::bare(Rover::new(Box::new(robot), Chassis::LINUXBOT, None))
    };
    assert_eq!(replay(rover, &STATEMENTS), 43);
}
