//! `mom keygen`: a key pair for a device, so that it needs no password.

use std::fs::{self, OpenOptions};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use mom_client::Key;
use serde_json::json;

use crate::cli::{self, GlobalArgs};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::style::{Tone, ink};

pub(crate) fn run(args: &cli::KeygenArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let key = Key::generate().doing("make a key")?;
    let file = args.out.display();
    write(&args.out, &key.to_pem(), args.force).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => Failure::usage(
            format!("{file} exists, and may hold a key that is in use"),
            "choose another file with --out FILE, or replace it with --force",
        ),
        _ => Failure::plain(format!("cannot write {file}: {error}")),
    })?;
    let public = key.public();
    let user = global.user.as_deref().filter(|user| !user.is_empty());
    let line = format!("keys = [\"{public}\"]");
    output.remark(format!(
        "{}  the private key; it stays here and is readable by you only\n\n{}\n",
        ink(&file, Tone::Strong),
        match user {
            Some(user) => format!("In the hub's users file, below name = \"{user}\":"),
            None => "In the hub's users file, below the name of the device:".to_owned(),
        },
    ));
    output.tell(
        || json!({"file": args.out.to_string_lossy(), "public": public}),
        || line.clone(),
    )?;
    let user = user.unwrap_or("NAME");
    output.remark(format!(
        "\nWhen the hub has read it:\n\n  mom --user {user} --key {file} tree"
    ));
    Ok(())
}

/// Writes the file whole or not at all, for this user only.
fn write(file: &Path, pem: &str, force: bool) -> io::Result<()> {
    if !force {
        return write_new(file, pem);
    }
    let mut name = file.as_os_str().to_owned();
    name.push(".new");
    let new = PathBuf::from(name);
    write_new(&new, pem)?;
    fs::rename(&new, file).inspect_err(|_| drop(fs::remove_file(&new)))
}

/// Writes a new file that its owner alone may read.
pub(super) fn write_new(file: &Path, pem: &str) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    // From the first byte on, not afterwards.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut open = options.open(file)?;
    let written = open.write_all(pem.as_bytes()).and_then(|()| open.sync_all());
    written.inspect_err(|_| drop(fs::remove_file(file)))
}
