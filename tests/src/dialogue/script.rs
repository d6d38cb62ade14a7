//! From text to steps.

use std::time::Duration;

use super::Error;
use super::hear::Expected;
use super::notation::Terms;
use super::say::Request;

/// A dialogue's steps.
#[derive(Debug)]
pub(crate) struct Script {
    pub(crate) config: Configuration,
    pub(crate) steps: Vec<Line>,
}

/// Where the configuration comes from.
#[derive(Debug, PartialEq)]
pub(crate) enum Configuration {
    /// A file of the project.
    File(String),
    /// Lines of the dialogue; the users of the lab.
    Text(String),
}

/// A step and where it stands.
#[derive(Debug)]
pub(crate) struct Line {
    pub(crate) number: usize,
    pub(crate) text: String,
    pub(crate) step: Step,
}

#[derive(Debug)]
pub(crate) enum Step {
    Connect(Connect),
    Link(Vec<String>),
    Joins { who: String, paths: Vec<String> },
    Ignore(Vec<String>),
    Clock(Duration),
    Gone { who: String },
    Says { who: String, request: Box<Request> },
    Hears { who: String, expected: Box<Expected> },
}

/// Links with logins.
#[derive(Debug)]
pub(crate) struct Connect {
    pub(crate) users: Vec<String>,
    pub(crate) nickname: Option<String>,
    /// The peer's name, if it is not the user's; then there is one user.
    pub(crate) name: Option<String>,
}

impl Script {
    pub(crate) fn parse(text: &str) -> Result<Script, Error> {
        let mut script = Script {
            config: Configuration::File("config/lab.toml".to_owned()),
            steps: Vec::new(),
        };
        let mut in_config = false;
        for (index, raw) in text.lines().enumerate() {
            let number = index + 1;
            let failed = |text: String| Error::Notation { line: number, text };
            if raw.starts_with([' ', '\t']) || (in_config && raw.is_empty()) {
                match &mut script.config {
                    Configuration::Text(config) if in_config => {
                        config.push_str(raw);
                        config.push('\n');
                        continue;
                    }
                    _ => return Err(failed("only lines of a configuration are indented".to_owned())),
                }
            }
            in_config = false;
            let line = raw.trim_end();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            if let Some(file) = line.strip_prefix("config") {
                in_config = file.trim().is_empty();
                script.config = match in_config {
                    true => Configuration::Text(String::new()),
                    false => Configuration::File(file.trim().to_owned()),
                };
                continue;
            }
            script.steps.push(Line {
                number,
                text: line.to_owned(),
                step: Step::parse(line).map_err(failed)?,
            });
        }
        Ok(script)
    }
}

impl Step {
    fn parse(line: &str) -> Result<Step, String> {
        let (first, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        if let Some(who) = first.strip_suffix(':') {
            let request = Box::new(Request::parse(rest.trim())?);
            return Ok(Step::Says {
                who: who.to_owned(),
                request,
            });
        }
        if let Some(who) = first.strip_suffix('<') {
            let expected = Box::new(Expected::parse(rest.trim())?);
            return Ok(Step::Hears {
                who: who.to_owned(),
                expected,
            });
        }
        let mut terms = Terms::parse(rest)?;
        let words = std::mem::take(&mut terms.words);
        let step = match first {
            "connect" => Step::Connect(connect(words, &mut terms)?),
            "link" => Step::Link(words),
            "ignore" => Step::Ignore(words),
            "clock" => Step::Clock(duration(rest.trim())?),
            who => match words.split_first() {
                Some((verb, [])) if verb == "gone" => Step::Gone { who: who.to_owned() },
                Some((verb, paths)) if verb == "joins" && !paths.is_empty() => Step::Joins {
                    who: who.to_owned(),
                    paths: paths.to_vec(),
                },
                _ => return Err(format!("{line:?} is not a line of a dialogue")),
            },
        };
        terms.nothing_left()?;
        Ok(step)
    }
}

fn connect(mut users: Vec<String>, terms: &mut Terms) -> Result<Connect, String> {
    let name = match users.iter().position(|word| word == "as") {
        None => None,
        Some(1) if users.len() == 3 => {
            users.remove(1);
            users.pop()
        }
        Some(_) => return Err("one user connects as one name: connect bob as bob~2".to_owned()),
    };
    let nickname = match terms.take_field("nickname") {
        None => None,
        Some(nickname) if users.len() == 1 => nickname.as_str().map(str::to_owned),
        Some(_) => return Err("a nickname is for one user".to_owned()),
    };
    Ok(Connect {
        users,
        nickname,
        name,
    })
}

fn duration(text: &str) -> Result<Duration, String> {
    let read = || {
        let amount = text.strip_prefix('+')?;
        let unit = amount.find(|c: char| c.is_ascii_alphabetic())?;
        let number: u64 = amount[..unit].parse().ok()?;
        match &amount[unit..] {
            "ms" => Some(Duration::from_millis(number)),
            "s" => Some(Duration::from_secs(number)),
            "m" => Some(Duration::from_secs(number * 60)),
            "h" => Some(Duration::from_secs(number * 3600)),
            _ => None,
        }
    };
    read().ok_or_else(|| format!("{text:?} is not a time to pass: clock +181s"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_line_is_refused_with_its_number() {
        for bad in [
            "alice",
            "alice sings /chat",
            "alice joins",
            "  indented",
            "clock 181s",
            "clock +181",
            "connect alice bob as bob~2",
            "connect alice bob nickname=x",
            "connect alice colour=red",
            "alice: jump /robot",
            "alice: grab",
            "alice: grab /robot/token now",
            "alice: send /chat say hello",
            "alice: create /lab",
            "alice: create /lab castle",
            "alice: parcel letter say",
            "alice< okay",
            "alice< error",
            "alice< event",
            "alice< nothing at all",
        ] {
            match Script::parse(&format!("# first\n{bad}\n")) {
                Err(Error::Notation { line, .. }) => assert_eq!(line, 2, "{bad}"),
                other => panic!("{bad}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_configuration_is_indented() {
        let script =
            Script::parse("config\n    root = \"open\"\n\n    log = \"info\"\n\nconnect alice\n").unwrap();
        let text = "    root = \"open\"\n\n    log = \"info\"\n\n".to_owned();
        assert_eq!(script.config, Configuration::Text(text));
        assert_eq!(script.steps.len(), 1);
        let file = Script::parse("config config/mom.toml\n").unwrap();
        assert_eq!(file.config, Configuration::File("config/mom.toml".to_owned()));
    }
}
