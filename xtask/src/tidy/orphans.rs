//! Every `.rs` file under a `src/` is reached from a crate by `mod`: what is not is never compiled, and rots unseen.

use anyhow::Result;

use super::Report;
use super::modules::{packages, reached};
use super::tree::{Tree, join};

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for package in packages(tree) {
        let Some(sources) = join(package, "src") else {
            continue;
        };
        let reached = reached(tree, package);
        for (path, _) in tree.with_extension(&["rs"]) {
            if path.starts_with(&format!("{sources}/")) && !reached.contains_key(path) {
                report(
                    path,
                    1,
                    "no `mod` leads here: add one to the parent module or remove the file".to_owned(),
                );
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    #[test]
    fn a_file_that_no_mod_names_is_an_orphan() {
        let message = "no `mod` leads here: add one to the parent module or remove the file";
        let files = [
            ("p/Cargo.toml", ""),
            ("p/src/lib.rs", "mod a;\n// mod lost;"),
            ("p/src/a.rs", ""),
            ("p/src/lost.rs", "mod below;"),
            ("p/src/lost/below.rs", ""),
            ("p/tests/free.rs", ""),
            ("p/examples/src/data.rs", ""),
        ];
        assert_eq!(
            found(check, &files),
            [
                format!("p/src/lost.rs:1: {message}"),
                format!("p/src/lost/below.rs:1: {message}")
            ]
        );
        assert_eq!(found(check, &files[..3]), [] as [&str; 0]);
    }
}
