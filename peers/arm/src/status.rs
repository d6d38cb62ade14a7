//! Reports to the sender of a command: the content of `status` messages (M42).

use mom_client::{Code, Map, Stale, Value, WireError, to_value};
use serde::{Deserialize, Serialize};

use crate::error::ArmError;
use crate::state::{CommandState, ScriptProgress};

/// How far one command has come: the content of a `status` message.
///
/// On the wire it is a map `{id?, peer, state, statement, of, error?}`; [`from_value`](mom_client::from_value)
/// reads it back. A command is known by `peer` and `id` together, because ids are unique per sender only.
///
/// ```
/// use mom_arm::{CommandState, Status};
/// use mom_client::{Map, from_value};
///
/// let content = Map::new().with("id", 4).with("peer", "alice").with("state", "executing")
///     .with("statement", 1).with("of", 2);
/// let status: Status = from_value(content.into())?;
/// assert_eq!((status.id, status.state), (Some(4), CommandState::Executing));
/// # Ok::<(), mom_client::WireError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The id of the command's parcel, if it had one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// Who sent the command.
    pub peer: String,
    /// What became of it.
    pub state: CommandState,
    /// The statement being executed, or the last one begun; 1 for the first, 0 before it.
    pub statement: u32,
    /// How many statements the command has; 0 where its script could not be read.
    pub of: u32,
    /// Why, where the state is `error`: `{name, code, text}` and what else applies (M53).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<Value>,
}

impl Status {
    /// Sets the progress of the command.
    pub(crate) fn at(mut self, state: CommandState, progress: ScriptProgress) -> Self {
        self.state = state;
        self.statement = progress.statement;
        self.of = progress.of;
        self
    }

    /// Sets the reason why the command ended.
    pub(crate) fn because(mut self, reason: Option<&CommandRefusal>) -> Self {
        self.error = reason.and_then(CommandRefusal::content);
        self
    }
}

/// Why a command was refused or ended before its end.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum CommandRefusal {
    /// The arm's own reason.
    Arm(ArmError),
    /// The command was not sent by the token's present owner.
    Stale(Stale),
    /// The state that the command was based on is outdated or unknown.
    State(WireError),
}

impl CommandRefusal {
    /// A map of code word, number, plain words, and what else applies.
    fn content(&self) -> Option<Value> {
        match self {
            CommandRefusal::Arm(error) => to_value(error).ok(),
            CommandRefusal::Stale(stale) => Some(stale_map(stale).into()),
            CommandRefusal::State(error) => Some(error.to_map().into()),
        }
    }
}

impl From<ArmError> for CommandRefusal {
    fn from(error: ArmError) -> Self {
        CommandRefusal::Arm(error)
    }
}

impl From<Stale> for CommandRefusal {
    fn from(stale: Stale) -> Self {
        CommandRefusal::Stale(stale)
    }
}

impl From<WireError> for CommandRefusal {
    fn from(error: WireError) -> Self {
        CommandRefusal::State(error)
    }
}

fn stale_map(stale: &Stale) -> Map {
    let now = match &stale.owner {
        Some(owner) => format!("{owner} owns the arm's token now, with fence {}", stale.fence),
        None => "nobody owns the arm's token now".to_owned(),
    };
    let text = match stale.given {
        Some(given) => format!("the command was sent under fence {given}, and {now}"),
        None => format!("the command was sent without a fence, and {now}"),
    };
    let map = Map::new()
        .with("name", Code::OLDER_FENCE.word())
        .with("code", u32::from(Code::OLDER_FENCE.number()))
        .with("text", text);
    match &stale.owner {
        Some(owner) => map.with("owner", owner.as_str()),
        None => map,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(given: Option<u64>, owner: Option<&str>, text: &str) {
        let stale = Stale {
            name: "command".to_owned(),
            given,
            fence: 9_437_190,
            owner: owner.map(str::to_owned),
        };
        let map = CommandRefusal::from(stale).content().unwrap();
        assert_eq!(map.get("text").and_then(Value::as_str), Some(text));
        assert_eq!(map.get("owner").and_then(Value::as_str), owner);
        assert_eq!(map.get("code"), Some(&Value::Int(205)));
    }

    #[test]
    fn a_stale_command_is_refused_in_plain_words() {
        check(
            Some(9_437_189),
            Some("bob"),
            "the command was sent under fence 9437189, and bob owns the arm's token now, with fence 9437190",
        );
        check(
            Some(9_437_190),
            None,
            "the command was sent under fence 9437190, and nobody owns the arm's token now",
        );
        check(
            None,
            Some("bob"),
            "the command was sent without a fence, and bob owns the arm's token now, with fence 9437190",
        );
    }
}
