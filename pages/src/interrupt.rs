//! What asks a program to end, as something to wait for: programs of devices halt first.

use std::io;

use tokio::signal::unix::{Signal, SignalKind, signal};

/// All ways to ask a program to end in order: Ctrl-C, SIGTERM, a terminal that is closed (SIGHUP) and Ctrl-\ (SIGQUIT).
#[derive(Debug)]
pub struct Interrupt {
    interrupt: Signal,
    terminate: Signal,
    quit: Signal,
    /// None where SIGHUP does not ask it to end.
    hangup: Option<Signal>,
}

impl Interrupt {
    /// From now on none of them ends the program by itself. One that was started by `nohup` goes on at SIGHUP.
    ///
    /// # Errors
    ///
    /// The system does not let it listen for them.
    pub fn install() -> io::Result<Interrupt> {
        // Before it is listened for, which would undo it.
        let hangup = match ignores_hangup() {
            true => None,
            false => Some(signal(SignalKind::hangup())?),
        };
        let rest = Interrupt::install_but_hangup()?;
        Ok(Interrupt { hangup, ..rest })
    }

    /// The same for a program to which SIGHUP says something else.
    ///
    /// # Errors
    ///
    /// As [`Interrupt::install`].
    pub fn install_but_hangup() -> io::Result<Interrupt> {
        Ok(Interrupt {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            quit: signal(SignalKind::quit())?,
            hangup: None,
        })
    }

    /// Waits until the program is asked to end. Cancel safe.
    pub async fn wait(&mut self) {
        let hangup = async {
            match &mut self.hangup {
                Some(hangup) => hangup.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            _ = self.quit.recv() => {}
            _ = hangup => {}
        }
    }
}

/// Whether the program was started so that SIGHUP is ignored, as by `nohup`. Where the system does not say so, it is not.
fn ignores_hangup() -> bool {
    std::fs::read_to_string("/proc/self/status").is_ok_and(|status| is_ignored(&status))
}

/// SIGHUP is the first of the signals.
fn is_ignored(status: &str) -> bool {
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mask_says_what_is_ignored() {
        for (status, ignored) in [
            ("Name:\tx\nSigIgn:\t0000000000000001\n", true),
            ("SigIgn:\t0000000000001001\n", true),
            ("SigIgn:\t0000000000001000\nSigCgt:\t0000000000000001\n", false),
            ("SigIgn:\tx\n", false),
            ("", false),
        ] {
            assert_eq!(is_ignored(status), ignored, "{status}");
        }
    }
}
