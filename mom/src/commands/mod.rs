//! One file for each command.

mod accept;
mod aim;
mod asking;
mod audit;
mod break_hold;
mod camera;
mod card;
mod chat;
mod create;
mod decline;
mod delete;
mod expel;
mod explain;
mod give;
mod grab;
mod hire;
mod hold;
mod inhibit;
mod invite;
mod jog;
mod keygen;
mod lab;
mod logs;
mod manage;
mod new;
mod offers;
mod request;
mod rsp;
mod run;
mod send;
mod snap;
mod stats;
mod stop;
mod token;
mod trace;
mod tree;
mod watch;
mod what_if;

use crate::cli::{Cli, Command};
use crate::doctor;
use crate::failure::Failure;
use crate::output::Output;
use crate::top;

pub(crate) use self::run::drive;

/// Runs a command.
pub(crate) async fn run(cli: &Cli, output: &Output) -> Result<(), Failure> {
    let (global, output) = (&cli.global, *output);
    match &cli.command {
        Command::Stop(args) => stop::stop(args, global, output).await,
        Command::Unstop(args) => stop::unstop(args, global, output).await,
        Command::Lab(args) => lab::run(args, output).await,
        Command::Tree(args) => tree::run(args, global, output).await,
        Command::Stats(args) => stats::run(args, global, output).await,
        Command::Top(args) => top::run(args, global, output).await,
        Command::Audit(args) => audit::run(args, global, output).await,
        Command::Explain(args) => explain::run(args, global, output).await,
        Command::WhatIf(args) => what_if::run(args, global, output).await,
        Command::Logs(args) => logs::run(args, global, output).await,
        Command::Watch(args) => watch::run(args, global, output).await,
        Command::Send(args) => send::run(args, global, output).await,
        Command::Create(args) => create::run(args, global, output).await,
        Command::Delete(args) => delete::run(args, global, output).await,
        Command::Grab(args) => grab::run(args, global, output).await,
        Command::Request(args) => request::run(args, global, output).await,
        Command::Give(args) => give::run(args, global, output).await,
        Command::Hire(args) => hire::run(args, global, output).await,
        Command::Accept(args) => accept::run(args, global, output).await,
        Command::Decline(args) => decline::run(args, global, output).await,
        Command::Break(args) => break_hold::run(args, global, output).await,
        Command::Inhibit(args) => inhibit::run(args, global, output).await,
        Command::Token(args) => token::run(args, global, output).await,
        Command::Invite(args) => invite::run(args, global, output).await,
        Command::Expel(args) => expel::run(args, global, output).await,
        Command::Manage(args) => manage::run(args, global, output).await,
        Command::Card(args) => card::run(args, global, output).await,
        Command::Run(args) => run::run(args, global, output).await,
        Command::Trace(args) => trace::run(args, global, output).await,
        Command::Jog(args) => jog::run(args, global, output).await,
        Command::Chat(args) => chat::run(args, global, output).await,
        Command::New(command) => new::run(command, output),
        Command::Keygen(args) => keygen::run(args, global, output),
        Command::Doctor(args) => doctor::run(args, global, output).await,
        Command::Camera(args) => camera::run(args, global, output).await,
        Command::Aim(args) => aim::run(args, global, output).await,
        Command::Snap(args) => snap::run(args, global, output).await,
        Command::Rsp(args) => rsp::run(args, output),
        Command::Device(command) => command.run(global, output).await,
    }
}
