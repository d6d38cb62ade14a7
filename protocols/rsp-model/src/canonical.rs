//! The canonical form of a model, which is hashed: all that both ends must agree on, with every default written out.

use std::fmt::Write as _;

use mom_rsp::{Kind, Motion, Payload};
use sha2::{Digest as _, Sha256};

use crate::model::{Model, ModelElement, kind_word, number_word};

impl Model {
    /// The text that is hashed.
    #[must_use]
    pub fn canonical(&self) -> String {
        text_of(self)
    }
}

/// The whole text. Another form gets another first line, so that no two forms have one hash.
fn text_of(model: &Model) -> String {
    let mut text = format!(
        "mom-rsp-model 1\nmodel {} {}\nperiod {}\nlargest-packet {}\nwatchdog {}\n",
        model.name, model.id, model.period, model.largest_packet, model.watchdog
    );
    for element in &model.elements {
        text.push_str(&element_text(element, &model.elements));
    }
    text
}

pub(crate) fn hash(model: &Model) -> [u8; 32] {
    Sha256::digest(text_of(model)).into()
}

/// The first four bytes of the hash of an element's lines.
pub(crate) fn digest(element: &ModelElement, all: &[ModelElement]) -> u32 {
    let hash = Sha256::digest(element_text(element, all));
    hash.iter()
        .take(4)
        .fold(0, |digest, byte| digest << 8 | u32::from(*byte))
}

fn element_text(element: &ModelElement, all: &[ModelElement]) -> String {
    let name_at = |place: Option<u8>| {
        let named = place.and_then(|place| all.get(usize::from(place)));
        named.map_or("-", |named| named.name.as_str())
    };
    let mut text = format!("element {} {}", element.name, kind_word(element.kind));
    let done = match element.payload {
        Payload::Nothing => Ok(()),
        Payload::Numbers(number, count) => write!(text, " {}*{count}", number_word(number)),
        Payload::Bytes(most) => write!(text, " bytes*{}", element.blob.unwrap_or(most)),
    }
    .and_then(|()| match (element.kind, element.motion) {
        (Kind::Effector, Motion::Absolute { interpolate, rate }) => {
            write!(text, " absolute interpolate={interpolate} rate={}", or_dash(rate))
        }
        (Kind::Effector, Motion::Incremental { rate }) => write!(text, " incremental rate={}", or_dash(rate)),
        (Kind::Sensor, _) => write!(text, " period={}", element.period),
        (Kind::Monitor, _) => write!(text, " period={} of={}", element.period, name_at(element.of)),
        _ => Ok(()),
    })
    // What has no sound keeps the hash that it had before there was any.
    .and_then(|()| match element.sound {
        Some(sound) => write!(text, " sound={sound}"),
        None => Ok(()),
    })
    // The same of what does not go on.
    .and_then(|()| match element.lasts {
        0 => Ok(()),
        ms => write!(text, " lasts={ms}"),
    })
    .and_then(|()| writeln!(text, " module={}", name_at(element.module)));
    debug_assert!(done.is_ok(), "a String takes all that is written");
    for quantity in &element.quantities {
        let part = quantity.part.as_deref().unwrap_or("-");
        let unit = if quantity.unit.is_empty() {
            "-"
        } else {
            &quantity.unit
        };
        let numbers = [quantity.scale, quantity.min, quantity.max, quantity.safe];
        let numbers = numbers.map(|number| number.to_string()).join(" ");
        text.push_str(&format!("  {part} {unit} {numbers}\n"));
    }
    text
}

fn or_dash(rate: Option<f32>) -> String {
    rate.map_or_else(|| "-".to_owned(), |rate| rate.to_string())
}
