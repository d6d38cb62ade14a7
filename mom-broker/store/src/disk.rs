//! What one lane writes to: a file of the embedded database, or what a test puts in its place.

use std::collections::BTreeMap;
use std::fs::Permissions;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path as FilePath, PathBuf};

use mom_hub::Record;
use mom_proto::Path;
use redb::{
    Builder, Database, DatabaseError, ReadableDatabase, ReadableTable, ReadableTableMetadata,
    TableDefinition, TableError,
};

use super::StoreError;
use super::queue::Numbered;
use super::quiet;
use super::row::{self, LaneMeta};

/// The latest record of each token, by path.
const TOKENS: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("tokens");
/// The lane's own row.
const LANE: TableDefinition<'_, &str, &[u8]> = TableDefinition::new("lane");
const META: &str = "meta";

/// All that a lane holds is small; the rest of the cache would only be memory.
const CACHE: usize = 4 * 1024 * 1024;

/// Rows that are removed before it is looked whether a file could be smaller.
const MANY_GONE: u64 = 1024;

/// A file of this size is small enough.
const SMALL: u64 = 256 * 1024;

/// Bytes of a file per row, with which it is worth the while to make it smaller: some four times what a row takes.
const PER_ROW: u64 = 1024;

/// Something that makes records durable.
pub(super) trait Disk: Send {
    /// Makes a change durable, all of it or nothing. A record that is older than what the disk has of its token
    /// is passed over. After an error the disk is not used again: whether the change is there is not known, and
    /// a second fsync would tell nothing about the first.
    ///
    /// # Errors
    /// What the system says.
    fn write(&mut self, meta: &LaneMeta, records: &[Numbered], gone: &[Path]) -> io::Result<()>;

    /// Gives space back that was taken by what is gone, if there is much of it.
    ///
    /// # Errors
    /// What the system says; the disk is not used again.
    fn shrink(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// All that a lane holds.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneImage {
    /// None in a lane that was never written to.
    pub(super) meta: Option<LaneMeta>,
    pub(super) rows: BTreeMap<Path, (u64, Record)>,
}

/// A lane's file.
pub(super) struct LaneFile {
    file: PathBuf,
    database: Database,
    /// Rows that were removed since the file was made smaller.
    gone: u64,
}

impl LaneFile {
    /// Makes an empty file, whole or not at all.
    pub(super) fn make(file: &FilePath) -> Result<(), StoreError> {
        let new = file.with_extension("new");
        // One that was left by a crash at this place holds nothing.
        match std::fs::remove_file(&new) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(unwritable(&new, &error)),
            _ => {}
        }
        let made = builder().create(&new).map_err(|error| unwritable(&new, &error))?;
        drop(made);
        let mine = Permissions::from_mode(0o600);
        std::fs::set_permissions(&new, mine).map_err(|error| unwritable(&new, &error))?;
        std::fs::rename(&new, file).map_err(|error| unwritable(file, &error))
    }

    /// Opens a file and looks at every page of it.
    pub(super) fn open(file: &FilePath) -> Result<(LaneFile, LaneImage), StoreError> {
        // The database asserts what it expects of its pages in debug builds; that too is only damage.
        let opened = quiet::catch(|| LaneFile::open_checked(file));
        opened.unwrap_or_else(|| Err(damaged(file, "its pages are inconsistent")))
    }

    fn open_checked(file: &FilePath) -> Result<(LaneFile, LaneImage), StoreError> {
        let judge = |error: redb::Error| match error {
            redb::Error::DatabaseAlreadyOpen => StoreError::InUse {
                path: file.to_owned(),
            },
            // What has no number of the system is the database's own word for a file that is none of its own.
            redb::Error::Io(error) if error.raw_os_error().is_some() => unwritable(file, &error),
            error => damaged(
                file,
                &format!("it does not hold what was written to it ({error})"),
            ),
        };
        let mut database = builder().open(file).map_err(|error| judge(error.into()))?;
        // Pages are checked at a repair only, and what is not looked at now would be believed later.
        match database.check_integrity() {
            Ok(true) => {}
            Ok(false) => tracing::warn!(file = %file.display(), "free space was recounted"),
            Err(DatabaseError::Storage(error)) => return Err(judge(error.into())),
            Err(error) => return Err(judge(error.into())),
        }
        let lane = LaneFile {
            file: file.to_owned(),
            database,
            gone: 0,
        };
        let image = lane.read().map_err(|error| match error {
            Unread::Database(error) => judge(*error),
            Unread::Row(reason) => damaged(file, &reason),
        })?;
        Ok((lane, image))
    }

    fn read(&self) -> Result<LaneImage, Unread> {
        let mut image = LaneImage::default();
        let read = self.database.begin_read()?;
        match read.open_table(LANE) {
            Ok(table) => {
                let meta = table.get(META)?;
                let meta = meta.map(|row| LaneMeta::decode(META, row.value())).transpose();
                image.meta = meta.map_err(Unread::Row)?;
            }
            Err(TableError::TableDoesNotExist(_)) => {}
            Err(error) => return Err(error.into()),
        }
        match read.open_table(TOKENS) {
            Ok(table) => {
                for row in table.iter()? {
                    let (key, row) = row?;
                    let (sequence, record) = row::decode(key.value(), row.value()).map_err(Unread::Row)?;
                    image.rows.insert(record.path.clone(), (sequence, record));
                }
            }
            Err(TableError::TableDoesNotExist(_)) => {}
            Err(error) => return Err(error.into()),
        }
        Ok(image)
    }

    fn rows(&self) -> Result<u64, redb::Error> {
        Ok(self.database.begin_read()?.open_table(TOKENS)?.len()?)
    }

    fn change(&self, meta: &LaneMeta, records: &[Numbered], gone: &[Path]) -> Result<(), Unread> {
        let mut write = self.database.begin_write()?;
        // With one phase a damaged last commit looks like one that a crash tore, and the one before it would
        // silently be taken for the last. With two the database reports it.
        write.set_two_phase_commit(true);
        {
            let mut tokens = write.open_table(TOKENS)?;
            for (sequence, record) in records {
                let path = record.path.as_str();
                let known = tokens.get(path)?.map(|row| row::decode(path, row.value()));
                let known = known.transpose().map_err(Unread::Row)?;
                if known.is_none_or(|(known, _)| known < *sequence) {
                    tokens.insert(path, row::encode(*sequence, record).as_slice())?;
                }
            }
            for path in gone {
                tokens.remove(path.as_str())?;
            }
            let mut lane = write.open_table(LANE)?;
            lane.insert(META, meta.encode(META).as_slice())?;
        }
        Ok(write.commit()?)
    }
}

impl Disk for LaneFile {
    fn write(&mut self, meta: &LaneMeta, records: &[Numbered], gone: &[Path]) -> io::Result<()> {
        self.change(meta, records, gone).map_err(|error| match error {
            Unread::Database(error) => match *error {
                redb::Error::Io(error) => error,
                error => io::Error::other(error),
            },
            Unread::Row(reason) => io::Error::new(io::ErrorKind::InvalidData, reason),
        })?;
        self.gone = self.gone.saturating_add(gone.len() as u64);
        Ok(())
    }

    fn shrink(&mut self) -> io::Result<()> {
        if self.gone < MANY_GONE {
            return Ok(());
        }
        // Moving what stays costs as much as there is of it, so it is done once for as much that went.
        let rows = self.rows().map_err(io::Error::other)?;
        if self.gone < rows {
            return Ok(());
        }
        self.gone = 0;
        if std::fs::metadata(&self.file).map_or(0, |known| known.len()) <= SMALL.max(rows * PER_ROW) {
            return Ok(());
        }
        self.database.compact().map(|_| ()).map_err(io::Error::other)
    }
}

/// What keeps a table from being read or written.
enum Unread {
    Database(Box<redb::Error>),
    Row(String),
}

impl<E: Into<redb::Error>> From<E> for Unread {
    fn from(error: E) -> Unread {
        Unread::Database(Box::new(error.into()))
    }
}

fn builder() -> Builder {
    let mut builder = Builder::new();
    builder.set_cache_size(CACHE);
    builder
}

/// The file of a lane.
pub(super) fn lane_file(directory: &FilePath, lane: usize) -> PathBuf {
    directory.join(format!("lane-{lane}.redb"))
}

pub(super) fn damaged(file: &FilePath, reason: &str) -> StoreError {
    StoreError::Damaged {
        file: file.to_owned(),
        reason: reason.to_owned(),
    }
}

pub(super) fn unwritable(file: &FilePath, reason: &dyn std::fmt::Display) -> StoreError {
    StoreError::Unwritable {
        file: file.to_owned(),
        reason: reason.to_string(),
    }
}
