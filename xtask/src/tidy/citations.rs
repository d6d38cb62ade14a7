//! Citations lead somewhere: "design §7" to section 7 of the design, "threat 26" to an item of the threats, "M29" to a line
//! of the papers' inventory. A reader who looks one up must find it; a number that no page explains explains nothing.
//!
//! They are looked for in comments and prose, never in code: a test may call a variable `M1`.

use std::collections::BTreeSet;

use anyhow::Result;

use super::Report;
use super::links::prose;
use super::rust_text::{RustText, words};
use super::tree::{Tree, line_at};

const DESIGN: &str = "docs/design.md";
const THREATS: &str = "docs/threats.md";
const PAPERS: &str = "docs/papers.md";
const SAFETY: &str = "docs/safety.md";

/// What one place in a text refers to.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Target {
    Section(u32),
    Threat(u32),
    Paper(char, u32),
    /// A number of a tracker that nobody can look up.
    Issue(u32),
}

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let known = known(tree);
    for (path, source) in tree.with_extension(&["rs", "md", "toml", "txt"]) {
        let rust = path.ends_with(".rs").then(|| tree.rust_text(path)).flatten();
        let text = citable(path, source, rust);
        let named = rust.map(|rust| test_names(&rust.code)).unwrap_or_default();
        let cited = citations(&text)
            .into_iter()
            .map(|(at, target)| (line_at(&text, at), target));
        for (line, target) in cited.chain(named) {
            if !known.contains(&target) {
                report(path, line, fault(&target));
            }
        }
    }
    check_threats(tree, report);
    check_safety(tree, report);
    Ok(())
}

fn fault(target: &Target) -> String {
    match target {
        Target::Section(number) => {
            format!("design §{number} leads nowhere: {DESIGN} has no section {number}")
        }
        Target::Threat(number) => format!("threat {number} leads nowhere: {THREATS} has no item {number}"),
        Target::Paper(letter, number) => {
            format!("{letter}{number} leads nowhere: {PAPERS} has no line **{letter}{number}**")
        }
        Target::Issue(number) => {
            format!("issue {number} is of no tracker that comes with the project: say where the fact stands")
        }
    }
}

/// All that can be cited.
fn known(tree: &Tree) -> BTreeSet<Target> {
    let lines = |path: &str| tree.text(path).unwrap_or_default().lines();
    let sections = lines(DESIGN).filter_map(|line| line.strip_prefix("## ").and_then(item_number));
    let threats = lines(THREATS).filter_map(item_number);
    let papers = lines(PAPERS).filter_map(|line| {
        let (name, _) = line.strip_prefix("- **")?.split_once("**")?;
        paper(name)
    });
    sections
        .map(Target::Section)
        .chain(threats.map(Target::Threat))
        .chain(papers)
        .collect()
}

/// The number of a line that begins with `N. `.
fn item_number(line: &str) -> Option<u32> {
    line.split_once(". ")?.0.parse().ok()
}

fn paper(word: &str) -> Option<Target> {
    let letter = word.chars().next().filter(|letter| "MWS".contains(*letter))?;
    let digits = &word[1..];
    let is_number = (1..=2).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit());
    let number = digits.parse().ok().filter(|_| is_number)?;
    Some(Target::Paper(letter, number))
}

/// The comments or the prose of a file, line by line; all else is left out, and so is code between backticks.
fn citable(path: &str, source: &str, rust: Option<&RustText>) -> String {
    let lines = source.lines().count();
    let mut kept = vec![String::new(); lines + 1];
    if path.ends_with(".md") {
        for (number, line) in prose(source) {
            line.clone_into(&mut kept[number - 1]);
        }
    } else if let Some(rust) = rust {
        for (kept, line) in kept.iter_mut().zip(rust.comments.lines()) {
            let text = line.trim_start().trim_start_matches('/');
            text.strip_prefix('!').unwrap_or(text).clone_into(kept);
        }
    } else {
        for (kept, line) in kept.iter_mut().zip(source.lines()) {
            hash_comment(line).clone_into(kept);
        }
    }
    let kept: Vec<String> = kept.iter().map(|line| without_code(line)).collect();
    kept.join("\n")
}

/// What follows a `#` that is not inside a string.
fn hash_comment(line: &str) -> &str {
    line.match_indices('#')
        .find(|(at, _)| {
            let before = &line[..*at];
            before.matches('"').count().is_multiple_of(2)
                && before.chars().next_back().is_none_or(char::is_whitespace)
        })
        .map_or("", |(at, _)| &line[at + 1..])
}

/// A line without what stands between pairs of backticks.
fn without_code(line: &str) -> String {
    let parts: Vec<&str> = line.split('`').collect();
    let last = parts.len() - 1;
    let is_prose = |at: usize| at.is_multiple_of(2) || at == last;
    let kept = parts.iter().enumerate().filter(|(at, _)| is_prose(*at));
    kept.map(|(_, part)| *part).collect::<Vec<_>>().join("`")
}

/// The citations of a text with their offsets.
fn citations(text: &str) -> Vec<(usize, Target)> {
    let mut found = Vec::new();
    for (at, word) in plain_words(text) {
        let rest = &text[at + word.len()..];
        let targets: Vec<Target> = match word.to_lowercase().as_str() {
            "design" => sections(rest).into_iter().map(Target::Section).collect(),
            "threat" => number(rest)
                .map(|(number, _)| Target::Threat(number))
                .into_iter()
                .collect(),
            "threats" => numbers(rest).into_iter().map(Target::Threat).collect(),
            "issue" | "issues" => numbers(rest).into_iter().map(Target::Issue).collect(),
            _ if stands_alone(&text[..at], rest) => paper(word).into_iter().collect(),
            _ => Vec::new(),
        };
        found.extend(targets.into_iter().map(|target| (at, target)));
    }
    found
}

/// Runs of letters, digits and `_`.
fn plain_words(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let is_word = |next: char| next.is_alphanumeric() || next == '_';
    let mut at = 0;
    std::iter::from_fn(move || {
        at += text[at..].find(is_word)?;
        let start = at;
        at += text[at..].find(|next| !is_word(next)).unwrap_or(text.len() - at);
        Some((start, &text[start..at]))
    })
}

/// Whether the word between these is not a part of a name such as `x-M1`, `a/S3` or `W5=7`.
fn stands_alone(before: &str, after: &str) -> bool {
    let joins = |next: char| "-/\\.#=:@$".contains(next);
    let mut after = after.chars();
    let (next, second) = (after.next(), after.next());
    let ends = !next.is_some_and(joins) || second.is_none_or(|second| !second.is_alphanumeric());
    ends && !before.chars().next_back().is_some_and(joins)
}

/// The sections of `§4, §7 and §9`.
fn sections(mut rest: &str) -> Vec<u32> {
    let mut found = Vec::new();
    while let Some((section, after)) = skip_blank(rest).strip_prefix('§').and_then(number) {
        found.push(section);
        let after = skip_blank(after);
        rest = after.strip_prefix(',').unwrap_or(after);
        rest = skip_blank(rest).strip_prefix("and ").unwrap_or(rest);
    }
    found
}

/// The numbers of `1, 2, 3 and 5`, `14 to 16`, `1–5`.
fn numbers(rest: &str) -> Vec<u32> {
    let Some((first, mut rest)) = number(rest) else {
        return Vec::new();
    };
    let mut found = vec![first];
    loop {
        let after = skip_blank(rest);
        let range = ["to ", "–"].iter().find_map(|mark| after.strip_prefix(mark));
        let list = [", and ", ",", "and "]
            .iter()
            .find_map(|mark| after.strip_prefix(mark));
        let Some((next, after)) = range.or(list).and_then(number) else {
            return found;
        };
        match range {
            Some(_) => found.extend(found[found.len() - 1] + 1..=next),
            None => found.push(next),
        }
        rest = after;
    }
}

/// The number at the start, after a blank or a line end, and what follows it.
fn number(rest: &str) -> Option<(u32, &str)> {
    let rest = skip_blank(rest);
    let end = rest
        .find(|next: char| !next.is_ascii_digit())
        .unwrap_or(rest.len());
    let (digits, after) = rest.split_at(end);
    let ends = !after.starts_with(|next: char| next.is_alphanumeric() || next == '_');
    // No tracker and no page here counts as far as a year or a size.
    let number = digits.parse().ok().filter(|_| ends && digits.len() <= 3)?;
    Some((number, after))
}

/// Without blanks and one line end: a citation may go on in the next line, but not in the next paragraph.
fn skip_blank(rest: &str) -> &str {
    let rest = rest.trim_start_matches(' ');
    rest.strip_prefix('\n').unwrap_or(rest).trim_start_matches(' ')
}

/// The threats that the names of tests cite, `threat_26_…`, with their lines.
fn test_names(code: &str) -> Vec<(usize, Target)> {
    let cited = words(code).filter_map(|(at, word)| {
        let digits = word.strip_prefix("threat_")?.split('_').next()?;
        Some((line_at(code, at), Target::Threat(digits.parse().ok()?)))
    });
    cited.collect()
}

/// Every threat names a test that exists, or says that it is open.
fn check_threats(tree: &Tree, report: &mut Report<'_>) {
    let Some(document) = tree.text(THREATS) else {
        return;
    };
    let tests = functions(tree);
    for (line, item) in items(document) {
        let named: Vec<&str> = item
            .split("Tests:")
            .skip(1)
            .filter_map(|part| part.split("*open*").next())
            .flat_map(|part| part.split('`').skip(1).step_by(2))
            .collect();
        if named.is_empty() && !item.contains("*open*") {
            let text =
                "a threat without a test: name one after `Tests:`, or say `*open*` and what is missing";
            report(THREATS, line, text.to_owned());
        }
        for name in named.iter().filter(|name| !tests.contains(*name)) {
            report(THREATS, line, format!("there is no test `{name}`"));
        }
    }
}

/// Every row of the table of safety names tests that exist, says that it does not apply, or that it is open.
fn check_safety(tree: &Tree, report: &mut Report<'_>) {
    let Some(document) = tree.text(SAFETY) else {
        return;
    };
    let mut tests: BTreeSet<&str> = functions(tree);
    let python = tree.with_extension(&["py"]);
    let words_of = python.flat_map(|(_, source)| source.split("def ").skip(1));
    tests.extend(words_of.filter_map(|rest| rest.split('(').next()));
    let scripts = tree.with_extension(&["ts", "mjs"]);
    let named = scripts.flat_map(|(_, source)| source.split("test(\"").skip(1));
    tests.extend(named.filter_map(|rest| rest.split('"').next()));
    for (number, row) in document.lines().enumerate() {
        let Some(cell) = row.strip_prefix("| ").and_then(|row| row.split(" | ").nth(2)) else {
            continue;
        };
        let named: Vec<&str> = cell.split('`').skip(1).step_by(2).collect();
        let says = ["test", "*open*", "does not apply"];
        if named.is_empty() && !says.iter().any(|word| cell.starts_with(word)) {
            let text = "a property of a device without a test: name one, or say `*open*` or `does not apply`, and why";
            report(SAFETY, number + 1, text.to_owned());
        }
        for name in named.iter().filter(|name| !tests.contains(*name)) {
            report(SAFETY, number + 1, format!("there is no test `{name}`"));
        }
    }
}

/// The numbered items of a document, each with its line and all of its text.
fn items(document: &str) -> Vec<(usize, String)> {
    let mut found: Vec<(usize, String)> = Vec::new();
    let mut inside = false;
    for (number, line) in document.lines().enumerate() {
        if item_number(line).is_some() {
            found.push((number + 1, String::new()));
            inside = true;
        } else if line.trim().is_empty() {
            inside = false;
        }
        if let Some((_, text)) = found.last_mut().filter(|_| inside) {
            text.push_str(line);
            text.push('\n');
        }
    }
    found
}

/// The names of all functions.
fn functions(tree: &Tree) -> BTreeSet<&str> {
    let mut names = BTreeSet::new();
    let sources = tree.with_extension(&["rs"]);
    for text in sources.filter_map(|(path, _)| tree.rust_text(path)) {
        let mut words = words(&text.code).map(|(_, word)| word).peekable();
        while let Some(word) = words.next() {
            if word == "fn" {
                names.extend(words.peek());
            }
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    const NONE: [&str; 0] = [];
    const PAGES: [(&str, &str); 3] = [
        (DESIGN, "# Design\n## 4. The hub\n## 7. Delivery\n"),
        (
            THREATS,
            "1. A bomb.\n   *open*: all of it.\n2. A lie.\n   Tests: `threat_2_a_lie`.\n3. Both. *open*: yes.\n",
        ),
        (PAPERS, "- **M2** Layers.\n- **M29** The rule.\n- **S1** Thin.\n"),
    ];
    const TEST: (&str, &str) = ("t.rs", "#[test]\nfn threat_2_a_lie() {}\n");

    fn faults(path: &str, text: &str) -> Vec<String> {
        let files: Vec<_> = PAGES.into_iter().chain([TEST, (path, text)]).collect();
        found(check, &files)
    }

    #[test]
    fn each_row_of_the_table_of_safety_names_a_test_that_exists() {
        let row =
            |cell: &str| format!("| property | device | test |\n|---|---|---|\n| stops | arm | {cell} |\n");
        for right in [
            "`threat_2_a_lie`",
            "*open*: all of it",
            "does not apply: it has none",
        ] {
            assert_eq!(faults(SAFETY, &row(right)), NONE, "{right}");
        }
        assert_eq!(faults(SAFETY, &row("`a_lie`")).len(), 1);
        assert_eq!(faults(SAFETY, &row("sure")).len(), 1);
    }

    #[test]
    fn citations_that_lead_somewhere_are_left_alone() {
        let text = "//! The rule (M29, design §4, §7; threat 2).\n/// Design §4 and §7: threats 1, 2 and 3, or\n/// threats\n/// 1 to 3 (1–3), M2–M29.\n";
        assert_eq!(faults("a.rs", text), NONE);
        assert_eq!(
            faults("docs/b.md", "[M29](papers.md), Threats 1–3, **S1**."),
            NONE
        );
        assert_eq!(faults("c.toml", "a = \"# M63\" # The rule (M29)."), NONE);
        assert_eq!(faults("d.txt", "# Thin (S1).\nalice: say x#M63\n"), NONE);
    }

    #[test]
    fn citations_that_lead_nowhere_are_found() {
        for (text, fault) in [
            (
                "// design §4, §5",
                "1: design §5 leads nowhere: docs/design.md has no section 5",
            ),
            (
                "\n/// Design\n/// §12.",
                "2: design §12 leads nowhere: docs/design.md has no section 12",
            ),
            (
                "//! (RFC 7578; threat 4)",
                "1: threat 4 leads nowhere: docs/threats.md has no item 4",
            ),
            (
                "// Threats 1, 2 and 9",
                "1: threat 9 leads nowhere: docs/threats.md has no item 9",
            ),
            (
                "// threats 2 to 4",
                "1: threat 4 leads nowhere: docs/threats.md has no item 4",
            ),
            (
                "a(); // (M29, M64).",
                "1: M64 leads nowhere: docs/papers.md has no line **M64**",
            ),
            (
                "/* W5 */",
                "1: W5 leads nowhere: docs/papers.md has no line **W5**",
            ),
            (
                "// measured, issue 4",
                "1: issue 4 is of no tracker that comes with the project: say where the fact stands",
            ),
            (
                "\nfn threat_7_x() {}",
                "2: threat 7 leads nowhere: docs/threats.md has no item 7",
            ),
        ] {
            assert_eq!(faults("a.rs", text), [format!("a.rs:{fault}")], "{text}");
        }
        assert_eq!(faults("docs/b.md", "one\n\ntwo (S12)").len(), 1);
        assert_eq!(faults("c.toml", "a = 1 # M30").len(), 1);
        assert_eq!(faults("d.txt", "alice: say \"x\" # as M30\n").len(), 1);
    }

    #[test]
    fn code_names_and_other_numbers_are_no_citations() {
        for text in [
            "let (M64, W5) = (\"M64 threat 9\", 'S');",
            "// RFC 2046 §5.1.1, 5 M, M640, W3C, S256, x-M64, a/S3, S9=1, `M64`, the design lists 12",
            "// no threat. 9 of them; an issue\n//\n// 4 more",
        ] {
            assert_eq!(faults("a.rs", text), NONE, "{text}");
        }
        assert_eq!(faults("docs/b.md", "```\nM64\n```\n`M64`"), NONE);
    }

    #[test]
    fn a_threat_names_a_test_or_is_open() {
        let document =
            "## Input\n1. A bomb.\n2. A lie.\n   Tests: `threat_2_a_lie`, `gone`. *open*: `this`.\n\nText.\n";
        assert_eq!(
            found(check, &[(THREATS, document), TEST]),
            [
                "docs/threats.md:2: a threat without a test: name one after `Tests:`, or say `*open*` and what is missing",
                "docs/threats.md:3: there is no test `gone`",
            ]
        );
    }
}
