//! Scripts on a station (W16): what the interpreter says, at its times.

use mom_brs::Frame;
use tokio::sync::broadcast::error::TryRecvError;
use tokio::task::yield_now;

use crate::circuit::{Note, Taken};
use crate::log::Entry;
use crate::script::{Action, Interpreter, NoReply, Script};
use crate::station::{SendError, Station};

/// Carries out a script. What became of each command is told to `sent`; where one is refused the script goes on. One for
/// whose robot as much waits as may wait is tried again for up to a second. To drop the future is to break off the script,
/// which stops no robot.
///
/// # Errors
///
/// A reply that the script waits for did not come.
pub async fn play(
    station: &Station,
    script: Script,
    mut sent: impl FnMut(Frame, Result<Taken, SendError>),
) -> Result<(), NoReply> {
    let mut changes = station.subscribe();
    let mut interpreter = Interpreter::new(script, station.now());
    loop {
        loop {
            match changes.try_recv() {
                Ok(entry) => tell(&mut interpreter, &entry),
                // A reply may be among what was missed: then the script waits for it in vain, which it says.
                Err(TryRecvError::Lagged(_)) => {}
                Err(TryRecvError::Empty | TryRecvError::Closed) => break,
            }
        }
        match interpreter.poll(station.now()) {
            Action::Send(unit, frame) => {
                sent(frame, station.send_in_turn(unit, frame).await);
                // The robots' tasks get their turns however much a script says at once.
                yield_now().await;
            }
            Action::Wait(until) => {
                tokio::select! {
                    () = station.sleep_until(until) => {}
                    entry = changes.recv() => {
                        if let Ok(entry) = entry {
                            tell(&mut interpreter, &entry);
                        }
                    }
                }
            }
            Action::Done => return Ok(()),
            Action::Failed(failed) => return Err(failed),
        }
    }
}

fn tell(interpreter: &mut Interpreter, entry: &Entry) {
    if let Note::Received(reply, _) = &entry.note {
        interpreter.replied(entry.unit, reply);
    }
}
