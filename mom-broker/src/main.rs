//! The broker service's program.

mod program;

use std::process::ExitCode;

fn main() -> ExitCode {
    program::main()
}
