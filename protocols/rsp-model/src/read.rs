//! Reading a model, whatever language it is written in.

use crate::fault::ModelError;
use crate::model::Model;
use crate::{check, faults, text, xmi};

impl Model {
    /// Reads a model from the text of a TOML file.
    ///
    /// # Errors
    ///
    /// The first fault, and its place.
    pub fn read(text: &str) -> Result<Model, ModelError> {
        let read = || check::model(&text::of_toml(text)?);
        read().map_err(|found| found.at(text))
    }

    /// All that is wrong in the text of a TOML file, in the order of the places, 50 faults at most; none in a model that can be read.
    /// Of an element whose kind, type or numbers are at fault nothing more is told. A file that is not TOML has one fault, the first.
    #[must_use]
    pub fn faults(text: &str) -> Vec<ModelError> {
        let found = match text::of_toml(text) {
            Ok(source) => faults::all(source),
            Err(found) => vec![found],
        };
        found.into_iter().map(|found| found.at(text)).collect()
    }

    /// Reads a model from an XMI file, as Eclipse UML2 writes it; `docs/rsp-model.md` says which part of XMI is read.
    ///
    /// # Errors
    ///
    /// The first fault, and its place in the XMI.
    pub fn import_xmi(text: &str) -> Result<Model, ModelError> {
        let read = || check::model(&xmi::source(text)?);
        read().map_err(|found| found.at(text))
    }
}
