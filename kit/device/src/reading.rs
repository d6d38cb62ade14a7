//! Reading scripts in the language of a machine.

use crate::script::{WAIT, check_length, check_number};
use crate::words::{Words, split};
use crate::{Attachments, DeviceError, MAX_WAIT, Machine, Script, Statement, Word};

impl<A> Script<A> {
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
        check_length(text)?;
        let mut statements = Vec::new();
        for mut words in split(text) {
            let Some(verb) = words.next() else { continue };
            let number = check_number(statements.len(), verb.at)?;
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
    ends(verb, words).map(|()| statement)
}

/// That nothing follows a statement.
pub(crate) fn ends(verb: Word<'_>, words: &mut Words<'_>) -> Result<(), DeviceError> {
    match words.next() {
        None => Ok(()),
        Some(word) => {
            let (verb, short) = (verb.text, word.short());
            let text = format!("`{verb}` ends before `{short}`; is a `;` or a new line missing?");
            Err(DeviceError::syntax(word.at, text))
        }
    }
}

pub(crate) fn wait(words: &mut Words<'_>) -> Result<u32, DeviceError> {
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
