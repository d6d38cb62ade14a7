//! Tables of commands from the text of a TOML file: the paper's four, and those that it lists.
//!
//! ```toml
#![doc = include_str!("../commands.toml")]
//! ```
//!
//! That is [`EXTENDED`], what our own robots understand.

use std::borrow::ToOwned;
use std::boxed::Box;
use std::fmt;
use std::format;
use std::ops::Range;
use std::string::{String, ToString};
use std::sync::LazyLock;
use std::vec::Vec;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::MOST;
use crate::number::{HIGHEST, LOWEST};
use crate::table::{Code, Command, PAPER, Parameter, Table, is_range, is_word};

/// The commands of our own robots, as text: the crate's `commands.toml`.
pub const EXTENDED_TEXT: &str = include_str!("../commands.toml");

/// The paper's commands and those of our own robots: GOTO, VIA (W17), POSE and HOLDER.
pub static EXTENDED: LazyLock<&'static Table> =
    LazyLock::new(|| table(EXTENDED_TEXT).expect("a test reads the crate's own commands"));

/// What is wrong in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FileFault {
    /// It is no TOML.
    Syntax,
    /// Nobody knows this key.
    UnknownKey,
    /// A key is missing.
    MissingKey,
    /// A value is of another type than its key's.
    Type,
    /// A code is not between 0 and 99.
    Code,
    /// Two commands of the file have this code.
    CodeTwice,
    /// A command of the paper has this code or this name.
    OfPaper,
    /// A name is no word: lower-case letters, digits and `-`, a letter first.
    Name,
    /// Two commands of the file, or two parameters of one frame, have this name.
    NameTwice,
    /// A command or a reply has more than eight parameters.
    TooMany,
    /// A range is empty, or goes beyond what `%05d` holds.
    Range,
    /// A command that is only a reply has none, or has parameters.
    ReplyOnly,
}

/// What is wrong in a file, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileError {
    fault: FileFault,
    line: usize,
    column: usize,
    text: String,
}

impl FileError {
    /// What kind of fault it is.
    #[must_use]
    pub const fn fault(&self) -> FileFault {
        self.fault
    }

    /// The line and the column, in characters, at which it is; 1 for the first.
    #[must_use]
    pub const fn place(&self) -> (usize, usize) {
        (self.line, self.column)
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, column {}: {}", self.line, self.column, self.text)
    }
}

impl std::error::Error for FileError {}

/// The table of a file's text: the paper's four commands and those of the file.
///
/// The table stays until the program ends, whatever becomes of it: call this once, at the program's start.
///
/// ```
/// use mom_brs::file;
///
/// let table = file::table("[[command]]\ncode = 20\nname = \"beep\"\n")?;
/// assert!(table.command("beep").is_some() && table.command("motor").is_some());
///
/// let error = file::table("[[command]]\ncode = 20\nnane = \"beep\"\n").unwrap_err();
/// assert_eq!(error.to_string(), "line 3, column 1: there is no key `nane`; did you mean `name`?");
/// # Ok::<(), file::FileError>(())
/// ```
///
/// # Errors
///
/// The first fault, and its place. Then nothing of the file is taken.
pub fn table(text: &str) -> Result<&'static Table, FileError> {
    let listed = read(text).map_err(|found| found.at(text))?;
    // Leaked, so that frames, parsers and tables hold plain `'static` references with a file as without one, on a
    // microcontroller, where tables are constants. A program reads its table once, and needs it until it ends.
    let commands: Vec<Command> = PAPER
        .commands()
        .iter()
        .copied()
        .chain(listed.into_iter().map(Listed::leak))
        .collect();
    let table = Table::new(commands.leak()).map_err(|fault| {
        // All that a table refuses was refused above, with its place.
        Found::new(FileFault::Syntax, 0..0, fault.to_string()).at(text)
    })?;
    Ok(Box::leak(Box::new(table)))
}

/// A fault at bytes of the text.
struct Found {
    fault: FileFault,
    span: Range<usize>,
    text: String,
}

impl Found {
    fn new(fault: FileFault, span: Range<usize>, text: String) -> Found {
        Found { fault, span, text }
    }

    fn at(self, text: &str) -> FileError {
        let before = text.get(..self.span.start).unwrap_or(text);
        let line_start = before.rfind('\n').map_or(0, |end| end + 1);
        FileError {
            fault: self.fault,
            line: before.matches('\n').count() + 1,
            column: before
                .get(line_start..)
                .map_or(1, |start| start.chars().count() + 1),
            text: self.text,
        }
    }
}

/// A command as the file lists it.
struct Listed {
    code: Code,
    name: String,
    parameters: Option<Vec<ListedParameter>>,
    reply: Option<Vec<ListedParameter>>,
}

struct ListedParameter {
    name: String,
    min: i32,
    max: i32,
}

impl Listed {
    fn leak(self) -> Command {
        Command {
            code: self.code,
            name: self.name.leak(),
            parameters: self.parameters.map(leak_parameters),
            reply: self.reply.map(leak_parameters),
        }
    }
}

fn leak_parameters(parameters: Vec<ListedParameter>) -> &'static [Parameter] {
    let leak =
        |parameter: ListedParameter| Parameter::new(parameter.name.leak(), parameter.min, parameter.max);
    let parameters: Vec<Parameter> = parameters.into_iter().map(leak).collect();
    parameters.leak()
}

type Value<'i> = Spanned<DeValue<'i>>;

fn read(text: &str) -> Result<Vec<Listed>, Found> {
    let root = DeTable::parse(text).map_err(|error| {
        let span = error.span().unwrap_or(0..0);
        Found::new(FileFault::Syntax, span, error.message().to_owned())
    })?;
    let root = Keys::new(root.get_ref(), root.span(), &["command"])?;
    let mut listed: Vec<Listed> = Vec::new();
    for value in root.list("command")?.unwrap_or_default() {
        let command = read_command(value, &listed)?;
        listed.push(command);
    }
    Ok(listed)
}

fn read_command(value: &Value<'_>, before: &[Listed]) -> Result<Listed, Found> {
    let keys = Keys::of(value, &["code", "name", "parameters", "reply", "reply-only"])?;
    let code = read_code(&keys, before)?;
    let (name, span) = keys.word("name")?;
    if PAPER.command(&name).is_some() {
        let text = format!("`{name}` is a command of the paper, which every table has");
        return Err(Found::new(FileFault::OfPaper, span, text));
    }
    if before.iter().any(|other| other.name == name) {
        let text = format!("two commands have the name `{name}`");
        return Err(Found::new(FileFault::NameTwice, span, text));
    }
    let parameters = keys.parameters("parameters")?;
    let reply = keys.parameters("reply")?;
    let reply_only = keys.flag("reply-only")?;
    let parameters = match (reply_only, parameters) {
        (Some(span), Some(_)) => {
            let text = format!("`{name}` cannot have parameters: base stations never say what is reply-only");
            return Err(Found::new(FileFault::ReplyOnly, span, text));
        }
        (Some(span), None) if reply.is_none() => {
            let text = format!("`{name}` is reply-only and has no `reply`");
            return Err(Found::new(FileFault::ReplyOnly, span, text));
        }
        (Some(_), None) => None,
        (None, parameters) => Some(parameters.unwrap_or_default()),
    };
    Ok(Listed {
        code,
        name,
        parameters,
        reply,
    })
}

fn read_code(keys: &Keys<'_, '_>, before: &[Listed]) -> Result<Code, Found> {
    let (number, span) = keys.integer("code")?;
    let Some(code) = u8::try_from(number).ok().and_then(Code::new) else {
        let text = format!("{number} is no code: it has two digits, 0 to 99");
        return Err(Found::new(FileFault::Code, span, text));
    };
    if let Some(command) = PAPER.get(code) {
        let text = format!("{code} is `{}` of the paper, which every table has", command.name);
        return Err(Found::new(FileFault::OfPaper, span, text));
    }
    if let Some(other) = before.iter().find(|other| other.code == code) {
        let text = format!("{code} is the code of `{}` already", other.name);
        return Err(Found::new(FileFault::CodeTwice, span, text));
    }
    Ok(code)
}

fn read_parameter(value: &Value<'_>, before: &[ListedParameter]) -> Result<ListedParameter, Found> {
    let keys = Keys::of(value, &["name", "min", "max"])?;
    let (name, span) = keys.word("name")?;
    if before.iter().any(|other| other.name == name) {
        let text = format!("two parameters have the name `{name}`");
        return Err(Found::new(FileFault::NameTwice, span, text));
    }
    let (min, span) = keys.integer("min")?;
    let (max, _) = keys.integer("max")?;
    match (i32::try_from(min), i32::try_from(max)) {
        (Ok(min), Ok(max)) if is_range(min, max) => Ok(ListedParameter { name, min, max }),
        _ if min > max => {
            let text = format!("`{name}` can have no value: min {min} is more than max {max}");
            Err(Found::new(FileFault::Range, span, text))
        }
        _ => {
            let text = format!(
                "five characters cannot hold all of `{name}`: {min} to {max} is not within {LOWEST} to {HIGHEST}"
            );
            Err(Found::new(FileFault::Range, span, text))
        }
    }
}

/// A table of the file whose keys are all known.
struct Keys<'v, 'i> {
    table: &'v DeTable<'i>,
    span: Range<usize>,
}

impl<'v, 'i> Keys<'v, 'i> {
    fn of(value: &'v Value<'i>, known: &[&str]) -> Result<Keys<'v, 'i>, Found> {
        let table = value.get_ref().as_table();
        let table = table.ok_or_else(|| wrong_type(value, "a table"))?;
        Keys::new(table, value.span(), known)
    }

    fn new(table: &'v DeTable<'i>, span: Range<usize>, known: &[&str]) -> Result<Keys<'v, 'i>, Found> {
        for key in table.keys() {
            let word = key.get_ref().as_ref();
            if !known.contains(&word) {
                let hint = match nearest(word, known) {
                    Some(nearest) => format!("did you mean `{nearest}`?"),
                    None => format!("the keys here are `{}`", known.join("`, `")),
                };
                let text = format!("there is no key `{word}`; {hint}");
                return Err(Found::new(FileFault::UnknownKey, key.span(), text));
            }
        }
        Ok(Keys { table, span })
    }

    fn required(&self, key: &str) -> Result<&'v Value<'i>, Found> {
        let missing = || {
            Found::new(
                FileFault::MissingKey,
                self.span.clone(),
                format!("`{key}` is missing"),
            )
        };
        self.table.get(key).ok_or_else(missing)
    }

    fn integer(&self, key: &str) -> Result<(i64, Range<usize>), Found> {
        let value = self.required(key)?;
        let number = value.get_ref().as_integer();
        let number = number.ok_or_else(|| wrong_type(value, "an integer"))?;
        // What an i64 cannot hold is out of every range; which side is all that matters.
        let end = if number.as_str().starts_with('-') {
            i64::MIN
        } else {
            i64::MAX
        };
        let number = i64::from_str_radix(number.as_str(), number.radix()).unwrap_or(end);
        Ok((number, value.span()))
    }

    fn word(&self, key: &str) -> Result<(String, Range<usize>), Found> {
        let value = self.required(key)?;
        let word = value
            .get_ref()
            .as_str()
            .ok_or_else(|| wrong_type(value, "a text"))?;
        if !is_word(word) {
            let text = format!("{word:?} is no word: lower-case letters, digits and `-`, a letter first");
            return Err(Found::new(FileFault::Name, value.span(), text));
        }
        Ok((word.to_owned(), value.span()))
    }

    /// Where a key is set to true.
    fn flag(&self, key: &str) -> Result<Option<Range<usize>>, Found> {
        let Some(value) = self.table.get(key) else {
            return Ok(None);
        };
        match value.get_ref().as_bool() {
            Some(true) => Ok(Some(value.span())),
            Some(false) => Ok(None),
            None => Err(wrong_type(value, "true or false")),
        }
    }

    fn list(&self, key: &str) -> Result<Option<&'v [Value<'i>]>, Found> {
        let Some(value) = self.table.get(key) else {
            return Ok(None);
        };
        let list = value.get_ref().as_array();
        let list = list.ok_or_else(|| wrong_type(value, "a list of tables"))?;
        Ok(Some(list))
    }

    fn parameters(&self, key: &str) -> Result<Option<Vec<ListedParameter>>, Found> {
        let Some(list) = self.list(key)? else {
            return Ok(None);
        };
        if let Some(ninth) = list.get(MOST) {
            let text = format!("{} parameters are too many: there may be {MOST}", list.len());
            return Err(Found::new(FileFault::TooMany, ninth.span(), text));
        }
        let mut parameters: Vec<ListedParameter> = Vec::new();
        for value in list {
            let parameter = read_parameter(value, &parameters)?;
            parameters.push(parameter);
        }
        Ok(Some(parameters))
    }
}

fn wrong_type(value: &Value<'_>, expected: &str) -> Found {
    let given = value.get_ref().type_str();
    let text = format!("{expected} is expected here, and this is of type {given}");
    Found::new(FileFault::Type, value.span(), text)
}

/// The known key that is similar enough to be meant.
fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    // The cost grows with the square of the length.
    const LONGEST_WORD: usize = 64;
    if word.len() > LONGEST_WORD {
        return None;
    }
    let allowed = (word.chars().count() / 3).max(1);
    known
        .iter()
        .map(|known| (strsim::osa_distance(word, known), *known))
        .filter(|(distance, _)| *distance <= allowed)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, known)| known)
}
