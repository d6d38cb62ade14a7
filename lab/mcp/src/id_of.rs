//! The id of a call whose line is too long to be kept.

use serde_json::Value as Json;

/// The longest id that is kept.
const MOST: usize = 256;

/// Looks for the `id` of a JSON object in bytes that are read once.
#[derive(Debug, Default)]
pub(crate) struct IdFinder {
    depth: usize,
    in_string: bool,
    escaped: bool,
    /// Behind a colon of the object itself.
    in_value: bool,
    is_id: bool,
    /// The key or value that is being read, of the object itself.
    token: Vec<u8>,
    id: Option<Json>,
}

impl IdFinder {
    /// Reads on.
    pub(crate) fn feed(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|byte| self.take(*byte));
    }

    /// What was found: a string or a whole number.
    pub(crate) fn id(self) -> Json {
        self.id
            .filter(|id| id.is_string() || id.is_i64())
            .unwrap_or_default()
    }

    fn take(&mut self, byte: u8) {
        if self.depth == 1
            && self.token.len() < MOST
            && !matches!(byte, b',' | b':' | b'}' if !self.in_string)
        {
            self.token.push(byte);
        }
        if self.in_string {
            let ends = byte == b'"' && !self.escaped;
            self.escaped = byte == b'\\' && !self.escaped;
            self.in_string = !ends;
            return;
        }
        match byte {
            b'"' => self.in_string = true,
            b'{' | b'[' => {
                self.depth += 1;
                self.token.clear();
            }
            b'}' | b']' => {
                self.end_value();
                self.depth = self.depth.saturating_sub(1);
            }
            b':' if self.depth == 1 => {
                self.is_id = self.read().is_some_and(|key| key == "id");
                self.in_value = true;
            }
            b',' => self.end_value(),
            _ => {}
        }
    }

    fn end_value(&mut self) {
        if self.depth == 1 {
            let value = self.read();
            if std::mem::take(&mut self.in_value) && self.is_id {
                self.id = value;
            }
        }
    }

    fn read(&mut self) -> Option<Json> {
        serde_json::from_slice(&std::mem::take(&mut self.token)).ok()
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn an_id_is_found_wherever_it_stands() {
        let long = "x".repeat(1000);
        for (line, id) in [
            (
                format!(r#"{{"jsonrpc":"2.0","id":7,"params":{{"id":8,"a":"{long}"}}}}"#),
                json!(7),
            ),
            (
                format!(r#"{{"params":[{{"id":8}},"{long}"], "id" : "a\"b"}}"#),
                json!("a\"b"),
            ),
            (
                format!(r#"{{"a":"\"id\":3,{long}","method":"x","id":9}}"#),
                json!(9),
            ),
            (format!(r#"{{"a":"{long}","ID":9}}"#), Json::Null),
            (format!(r#"{{"id":{{"id":1}},"a":"{long}"}}"#), Json::Null),
            (format!(r#"{{"id":"{long}"}}"#), Json::Null),
            (format!(r#"["id",1,"{long}"]"#), Json::Null),
        ] {
            let mut finder = IdFinder::default();
            line.as_bytes().chunks(7).for_each(|piece| finder.feed(piece));
            assert_eq!(finder.id(), id, "{line}");
        }
    }
}
