//! Names of a model in the form of each language.

/// `left_wheel`; with a `_` behind it where it would be a keyword of C or Rust.
pub(super) fn snake(name: &str) -> String {
    let snake = name.replace('-', "_");
    match KEYWORDS.contains(&snake.as_str()) {
        true => format!("{snake}_"),
        false => snake,
    }
}

/// `LEFT_WHEEL`.
pub(super) fn upper(name: &str) -> String {
    name.replace('-', "_").to_ascii_uppercase()
}

/// `LeftWheel`; `Self` is the only keyword of this form.
pub(super) fn camel(name: &str) -> String {
    match name {
        "self" => "Self_".to_owned(),
        name => name.split('-').map(capital).collect(),
    }
}

/// `left wheel`.
pub(super) fn spaced(name: &str) -> String {
    name.replace('-', " ")
}

fn capital(word: &str) -> String {
    let mut chars = word.chars();
    let first = chars.next().map(|first| first.to_ascii_uppercase());
    first.into_iter().chain(chars).collect()
}

/// Words that cannot be names in C, Rust or C++, which reads headers of C.
const KEYWORDS: &[&str] = &[
    "abstract",
    "alignas",
    "alignof",
    "and",
    "as",
    "asm",
    "async",
    "auto",
    "await",
    "become",
    "bool",
    "box",
    "break",
    "case",
    "catch",
    "char",
    "class",
    "const",
    "constexpr",
    "continue",
    "crate",
    "default",
    "delete",
    "do",
    "double",
    "dyn",
    "else",
    "enum",
    "explicit",
    "export",
    "extern",
    "false",
    "final",
    "float",
    "fn",
    "for",
    "friend",
    "gen",
    "goto",
    "if",
    "impl",
    "in",
    "inline",
    "int",
    "let",
    "long",
    "loop",
    "macro",
    "map",
    "match",
    "mod",
    "move",
    "mut",
    "mutable",
    "namespace",
    "new",
    "noexcept",
    "not",
    "nullptr",
    "operator",
    "or",
    "override",
    "priv",
    "private",
    "protected",
    "pub",
    "public",
    "ref",
    "register",
    "restrict",
    "return",
    "self",
    "short",
    "signed",
    "sizeof",
    "static",
    "struct",
    "super",
    "switch",
    "template",
    "this",
    "throw",
    "trait",
    "true",
    "try",
    "type",
    "typedef",
    "typeid",
    "typename",
    "typeof",
    "union",
    "unsafe",
    "unsized",
    "unsigned",
    "use",
    "using",
    "virtual",
    "void",
    "volatile",
    "where",
    "while",
    "xor",
    "yield",
];
