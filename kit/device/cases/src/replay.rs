//! The dialogues that every device replays.

use mom_client::{Card, to_value};
use mom_device::Machine;

use crate::Stage;

/// What every device does alike.
const DIALOGUES: &str = include_str!("../../../../tests/cases/device.txt");

/// What a machine is told where a dialogue has a word in braces; none = it has nothing like that, and its dialogues are left out.
#[derive(Clone, Copy, Debug, Default)]
pub struct Statements {
    /// Moves it for more than 200 ms, wherever it is.
    pub go: &'static str,
    /// Moves it from where that leads.
    pub back: &'static str,
    /// Cannot be read.
    pub wrong: &'static str,
    /// Can be read and not be carried out, with the name and the number of the error.
    pub beyond: Option<(&'static str, &'static str)>,
    /// Says only how far it goes.
    pub relative: Option<&'static str>,
    /// Gives way to the next command, and waits behind no other.
    pub velocity: Option<&'static str>,
}

/// Plays each dialogue of `tests/cases/device.txt` on stages that are made anew for each, with a device of which nothing was heard
/// yet; also how many it played.
///
/// # Panics
///
/// With the title and the line at which the device says something else.
pub fn replay<M: Machine>(make: impl Fn() -> Stage<M>, statements: &Statements) -> usize {
    let text = DIALOGUES
        .lines()
        .filter(|line| !line.starts_with('#'))
        .collect::<Vec<_>>()
        .join("\n");
    check_card(make().server().machine(), statements);
    let mut played = 0;
    for dialogue in text.split("\n== ").skip(1) {
        let (title, lines) = dialogue.split_once('\n').unwrap();
        if let Some((needed, _)) = lines
            .strip_prefix("needs ")
            .and_then(|rest| rest.split_once('\n'))
            && !has(needed, &make(), statements)
        {
            continue;
        }
        let lines = lines.lines().filter(|line| !line.starts_with("needs "));
        let (each, lines): (Vec<&str>, Vec<&str>) = lines.partition(|line| line.starts_with("each "));
        let each = each.first().map_or("", |each| each.trim_start_matches("each "));
        for one in each.split(" | ") {
            let lines = lines.join("\n").replace("{each}", one);
            let mut stage = make().begin();
            check(
                &mut stage,
                &format!("{title} ({one})"),
                &fill_in::<M>(&lines, statements),
            );
            played += 1;
        }
    }
    played
}

/// Plays lines on a stage: those with `>` are what must have been said since the line before.
///
/// # Panics
///
/// With the title and the line at which the device says something else.
pub fn check<M: Machine>(stage: &mut Stage<M>, title: &str, dialogue: &str) {
    let lines = dialogue.lines().map(str::trim);
    let mut lines = lines.filter(|line| !line.is_empty()).peekable();
    while let Some(line) = lines.next() {
        stage.act(line);
        let mut expected = Vec::new();
        while let Some(heard) = lines.next_if(|line| line.starts_with("> ")) {
            expected.push(heard.trim_start_matches("> ").to_owned());
        }
        let heard = stage.heard();
        let fits = heard.len() == expected.len()
            && heard.iter().zip(&expected).all(|(heard, line)| fits(heard, line));
        assert!(
            fits,
            "{}, {title}: after `{line}`\n heard {heard:#?}\n instead of {expected:#?}",
            M::NAME
        );
    }
}

/// Whether what is heard is what a line says; ` *` stands for whatever a state tells of motion.
fn fits(heard: &str, line: &str) -> bool {
    match line.split_once(" *") {
        None => heard == line,
        Some((before, after)) => ["", " moving", " at rest"]
            .iter()
            .any(|motion| heard == format!("{before}{motion}{after}")),
    }
}

/// The card says what the machine does: its statements are the machine's, and those of the dialogues are as it says.
fn check_card<M: Machine>(machine: &M, statements: &Statements) {
    let card = mom_device::card(machine);
    let read = Card::read(&to_value(&card).unwrap());
    assert_eq!(read.as_ref(), Ok(&card), "a hub takes it");
    for verb in &card.verbs {
        assert!(
            M::VERBS.is_empty() || M::VERBS.contains(&&*verb.name),
            "{} is a statement of {}",
            verb.name,
            M::NAME
        );
    }
    let of = |statement: &str| {
        let verb = statement.split(' ').next().unwrap_or_default();
        card.verb(verb)
            .unwrap_or_else(|| panic!("the card of {} has {verb}", M::NAME))
    };
    assert!(of(statements.go).moves && of(statements.back).moves);
    assert!(statements.relative.is_none_or(|statement| of(statement).relative));
    assert!(statements.velocity.is_none_or(|statement| of(statement).velocity));
    let relative = card.verbs.iter().any(|verb| verb.relative);
    let velocity = card.verbs.iter().any(|verb| verb.velocity);
    assert_eq!(
        (relative, velocity),
        (statements.relative.is_some(), statements.velocity.is_some())
    );
    // Where it is, by which commands are based on a state, is told with its unit.
    for (key, _) in machine.position().iter() {
        let is_told = card
            .state
            .iter()
            .any(|field| field.name.split('.').next() == Some(key));
        assert!(is_told, "the card of {} has {key}", M::NAME);
    }
}

fn has<M: Machine>(needed: &str, stage: &Stage<M>, statements: &Statements) -> bool {
    match needed {
        "beyond" => statements.beyond.is_some(),
        "relative" => statements.relative.is_some(),
        "velocity" => statements.velocity.is_some(),
        "pushes" => stage.is_pushed(),
        "estop" => stage.is_pressed(),
        "keep-alive" => stage.is_kept(),
        "completes" => M::COMPLETES,
        "halts-on-give" => !M::COMPLETES,
        other => panic!("no dialogue can need {other}"),
    }
}

fn fill_in<M: Machine>(lines: &str, statements: &Statements) -> String {
    let (beyond, error) = statements.beyond.unwrap_or_default();
    let within = (M::STOPPING_TIME / 1000).to_string();
    let words = [
        ("{go}", statements.go),
        ("{back}", statements.back),
        ("{wrong}", statements.wrong),
        ("{beyond}", beyond),
        ("{beyond-error}", error),
        ("{relative}", statements.relative.unwrap_or_default()),
        ("{velocity}", statements.velocity.unwrap_or_default()),
        ("{stops-within}", &within),
    ];
    words
        .iter()
        .fold(lines.to_owned(), |lines, (word, text)| lines.replace(word, text))
}
