//! No file names the machine that it was written or built on: such a path means nothing to anyone else, and a
//! registry's host in a lock or configuration file sends every later build there.

use anyhow::Result;

use super::Report;
use super::tree::{Tree, line_at};

/// What must not be found, in pieces so that this file passes its own check.
const NAMES: &[(&str, &str)] = &[
    (concat!("/wor", "k/"), "a path of a build machine"),
    (concat!("/ro", "ot/"), "a path of a build machine"),
    (concat!("index.cra", "tes.io"), "the host of a registry"),
    (concat!("static.cra", "tes.io"), "the host of a registry"),
    (concat!("registry.np", "mjs.org"), "the host of a registry"),
    (concat!("registry.ya", "rnpkg.com"), "the host of a registry"),
    (concat!("files.python", "hosted.org"), "the host of a registry"),
    (concat!("py", "pi.org"), "the host of a registry"),
    (concat!("deb.deb", "ian.org"), "the host of a registry"),
    (concat!("proxy.gol", "ang.org"), "the host of a registry"),
];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for (path, text) in tree.files() {
        for (name, what) in NAMES {
            for (at, _) in text.match_indices(name) {
                report(
                    path,
                    line_at(text, at),
                    format!("`{name}` is {what}: write it relative, or leave it out"),
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
    fn every_name_is_found_in_any_file() {
        for (name, what) in NAMES {
            let text = format!("one\n\"https:{name}x\"\n");
            let expected = format!("`{name}` is {what}: write it relative, or leave it out");
            for path in ["a.rs", "Cargo.lock", "docs/picture.png"] {
                assert_eq!(found(check, &[(path, &text)]), [format!("{path}:2: {expected}")]);
            }
        }
    }

    #[test]
    fn ordinary_paths_and_hosts_are_free() {
        let text = "the work/rest of /robot/token, /rooted, https://github.com/rust-lang/crates.io-index";
        assert_eq!(found(check, &[("a.md", text)]), [] as [&str; 0]);
    }

    #[test]
    fn this_file_names_nothing() {
        assert_eq!(
            found(check, &[("names.rs", include_str!("names.rs"))]),
            [] as [&str; 0]
        );
    }
}
