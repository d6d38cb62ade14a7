//! Reports to the sender of a command: the content of `status` messages (M42).

use mom_client::Value;
use serde::{Deserialize, Serialize};

use crate::state::CommandState;

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
