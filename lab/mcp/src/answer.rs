//! What a tool answers: words for the model, the same as data, and perhaps a picture.

use mom_client::{ClientError, ErrorKind, WireError};
use mom_drive::VerbFailure;
use rmcp::model::{CallToolResult, ContentBlock};
use serde_json::{Value as Json, json};

/// The answer of a tool.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Answer {
    pub(crate) text: String,
    pub(crate) facts: Json,
    /// In base64, with its media type.
    pub(crate) picture: Option<(String, String)>,
    failed: bool,
}

impl Answer {
    /// It was done.
    pub(crate) fn good(text: impl Into<String>, facts: Json) -> Answer {
        Answer {
            text: text.into(),
            facts,
            picture: None,
            failed: false,
        }
    }

    /// It was not done, for the reason that this code names.
    pub(crate) fn bad(code: &str, text: impl Into<String>) -> Answer {
        let text = text.into();
        Answer {
            facts: json!({"error": {"code": code, "text": text}}),
            text: format!("{code}: {text}"),
            picture: None,
            failed: true,
        }
    }

    /// A refusal of the hub or of a device.
    pub(crate) fn refused(what: &str, error: &WireError) -> Answer {
        let mut answer = Answer::bad(error.code.word(), format!("{what}: {}", error.text));
        answer.facts["error"]["number"] = json!(error.code.number());
        answer
    }

    /// A request of the client failed.
    pub(crate) fn of_client(what: &str, error: &ClientError) -> Answer {
        match (error.wire(), error.kind()) {
            (Some(wire), _) => Answer::refused(what, wire),
            (None, ErrorKind::TimedOut) => Answer::bad("timed-out", format!("{what}: {error}")),
            (None, _) => Answer::bad("disconnected", format!("{what}: {error}")),
        }
    }

    /// With another fact.
    pub(crate) fn with(mut self, key: &str, fact: Json) -> Answer {
        self.facts[key] = fact;
        self
    }

    /// With all of these facts more.
    pub(crate) fn with_all(mut self, facts: serde_json::Map<String, Json>) -> Answer {
        if let Json::Object(known) = &mut self.facts {
            known.extend(facts);
        }
        self
    }

    /// With more words.
    pub(crate) fn and(mut self, more: &str) -> Answer {
        if !more.is_empty() {
            self.text.push_str("; ");
            self.text.push_str(more);
        }
        self
    }
}

impl From<&VerbFailure> for Answer {
    fn from(failure: &VerbFailure) -> Answer {
        match failure {
            VerbFailure::Hub { what, error } => Answer::of_client(what, error),
            VerbFailure::Refused { what, error } => Answer::refused(what, error),
            VerbFailure::Failed { text, hint } => {
                let answer = Answer::bad("failed", text);
                answer.and(hint.as_deref().unwrap_or_default())
            }
            VerbFailure::Io(error) => Answer::bad("failed", error.to_string()),
        }
    }
}

impl From<Answer> for CallToolResult {
    fn from(answer: Answer) -> CallToolResult {
        let mut content = vec![ContentBlock::text(answer.text)];
        if let Some((data, media_type)) = answer.picture {
            content.push(ContentBlock::image(data, media_type));
        }
        let mut result = match answer.failed {
            true => CallToolResult::error(content),
            false => CallToolResult::success(content),
        };
        result.structured_content = Some(answer.facts);
        result
    }
}

#[cfg(test)]
mod tests {
    use mom_client::Code;

    use super::*;

    #[test]
    fn a_failure_has_a_code() {
        let wire = WireError::new(Code::HELD, "alice drives");
        for (failure, code) in [
            (
                VerbFailure::Hub {
                    what: "grab".to_owned(),
                    error: ClientError::Refused(wire.clone()),
                },
                "held",
            ),
            (
                VerbFailure::Refused {
                    what: "send".to_owned(),
                    error: wire,
                },
                "held",
            ),
            (
                VerbFailure::Hub {
                    what: "grab".to_owned(),
                    error: ClientError::Connection("reset".to_owned()),
                },
                "disconnected",
            ),
            (VerbFailure::new("the robot is stopped", "let it go"), "failed"),
        ] {
            let answer = Answer::from(&failure);
            assert_eq!(answer.facts["error"]["code"], code, "{failure}");
            assert!(answer.text.starts_with(code), "{}", answer.text);
            assert_eq!(CallToolResult::from(answer).is_error, Some(true));
        }
    }
}
