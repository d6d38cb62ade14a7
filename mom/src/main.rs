//! The command line of MOM: a lab to try, and the tools to look at a hub and to work with it.

mod cli;
mod commands;
mod complete;
mod connect;
mod devices;
mod doctor;
mod failure;
mod global;
mod input;
mod output;
mod top;

use std::pin::Pin;
use std::process::ExitCode;

use clap::CommandFactory as _;

use crate::cli::Cli;
use crate::failure::Failure;
use crate::output::Output;

/// `mom lab` draws and reads large pictures on many threads: this gives their memory back, where the C library's allocator keeps most of
/// it (docs/decisions.md).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Boxed, because tokio has three ways to wait for what it is given, and all commands would be compiled once for each.
fn running<'a>(cli: &'a Cli, output: &'a Output) -> Pin<Box<dyn Future<Output = Result<(), Failure>> + 'a>> {
    Box::pin(commands::run(cli, output))
}

fn main() -> ExitCode {
    let args: Vec<_> = std::env::args_os().collect();
    if let Some(written) = mom_pages::asked::<complete::Completed>(&args) {
        return match written {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => Output::new(false).failure(&Failure::from(error)),
        };
    }
    // The settings of the environment count as arguments for clap, so it would not see that there are none.
    if args.len() == 1 {
        return output::help(&mut Cli::command());
    }
    let cli = cli::parse();
    let output = Output::new(cli.global.json);
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return output.failure(&Failure::from(error)),
    };
    let result = runtime.block_on(running(&cli, &output));
    // A thread that still waits for a line of input must not hold up the end.
    runtime.shutdown_background();
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => output.failure(&failure),
    }
}
