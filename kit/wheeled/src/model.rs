//! A robot's model: its geometry, its battery, and what is plugged into the ports of its hub, as a file says.

use mom_toml_faults::{At, Section, quoted, unknown};
use mom_wheels::{Chassis, Fittings, Power, switch};

/// What a robot is like: `config/lego.toml` is one in its file's form.
///
/// ```
/// use mom_wheeled::Model;
///
/// let lego = Model::parse(include_str!("../../../config/lego.toml"))?;
/// assert_eq!((lego.fittings.leds, lego.fittings.light), (0, Some(60.0)));
/// # Ok::<(), mom_wheeled::ModelError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Model {
    /// Its drive geometry.
    pub chassis: Chassis,
    /// Its battery.
    pub power: Power,
    /// Its sensors and LEDs.
    pub fittings: Fittings,
}

impl Model {
    /// The robot of the second paper.
    pub const LINUXBOT: Self = Self {
        chassis: Chassis::LINUXBOT,
        power: Power::LINUXBOT,
        fittings: Fittings::LINUXBOT,
    };
}

/// What is wrong with a model's file, and where.
pub type ModelError = mom_toml_faults::FileError<()>;

type Found = mom_toml_faults::Found<()>;

/// What can be plugged in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Plugged {
    LeftMotor,
    RightMotor,
    TouchFront,
    TouchRear,
    Light,
}

/// The ports of the hub: those of motors, and those of sensors.
const MOTOR_PORTS: [&str; 3] = ["A", "B", "C"];
const SENSOR_PORTS: [&str; 4] = ["1", "2", "3", "4"];

/// The parts: how the file calls each, and at which ports it can be.
const PARTS: [(Plugged, &str, &[&str]); 5] = [
    (Plugged::LeftMotor, "left-motor", &MOTOR_PORTS),
    (Plugged::RightMotor, "right-motor", &MOTOR_PORTS),
    (Plugged::TouchFront, "touch-front", &SENSOR_PORTS),
    (Plugged::TouchRear, "touch-rear", &SENSOR_PORTS),
    (Plugged::Light, "light", &SENSOR_PORTS),
];

impl Model {
    /// Reads a model's file.
    ///
    /// # Errors
    ///
    /// The first fault, and its place.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        read(text).map_err(|found| found.at(text))
    }
}

fn read(text: &str) -> Result<Model, Found> {
    let root = Section::parse(text)?;
    root.only(&["chassis", "power", "ports", "sensors"])?;
    let chassis = read_chassis(root.required("chassis")?.table()?)?;
    let power = read_power(root.required("power")?.table()?)?;
    let (mut odometry, mut ahead) = (false, 0.0);
    if let Some(sensors) = root.get("sensors") {
        let sensors = sensors.table()?.only(&["odometry", "light-ahead"])?;
        odometry = sensors.get("odometry").map_or(Ok(odometry), At::flag)?;
        ahead = sensors.get("light-ahead").map_or(Ok(ahead), At::number)?;
    }
    let ports = root.required("ports")?.table()?;
    let plugged = plugged(ports)?;
    let has = |part| plugged.contains(&part);
    if has(Plugged::Light) && !(0.0..=1000.0).contains(&ahead) {
        let text = format!("`light-ahead` is {ahead}; it must be 0 to 1000");
        return Err(Found::new((), &ports.span, text));
    }
    let switches = |part, mask| if has(part) { mask } else { 0 };
    let fittings = Fittings {
        switches: switches(Plugged::TouchFront, switch::FRONT) | switches(Plugged::TouchRear, switch::REAR),
        leds: 0,
        light: has(Plugged::Light).then_some(ahead),
        odometry,
    };
    Ok(Model {
        chassis,
        power,
        fittings,
    })
}

fn read_chassis(keys: &Section) -> Result<Chassis, Found> {
    keys.only(&["wheel-base", "radius", "full-speed", "lag"])?;
    let number = |key| keys.required(key)?.number();
    let chassis = Chassis {
        wheel_base: number("wheel-base")?,
        radius: number("radius")?,
        full_speed: number("full-speed")?,
        lag: number("lag")?,
    };
    let checked = chassis.check();
    checked.map_err(|error| Found::new((), &keys.span, error.to_string()))?;
    Ok(chassis)
}

fn read_power(keys: &Section) -> Result<Power, Found> {
    keys.only(&["capacity", "idle", "wheel", "led", "charger"])?;
    let number = |key| keys.required(key)?.number();
    let power = Power {
        capacity: number("capacity")?,
        idle: number("idle")?,
        wheel: number("wheel")?,
        led: number("led")?,
        charger: number("charger")?,
    };
    let checked = power.check();
    checked.map_err(|error| Found::new((), &keys.span, error.to_string()))?;
    Ok(power)
}

/// What is plugged in.
fn plugged(section: &Section) -> Result<Vec<Plugged>, Found> {
    let mut all = Vec::new();
    for (port, value) in &section.entries {
        let wrong = |text: String| Err(Found::new((), &value.span, text));
        let word = value.text()?;
        let Some((part, _, ports)) = PARTS.iter().find(|(_, known, _)| *known == word) else {
            return wrong(unknown("part", word, &PARTS.map(|(_, known, _)| known)));
        };
        if !ports.contains(&port.value.as_str()) {
            let (ports, port) = (ports.join(", "), quoted(&port.value));
            return wrong(format!("`{word}` goes into one of {ports}, not `{port}`"));
        }
        if all.contains(part) {
            return wrong(format!("`{word}` is already plugged in"));
        }
        all.push(*part);
    }
    for (motor, word, _) in &PARTS[..2] {
        if !all.contains(motor) {
            let text = format!("`{word}` is missing: a rover has two motors");
            return Err(Found::new((), &section.span, text));
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEGO: &str = include_str!("../../../config/lego.toml");

    #[test]
    fn a_fault_in_the_file_is_told_with_its_line() {
        for (part, instead, said) in [
            (
                "1 = \"touch-front\"",
                "1 = \"gyro\"",
                "line 24, column 5: there is no part `gyro`; expected one of `left-motor`, `right-motor`",
            ),
            (
                "1 = \"touch-front\"",
                "B = \"touch-front\"",
                "line 24, column 5: `touch-front` goes into one of 1, 2, 3, 4, not `B`",
            ),
            (
                "1 = \"touch-front\"",
                "1 = \"light\"",
                "line 25, column 5: `light` is already plugged in",
            ),
            ("1 = \"touch-front\"", "5 = \"touch-front\"", "not `5`"),
            (
                "A = \"left-motor\"",
                "",
                "`left-motor` is missing: a rover has two motors",
            ),
            (
                "radius = 90 ",
                "radius = 0 ",
                "radius is 0, but may be only from 1 to 10000",
            ),
            ("capacity = 32_400", "capacity = nan", "capacity is NaN"),
            (
                "lag = 0.06",
                "leg = 0.06",
                "line 11, column 1: there is no key `leg`; did you mean `lag`?",
            ),
            (
                "lag = 0.06",
                "lag = true",
                "line 11, column 7: expected a number, found true or false",
            ),
            ("lag = 0.06", "", "line 7, column 1: `lag` is missing"),
            ("light-ahead = 60", "light-ahead = -1", "`light-ahead` is -1"),
            ("[power]", "[power", "line 13, column"),
        ] {
            assert!(LEGO.contains(part), "{part}");
            let text = LEGO.replacen(part, instead, 1);
            let error = Model::parse(&text).expect_err(instead).to_string();
            assert!(
                error.contains(said) && error.starts_with("line "),
                "{instead}: {error}"
            );
        }
    }
}
