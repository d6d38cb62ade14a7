//! Changes of a fleet's file (W12, W14): its comments and its order stay.

use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};
use std::{fs, io};

use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, Value, value};

use crate::fleet::{Address, Fleet, FleetError, Robot, Unit};

/// So long another program may have the lock: an edit takes milliseconds.
const LOCK: Duration = Duration::from_secs(3);
const LOOK_AGAIN: Duration = Duration::from_millis(20);

/// What is to be changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Edit {
    /// There is one robot more.
    Add(Robot),
    /// A robot has other values.
    Change(Unit, Change),
    /// These robots are no more.
    Remove(Vec<Unit>),
}

/// The values of a robot that change; the others stay.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Change {
    /// Its unit number.
    pub unit: Option<Unit>,
    /// Where it listens.
    pub address: Option<Address>,
    /// What people call it; `Some(None)`: it has no name from now on.
    pub name: Option<Option<String>>,
    /// Its group; `Some(None)`: it has none from now on.
    pub group: Option<Option<String>>,
}

/// Why a fleet's file is not changed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EditError {
    /// It is wrong already.
    #[error("{0}")]
    Before(FleetError),
    /// It would be wrong.
    #[error("the result would be invalid, so nothing was changed: {0}")]
    After(FleetError),
    /// There is no such robot.
    #[error("there is no unit {0}")]
    NoUnit(Unit),
    /// Its robots are no `[[robot]]` tables.
    #[error(
        "its robots are one list, `robot = […]`, and no tables `[[robot]]`, which can be changed one by one"
    )]
    NoTables,
}

impl Edit {
    /// The text of a fleet's file after this; an empty one has no robots.
    ///
    /// ```
    /// use mom_base_station::edit::Edit;
    ///
    /// let file = "# Ours.\n\n[[robot]]\nunit = 1\naddress = \"[::1]:4001\"\n\n[[robot]]\nunit = 2\naddress = \"[::1]:4002\"\n";
    /// assert_eq!(Edit::Remove(vec![1]).apply(file)?, "# Ours.\n\n[[robot]]\nunit = 2\naddress = \"[::1]:4002\"\n");
    /// # Ok::<(), mom_base_station::edit::EditError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// A file that is wrong, or would be.
    pub fn apply(&self, text: &str) -> Result<String, EditError> {
        let is_new = text.trim().is_empty();
        if !is_new {
            Fleet::parse(text).map_err(EditError::Before)?;
        }
        // What was read before is TOML.
        let mut document: DocumentMut = text.parse().map_err(|_| EditError::NoTables)?;
        let robots = document
            .entry("robot")
            .or_insert(Item::ArrayOfTables(ArrayOfTables::new()));
        let robots = robots.as_array_of_tables_mut().ok_or(EditError::NoTables)?;
        let mut left = String::new();
        match self {
            Self::Add(robot) => robots.push(table(robot, is_new)),
            Self::Change(unit, change) => {
                let place = place(robots, *unit)?;
                if let Some(table) = robots.get_mut(place) {
                    change.apply(table);
                }
            }
            Self::Remove(units) => {
                for unit in units {
                    left.push_str(&remove(robots, place(robots, *unit)?));
                }
            }
        }
        if !left.is_empty() {
            let trailing = document.trailing().as_str().unwrap_or_default();
            document.set_trailing(format!("{left}{trailing}"));
        }
        let text = document.to_string();
        Fleet::parse(&text).map_err(EditError::After)?;
        Ok(text)
    }
}

impl Change {
    fn apply(&self, table: &mut Table) {
        if let Some(unit) = self.unit {
            set(table, "unit", i64::from(unit).into());
        }
        if let Some(address) = &self.address {
            set(table, "address", address.to_string().into());
        }
        for (key, word) in [("name", &self.name), ("group", &self.group)] {
            match word {
                None => {}
                Some(Some(word)) => set(table, key, word.as_str().into()),
                Some(None) => {
                    table.remove(key);
                }
            }
        }
    }
}

/// Sets a value; the comment behind it stays.
fn set(table: &mut Table, key: &str, new: Value) {
    match table.get_mut(key).and_then(Item::as_value_mut) {
        Some(old) => {
            let decor = old.decor().clone();
            *old = new;
            *old.decor_mut() = decor;
        }
        None => {
            table.insert(key, value(new));
        }
    }
}

/// A robot's table, with a blank line before it unless the file begins with it.
fn table(robot: &Robot, is_first: bool) -> Table {
    let mut table = Table::new();
    table.insert("unit", value(i64::from(robot.unit)));
    table.insert("address", value(robot.address.to_string()));
    for (key, word) in [("name", &robot.name), ("group", &robot.group)] {
        if let Some(word) = word {
            table.insert(key, value(word.as_str()));
        }
    }
    table.decor_mut().set_prefix(if is_first { "" } else { "\n" });
    table
}

fn place(robots: &ArrayOfTables, unit: Unit) -> Result<usize, EditError> {
    let is_it = |table: &Table| table.get("unit").and_then(Item::as_integer) == Some(i64::from(unit));
    robots.iter().position(is_it).ok_or(EditError::NoUnit(unit))
}

/// Removes a robot with the comment right above it. Gives what stands above that and had no robot to go to.
fn remove(robots: &mut ArrayOfTables, place: usize) -> String {
    let prefix = |table: &Table| {
        let prefix = table.decor().prefix().and_then(|prefix| prefix.as_str());
        prefix.unwrap_or_default().to_owned()
    };
    let above = robots.get(place).map(prefix).unwrap_or_default();
    // What a blank line parts from the table is not about it.
    let kept = above.rfind("\n\n").map_or("", |end| &above[..=end]).to_owned();
    robots.remove(place);
    match robots.get_mut(place) {
        Some(next) => {
            let own = prefix(next);
            let joined = match kept.is_empty() && place == 0 {
                // The file begins with it now.
                true => own.trim_start_matches('\n').to_owned(),
                false => format!("{kept}{own}"),
            };
            next.decor_mut().set_prefix(joined);
            String::new()
        }
        None => kept,
    }
}

/// Why a file was not changed.
#[derive(Debug, thiserror::Error)]
pub enum ChangeError {
    /// The system says so.
    #[error("{0}: {1}")]
    File(String, io::Error),
    /// The edit cannot be.
    #[error(transparent)]
    Edit(EditError),
}

/// Changes a fleet's file, and gives the fleet as it is then. Who changes it at the same time does so before or afterwards.
///
/// # Errors
///
/// A file that cannot be read, locked or written; a file that is wrong, or would be.
pub fn change(path: &Path, edit: &Edit) -> Result<Fleet, ChangeError> {
    let failed = |what: &str| {
        let text = format!("cannot {what} {}", path.display());
        move |error| ChangeError::File(text, error)
    };
    // The file itself is replaced, so its folder is locked.
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let lock = fs::File::open(folder.unwrap_or(Path::new(".")));
    let lock = lock.and_then(|folder| lock_within(&folder, LOCK).map(|()| folder));
    let _lock = lock.map_err(failed("lock the folder of"))?;
    let text = match edit {
        Edit::Add(_) if !path.exists() => String::new(),
        _ => read(path).map_err(failed("read"))?,
    };
    let text = edit.apply(&text).map_err(ChangeError::Edit)?;
    let fleet = Fleet::parse(&text).map_err(|error| ChangeError::Edit(EditError::After(error)))?;
    replace(path, &text).map_err(failed("write"))?;
    Ok(fleet)
}

/// The text of a fleet's file.
///
/// # Errors
///
/// What the system says; what is not a file, as a pipe or a device need not end; more than the longest file that says anything.
pub fn read(path: &Path) -> io::Result<String> {
    const MOST: u64 = 16 << 20;
    let known = fs::metadata(path)?;
    if !known.is_file() {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            "it is not a regular file",
        ));
    }
    if known.len() > MOST {
        let text = format!("it has {} bytes, and a fleet's file {MOST} at most", known.len());
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, text));
    }
    fs::read_to_string(path)
}

/// Locks, as soon as nobody else has the lock.
fn lock_within(folder: &fs::File, most: Duration) -> io::Result<()> {
    let until = Instant::now() + most;
    loop {
        match folder.try_lock() {
            Ok(()) => return Ok(()),
            Err(fs::TryLockError::WouldBlock) if Instant::now() < until => std::thread::sleep(LOOK_AGAIN),
            Err(fs::TryLockError::WouldBlock) => {
                let text = format!("another program has had the lock for {} s", most.as_secs());
                return Err(io::Error::new(io::ErrorKind::WouldBlock, text));
            }
            Err(fs::TryLockError::Error(error)) => return Err(error),
        }
    }
}

/// Writes a file whole or not at all; who may read it stays, and where a link leads.
///
/// # Errors
///
/// What the system says.
fn replace(path: &Path, text: &str) -> io::Result<()> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let mut new = tempfile::NamedTempFile::new_in(folder)?;
    new.write_all(text.as_bytes())?;
    let may = match fs::metadata(&target) {
        Ok(known) => known.permissions(),
        // As other new files are for who reads a fleet's file: it has no secrets.
        Err(_) => std::os::unix::fs::PermissionsExt::from_mode(0o644),
    };
    new.as_file().set_permissions(may)?;
    new.as_file().sync_all()?;
    new.persist(&target).map_err(|error| error.error)?;
    fs::File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "\
# The fleet of the hall.

# By the door.
[[robot]]
unit = 7
address = \"10.0.0.7:4000\" # the new one

[[robot]] # slow
unit = 2
name = \"Bob\"
group = \"scouts\"
address = \"10.0.0.2:4000\"
# The end.
";

    fn address(text: &str) -> Address {
        Address::parse(text).expect("an address")
    }

    fn robot(unit: Unit, at: &str) -> Edit {
        Edit::Add(Robot {
            unit,
            address: address(at),
            name: None,
            group: None,
        })
    }

    #[test]
    fn comments_and_order_stay() {
        let added = robot(3, "10.0.0.3:4000").apply(FILE).expect("it is free");
        let wanted = FILE.replace(
            "# The end.\n",
            "\n[[robot]]\nunit = 3\naddress = \"10.0.0.3:4000\"\n# The end.\n",
        );
        assert_eq!(added, wanted);

        let change = Change {
            address: Some(address("[::1]:4007")),
            name: Some(Some("Alice".to_owned())),
            ..Change::default()
        };
        let changed = Edit::Change(7, change).apply(FILE).expect("it is there");
        let line = "address = \"[::1]:4007\" # the new one\nname = \"Alice\"\n";
        assert_eq!(
            changed,
            FILE.replace("address = \"10.0.0.7:4000\" # the new one\n", line)
        );

        let change = Change {
            unit: Some(4),
            name: Some(None),
            group: Some(None),
            ..Change::default()
        };
        let changed = Edit::Change(2, change).apply(FILE).expect("it is there");
        let wanted = FILE.replace("unit = 2\nname = \"Bob\"\ngroup = \"scouts\"\n", "unit = 4\n");
        assert_eq!(changed, wanted);

        // What is above the whole file stays, and the robot's own comment goes with it.
        let removed = Edit::Remove(vec![7]).apply(FILE).expect("it is there");
        assert!(
            removed.starts_with("# The fleet of the hall.\n\n[[robot]] # slow\n"),
            "{removed}"
        );
        let removed = Edit::Remove(vec![2]).apply(FILE).expect("it is there");
        assert!(removed.ends_with("# the new one\n# The end.\n"), "{removed}");

        let first = robot(1, "localhost:1").apply("").expect("a first one");
        assert_eq!(first, "[[robot]]\nunit = 1\naddress = \"localhost:1\"\n");
        let second = robot(2, "localhost:2").apply(&first).expect("a second one");
        assert_eq!(
            second.trim_start_matches(&first),
            "\n[[robot]]\nunit = 2\naddress = \"localhost:2\"\n"
        );
    }

    #[test]
    fn what_is_wrong_or_would_be_changes_nothing() {
        for (edit, file, said) in [
            (
                robot(2, "localhost:1"),
                FILE,
                "the result would be invalid, so nothing was changed: line ",
            ),
            (
                robot(3, "10.0.0.2:4000"),
                FILE,
                "10.0.0.2:4000 is already the address of unit 2",
            ),
            (Edit::Remove(vec![2, 7]), FILE, "there is no `[[robot]]`"),
            (Edit::Remove(vec![9]), FILE, "there is no unit 9"),
            (Edit::Change(9, Change::default()), FILE, "there is no unit 9"),
            (
                Edit::Remove(vec![1]),
                "[[robot]]\nunit = 1\nadress = 4\n",
                "line 3, column 1: there is no key `adress`; did you mean `address`?",
            ),
            (Edit::Remove(vec![1]), "[[robot", "line 1, column"),
            (
                robot(3, "localhost:3"),
                "robot = [{ unit = 1, address = \"localhost:1\" }]",
                "its robots are one list",
            ),
        ] {
            let error = edit.apply(file).expect_err(said).to_string();
            assert!(error.contains(said), "{error}");
        }
    }

    #[test]
    fn a_file_is_replaced_whole_behind_its_link() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().expect("a folder");
        let (file, link) = (folder.path().join("fleet.toml"), folder.path().join("link"));
        fs::write(&file, "old").expect("it is written");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).expect("it is ours");
        std::os::unix::fs::symlink(&file, &link).expect("a link");
        replace(&link, "new").expect("it is replaced");
        assert_eq!(fs::read_to_string(&file).expect("it is there"), "new");
        assert_eq!(
            fs::metadata(&file).expect("it is there").permissions().mode() & 0o777,
            0o640
        );
        assert!(fs::symlink_metadata(&link).expect("it is there").is_symlink());
        assert_eq!(fs::read_dir(folder.path()).expect("it is there").count(), 2);
    }

    #[test]
    fn what_need_not_end_is_not_read_and_a_held_lock_is_not_waited_for_long() {
        let error = read(Path::new("/dev/zero")).expect_err("it has no end");
        assert!(error.to_string().contains("not a regular file"), "{error}");
        let folder = tempfile::tempdir().expect("a folder");
        let open = || fs::File::open(folder.path()).expect("it is there");
        let held = open();
        held.lock().expect("nobody else has it");
        let error = lock_within(&open(), Duration::from_millis(30)).expect_err("it is held");
        assert!(
            error.to_string().contains("another program has had the lock"),
            "{error}"
        );
        drop(held);
        lock_within(&open(), Duration::from_millis(30)).expect("it is free");
    }
}
