//! Why a command is refused, and how that is told.

use mom_client::{Code, Map, Stale, Value, WireError, to_value};

use crate::DeviceError;

/// Why a command was refused.
pub(crate) enum CommandRefusal {
    /// The device's own reason.
    Device(DeviceError),
    /// The command was not sent by the token's present owner.
    Stale(Stale),
    /// The state that the command was based on is outdated or unknown, or it is not an answer in time.
    State(WireError),
}

impl CommandRefusal {
    /// A map of code word, number, plain words, and what else applies.
    pub(crate) fn content(&self) -> Option<Value> {
        match self {
            CommandRefusal::Device(error) => to_value(error).ok(),
            CommandRefusal::Stale(stale) => Some(stale_map(stale).into()),
            CommandRefusal::State(error) => Some(error.to_map().into()),
        }
    }
}

impl From<DeviceError> for CommandRefusal {
    fn from(error: DeviceError) -> Self {
        CommandRefusal::Device(error)
    }
}

impl From<WireError> for CommandRefusal {
    fn from(error: WireError) -> Self {
        CommandRefusal::State(error)
    }
}

impl From<Stale> for CommandRefusal {
    fn from(stale: Stale) -> Self {
        CommandRefusal::Stale(stale)
    }
}

fn stale_map(stale: &Stale) -> Map {
    let now = match &stale.owner {
        Some(owner) => format!("{owner} owns its token now, with fence {}", stale.fence),
        None => "nobody owns its token now".to_owned(),
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

    #[test]
    fn a_stale_command_is_refused_in_plain_words() {
        for (given, owner, text) in [
            (
                Some(7),
                Some("bob"),
                "the command was sent under fence 7, and bob owns its token now, with fence 9",
            ),
            (
                Some(9),
                None,
                "the command was sent under fence 9, and nobody owns its token now",
            ),
            (
                None,
                None,
                "the command was sent without a fence, and nobody owns its token now",
            ),
        ] {
            let stale = Stale {
                name: "command".to_owned(),
                given,
                fence: 9,
                owner: owner.map(str::to_owned),
            };
            let map = stale_map(&stale);
            assert_eq!(map.get("text").and_then(Value::as_str), Some(text));
            assert_eq!(map.get("owner").and_then(Value::as_str), owner);
        }
    }
}
