//! A context to be made, as it stands in a request or in the configuration.

use mom_managers::Expiry;
use mom_proto::{Delivery, Overflow, Value, WireError, check_message_name, event};
use serde::Deserialize;

use super::context::Presence;
use super::keep::KeepArgs;
use crate::content::bad;

/// The least that a device reads, bytes a second: less than signs of life and replies take.
const LEAST_PACE: u32 = 1000;

/// A context to be made: the content of `context create`, or an entry of the configuration file.
///
/// ```
/// use mom_hub::ContextSpec;
/// use mom_proto::{Map, from_value};
/// let spec: ContextSpec = from_value(Map::new().with("kind", "token").with("lease", 60_000).into()).unwrap();
/// assert_eq!(spec.lease, Some(60_000));
/// ```
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct ContextSpec {
    /// The path; in a request it is the slot `context` instead.
    #[serde(default)]
    pub path: Option<String>,
    /// `session`, `channel` or `token`.
    pub kind: String,
    /// A name of the configuration, or a map with `kind` and parameters; absent = the parent's.
    #[serde(default)]
    pub manager: Option<Value>,
    /// The members that are told of joins and leaves; absent = all.
    #[serde(default)]
    pub presence: Option<Presence>,
    /// Deleted with its last member.
    #[serde(default)]
    pub transient: bool,
    /// Channels: the messages that need ownership of a token.
    #[serde(default)]
    pub guard: Option<GuardArgs>,
    /// Channels: the delivery class of parcels that name none.
    #[serde(default)]
    pub delivery: Option<String>,
    /// Channels: what happens where a receiver has no room for a `reliable` parcel; absent = `close`.
    #[serde(default)]
    pub overflow: Option<String>,
    /// Channels: bytes that their devices read in a second; absent = not known.
    #[serde(default)]
    pub pace: Option<u32>,
    /// Channels: how many devices may obey there; absent = one where a token guards it, else several.
    #[serde(default)]
    pub devices: Option<Devices>,
    /// Channels: messages kept for late joiners; absent = none.
    #[serde(default)]
    pub keep: Option<KeepArgs>,
    /// Tokens: what is sent when ownership ends; absent = `halt` to every guarded channel.
    #[serde(default)]
    pub safe: Option<SafeArgs>,
    /// Tokens: how long ownership lasts without renewal, in ms; absent = as the manager says.
    #[serde(default)]
    pub lease: Option<u64>,
    /// Tokens: what happens at the lease's end; absent = as the manager says.
    #[serde(default)]
    pub expiry: Option<Expiry>,
    /// Tokens: the owner loses it if it does not renew for so long, in ms; absent = as the manager says.
    #[serde(default)]
    pub deadman: Option<u64>,
    /// Tokens: whether the safe state is sent also when the owner gives it away; absent = yes.
    #[serde(default)]
    pub safe_on_give: Option<bool>,
    /// Tokens: whether a stop of a channel that it guards ends its owner's grant; absent = no.
    #[serde(default)]
    pub stop_ends_grant: Option<bool>,
}

/// How many devices may be in a channel at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Devices {
    /// Another one is refused as `occupied`.
    One,
    /// All obey what is said to all.
    Several,
}

/// The guard of a channel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GuardArgs {
    /// The token's path.
    pub token: String,
    /// The messages; `*` stands for all.
    pub names: Vec<String>,
}

/// The safe state of a token.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SafeArgs {
    /// The channel's path.
    pub channel: String,
    /// The message's name.
    pub name: String,
    /// The message's content.
    #[serde(default)]
    pub content: Option<Value>,
}

impl SafeArgs {
    /// Checks the message's name.
    ///
    /// # Errors
    /// `bad-content` or `bad-name` with the key as slot.
    pub fn check_name(&self) -> Result<(), WireError> {
        check_message_name(&self.name).map_err(|error| error.slot("content/safe/name"))?;
        match &*self.name {
            event::STOP | event::UNSTOP => {
                let text = "safe cannot be stop or unstop, which need a right of their own; leave safe out to send halt";
                Err(bad("safe/name", text.to_owned()))
            }
            _ => Ok(()),
        }
    }
}

impl ContextSpec {
    /// The delivery class, checked.
    pub(crate) fn delivery(&self) -> Result<Delivery, WireError> {
        let Some(word) = &self.delivery else {
            return Ok(Delivery::default());
        };
        Delivery::from_word(word).ok_or_else(|| {
            bad(
                "delivery",
                format!("{word:?} is not one of reliable, latest, fleeting"),
            )
        })
    }

    /// What devices read in a second, checked.
    pub(crate) fn pace(&self) -> Result<Option<u32>, WireError> {
        match self.pace {
            Some(pace) if pace < LEAST_PACE => {
                let text = format!("{pace} bytes a second are below the minimum, {LEAST_PACE}");
                Err(bad("pace", text))
            }
            pace => Ok(pace),
        }
    }

    /// What happens where a receiver has no room, checked.
    pub(crate) fn overflow(&self) -> Result<Overflow, WireError> {
        let Some(word) = &self.overflow else {
            return Ok(Overflow::default());
        };
        let unknown = || bad("overflow", format!("{word:?} is not one of close, wait"));
        Overflow::from_word(word).ok_or_else(unknown)
    }
}
