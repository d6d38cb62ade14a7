//! A store that answers when it likes, and forgets what it may forget when its hub is killed.

use std::collections::BTreeMap;

use mom_hub::{Effect, Record, Ticket};
use mom_proto::Path;

/// What was written, and what of it is durable.
#[derive(Debug, Default)]
pub(crate) struct Disk {
    written: BTreeMap<Path, Vec<Write>>,
    due: Vec<Due>,
}

#[derive(Debug)]
struct Write {
    record: Record,
    ticket: Option<Ticket>,
    /// What was said of it.
    answered: Option<bool>,
}

#[derive(Debug)]
struct Due {
    step: usize,
    ticket: Ticket,
    ok: bool,
}

impl Disk {
    /// Takes a record in; the step at which it is answered, if that is awaited, and how.
    pub(crate) fn take(&mut self, effect: &Effect, step: usize, ok: bool) {
        let Effect::Store { record, ticket } = effect else {
            return;
        };
        let write = Write {
            record: record.clone(),
            ticket: *ticket,
            answered: None,
        };
        let written = self.written.entry(record.path.clone()).or_default();
        if let Some(ticket) = *ticket {
            assert!(
                written.iter().all(|other| other.ticket != Some(ticket)),
                "no ticket twice"
            );
            self.due.push(Due { step, ticket, ok });
        }
        written.push(write);
    }

    /// The next answer by this step.
    pub(crate) fn answer(&mut self, step: usize) -> Option<(Ticket, bool)> {
        let next = self.due.iter().position(|due| due.step <= step)?;
        let Due { ticket, ok, .. } = self.due.remove(next);
        let mut writes = self.written.values_mut().flatten();
        let write = writes.find(|write| write.ticket == Some(ticket)).unwrap();
        write.answered = Some(ok);
        Some((ticket, ok))
    }

    /// The token whose change waits, or waited, for an answer.
    pub(crate) fn path_of(&self, ticket: Ticket) -> Option<&Path> {
        let of = |write: &Write| write.ticket == Some(ticket);
        let mut written = self.written.iter();
        written
            .find(|(_, writes)| writes.iter().any(of))
            .map(|(path, _)| path)
    }

    /// Whether a change of this token waits for an answer.
    pub(crate) fn awaits(&self, path: &Path) -> bool {
        let open = |write: &Write| write.ticket.is_some() && write.answered.is_none();
        self.written
            .get(path)
            .is_some_and(|written| written.iter().any(open))
    }

    /// What is found after a kill: of each path the latest that was said to be durable, or a later one. With it
    /// the paths of which nothing was under way.
    pub(crate) fn survive(&self, luck: u64) -> (Vec<Record>, Vec<Path>) {
        let mut found = Vec::new();
        let mut settled = Vec::new();
        for (number, (path, written)) in self.written.iter().enumerate() {
            let sure = written.iter().rposition(|write| write.answered == Some(true));
            let least = sure.map_or(0, |sure| sure + 1);
            let more = written.len() - least;
            let more = usize::try_from(luck >> (number % 16 * 3)).unwrap() % (more + 1);
            let last = (least + more).checked_sub(1);
            found.extend(last.map(|last| written[last].record.clone()));
            let whole = |last: usize| last + 1 == written.len() && written[last].is_over();
            if last.is_none_or(whole) {
                settled.push(path.clone());
            }
        }
        (found, settled)
    }
}

impl Write {
    /// Whether it is what it says: not a change that may have happened or not.
    fn is_over(&self) -> bool {
        self.ticket.is_none() || self.answered == Some(true)
    }
}

/// The epoch of a hub that is started anew, where the clock helps nothing.
pub(crate) fn next_epoch(epoch: u64, records: &[Record]) -> u64 {
    let highest = records.iter().map(|record| record.fence >> 20).max();
    (epoch + 1).max(highest.unwrap_or_default() + 1)
}
