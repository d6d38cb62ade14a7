//! The terminal as a whole, for programs that draw on it and take keys.

use std::mem::ManuallyDrop;
use std::{io, thread};

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event};
use tokio::sync::mpsc;

/// The terminal, which is as it was before when this is dropped.
#[derive(Debug)]
pub struct Screen {
    /// Draws. It is never dropped: it would insist on telling a terminal that is gone that it is, and panic.
    pub terminal: ManuallyDrop<DefaultTerminal>,
}

impl Screen {
    /// Takes the terminal: raw keys, and a screen beside the one with its lines.
    ///
    /// # Errors
    ///
    /// Standard output is not a terminal, or cannot be set.
    pub fn take() -> io::Result<Screen> {
        let terminal = ManuallyDrop::new(ratatui::try_init()?);
        Ok(Screen { terminal })
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // Nobody could be told on this terminal.
        let _ = self.terminal.show_cursor();
        let _ = ratatui::try_restore();
    }
}

/// What is typed, read by a thread of its own that lasts as long as the program; it ends with the first error.
#[must_use]
pub fn keys() -> mpsc::UnboundedReceiver<io::Result<Event>> {
    let (sender, receiver) = mpsc::unbounded_channel();
    thread::spawn(move || {
        loop {
            let event = event::read();
            let failed = event.is_err();
            if sender.send(event).is_err() || failed {
                return;
            }
        }
    });
    receiver
}
