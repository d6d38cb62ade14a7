//! A refusal as text: what, by which rule, who owns it, when to try again, what to do now.

use mom_client::{Code, Refusal as Details, Value, WireError, ordinal};

use super::words;
use crate::failure::HINT;

/// The first line of a refusal, and below it what is known, each with its label.
#[derive(Debug, PartialEq)]
pub(crate) struct RefusalText {
    /// What was refused and why, in one line.
    pub(crate) headline: String,
    /// Label and text, in the order in which a reader asks.
    pub(crate) facts: Vec<(&'static str, String)>,
}

/// Words for the hub's refusal of `what` (`grab /robot/token`).
pub(crate) fn refusal(what: &str, error: &WireError) -> RefusalText {
    let text = match error.text.is_empty() {
        true => error.code.word().to_owned(),
        false => words::visible(&error.text),
    };
    let details = Details::of(error);
    let mut facts = Vec::new();
    let mut fact = |label, text: Option<String>| facts.extend(text.map(|text| (label, text)));
    fact("rule", details.rule.map(words::visible));
    fact("owner", owner(&details));
    fact("holders", holders(&details));
    fact("you", details.level.map(|level| format!("level {level}")));
    fact("retry", retry(&details));
    fact("place", place(&details));
    fact("slot", string(error, "slot"));
    fact(
        "position",
        int(error, "position").map(|position| format!("byte {position}")),
    );
    fact(
        "nearest",
        string(error, "nearest").map(|nearest| format!("did you mean {nearest}?")),
    );
    fact("code", Some(format!("{} ({})", error.code, error.code.number())));
    fact(
        "try",
        string(error, HINT).or_else(|| hint(error).map(str::to_owned)),
    );
    RefusalText {
        headline: format!("{what}: {text}"),
        facts,
    }
}

fn owner(details: &Details<'_>) -> Option<String> {
    let owner = words::visible(details.owner?);
    Some(match details.owner_level {
        Some(level) => format!("{owner}, level {level}"),
        None => owner,
    })
}

fn holders(details: &Details<'_>) -> Option<String> {
    let holders: Vec<String> = details.holders.iter().map(|peer| words::visible(peer)).collect();
    (!holders.is_empty()).then(|| holders.join(", "))
}

fn retry(details: &Details<'_>) -> Option<String> {
    let wait = details.retry_after?;
    let words = words::duration(wait);
    let owner = details.owner.map(words::visible);
    Some(match (owner, wait.is_zero()) {
        (_, true) => "at once".to_owned(),
        (Some(owner), false) => format!("in {words} at the earliest, if {owner} does not renew before"),
        (None, false) => format!("in {words} at the earliest"),
    })
}

/// The place that a waiting grab would have, or had when its wait ended.
fn place(details: &Details<'_>) -> Option<String> {
    let place = ordinal(details.place?);
    Some(match details.expected {
        _ if *details.code == Code::TIMED_OUT => format!("{place} in the queue when the time was over"),
        Some(expected) => format!(
            "{place} in the queue, if you wait; your turn would be in {}",
            words::duration(expected)
        ),
        None => format!("{place} in the queue, if you wait"),
    })
}

/// What helps most people who get this code.
fn hint(error: &WireError) -> Option<&'static str> {
    let hints = [
        (
            Code::HELD,
            "wait for your turn with `mom grab --wait 5m`, or ask the owner with `mom request`",
        ),
        (
            Code::NO_OFFER,
            "`mom token` shows what is offered, and who has asked",
        ),
        (
            Code::STORAGE_FAILED,
            "nothing has changed; the hub's store needs its operator",
        ),
        (
            Code::NOT_OWNER,
            "only the token's owner sends this; `mom run` grabs the token, sends, and releases it",
        ),
        (Code::UNKNOWN_PATH, "`mom tree` shows what there is"),
        (Code::WRONG_KIND, "`mom tree` shows of which kind each context is"),
        (Code::UNKNOWN_PEER, "`mom tree` shows who is there"),
        (
            Code::NOT_LOGGED_IN,
            "name yourself with --user, and give MOM_PASSWORD",
        ),
        (
            Code::INSECURE,
            "passwords go over TLS or loopback only: connect to bins:// or tcps://",
        ),
        (
            Code::TOO_MANY_CONNECTIONS,
            "close connections that are not needed, or raise the hub's limit",
        ),
        (Code::SHUTDOWN, "the hub is going down; try again when it is back"),
    ];
    hints
        .into_iter()
        .find(|(code, _)| *code == error.code)
        .map(|(_, hint)| hint)
}

fn string(error: &WireError, key: &str) -> Option<String> {
    error.get(key).and_then(Value::as_str).map(words::visible)
}

fn int(error: &WireError, key: &str) -> Option<i64> {
    error.get(key).and_then(Value::as_int)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn check(what: &str, error: &WireError, headline: &str, facts: &[(&str, &str)]) {
        let told = refusal(what, error);
        assert_eq!(told.headline, headline);
        let told: Vec<(&str, &str)> = told
            .facts
            .iter()
            .map(|(label, text)| (*label, text.as_str()))
            .collect();
        assert_eq!(told, facts, "{headline}");
    }

    #[test]
    fn refusals_in_words() {
        check(
            "grab /robot/token",
            &WireError::new(Code::HELD, "/robot/token is held by alice")
                .rule("lab-token")
                .owner("alice", 1)
                .level(1)
                .retry_after(Duration::from_millis(177_400))
                .detail("place", 2)
                .detail("expected", 357_400),
            "grab /robot/token: /robot/token is held by alice",
            &[
                ("rule", "lab-token"),
                ("owner", "alice, level 1"),
                ("you", "level 1"),
                (
                    "retry",
                    "in 2 min 58 s at the earliest, if alice does not renew before",
                ),
                (
                    "place",
                    "2nd in the queue, if you wait; your turn would be in 5 min 58 s",
                ),
                ("code", "held (101)"),
                (
                    "try",
                    "wait for your turn with `mom grab --wait 5m`, or ask the owner with `mom request`",
                ),
            ],
        );
        check(
            "send to /robot/arm",
            &WireError::new(Code::NOT_OWNER, "/robot/token has no owner"),
            "send to /robot/arm: /robot/token has no owner",
            &[
                ("code", "not-owner (204)"),
                (
                    "try",
                    "only the token's owner sends this; `mom run` grabs the token, sends, and releases it",
                ),
            ],
        );
        check(
            "look up /robt",
            &WireError::new(Code::UNKNOWN_PATH, "there is no context /robt").nearest("/robot"),
            "look up /robt: there is no context /robt",
            &[
                ("nearest", "did you mean /robot?"),
                ("code", "unknown-path (210)"),
                ("try", "`mom tree` shows what there is"),
            ],
        );
        check(
            "x",
            &WireError::new(Code::from_wire(199, "from-later"), "").retry_after(Duration::ZERO),
            "x: from-later",
            &[("retry", "at once"), ("code", "from-later (199)")],
        );
    }

    #[test]
    fn what_stands_in_the_way() {
        check(
            "grab /t",
            &WireError::new(Code::TIMED_OUT, "not within 5 s")
                .owner("alice", 1)
                .detail("place", 1),
            "grab /t: not within 5 s",
            &[
                ("owner", "alice, level 1"),
                ("place", "1st in the queue when the time was over"),
                ("code", "timed-out (102)"),
            ],
        );
        check(
            "inhibit /t",
            &WireError::new(Code::DENIED, "no").detail("holders", vec!["bob".into(), "dan".into()]),
            "inhibit /t: no",
            &[("holders", "bob, dan"), ("code", "denied (200)")],
        );
    }
}
