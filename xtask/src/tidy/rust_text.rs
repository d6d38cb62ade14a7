//! Rust source told apart into code, strings and comments, without parsing it.
//!
//! The checks look for words; this keeps them from finding words in the wrong place. Each part has the length
//! and the lines of the source, with everything else blanked, so that an offset means the same in all of them.

use std::ops::Range;

/// The parts of one source file.
pub(crate) struct RustText {
    /// The code, with the insides of strings and characters blanked.
    pub(crate) code: String,
    /// The code with its strings.
    pub(crate) with_strings: String,
    /// The comments alone.
    pub(crate) comments: String,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    Code,
    Text,
    Comment,
}

impl RustText {
    pub(crate) fn new(source: &str) -> RustText {
        let parts = parts(source.as_bytes());
        let keep = |wanted: &[Part]| {
            let bytes = source.bytes().zip(&parts).map(|(byte, part)| {
                if byte == b'\n' || wanted.contains(part) {
                    byte
                } else {
                    b' '
                }
            });
            // Parts end at ASCII bytes, so no character is ever cut: lossy changes nothing.
            String::from_utf8_lossy(&bytes.collect::<Vec<u8>>()).into_owned()
        };
        RustText {
            code: keep(&[Part::Code]),
            with_strings: keep(&[Part::Code, Part::Text]),
            comments: keep(&[Part::Comment]),
        }
    }

    /// Where the code is that only tests compile: the items under `#[cfg(test)]`.
    pub(crate) fn test_regions(&self) -> Vec<Range<usize>> {
        let mut regions: Vec<Range<usize>> = Vec::new();
        for attribute in attributes(&self.code) {
            let text: String = self.code[attribute.clone()].split_whitespace().collect();
            let is_test = text.starts_with("#[cfg(test)") || text.starts_with("#[cfg(all(test");
            if text.starts_with("#![cfg(test)") {
                return std::iter::once(0..self.code.len()).collect();
            }
            let is_inside = regions.last().is_some_and(|last| last.contains(&attribute.start));
            if is_test && !is_inside {
                regions.push(attribute.start..item_end(&self.code, attribute.end));
            }
        }
        regions
    }
}

/// Where the attributes are, from `#` to the bracket that closes them, in the `code` of a source.
pub(crate) fn attributes(code: &str) -> Vec<Range<usize>> {
    let bytes = code.as_bytes();
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        if bytes[at] == b'#' {
            let open = if bytes.get(at + 1) == Some(&b'!') {
                at + 2
            } else {
                at + 1
            };
            if bytes.get(open) == Some(&b'[') {
                let end = group_end(bytes, open);
                found.push(at..end);
                at = end;
                continue;
            }
        }
        at += 1;
    }
    found
}

/// The identifiers and keywords of `code` with their offsets.
pub(crate) fn words(code: &str) -> impl Iterator<Item = (usize, &str)> {
    let is_word = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte >= 0x80;
    let bytes = code.as_bytes();
    let mut at = 0;
    std::iter::from_fn(move || {
        while at < bytes.len() && !is_word(bytes[at]) {
            at += 1;
        }
        let start = at;
        while at < bytes.len() && is_word(bytes[at]) {
            at += 1;
        }
        (start < at).then(|| (start, &code[start..at]))
    })
}

/// The offset after the bracket that closes the one at `open`; the end where none does.
pub(crate) fn group_end(bytes: &[u8], open: usize) -> usize {
    let mut depth = 0_usize;
    for (at, byte) in bytes.iter().enumerate().skip(open) {
        match byte {
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => {
                depth = depth.saturating_sub(1);
                if depth == 0 {
                    return at + 1;
                }
            }
            _ => {}
        }
    }
    bytes.len()
}

/// The end of the item that begins at `at`: its `;`, or the end of its braces.
fn item_end(code: &str, mut at: usize) -> usize {
    let bytes = code.as_bytes();
    while at < bytes.len() {
        match bytes[at] {
            b';' => return at + 1,
            b'{' => return group_end(bytes, at),
            b'(' | b'[' => at = group_end(bytes, at),
            // The end of what holds the item: a field or an arm without `;`.
            b'}' | b')' | b']' => return at,
            _ => at += 1,
        }
    }
    at
}

/// Which part each byte of the source belongs to.
fn parts(source: &[u8]) -> Vec<Part> {
    let mut parts = vec![Part::Code; source.len()];
    let mut at = 0;
    while at < source.len() {
        let rest = &source[at..];
        let (end, part) = if rest.starts_with(b"//") {
            (
                at + rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len()),
                Part::Comment,
            )
        } else if rest.starts_with(b"/*") {
            (at + block_comment(rest), Part::Comment)
        } else if rest[0] == b'"' {
            (at + string(rest), Part::Text)
        } else if rest[0] == b'r' && !continues_word(source, at) && raw_hashes(rest).is_some() {
            (at + raw_string(rest, raw_hashes(rest).unwrap_or(0)), Part::Text)
        } else if rest[0] == b'\'' && character(rest).is_some() {
            (at + character(rest).unwrap_or(1), Part::Text)
        } else {
            (at + 1, Part::Code)
        };
        parts[at..end].fill(part);
        at = end;
    }
    parts
}

fn continues_word(source: &[u8], at: usize) -> bool {
    // `br"` and `cr"` are prefixes too; `for"` is not.
    let mut before = at;
    if before > 0 && matches!(source[before - 1], b'b' | b'c') {
        before -= 1;
    }
    before > 0 && (source[before - 1].is_ascii_alphanumeric() || source[before - 1] == b'_')
}

/// The length of the block comment at the start, with those inside it.
fn block_comment(rest: &[u8]) -> usize {
    let (mut depth, mut at) = (0_usize, 0);
    while at < rest.len() {
        if rest[at..].starts_with(b"/*") {
            depth += 1;
            at += 2;
        } else if rest[at..].starts_with(b"*/") {
            depth -= 1;
            at += 2;
            if depth == 0 {
                return at;
            }
        } else {
            at += 1;
        }
    }
    at
}

/// The length of the string at the start, quotes included.
fn string(rest: &[u8]) -> usize {
    let mut at = 1;
    while at < rest.len() {
        match rest[at] {
            b'\\' => at += 2,
            b'"' => return at + 1,
            _ => at += 1,
        }
    }
    rest.len()
}

/// How many `#` the raw string at the start has; nothing if there is none.
fn raw_hashes(rest: &[u8]) -> Option<usize> {
    let hashes = rest[1..].iter().take_while(|byte| **byte == b'#').count();
    (rest.get(1 + hashes) == Some(&b'"')).then_some(hashes)
}

fn raw_string(rest: &[u8], hashes: usize) -> usize {
    let close = [b"\"".as_slice(), &vec![b'#'; hashes]].concat();
    let open = hashes + 2;
    let inside = &rest[open..];
    inside
        .windows(close.len())
        .position(|window| window == close)
        .map_or(rest.len(), |at| open + at + close.len())
}

/// The length of the character at the start; nothing if the `'` begins a lifetime.
fn character(rest: &[u8]) -> Option<usize> {
    if rest.get(1) == Some(&b'\\') {
        // The byte after the backslash may itself be a quote.
        return rest
            .iter()
            .skip(3)
            .position(|byte| *byte == b'\'')
            .map(|at| at + 4);
    }
    let text = &rest[1..rest.len().min(5)];
    let valid = text.utf8_chunks().next()?.valid();
    let length = valid.chars().next()?.len_utf8();
    (rest.get(1 + length) == Some(&b'\'')).then_some(length + 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn code_strings_and_comments_are_told_apart() {
        let check = |source: &str, code: &str, comments: &str| {
            let text = RustText::new(source);
            assert_eq!(
                text.code.split_whitespace().collect::<Vec<_>>().join(" "),
                code,
                "{source}"
            );
            assert_eq!(text.comments.trim(), comments, "{source}");
            assert_eq!(
                (text.code.len(), text.comments.len()),
                (source.len(), source.len()),
                "{source}"
            );
        };
        check("a(); // b", "a();", "// b");
        check("a /* b /* c */ d */ e", "a e", "/* b /* c */ d */");
        check(r#"a("// no \" comment"); b"#, "a( ); b", "");
        check(r##"a(r#"x " // y"#, br"z\"); b"##, "a( , b ); b", "");
        check(
            "f::<'a>('\"', '\\'', 'é', '\\u{1F}'); g",
            "f::<'a>( , , , ); g",
            "",
        );
        check("let r#type = for_r\"x\";", "let r#type = for_r ;", "");
        check("\"open", "", "");
        check("/* open", "", "/* open");
    }

    #[test]
    fn strings_are_kept_where_wanted() {
        let text = RustText::new("path = \"x/y.rs\" // z");
        assert_eq!(text.with_strings.trim_end(), "path = \"x/y.rs\"");
    }

    #[test]
    fn items_for_tests_only_are_found() {
        let check = |source: &str, expected: &[&str]| {
            let found: Vec<_> = RustText::new(source)
                .test_regions()
                .into_iter()
                .map(|region| &source[region])
                .collect();
            assert_eq!(found, expected, "{source}");
        };
        check(
            "fn a() {} #[cfg(test)] mod tests { fn b() {} } fn c() {}",
            &["#[cfg(test)] mod tests { fn b() {} }"],
        );
        check(
            "#[cfg(test)]\n#[path = \"t.rs\"]\nmod tests; fn c() {}",
            &["#[cfg(test)]\n#[path = \"t.rs\"]\nmod tests;"],
        );
        check(
            "#[cfg(all(test, unix))] fn a(x: [u8; 2]) { 1; } b",
            &["#[cfg(all(test, unix))] fn a(x: [u8; 2]) { 1; }"],
        );
        check("#[cfg(not(test))] fn a() {}", &[]);
        check(
            "struct A { #[cfg(test)] b: u8 } fn c() {}",
            &["#[cfg(test)] b: u8 "],
        );
        check("#![cfg(test)] fn a() {}", &["#![cfg(test)] fn a() {}"]);
    }

    #[test]
    fn words_have_their_places() {
        assert_eq!(
            words("mod a_1; x").collect::<Vec<_>>(),
            [(0, "mod"), (4, "a_1"), (9, "x")]
        );
    }
}
