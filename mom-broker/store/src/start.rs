//! Opening a store: what all lanes hold together, the new epoch, and what is not needed any more.

use std::collections::BTreeMap;
use std::fs::{DirBuilder, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::Path as FilePath;

use mom_hub::Record;
use mom_proto::{Fence, Path, Time};

use super::StoreError;
use super::disk::{Disk, LaneFile, LaneImage, damaged, lane_file, unwritable};
use super::row::LaneMeta;
use super::rows::is_free;

/// A directory that no other broker uses, for as long as this lives.
#[derive(Debug)]
pub(super) struct Lock {
    file: File,
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing would do, but for a process that is just being made and has all files of this one until it
        // becomes its own program. What fails here is closed all the same.
        let _ = self.file.unlock();
    }
}

/// What a store held, and what its lanes go on with.
pub(super) struct Begun {
    pub(super) lock: Lock,
    pub(super) lanes: Vec<LaneFile>,
    pub(super) found: Found,
}

/// What the lanes hold together.
#[derive(Debug)]
pub(super) struct Found {
    /// The epoch from now on.
    pub(super) epoch: u64,
    /// The latest record of each token.
    pub(super) records: Vec<Record>,
    /// The last sequence of each lane.
    pub(super) seen: Vec<u64>,
    /// The rows that stay: of which token, in which lane, with which sequence.
    pub(super) kept: Vec<(Path, usize, u64)>,
    /// Per lane the rows that another lane has newer.
    old: Vec<Vec<Path>>,
    /// Per lane the latest records that nobody owns: the new epoch is above their fences, so there is nothing
    /// left to know from them.
    free: Vec<Vec<Path>>,
}

/// A lane that cannot be right, and why.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Wrong {
    pub(super) lane: usize,
    pub(super) reason: String,
}

/// Opens the lanes of a directory, or makes them, and makes the new epoch durable in each.
pub(super) fn begin(directory: &FilePath, lanes: usize, wall: Time) -> Result<Begun, StoreError> {
    let lock = lock(directory)?;
    let mut opened = Vec::new();
    let mut images = Vec::new();
    let files: Vec<_> = (0..lanes).map(|lane| lane_file(directory, lane)).collect();
    for file in files.iter().filter(|file| !file.exists()) {
        LaneFile::make(file)?;
    }
    sync(directory).map_err(|error| unwritable(directory, &error))?;
    for file in &files {
        let (lane, image) = LaneFile::open(file)?;
        opened.push(lane);
        images.push(image);
    }
    let mut found =
        Found::of(&images).map_err(|wrong| damaged(&lane_file(directory, wrong.lane), &wrong.reason))?;
    found.epoch = found.epoch.max(seconds(wall));
    if found.epoch > Fence::MAX_EPOCH {
        return Err(StoreError::Clock { epoch: found.epoch });
    }
    found
        .settle(&mut opened)
        .map_err(|(lane, error)| unwritable(&lane_file(directory, lane), &error))?;
    Ok(Begun {
        lock,
        lanes: opened,
        found,
    })
}

impl Found {
    /// Takes the images of all lanes together: per token the record of the highest sequence holds. The epoch is
    /// the least that is above all that was ever given out.
    pub(super) fn of(images: &[LaneImage]) -> Result<Found, Wrong> {
        check(images)?;
        let mut latest: BTreeMap<&Path, (usize, u64, &Record)> = BTreeMap::new();
        let mut old = vec![Vec::new(); images.len()];
        for (lane, image) in images.iter().enumerate() {
            for (path, (sequence, record)) in &image.rows {
                let here = (lane, *sequence, record);
                match latest.insert(path, here) {
                    Some(other) if other.1 > *sequence => {
                        old[lane].push(path.clone());
                        latest.insert(path, other);
                    }
                    Some((other, ..)) => old[other].push(path.clone()),
                    None => {}
                }
            }
        }
        let mut free = vec![Vec::new(); images.len()];
        let mut kept = Vec::new();
        for (path, (lane, sequence, record)) in &latest {
            match is_free(record) {
                true => free[*lane].push((*path).clone()),
                false => kept.push(((*path).clone(), *lane, *sequence)),
            }
        }
        let metas = || images.iter().filter_map(|image| image.meta.as_ref());
        let fences = images.iter().flat_map(|image| image.rows.values());
        let after_fences = fences
            .map(|(_, record)| Fence::from(record.last_fence()).epoch() + 1)
            .max();
        let after_epochs = metas().map(|meta| meta.epoch.saturating_add(1)).max();
        Ok(Found {
            epoch: after_fences.max(after_epochs).unwrap_or_default(),
            records: latest
                .into_values()
                .map(|(_, _, record)| record.clone())
                .collect(),
            seen: images.iter().map(last).collect(),
            kept,
            old,
            free,
        })
    }

    /// Makes the epoch durable in each lane and removes what is not needed.
    ///
    /// Older rows go everywhere before a latest one goes anywhere, so that a crash between the two cannot bring an
    /// older one back. In the second round each lane learns that the others have begun: a file that is
    /// missing later was there.
    pub(super) fn settle<D: Disk>(&mut self, lanes: &mut [D]) -> Result<(), (usize, io::Error)> {
        let mut sequence = self.seen.iter().copied().max().unwrap_or_default();
        for gone in [&self.old, &self.free] {
            for (lane, disk) in lanes.iter_mut().enumerate() {
                sequence += 1;
                let mut meta = LaneMeta {
                    lane,
                    epoch: self.epoch,
                    seen: self.seen.clone(),
                };
                meta.seen[lane] = sequence;
                disk.write(&meta, &[], &gone[lane])
                    .map_err(|error| (lane, error))?;
                self.seen[lane] = sequence;
            }
        }
        Ok(())
    }
}

/// Whether the lanes belong together, and none of them ends before what another has seen of it.
fn check(images: &[LaneImage]) -> Result<(), Wrong> {
    let wrong = |lane, reason| Err(Wrong { lane, reason });
    for (lane, image) in images.iter().enumerate() {
        let highest = image.rows.values().map(|(sequence, _)| *sequence).max();
        match &image.meta {
            Some(meta) if meta.lane != lane || meta.seen.len() != images.len() => {
                let (mine, of) = (meta.lane, meta.seen.len());
                return wrong(
                    lane,
                    format!("it is lane {mine} of {of}, and not what its name says"),
                );
            }
            _ if highest.unwrap_or_default() > last(image) => {
                return wrong(lane, "it holds records from after its last commit".to_owned());
            }
            _ => {}
        }
    }
    for (witness, image) in images.iter().enumerate() {
        let seen = image.meta.iter().flat_map(|meta| meta.seen.iter().enumerate());
        for (lane, seen) in seen {
            let last = last(&images[lane]);
            if last < *seen {
                let missing = "it was lost, emptied, or an old copy was put in its place";
                let reason = format!(
                    "it ends at commit {last}, but lane {witness} has seen its commit {seen}; {missing}"
                );
                return wrong(lane, reason);
            }
        }
    }
    Ok(())
}

fn last(image: &LaneImage) -> u64 {
    image.meta.as_ref().map(LaneMeta::last).unwrap_or_default()
}

pub(super) fn seconds(wall: Time) -> u64 {
    u64::try_from(wall.micros() / 1_000_000).unwrap_or_default()
}

/// Makes the directory if it is not there, for this user alone, and keeps others away from it.
fn lock(directory: &FilePath) -> Result<Lock, StoreError> {
    let failed = |error| StoreError::Directory {
        path: directory.to_owned(),
        error,
    };
    make_directory(directory).map_err(failed)?;
    let mode = std::fs::metadata(directory).map_err(failed)?.permissions().mode();
    if mode & 0o077 != 0 {
        tracing::warn!(
            directory = %directory.display(),
            mode = format!("{:o}", mode & 0o777),
            "[store] others can look into the directory; it holds users' names, so better mode 700"
        );
    }
    let file = directory.join("lock");
    let file = File::options()
        .write(true)
        .create(true)
        .truncate(false)
        .open(file)
        .map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(Lock { file }),
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse {
            path: directory.to_owned(),
        }),
        Err(TryLockError::Error(error)) => Err(failed(error)),
    }
}

/// Makes a directory if it is not there, for this user alone.
pub(super) fn make_directory(directory: &FilePath) -> io::Result<()> {
    let there = directory.exists();
    DirBuilder::new().mode(0o700).recursive(true).create(directory)?;
    match directory.parent() {
        _ if there => Ok(()),
        Some(parent) if parent.as_os_str().is_empty() => sync(FilePath::new(".")),
        Some(parent) => sync(parent),
        None => Ok(()),
    }
}

/// Makes the entries of a directory durable.
pub(super) fn sync(directory: &FilePath) -> io::Result<()> {
    File::open(directory)?.sync_all()
}
