//! `mom-broker passwd`: a password's hash, for the users file.

use std::io::Write;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

#[derive(clap::Args)]
pub(super) struct PasswdArgs {
    /// The user's name.
    user: String,
    /// The users file to change; without it the entry is printed.
    #[arg(long)]
    users: Option<PathBuf>,
    /// Put the user into this group, too; may be repeated.
    #[arg(long = "group", value_name = "NAME")]
    groups: Vec<String>,
}

pub(super) fn run(args: &PasswdArgs) -> Result<()> {
    let user = args.user.as_str();
    mom_proto::check_name(user)?;
    let password = match std::env::var("MOM_PASSWORD") {
        Ok(password) => password,
        Err(_) => rpassword::prompt_password(format!("Password for {user}: ")).or_else(|_| read_line())?,
    };
    if password.is_empty() {
        bail!("an empty password would let anyone log in; nothing was changed");
    }
    let hash = mom_broker::hash(&password).map_err(anyhow::Error::msg)?;
    let Some(file) = &args.users else {
        let (entry, _) = set_password("", user, &hash, &args.groups)?;
        write!(std::io::stdout(), "{entry}")?;
        return Ok(());
    };
    let text = match std::fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
    };
    let (text, what) =
        set_password(&text, user, &hash, &args.groups).with_context(|| format!("in {}", file.display()))?;
    replace(file, &text)?;
    writeln!(std::io::stdout(), "{what} {user} in {}", file.display())?;
    Ok(())
}

fn read_line() -> std::io::Result<String> {
    let mut line = String::new();
    std::io::stdin().read_line(&mut line)?;
    Ok(line.trim_end_matches(['\r', '\n']).to_owned())
}

/// The users file with a new password of the user, who is in these groups too; comments and order stay.
fn set_password(text: &str, user: &str, hash: &str, groups: &[String]) -> Result<(String, &'static str)> {
    let mut document: toml_edit::DocumentMut = text.parse().context("this is not TOML")?;
    let users = document
        .entry("users")
        .or_insert(toml_edit::ArrayOfTables::new().into());
    let users = users
        .as_array_of_tables_mut()
        .context("users is not a list of [[users]] tables")?;
    let named = |entry: &toml_edit::Table| entry.get("name").and_then(|name| name.as_str()) == Some(user);
    let known = users.iter().position(named);
    let (place, what) = match known {
        Some(place) => (place, "changed the password of"),
        None => {
            let mut entry = toml_edit::Table::new();
            entry["name"] = toml_edit::value(user);
            entry["password"] = toml_edit::value("");
            entry["level"] = toml_edit::value(0);
            entry["groups"] = toml_edit::value(toml_edit::Array::new());
            users.push(entry);
            (users.len() - 1, "added")
        }
    };
    let entry = users.get_mut(place).context("the user has an entry")?;
    entry["password"] = toml_edit::value(hash);
    for group in groups {
        let known = entry
            .entry("groups")
            .or_insert(toml_edit::value(toml_edit::Array::new()));
        let known = known
            .as_array_mut()
            .with_context(|| format!("the groups of {user} are not a list"))?;
        if !known.iter().any(|known| known.as_str() == Some(group)) {
            known.push(group);
        }
    }
    Ok((document.to_string(), what))
}

/// Writes a file whole or not at all. Who may read it stays, so that root may change the file of a broker that is not root's.
fn replace(file: &Path, text: &str) -> Result<()> {
    let new = file.with_extension("new");
    let known = std::fs::metadata(file).ok();
    let written = || -> std::io::Result<()> {
        let mut to = std::fs::File::create(&new)?;
        if let Some(known) = &known {
            // Before there is anything to read in it.
            std::os::unix::fs::fchown(&to, Some(known.uid()), Some(known.gid()))?;
            to.set_permissions(known.permissions())?;
        }
        to.write_all(text.as_bytes())
    };
    written().with_context(|| format!("cannot write {} as {} is", new.display(), file.display()))?;
    std::fs::rename(&new, file).with_context(|| format!("cannot replace {}", file.display()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passwords_are_changed_in_place() {
        let text = "# staff\n[[users]]\nname = \"alice\" # boss\npassword = \"old\"\nlevel = 5\n";
        let (changed, what) = set_password(text, "alice", "new", &[]).unwrap();
        assert_eq!(changed, text.replace("\"old\"", "\"new\""));
        assert_eq!(what, "changed the password of");
        let (added, what) = set_password(text, "bob", "hash", &[]).unwrap();
        assert!(
            added.starts_with(text) && added.contains("name = \"bob\"\npassword = \"hash\""),
            "{added}"
        );
        assert_eq!(what, "added");
        assert!(set_password("users = 1", "bob", "hash", &[]).is_err());
    }

    #[test]
    fn groups_are_added_once_and_others_stay() {
        let groups = ["admin".to_owned(), "staff".to_owned()];
        let (added, _) = set_password("", "alice", "hash", &groups).unwrap();
        assert!(added.contains(r#"groups = ["admin", "staff"]"#), "{added}");
        assert_eq!(set_password(&added, "alice", "hash", &groups).unwrap().0, added);
        let text = "[[users]]\nname = \"bob\"\ngroups = [\"device\"]\n";
        let (changed, _) = set_password(text, "bob", "hash", &groups[..1]).unwrap();
        assert!(changed.contains(r#"groups = ["device", "admin"]"#), "{changed}");
    }

    #[test]
    fn who_may_read_the_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("users.toml");
        std::fs::write(&file, "").unwrap();
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o640);
        std::fs::set_permissions(&file, mode).unwrap();
        // Only root may give a file away.
        let given = std::os::unix::fs::chown(&file, None, Some(12)).is_ok();
        replace(&file, "# new\n").unwrap();
        let after = std::fs::metadata(&file).unwrap();
        assert_eq!(after.mode() & 0o777, 0o640);
        assert!(!given || after.gid() == 12);
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "# new\n");
    }
}
