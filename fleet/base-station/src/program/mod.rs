//! The program: a fleet in a terminal, and commands for scripts.

mod args;
mod plain;
mod screen;
#[cfg(test)]
mod tests;
mod view;
mod watching;

use std::io::{IsTerminal as _, Write as _, stdout};
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};
use clap::Parser as _;
use mom_base_station::edit::{self, Change, ChangeError, Edit};
use mom_base_station::fleet::{Fleet, Unit};
use mom_base_station::log::{Log, LogFile};
use mom_base_station::script::Script;
use mom_base_station::station::{Settings, Station};
use mom_brs::Table;
use mom_brs::file::{self, EXTENDED};
use tokio::signal::unix::{Signal, SignalKind, signal};

use self::args::{Args, Work};

/// How many entries the view can show.
const REMEMBERED: usize = 1000;

/// Begins: what is wrong with the files is told before any robot is spoken to.
#[tokio::main]
pub(crate) async fn main() -> Result<()> {
    if let Some(written) = mom_pages::asked::<Args>() {
        return Ok(written?);
    }
    let args = Args::parse();
    if let Some((edit, done)) = args.work.as_ref().and_then(Work::edit) {
        return change(&args.fleet, &edit, &done);
    }
    let fleet = Fleet::parse(&read(&args.fleet)?).with_context(|| args.fleet.display().to_string())?;
    let table: &'static Table = match &args.table {
        Some(path) => file::table(&read(path)?).with_context(|| path.display().to_string())?,
        None => &EXTENDED,
    };
    let begin = |fleet: &Fleet| -> Result<Station> {
        let mut log = Log::new(REMEMBERED);
        if let Some(path) = &args.log {
            let file = LogFile::open(path).with_context(|| path.display().to_string())?;
            log = log.with_file(file);
        }
        let settings = Settings {
            log,
            ..Settings::default()
        };
        Ok(Station::new(fleet, table, settings))
    };
    let mut interrupt = Interrupt::install()?;
    match args.work {
        None if stdout().is_terminal() => {
            let station = begin(&fleet)?;
            let shown = watching::show(&station, &fleet.units(), table, &mut interrupt).await;
            finish(&station).await.and(shown)
        }
        None => {
            let station = begin(&fleet)?;
            let shown = plain::show(&station, &fleet.units(), table, &mut interrupt).await;
            finish(&station).await.and(shown)
        }
        Some(Work::Send(send)) => {
            let text = send.statement.join(" ");
            let script = Script::parse(&text, &fleet.units(), table).with_context(|| format!("`{text}`"))?;
            let station = begin(&part(&fleet, &script.units())?)?;
            let sent = plain::send(&station, &script, &send, args.timeout, &mut interrupt).await;
            finish(&station).await.and(sent)
        }
        Some(Work::Run(run)) => {
            let name = || run.script.display().to_string();
            let script = Script::parse(&read(&run.script)?, &fleet.units(), table).with_context(name)?;
            let station = begin(&part(&fleet, &script.units())?)?;
            let played = plain::run(&station, script, run.stay, args.timeout, &mut interrupt).await;
            finish(&station).await.and(played)
        }
        // The others have been carried out above.
        Some(Work::List | Work::Add(_) | Work::Change(_) | Work::Remove(_)) => {
            let station = begin(&fleet)?;
            let listed = plain::list(&station, args.timeout, &mut interrupt).await;
            finish(&station).await.and(listed)
        }
    }
}

/// Changes the file of the fleet, or says why not.
fn change(path: &Path, edit: &Edit, done: &str) -> Result<()> {
    let name = || path.display().to_string();
    let is_nothing = matches!(edit, Edit::Change(_, change) if *change == Change::default());
    ensure!(
        !is_nothing,
        "there is nothing to change: say --unit, --address, --name, --no-name, --group or --no-group"
    );
    edit::change(path, edit).map_err(|error| match error {
        ChangeError::Edit(error) => anyhow::Error::new(error).context(name()),
        error @ ChangeError::File(..) => error.into(),
    })?;
    writeln!(
        stdout(),
        "{done} in {}; a running mom-gateway reloads it at SIGHUP, a mom-base-station when it is restarted",
        path.display()
    )?;
    Ok(())
}

/// The robots that a script speaks to: the others are left alone.
fn part(fleet: &Fleet, units: &[Unit]) -> Result<Fleet> {
    fleet.only(units).context("no robot is given a command")
}

fn read(path: &Path) -> Result<String> {
    mom_base_station::edit::read(path).with_context(|| path.display().to_string())
}

/// Stops all robots that were set in motion, and closes the connections.
async fn finish(station: &Station) -> Result<()> {
    let left = station.halt().await;
    station.close().await;
    if !left.is_empty() {
        let units: Vec<String> = left.iter().map(Unit::to_string).collect();
        bail!(
            "these units were started and could not be stopped: {}",
            units.join(", ")
        );
    }
    Ok(())
}

/// Ctrl-C, SIGTERM, and what a terminal says that is closed or left by Ctrl-\.
pub(crate) struct Interrupt {
    interrupt: Signal,
    terminate: Signal,
    hangup: Signal,
    quit: Signal,
}

impl Interrupt {
    fn install() -> Result<Interrupt> {
        Ok(Interrupt {
            interrupt: signal(SignalKind::interrupt()).context("cannot listen for Ctrl-C")?,
            terminate: signal(SignalKind::terminate()).context("cannot listen for SIGTERM")?,
            hangup: signal(SignalKind::hangup()).context("cannot listen for SIGHUP")?,
            quit: signal(SignalKind::quit()).context("cannot listen for SIGQUIT")?,
        })
    }

    /// Waits for one of them.
    async fn wait(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            _ = self.hangup.recv() => {}
            _ = self.quit.recv() => {}
        }
    }
}
