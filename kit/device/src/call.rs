//! Statements as a card has them: what a script says, read into values.

use std::sync::Arc;

use mom_client::{CardArg, CardType, CardVerb, Value};

use crate::reading::ends;
use crate::script::WAIT;
use crate::words::Words;
use crate::{Attachments, DeviceError, ErrorName, Word};

/// A statement of a declared device: its verb, and the values of its arguments.
#[derive(Clone, Debug, PartialEq)]
pub struct Call {
    verb: Arc<CardVerb>,
    /// In the order of the verb's arguments; those that are said again follow.
    values: Vec<Argument>,
}

/// What stands for an argument.
#[derive(Clone, Debug, PartialEq)]
enum Argument {
    Number(f64),
    Word(String),
    Bytes(Arc<[u8]>),
}

impl Call {
    /// Reads what follows a verb, by what its card says; the device may refuse more, such as what is out of its reach.
    pub(crate) fn read(verb: Arc<CardVerb>, words: &mut Words<'_>) -> Result<Self, DeviceError> {
        let mut values = Vec::with_capacity(verb.args.len());
        for arg in &verb.args {
            values.push(match &arg.default {
                Some(default) if words.is_over() => default_of(default),
                _ => argument(&verb, arg, words)?,
            });
        }
        let again = verb.args.len().saturating_sub(verb.repeats as usize);
        while verb.repeats > 0 && !words.is_over() {
            for arg in verb.args.get(again..).unwrap_or_default() {
                values.push(argument(&verb, arg, words)?);
            }
        }
        Ok(Self { verb, values })
    }

    /// The verb's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.verb.name
    }

    /// What the card says of the verb.
    #[must_use]
    pub fn verb(&self) -> &CardVerb {
        &self.verb
    }

    /// The number of this argument: a `number` or a `whole`.
    ///
    /// # Errors
    ///
    /// `link` where the verb declares no such number: the device's program has to be mended.
    pub fn number(&self, name: &str) -> Result<f64, DeviceError> {
        match self.value(name) {
            Some(Argument::Number(number)) => Ok(*number),
            _ => Err(self.undeclared(name, "a number")),
        }
    }

    /// The word of this argument.
    ///
    /// # Errors
    ///
    /// As [`Call::number`].
    pub fn word(&self, name: &str) -> Result<&str, DeviceError> {
        match self.value(name) {
            Some(Argument::Word(word)) => Ok(word),
            _ => Err(self.undeclared(name, "a word")),
        }
    }

    /// The bytes of this attachment.
    ///
    /// # Errors
    ///
    /// As [`Call::number`].
    pub fn bytes(&self, name: &str) -> Result<&[u8], DeviceError> {
        match self.value(name) {
            Some(Argument::Bytes(bytes)) => Ok(bytes),
            _ => Err(self.undeclared(name, "an attachment")),
        }
    }

    /// All numbers in their order, such as those of places that are said one after the other.
    pub fn numbers(&self) -> impl Iterator<Item = f64> {
        self.values.iter().filter_map(|value| match value {
            Argument::Number(number) => Some(*number),
            _ => None,
        })
    }

    /// Puts the bytes in the place of their name.
    pub(crate) fn attach(&mut self, attachments: &Attachments) -> Result<(), DeviceError> {
        for (value, arg) in self.values.iter_mut().zip(&self.verb.args) {
            if let (Argument::Word(name), CardType::Attachment) = (&*value, arg.kind) {
                *value = Argument::Bytes(attachments.get(name)?);
            }
        }
        Ok(())
    }

    fn value(&self, name: &str) -> Option<&Argument> {
        let place = self.verb.args.iter().position(|arg| arg.name == name)?;
        self.values.get(place)
    }

    fn undeclared(&self, name: &str, kind: &str) -> DeviceError {
        let text = format!(
            "the program of the device asks `{}` for `{name}`, which is not {kind} of it",
            self.name()
        );
        DeviceError::new(ErrorName::Link, text)
    }
}

/// The verb of this name and what follows it.
pub(crate) fn read_statement(
    verbs: &[Arc<CardVerb>],
    verb: Word<'_>,
    words: &mut Words<'_>,
) -> Result<Call, DeviceError> {
    let Some(known) = verbs.iter().find(|known| known.name == verb.text) else {
        let names = verbs.iter().map(|verb| &*verb.name).chain([WAIT]);
        let nearest = mom_nearest::most_similar(&verb.short().to_lowercase(), names).unwrap_or_default();
        let text = format!("there is no `{}`; did you mean `{nearest}`?", verb.short());
        return Err(DeviceError::syntax(verb.at, text));
    };
    let call = Call::read(Arc::clone(known), words)?;
    ends(verb, words).map(|()| call)
}

/// That what stands alone does so, and what stands last: of the verbs of a script's statements, and of none for a `wait`.
pub(crate) fn check_places<'a>(
    verbs: impl ExactSizeIterator<Item = Option<&'a CardVerb>>,
) -> Result<(), (u32, String)> {
    let count = verbs.len();
    for (verb, number) in verbs.zip(1..) {
        let Some(verb) = verb else { continue };
        let how = match (verb.velocity && count > 1, verb.last && number as usize != count) {
            (true, _) => "stands alone in",
            (_, true) => "must be the last statement of",
            _ => continue,
        };
        return Err((number, format!("`{}` {how} its script", verb.name)));
    }
    Ok(())
}

fn default_of(value: &Value) -> Argument {
    match value {
        Value::String(word) => Argument::Word(word.clone()),
        Value::Int(number) => Argument::Number(*number as f64),
        Value::Double(number) => Argument::Number(*number),
        _ => Argument::Number(0.0),
    }
}

fn argument(verb: &CardVerb, arg: &CardArg, words: &mut Words<'_>) -> Result<Argument, DeviceError> {
    let usage = verb.usage();
    let word = words.need(&verb.name, &format!("`{usage}`"), &arg.name)?;
    let said = || Ok(Argument::Word(word.text.to_owned()));
    if arg.choices.iter().any(|choice| choice == word.text) {
        return said();
    }
    let wrong = |text: String| Err(DeviceError::syntax(word.at, text));
    let number = match arg.kind {
        CardType::Word | CardType::Attachment if arg.choices.is_empty() => return said(),
        CardType::Word | CardType::Attachment => {
            let choices = arg.choices.iter().map(|choice| &**choice);
            let nearest =
                mom_nearest::most_similar(&word.short().to_lowercase(), choices).unwrap_or_default();
            return wrong(format!(
                "there is no `{}`; did you mean `{nearest}`?",
                word.short()
            ));
        }
        CardType::Whole => word.text.parse::<i64>().ok().map(|number| number as f64),
        CardType::Number => word.text.parse::<f64>().ok().filter(|number| number.is_finite()),
    };
    let Some(number) = number else {
        let kind = if arg.kind == CardType::Whole {
            "whole number"
        } else {
            "number"
        };
        return wrong(format!(
            "{} is `{}`, which is not a {kind}",
            arg.name,
            word.short()
        ));
    };
    match out_of_range(arg, number) {
        None => Ok(Argument::Number(number)),
        Some(range) => wrong(format!(
            "{} is {}, `{}` takes {range}",
            arg.name,
            word.short(),
            verb.name
        )),
    }
}

/// The range of an argument in words, if this number is not in it.
fn out_of_range(arg: &CardArg, number: f64) -> Option<String> {
    let low = arg.min.is_some_and(|min| number < min);
    let high = arg.max.is_some_and(|max| number > max);
    (low || high).then(|| {
        let range = match (arg.min, arg.max) {
            (Some(min), Some(max)) => format!("{min} to {max}"),
            (Some(min), None) => format!("{min} and more"),
            (_, max) => format!("{} and less", max.unwrap_or_default()),
        };
        match arg.unit.is_empty() {
            true => range,
            false => format!("{range} {}", arg.unit),
        }
    })
}
