//! The text of a file as the sections of a model, whatever language it is written in: what is checked knows TOML and XMI alike.

use mom_toml_faults::Section;

use crate::fault::{Fault, Found};

/// The most bytes of a model's text.
pub(crate) const LONGEST_TEXT: usize = 1 << 20;

/// A file.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub(crate) root: Section,
    pub(crate) elements: Vec<Section>,
}

pub(crate) fn check_length(text: &str) -> Result<(), Found> {
    if text.len() > LONGEST_TEXT {
        let words = format!(
            "{} bytes are too many: a model has at most {LONGEST_TEXT}",
            text.len()
        );
        return Err(Found::new(Fault::TooLong, &(0..0), words));
    }
    Ok(())
}

/// The sections of a TOML file.
pub(crate) fn of_toml(text: &str) -> Result<Source, Found> {
    check_length(text)?;
    let mut root = Section::parse(text)?;
    let elements = root.tables("element")?.into_iter().cloned().collect();
    root.entries.retain(|(key, _)| key.value != "element");
    Ok(Source { root, elements })
}
