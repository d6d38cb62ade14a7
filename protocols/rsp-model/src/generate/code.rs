//! A text of code that is written line by line.

/// Lines, each at the indentation of its block.
#[derive(Debug, Default)]
pub(super) struct Code {
    text: String,
    depth: usize,
}

impl Code {
    /// Writes lines; an empty one has no indentation.
    pub(super) fn line(&mut self, lines: impl AsRef<str>) -> &mut Code {
        for line in lines.as_ref().split('\n') {
            if !line.is_empty() {
                self.text.push_str(&"    ".repeat(self.depth));
                self.text.push_str(line);
            }
            self.text.push('\n');
        }
        self
    }

    /// Writes a line, what is in its block, and the line that ends it.
    pub(super) fn block(
        &mut self,
        begin: impl AsRef<str>,
        end: &str,
        inside: impl FnOnce(&mut Code),
    ) -> &mut Code {
        self.line(begin).inside(end, inside)
    }

    /// Writes what is in a block whose first line is written, and the line that ends it.
    pub(super) fn inside(&mut self, end: &str, inside: impl FnOnce(&mut Code)) -> &mut Code {
        self.depth += 1;
        inside(self);
        self.depth -= 1;
        self.line(end)
    }

    pub(super) fn end(self) -> String {
        self.text
    }
}

/// A doc text as it may stand in a comment of code: its lines, without what would end the comment.
pub(super) fn comment_lines(doc: &str) -> Vec<String> {
    doc.lines()
        .map(|line| {
            let line: String = line.chars().filter(|c| !c.is_control()).collect();
            line.trim_end()
                .replace("*/", "* /")
                .replace("/*", "/ *")
                .replace('\\', "/")
        })
        .collect()
}
