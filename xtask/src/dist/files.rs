//! Files with the modes that they are installed with, whatever this machine's own habit is.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

/// Writes a file, with the folders above it.
pub(super) fn put(to: &Path, text: &str, mode: u32) -> Result<()> {
    make_above(to)?;
    fs::write(to, text).with_context(|| format!("{} cannot be written", to.display()))?;
    set_mode(to, mode)
}

/// Copies a file, with the folders above it; one that is there already only gets its mode.
pub(super) fn copy(from: &Path, to: &Path, mode: u32) -> Result<()> {
    if from != to {
        make_above(to)?;
        fs::copy(from, to)
            .with_context(|| format!("{} cannot be copied to {}", from.display(), to.display()))?;
    }
    set_mode(to, mode)
}

fn set_mode(file: &Path, mode: u32) -> Result<()> {
    fs::set_permissions(file, fs::Permissions::from_mode(mode))
        .with_context(|| format!("{} cannot be given the mode {mode:o}", file.display()))
}

fn make_above(file: &Path) -> Result<()> {
    file.parent().map_or(Ok(()), fs::create_dir_all)?;
    Ok(())
}

/// Lets everybody look into a folder and those below it.
pub(super) fn open(folder: &Path) -> Result<()> {
    set_mode(folder, 0o755)?;
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            open(&path)?;
        }
    }
    Ok(())
}

/// All files in a folder and those below it, in the order of their names.
pub(super) fn kept(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).with_context(|| format!("{} cannot be read", folder.display()))? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.push(path);
            }
        }
    }
    files.sort();
    Ok(files)
}
