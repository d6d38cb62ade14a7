//! What the commander hears about one command: the content of `status` messages (M42).

use mom_client::{Code, Map, Value, to_value};
use serde::{Deserialize, Serialize};

use crate::error::ArmError;
use crate::state::{CommandState, Progress};

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
    /// Puts in how far the command has come.
    pub(crate) fn at(mut self, state: CommandState, progress: Progress) -> Self {
        self.state = state;
        self.statement = progress.statement;
        self.of = progress.of;
        self
    }

    /// Puts in why the command ended.
    pub(crate) fn because(mut self, reason: Option<&Refusal>) -> Self {
        self.error = reason.and_then(Refusal::content);
        self
    }
}

/// Why a command was refused or ended before its end.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Refusal {
    /// The arm's own reason.
    Arm(ArmError),
    /// The command's fence is not that of the present owner; in plain words.
    Fence(String),
}

impl Refusal {
    /// A map of code word, number and plain words.
    fn content(&self) -> Option<Value> {
        match self {
            Refusal::Arm(error) => to_value(error).ok(),
            Refusal::Fence(text) => {
                let code = Code::OLDER_FENCE;
                let map = Map::new()
                    .with("name", code.word())
                    .with("code", u32::from(code.number()))
                    .with("text", text.as_str());
                Some(map.into())
            }
        }
    }
}

impl From<ArmError> for Refusal {
    fn from(error: ArmError) -> Self {
        Refusal::Arm(error)
    }
}
