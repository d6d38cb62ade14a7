//! The files of a checkout, read once and given to every check; in tests, a few lines of text.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

use super::rust_text::RustText;

/// The files by their path from the root of the checkout, with `/` between the parts.
pub(crate) struct Tree {
    root: PathBuf,
    files: BTreeMap<String, File>,
}

struct File {
    text: String,
    /// Several checks look at the same source, and telling its parts apart is most of their work.
    rust: OnceCell<RustText>,
}

impl From<String> for File {
    fn from(text: String) -> File {
        File {
            text,
            rust: OnceCell::new(),
        }
    }
}

/// Folders that begin with a dot hold the tools' own things, save these.
const DOT_FOLDERS: &[&str] = &[".cargo", ".ci", ".github"];
/// Folders of things fetched or built.
const SKIPPED_FOLDERS: &[&str] = &["node_modules", "__pycache__", "dist"];

impl Tree {
    /// Reads the checkout at `root`. What is built is left out: cargo marks its folders with a `CACHEDIR.TAG`.
    pub(crate) fn read(root: &Path) -> Result<Tree> {
        let mut tree = Tree {
            root: root.to_path_buf(),
            files: BTreeMap::new(),
        };
        tree.read_folder(root, "")?;
        Ok(tree)
    }

    #[cfg(test)]
    pub(crate) fn of(files: &[(&str, &str)]) -> Tree {
        let files = files
            .iter()
            .map(|(path, text)| ((*path).to_owned(), File::from((*text).to_owned())))
            .collect();
        Tree {
            root: PathBuf::from("."),
            files,
        }
    }

    /// Where the checkout lies.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    pub(crate) fn len(&self) -> usize {
        self.files.len()
    }

    /// The text of a file; bytes that are no UTF-8 are replaced.
    pub(crate) fn text(&self, path: &str) -> Option<&str> {
        self.files.get(path).map(|file| file.text.as_str())
    }

    /// The parts of a file, as Rust source.
    pub(crate) fn rust_text(&self, path: &str) -> Option<&RustText> {
        let file = self.files.get(path)?;
        Some(file.rust.get_or_init(|| RustText::new(&file.text)))
    }

    /// All files with their text, in the order of their paths.
    pub(crate) fn files(&self) -> impl Iterator<Item = (&str, &str)> {
        self.files
            .iter()
            .map(|(path, file)| (path.as_str(), file.text.as_str()))
    }

    /// The files whose name ends in `.` and one of `extensions`.
    pub(crate) fn with_extension(&self, extensions: &[&str]) -> impl Iterator<Item = (&str, &str)> {
        self.files().filter(move |(path, _)| {
            path.rsplit_once('.')
                .is_some_and(|(_, extension)| extensions.contains(&extension))
        })
    }

    /// Whether there is a file or a folder with this path; the empty path is the root.
    pub(crate) fn exists(&self, path: &str) -> bool {
        if path.is_empty() || self.files.contains_key(path) {
            return true;
        }
        let folder = format!("{path}/");
        self.files
            .range(folder.clone()..)
            .next()
            .is_some_and(|(file, _)| file.starts_with(&folder))
    }

    fn read_folder(&mut self, folder: &Path, prefix: &str) -> Result<()> {
        let cannot = || format!("{} cannot be read", folder.display());
        for entry in fs::read_dir(folder).with_context(cannot)? {
            let entry = entry.with_context(cannot)?;
            let kind = entry.file_type().with_context(cannot)?;
            let Ok(name) = entry.file_name().into_string() else {
                continue;
            };
            let path = format!("{prefix}{name}");
            // In a worktree `.git` is a file, and names the checkout that it belongs to.
            if kind.is_file() && name != ".git" {
                self.read_file(&entry.path(), path)?;
            } else if kind.is_dir() && !is_skipped(&entry.path(), &name) {
                self.read_folder(&entry.path(), &format!("{path}/"))?;
            }
        }
        Ok(())
    }

    fn read_file(&mut self, file: &Path, path: String) -> Result<()> {
        match fs::read(file) {
            Ok(bytes) => {
                self.files
                    .insert(path, String::from_utf8_lossy(&bytes).into_owned().into());
                Ok(())
            }
            // An editor may have removed its temporary file since the folder was listed.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(error).with_context(|| format!("{} cannot be read", file.display())),
        }
    }
}

fn is_skipped(folder: &Path, name: &str) -> bool {
    (name.starts_with('.') && !DOT_FOLDERS.contains(&name))
        || SKIPPED_FOLDERS.contains(&name)
        || folder.join("CACHEDIR.TAG").is_file()
}

/// The line, from 1, that holds the byte at `offset`.
pub(crate) fn line_at(text: &str, offset: usize) -> usize {
    1 + text
        .as_bytes()
        .iter()
        .take(offset)
        .filter(|byte| **byte == b'\n')
        .count()
}

/// The folder part of a path, without the last `/`.
pub(crate) fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// `path` as seen from `folder`, with `.` and `..` resolved; nothing if it leads out of the checkout.
pub(crate) fn join(folder: &str, path: &str) -> Option<String> {
    let mut parts: Vec<&str> = folder.split('/').filter(|part| !part.is_empty()).collect();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop()?;
            }
            part => parts.push(part),
        }
    }
    Some(parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkout_is_read_without_what_is_built_or_hidden() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let tree = Tree::read(root).unwrap();
        assert!(
            tree.text("src/tidy/tree.rs")
                .unwrap()
                .contains("fn a_checkout_is_read")
        );
        assert!(is_skipped(root, ".git") && is_skipped(root, "node_modules"));
        assert!(!is_skipped(root, ".ci") && !is_skipped(root, "src"));
    }

    #[test]
    fn folders_exist_with_their_files() {
        let tree = Tree::of(&[("a/b.rs", ""), ("ab.rs", "")]);
        for (path, expected) in [
            ("a", true),
            ("a/b.rs", true),
            ("", true),
            ("b", false),
            ("a/b", false),
        ] {
            assert_eq!(tree.exists(path), expected, "{path}");
        }
    }

    #[test]
    fn paths_are_joined_inside_the_checkout_only() {
        for (folder, path, expected) in [
            ("docs", "../README.md", Some("README.md")),
            ("docs", "a/./b.md", Some("docs/a/b.md")),
            ("", "x.md", Some("x.md")),
            ("docs", "../../x", None),
        ] {
            assert_eq!(join(folder, path).as_deref(), expected, "{folder} {path}");
        }
    }

    #[test]
    fn lines_count_from_one() {
        assert_eq!(
            [0, 2, 3, 99].map(|offset| line_at("ab\ncd\n", offset)),
            [1, 1, 2, 3]
        );
    }
}
