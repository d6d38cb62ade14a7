//! The broker service's program.

mod program;

use std::process::ExitCode;

/// After a flood it gives memory back to the system, where the C library's keeps most of it (docs/decisions.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    program::main()
}
