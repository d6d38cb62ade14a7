//! A model as a TOML file.

use mom_rsp::{Kind, Motion, Payload};

use crate::model::{Model, ModelElement, Quantity, bounds, kind_word, number_word};

impl Model {
    /// The model as a TOML file, which gives the same model again. Comments are not part of a model.
    #[must_use]
    pub fn to_toml(&self) -> String {
        toml(self)
    }
}

fn toml(model: &Model) -> String {
    let mut text = format!("name = {}\nid = {}\n", quoted(&model.name), model.id);
    if !model.doc.is_empty() {
        text.push_str(&format!("doc = {}\n", quoted(&model.doc)));
    }
    text.push_str(&format!(
        "# T, in ms\nperiod = {}\n# bytes, with the tag of a sealed one\nlargest-packet = {}\n# ms; 0 for none\nwatchdog = {}\n",
        model.period, model.largest_packet, model.watchdog
    ));
    for (place, element) in model.elements.iter().enumerate() {
        text.push_str("\n[[element]]\n");
        for (key, value) in keys(model, element, place) {
            text.push_str(&format!("{key} = {value}\n"));
        }
    }
    text
}

fn keys(model: &Model, element: &ModelElement, place: usize) -> Vec<(&'static str, String)> {
    let mut keys = vec![
        ("name", quoted(&element.name)),
        ("kind", quoted(kind_word(element.kind))),
    ];
    if element.kind == Kind::Monitor {
        let of = element.of.and_then(|of| model.elements.get(usize::from(of)));
        keys.extend(of.map(|of| ("of", quoted(&of.name))));
    } else {
        data(element, &mut keys);
    }
    if element.kind == Kind::Module {
        let is_member = |member: &&ModelElement| member.module.map(usize::from) == Some(place);
        let members = model.elements.iter().filter(is_member);
        keys.push(("members", list(members.map(|member| quoted(&member.name)))));
    }
    if let Some(rate) = element.rate {
        keys.push(("rate", rate.to_string()));
    }
    match (element.kind, element.motion) {
        (Kind::Effector, Motion::Incremental { .. }) => keys.push(("motion", quoted("incremental"))),
        (
            Kind::Effector,
            Motion::Absolute {
                interpolate: true, ..
            },
        ) => {
            keys.push(("interpolate", "true".to_owned()));
        }
        _ => {}
    }
    if element.period != 0 {
        keys.push(("period", element.period.to_string()));
    }
    if element.lasts != 0 {
        keys.push(("lasts", element.lasts.to_string()));
    }
    if !element.doc.is_empty() {
        keys.push(("doc", quoted(&element.doc)));
    }
    keys
}

fn data(element: &ModelElement, keys: &mut Vec<(&'static str, String)>) {
    let (number, count) = match element.payload {
        Payload::Nothing => return,
        Payload::Bytes(most) => {
            keys.push(("type", quoted("bytes")));
            keys.push(("max", element.blob.unwrap_or(most).to_string()));
            keys.extend(element.sound.map(|sound| ("sound", quoted(&sound.to_string()))));
            return;
        }
        Payload::Numbers(number, count) => (number, count),
    };
    keys.push(("type", quoted(number_word(number))));
    let quantities = &element.quantities;
    if quantities.iter().any(|quantity| quantity.part.is_some()) {
        let parts = quantities.iter().filter_map(|quantity| quantity.part.as_deref());
        keys.push(("parts", list(parts.map(quoted))));
    } else if count != 1 {
        keys.push(("count", count.to_string()));
    }
    let mut say = |key, default: &dyn Fn(&Quantity) -> bool, show: &dyn Fn(&Quantity) -> String| {
        if !quantities.iter().all(default) {
            keys.push((key, each(quantities, show)));
        }
    };
    say("unit", &|quantity| quantity.unit.is_empty(), &|quantity| {
        quoted(&quantity.unit)
    });
    say("scale", &|quantity| quantity.scale == 1.0, &|quantity| {
        quantity.scale.to_string()
    });
    let (lowest, highest) = bounds(number);
    say(
        "range",
        &|quantity| quantity.min == lowest * quantity.scale && quantity.max == highest * quantity.scale,
        &|quantity| list([quantity.min.to_string(), quantity.max.to_string()].into_iter()),
    );
    say("safe", &|quantity| quantity.safe == 0.0, &|quantity| {
        quantity.safe.to_string()
    });
}

/// Once for all numbers, or once for each where they differ.
fn each(quantities: &[Quantity], show: &dyn Fn(&Quantity) -> String) -> String {
    let shown: Vec<String> = quantities.iter().map(show).collect();
    match shown.first() {
        Some(first) if shown.iter().all(|other| other == first) => first.clone(),
        _ => list(shown.into_iter()),
    }
}

fn list(values: impl Iterator<Item = String>) -> String {
    format!("[{}]", values.collect::<Vec<_>>().join(", "))
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}
