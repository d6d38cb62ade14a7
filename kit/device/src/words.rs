//! The words of a script, with their places.

use crate::DeviceError;

/// The longest part of a wrong word that an error repeats, in characters.
const LONGEST_WORD: usize = 24;

/// A word and the byte at which it begins.
#[derive(Debug, Clone, Copy)]
pub struct Word<'a> {
    /// What it says.
    pub text: &'a str,
    /// The byte of the script at which it begins.
    pub at: usize,
}

impl Word<'_> {
    /// The word for an error's text, shortened.
    #[must_use]
    pub fn short(&self) -> String {
        let short: String = self.text.chars().take(LONGEST_WORD).collect();
        match short.len() < self.text.len() {
            true => short + "…",
            false => short,
        }
    }

    /// The most similar of some known words, without regard to case; an empty one of none.
    #[must_use]
    pub fn nearest(&self, known: &[&'static str]) -> &'static str {
        let lower = self.short().to_lowercase();
        mom_nearest::most_similar(&lower, known.iter().copied()).unwrap_or_default()
    }
}

/// The words of one statement that are still to be read.
#[derive(Debug)]
pub struct Words<'a> {
    rest: &'a str,
    at: usize,
}

impl<'a> Iterator for Words<'a> {
    type Item = Word<'a>;

    fn next(&mut self) -> Option<Word<'a>> {
        let trimmed = self.rest.trim_start();
        self.at += self.rest.len() - trimmed.len();
        let end = trimmed.find(char::is_whitespace).unwrap_or(trimmed.len());
        let (text, rest) = trimmed.split_at(end);
        let word = Word { text, at: self.at };
        (self.rest, self.at) = (rest, self.at + end);
        (end > 0).then_some(word)
    }
}

impl<'a> Words<'a> {
    /// Whether none is left.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.rest.trim_start().is_empty()
    }

    /// The next word, which is `which` of what `verb` takes.
    ///
    /// # Errors
    ///
    /// `syntax` if the statement ends before.
    pub fn need(&mut self, verb: &str, takes: &str, which: &str) -> Result<Word<'a>, DeviceError> {
        let word = self.next();
        word.ok_or_else(|| {
            DeviceError::syntax(self.at, format!("`{verb}` takes {takes}; {which} is missing"))
        })
    }

    /// The next word as a number.
    ///
    /// # Errors
    ///
    /// `syntax` if there is none, or it is not a finite number.
    pub fn number(&mut self, verb: &str, takes: &str, which: &str) -> Result<f64, DeviceError> {
        let word = self.need(verb, takes, which)?;
        // `parse` also takes `inf` and `nan`, and makes an infinity of what is too large.
        let number = word.text.parse().ok().filter(|number: &f64| number.is_finite());
        number.ok_or_else(|| {
            let text = format!("{which} is `{}`, which is not a number", word.short());
            DeviceError::syntax(word.at, text)
        })
    }

    /// The next word as a whole number between these two.
    ///
    /// # Errors
    ///
    /// `syntax` if there is none, or it is not such a number.
    pub fn whole(
        &mut self,
        verb: &str,
        takes: &str,
        which: &str,
        range: std::ops::RangeInclusive<i32>,
    ) -> Result<i32, DeviceError> {
        let word = self.need(verb, takes, which)?;
        let number = word.text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| {
            let (least, most, short) = (range.start(), range.end(), word.short());
            let text = format!(
                "`{verb}` takes {takes}: {which} is a whole number from {least} to {most}, not `{short}`"
            );
            DeviceError::syntax(word.at, text)
        })
    }
}

/// The statements of a script as words, without their comments; some may have no word.
pub(crate) fn split(text: &str) -> impl Iterator<Item = Words<'_>> {
    let mut line_at = 0;
    text.split('\n').flat_map(move |line| {
        let mut at = line_at;
        line_at += line.len() + 1;
        let code = line.split_once('#').map_or(line, |(code, _comment)| code);
        code.split(';').map(move |rest| {
            let words = Words { rest, at };
            at += rest.len() + 1;
            words
        })
    })
}
