//! The wheels of a mirrored robot as a driver, so that what drives wheeled robots drives it: the robot itself plans nothing (S1).

use mom_rsp_model::ModelElement;
use mom_wheels::{Chassis, Driver, DriverError, Fault, Motors, Pose, Sensors, WheelTime};

use crate::{Simulacrum, to_wire};

/// The wheels of a robot whose model has the effectors `left-wheel` and `right-wheel`, in mm/s.
///
/// Where it is, is what a sensor `pose` says in its parts `x`, `y` (mm) and `heading` (degrees); the battery is a part `battery` of any
/// sensor, in %. What a model does not have the robot does not know.
pub struct Wheels {
    robot: Simulacrum,
    chassis: Chassis,
    left: u8,
    right: u8,
    pose: Option<(u8, [usize; 3])>,
    battery: Option<(u8, usize)>,
    motors: Motors,
}

impl Wheels {
    /// The wheels of a robot, if it has some; they reach the chassis's full speed at 1000 per mille.
    #[must_use]
    pub fn of(robot: &Simulacrum, chassis: Chassis) -> Option<Self> {
        let wheel = |name| robot.element(name).map(|(place, _)| place);
        let part = |element: &ModelElement, name: &str| {
            let named = |quantity: &mom_rsp_model::Quantity| quantity.part.as_deref() == Some(name);
            element.quantities.iter().position(named)
        };
        let pose = robot.element("pose").and_then(|(place, element)| {
            let parts = [
                part(element, "x")?,
                part(element, "y")?,
                part(element, "heading")?,
            ];
            Some((place, parts))
        });
        let elements = (0..).zip(robot.model().elements());
        let battery = elements.into_iter().find_map(|(place, element)| {
            let part = part(element, "battery")?;
            let percent = element.quantity(part)?.unit == "%";
            percent.then_some((place, part))
        });
        Some(Self {
            left: wheel("left-wheel")?,
            right: wheel("right-wheel")?,
            pose,
            battery,
            robot: robot.clone(),
            chassis,
            motors: Motors::STOP,
        })
    }

    fn unreached(&self) -> DriverError {
        let text = format!(
            "{} is not reached: it has no session at present",
            self.robot.name()
        );
        DriverError::new(Fault::Link, text)
    }
}

impl Driver for Wheels {
    fn set_motors(&mut self, motors: Motors, _at: WheelTime) -> Result<(), DriverError> {
        self.motors = motors;
        if !self.robot.is_up() {
            // Without a session it rests.
            return match motors == Motors::STOP {
                true => Ok(()),
                false => Err(self.unreached()),
            };
        }
        for (element, per_mille) in [(self.left, motors.left()), (self.right, motors.right())] {
            let speed = f64::from(per_mille) / 1000.0 * self.chassis.full_speed;
            let model = self.robot.model().elements().get(usize::from(element));
            let value = model.map(|model| to_wire(model, &[speed]));
            let written = match value {
                Some(Ok(value)) => self
                    .robot
                    .write(element, &value)
                    .map_err(|error| error.to_string()),
                Some(Err(error)) => Err(error.to_string()),
                None => Err("the model has lost a wheel".to_owned()),
            };
            written.map_err(|text| DriverError::new(Fault::Motors, text))?;
        }
        Ok(())
    }

    fn set_leds(&mut self, _leds: u8, _at: WheelTime) -> Result<(), DriverError> {
        let text = format!("the model of {} has no LEDs", self.robot.name());
        Err(DriverError::new(Fault::Leds, text))
    }

    fn sensors(&mut self, _at: WheelTime) -> Result<Sensors, DriverError> {
        let value = |element: u8, part: usize| self.robot.read(element)?.values.get(part).copied();
        let pose = self.pose.and_then(|(element, [x, y, heading])| {
            Some(Pose::new(
                value(element, x)?,
                value(element, y)?,
                value(element, heading)?,
            ))
        });
        // What it said last grows old in the mirror; without a session no motor is set by it.
        if pose.is_none() && !self.robot.is_up() {
            return Err(self.unreached());
        }
        let battery = self.battery.and_then(|(element, part)| value(element, part));
        Ok(Sensors {
            switches: 0,
            // One that tells of none is taken for full.
            battery: battery.map_or(100, |percent| percent.clamp(0.0, 100.0) as u8),
            motors: self.motors,
            pose,
        })
    }

    fn next_wake(&mut self) -> Option<WheelTime> {
        None
    }
}
