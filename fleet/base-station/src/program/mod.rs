//! The program: a fleet in a terminal, and commands for scripts.

mod args;
mod plain;
#[cfg(test)]
mod tests;
mod view;
mod watching;

use std::ffi::OsString;
use std::io::{IsTerminal as _, Write as _, stderr, stdout};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use crate::edit::{self, Change, ChangeError, Edit};
use crate::fleet::{Fleet, Unit};
use crate::log::{Log, LogFile};
use crate::script::Script;
use crate::station::{Settings, Station};
use anyhow::{Context as _, Result, bail, ensure};
use clap::Parser as _;
use mom_brs::Table;
use mom_brs::file::{self, EXTENDED};
use mom_pages::Interrupt;
use tokio::task::JoinSet;
use tokio::time::sleep;

use self::args::{Args, Work};

/// So long the program's own end may take once its robots were to stop.
const END: Duration = Duration::from_secs(3);

/// How many entries the view can show.
const REMEMBERED: usize = 1000;

/// Runs the program with these arguments, of which the first is its name, until it is done or told to end.
pub fn run(args: Vec<OsString>) -> ExitCode {
    match carry_out(args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // In one line: the file, the place in it, and what is wrong.
            let _ = writeln!(stderr(), "mom-base-station: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Begins: what is wrong with the files is told before any robot is spoken to.
#[tokio::main]
async fn carry_out(args: Vec<OsString>) -> Result<()> {
    if let Some(written) = mom_pages::asked::<Args>(&args) {
        return Ok(written?);
    }
    let args = Args::parse_from(args);
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
        let station = Station::new(fleet, table, settings);
        let interrupt = Interrupt::install().context("cannot listen for signals")?;
        tokio::spawn(end_in_any_case(station.clone(), interrupt));
        Ok(station)
    };
    let mut interrupt = Interrupt::install().context("cannot listen for signals")?;
    match args.work {
        None => {
            let (station, units) = (begin(&fleet)?, fleet.units());
            let mut playing = JoinSet::new();
            let shown = if stdout().is_terminal() {
                watching::show(&station, &units, table, &mut interrupt, &mut playing).await
            } else {
                plain::show(&station, &units, table, &mut interrupt, &mut playing).await
            };
            // Nothing is sent any more when the robots are stopped.
            playing.shutdown().await;
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
    crate::edit::read(path).with_context(|| path.display().to_string())
}

/// Stops the robots and ends the program where that waits for a reader of its output: a blocked write keeps it from everything else.
async fn end_in_any_case(station: Station, mut interrupt: Interrupt) {
    interrupt.wait().await;
    let left = station.halt().await;
    sleep(END).await;
    // On a thread of its own, as that may not be read either.
    std::thread::spawn(move || {
        let _ = writeln!(
            stderr(),
            "mom-base-station: nobody reads its output; {}",
            stands(&left)
        );
    });
    sleep(Duration::from_millis(100)).await;
    std::process::exit(1);
}

/// What is known of the robots that were to stop, of which these have not confirmed it.
fn stands(left: &[Unit]) -> String {
    let units: Vec<String> = left.iter().map(Unit::to_string).collect();
    match units.is_empty() {
        true => "the robots were stopped".to_owned(),
        false => format!(
            "these units were started, and have not confirmed their stop: {}",
            units.join(", ")
        ),
    }
}

/// Stops all robots that were set in motion, and closes the connections.
async fn finish(station: &Station) -> Result<()> {
    let left = station.halt().await;
    station.close().await;
    match left.is_empty() {
        true => Ok(()),
        false => bail!("{}", stands(&left)),
    }
}
