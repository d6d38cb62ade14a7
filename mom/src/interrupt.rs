//! What asks a program to end (Ctrl-C, SIGTERM, a closed terminal, Ctrl-\) as something to wait for, where a command has to clean up first.

use std::io;

/// All ways to ask a program to end.
pub(crate) struct Interrupt {
    #[cfg(unix)]
    interrupt: tokio::signal::unix::Signal,
    #[cfg(unix)]
    terminate: tokio::signal::unix::Signal,
    #[cfg(unix)]
    hangup: tokio::signal::unix::Signal,
    /// Started by `nohup`, it goes on without its terminal.
    #[cfg(unix)]
    ignores_hangup: bool,
    #[cfg(unix)]
    quit: tokio::signal::unix::Signal,
}

impl Interrupt {
    /// From now on none of them ends anything by itself.
    pub(crate) fn install() -> io::Result<Interrupt> {
        #[cfg(unix)]
        {
            use tokio::signal::unix::{SignalKind, signal};
            // Before it is listened for.
            let ignores_hangup = mom_pages::ignores_hangup();
            Ok(Interrupt {
                ignores_hangup,
                hangup: signal(SignalKind::hangup())?,
                quit: signal(SignalKind::quit())?,
                interrupt: signal(SignalKind::interrupt())?,
                terminate: signal(SignalKind::terminate())?,
            })
        }
        #[cfg(not(unix))]
        Ok(Interrupt {})
    }

    /// Waits until the program is asked to end. Cancel safe.
    pub(crate) async fn wait(&mut self) {
        #[cfg(unix)]
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
            _ = self.hangup.recv(), if !self.ignores_hangup => {}
            _ = self.quit.recv() => {}
        }
        // Without a handler there is nothing to wait for, and the system ends the program itself.
        #[cfg(not(unix))]
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}
