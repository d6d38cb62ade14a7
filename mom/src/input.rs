//! Standard input, line by line, beside everything else.

use std::fs;
use std::io::{self, BufRead as _, Read as _};
use std::thread;

use tokio::sync::mpsc;

/// Lines that may wait to be sent; a faster writer of our input has to wait.
const WAITING: usize = 64;

/// The lines of standard input, without their ends; closed at the end of input.
///
/// They are read by a thread of their own: a read from a terminal cannot be cancelled, and the program's end
/// must not wait for one more line.
pub(crate) fn lines() -> mpsc::Receiver<io::Result<String>> {
    let (sender, receiver) = mpsc::channel(WAITING);
    thread::spawn(move || {
        for line in io::stdin().lock().lines() {
            if sender.blocking_send(line).is_err() {
                break;
            }
        }
    });
    receiver
}

/// The whole text of a file, or of standard input for `-`.
pub(crate) fn text(file: &str) -> io::Result<String> {
    if file != "-" {
        return fs::read_to_string(file);
    }
    let mut text = String::new();
    io::stdin().lock().read_to_string(&mut text)?;
    Ok(text)
}
