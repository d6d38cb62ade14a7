//! What robots are to do: side by side, and then what comes after all of them.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::Path;

use mom_device::{DeviceError, Script};
use mom_drive::VerbFailure;
use mom_wheeled::Action;

use super::units::{Known, Units};
use crate::Unit;

/// A line at which robots wait for each other.
const BARRIER: &str = "---";
/// The largest file, in bytes.
const MOST: u64 = 1 << 20;

/// Steps as they were written.
#[derive(Debug)]
pub(super) struct Steps(Vec<Vec<ScriptLine>>);

#[derive(Debug)]
struct ScriptLine {
    /// Where it stands, for errors: `formation.txt:3`.
    at: String,
    units: Units,
    script: String,
}

/// What each robot does in each step, one script after the other.
pub(super) type Work = Vec<BTreeMap<u32, Vec<String>>>;

impl Steps {
    /// One script for some robots.
    pub(super) fn one(units: &str, script: &str) -> Result<Self, VerbFailure> {
        let line = line("", units, 0, script)?;
        Ok(Self(vec![vec![line]]))
    }

    /// Those of a file.
    pub(super) fn read(file: &Path) -> Result<Self, VerbFailure> {
        let (name, text) = text(file)?;
        Self::parse(&name, &text)
    }

    fn parse(name: &str, text: &str) -> Result<Self, VerbFailure> {
        let mut steps = vec![Vec::new()];
        for (code, number) in text.lines().zip(1..) {
            let written = code.split_once('#').map_or(code, |(code, _comment)| code);
            let at = format!("{name}:{number}");
            match written.trim() {
                "" => {}
                BARRIER => steps.push(Vec::new()),
                other => match written.split_once(':') {
                    Some((units, script)) => {
                        let column = units.chars().count() + 1;
                        if let Some(step) = steps.last_mut() {
                            step.push(line(&at, units, column, script)?);
                        }
                    }
                    None => {
                        let text = format!(
                            "{at}:1: `{other}` names no robots; a line is such as `1-3: goto 1000 1000`"
                        );
                        return Err(VerbFailure::new(text, "mom fleet run --help shows a file"));
                    }
                },
            }
        }
        steps.retain(|step| !step.is_empty());
        match steps.is_empty() {
            true => Err(VerbFailure::plain(format!("{name} has nothing to be done"))),
            false => Ok(Self(steps)),
        }
    }

    /// Whether it takes more than numbers to know which robots are meant.
    pub(super) fn has_groups(&self) -> bool {
        self.0.iter().flatten().any(|line| line.units.has_groups())
    }

    /// What that is for the robots that are there.
    pub(super) fn of(self, known: &Known) -> Result<Work, VerbFailure> {
        let mut work = Work::new();
        for step in self.0 {
            let mut scripts: BTreeMap<u32, Vec<String>> = BTreeMap::new();
            for line in step {
                let units = line.units.of(known).map_err(|missing| {
                    let at = colon(&line.at);
                    VerbFailure::new(format!("{at}{missing}"), "see which there are: mom fleet list")
                })?;
                for unit in units {
                    scripts.entry(unit).or_default().push(line.script.clone());
                }
            }
            work.push(scripts);
        }
        Ok(work)
    }
}

/// A file's name in words, and its text; - is the standard input.
pub(super) fn text(file: &Path) -> Result<(String, String), VerbFailure> {
    let mut text = String::new();
    let read = match file.to_str() {
        Some("-") => std::io::stdin().take(MOST).read_to_string(&mut text),
        _ => std::fs::File::open(file).and_then(|open| open.take(MOST).read_to_string(&mut text)),
    };
    let name = match file.to_str() {
        Some("-") => "standard input".to_owned(),
        _ => file.display().to_string(),
    };
    read.map_err(|error| VerbFailure::plain(format!("{name}: {error}")))?;
    Ok((name, text))
}

/// A line whose script can be read; `column` characters stand before that.
fn line(at: &str, units: &str, column: usize, script: &str) -> Result<ScriptLine, VerbFailure> {
    let mistake = |text: String| VerbFailure::new(text, "mom fleet send --help lists the statements");
    let units = Units::parse(units).map_err(|error| mistake(format!("{}{error}", colon(at))))?;
    check(script).map_err(|error| {
        let place = match (at, error.place()) {
            ("", Some((_, at))) => format!("column {at}: "),
            (_, Some((_, within))) => format!("{at}:{}: ", column + within as usize),
            (_, None) => colon(at),
        };
        mistake(format!("{place}{error}"))
    })?;
    Ok(ScriptLine {
        at: at.to_owned(),
        units,
        script: script.trim().to_owned(),
    })
}

/// Whether a script is one of a fleet's robots. One with a verb of models is for its robot to judge.
fn check(script: &str) -> Result<(), DeviceError> {
    let verbs = script
        .split(['\n', ';'])
        .filter_map(|statement| statement.split_whitespace().next());
    let mut of_models = verbs.filter(|verb| Action::OF_MODELS.contains(verb));
    match of_models.next() {
        Some(_) => Ok(()),
        None => Script::read::<Unit>(script).map(drop),
    }
}

fn colon(at: &str) -> String {
    match at {
        "" => String::new(),
        at => format!("{at}: "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known() -> Known {
        Known {
            units: (1..=4).collect(),
            groups: [("pair".to_owned(), [1, 2].into())].into(),
        }
    }

    #[test]
    fn robots_work_side_by_side_between_barriers() {
        let text = "# to the line\npair: goto 1 2\n2: leds 1; wait 5\n\n---\nall: leds 0 # dark\n---\n";
        let steps = Steps::parse("f", text).expect("it is right");
        assert!(steps.has_groups());
        let work = steps.of(&known()).expect("they are there");
        let scripts = |of: &[&str]| of.iter().map(|script| (*script).to_owned()).collect::<Vec<_>>();
        assert_eq!(work.len(), 2);
        assert_eq!(
            work[0],
            [
                (1, scripts(&["goto 1 2"])),
                (2, scripts(&["goto 1 2", "leds 1; wait 5"]))
            ]
            .into()
        );
        assert_eq!(work[1].len(), 4);
    }

    #[test]
    fn mistakes_are_told_with_line_and_column() {
        for (text, words) in [
            (
                "1: goto 1",
                "f:1:10: statement 1: `goto` takes two coordinates, x y in mm; y is missing",
            ),
            (
                "\n1,2 : gogo",
                "f:2:7: statement 1: there is no `gogo`; did you mean `goto`?",
            ),
            (
                "?: leds 1",
                "f:1: `?` is not a number of a robot; numbers, ranges and groups such as 1,3-5,scouts, or all",
            ),
            (
                "leds 1",
                "f:1:1: `leds 1` names no robots; a line is such as `1-3: goto 1000 1000`",
            ),
            ("# nothing\n---", "f has nothing to be done"),
            ("3-5: leds 1", "f:1: there is no robot 5"),
            ("\nx: leds 1", "f:2: there is no group x"),
        ] {
            let error = Steps::parse("f", text).and_then(|steps| steps.of(&known()));
            assert_eq!(error.expect_err(text).to_string(), words, "{text}");
        }
        let error = Steps::one("1", "leds 1; motor 1 2").expect_err("no time");
        assert!(
            error.to_string().starts_with("column 18: statement 2: `motor`"),
            "{error}"
        );
    }
}
