//! Tables of commands from the text of a TOML file: the paper's four, and those that it lists.
//!
//! ```toml
#![doc = include_str!("../commands.toml")]
//! ```
//!
//! That is [`EXTENDED`], what our own robots understand.

use std::borrow::ToOwned;
use std::boxed::Box;
use std::format;
use std::ops::Range;
use std::string::{String, ToString};
use std::sync::LazyLock;
use std::vec::Vec;

use mom_toml_faults::{At, Item, Section, Shape};

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
    /// It is not TOML.
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
    /// A name is not a word: lower-case letters, digits and `-`, a letter first.
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
pub type FileError = mom_toml_faults::FileError<FileFault>;

impl From<Shape> for FileFault {
    fn from(shape: Shape) -> FileFault {
        match shape {
            Shape::Syntax => FileFault::Syntax,
            Shape::UnknownKey => FileFault::UnknownKey,
            Shape::MissingKey => FileFault::MissingKey,
            Shape::Type => FileFault::Type,
        }
    }
}

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
        Found::new(FileFault::Syntax, &(0..0), fault.to_string()).at(text)
    })?;
    Ok(Box::leak(Box::new(table)))
}

type Found = mom_toml_faults::Found<FileFault>;

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

fn read(text: &str) -> Result<Vec<Listed>, Found> {
    let root = Section::parse(text)?;
    let mut listed: Vec<Listed> = Vec::new();
    for keys in root.only(&["command"])?.tables("command")? {
        let command = read_command(keys, &listed)?;
        listed.push(command);
    }
    Ok(listed)
}

fn read_command(keys: &Section, before: &[Listed]) -> Result<Listed, Found> {
    keys.only(&["code", "name", "parameters", "reply", "reply-only"])?;
    let code = read_code(keys.required("code")?, before)?;
    let (name, span) = word(keys, "name")?;
    if PAPER.command(&name).is_some() {
        let text = format!("`{name}` is a command of the paper, which every table has");
        return Err(Found::new(FileFault::OfPaper, span, text));
    }
    if before.iter().any(|other| other.name == name) {
        let text = format!("two commands have the name `{name}`");
        return Err(Found::new(FileFault::NameTwice, span, text));
    }
    let listed = parameters(keys, "parameters")?;
    let reply = parameters(keys, "reply")?;
    let reply_only = set(keys, "reply-only")?;
    let parameters = match (reply_only, listed) {
        (Some(span), Some(_)) => {
            let text = format!("`{name}` cannot have parameters: base stations never say what is reply-only");
            return Err(Found::new(FileFault::ReplyOnly, span, text));
        }
        (Some(span), None) if reply.is_none() => {
            let text = format!("`{name}` is reply-only and has no `reply`");
            return Err(Found::new(FileFault::ReplyOnly, span, text));
        }
        (Some(_), None) => None,
        (None, listed) => Some(listed.unwrap_or_default()),
    };
    Ok(Listed {
        code,
        name,
        parameters,
        reply,
    })
}

fn read_code(value: &At<Item>, before: &[Listed]) -> Result<Code, Found> {
    let (number, span) = (value.integer()?, &value.span);
    let Some(code) = u8::try_from(number).ok().and_then(Code::new) else {
        let text = format!("{number} is not a code: it has two digits, 0 to 99");
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

fn read_parameter(keys: &Section, before: &[ListedParameter]) -> Result<ListedParameter, Found> {
    keys.only(&["name", "min", "max"])?;
    let (name, span) = word(keys, "name")?;
    if before.iter().any(|other| other.name == name) {
        let text = format!("two parameters have the name `{name}`");
        return Err(Found::new(FileFault::NameTwice, span, text));
    }
    let least = keys.required("min")?;
    let (min, span) = (least.integer()?, &least.span);
    let max = keys.required("max")?.integer()?;
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

fn word<'k>(keys: &'k Section, key: &str) -> Result<(String, &'k Range<usize>), Found> {
    let value = keys.required(key)?;
    let word = value.text()?;
    if !is_word(word) {
        let text = format!("{word:?} is not a word: lower-case letters, digits and `-`, a letter first");
        return Err(Found::new(FileFault::Name, &value.span, text));
    }
    Ok((word.to_owned(), &value.span))
}

/// Where a key is set to true.
fn set<'k>(keys: &'k Section, key: &str) -> Result<Option<&'k Range<usize>>, Found> {
    match keys.get(key) {
        Some(value) => Ok(value.flag()?.then_some(&value.span)),
        None => Ok(None),
    }
}

fn parameters(keys: &Section, key: &str) -> Result<Option<Vec<ListedParameter>>, Found> {
    let Some(value) = keys.get(key) else {
        return Ok(None);
    };
    let list = value.list("a list of tables")?;
    if let Some(ninth) = list.get(MOST) {
        let text = format!("{} parameters are too many: there may be {MOST}", list.len());
        return Err(Found::new(FileFault::TooMany, &ninth.span, text));
    }
    let mut parameters: Vec<ListedParameter> = Vec::new();
    for value in list {
        let parameter = read_parameter(value.table()?, &parameters)?;
        parameters.push(parameter);
    }
    Ok(Some(parameters))
}
