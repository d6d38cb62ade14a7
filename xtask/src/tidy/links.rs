//! Relative links in the documents lead to files and headings that exist: a reader who follows one must arrive.

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
    }
    Ok(())
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
    fn code_and_other_folders_are_no_documents() {
        assert_eq!(
            faults("README.md", "```\n[a](none.md)\n```\n`[b](none.md)` ~~~x\n"),
            NONE
        );
        assert_eq!(faults("mom/NOTES.md", "[a](none.md)"), NONE);
    }
}
