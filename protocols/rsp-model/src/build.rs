//! For the `build.rs` of a package whose program uses a model.
//!
//! ```no_run
//! // build.rs
//! fn main() -> Result<(), Box<dyn std::error::Error>> {
//!     Ok(mom_rsp_model::build::generate("cubo.toml")?)
//! }
//! ```
//!
//! and in the program, if the model's name is `cubo`:
//!
//! ```text
//! mod cubo {
//!     include!(concat!(env!("OUT_DIR"), "/cubo.rs"));
//! }
//! ```

use std::fmt;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

use crate::fault::ModelError;
use crate::generate::{self, Ends};
use crate::model::Model;

/// Why no code was made of a model.
#[derive(Debug)]
#[non_exhaustive]
pub enum BuildError {
    /// There is no `OUT_DIR`: this is not a build script.
    NoScript,
    /// A file could not be read or written.
    Io(PathBuf, io::Error),
    /// The model is wrong.
    Model(PathBuf, ModelError),
}

impl fmt::Display for BuildError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            BuildError::NoScript => f.write_str("OUT_DIR is not set: call this in a build script"),
            BuildError::Io(file, error) => write!(f, "{}: {error}", file.display()),
            BuildError::Model(file, error) => write!(f, "{}: {error}", file.display()),
        }
    }
}

impl std::error::Error for BuildError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            BuildError::NoScript => None,
            BuildError::Io(_, error) => Some(error),
            BuildError::Model(_, error) => Some(error),
        }
    }
}

/// Reads a model, and writes the Rust of both its ends into the folder for what a build makes, as the model's name and
/// `.rs`. The script runs again when the file changes.
///
/// # Errors
///
/// The file cannot be read, what it says is wrong, or the code cannot be written.
pub fn generate(file: impl AsRef<Path>) -> Result<(), BuildError> {
    generate_for(file, Ends::Both)
}

/// The same for some of the ends.
///
/// # Errors
///
/// As [`generate()`].
#[expect(clippy::print_stdout, reason = "it is how a build script speaks to cargo")]
pub fn generate_for(file: impl AsRef<Path>, ends: Ends) -> Result<(), BuildError> {
    let file = file.as_ref();
    println!("cargo::rerun-if-changed={}", file.display());
    let folder = env::var_os("OUT_DIR").ok_or(BuildError::NoScript)?;
    write_into(file, ends, Path::new(&folder))
}

fn write_into(file: &Path, ends: Ends, folder: &Path) -> Result<(), BuildError> {
    let text = fs::read_to_string(file).map_err(|error| BuildError::Io(file.to_owned(), error))?;
    let model = Model::read(&text).map_err(|error| BuildError::Model(file.to_owned(), error))?;
    let to = folder.join(format!("{}.rs", model.name()));
    fs::write(&to, generate::rust_for(&model, ends)).map_err(|error| BuildError::Io(to, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_models_code_is_written_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("any.toml");
        let text = "name = \"left-cart\"\nid = 1\n[[element]]\nname = \"x\"\nkind = \"event\"\n";
        fs::write(&file, text).unwrap();
        write_into(&file, Ends::Robot, folder.path()).unwrap();
        let model = Model::read(text).unwrap();
        let written = fs::read_to_string(folder.path().join("left-cart.rs")).unwrap();
        assert_eq!(written, generate::rust_for(&model, Ends::Robot));
    }

    #[test]
    fn a_wrong_model_is_told_with_file_and_place() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("any.toml");
        fs::write(&file, "id = 1\n").unwrap();
        let error = write_into(&file, Ends::Both, folder.path()).unwrap_err();
        let words = format!("{}: line 1, column 1: `name` is missing", file.display());
        assert_eq!(error.to_string(), words);
        let error = write_into(&folder.path().join("none.toml"), Ends::Both, folder.path()).unwrap_err();
        assert!(matches!(error, BuildError::Io(..)), "{error}");
    }
}
