//! Scripts of a device (M47): statements separated by `;` or by a new line, comments from `#` on.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use mom_client::{Map, Value};

use crate::{DeviceError, ErrorName};

/// The longest script, in bytes.
pub const MAX_BYTES: usize = 64 * 1024;
/// The most statements of a script.
pub const MAX_STATEMENTS: usize = 1000;
/// The most bytes that came with the scripts of one device that wait and are carried out.
pub const MAX_ATTACHED: usize = 8 << 20;
/// The longest `wait`, in ms.
pub const MAX_WAIT: u32 = 60_000;

pub(crate) const WAIT: &str = "wait";

/// That a script is not too long to be read.
pub(crate) fn check_length(text: &str) -> Result<(), DeviceError> {
    let length = text.len();
    match length > MAX_BYTES {
        true => {
            let text = format!("the script has {length} bytes, at most {MAX_BYTES} are read");
            Err(DeviceError::syntax(MAX_BYTES, text))
        }
        false => Ok(()),
    }
}

/// The number of the statement behind so many others, which begins there.
pub(crate) fn check_number(before: usize, at: usize) -> Result<u32, DeviceError> {
    match before < MAX_STATEMENTS {
        true => Ok(u32::try_from(before + 1).unwrap_or(u32::MAX)),
        false => {
            let text = format!("the script has more than {MAX_STATEMENTS} statements");
            Err(DeviceError::syntax(at, text))
        }
    }
}

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
                format!("the attachment `{name}` must be bytes"),
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
    pub(crate) statements: Vec<Statement<A>>,
    /// Bytes that came with it.
    pub(crate) attached: usize,
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
}

/// The script of a command's content, and the bytes that came with it.
pub(crate) fn script_of<'a>(
    name: &str,
    content: Option<&'a Value>,
) -> Result<(&'a str, Attachments), DeviceError> {
    let plain = content.and_then(Value::as_str).map(|script| (script, None));
    let with = || {
        let content = content?;
        Some((content.get("script")?.as_str()?, content.get("attachments")))
    };
    let (script, attachments) = plain.or_else(with).ok_or_else(|| {
        let text =
            format!("the content of a command is a string, the script of {name}, or {{script, attachments}}");
        DeviceError::new(ErrorName::Syntax, text)
    })?;
    let attachments = match attachments {
        None => Attachments::default(),
        Some(Value::Map(map)) => Attachments::of(map)?,
        Some(_) => {
            let text = "attachments are a map of names to bytes";
            return Err(DeviceError::new(ErrorName::Syntax, text));
        }
    };
    Ok((script, attachments))
}
