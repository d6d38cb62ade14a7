//! Relative links in the documents lead to files and headings that exist: a reader who follows one must arrive.
//!
//! So must one who looks up a file that is named in backticks: `lab/arm`, `config/cubo.toml`, or the end of a path to a source, such as
//! `verbs/grab.rs`. In a table whose first column has nothing but folders, a source is one of the row's.

use std::collections::BTreeMap;

use anyhow::Result;

use super::Report;
use super::tree::{Tree, folder_of, join};

/// One link: where it stands and where it leads.
#[derive(Debug, PartialEq, Eq)]
struct Link<'a> {
    line: usize,
    target: &'a str,
}

/// Names of files that end so are names of sources.
const SOURCES: &[&str] = &[".rs", ".ts", ".svelte", ".mjs", ".py"];
/// What is built is in no checkout.
const BUILT: &str = "dist";
/// History names what there was.
const HISTORY: &[&str] = &["CHANGELOG.md", "docs/bugs.md"];

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    for (path, text) in tree.with_extension(&["md"]) {
        if path.contains('/') && !path.starts_with("docs/") {
            continue;
        }
        for Link { line, target } in links(text) {
            if let Some(fault) = fault(tree, path, target) {
                report(path, line, fault);
            }
        }
        let written = prose(text).filter(|_| !HISTORY.contains(&path));
        for (line, content) in written {
            let folders = row_folders(tree, content);
            for name in in_backticks(content).filter(|name| is_path(tree, name)) {
                if !leads(tree, name, &folders) {
                    report(
                        path,
                        line,
                        format!("`{name}` leads nowhere: there is no such file"),
                    );
                }
            }
        }
    }
    Ok(())
}

fn in_backticks(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// The folders in the first cell of a table's row, if nothing else is there.
fn row_folders<'a>(tree: &Tree, line: &'a str) -> Vec<&'a str> {
    let cell = line.strip_prefix('|').and_then(|row| row.split('|').next());
    let Some(cell) = cell else { return Vec::new() };
    let is_more = |text: &str| text.contains(|next: char| !matches!(next, ' ' | ','));
    if cell.split('`').step_by(2).any(is_more) {
        return Vec::new();
    }
    let is_folder = |name: &&str| tree.files().any(|(path, _)| inside(path, name).is_some());
    in_backticks(cell).filter(is_folder).collect()
}

/// Whether what stands in backticks is the name of a source, or a path from the root.
fn is_path(tree: &Tree, name: &str) -> bool {
    let is_plain = |next: char| next.is_ascii_alphanumeric() || "._-/".contains(next);
    let last = name.rsplit('/').next().unwrap_or(name);
    if !name.chars().all(is_plain) || name.starts_with(['/', '.', '-']) || last.starts_with('.') {
        return false;
    }
    let is_source = SOURCES.iter().any(|end| last.ends_with(end));
    let from_root = name.split_once('/').is_some_and(|(first, _)| tree.exists(first));
    (is_source || from_root) && !name.split('/').any(|part| part == BUILT)
}

/// Whether there is a file or a folder whose path is this or ends so, below one of the folders if there are some.
fn leads(tree: &Tree, name: &str, folders: &[&str]) -> bool {
    let name = name.trim_end_matches('/');
    if name.contains('/') && tree.exists(name) {
        return true;
    }
    let ends_so = |path: &str| format!("/{path}/").contains(&format!("/{name}/"));
    tree.files().any(|(path, _)| match folders {
        [] => ends_so(path),
        folders => folders
            .iter()
            .filter_map(|folder| inside(path, folder))
            .any(ends_so),
    })
}

/// What follows in a path after a folder that is named by its path or the end of it.
fn inside<'a>(path: &'a str, folder: &str) -> Option<&'a str> {
    let from_root = path.strip_prefix(folder).and_then(|rest| rest.strip_prefix('/'));
    from_root.or_else(|| Some(path.split_once(&format!("/{folder}/"))?.1))
}

/// What is wrong with a link in the document at `path`; nothing for links to other hosts.
fn fault(tree: &Tree, path: &str, target: &str) -> Option<String> {
    let has_scheme = target.split_once(':').is_some_and(|(scheme, _)| {
        !scheme.is_empty()
            && scheme
                .chars()
                .all(|next| next.is_ascii_alphanumeric() || "+-.".contains(next))
    });
    if has_scheme || target.starts_with("//") {
        return None;
    }
    let (file, anchor) = target.split_once('#').unwrap_or((target, ""));
    let file = file.split('?').next().unwrap_or_default().replace("%20", " ");
    let resolved = match file.strip_prefix('/') {
        _ if file.is_empty() => Some(path.to_owned()),
        Some(from_root) => join("", from_root),
        None => join(folder_of(path), &file),
    };
    let Some(resolved) = resolved else {
        return Some(format!("`{target}` leads out of the checkout"));
    };
    if !tree.exists(&resolved) {
        return Some(format!("`{target}` leads nowhere: there is no {resolved}"));
    }
    let document = resolved
        .ends_with(".md")
        .then(|| tree.text(&resolved))
        .flatten()?;
    if anchor.is_empty() || anchors(document).iter().any(|known| known == anchor) {
        return None;
    }
    Some(format!(
        "`{target}` leads nowhere: {resolved} has no heading #{anchor}"
    ))
}

/// The lines of a document outside its code blocks, with their numbers.
pub(super) fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut fence: Option<&str> = None;
    text.lines().enumerate().filter_map(move |(number, line)| {
        let start = line.trim_start();
        let mark = ["```", "~~~"].into_iter().find(|mark| start.starts_with(mark));
        match (fence, mark) {
            (None, Some(mark)) => fence = Some(mark),
            (Some(open), Some(mark)) if open == mark => fence = None,
            (None, None) => return Some((number + 1, line)),
            _ => {}
        }
        None
    })
}

/// The links `[text](target)`, images among them, and the definitions `[name]: target`.
fn links(text: &str) -> Vec<Link<'_>> {
    let mut found = Vec::new();
    for (line, content) in prose(text) {
        let code = code_spans(content);
        for (at, mark) in content.match_indices("](") {
            if code.iter().any(|span| span.contains(&at)) {
                continue;
            }
            let rest = &content[at + mark.len()..];
            let target = match rest.strip_prefix('<') {
                Some(rest) => rest.split('>').next(),
                // A title may follow the target after a space.
                None => rest[..closing(rest)].split_whitespace().next(),
            };
            found.extend(target.map(|target| Link { line, target }));
        }
        if let Some((name, target)) = content.strip_prefix('[').and_then(|rest| rest.split_once("]: "))
            && !name.contains(']')
            && !name.starts_with('^')
        {
            found.extend(
                target
                    .split_whitespace()
                    .next()
                    .map(|target| Link { line, target }),
            );
        }
    }
    found
}

/// The offset of the `)` that ends a target, which may itself hold pairs of them.
fn closing(rest: &str) -> usize {
    let mut depth = 1_usize;
    for (at, next) in rest.char_indices() {
        match next {
            '(' => depth += 1,
            ')' if depth == 1 => return at,
            ')' => depth -= 1,
            _ => {}
        }
    }
    rest.len()
}

/// Where a line holds code between backticks.
fn code_spans(line: &str) -> Vec<std::ops::Range<usize>> {
    let marks: Vec<usize> = line.match_indices('`').map(|(at, _)| at).collect();
    marks.chunks_exact(2).map(|pair| pair[0]..pair[1]).collect()
}

/// The anchors of a document: its headings as the usual hosts write them, and explicit ids.
fn anchors(text: &str) -> Vec<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let mut anchors = Vec::new();
    for (_, line) in prose(text) {
        let title = line.trim_start_matches('#');
        let level = line.len() - title.len();
        if (1..=6).contains(&level) && title.starts_with(' ') {
            let anchor = slug(title.trim().trim_end_matches('#').trim_end());
            let count = seen.entry(anchor.clone()).or_default();
            anchors.push(if *count == 0 {
                anchor
            } else {
                format!("{anchor}-{count}")
            });
            *count += 1;
        }
        for mark in ["id=\"", "name=\""] {
            anchors.extend(
                line.split(mark)
                    .skip(1)
                    .filter_map(|rest| rest.split('"').next())
                    .map(str::to_owned),
            );
        }
    }
    anchors
}

/// A heading as an anchor: lower case, spaces as `-`, without punctuation.
fn slug(title: &str) -> String {
    let kept = title
        .chars()
        .filter(|next| next.is_alphanumeric() || matches!(next, ' ' | '-' | '_'));
    kept.flat_map(char::to_lowercase)
        .map(|next| if next == ' ' { '-' } else { next })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    const NONE: [&str; 0] = [];
    const GUIDE: &str = "# The Guide\n## 1. Parcels & wire (XML)\n## Same\n## Same\n<a id=\"here\"></a>\n";

    fn faults(path: &str, text: &str) -> Vec<String> {
        found(
            check,
            &[
                (path, text),
                ("docs/guide.md", GUIDE),
                ("docs/images/a.png", ""),
                ("LICENSE", ""),
            ],
        )
    }

    #[test]
    fn links_that_arrive_are_left_alone() {
        let text = "[a](docs/guide.md) ![b](docs/images/a.png \"title\") [c](<LICENSE>) [d](docs/) [e](/LICENSE)\n\
            [f](docs/guide.md#1-parcels--wire-xml) [g](docs/guide.md#same-1) [h](docs/guide.md#here) [i](#top-thing)\n\
            [j](https://example.org/x) [k](mailto:a@example.org)\n# Top `thing`\n[ref]: docs/guide.md\n[^note]: text";
        assert_eq!(faults("README.md", text), NONE);
        assert_eq!(
            faults("docs/other.md", "[a](guide.md) [b](../LICENSE) [c](images/a.png)"),
            NONE
        );
    }

    #[test]
    fn links_that_lead_nowhere_are_found() {
        for (text, fault) in [
            (
                "\n[a](docs/none.md)",
                "2: `docs/none.md` leads nowhere: there is no docs/none.md",
            ),
            ("![a](a.png)", "1: `a.png` leads nowhere: there is no a.png"),
            ("[a](../x.md)", "1: `../x.md` leads out of the checkout"),
            (
                "[a](#none)",
                "1: `#none` leads nowhere: README.md has no heading #none",
            ),
            (
                "[a](docs/guide.md#same-2)",
                "1: `docs/guide.md#same-2` leads nowhere: docs/guide.md has no heading #same-2",
            ),
            (
                "[ref]: none.md",
                "1: `none.md` leads nowhere: there is no none.md",
            ),
            ("[a](x(1).md)", "1: `x(1).md` leads nowhere: there is no x(1).md"),
        ] {
            assert_eq!(
                faults("README.md", text),
                [format!("README.md:{fault}")],
                "{text}"
            );
        }
    }

    #[test]
    fn files_in_backticks_are_there() {
        let files = |path: &str, text: &str| {
            let sources = [
                "lab/arm/src/peer.rs",
                "lab/arm/src/zones/mod.rs",
                "lab/camera/src/pan.rs",
            ];
            let mut files: Vec<_> = sources.iter().map(|path| (*path, "")).collect();
            files.push((path, text));
            found(check, &files)
        };
        for right in [
            "`peer.rs`, `zones/mod.rs`, `lab/arm`, `lab/arm/`, `lab/arm/src/peer.rs`",
            "| `lab/arm` | `peer.rs`, `lab/camera/src/pan.rs`, and `zones` |",
            "| `lab/arm`, `lab/camera` | `pan.rs` |",
            "| `zones` | `mod.rs` |",
            "| pans, `lab/arm` | `pan.rs` |",
            "`.rs`, `*.py`, `/lab/x`, `a/b`, `lab/dist`, `x.toml`, `lab/arm x`",
            "```\n`gone.rs`\n```",
        ] {
            assert_eq!(files("docs/a.md", right), NONE, "{right}");
        }
        for (wrong, fault) in [
            ("`gone.rs`", "1: `gone.rs`"),
            ("\n`lab/gone`", "2: `lab/gone`"),
            ("`arm/peer.rs`", "1: `arm/peer.rs`"),
            ("| `lab/arm` | `pan.rs` |", "1: `pan.rs`"),
        ] {
            let fault = format!("docs/a.md:{fault} leads nowhere: there is no such file");
            assert_eq!(files("docs/a.md", wrong), [fault], "{wrong}");
            assert_eq!(files("docs/bugs.md", wrong), NONE, "{wrong}");
        }
    }

    #[test]
    fn code_and_other_folders_are_no_documents() {
        assert_eq!(
            faults("README.md", "```\n[a](none.md)\n```\n`[b](none.md)` ~~~x\n"),
            NONE
        );
        assert_eq!(faults("mom/NOTES.md", "[a](none.md)"), NONE);
    }
}
