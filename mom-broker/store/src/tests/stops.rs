//! What is stopped, over restarts and between brokers of one configuration.

use std::fs;
use std::path::Path as FilePath;
use std::sync::Arc;

use mom_hub::{Latch, Stop, StopRecord, Ticket};
use tempfile::TempDir;

use super::*;
use crate::stops::{KeptStops, StopFile};

/// A channel whose newest stop has this number, and holds or was lifted.
fn record(channel: &str, number: u64, stopped: bool) -> StopRecord {
    let stop = Stop {
        number: number.into(),
        by: "bob".into(),
        user: "bob".into(),
        since: Time::default(),
        reason: None,
    };
    StopRecord {
        path: path(channel),
        latch: Latch {
            newest: number.into(),
            all: stopped.then(|| Arc::new(stop)),
            ..Latch::default()
        },
    }
}

fn open(folder: &FilePath) -> KeptStops {
    StopFile::open(folder, "stops").expect("it can be used")
}

/// The channels with their numbers; `!` = stopped.
fn words(kept: &KeptStops) -> Vec<String> {
    words_of(&kept.records)
}

fn words_of(records: &[StopRecord]) -> Vec<String> {
    let word = |record: &StopRecord| {
        let mark = if record.latch.is_stopped() { "!" } else { "" };
        format!("{} {}{mark}", record.path, u64::from(record.latch.newest))
    };
    records.iter().map(word).collect()
}

#[test]
fn a_broker_that_begins_before_the_older_one_has_ended_knows_its_stops() {
    let folder = TempDir::new().expect("a folder");
    let old = open(folder.path());
    old.file.keep(&record("/arm", 5, true), Some(Ticket(1)));
    let mut answers = old.answers;
    assert_eq!(answers.blocking_recv(), Some((Ticket(1), true)));
    let new = open(folder.path());
    assert_eq!(words(&new), ["/arm 5!"]);
    // Each goes on by itself; for the next one all holds that holds in one of both.
    for (file, number, channel, newest, stopped) in [
        (&old.file, 2, "/arm", 5, false),
        (&old.file, 3, "/belt", 7, true),
        (&new.file, 4, "/belt", 8, false),
        (&new.file, 5, "/crane", 9, true),
    ] {
        file.keep(&record(channel, newest, stopped), Some(Ticket(number)));
    }
    old.file.close();
    new.file.close();
    let next = open(folder.path());
    assert_eq!(words(&next), ["/arm 5!", "/belt 8!", "/crane 9!"]);
    assert!(
        !folder.path().join("stops-2.json").exists(),
        "all of it is in the first one"
    );
    next.file.keep(&record("/arm", 5, false), None);
    next.file.close();
    assert_eq!(words(&open(folder.path())), ["/arm 5", "/belt 8!", "/crane 9!"]);
}

#[test]
fn a_file_that_is_gone_or_damaged_is_not_one_that_never_was() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("stops.json");
    let first = open(folder.path());
    assert!(first.unread.is_none() && first.records.is_empty());
    first.file.close();
    fs::remove_file(&file).expect("it was there");
    let gone = open(folder.path());
    assert_eq!(gone.unread.as_deref(), Some("it is gone"));
    // What the broker has kept since is whole again.
    gone.file.keep(&record("/arm", 5, true), None);
    gone.file.close();
    let kept = open(folder.path());
    assert_eq!((words(&kept), kept.unread), (vec!["/arm 5!".to_owned()], None));
    kept.file.close();
    fs::write(folder.path().join("stops-2.json"), "mom-stops-1 00000000\n[]").expect("written");
    let damaged = open(folder.path());
    let reason = damaged.unread.expect("another one's may say anything");
    assert!(reason.contains("stops-2.json: its checksum is wrong"), "{reason}");
    assert_eq!(
        words_of(&damaged.records),
        ["/arm 5!"],
        "what can be read is known"
    );
    // The sign of it goes once all that holds is kept.
    assert!(folder.path().join("stops-2.json").exists());
    damaged.file.keep(&record("/belt", 6, true), None);
    damaged.file.close();
    assert!(folder.path().join("stops-2.damaged").exists());
    assert_eq!(open(folder.path()).unread, None, "it is told once");
}
