//! The files of a store: what a start finds in them, and damage of every kind.

use std::fs;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;

use mom_hub::{Record, Ticket};
use tempfile::TempDir;

use super::{at, free, holder, owned};
use crate::disk::{Disk, LaneFile, LaneImage, lane_file};
use crate::row::LaneMeta;
use crate::{LANES, Opened, Store, StoreError};

const NOW: i64 = 1_795_000_000;
const DAY: i64 = 86_400;

fn folder() -> (TempDir, PathBuf) {
    let folder = TempDir::new().expect("a folder");
    let state = folder.path().join("var/state");
    (folder, state)
}

fn open(state: &FilePath) -> Opened {
    Store::open(state, at(NOW)).expect("it opens")
}

/// Puts awaited records and waits until they are durable.
fn keep(opened: &mut Opened, records: &[Record]) {
    for (ticket, record) in records.iter().enumerate() {
        opened.store.put(record.clone(), Some(Ticket(ticket as u64)));
        let answer = opened.answers.blocking_recv();
        assert_eq!(answer, Some((Ticket(ticket as u64), true)));
    }
}

fn close(opened: &Opened) {
    tokio::runtime::Builder::new_current_thread()
        .build()
        .expect("a runtime")
        .block_on(opened.store.close());
}

/// The files as they would be after a crash now.
fn crash_image(state: &FilePath) -> TempDir {
    let image = TempDir::new().expect("a folder");
    for file in fs::read_dir(state).expect("a folder") {
        let file = file.expect("an entry").path();
        let name = file.file_name().expect("a name");
        fs::copy(&file, image.path().join(name)).expect("copied");
    }
    image
}

#[test]
fn records_outlive_the_broker() {
    let (_folder, state) = folder();
    let mut first = open(&state);
    assert_eq!((first.epoch, first.records.len()), (NOW as u64, 0));
    let mode = fs::metadata(&state).expect("there").permissions().mode();
    assert_eq!(mode & 0o777, 0o700);
    let mode = fs::metadata(lane_file(&state, 0))
        .expect("there")
        .permissions()
        .mode();
    assert_eq!(mode & 0o777, 0o600);
    let alices = owned("/arm/token", (NOW as u64) << 20 | 3);
    let changing = Record {
        before: Some(holder("bob")),
        lease: None,
        ..owned("/camera", (NOW as u64) << 20 | 9)
    };
    let freed = free("/drone", (NOW as u64) << 20 | 2);
    keep(
        &mut first,
        &[
            owned("/arm/token", 1),
            owned("/drone", 2),
            changing.clone(),
            alices.clone(),
        ],
    );
    first.store.put(freed.clone(), None);
    close(&first);

    let second = open(&state);
    assert_eq!(second.epoch, NOW as u64 + 1, "although the clock stands");
    assert_eq!(second.records, [alices.clone(), changing.clone(), freed]);
    close(&second);
    // From what is free nothing is left to know: the epoch is above its fence.
    let third = open(&state);
    assert_eq!(third.records, [alices, changing]);
}

/// Threat 30: what a killed broker had acknowledged is there, and an older row in another lane never wins.
#[test]
fn records_outlive_a_crash() {
    let (_folder, state) = folder();
    let mut store = open(&state);
    let tokens = ["/a", "/b", "/c"];
    for fence in 1..=20 {
        keep(&mut store, &tokens.map(|token| owned(token, fence)));
        let image = crash_image(&state);
        let found = open(image.path());
        assert_eq!(found.records, tokens.map(|token| owned(token, fence)));
    }
}

/// No clock brings fences down.
#[test]
fn the_epoch_rises_with_every_start() {
    let (_folder, state) = folder();
    let start = |now: i64, expected: i64| {
        let store = Store::open(&state, at(now)).expect("it opens");
        assert_eq!(store.epoch, expected as u64, "at {now}");
        close(&store);
    };
    start(NOW, NOW);
    start(NOW + 100, NOW + 100);
    start(NOW - 15 * DAY, NOW + 101);
    let years = NOW + 3650 * DAY;
    start(years, years);
    start(NOW, years + 1);
    start(-1, years + 2);
    // More grants than an epoch has numbers run into the next ones.
    let mut store = open(&state);
    let far = (years as u64 + 50) << 20 | 1;
    keep(&mut store, &[owned("/a", far)]);
    close(&store);
    start(NOW, years + 51);
    // The epoch is durable before anybody can be granted anything: a crash right after the start keeps it.
    let _store = open(&state);
    let image = crash_image(&state);
    assert_eq!(open(image.path()).epoch, years as u64 + 53);
}

#[test]
fn a_clock_beyond_all_fences_is_refused() {
    let (_folder, state) = folder();
    let refused = Store::open(&state, at(1 << 33)).map(drop);
    assert!(matches!(refused, Err(StoreError::Clock { .. })), "{refused:?}");
    assert_eq!(
        Store::open(&state, at((1 << 33) - 1)).expect("the last").epoch,
        (1 << 33) - 1
    );
}

#[test]
fn a_directory_has_one_broker() {
    let (_folder, state) = folder();
    let store = open(&state);
    let second = Store::open(&state, at(NOW)).map(drop).expect_err("in use");
    assert!(matches!(&second, StoreError::InUse { path } if *path == state));
    assert!(second.to_string().contains("another broker"), "{second}");
    close(&store);
    assert!(Store::open(&state, at(NOW)).is_ok());
}

#[test]
fn a_directory_that_cannot_be() {
    let (folder, _) = folder();
    let file = folder.path().join("file");
    fs::write(&file, "x").expect("written");
    for path in [file.clone(), file.join("state")] {
        let refused = Store::open(&path, at(NOW)).map(drop).expect_err("no directory");
        assert!(matches!(refused, StoreError::Directory { .. }), "{refused:?}");
        assert!(
            refused.to_string().contains(&path.display().to_string()),
            "{refused}"
        );
    }
}

/// A store with records in all lanes, as a crash leaves it, and the tokens that are in it.
fn used() -> (TempDir, Vec<Record>) {
    let (_folder, state) = folder();
    let mut store = open(&state);
    let records: Vec<_> = (0..40)
        .map(|token| owned(&format!("/token/{token:02}"), token + 1))
        .collect();
    keep(&mut store, &records);
    keep(&mut store, &records);
    (crash_image(&state), records)
}

/// Threat 29: damage is reported with the file's name, and never cut.
#[test]
fn damaged_files_are_refused() {
    type Damage = fn(&FilePath, &FilePath) -> io::Result<()>;
    let damages: [(&str, Damage); 8] = [
        ("was lost", |file, _| fs::remove_file(file)),
        ("not hold", |file, _| fs::write(file, "")),
        ("not hold", |file, _| fs::write(file, "no database")),
        ("not hold", |file, _| fs::write(file, vec![0; 1 << 16])),
        ("not hold", |file, _| {
            let whole = fs::read(file)?;
            fs::write(file, &whole[..whole.len() / 2])
        }),
        ("not hold", |file, _| {
            let whole = fs::read(file)?;
            fs::write(file, &whole[..whole.len() - 1])
        }),
        ("lane 0 of 4", |file, other| fs::copy(other, file).map(drop)),
        ("old copy", |file, _| {
            let old = file.with_extension("old");
            fs::rename(old, file)
        }),
    ];
    for (words, damage) in damages {
        let (state, records) = used();
        let file = lane_file(state.path(), 2);
        // The file as it is now, and then something new in all lanes.
        fs::copy(&file, file.with_extension("old")).expect("copied");
        close(&open(state.path()));
        damage(&file, &lane_file(state.path(), 0)).expect("damaged");
        for attempt in 0..2 {
            let refused = Store::open(state.path(), at(NOW)).map(drop).expect_err(words);
            assert!(
                matches!(&refused, StoreError::Damaged { file: named, .. } if *named == file),
                "{attempt}: {refused:?}"
            );
            let said = refused.to_string();
            for part in [
                words,
                "lane-2.redb",
                "longest lease",
                &state.path().display().to_string(),
            ] {
                assert!(said.contains(part), "{part} in {said}");
            }
        }
        assert_eq!(records.len(), 40);
    }
}

/// A record that another lane could not keep may come late; it never goes over a newer one.
#[test]
fn an_older_record_does_not_replace_a_newer() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("lane.redb");
    LaneFile::make(&file).expect("made");
    let (mut lane, _) = LaneFile::open(&file).expect("it opens");
    for sequence in [5, 3, 6, 4] {
        let meta = LaneMeta {
            lane: 0,
            epoch: 1,
            seen: vec![6],
        };
        let record = Arc::new(owned("/a", sequence));
        lane.write(&meta, &[(sequence, record)], &[]).expect("written");
    }
    drop(lane);
    let (_, image) = LaneFile::open(&file).expect("it opens");
    assert_eq!(
        image.rows.into_values().collect::<Vec<_>>(),
        [(6, owned("/a", 6))]
    );
}

/// Threat 29: a flipped bit is found, or it was in nothing that counts.
#[test]
fn flipped_bits_are_not_believed() {
    let folder = TempDir::new().expect("a folder");
    let [file, crashed, flipped] = ["lane", "crashed", "flipped"].map(|name| folder.path().join(name));
    LaneFile::make(&file).expect("made");
    let (mut lane, _) = LaneFile::open(&file).expect("it opens");
    for round in 1..4 {
        let record = |token| (round, Arc::new(owned(&format!("/token/{token}"), round)));
        let records: Vec<_> = (0..200).map(record).collect();
        let meta = LaneMeta {
            lane: 0,
            epoch: round,
            seen: vec![round],
        };
        lane.write(&meta, &records, &[]).expect("written");
    }
    fs::copy(&file, &crashed).expect("copied");
    drop(lane);

    let look = |bytes: &[u8]| -> Result<LaneImage, StoreError> {
        fs::write(&flipped, bytes).expect("written");
        LaneFile::open(&flipped).map(|(_, image)| image)
    };
    let mut found = 0;
    for file in [&crashed, &file] {
        let whole = fs::read(file).expect("readable");
        let right = look(&whole).expect("undamaged");
        assert_eq!(right.rows.len(), 200);
        let used: Vec<usize> = (0..whole.len()).filter(|at| whole[*at] != 0).collect();
        // Where a page says what it is and how much of it counts, and samples of the rest.
        let heads = used.iter().filter(|at| **at % 4096 < 4);
        for at in heads.chain(used.iter().step_by(used.len() / 100)).copied() {
            let mut flipped = whole.clone();
            flipped[at] ^= 1 << (at % 8);
            match look(&flipped) {
                Ok(image) => assert_eq!(
                    (&image.rows, &image.meta),
                    (&right.rows, &right.meta),
                    "byte {at}"
                ),
                Err(StoreError::Damaged { .. }) => found += 1,
                Err(error) => panic!("byte {at}: {error}"),
            }
        }
    }
    // The files hold three rounds, of which one counts.
    assert!(found > 15, "{found} flips found");
}

/// The record of a grant covers more grants than it names, and those may run into the next second's numbers.
#[test]
fn the_epoch_is_above_what_was_given_out_without_a_record() {
    let (_folder, state) = folder();
    let mut opened = open(&state);
    let last = (opened.epoch << 20) + (1 << 20) - 1;
    let record = owned("/a", last);
    let given = record.last_fence();
    keep(&mut opened, &[record]);
    close(&opened);
    drop(opened);
    let again = open(&state);
    assert!(again.epoch << 20 > given, "{} {given}", again.epoch);
}

/// Tokens that come by the thousand and go again: what the files hold of them goes too while they are open, and the next
/// start finds what is still owned.
#[test]
fn what_is_free_takes_no_room_while_it_runs() {
    const TOKENS: u64 = 16_000;
    let (_folder, state) = folder();
    let mut opened = open(&state);
    let first = opened.epoch << 20;
    let length = |lane| fs::metadata(lane_file(&state, lane)).expect("there").len();
    let size = || (0..LANES).map(length).sum::<u64>();
    let path = |token: u64| format!("/of/a/length/as/they/are/in/robots/{token}");
    keep(&mut opened, &[owned("/kept", first)]);
    for token in 1..=TOKENS {
        let record = owned(&path(token), first + token);
        opened.store.put(record, Some(Ticket(token)));
    }
    for _ in 0..TOKENS {
        assert!(opened.answers.blocking_recv().expect("an answer").1);
    }
    let most = size();
    for token in 1..=TOKENS {
        opened.store.put(free(&path(token), first + token), None);
    }
    let mut commits = 0;
    while size() > most / 2 {
        commits += 1;
        assert!(commits < 10_000, "{} of {most} bytes are left", size());
        keep(&mut opened, &[owned("/busy", first + TOKENS + commits)]);
    }
    close(&opened);
    drop(opened);
    let again = open(&state);
    let owned = again.records.iter().filter(|record| record.owner.is_some());
    let owned: Vec<&str> = owned.map(|record| record.path.as_str()).collect();
    assert!(matches!(owned[..], ["/busy", "/kept"] | ["/kept"]), "{owned:?}");
    assert!(
        again.records.len() < TOKENS as usize / 2,
        "{} rows",
        again.records.len()
    );
}
