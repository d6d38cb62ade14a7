//! kill -9 in the midst of commits, in a process of its own.

use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use mom_hub::Ticket;
use tempfile::TempDir;

use super::{at, owned};
use crate::Store;

/// The directory of the child's store; the test that is the child does nothing without it.
const STATE: &str = "MOM_TEST_STORE";

const TOKENS: u64 = 7;

/// The process that is killed: grants without end, and says which of them were acknowledged.
#[test]
fn child() {
    let Some(state) = std::env::var_os(STATE).map(PathBuf::from) else {
        return;
    };
    let mut opened = Store::open(&state, at(0)).expect("it opens");
    let mut out = std::io::stdout();
    let grant = |number: u64| {
        let token = format!("/token/{}", number % TOKENS);
        opened.store.put(owned(&token, number), Some(Ticket(number)));
    };
    // The numbers of a later child are higher.
    let first = opened.epoch * 1000 * TOKENS;
    (first..first + TOKENS).for_each(grant);
    loop {
        let (Ticket(number), ok) = opened.answers.blocking_recv().expect("the store lives");
        assert!(ok);
        writeln!(out, "acknowledged {number}").expect("the parent listens");
        grant(number + TOKENS);
    }
}

/// Threat 30: every acknowledged record is there after kill -9.
#[test]
fn acknowledged_records_outlive_a_kill() {
    let folder = TempDir::new().expect("a folder");
    let mut newest = [None; TOKENS as usize];
    for round in 0..3 {
        let mut child = Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "tests::crash::child", "--nocapture"])
            .env(STATE, folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .expect("it runs");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let mut hear = |most: usize| {
            let numbers = lines.by_ref().map_while(Result::ok).filter_map(|line| {
                let number = line.split("acknowledged ").nth(1)?;
                number.parse::<u64>().ok()
            });
            numbers
                .take(most)
                .map(|number| newest[(number % TOKENS) as usize] = Some(number))
                .count()
        };
        assert_eq!(hear(40), 40, "it was not killed yet");
        child.kill().expect("SIGKILL");
        hear(usize::MAX);
        child.wait().expect("it ended");

        let opened = Store::open(folder.path(), at(0)).expect("it opens");
        for (token, acknowledged) in newest.iter().enumerate() {
            let path = format!("/token/{token}");
            let record = opened.records.iter().find(|record| record.path.as_str() == path);
            assert!(
                record.map(|record| record.fence) >= *acknowledged,
                "{path} after round {round}"
            );
        }
        // Its lock is free for the next child when its lanes have ended.
        tokio::runtime::Builder::new_current_thread()
            .build()
            .expect("a runtime")
            .block_on(opened.store.close());
    }
}
