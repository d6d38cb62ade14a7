//! One file for each command.

mod chat;
mod grab;
mod keygen;
mod lab;
mod run;
mod send;
mod snap;
mod tree;
mod watch;

use crate::cli::{Cli, Command};
use crate::failure::Failure;
use crate::output::Output;

/// Carries out what was typed.
pub(crate) async fn run(cli: &Cli, output: &Output) -> Result<(), Failure> {
    let (global, output) = (&cli.global, *output);
    match &cli.command {
        Command::Lab(args) => lab::run(args, output).await,
        Command::Tree(args) => tree::run(args, global, output).await,
        Command::Watch(args) => watch::run(args, global, output).await,
        Command::Send(args) => send::run(args, global, output).await,
        Command::Grab(args) => grab::run(args, global, output).await,
        Command::Run(args) => run::run(args, global, output).await,
        Command::Chat(args) => chat::run(args, global, output).await,
        Command::Keygen(args) => keygen::run(args, global, output),
        Command::Snap(args) => snap::run(args, global, output).await,
    }
}
