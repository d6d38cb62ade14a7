//! What a channel keeps for those who join later (design §4, §7).

use mom_proto::{Map, Micros, WireError, event};
use serde::Deserialize;

use crate::content::{bad, micros};
use crate::values::{count, millis};

/// Bytes of content that are kept: default and maximum.
const BYTES: usize = 1 << 20;
const MOST_BYTES: usize = 16 << 20;

/// Parcels that are kept where only bytes or an age is given, and the maximum.
const PARCELS: usize = 1000;
const MOST_PARCELS: usize = 10_000;

/// What a channel keeps. It never keeps guarded or addressed messages, nor `command`, `stop`, `unstop` and `halt`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Keep {
    /// Only the newest of each sender and name, as long as its sender is a member.
    pub latest: bool,
    /// At most so many parcels.
    pub parcels: usize,
    /// At most so many bytes.
    pub bytes: usize,
    /// Nothing that came longer ago, µs; none = however long ago.
    pub age: Option<Micros>,
}

/// The key `keep` of a channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct KeepArgs {
    /// Only the newest of each sender and name.
    pub latest: bool,
    /// At most so many parcels.
    pub parcels: Option<usize>,
    /// At most so many bytes.
    pub bytes: Option<usize>,
    /// Nothing older, ms.
    pub age: Option<u64>,
}

impl KeepArgs {
    pub(crate) fn read(self) -> Result<Keep, WireError> {
        if self == KeepArgs::default() {
            let text = "keep requires latest = true, or parcels, bytes or age";
            return Err(bad("keep", text.to_owned()));
        }
        let within = |key: &str, value: Option<usize>, usual: usize, most: usize| {
            let value = value.unwrap_or(usual);
            let text = || format!("{key} must be a number from 1 to {most}");
            let fits = (1..=most).contains(&value);
            fits.then_some(value)
                .ok_or_else(|| bad(&format!("keep/{key}"), text()))
        };
        Ok(Keep {
            latest: self.latest,
            parcels: within("parcels", self.parcels, PARCELS, MOST_PARCELS)?,
            bytes: within("bytes", self.bytes, BYTES, MOST_BYTES)?,
            age: self.age.map(|age| micros(age, "keep/age")).transpose()?,
        })
    }
}

impl Keep {
    /// Whether unguarded messages of this name are kept: a message that moves a device is never delivered later.
    pub fn covers(name: &str) -> bool {
        !matches!(name, event::COMMAND | event::STOP | event::UNSTOP | event::HALT)
    }

    /// For replies.
    pub(crate) fn to_map(self) -> Map {
        let map = Map::new()
            .with("latest", self.latest)
            .with("parcels", count(self.parcels))
            .with("bytes", count(self.bytes));
        match self.age {
            Some(age) => map.with("age", millis(age)),
            None => map,
        }
    }
}
