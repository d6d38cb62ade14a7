//! Sections become a model, if nothing is wrong with them.

use std::ops::Range;

use mom_rsp::{AudioCodec, Kind, Motion, Number, Payload, Sound};
use mom_toml_faults::{At, Section, quoted, unknown};

use crate::canonical;
use crate::fault::{Fault, Found};
use crate::keys::{choice, integer, list, number, word};
use crate::model::{
    Direction, HEADER, HIGHEST_PACKET, KINDS, MOST_ELEMENTS, Model, ModelElement, NUMBERS, TAG, kind_word,
};
use crate::quantities::{self, in_code};
use crate::text::Source;

/// The keys of the file itself.
const ROOT_KEYS: &[&str] = &[
    "name",
    "id",
    "doc",
    "period",
    "largest-packet",
    "watchdog",
    "element",
];

/// The keys of elements.
const ELEMENT_KEYS: &[&str] = &[
    "name",
    "kind",
    "type",
    "count",
    "max",
    "sound",
    "parts",
    "unit",
    "scale",
    "range",
    "safe",
    "rate",
    "motion",
    "interpolate",
    "period",
    "lasts",
    "of",
    "members",
    "doc",
];

const DEFAULT_PERIOD: u16 = 20;
const DEFAULT_WATCHDOG: u16 = 500;
/// What an Ethernet frame holds beside the headers of IPv4 and UDP.
const DEFAULT_LARGEST: u16 = 1472;
const LEAST_LARGEST: u16 = 64;
/// The most characters of a doc text.
const LONGEST_DOC: usize = 4096;

/// An element that has been read, and what is looked up when all have been.
struct Draft {
    element: ModelElement,
    name: At<String>,
    of: Option<At<String>>,
    members: Vec<At<String>>,
}

pub(crate) fn model(source: &Source) -> Result<Model, Found> {
    let root = source.root.only(ROOT_KEYS)?;
    let name = word(root.required("name")?)?;
    let id = integer(root, "id", 0..=u16::MAX, None)?;
    let period = integer(root, "period", 1..=200, Some(DEFAULT_PERIOD))?;
    let largest_packet = integer(
        root,
        "largest-packet",
        LEAST_LARGEST..=HIGHEST_PACKET,
        Some(DEFAULT_LARGEST),
    )?;
    let watchdog = watchdog(root, period)?;
    let doc = doc(root)?;
    if let Some(section) = source.elements.get(MOST_ELEMENTS) {
        let words = format!(
            "{} elements are too many: a model has at most {MOST_ELEMENTS}",
            source.elements.len()
        );
        return Err(Found::new(Fault::Elements, &section.span, words));
    }
    if source.elements.is_empty() {
        let words = "the model has no element: write `[[element]]` for each";
        return Err(Found::new(Fault::Elements, &root.span, words));
    }
    let mut drafts: Vec<Draft> = Vec::new();
    for section in &source.elements {
        let draft = element(section, &drafts)?;
        drafts.push(draft);
    }
    let monitors = monitors(&drafts)?;
    let modules = modules(&drafts)?;
    let mut elements: Vec<ModelElement> = drafts.into_iter().map(|draft| draft.element).collect();
    for ((element, monitor), module) in elements.iter_mut().zip(monitors).zip(modules) {
        element.module = module;
        if let Some((place, payload, quantities)) = monitor {
            element.of = Some(place);
            element.payload = payload;
            element.quantities = quantities;
        }
    }
    fragment(&mut elements, largest_packet);
    let digests: Vec<u32> = elements
        .iter()
        .map(|element| canonical::digest(element, &elements))
        .collect();
    for (element, digest) in elements.iter_mut().zip(digests) {
        element.digest = digest;
    }
    let mut model = Model {
        name: name.value,
        id,
        doc,
        period,
        largest_packet,
        watchdog,
        elements,
        hash: [0; 32],
    };
    packets(&model, source)?;
    model.hash = canonical::hash(&model);
    Ok(model)
}

fn watchdog(root: &Section, period: u16) -> Result<u16, Found> {
    let watchdog = integer(
        root,
        "watchdog",
        0..=u16::MAX,
        Some(DEFAULT_WATCHDOG.max(period.saturating_mul(2))),
    )?;
    match root.get("watchdog") {
        Some(item) if watchdog != 0 && watchdog < period.saturating_mul(2) => {
            let words = format!(
                "a watchdog of {watchdog} ms ends the session at one lost packet: set 0 for none, or at least two periods, {} ms",
                period.saturating_mul(2)
            );
            Err(Found::new(Fault::Number, &item.span, words))
        }
        _ => Ok(watchdog),
    }
}

fn doc(keys: &Section) -> Result<String, Found> {
    let Some(item) = keys.get("doc") else {
        return Ok(String::new());
    };
    let doc = item.text()?;
    if doc.chars().nth(LONGEST_DOC).is_some() {
        let words = format!("a doc text has at most {LONGEST_DOC} characters");
        return Err(Found::new(Fault::TooLong, &item.span, words));
    }
    Ok(doc.trim().to_owned())
}

/// The keys that say something of elements of a kind; `name`, `kind` and `doc` are everybody's.
fn has_key(kind: Kind, key: &str) -> bool {
    match key {
        "name" | "kind" | "doc" => true,
        "safe" | "rate" | "motion" | "interpolate" => kind == Kind::Effector,
        "period" => matches!(kind, Kind::Sensor | Kind::Monitor),
        "lasts" => matches!(kind, Kind::Command | Kind::MemoryCommand),
        "sound" => matches!(kind, Kind::Effector | Kind::Sensor),
        "of" => kind == Kind::Monitor,
        "members" => kind == Kind::Module,
        _ => !matches!(kind, Kind::Monitor | Kind::Module),
    }
}

fn element(section: &Section, before: &[Draft]) -> Result<Draft, Found> {
    let keys = section.only(ELEMENT_KEYS)?;
    let name = word(keys.required("name")?)?;
    if let Some(other) = before
        .iter()
        .find(|other| in_code(&other.name.value) == in_code(&name.value))
    {
        let words = match other.name.value == name.value {
            true => format!("two elements have the name `{}`", name.value),
            false => format!(
                "`{}` and `{}` have the same name in generated code",
                name.value, other.name.value
            ),
        };
        return Err(Found::new(Fault::NameTwice, &name.span, words));
    }
    let kind = choice(keys.required("kind")?, "kind of element", &KINDS)?;
    only_keys_of(kind, keys)?;
    let of = match kind {
        Kind::Monitor => Some(word(keys.required("of")?)?),
        _ => None,
    };
    let members = match kind {
        Kind::Module => members(keys)?,
        _ => Vec::new(),
    };
    let mut element = ModelElement {
        name: name.value.clone(),
        kind,
        payload: Payload::Nothing,
        blob: None,
        sound: None,
        quantities: Vec::new(),
        motion: Motion::Absolute {
            interpolate: false,
            rate: None,
        },
        rate: None,
        safe: Vec::new(),
        period: integer(keys, "period", 0..=60_000, Some(0))?,
        lasts: integer(keys, "lasts", 0..=60_000, Some(0))?,
        of: None,
        module: None,
        doc: doc(keys)?,
        digest: 0,
    };
    match payload(keys, kind)? {
        Payload::Numbers(of, count) => numbers(keys, &mut element, of, count)?,
        other => {
            no_keys_of_numbers(keys, other)?;
            element.payload = other;
            element.sound = sound(keys, other)?;
            if let (Kind::Effector, Payload::Bytes(_)) = (kind, other) {
                // No bytes: their number alone.
                element.safe = vec![0, 0];
            }
        }
    }
    Ok(Draft {
        element,
        name,
        of,
        members,
    })
}

fn only_keys_of(kind: Kind, keys: &Section) -> Result<(), Found> {
    for key in ELEMENT_KEYS.iter().filter(|key| !has_key(kind, key)) {
        if let Some(span) = keys.key_span(key) {
            let word = kind_word(kind).replace('-', " ");
            let article = if word.starts_with('e') { "an" } else { "a" };
            let words = format!("{article} {word} has no `{key}`");
            return Err(Found::new(Fault::NotOfKind, span, words));
        }
    }
    Ok(())
}

fn no_keys_of_numbers(keys: &Section, payload: Payload) -> Result<(), Found> {
    const OF_NUMBERS: [&str; 9] = [
        "count",
        "parts",
        "unit",
        "scale",
        "range",
        "safe",
        "rate",
        "motion",
        "interpolate",
    ];
    let Some((key, span)) = OF_NUMBERS.iter().find_map(|key| Some((key, keys.key_span(key)?))) else {
        return Ok(());
    };
    let words = match payload {
        Payload::Bytes(_) => format!("`{key}` applies to numbers, not to bytes"),
        _ => format!("`{key}` requires a `type` of numbers"),
    };
    Err(Found::new(Fault::NotOfKind, span, words))
}

fn members(keys: &Section) -> Result<Vec<At<String>>, Found> {
    let item = keys.required("members")?;
    let values = list(item).ok_or_else(|| item.wrong_type("a list of names"))?;
    values.iter().map(word).collect()
}

/// The type of an element's data. Commands and events may have none.
fn payload(keys: &Section, kind: Kind) -> Result<Payload, Found> {
    let bytes = [("bytes", None)];
    let types = NUMBERS.map(|(word, number)| (word, Some(number)));
    let types: Vec<(&str, Option<Number>)> = types.into_iter().chain(bytes).collect();
    let item = match (keys.get("type"), kind) {
        (Some(item), _) => item,
        (None, Kind::Effector | Kind::Sensor) => keys.required("type")?,
        (None, _) => {
            return match of_bytes(keys) {
                Some((key, span)) => {
                    let words = format!("`{key}` requires `type = \"bytes\"`");
                    Err(Found::new(Fault::NotOfKind, span, words))
                }
                None => Ok(Payload::Nothing),
            };
        }
    };
    match choice(item, "type", &types)? {
        None => Ok(Payload::Bytes(integer(keys, "max", 1..=u16::MAX, None)?)),
        Some(number) => match of_bytes(keys) {
            Some((key, span)) => {
                let words = format!("`{key}` is of bytes; how many numbers there are is `count`");
                Err(Found::new(Fault::NotOfKind, span, words))
            }
            None => Ok(Payload::Numbers(number, quantities::count(keys)?)),
        },
    }
}

/// A key that is of bytes alone.
fn of_bytes(keys: &Section) -> Option<(&'static str, &Range<usize>)> {
    ["max", "sound"]
        .into_iter()
        .find_map(|key| Some((key, keys.key_span(key)?)))
}

/// What kind of sound the bytes are, if they are some.
fn sound(keys: &Section, payload: Payload) -> Result<Option<Sound>, Found> {
    let (Some(item), Payload::Bytes(most)) = (keys.get("sound"), payload) else {
        return Ok(None);
    };
    let text = item.text()?;
    let found = |fault: Fault, words: String| Err(Found::new(fault, &item.span, words));
    let Some((word, rate)) = text.split_once(' ') else {
        let words = format!(
            "a sound must be a codec and its samples per second, such as `pcm 16000`, not `{}`",
            quoted(text)
        );
        return found(Fault::UnknownWord, words);
    };
    let Some(codec) = AudioCodec::ALL.into_iter().find(|codec| codec.word() == word) else {
        return found(
            Fault::UnknownWord,
            unknown("codec", word, &AudioCodec::ALL.map(AudioCodec::word)),
        );
    };
    let is_right = |rate: &u32| codec.takes(*rate);
    let Some(rate) = rate.parse().ok().filter(is_right) else {
        let rates = match codec {
            AudioCodec::Pcm => "8000 to 96000 samples a second, a multiple of 50",
            AudioCodec::Opus => "8000, 12000, 16000, 24000 or 48000 samples a second",
        };
        return found(
            Fault::Number,
            format!("{word} has {rates}, and not `{}`", quoted(rate)),
        );
    };
    let sound = Sound { codec, rate };
    if sound.block() > usize::from(most) {
        let words = format!(
            "20 ms of it take up to {} bytes, and `max` is {most}",
            sound.block()
        );
        return found(Fault::Number, words);
    }
    Ok(Some(sound))
}

fn numbers(keys: &Section, element: &mut ModelElement, of: Number, count: u16) -> Result<(), Found> {
    let motions = [("absolute", false), ("incremental", true)];
    let incremental = match keys.get("motion") {
        Some(item) => choice(item, "way of motion", &motions)?,
        None => false,
    };
    element.payload = Payload::Numbers(of, count);
    element.quantities = quantities::read(keys, element.kind, of, count, incremental)?;
    if element.kind != Kind::Effector {
        return Ok(());
    }
    element.safe = quantities::safe_bytes(&element.quantities, of, count);
    let interpolate = keys.get("interpolate").map_or(Ok(false), At::flag)?;
    element.rate = rate(keys)?;
    let rate = wire_rate(keys, element)?;
    element.motion = match incremental {
        true if interpolate => {
            let span = keys.key_span("interpolate").unwrap_or(&keys.span);
            let words = "incremental steps cannot be interpolated: leave out `interpolate` or `motion`";
            return Err(Found::new(Fault::NotOfKind, span, words));
        }
        true => Motion::Incremental { rate },
        false => Motion::Absolute { interpolate, rate },
    };
    Ok(())
}

/// The limit of change, in the element's unit a second.
fn rate(keys: &Section) -> Result<Option<f64>, Found> {
    keys.get("rate").map(number).transpose()
}

/// The same in units of the wire.
fn wire_rate(keys: &Section, element: &ModelElement) -> Result<Option<f32>, Found> {
    let Some(rate) = element.rate else {
        return Ok(None);
    };
    let span = keys.get("rate").map_or(&keys.span, |item| &item.span);
    let scale = element.quantities.first().map_or(1.0, |first| first.scale);
    if element.quantities.iter().any(|other| other.scale != scale) {
        let words = "one rate cannot limit numbers of several scales: make them elements of their own";
        return Err(Found::new(Fault::Number, span, words));
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "what does not fit is refused below"
    )]
    let wire = (rate / scale) as f32;
    if !wire.is_normal() || wire < 0.0 {
        let words = format!("a rate is in units per second and must exceed 0, not {rate}");
        return Err(Found::new(Fault::Number, span, words));
    }
    Ok(Some(wire))
}

type Monitored = Option<(u8, Payload, Vec<crate::Quantity>)>;

/// For each element: what it has of its effector, if it is a monitor.
fn monitors(drafts: &[Draft]) -> Result<Vec<Monitored>, Found> {
    let effectors: Vec<&str> = drafts
        .iter()
        .filter(|draft| draft.element.kind == Kind::Effector)
        .map(|draft| draft.name.value.as_str())
        .collect();
    let monitored = |draft: &Draft| {
        let Some(of) = &draft.of else {
            return Ok(None);
        };
        let (place, effector) = lookup(drafts, of, "effector", &effectors)?;
        let element = &effector.element;
        if element.kind != Kind::Effector {
            let words = format!(
                "a monitor reports the states of an effector, and `{}` is of kind {}",
                of.value,
                kind_word(element.kind)
            );
            return Err(Found::new(Fault::Reference, &of.span, words));
        }
        let mut quantities = element.quantities.clone();
        for quantity in &mut quantities {
            quantity.safe = 0.0;
        }
        Ok(Some((place, element.payload, quantities)))
    };
    drafts.iter().map(monitored).collect()
}

/// For each element: the module that it is a member of.
fn modules(drafts: &[Draft]) -> Result<Vec<Option<u8>>, Found> {
    let names: Vec<&str> = drafts
        .iter()
        .filter(|draft| draft.element.kind != Kind::Module)
        .map(|draft| draft.name.value.as_str())
        .collect();
    let mut modules = vec![None; drafts.len()];
    for (place, draft) in (0u8..=u8::MAX).zip(drafts) {
        for member in &draft.members {
            let (at, found) = lookup(drafts, member, "element", &names)?;
            let Some(module) = modules.get_mut(usize::from(at)) else {
                continue;
            };
            let words = if found.element.kind == Kind::Module {
                format!(
                    "`{}` is a module, and a module cannot contain modules",
                    member.value
                )
            } else if *module == Some(place) {
                format!("`{}` is listed twice", member.value)
            } else if module.is_some() {
                format!("`{}` is a member of another module already", member.value)
            } else {
                *module = Some(place);
                continue;
            };
            return Err(Found::new(Fault::Reference, &member.span, words));
        }
    }
    Ok(modules)
}

fn lookup<'d>(
    drafts: &'d [Draft],
    name: &At<String>,
    what: &str,
    candidates: &[&str],
) -> Result<(u8, &'d Draft), Found> {
    let found = (0u8..=u8::MAX)
        .zip(drafts)
        .find(|(_, draft)| draft.name.value == name.value);
    found.ok_or_else(|| {
        let few = candidates.get(..8).unwrap_or(candidates);
        let words = match unknown(what, &name.value, candidates) {
            // A longer list does not help.
            long if long.len() > 400 => format!(
                "there is no {what} `{}`; expected one of `{}` and others",
                quoted(&name.value),
                few.join("`, `")
            ),
            words => words,
        };
        Found::new(Fault::Reference, &name.span, words)
    })
}

/// Values that do not fit a packet travel in fragments (S13, S27). Commands and events cannot: they arrive as a whole.
fn fragment(elements: &mut [ModelElement], largest_packet: u16) {
    let room = usize::from(largest_packet).saturating_sub(HEADER + elements.len().div_ceil(8) + TAG);
    for element in elements {
        let is_value = matches!(element.kind, Kind::Effector | Kind::Sensor | Kind::Monitor);
        if let (true, Payload::Bytes(most)) = (is_value, element.payload)
            && element.payload.size() > room
        {
            element.blob = Some(most);
            element.payload = Payload::Bytes(0);
        }
    }
}

/// Whether packets with everything in them are small enough.
fn packets(model: &Model, source: &Source) -> Result<(), Found> {
    let limit = usize::from(model.largest_packet);
    for direction in [Direction::Down, Direction::Up] {
        let size = model.packet_size(direction) + TAG;
        if size <= limit {
            continue;
        }
        // The element with which it is too large is the place to look at.
        let mut sum = HEADER + model.map_size() + TAG;
        let beyond = model.elements.iter().position(|element| {
            sum += element.payload_size(direction);
            sum > limit
        });
        let section = beyond.and_then(|place| source.elements.get(place));
        let span = &section.unwrap_or(&source.root).span;
        let way = match direction {
            Direction::Down => "to",
            Direction::Up => "from",
        };
        let words = format!(
            "a packet {way} the robot with everything in it has {size} bytes, and `largest-packet` is {limit}: make it more, or an element smaller"
        );
        return Err(Found::new(Fault::Packet, span, words));
    }
    Ok(())
}
