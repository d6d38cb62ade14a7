//! Whether statements are those of a robot's model.

use mom_device::{DeviceError, ErrorName};
use mom_rsp::{Kind, Payload, Sound};
use mom_rsp_model::ModelElement;
use mom_sound::{Clip, Encoder, SoundError};

use super::Mirror;
use crate::{Action, Setting, to_wire};

impl Mirror {
    /// The element that a statement names.
    pub(super) fn named(
        &self,
        name: &str,
        is_right: impl Fn(Kind) -> bool,
        what: &str,
    ) -> Result<(u8, &ModelElement), DeviceError> {
        let syntax = |text: String| DeviceError::new(ErrorName::Syntax, text);
        let Some((place, element)) = self.robot.element(name) else {
            let all = self.robot.model().elements().iter();
            let right: Vec<&str> = all
                .filter(|element| is_right(element.kind))
                .map(|element| element.name.as_str())
                .collect();
            return Err(syntax(format!(
                "{} has no element `{name}`; {what} are {}",
                self.robot.name(),
                right.join(", ")
            )));
        };
        match is_right(element.kind) {
            true => Ok((place, element)),
            false => Err(syntax(format!("`{name}` is not one of {what}"))),
        }
    }

    pub(super) fn value(
        &self,
        setting: &Setting,
        is_right: impl Fn(Kind) -> bool,
        what: &str,
    ) -> Result<(u8, Vec<u8>), DeviceError> {
        let (place, element) = self.named(&setting.element, is_right, what)?;
        let bytes = to_wire(element, &setting.values);
        let bytes = bytes.map_err(|error| DeviceError::new(ErrorName::Syntax, error.to_string()))?;
        Ok((place, bytes))
    }

    /// Whether an action is one of this robot.
    pub(super) fn check(&self, action: &Action) -> Result<(), DeviceError> {
        match action {
            Action::Wheels(_) if self.rover.is_none() => {
                let text = format!("{} has no wheels in its model", self.robot.name());
                Err(DeviceError::new(ErrorName::Syntax, text))
            }
            Action::Wheels(mom_wheeled::Action::Leds(_)) => {
                let text = format!("{} has no LEDs; `set` sets its effectors", self.robot.name());
                Err(DeviceError::new(ErrorName::Syntax, text))
            }
            Action::Set { settings, ms } => settings.iter().try_for_each(|setting| {
                let (place, _) = self.value(setting, is_effector, "the effectors")?;
                let element = self.robot.model().elements().get(usize::from(place));
                let speeds = element.map_or(&[][..], |element| &element.quantities);
                match ms.is_none() && speeds.iter().any(|quantity| quantity.unit.ends_with("/s")) {
                    true => {
                        let text = format!(
                            "`{}` is a speed: say for how long, as in `set {0} 100 for 1000`",
                            setting.element
                        );
                        Err(DeviceError::new(ErrorName::Syntax, text))
                    }
                    false => Ok(()),
                }
            }),
            Action::Do(setting) => self.value(setting, is_command, "the commands").map(drop),
            Action::Play { element, sound, .. } => {
                let (_, kind) = self.speaker(element)?;
                let heard = Clip::read(&sound.bytes).and_then(|_| Encoder::new(kind));
                heard
                    .map(drop)
                    .map_err(|error| Self::sound_fault(&sound.name, &error))
            }
            Action::Show { element, bytes } => {
                self.bytes(element)?;
                match bytes.bytes.is_empty() {
                    true => {
                        let text = format!("`{}` is empty", bytes.name);
                        Err(DeviceError::new(ErrorName::Syntax, text))
                    }
                    false => Ok(()),
                }
            }
            Action::Activate { element, .. } => {
                self.named(element, is_switched, "what can be switched").map(drop)
            }
            Action::Ask(element) => self.named(element, is_asked, "what can be asked").map(drop),
            Action::Wheels(_) | Action::Period(_) | Action::Clear => Ok(()),
        }
    }

    /// The effector of type bytes that a statement names, and what sound it plays.
    pub(super) fn bytes(&self, name: &str) -> Result<(u8, Option<Sound>), DeviceError> {
        let (place, element) = self.named(name, is_effector, "the effectors")?;
        match element.payload {
            Payload::Bytes(_) => Ok((place, element.sound)),
            _ => {
                let text = format!("`{name}` takes numbers: `set` sets it");
                Err(DeviceError::new(ErrorName::Syntax, text))
            }
        }
    }

    /// The effector that plays sounds, and which.
    pub(super) fn speaker(&self, name: &str) -> Result<(u8, Sound), DeviceError> {
        let (place, sound) = self.bytes(name)?;
        let sound = sound.ok_or_else(|| {
            let text = format!("`{name}` plays no sound by its model; `show` hands bytes to it");
            DeviceError::new(ErrorName::Syntax, text)
        })?;
        Ok((place, sound))
    }

    pub(super) fn sound_fault(name: &str, error: &SoundError) -> DeviceError {
        DeviceError::new(ErrorName::Syntax, format!("`{name}` cannot be played: {error}"))
    }
}

pub(super) fn is_effector(kind: Kind) -> bool {
    kind == Kind::Effector
}

pub(super) fn is_command(kind: Kind) -> bool {
    matches!(kind, Kind::Command | Kind::MemoryCommand)
}

pub(super) fn is_switched(kind: Kind) -> bool {
    matches!(kind, Kind::Effector | Kind::Sensor | Kind::Monitor | Kind::Module)
}

pub(super) fn is_asked(kind: Kind) -> bool {
    matches!(kind, Kind::Sensor | Kind::Monitor | Kind::MemoryEvent)
}
