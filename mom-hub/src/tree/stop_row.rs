//! A latch as it is written down: in the file of stops and in recordings.

use std::sync::Arc;

use mom_proto::{Path, Time};
use serde::{Deserialize, Serialize};

use super::latch::{Latch, Stop, StopRecord};

/// A [`StopRecord`] in types that any format of `serde` has.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopRow {
    path: String,
    newest: u64,
    #[serde(default)]
    known: u64,
    #[serde(default)]
    lifted: u64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    all: Option<StopFacts>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    each: Vec<(String, Option<StopFacts>)>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    device: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StopFacts {
    number: u64,
    by: String,
    user: String,
    /// µs since 1970.
    since: i64,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

impl From<&StopRecord> for StopRow {
    fn from(record: &StopRecord) -> StopRow {
        let facts = |stop: &Arc<Stop>| StopFacts {
            number: stop.number.into(),
            by: stop.by.to_string(),
            user: stop.user.to_string(),
            since: stop.since.micros(),
            reason: stop.reason.as_deref().map(str::to_owned),
        };
        let each = record.latch.each.iter();
        StopRow {
            path: record.path.to_string(),
            newest: record.latch.newest.into(),
            known: record.latch.known.into(),
            lifted: record.latch.lifted.into(),
            all: record.latch.all.as_ref().map(facts),
            each: each
                .map(|(name, own)| (name.to_string(), own.as_ref().map(facts)))
                .collect(),
            device: record.latch.device,
        }
    }
}

impl StopRow {
    /// The record.
    ///
    /// # Errors
    /// What of it cannot be.
    pub fn record(self) -> Result<StopRecord, String> {
        let stop = |facts: StopFacts| {
            let since = Time::from_micros(facts.since)
                .ok_or_else(|| format!("{} µs is out of range", facts.since))?;
            Ok::<_, String>(Arc::new(Stop {
                number: facts.number.into(),
                by: facts.by.into(),
                user: facts.user.into(),
                since,
                reason: facts.reason.map(Into::into),
            }))
        };
        let path =
            Path::parse(&self.path).map_err(|error| format!("{:?} is not a path: {error}", self.path))?;
        let each = self
            .each
            .into_iter()
            .map(|(name, own)| Ok((name.into(), own.map(stop).transpose()?)));
        Ok(StopRecord {
            path,
            latch: Latch {
                newest: self.newest.into(),
                known: self.known.into(),
                lifted: self.lifted.into(),
                all: self.all.map(stop).transpose()?,
                each: each.collect::<Result<_, String>>()?,
                device: self.device,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_read_as_it_was_written() {
        let stop = |number: u64, reason: Option<&str>| {
            Arc::new(Stop {
                number: number.into(),
                by: "bob~2".into(),
                user: "bob".into(),
                since: Time::from_micros(1_795_255_200_000_001).expect("a time"),
                reason: reason.map(Into::into),
            })
        };
        let record = StopRecord {
            path: Path::parse("/robot/arm").expect("a path"),
            latch: Latch {
                newest: 9.into(),
                known: 3.into(),
                lifted: 6.into(),
                all: Some(stop(7, None)),
                each: [
                    ("arm".into(), Some(stop(9, Some("smoke")))),
                    ("belt".into(), None),
                ]
                .into(),
                device: true,
            },
        };
        let row = StopRow::from(&record);
        assert_eq!(row.clone().record(), Ok(record));
        let wrong = StopRow {
            path: "robot".to_owned(),
            ..row
        };
        assert!(wrong.record().is_err_and(|error| error.contains("not a path")));
    }
}
