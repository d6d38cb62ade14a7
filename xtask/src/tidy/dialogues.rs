//! Every dialogue that the devices of all languages replay stands beside a rule in the document, and each that is named there exists.

use anyhow::Result;

use super::Report;
use super::tree::Tree;

const CASES: &str = "tests/cases/device.txt";
const DOCUMENT: &str = "docs/device.md";
/// The section of the table.
const SECTION: &str = "## Rules";

pub(crate) fn check(tree: &Tree, report: &mut Report<'_>) -> Result<()> {
    let (Some(cases), Some(document)) = (tree.text(CASES), tree.text(DOCUMENT)) else {
        return Ok(());
    };
    let named: Vec<(usize, &str)> = document
        .lines()
        .zip(1..)
        .skip_while(|(line, _)| *line != SECTION)
        .skip(1)
        .take_while(|(line, _)| !line.starts_with("## "))
        .filter(|(line, _)| line.starts_with("| "))
        .flat_map(|(row, line)| {
            let dialogues = row
                .trim_end_matches(" |")
                .rsplit(" | ")
                .next()
                .unwrap_or_default();
            dialogues
                .split('`')
                .skip(1)
                .step_by(2)
                .map(move |title| (line, title))
        })
        .collect();
    for (title, line) in cases
        .lines()
        .zip(1..)
        .filter_map(|(text, line)| Some((text.strip_prefix("== ")?, line)))
    {
        if !named.iter().any(|(_, known)| *known == title) {
            report(
                CASES,
                line,
                format!("`{title}` stands beside no rule of {DOCUMENT}: add it to the table"),
            );
        }
    }
    for (line, title) in named {
        if !cases.lines().any(|text| text.strip_prefix("== ") == Some(title)) {
            report(
                DOCUMENT,
                line,
                format!("there is no dialogue `{title}` in {CASES}"),
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_and_dialogues_name_each_other() {
        let files = [
            (CASES, "== a stop latches\nbob stop\n== a gap is a stop\n"),
            (
                DOCUMENT,
                "| `b` |\n## Rules\n| rule | why | dialogue |\n|---|---|---|\n| `stop` latches | so | `a stop latches`, `a gap is none` |\n## More\n| `c` |\n",
            ),
        ];
        assert_eq!(
            super::super::found(check, &files),
            [
                "docs/device.md:5: there is no dialogue `a gap is none` in tests/cases/device.txt",
                "tests/cases/device.txt:3: `a gap is a stop` stands beside no rule of docs/device.md: add it to the table",
            ]
        );
    }
}
