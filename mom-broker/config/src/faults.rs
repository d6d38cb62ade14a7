//! Finds all that is wrong with the files: what is at fault is struck out, and the rest is read again.

use super::source::SourceText;
use super::{Config, ConfigError, ConfigErrors};

/// After so many nothing more is looked for: each may cost another reading.
pub(super) const MOST: usize = 100;

/// The files of a configuration while they are read.
pub(super) struct Reading<F> {
    pub(super) config: SourceText,
    /// The users file, once it was read.
    pub(super) users: Option<SourceText>,
    /// Reads a file beside the configuration's.
    pub(super) beside: F,
    found: Vec<ConfigError>,
}

impl<F: Fn(&str) -> Result<SourceText, ConfigError>> Reading<F> {
    pub(super) fn new(config: SourceText, beside: F) -> Reading<F> {
        let mut reading = Reading {
            config: SourceText::default(),
            users: None,
            beside,
            found: Vec::new(),
        };
        reading.config = reading.open(config);
        reading
    }

    /// Tells what is not TOML. A header that cannot be read leaves open where the keys below it belong.
    pub(super) fn open(&mut self, mut source: SourceText) -> SourceText {
        let faults = source.syntax();
        let header = |error: &ConfigError| error.key.as_ref().is_some_and(|key| key.starts_with('['));
        if faults.iter().any(header) {
            source.strike(Vec::new(), None);
        }
        self.found.extend(faults);
        source
    }

    /// Reads the files until nothing more is found.
    ///
    /// # Errors
    /// All that is wrong with them.
    pub(super) fn finish(mut self) -> Result<Config, ConfigErrors> {
        let mut goes_on = true;
        while goes_on {
            match Config::read_once(&mut self) {
                Ok(config) if self.found.is_empty() => return Ok(config),
                Ok(_) => break,
                Err(faults) => goes_on = self.take(faults),
            }
        }
        let users = self.users.as_ref().map(|users| users.name.clone());
        self.found.sort_by_key(|error| (error.file == users, error.line));
        self.found.dedup();
        if self.found.len() >= MOST {
            let text = format!("more may be wrong; after {MOST} faults nothing more is looked for");
            self.found.push(ConfigError::of_file(&self.config.name, text));
        }
        Err(ConfigErrors(self.found))
    }

    /// Strikes what is at fault, and tells what does not only come of what was struck before. Gives whether there may be more.
    fn take(&mut self, mut faults: Vec<ConfigError>) -> bool {
        faults.truncate(MOST);
        // Judged before anything is struck for them: none of them follows from another.
        let judged: Vec<(Vec<String>, bool)> = faults
            .iter()
            .map(|fault| {
                (
                    self.source_of(fault).nearest_to(&fault.at.keys),
                    self.is_consequence(fault),
                )
            })
            .collect();
        let mut struck = false;
        for (fault, (at, known)) in faults.into_iter().zip(judged) {
            // What was meant stands in only for what was written there, and not for what holds it.
            let meant = fault.at.meant.clone().filter(|_| at == fault.at.keys);
            struck |= match &mut self.users {
                Some(users) if fault.file.as_ref() == Some(&users.name) => users.strike(at, meant),
                _ => self.config.strike(at, meant),
            };
            let again = |told: &ConfigError| told.file == fault.file && told.at.keys == fault.at.keys;
            if !known && (fault.at.keys.is_empty() || !self.found.iter().any(again)) {
                self.found.push(fault);
            }
        }
        struck && self.found.len() < MOST
    }

    fn source_of(&self, fault: &ConfigError) -> &SourceText {
        let users = self.users.as_ref();
        let users = users.filter(|users| fault.file.as_ref() == Some(&users.name));
        users.unwrap_or(&self.config)
    }

    fn is_consequence(&self, fault: &ConfigError) -> bool {
        let same_line = |told: &ConfigError| {
            told.file == fault.file && told.line == fault.line && told.at.keys.is_empty()
        };
        let source = self.source_of(fault);
        // A context below one that was struck, or whatever names one or a manager.
        let named = source.text_at(&fault.at.keys);
        let refers = |name: &String| {
            let rest = named.as_ref().and_then(|named| named.strip_prefix(name.as_str()));
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        source.follows(&fault.at.keys)
            || self.found.iter().any(same_line)
            || source.struck_names().iter().any(refers)
    }
}
