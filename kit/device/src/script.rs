//! Scripts of a device (M47): statements separated by `;` or by a new line, comments from `#` on.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use mom_client::{Map, Value};

use crate::words::{Words, split};
use crate::{DeviceError, ErrorName, Machine, Word};

/// The longest script, in bytes.
pub const MAX_BYTES: usize = 64 * 1024;
/// The most statements of a script.
pub const MAX_STATEMENTS: usize = 1000;
/// The most bytes that came with the scripts of one device that wait and are carried out.
pub const MAX_ATTACHED: usize = 8 << 20;
/// The longest `wait`, in ms.
pub const MAX_WAIT: u32 = 60_000;

const WAIT: &str = "wait";

/// Bytes that come with a script, by the names that its statements use, such as sounds and pictures. Statements share them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Attachments(BTreeMap<String, Arc<[u8]>>);

impl Attachments {
    /// Those of a map of names to bytes.
    ///
    /// # Errors
    ///
    /// `syntax` for one that is not bytes.
    pub fn of(map: &Map) -> Result<Self, DeviceError> {
        let bytes = |(name, value): (&str, &Value)| match value {
            Value::Binary(bytes) => Ok((name.to_owned(), bytes[..].into())),
            _ => Err(DeviceError::new(
                ErrorName::Syntax,
                format!("the attachment `{name}` has to be bytes"),
            )),
        };
        map.iter().map(bytes).collect::<Result<_, _>>().map(Self)
    }

    /// How many bytes they have.
    #[must_use]
    pub fn size(&self) -> usize {
        self.0.values().map(|bytes| bytes.len()).sum()
    }

    /// The bytes of this name.
    ///
    /// # Errors
    ///
    /// `syntax` with the names that there are.
    pub fn get(&self, name: &str) -> Result<Arc<[u8]>, DeviceError> {
        self.0.get(name).cloned().ok_or_else(|| {
            let names: Vec<&str> = self.0.keys().map(String::as_str).collect();
            let text = match names.is_empty() {
                true => format!("`{name}` did not come with the script: it has no attachments"),
                false => format!("`{name}` did not come with the script, but {}", names.join(", ")),
            };
            DeviceError::new(ErrorName::Syntax, text)
        })
    }
}

/// One statement of a script.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Statement<A> {
    /// What the device does.
    Do(A),
    /// `wait ms`: nothing is begun for so many ms, 0 to [`MAX_WAIT`].
    Wait(u32),
}

impl<A: fmt::Display> fmt::Display for Statement<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Do(action) => action.fmt(f),
            Self::Wait(ms) => write!(f, "{WAIT} {ms}"),
        }
    }
}

/// A script: between 1 and [`MAX_STATEMENTS`] statements.
#[derive(Debug, Clone, PartialEq)]
pub struct Script<A> {
    statements: Vec<Statement<A>>,
    /// Bytes that came with it.
    attached: usize,
}

impl<A> Script<A> {
    /// The statements, in the order in which they take effect.
    #[must_use]
    pub fn statements(&self) -> &[Statement<A>] {
        &self.statements
    }

    /// How many bytes came with it.
    #[must_use]
    pub fn attached(&self) -> usize {
        self.attached
    }

    /// What the device does, with the number of each statement (1 for the first).
    pub fn actions(&self) -> impl Iterator<Item = (&A, u32)> {
        self.statements
            .iter()
            .zip(1..)
            .filter_map(|(statement, number)| match statement {
                Statement::Do(action) => Some((action, number)),
                Statement::Wait(_) => None,
            })
    }

    /// Whether its first motion says only how far it goes from where the device is then, so that it is wrong from anywhere else
    /// (M35).
    #[must_use]
    pub fn is_relative<M: Machine<Action = A>>(&self) -> bool {
        let first = self.actions().find_map(|(action, _)| M::is_relative(action));
        first == Some(true)
    }

    /// Reads a script of this machine.
    ///
    /// # Errors
    ///
    /// `syntax` with the statement's number, where the mistake begins, and the nearest known word where a word is unknown.
    pub fn read<M: Machine<Action = A>>(text: &str) -> Result<Self, DeviceError> {
        Self::statements_of::<M>(text).map_err(|error| error.in_text(text))
    }

    /// Reads a script of this machine that comes with bytes.
    ///
    /// # Errors
    ///
    /// As [`Script::read`], and for bytes that did not come.
    pub fn read_with<M: Machine<Action = A>>(
        text: &str,
        attachments: &Attachments,
    ) -> Result<Self, DeviceError> {
        let mut script = Self::read::<M>(text)?;
        script.attached = attachments.size();
        for (statement, number) in script.statements.iter_mut().zip(1..) {
            if let Statement::Do(action) = statement {
                M::attach(action, attachments).map_err(|error| error.at_statement(number))?;
            }
        }
        Ok(script)
    }

    fn statements_of<M: Machine<Action = A>>(text: &str) -> Result<Self, DeviceError> {
        if text.len() > MAX_BYTES {
            let length = text.len();
            let text = format!("the script has {length} bytes, at most {MAX_BYTES} are read");
            return Err(DeviceError::syntax(MAX_BYTES, text));
        }
        let mut statements = Vec::new();
        for mut words in split(text) {
            let Some(verb) = words.next() else { continue };
            let number = u32::try_from(statements.len() + 1).unwrap_or(u32::MAX);
            if statements.len() == MAX_STATEMENTS {
                let text = format!("the script has more than {MAX_STATEMENTS} statements");
                return Err(DeviceError::syntax(verb.at, text));
            }
            let statement = statement::<M>(verb, &mut words);
            statements.push(statement.map_err(|error| error.at_statement(number))?);
        }
        match statements.is_empty() {
            true => Err(DeviceError::syntax(0, "the script has no statement")),
            false => Ok(Self {
                statements,
                attached: 0,
            }),
        }
    }
}

fn statement<M: Machine>(verb: Word<'_>, words: &mut Words<'_>) -> Result<Statement<M::Action>, DeviceError> {
    let statement = match verb.text {
        WAIT => Statement::Wait(wait(words)?),
        _ => match M::read(verb, words) {
            Some(action) => Statement::Do(action?),
            None => return Err(unknown::<M>(verb)),
        },
    };
    match words.next() {
        None => Ok(statement),
        Some(word) => {
            let (verb, short) = (verb.text, word.short());
            let text = format!("`{verb}` ends before `{short}`; is a `;` or a new line missing?");
            Err(DeviceError::syntax(word.at, text))
        }
    }
}

fn wait(words: &mut Words<'_>) -> Result<u32, DeviceError> {
    let word = words.need(WAIT, "a time in ms", "it")?;
    let ms = word.text.parse().ok().filter(|ms| *ms <= MAX_WAIT);
    ms.ok_or_else(|| {
        let short = word.short();
        let text = format!("`wait` takes a whole number of ms from 0 to {MAX_WAIT}, not `{short}`");
        DeviceError::syntax(word.at, text)
    })
}

fn unknown<M: Machine>(verb: Word<'_>) -> DeviceError {
    let nearest = verb.nearest(&[M::VERBS, &[WAIT]].concat());
    let text = format!("there is no `{}`; did you mean `{nearest}`?", verb.short());
    DeviceError::syntax(verb.at, text).with_nearest(nearest)
}
