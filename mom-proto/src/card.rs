//! What a device says of itself: its card.

use serde::{Deserialize, Serialize};

use crate::{Code, Path, Value, WireError, check_name, content, from_value};

/// The version of cards that this describes.
pub const CARD_VERSION: u32 = 1;

/// The most bytes of a card in the binary form.
pub const MAX_CARD: usize = 64 * 1024;

/// What a device can do, and what it tells of itself; published when it joins its channel, and read by all that show or drive it.
///
/// Nothing relies on it that protects: what a command may do is decided by rights, guards, stops and the device itself.
///
/// ```
/// use mom_proto::{Card, Map, Value};
///
/// let go = Map::new()
///     .with("name", "go")
///     .with("moves", true)
///     .with("args", vec![Map::new().with("name", "x").with("type", "number").with("unit", "mm").into()]);
/// let card = Map::new().with("card", 1).with("name", "cart").with("verbs", vec![go.into()]);
/// assert_eq!(Card::read(&card.clone().into())?.verbs[0].usage(), "go x/mm");
///
/// let wrong = card.with("verbs", vec![Map::new().with("name", "go now").with("moves", true).into()]);
/// let error = Card::read(&wrong.into()).unwrap_err();
/// assert_eq!(error.get("slot").and_then(Value::as_str), Some("content/device/card/verbs/0/name"));
/// # Ok::<(), mom_proto::WireError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Card {
    /// The version of this form, [`CARD_VERSION`].
    pub card: u32,
    /// What it is called in texts.
    pub name: String,
    /// What it is, for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub does: String,
    /// The statements of its scripts, without `wait`, which every device has.
    #[serde(default)]
    pub verbs: Vec<CardVerb>,
    /// The fields of its `state`, without those that every device has.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub state: Vec<CardField>,
    /// ms within which it stands once it is to.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stops_within: Option<u32>,
    /// What it does when its link is lost.
    #[serde(default, skip_serializing_if = "OnLoss::is_halt")]
    pub on_loss: OnLoss,
    /// The channels of cameras that see it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<String>,
}

/// One statement of a device's scripts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct CardVerb {
    /// Its first word.
    pub name: String,
    /// What it does, for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub does: String,
    /// What follows, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub args: Vec<CardArg>,
    /// So many of its last arguments may be said again and again.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub repeats: u32,
    /// Whether it moves the device.
    pub moves: bool,
    /// Whether it says only how far it goes, so that its command needs `based-on`.
    #[serde(default, skip_serializing_if = "is_false")]
    pub relative: bool,
    /// Whether it goes on for a time or until the next command, which it gives way to, and waits behind no other.
    #[serde(default, skip_serializing_if = "is_false")]
    pub velocity: bool,
    /// Whether it moves a part of the device and takes it nowhere, so that a relative statement behind it needs `based-on` all the same.
    #[serde(default, skip_serializing_if = "is_false")]
    pub in_place: bool,
    /// Whether it must be the last statement of its script.
    #[serde(default, skip_serializing_if = "is_false")]
    pub last: bool,
}

/// One argument of a statement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct CardArg {
    /// What it is called.
    pub name: String,
    /// What may stand there.
    #[serde(rename = "type")]
    pub kind: CardType,
    /// Of a number.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// The least number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// The greatest number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
    /// The words that may stand there: of a `word` the only ones, of a number beside numbers.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<String>,
    /// What holds where it is left out; only the last arguments have that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub default: Option<Value>,
}

/// One field of a device's `state`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct CardField {
    /// Its key; of a map in it, the keys with `.` between.
    pub name: String,
    /// What it is.
    #[serde(rename = "type", default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<FieldType>,
    /// Of a number.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// What it says, for people.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub does: String,
}

/// What may stand as an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CardType {
    /// A finite number.
    Number,
    /// A whole number.
    Whole,
    /// A word.
    Word,
    /// The name of an attachment.
    Attachment,
}

/// What a field of a state is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FieldType {
    /// A number.
    Number,
    /// A whole number.
    Whole,
    /// True or false.
    Boolean,
    /// A text.
    Word,
}

/// What a device does when its link is lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnLoss {
    /// It halts.
    #[default]
    Halt,
    /// It goes on with its order, as its token's configuration has to permit.
    GoOn,
}

impl OnLoss {
    /// Whether it halts.
    #[must_use]
    pub fn is_halt(&self) -> bool {
        *self == OnLoss::Halt
    }
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands it over so")]
fn is_false(is: &bool) -> bool {
    !is
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands it over so")]
fn is_zero(number: &u32) -> bool {
    *number == 0
}

impl Card {
    /// The card of a device that says nothing else yet.
    #[must_use]
    pub fn new(name: &str, does: &str) -> Card {
        Card {
            card: CARD_VERSION,
            name: name.to_owned(),
            does: does.to_owned(),
            verbs: Vec::new(),
            state: Vec::new(),
            stops_within: None,
            on_loss: OnLoss::Halt,
            cameras: Vec::new(),
        }
    }

    /// This card with these statements more.
    #[must_use]
    pub fn verbs(mut self, verbs: impl IntoIterator<Item = CardVerb>) -> Card {
        self.verbs.extend(verbs);
        self
    }

    /// This card with a field of numbers more.
    #[must_use]
    pub fn measures(mut self, name: &str, unit: &str, does: &str) -> Card {
        self.state.push(CardField {
            name: name.to_owned(),
            kind: Some(FieldType::Number),
            unit: unit.to_owned(),
            does: does.to_owned(),
        });
        self
    }

    /// This card with another field more.
    #[must_use]
    pub fn tells(mut self, name: &str, kind: FieldType, does: &str) -> Card {
        self.state.push(CardField {
            name: name.to_owned(),
            kind: Some(kind),
            unit: String::new(),
            does: does.to_owned(),
        });
        self
    }

    /// The statement of this name.
    #[must_use]
    pub fn verb(&self, name: &str) -> Option<&CardVerb> {
        self.verbs.iter().find(|verb| verb.name == name)
    }

    /// About how many bytes a card takes.
    #[must_use]
    pub fn size(value: &Value) -> usize {
        content::size(value)
    }

    /// Reads the card of a join.
    ///
    /// # Errors
    /// `bad-content`, with the slot of what is wrong: `content/device/card/verbs/0/args/1/min`.
    pub fn read(value: &Value) -> Result<Card, WireError> {
        let size = Card::size(value);
        if size > MAX_CARD {
            let text = format!("the card has {size} bytes, at most {MAX_CARD} are kept");
            return Err(wrong("", text));
        }
        let version = value
            .as_map()
            .and_then(|map| map.get("card"))
            .and_then(Value::as_int);
        if version != Some(i64::from(CARD_VERSION)) {
            let text = format!("card must be a map with the version of its form, card = {CARD_VERSION}");
            return Err(wrong("card", text));
        }
        let card: Card = from_value(value.clone()).map_err(|error| {
            // It stands in a join, whose content it is not.
            let at = error.get("slot").and_then(Value::as_str).unwrap_or_default();
            wrong(
                at.trim_start_matches("content").trim_start_matches('/'),
                error.text.clone(),
            )
        })?;
        card.check()?;
        Ok(card)
    }

    fn check(&self) -> Result<(), WireError> {
        check_word(&self.name, "name")?;
        let mut known: Vec<&str> = vec!["wait"];
        for (verb, at) in self.verbs.iter().zip(0..) {
            let at = format!("verbs/{at}");
            check_word(&verb.name, &format!("{at}/name"))?;
            if known.contains(&&*verb.name) {
                let text = format!("there is a statement `{}` already", verb.name);
                return Err(wrong(&format!("{at}/name"), text));
            }
            known.push(&verb.name);
            verb.check(&at)?;
        }
        for (field, at) in self.state.iter().zip(0..) {
            check_word(&field.name, &format!("state/{at}/name"))?;
        }
        for (camera, at) in self.cameras.iter().zip(0..) {
            let place = format!("cameras/{at}");
            Path::parse(camera).map_err(|error| wrong(&place, error.text))?;
        }
        Ok(())
    }
}

impl CardVerb {
    /// A statement without arguments that moves nothing.
    #[must_use]
    pub fn new(name: &str, does: &str) -> CardVerb {
        CardVerb {
            name: name.to_owned(),
            does: does.to_owned(),
            args: Vec::new(),
            repeats: 0,
            moves: false,
            relative: false,
            velocity: false,
            in_place: false,
            last: false,
        }
    }

    /// The same that moves the device.
    #[must_use]
    pub fn motion(name: &str, does: &str) -> CardVerb {
        CardVerb {
            moves: true,
            ..CardVerb::new(name, does)
        }
    }

    /// This statement with these arguments more.
    #[must_use]
    pub fn args(mut self, args: impl IntoIterator<Item = CardArg>) -> CardVerb {
        self.args.extend(args);
        self
    }

    /// This statement, which says only how far it goes.
    #[must_use]
    pub fn relative(mut self) -> CardVerb {
        self.relative = true;
        self
    }

    /// This statement, which goes on for a time or until the next command.
    #[must_use]
    pub fn velocity(mut self) -> CardVerb {
        self.velocity = true;
        self
    }

    /// This statement, of which so many of the last arguments may be said again.
    #[must_use]
    pub fn repeating(mut self, repeats: u32) -> CardVerb {
        self.repeats = repeats;
        self
    }

    fn check(&self, at: &str) -> Result<(), WireError> {
        let count = u32::try_from(self.args.len()).unwrap_or(u32::MAX);
        if self.repeats > count {
            let text = format!(
                "{} arguments cannot be said again, there are {count}",
                self.repeats
            );
            return Err(wrong(&format!("{at}/repeats"), text));
        }
        let mut optional = false;
        for (arg, number) in self.args.iter().zip(0..) {
            let at = format!("{at}/args/{number}");
            check_word(&arg.name, &format!("{at}/name"))?;
            if optional && arg.default.is_none() {
                let text = "an argument behind one with a default needs a default too";
                return Err(wrong(&format!("{at}/default"), text.to_owned()));
            }
            optional |= arg.default.is_some();
            arg.check(&at)?;
        }
        Ok(())
    }

    /// The statement as help shows it: `move x/mm y/mm [speed/mm/s]`.
    #[must_use]
    pub fn usage(&self) -> String {
        let mut usage = self.name.clone();
        for arg in &self.args {
            let word = match (arg.choices.is_empty(), arg.kind) {
                (false, CardType::Word) => arg.choices.join("|"),
                (false, _) => format!("{}|{}", arg.choices.join("|"), arg.name),
                (true, _) if arg.unit.is_empty() => arg.name.clone(),
                (true, _) => format!("{}/{}", arg.name, arg.unit),
            };
            usage += &match arg.default {
                Some(_) => format!(" [{word}]"),
                None => format!(" {word}"),
            };
        }
        if self.repeats > 0 {
            usage += " …";
        }
        usage
    }
}

impl CardArg {
    /// An argument of this type.
    #[must_use]
    pub fn new(name: &str, kind: CardType) -> CardArg {
        CardArg {
            name: name.to_owned(),
            kind,
            unit: String::new(),
            min: None,
            max: None,
            choices: Vec::new(),
            default: None,
        }
    }

    /// A number in this unit.
    #[must_use]
    pub fn number(name: &str, unit: &str) -> CardArg {
        CardArg {
            unit: unit.to_owned(),
            ..CardArg::new(name, CardType::Number)
        }
    }

    /// A whole number in this unit.
    #[must_use]
    pub fn whole(name: &str, unit: &str) -> CardArg {
        CardArg {
            unit: unit.to_owned(),
            ..CardArg::new(name, CardType::Whole)
        }
    }

    /// One of these words.
    #[must_use]
    pub fn one_of(name: &str, choices: &[&str]) -> CardArg {
        CardArg {
            choices: choices.iter().map(|choice| (*choice).to_owned()).collect(),
            ..CardArg::new(name, CardType::Word)
        }
    }

    /// This number, between these two.
    #[must_use]
    pub fn within(mut self, range: std::ops::RangeInclusive<f64>) -> CardArg {
        (self.min, self.max) = (Some(*range.start()), Some(*range.end()));
        self
    }

    /// This argument, which may be left out.
    #[must_use]
    pub fn or(mut self, default: impl Into<Value>) -> CardArg {
        self.default = Some(default.into());
        self
    }

    fn check(&self, at: &str) -> Result<(), WireError> {
        let is_number = matches!(self.kind, CardType::Number | CardType::Whole);
        if !is_number && (self.min.is_some() || self.max.is_some() || !self.unit.is_empty()) {
            return Err(wrong(at, "only numbers have unit, min and max".to_owned()));
        }
        if let (Some(min), Some(max)) = (self.min, self.max)
            && min > max
        {
            return Err(wrong(
                &format!("{at}/min"),
                format!("min is {min}, above max, {max}"),
            ));
        }
        for (choice, number) in self.choices.iter().zip(0..) {
            check_word(choice, &format!("{at}/choices/{number}"))?;
        }
        let fits = match &self.default {
            None => true,
            Some(Value::String(word)) => word.is_empty() || check_name(word).is_ok(),
            Some(Value::Int(number)) => self.takes(*number as f64),
            Some(Value::Double(number)) => self.takes(*number),
            Some(_) => false,
        };
        match fits {
            true => Ok(()),
            false => {
                let text = "a default is a word, or a number that lies within min and max".to_owned();
                Err(wrong(&format!("{at}/default"), text))
            }
        }
    }

    fn takes(&self, number: f64) -> bool {
        let is_number = matches!(self.kind, CardType::Number | CardType::Whole);
        is_number && self.min.is_none_or(|min| number >= min) && self.max.is_none_or(|max| number <= max)
    }
}

/// Where the card stands in a join.
const CARD: &str = "device/card";

fn slot(at: &str) -> String {
    match at.is_empty() {
        true => format!("content/{CARD}"),
        false => format!("content/{CARD}/{at}"),
    }
}

fn wrong(at: &str, text: String) -> WireError {
    WireError::new(Code::BAD_CONTENT, text).slot(&slot(at))
}

/// A word of a script: without white space, `;` and `#`.
fn check_word(word: &str, at: &str) -> Result<(), WireError> {
    check_name(word).map_err(|error| wrong(at, error.text))
}

#[cfg(test)]
mod tests;
