//! Plain lines, for output that is not a terminal, and the commands that end by themselves.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::fmt::Display;
use std::io::{self, Write as _};
use std::pin::pin;
use std::time::Duration;

use crate::circuit::{Note, State, Taken};
use crate::fleet::Unit;
use crate::log::{Entry, millis};
use crate::play::play;
use crate::script::Script;
use crate::station::{SendError, Snapshot, Station};
use anyhow::{Result, bail};
use mom_brs::{Code, Command, Frame, Table};
use mom_pages::Interrupt;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior, interval, timeout, timeout_at};

use super::args::SendArgs;

/// Between two frames for the watchdogs of robots that drive: the usual one is 0.5 s.
const FEEDS: Duration = Duration::from_millis(150);
/// How long replies are waited for at the end.
const REPLIES_WITHIN: Duration = Duration::from_secs(3);

fn say(line: impl Display) -> io::Result<()> {
    writeln!(io::stdout().lock(), "{line}")
}

/// For people, beside the results.
fn warn(line: impl Display) {
    // Nobody could be told of it.
    let _ = writeln!(io::stderr().lock(), "{line}");
}

async fn next(changes: &mut Receiver<Entry>) -> Option<Entry> {
    loop {
        match changes.recv().await {
            Ok(entry) => return Some(entry),
            Err(RecvError::Lagged(missed)) => warn(format!("{missed} lines are missing here")),
            Err(RecvError::Closed) => return None,
        }
    }
}

/// Shows all that happens, and carries out the statements of the standard input, until it is interrupted.
pub(super) async fn show(
    station: &Station,
    units: &[Unit],
    table: &'static Table,
    interrupt: &mut Interrupt,
    playing: &mut JoinSet<()>,
) -> Result<()> {
    let mut changes = station.subscribe();
    let mut statements = statements();
    let mut open = true;
    let (lines, mut written) = written();
    station.connect_all();
    loop {
        // Where its output is not read, statements are carried out all the same.
        let told = async {
            let place = lines.reserve().await;
            (place, next(&mut changes).await)
        };
        tokio::select! {
            () = interrupt.wait() => return Ok(()),
            error = &mut written => return Err(error?.into()),
            (place, entry) = told => match (place, entry) {
                (Ok(place), Some(entry)) => place.send(entry.to_string()),
                (Ok(_), None) => return Ok(()),
                // Why is told next.
                (Err(_), _) => return Err(written.await?.into()),
            },
            Some(_) = playing.join_next(), if !playing.is_empty() => {}
            line = statements.recv(), if open => match line {
                None => open = false,
                Some(line) => match Script::parse(&line, units, table) {
                    Err(error) => warn(error),
                    Ok(script) => {
                        let station = station.clone();
                        // It is still shown what happens while it waits.
                        playing.spawn(async move {
                            let sent = |_, sent: Result<Taken, SendError>| {
                                let _ = sent.map_err(warn);
                            };
                            if let Err(failed) = play(&station, script, sent).await {
                                warn(failed);
                            }
                        });
                    }
                }
            },
        }
    }
}

/// Takes lines to be written to standard output by a thread of its own; also why it writes no more.
fn written() -> (mpsc::Sender<String>, oneshot::Receiver<io::Error>) {
    let (sender, mut lines) = mpsc::channel::<String>(64);
    let (failed, why) = oneshot::channel();
    std::thread::spawn(move || {
        while let Some(line) = lines.blocking_recv() {
            if let Err(error) = say(line) {
                let _ = failed.send(error);
                return;
            }
        }
    });
    (sender, why)
}

/// The lines of the standard input, read by a thread of its own that lasts as long as the program.
fn statements() -> mpsc::Receiver<String> {
    let (sender, receiver) = mpsc::channel(16);
    std::thread::spawn(move || {
        for line in io::stdin().lines() {
            let Ok(line) = line else { return };
            if sender.blocking_send(line).is_err() {
                return;
            }
        }
    });
    receiver
}

/// Waits until all are writable, and tells who is not.
async fn connect(station: &Station, patience: Duration) -> Result<()> {
    station.connect_all();
    let until = Instant::now() + patience;
    for unit in station.snapshot().iter().map(|snapshot| snapshot.robot.unit) {
        let mut changes = station.watch(unit)?;
        let writable = changes.wait_for(|snapshot| snapshot.state == State::Writable);
        if timeout_at(until, writable).await.is_err() {
            let snapshot = changes.borrow();
            match &snapshot.last_end {
                Some(end) => warn(format!("unit {unit} is {}: {end}", snapshot.state)),
                None => warn(format!("unit {unit} is {}", snapshot.state)),
            }
        }
    }
    Ok(())
}

/// What is still to come of a script: frames that were taken and not written yet, and replies.
#[derive(Default)]
struct ToCome {
    unwritten: Cell<u64>,
    refused: Cell<u64>,
    replies: RefCell<HashMap<(Unit, Code), u64>>,
}

impl ToCome {
    /// Takes in what became of a command.
    fn sent(&self, frame: Frame, sent: Result<Taken, SendError>) {
        match sent {
            Err(error) => {
                self.refused.set(self.refused.get() + 1);
                warn(error);
            }
            // NULLs leave by themselves, too.
            Ok(Taken::Queued) if frame.code() != Code::NULL => self.unwritten.set(self.unwritten.get() + 1),
            Ok(Taken::Queued) => {}
            Ok(Taken::Replaced(dropped)) => {
                // It is to come itself.
                self.unwritten
                    .set((self.unwritten.get() + 1).saturating_sub(dropped as u64));
                warn(format!(
                    "{frame} overrides the queued commands: {dropped} not sent"
                ));
            }
        }
    }

    /// Tells of an entry, and takes it from what is to come.
    fn take(&self, entry: &Entry) -> io::Result<()> {
        let mut replies = self.replies.borrow_mut();
        match &entry.note {
            Note::Sent(frame) if frame.code() == Code::NULL => return Ok(()),
            Note::Sent(_) => self.unwritten.set(self.unwritten.get().saturating_sub(1)),
            Note::Received(frame, _) => {
                let key = (entry.unit, frame.code());
                match replies.get_mut(&key) {
                    Some(left) if *left > 1 => *left -= 1,
                    Some(_) => {
                        replies.remove(&key);
                    }
                    None if frame.code() == Code::NULL => return Ok(()),
                    None => {}
                }
            }
            _ => {}
        }
        say(entry)
    }

    fn is_nothing(&self) -> bool {
        self.unwritten.get() == 0 && self.replies.borrow().is_empty()
    }
}

/// Carries out a script, and tells of all that happens meanwhile; what is to come then, all commands counted.
async fn carry_out(
    station: &Station,
    script: &Script,
    changes: &mut Receiver<Entry>,
    come: &ToCome,
) -> Result<()> {
    let mut played = pin!(play(station, script.clone(), |frame, sent| come.sent(frame, sent)));
    loop {
        tokio::select! {
            biased;
            entry = next(changes) => match entry {
                Some(entry) => come.take(&entry)?,
                None => return Ok(()),
            },
            played = &mut played => return Ok(played?),
        }
    }
}

/// Tells of all that happens until what is to come has come, for three seconds at most.
async fn await_rest(changes: &mut Receiver<Entry>, come: &ToCome) -> Result<()> {
    let rest = async {
        while !come.is_nothing() {
            let Some(entry) = next(changes).await else { break };
            come.take(&entry)?;
        }
        anyhow::Ok(())
    };
    if let Ok(told) = timeout(REPLIES_WITHIN, rest).await {
        return told;
    }
    for ((unit, code), left) in come.replies.take() {
        warn(format!("unit {unit} has not replied to {code}"));
        come.refused.set(come.refused.get() + left);
    }
    let unwritten = come.unwritten.take();
    if unwritten > 0 {
        warn(format!("{unwritten} commands could not be written"));
    }
    come.refused.set(come.refused.get() + unwritten);
    Ok(())
}

/// Carries out a statement once, and waits for its replies; how many commands were refused or without one.
async fn once(station: &Station, script: &Script) -> Result<u64> {
    let mut changes = station.subscribe();
    let come = ToCome::default();
    // Who is not there does not reply.
    let is_there = |unit| {
        station
            .watch(unit)
            .is_ok_and(|seen| seen.borrow().state == State::Writable)
    };
    for (unit, code) in script.replies() {
        if is_there(unit) {
            *come.replies.borrow_mut().entry((unit, code)).or_default() += 1;
        }
    }
    carry_out(station, script, &mut changes, &come).await?;
    await_rest(&mut changes, &come).await?;
    Ok(come.refused.get())
}

fn all_sent(refused: u64) -> Result<()> {
    if refused > 0 {
        bail!("{refused} commands were not sent, or had no reply");
    }
    Ok(())
}

/// Sends a statement, once or again and again.
pub(super) async fn send(
    station: &Station,
    script: &Script,
    args: &SendArgs,
    patience: Duration,
    interrupt: &mut Interrupt,
) -> Result<()> {
    let sending = async {
        connect(station, patience).await?;
        let mut refused = 0;
        if let Some(pause) = args.repeat {
            let mut ticks = interval(pause.max(Duration::from_millis(1)));
            ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
            let mut left = args.times;
            while left != Some(0) {
                ticks.tick().await;
                refused += once(station, script).await?;
                left = left.map(|left| left - 1);
            }
            // The last one lasts as long as the others.
            ticks.tick().await;
        } else {
            refused = once(station, script).await?;
        }
        let stay = args.stay.unwrap_or_else(|| match args.repeat {
            Some(_) => Duration::ZERO,
            None => drive_on(station),
        });
        let (mut changes, nothing) = (station.subscribe(), ToCome::default());
        tokio::select! {
            told = stay_and_tell(&mut changes, &nothing, stay) => told?,
            // Who stops now needs no frame, and its moment would be left to chance.
            () = keep_driving(station), if !stay.is_zero() => {}
        }
        all_sent(refused)
    };
    tokio::select! {
        () = interrupt.wait() => Ok(()),
        sent = sending => sent,
    }
}

/// For how long robots go on that a statement has set in motion: when they are where they are to be, only who looks on knows.
fn drive_on(station: &Station) -> Duration {
    let snapshots = station.snapshot();
    let moving = snapshots.iter().filter(|snapshot| snapshot.in_motion);
    let units: Vec<String> = moving.map(|snapshot| snapshot.robot.unit.to_string()).collect();
    if units.is_empty() {
        return Duration::ZERO;
    }
    warn(format!(
        "unit {} drives until Ctrl-C; --stay 5s stops it after 5 s",
        units.join(", ")
    ));
    Duration::MAX
}

/// Has robots with a watchdog drive on: any frame feeds it.
async fn keep_driving(station: &Station) {
    let mut ticks = interval(FEEDS);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let Ok(null) = Frame::new(&Command::NULL, &[]) else {
            return;
        };
        for snapshot in station.snapshot().iter().filter(|snapshot| snapshot.in_motion) {
            // One that takes nothing now is lost, which is told.
            let _ = station.send(snapshot.robot.unit, null);
        }
    }
}

/// Tells of all that happens for some time.
async fn stay_and_tell(changes: &mut Receiver<Entry>, come: &ToCome, stay: Duration) -> Result<()> {
    let telling = async {
        while let Some(entry) = next(changes).await {
            come.take(&entry)?;
        }
        anyhow::Ok(())
    };
    timeout(stay, telling).await.unwrap_or(Ok(()))
}

/// Carries out a script.
pub(super) async fn run(
    station: &Station,
    script: Script,
    stay: Duration,
    patience: Duration,
    interrupt: &mut Interrupt,
) -> Result<()> {
    let running = async {
        connect(station, patience).await?;
        let (mut changes, come) = (station.subscribe(), ToCome::default());
        carry_out(station, &script, &mut changes, &come).await?;
        await_rest(&mut changes, &come).await?;
        stay_and_tell(&mut changes, &come, stay).await?;
        all_sent(come.refused.get())
    };
    tokio::select! {
        () = interrupt.wait() => Ok(()),
        played = running => played,
    }
}

/// Tries all robots, and tells what is known of them.
pub(super) async fn list(station: &Station, patience: Duration, interrupt: &mut Interrupt) -> Result<()> {
    let asking = async {
        station.connect_all();
        let until = Instant::now() + patience;
        let status = Frame::new(&Command::STATUS, &[])?;
        let mut asked = Vec::new();
        for unit in station.snapshot().iter().map(|snapshot| snapshot.robot.unit) {
            let mut seen = station.watch(unit)?;
            let station = station.clone();
            asked.push(tokio::spawn(timeout_at(until, async move {
                let _ = seen.wait_for(|snapshot| snapshot.state == State::Writable).await;
                let _ = station.send(unit, status);
                let _ = seen.wait_for(|snapshot| snapshot.status.is_some()).await;
            })));
        }
        for asked in asked {
            let _ = asked.await;
        }
        say(table(&station.snapshot()))?;
        Ok(())
    };
    tokio::select! {
        () = interrupt.wait() => Ok(()),
        listed = asking => listed,
    }
}

/// A line for each robot, in columns.
pub(super) fn table(snapshots: &[Snapshot]) -> String {
    let mut rows = vec![["unit", "name", "address", "state", "round trip", "status", ""].map(str::to_owned)];
    for snapshot in snapshots {
        let robot = &snapshot.robot;
        let end = match (&snapshot.last_end, snapshot.state.is_up()) {
            (Some(end), false) => end.to_string(),
            _ => String::new(),
        };
        rows.push([
            robot.unit.to_string(),
            robot.name.clone().unwrap_or_default(),
            robot.address.to_string(),
            snapshot.state.to_string(),
            snapshot.round_trip.map(millis).unwrap_or_default(),
            snapshot.status.map(|bits| bits.to_string()).unwrap_or_default(),
            end,
        ]);
    }
    let mut widths = [0; 7];
    for row in &rows {
        for (width, cell) in widths.iter_mut().zip(row) {
            *width = cell.chars().count().max(*width);
        }
    }
    let line = |row: &[String; 7]| {
        let cells: Vec<String> = row
            .iter()
            .zip(widths)
            .map(|(cell, width)| format!("{cell:width$}"))
            .collect();
        cells.join("  ").trim_end().to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a stop has overridden never leaves.
    #[test]
    fn what_is_overridden_is_not_waited_for() {
        let come = ToCome::default();
        let motor = |speed| Frame::new(&Command::MOTOR, &[speed, speed]).unwrap();
        come.sent(motor(1), Ok(Taken::Queued));
        come.sent(motor(2), Ok(Taken::Queued));
        come.sent(motor(0), Ok(Taken::Replaced(2)));
        assert!(!come.is_nothing());
        let note = Note::Sent(motor(0));
        come.take(&Entry {
            time: 0,
            unit: 1,
            note,
        })
        .unwrap();
        assert!(come.is_nothing());
        assert_eq!(come.refused.get(), 0);
    }
}
