//! A robot's model: its geometry, its battery, and what is plugged into the ports of its hub, as a file says.

use std::collections::BTreeMap;

use mom_wheels::{Chassis, Fittings, Power, switch};
use serde::Deserialize;
use toml::Spanned;

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
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {text}")]
pub struct ModelError {
    line: usize,
    column: usize,
    text: String,
}

impl ModelError {
    /// A fault at a byte of the text.
    fn at(source: &str, byte: usize, text: String) -> Self {
        let before = source.get(..byte).unwrap_or(source);
        let line = before.rsplit('\n').next().unwrap_or_default();
        Self {
            line: before.matches('\n').count() + 1,
            column: line.chars().count() + 1,
            text,
        }
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct File {
    chassis: Spanned<ChassisPart>,
    power: Spanned<PowerPart>,
    ports: Spanned<BTreeMap<String, Spanned<Plugged>>>,
    #[serde(default)]
    sensors: Sensing,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct ChassisPart {
    wheel_base: f64,
    radius: f64,
    full_speed: f64,
    lag: f64,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct PowerPart {
    capacity: f64,
    idle: f64,
    wheel: f64,
    led: f64,
    charger: f64,
}

#[derive(Deserialize, Default)]
#[serde(rename_all = "kebab-case", deny_unknown_fields, default)]
struct Sensing {
    odometry: bool,
    light_ahead: f64,
}

/// What can be plugged in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
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

impl Plugged {
    const fn word(self) -> &'static str {
        match self {
            Self::LeftMotor => "left-motor",
            Self::RightMotor => "right-motor",
            Self::TouchFront => "touch-front",
            Self::TouchRear => "touch-rear",
            Self::Light => "light",
        }
    }

    const fn ports(self) -> &'static [&'static str] {
        match self {
            Self::LeftMotor | Self::RightMotor => &MOTOR_PORTS,
            Self::TouchFront | Self::TouchRear | Self::Light => &SENSOR_PORTS,
        }
    }
}

impl Model {
    /// Reads a model's file.
    ///
    /// # Errors
    ///
    /// The first fault, and its place.
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        let file: File = toml::from_str(text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            ModelError::at(text, at, error.message().to_owned())
        })?;
        let plugged = plugged(&file).map_err(|(at, words)| ModelError::at(text, at, words))?;
        let part = file.chassis.get_ref();
        let chassis = Chassis {
            wheel_base: part.wheel_base,
            radius: part.radius,
            full_speed: part.full_speed,
            lag: part.lag,
        };
        let wrong = |at: usize, error: mom_wheels::SetupError| ModelError::at(text, at, error.to_string());
        chassis
            .check()
            .map_err(|error| wrong(file.chassis.span().start, error))?;
        let part = file.power.get_ref();
        let power = Power {
            capacity: part.capacity,
            idle: part.idle,
            wheel: part.wheel,
            led: part.led,
            charger: part.charger,
        };
        power
            .check()
            .map_err(|error| wrong(file.power.span().start, error))?;
        let has = |part| plugged.contains(&part);
        let switches = |part, mask| if has(part) { mask } else { 0 };
        let fittings = Fittings {
            switches: switches(Plugged::TouchFront, switch::FRONT)
                | switches(Plugged::TouchRear, switch::REAR),
            leds: 0,
            light: has(Plugged::Light).then_some(file.sensors.light_ahead),
            odometry: file.sensors.odometry,
        };
        Ok(Self {
            chassis,
            power,
            fittings,
        })
    }
}

/// What is plugged in; else what is wrong with it, at which byte.
fn plugged(file: &File) -> Result<Vec<Plugged>, (usize, String)> {
    let mut all = Vec::new();
    for (port, part) in file.ports.get_ref() {
        let (at, part) = (part.span().start, *part.get_ref());
        let word = part.word();
        if !part.ports().contains(&port.as_str()) {
            let ports = part.ports().join(", ");
            return Err((
                at,
                format!("`{word}` is plugged in at one of {ports}, and not at `{port}`"),
            ));
        }
        if all.contains(&part) {
            return Err((at, format!("`{word}` is plugged in already")));
        }
        all.push(part);
    }
    for motor in [Plugged::LeftMotor, Plugged::RightMotor] {
        if !all.contains(&motor) {
            let text = format!("`{}` is missing: a rover has two motors", motor.word());
            return Err((file.ports.span().start, text));
        }
    }
    let ahead = file.sensors.light_ahead;
    if all.contains(&Plugged::Light) && !(0.0..=1000.0).contains(&ahead) {
        let text = format!("`light-ahead` is {ahead}, but may be only from 0 to 1000");
        return Err((file.ports.span().start, text));
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
                "line 24, column 5: unknown variant `gyro`",
            ),
            (
                "1 = \"touch-front\"",
                "B = \"touch-front\"",
                "line 24, column 5: `touch-front` is plugged in at one of 1, 2, 3, 4",
            ),
            (
                "1 = \"touch-front\"",
                "1 = \"light\"",
                "line 25, column 5: `light` is plugged in already",
            ),
            ("1 = \"touch-front\"", "5 = \"touch-front\"", "and not at `5`"),
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
            ("lag = 0.06", "leg = 0.06", "unknown field `leg`"),
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
