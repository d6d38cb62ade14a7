//! Names of elements and attributes.

/// Whether this is an XML 1.0 name without `:`.
pub(super) fn is_name(text: &str) -> bool {
    let bytes = text.as_bytes();
    let Some(first) = bytes.first() else {
        return false;
    };
    let plain = |byte: &u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-' | b'.');
    if bytes.iter().all(plain) {
        return first.is_ascii_alphabetic() || *first == b'_';
    }
    let mut chars = text.chars();
    chars.next().is_some_and(is_start) && chars.all(|c| is_start(c) || is_inner(c))
}

/// Whether an element may be named so for a slot of this key; other keys are written `<slot key="…">`.
pub(super) fn is_element_key(key: &str) -> bool {
    is_name(key) && key != "slot" && !is_reserved(key)
}

/// Whether XML keeps this name for itself.
pub(super) fn is_reserved(name: &str) -> bool {
    name.as_bytes()
        .get(..3)
        .is_some_and(|first| first.eq_ignore_ascii_case(b"xml"))
}

// XML 1.0, fifth edition, productions 4 and 4a, without the colon.
fn is_start(c: char) -> bool {
    matches!(c,
        'A'..='Z' | '_' | 'a'..='z' | '\u{C0}'..='\u{D6}' | '\u{D8}'..='\u{F6}' | '\u{F8}'..='\u{2FF}'
        | '\u{370}'..='\u{37D}' | '\u{37F}'..='\u{1FFF}' | '\u{200C}'..='\u{200D}' | '\u{2070}'..='\u{218F}'
        | '\u{2C00}'..='\u{2FEF}' | '\u{3001}'..='\u{D7FF}' | '\u{F900}'..='\u{FDCF}'
        | '\u{FDF0}'..='\u{FFFD}' | '\u{10000}'..='\u{EFFFF}')
}

fn is_inner(c: char) -> bool {
    matches!(c, '-' | '.' | '0'..='9' | '\u{B7}' | '\u{300}'..='\u{36F}' | '\u{203F}'..='\u{2040}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn which_keys_are_element_names() {
        for good in ["a", "_", "age-error", "a.b", "Größe", "名", "x1", "item", "xm"] {
            assert!(is_element_key(good), "{good}");
        }
        for bad in [
            "",
            "1",
            "-a",
            ".a",
            "a b",
            "a:b",
            "slot",
            "xml",
            "XmLish",
            "a\u{2028}",
            "\u{300}a",
            "a<",
            "×",
        ] {
            assert!(!is_element_key(bad), "{bad}");
        }
    }
}
