//! `mom-broker passwd`: a password's hash, for the users file.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

#[derive(clap::Args)]
pub(super) struct PasswdArgs {
    /// The user's name.
    user: String,
    /// The users file to change; without it the entry is printed.
    #[arg(long)]
    users: Option<PathBuf>,
}

pub(super) fn run(args: &PasswdArgs) -> Result<()> {
    let user = args.user.as_str();
    mom_proto::check_name(user)?;
    let password = match std::env::var("MOM_PASSWORD") {
        Ok(password) => password,
        Err(_) => rpassword::prompt_password(format!("Password for {user}: ")).or_else(|_| read_line())?,
    };
    if password.is_empty() {
        bail!("an empty password lets anybody in; nothing was changed");
    }
    let hash = mom_broker::hash(&password).map_err(anyhow::Error::msg)?;
    let Some(file) = &args.users else {
        writeln!(
            std::io::stdout(),
            "[[users]]\nname = \"{user}\"\npassword = \"{hash}\"\nlevel = 0\ngroups = []"
        )?;
        return Ok(());
    };
    let text = match std::fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", file.display())),
    };
    let (text, what) = set_password(&text, user, &hash).with_context(|| format!("in {}", file.display()))?;
    replace(file, &text)?;
    writeln!(std::io::stdout(), "{what} {user} in {}", file.display())?;
    Ok(())
}

fn read_line() -> std::io::Result<String> {
    let mut line = String::new();
    std::io::stdin().read_line(&mut line)?;
    Ok(line.trim_end_matches(['\r', '\n']).to_owned())
}

/// The users file with a new password; comments and order stay.
fn set_password(text: &str, user: &str, hash: &str) -> Result<(String, &'static str)> {
    let mut document: toml_edit::DocumentMut = text.parse().context("this is no TOML")?;
    let users = document
        .entry("users")
        .or_insert(toml_edit::ArrayOfTables::new().into());
    let users = users
        .as_array_of_tables_mut()
        .context("users is not a list of [[users]] tables")?;
    let known = users
        .iter_mut()
        .find(|entry| entry.get("name").and_then(|name| name.as_str()) == Some(user));
    let what = match known {
        Some(entry) => {
            entry["password"] = toml_edit::value(hash);
            "changed the password of"
        }
        None => {
            let mut entry = toml_edit::Table::new();
            entry["name"] = toml_edit::value(user);
            entry["password"] = toml_edit::value(hash);
            entry["level"] = toml_edit::value(0);
            entry["groups"] = toml_edit::value(toml_edit::Array::new());
            users.push(entry);
            "added"
        }
    };
    Ok((document.to_string(), what))
}

/// Writes a file whole or not at all.
fn replace(file: &Path, text: &str) -> Result<()> {
    let new = file.with_extension("new");
    let permissions = std::fs::metadata(file).map(|known| known.permissions()).ok();
    std::fs::write(&new, text).with_context(|| format!("cannot write {}", new.display()))?;
    if let Some(permissions) = permissions {
        std::fs::set_permissions(&new, permissions)?;
    }
    std::fs::rename(&new, file).with_context(|| format!("cannot replace {}", file.display()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passwords_are_changed_in_place() {
        let text = "# staff\n[[users]]\nname = \"alice\" # boss\npassword = \"old\"\nlevel = 5\n";
        let (changed, what) = set_password(text, "alice", "new").unwrap();
        assert_eq!(changed, text.replace("\"old\"", "\"new\""));
        assert_eq!(what, "changed the password of");
        let (added, what) = set_password(text, "bob", "hash").unwrap();
        assert!(
            added.starts_with(text) && added.contains("name = \"bob\"\npassword = \"hash\""),
            "{added}"
        );
        assert_eq!(what, "added");
        assert!(set_password("users = 1", "bob", "hash").is_err());
    }
}
