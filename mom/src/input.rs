//! Standard input, line by line, beside everything else.

use std::fs;
use std::future::pending;
use std::io::{self, BufRead as _, IsTerminal as _, Read as _};
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

/// Answers to occasional questions, one line each.
///
/// At a terminal a line counts only if a question is open when it comes: a second Enter must not answer the next
/// question. Lines from elsewhere were written in advance, so they wait.
pub(crate) struct Answers {
    lines: Option<mpsc::Receiver<io::Result<String>>>,
    ahead: Option<io::Result<String>>,
    waits: bool,
}

impl Answers {
    /// Those on standard input.
    pub(crate) fn new() -> Answers {
        Answers::of(lines(), !io::stdin().is_terminal())
    }

    /// No answers at all.
    pub(crate) fn none() -> Answers {
        Answers {
            lines: None,
            ahead: None,
            waits: false,
        }
    }

    fn of(lines: mpsc::Receiver<io::Result<String>>, waits: bool) -> Answers {
        Answers {
            lines: Some(lines),
            ahead: None,
            waits,
        }
    }

    /// Whether there may be some.
    pub(crate) fn is_open(&self) -> bool {
        self.lines.is_some()
    }

    /// The answer to the open question, if there is one; `None` at the end of input. Cancel safe.
    pub(crate) async fn next(&mut self, asked: bool) -> Option<io::Result<String>> {
        loop {
            if asked && let Some(line) = self.ahead.take() {
                return Some(line);
            }
            let lines = match (&mut self.lines, &self.ahead) {
                (Some(lines), None) => lines,
                // Nothing to say now.
                _ => return pending().await,
            };
            match lines.recv().await {
                Some(line) if asked => return Some(line),
                Some(line) => self.ahead = Some(line).filter(|_| self.waits),
                None => {
                    self.lines = None;
                    return None;
                }
            }
        }
    }
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

#[cfg(test)]
mod tests {
    use tokio::sync::mpsc::Sender;

    use super::*;

    async fn answers(waits: bool, lines: &[&str]) -> (Answers, Sender<io::Result<String>>) {
        let (sender, receiver) = mpsc::channel(WAITING);
        for line in lines {
            sender.send(Ok((*line).to_owned())).await.unwrap();
        }
        (Answers::of(receiver, waits), sender)
    }

    /// The next answer, if there is one now.
    async fn now(answers: &mut Answers, asked: bool) -> Option<Option<String>> {
        tokio::select! {
            biased;
            answer = answers.next(asked) => Some(answer.map(|line| line.unwrap())),
            () = std::future::ready(()) => None,
        }
    }

    #[tokio::test]
    async fn a_line_at_a_terminal_answers_only_what_is_asked() {
        let (mut answers, sender) = answers(false, &["y", "y"]).await;
        assert_eq!(now(&mut answers, false).await, None);
        assert_eq!(now(&mut answers, true).await, None, "passed over");
        sender.send(Ok("n".to_owned())).await.unwrap();
        assert_eq!(now(&mut answers, true).await, Some(Some("n".to_owned())));
    }

    #[tokio::test]
    async fn lines_written_before_wait_for_their_questions() {
        let (mut answers, sender) = answers(true, &["y", "n"]).await;
        drop(sender);
        assert_eq!(now(&mut answers, false).await, None);
        assert_eq!(now(&mut answers, true).await, Some(Some("y".to_owned())));
        assert_eq!(now(&mut answers, true).await, Some(Some("n".to_owned())));
        assert!(answers.is_open());
        assert_eq!(
            now(&mut answers, false).await,
            Some(None),
            "the end is heard of at once"
        );
        assert_eq!(now(&mut answers, true).await, None, "and once");
        assert!(!answers.is_open());
    }
}
