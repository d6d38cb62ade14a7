//! The view on a terminal: what happens goes in, and what keys ask for is done.

use std::time::Duration;

use crate::circuit::Taken;
use crate::fleet::Unit;
use crate::play::play;
use crate::script::Script;
use crate::station::{SendError, Station};
use anyhow::Result;
use mom_brs::Table;
use mom_pages::Interrupt;
use mom_screen::{Screen, keys};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc::{self, UnboundedSender};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

use super::view::{Asked, View};

/// The picture is drawn so often at most.
const PICTURE: Duration = Duration::from_millis(50);

/// Draws until a key or a signal ends it.
pub(super) async fn show(
    station: &Station,
    units: &[Unit],
    table: &'static Table,
    interrupt: &mut Interrupt,
    playing: &mut JoinSet<()>,
) -> Result<()> {
    let mut changes = station.subscribe();
    let mut view = View::new(station.snapshot());
    let mut screen = Screen::take()?;
    let mut keys = keys();
    let (tell, mut told) = mpsc::unbounded_channel();
    let mut second = interval(Duration::from_secs(1));
    second.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut picture = interval(PICTURE);
    picture.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut drawn = false;
    loop {
        let asked = tokio::select! {
            () = interrupt.wait() => return Ok(()),
            Some(event) = keys.recv() => {
                drawn = false;
                view.on_event(&event?)
            }
            entry = changes.recv() => {
                match entry {
                    Ok(entry) => view.take(&entry),
                    Err(RecvError::Lagged(_)) => {}
                    Err(RecvError::Closed) => return Ok(()),
                }
                drawn = false;
                continue;
            }
            Some(line) = told.recv() => {
                view.say(line);
                drawn = false;
                continue;
            }
            _ = second.tick() => view.on_second(),
            _ = picture.tick(), if !drawn => {
                view.update(station.snapshot());
                screen.terminal.draw(|frame| view.draw(frame))?;
                drawn = true;
                continue;
            }
            Some(_) = playing.join_next(), if !playing.is_empty() => continue,
        };
        match asked {
            Asked::Nothing => {}
            Asked::Quit => return Ok(()),
            Asked::ConnectAll => station.connect_all(),
            Asked::Disconnect(unit) => {
                playing.spawn(part(station.clone(), unit, tell.clone()));
            }
            Asked::Halt => {
                // What scripts would still say is not said.
                playing.shutdown().await;
                playing.spawn(halt(station.clone(), tell.clone()));
            }
            Asked::Send(line) => match Script::parse(&line, units, table) {
                Err(error) => view.say(error.to_string()),
                Ok(script) => {
                    playing.spawn(carry_out(station.clone(), script, tell.clone()));
                }
            },
        }
    }
}

async fn halt(station: Station, tell: UnboundedSender<String>) {
    for unit in station.halt().await {
        let _ = tell.send(format!("unit {unit} has not confirmed its stop"));
    }
}

async fn part(station: Station, unit: Unit, tell: UnboundedSender<String>) {
    let said = match station.part(unit).await {
        Ok(true) => return,
        Ok(false) => format!("unit {unit} has not confirmed its stop, and is disconnected"),
        Err(error) => error.to_string(),
    };
    let _ = tell.send(said);
}

async fn carry_out(station: Station, script: Script, tell: UnboundedSender<String>) {
    let sent = |_, sent: Result<Taken, SendError>| {
        if let Err(error) = sent {
            let _ = tell.send(error.to_string());
        }
    };
    if let Err(failed) = play(&station, script, sent).await {
        let _ = tell.send(failed.to_string());
    }
}
