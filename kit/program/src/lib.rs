//! What the programs of peers do alike: the options by which they find their hub and log in, their log, and how they end.

use std::ffi::OsString;
use std::future::Future;
use std::io::IsTerminal;
use std::pin::Pin;

use anyhow::Context;
use clap::Parser;
use mom_pages::Interrupt;
use tokio::runtime::Builder;
use tracing_subscriber::EnvFilter;

mod hub;
mod installation;
pub mod others;
pub mod work;

pub use hub::HubArgs;

const SIGNALS: &str = "cannot listen for signals";

/// Reads the arguments of a program, of which the first is its name, and begins its log on the standard error: as much as
/// `RUST_LOG` says, else as `log` says.
/// None where its pages were asked for ([`mom_pages::ASK`]), which are written then.
///
/// # Errors
///
/// Pages that cannot be written. Arguments that are wrong end the program.
pub fn begin<A: Parser>(args: Vec<OsString>, log: &str) -> anyhow::Result<Option<A>> {
    if let Some(written) = mom_pages::asked::<A>(&args) {
        written.context("cannot write the pages")?;
        return Ok(None);
    }
    let args = A::parse_from(args);
    begin_log(log);
    Ok(Some(args))
}

/// Does the work of a program on a runtime with a thread for each core.
///
/// It is boxed because tokio has three ways to wait for what it is given, and the whole program would be compiled once for each.
///
/// # Errors
///
/// What the work ends by, or a runtime that cannot be started.
pub fn block_on(work: Pin<Box<dyn Future<Output = anyhow::Result<()>>>>) -> anyhow::Result<()> {
    let runtime = Builder::new_multi_thread().enable_all().build();
    runtime.context("cannot start the runtime")?.block_on(work)
}

/// Apart from [`begin`], which is compiled for each program's arguments.
fn begin_log(log: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(log));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // A terminal that is gone takes no complaint either, and to insist would panic.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
}

/// Done at Ctrl-C and SIGTERM, and at what a terminal says that is closed or left by Ctrl-\ (SIGHUP, SIGQUIT): a device halts whatever asks
/// it to end. Started by `nohup`, it goes on at SIGHUP. `mom_device::obey` takes it as the end of a device.
///
/// # Errors
///
/// The system does not let it listen for them.
pub fn shutdown() -> anyhow::Result<impl Future<Output = ()>> {
    Interrupt::install().context(SIGNALS).map(asked)
}

/// The same for a program to which SIGHUP says something else.
///
/// # Errors
///
/// As [`shutdown`].
pub fn shutdown_but_hangup() -> anyhow::Result<impl Future<Output = ()>> {
    Interrupt::install_but_hangup().context(SIGNALS).map(asked)
}

async fn asked(mut interrupt: Interrupt) {
    interrupt.wait().await;
    tracing::info!("ending");
}
