//! From text to steps.

use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

use mom_brs::{Code, Command, Frame, Parameter, Table};
use mom_toml_faults::{Spot, quoted, unknown};

use super::{DEEPEST, LONGEST, MOST_BYTES, MOST_STEPS, REPLY_WITHIN, ScriptFault, Step};
use crate::fleet::Unit;

const KEYWORDS: [&str; 5] = ["all", "wait", "repeat", "end", "on"];

/// The longest wait of one statement, in ms.
const LONGEST_WAIT: u64 = 3_600_000;

type Found = mom_toml_faults::Found<ScriptFault>;

fn found<T>(fault: ScriptFault, at: usize, text: impl Into<String>) -> Result<T, Found> {
    Err(Found::new(fault, &(at..at), text))
}

/// A word and the byte at which it begins.
#[derive(Clone, Copy)]
struct Word<'t> {
    text: &'t str,
    at: usize,
}

impl Word<'_> {
    fn is(&self, keyword: &str) -> bool {
        self.text.eq_ignore_ascii_case(keyword)
    }
}

/// The words of one statement, taken one by one.
struct Words<'t> {
    words: std::vec::IntoIter<Word<'t>>,
    /// Where the last word that was taken ends: what is missing is missing here.
    end: usize,
}

impl<'t> Words<'t> {
    fn next(&mut self) -> Option<Word<'t>> {
        let word = self.words.next()?;
        self.end = word.at + word.text.len();
        Some(word)
    }

    fn required(&mut self, what: &str) -> Result<Word<'t>, Found> {
        let end = self.end;
        match self.next() {
            Some(word) => Ok(word),
            None => found(ScriptFault::Missing, end, format!("{what} is missing")),
        }
    }

    fn done(mut self) -> Result<(), Found> {
        match self.next() {
            None => Ok(()),
            Some(word) => found(
                ScriptFault::TooMuch,
                word.at,
                format!(
                    "the statement ends before `{}`; the next one is on a line of its own or after `;`",
                    quoted(word.text)
                ),
            ),
        }
    }
}

/// A repetition that has no end yet; the outermost is the script itself.
struct Open {
    at: usize,
    count: u64,
    /// The first step within.
    first: usize,
    steps: u64,
    micros: i64,
}

struct Reader<'a> {
    text: &'a str,
    known: &'a [Unit],
    table: &'static Table,
    names: Vec<&'static str>,
    /// What lists of units mean: a script says the same ones again and again.
    lists: HashMap<&'a str, Arc<[Unit]>>,
    steps: Vec<Step>,
    open: Vec<Open>,
}

pub(super) fn steps(text: &str, known: &[Unit], table: &'static Table) -> Result<Vec<Step>, Found> {
    if text.len() > MOST_BYTES {
        let text = format!("{} bytes exceed the limit of {MOST_BYTES}", text.len());
        return found(ScriptFault::TooLong, 0, text);
    }
    let said = |command: &&Command| !command.is_reply_only();
    let mut known = known.to_vec();
    known.sort_unstable();
    known.dedup();
    let mut reader = Reader {
        text,
        known: &known,
        table,
        names: table
            .commands()
            .iter()
            .filter(said)
            .map(|command| command.name)
            .collect(),
        lists: HashMap::new(),
        steps: Vec::new(),
        open: vec![Open {
            at: 0,
            count: 1,
            first: 0,
            steps: 0,
            micros: 0,
        }],
    };
    for statement in statements(text) {
        reader.statement(statement)?;
    }
    match reader.open.as_slice() {
        [_, .., unclosed] => found(ScriptFault::Nesting, unclosed.at, "this `repeat` has no `end`"),
        _ => Ok(reader.steps),
    }
}

/// The statements that are not empty.
fn statements(text: &str) -> impl Iterator<Item = Words<'_>> {
    let offset = |part: &str| part.as_ptr() as usize - text.as_ptr() as usize;
    text.lines()
        .map(|line| line.split('#').next().unwrap_or_default())
        .flat_map(|line| line.split(';'))
        .filter_map(move |statement| {
            let words: Vec<Word<'_>> = statement
                .split_whitespace()
                .map(|text| Word {
                    text,
                    at: offset(text),
                })
                .collect();
            let end = words.first()?.at;
            let words = words.into_iter();
            Some(Words { words, end })
        })
}

impl<'a> Reader<'a> {
    fn statement(&mut self, mut words: Words<'a>) -> Result<(), Found> {
        let Some(first) = words.next() else { return Ok(()) };
        if first.is("wait") {
            let what = format!("how long, in ms, 0 to {LONGEST_WAIT},");
            let millis = whole(&mut words, &what, 0, LONGEST_WAIT)?;
            let micros = i64::try_from(millis * 1000).unwrap_or(i64::MAX);
            self.add(first.at, 1, micros, [Step::Wait { micros }])?;
        } else if first.is("repeat") {
            self.repeat(first.at, &mut words)?;
        } else if first.is("end") {
            self.end(first.at)?;
        } else if first.is("on") {
            self.on(first.at, &mut words)?;
        } else {
            let units = self.units(first)?;
            let command = words.required("the command, such as `motor`,")?;
            if command.is("to") {
                self.to(first.at, &units, &mut words)?;
            } else {
                let entry = self.command(command)?;
                let frame = frame(entry, command.at, &mut words)?;
                self.send(first.at, &units, [frame])?;
            }
        }
        words.done()
    }

    fn repeat(&mut self, at: usize, words: &mut Words<'a>) -> Result<(), Found> {
        let what = format!("how often, 1 to {MOST_STEPS},");
        let count = whole(words, &what, 1, MOST_STEPS)?;
        if self.open.len() > DEEPEST {
            let text = format!("`repeat` may be nested at most {DEEPEST} deep");
            return found(ScriptFault::Nesting, at, text);
        }
        self.steps.push(Step::Repeat { count });
        self.open.push(Open {
            at,
            count,
            first: self.steps.len(),
            steps: 1,
            micros: 0,
        });
        Ok(())
    }

    fn end(&mut self, at: usize) -> Result<(), Found> {
        let closed = match self.open.len() {
            0 | 1 => None,
            _ => self.open.pop(),
        };
        let Some(closed) = closed else {
            return found(ScriptFault::Nesting, at, "`end` without `repeat`");
        };
        let steps = closed.steps.saturating_mul(closed.count);
        let count = i64::try_from(closed.count).unwrap_or(i64::MAX);
        let micros = closed.micros.saturating_mul(count);
        self.add(closed.at, steps, micros, [Step::End { first: closed.first }])
    }

    fn on(&mut self, at: usize, words: &mut Words<'a>) -> Result<(), Found> {
        let unit = words.required("the unit")?;
        let unit = self.unit(unit.text, unit.at)?;
        let reply = words.required("`reply`")?;
        if !reply.is("reply") {
            let text = format!("`reply` is expected, and this is `{}`", quoted(reply.text));
            return found(ScriptFault::UnknownWord, reply.at, text);
        }
        let word = words.required("the command whose reply it is")?;
        let command = self.any_command(word)?;
        if command.reply.is_none() {
            let text = format!("robots do not reply to `{}`", command.name);
            return found(ScriptFault::NoReply, word.at, text);
        }
        let spot = Spot::of(self.text, at);
        let code = command.code;
        self.add(at, 1, REPLY_WITHIN, [Step::Reply { unit, code, spot }])
    }

    /// `to X Y via X Y via X Y`: the places after `via` come first, in their order.
    fn to(&mut self, at: usize, units: &Arc<[Unit]>, words: &mut Words<'a>) -> Result<(), Found> {
        let of = |code| self.table.get(code).filter(|command| has_place(command));
        let (Some(goto), Some(via)) = (of(Code::GOTO), of(Code::VIA)) else {
            let text = "the table has no GOTO and VIA with two values each, which `to` stands for";
            return found(ScriptFault::NoCommand, at, text);
        };
        let mut places = Vec::new();
        let last = place(goto, words)?;
        while let Some(word) = words.next() {
            if !word.is("via") {
                let text = format!("`via` is expected, and this is `{}`", quoted(word.text));
                return found(ScriptFault::UnknownWord, word.at, text);
            }
            places.push(place(goto, words)?);
        }
        places.push(last);
        let mut frames = Vec::with_capacity(places.len());
        for (index, values) in places.iter().enumerate() {
            let command = if index == 0 { goto } else { via };
            match Frame::new(command, values) {
                Ok(frame) => frames.push(frame),
                Err(fault) => return found(ScriptFault::NoCommand, at, fault.to_string()),
            }
        }
        self.send(at, units, frames)
    }

    fn command(&self, word: Word<'_>) -> Result<&'static Command, Found> {
        let command = self.any_command(word)?;
        if command.is_reply_only() {
            let text = format!("`{}` is sent by robots only", command.name);
            return found(ScriptFault::NoCommand, word.at, text);
        }
        Ok(command)
    }

    fn any_command(&self, word: Word<'_>) -> Result<&'static Command, Found> {
        match self.table.command(word.text) {
            Some(command) => Ok(command),
            None => {
                let names: Vec<&str> = self.names.iter().copied().chain(["to"]).collect();
                let text = unknown("command", word.text, &names);
                found(ScriptFault::UnknownWord, word.at, text)
            }
        }
    }

    /// `all`, `1`, `1,3-5`.
    fn units(&mut self, word: Word<'a>) -> Result<Arc<[Unit]>, Found> {
        if let Some(units) = self.lists.get(word.text) {
            return Ok(Arc::clone(units));
        }
        let mut units = BTreeSet::new();
        if word.is("all") {
            units.extend(self.known);
        } else if word.text.starts_with(|c: char| c.is_ascii_digit()) {
            let mut at = word.at;
            for part in word.text.split(',') {
                let (first, last) = match part.split_once('-') {
                    Some((first, last)) => (self.unit(first, at)?, self.unit(last, at + first.len() + 1)?),
                    None => (self.unit(part, at)?, self.unit(part, at)?),
                };
                if first > last {
                    let text = format!("the range {first}-{last} is the wrong way round");
                    return found(ScriptFault::Unit, at, text);
                }
                for unit in first..=last {
                    if self.known.binary_search(&unit).is_err() {
                        let text = format!("there is no unit {unit} in the fleet");
                        return found(ScriptFault::Unit, at, text);
                    }
                }
                units.extend(first..=last);
                at += part.len() + 1;
            }
        } else {
            let shown = quoted(word.text);
            let text = match self.table.command(word.text) {
                Some(_) => format!("the unit is missing before `{shown}`, as in `1 {shown}`"),
                None => unknown("statement", word.text, &KEYWORDS),
            };
            return found(ScriptFault::UnknownWord, word.at, text);
        }
        let units: Arc<[Unit]> = units.into_iter().collect();
        self.lists.insert(word.text, Arc::clone(&units));
        Ok(units)
    }

    fn unit(&self, text: &str, at: usize) -> Result<Unit, Found> {
        let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        match text.parse::<Unit>() {
            Ok(unit) if digits && self.known.binary_search(&unit).is_ok() => Ok(unit),
            _ if digits => {
                let text = format!("there is no unit {} in the fleet", quoted(text));
                found(ScriptFault::Unit, at, text)
            }
            _ => {
                let text = format!("`{}` is not a unit number; units are written 1,3-5", quoted(text));
                found(ScriptFault::Unit, at, text)
            }
        }
    }

    fn send(
        &mut self,
        at: usize,
        units: &Arc<[Unit]>,
        frames: impl IntoIterator<Item = Frame>,
    ) -> Result<(), Found> {
        for frame in frames {
            let units = Arc::clone(units);
            let count = u64::try_from(units.len()).unwrap_or(u64::MAX);
            self.add(at, count, 0, [Step::Send { units, frame }])?;
        }
        Ok(())
    }

    fn add(&mut self, at: usize, steps: u64, micros: i64, add: [Step; 1]) -> Result<(), Found> {
        if let Some(open) = self.open.last_mut() {
            open.steps = open.steps.saturating_add(steps);
            open.micros = open.micros.saturating_add(micros);
            if open.steps > MOST_STEPS {
                let text = format!("the script has more than {MOST_STEPS} steps here, counting repetitions");
                return found(ScriptFault::TooLong, at, text);
            }
            if open.micros > LONGEST {
                let text = "up to here it would wait for more than a day";
                return found(ScriptFault::TooLong, at, text);
            }
        }
        self.steps.extend(add);
        Ok(())
    }
}

fn has_place(command: &Command) -> bool {
    command.parameters.is_some_and(|parameters| parameters.len() == 2)
}

fn place(goto: &'static Command, words: &mut Words<'_>) -> Result<[i32; 2], Found> {
    let mut values = [0; 2];
    for (value, parameter) in values.iter_mut().zip(goto.parameters.unwrap_or_default()) {
        *value = read_value(parameter, words)?;
    }
    Ok(values)
}

fn frame(command: &'static Command, at: usize, words: &mut Words<'_>) -> Result<Frame, Found> {
    let mut values = Vec::new();
    for parameter in command.parameters.unwrap_or_default() {
        values.push(read_value(parameter, words)?);
    }
    Frame::new(command, &values).or_else(|fault| found(ScriptFault::NoCommand, at, fault.to_string()))
}

/// A value that the parameter can have. The wire would clamp it; here the author can still correct it.
fn read_value(parameter: &Parameter, words: &mut Words<'_>) -> Result<i32, Found> {
    let Parameter { name, min, max } = parameter;
    let word = words.required(&format!("the value of `{name}`, {min} to {max},"))?;
    let shown = quoted(word.text);
    match word.text.parse::<i32>() {
        Ok(value) if (*min..=*max).contains(&value) => Ok(value),
        Ok(_) => found(
            ScriptFault::Value,
            word.at,
            format!("`{name}` is {min} to {max}, not {shown}"),
        ),
        Err(_) => {
            let text = format!("`{name}` is a whole number from {min} to {max}, not `{shown}`");
            found(ScriptFault::Value, word.at, text)
        }
    }
}

fn whole(words: &mut Words<'_>, what: &str, min: u64, max: u64) -> Result<u64, Found> {
    let word = words.required(what)?;
    match word.text.parse::<u64>() {
        Ok(number) if (min..=max).contains(&number) => Ok(number),
        _ => {
            let text = format!(
                "a whole number from {min} to {max} is expected, not `{}`",
                quoted(word.text)
            );
            found(ScriptFault::Value, word.at, text)
        }
    }
}
