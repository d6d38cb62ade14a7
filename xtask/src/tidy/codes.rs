//! Every error code of the one table is in the protocol's document, with its number and its word: a client is
//! written from that document, and goes by the number's range where it does not know the code.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use anyhow::Result;

use super::Report;
use super::rust_text::RustText;
use super::tree::{Tree, line_at};

const TABLE: &str = "mom-proto/src/codes.rs";
const DOCUMENT: &str = "docs/PROTOCOL.md";
/// 100–199 try later, 200–299 don't, 300–399 reconnect, 400–499 stay away.
const NUMBERS: RangeInclusive<u32> = 100..=499;

struct Code {
    line: usize,
    number: u32,
    word: String,
}

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let Some(source) = tree.text(TABLE) else {
        report(TABLE, 1, "the table of error codes is not here".to_owned());
        return Ok(());
    };
    let codes = codes(source);
    if codes.is_empty() {
        report(
            TABLE,
            1,
            "no `Code::new(number, \"word\")` is found here".to_owned(),
        );
    }
    let rows = tree.text(DOCUMENT).map(table_rows).unwrap_or_default();
    let mut numbers = BTreeMap::new();
    let mut words = BTreeMap::new();
    for Code { line, number, word } in &codes {
        let mut fault = |message: String| report(TABLE, *line, message);
        if !NUMBERS.contains(number) {
            fault(format!("`{word}` has the number {number}, outside 100 to 499"));
        }
        if let Some(other) = numbers.insert(number, word) {
            fault(format!("`{word}` has the number {number} of `{other}`"));
        }
        if let Some(other) = words.insert(word, number) {
            fault(format!("`{word}` stands for {other} and {number}"));
        }
        let number_cell = number.to_string();
        if !rows
            .iter()
            .any(|row| row.contains(&number_cell.as_str()) && row.contains(&word.as_str()))
        {
            fault(format!(
                "{number} `{word}` is not in a row of {DOCUMENT}: add | {number} | `{word}` | … |"
            ));
        }
    }
    Ok(())
}

/// The codes that the source makes, outside of its tests.
fn codes(source: &str) -> Vec<Code> {
    let text = RustText::new(source);
    let tests = text.test_regions();
    text.code
        .match_indices("Code::new(")
        .filter(|(at, _)| !tests.iter().any(|region| region.contains(at)))
        .filter_map(|(at, start)| {
            let (number, rest) = text.with_strings[at + start.len()..].split_once(',')?;
            let word = rest.trim_start().strip_prefix('"')?.split('"').next()?;
            let number = number.trim().replace('_', "").parse().ok()?;
            Some(Code {
                line: line_at(source, at),
                number,
                word: word.to_owned(),
            })
        })
        .collect()
}

/// The cells of the document's tables, row by row, without the marks of code.
fn table_rows(document: &str) -> Vec<Vec<&str>> {
    let rows = document
        .lines()
        .map(str::trim)
        .filter(|line| line.starts_with('|'));
    rows.map(|row| row.split('|').map(|cell| cell.trim().trim_matches('`')).collect())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::found;
    use super::*;

    fn faults(source: &str, document: &str) -> Vec<String> {
        let found = found(check, &[(TABLE, source), (DOCUMENT, document)]);
        found.into_iter().map(|line| line.replace(TABLE, "T")).collect()
    }

    const NONE: [&str; 0] = [];

    #[test]
    fn a_code_in_a_row_with_number_and_word_is_documented() {
        let source = "pub const A: Code = Code::new(100, \"try-later\");\npub const B: Code =\n    Code::new(\n        200,\n \"denied\",\n    );";
        let document =
            "| code | word | meaning |\n|---|---|---|\n| 100 | `try-later` | x |\n| `denied` | 200 | y |";
        assert_eq!(faults(source, document), NONE);
    }

    #[test]
    fn an_undocumented_code_is_found() {
        let source = "// Code::new(101, \"gone\")\nconst A: Code = Code::new(100, \"held\");\n#[cfg(test)]\nmod t { Code::new(1, \"x\"); }";
        let message = "T:2: 100 `held` is not in a row of docs/PROTOCOL.md: add | 100 | `held` | … |";
        for document in [
            "",
            "100 `held`",
            "| 1000 | `held` |",
            "| 100 | `held-by` |",
            "| 100 | x |\n| 2 | `held` |",
        ] {
            assert_eq!(faults(source, document), [message], "{document}");
        }
    }

    #[test]
    fn numbers_and_words_are_unique_and_in_range() {
        let source = "Code::new(100, \"a\")\nCode::new(100, \"b\")\nCode::new(101, \"a\")\nCode::new(500, \"c\")\nCode::new(99, \"d\")";
        let document = "| 100 | a |\n| 100 | b |\n| 101 | a |\n| 500 | c |\n| 99 | d |";
        assert_eq!(
            faults(source, document),
            [
                "T:2: `b` has the number 100 of `a`",
                "T:3: `a` stands for 100 and 101",
                "T:4: `c` has the number 500, outside 100 to 499",
                "T:5: `d` has the number 99, outside 100 to 499",
            ]
        );
    }

    #[test]
    fn a_table_of_another_shape_is_no_success() {
        assert_eq!(
            faults("enum Code { Held }", ""),
            ["T:1: no `Code::new(number, \"word\")` is found here"]
        );
        assert_eq!(
            found(check, &[]),
            ["mom-proto/src/codes.rs:1: the table of error codes is not here"]
        );
    }
}
