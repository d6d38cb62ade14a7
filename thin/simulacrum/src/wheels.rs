//! The wheels of a mirrored robot as a driver, so that what drives wheeled robots drives it: the robot itself plans nothing (S1).

use mom_rsp::Refused;
use mom_rsp_model::{Model, ModelElement};
use mom_wheels::{Chassis, Driver, DriverError, Fault, Motors, Pose, Sensors, SetupError, WheelTime};

use crate::{Simulacrum, to_wire};

const WHEELS: [&str; 2] = ["left-wheel", "right-wheel"];

/// The chassis of the robots of a model: CUBO's, but for mm between the wheels, and the full speed, which is the least of the ranges of
/// the model's wheels.
///
/// # Errors
///
/// [`SetupError::Parameter`] for a number that is out of its range.
pub fn chassis(model: &Model, wheel_base: f64) -> Result<Chassis, SetupError> {
    let wheels = model
        .elements()
        .iter()
        .filter(|element| WHEELS.contains(&element.name.as_str()) && is_speed(element));
    let most = wheels
        .filter_map(|element| element.quantity(0))
        .map(|quantity| quantity.max.min(-quantity.min));
    let chassis = Chassis {
        wheel_base,
        full_speed: most.reduce(f64::min).unwrap_or(Chassis::CUBO.full_speed),
        ..Chassis::CUBO
    };
    chassis.check().map(|()| chassis)
}

fn is_speed(element: &ModelElement) -> bool {
    element
        .quantity(0)
        .is_some_and(|quantity| quantity.unit == "mm/s")
}

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
        let wheel = |name| {
            let (place, element) = robot.element(name)?;
            is_speed(element).then_some(place)
        };
        let [left, right] = WHEELS.map(wheel);
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
            left: left?,
            right: right?,
            pose,
            battery,
            robot: robot.clone(),
            chassis,
            motors: Motors::STOP,
        })
    }

    /// The wheels' places, if it says where it is at least each so many ms.
    pub(crate) fn measured(&self, slowest: u16) -> Vec<u8> {
        let elements = self.robot.model().elements();
        let pose = self.pose.and_then(|(place, _)| elements.get(usize::from(place)));
        match pose.is_some_and(|pose| pose.period <= slowest) {
            true => vec![self.left, self.right],
            false => Vec::new(),
        }
    }

    fn unreached(&self) -> DriverError {
        let why = self.robot.trouble().unwrap_or_default();
        let text = format!("{} is not reached: {why}", self.robot.name());
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
                Some(Ok(value)) => match self.robot.write(element, &value) {
                    // A wheel that is switched off stands.
                    Err(Refused::Inactive) if motors == Motors::STOP => Ok(()),
                    written => written.map_err(|error| error.to_string()),
                },
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
        // What a sensor said before it was switched off says nothing of now.
        let value = |element: u8, part: usize| {
            let is_active = self.robot.with(|middle| middle.active(element));
            let known = self.robot.read(element).filter(|_| is_active)?;
            known.values.get(part).copied()
        };
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

#[cfg(test)]
mod tests {
    use super::*;

    fn model(left: &str, right: &str) -> Model {
        let wheel = |name, range| {
            format!("[[element]]\nname = \"{name}\"\nkind = \"effector\"\ntype = \"i16\"\n{range}\n")
        };
        let text = format!(
            "name = \"cart\"\nid = 7\n{}{}",
            wheel("left-wheel", left),
            wheel("right-wheel", right)
        );
        Model::read(&text).unwrap()
    }

    #[test]
    fn a_chassis_is_as_fast_as_the_slower_wheel_of_the_model() {
        let cart = model(
            "unit = \"mm/s\"\nrange = [-300, 400]",
            "unit = \"mm/s\"\nrange = [-350, 350]",
        );
        let wide = chassis(&cart, 400.0).unwrap();
        assert_eq!((wide.wheel_base, wide.full_speed), (400.0, 300.0));
        assert!(wide.full_turn() < Chassis::CUBO.full_turn());
        assert!(chassis(&cart, 1.0).is_err());
        let percent = model(
            "unit = \"%\"\nrange = [-100, 100]",
            "unit = \"%\"\nrange = [-100, 100]",
        );
        let other = chassis(&percent, 170.0).unwrap();
        assert_eq!(other, Chassis::CUBO, "percent are no speed");
    }
}
