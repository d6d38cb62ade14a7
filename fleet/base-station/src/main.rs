//! The base station as a program.

mod program;

use std::io::{Write as _, stderr};
use std::process::ExitCode;

fn main() -> ExitCode {
    match program::main() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // In one line: the file, the place in it, and what is wrong.
            let _ = writeln!(stderr(), "mom-base-station: {error:#}");
            ExitCode::FAILURE
        }
    }
}
