//! A simulated robot whose way is written into a file.

use mom_trace::Trace;

use crate::{Driver, DriverError, Motors, Parts, Sensors, Simulated, WheelTime};

/// A simulated robot that writes where it is: x and y in mm, and where it looks, degrees.
#[derive(Debug)]
pub struct Traced {
    robot: Simulated,
    trace: Trace,
}

impl Traced {
    /// This robot, whose way is written there.
    #[must_use]
    pub fn new(robot: Simulated, trace: Trace) -> Self {
        Self { robot, trace }
    }

    fn trace(&mut self, at: WheelTime) {
        let robot = &mut self.robot;
        self.trace.until(at, |at| {
            let pose = robot.pose(at);
            [pose.x, pose.y, pose.heading]
        });
    }
}

impl Driver for Traced {
    fn set_motors(&mut self, motors: Motors, at: WheelTime) -> Result<(), DriverError> {
        self.trace(at);
        self.robot.set_motors(motors, at)
    }

    fn hold(&mut self, until: WheelTime, at: WheelTime) -> Result<(), DriverError> {
        self.trace(at);
        self.robot.hold(until, at)
    }

    fn set_leds(&mut self, leds: u8, at: WheelTime) -> Result<(), DriverError> {
        self.trace(at);
        self.robot.set_leds(leds, at)
    }

    fn sensors(&mut self, at: WheelTime) -> Result<Sensors, DriverError> {
        self.trace(at);
        self.robot.sensors(at)
    }

    fn parts(&mut self, at: WheelTime) -> Result<Parts, DriverError> {
        self.trace(at);
        self.robot.parts(at)
    }

    fn next_wake(&mut self) -> Option<WheelTime> {
        self.robot.next_wake()
    }
}
