//! Which robots are meant.

use std::collections::{BTreeMap, BTreeSet};

/// The highest number of a robot.
const HIGHEST: u32 = 99_999;

/// Robots as they are typed: `all`, or numbers, ranges and groups such as `1,3-5,scouts`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Units {
    All,
    Some {
        units: BTreeSet<u32>,
        groups: BTreeSet<String>,
    },
}

/// The robots that are there.
#[derive(Debug, Default)]
pub(super) struct Known {
    pub(super) units: BTreeSet<u32>,
    /// Those of each group.
    pub(super) groups: BTreeMap<String, BTreeSet<u32>>,
}

impl Units {
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        if text.trim() == "all" {
            return Ok(Self::All);
        }
        let (mut units, mut groups) = (BTreeSet::new(), BTreeSet::new());
        for part in text.split(',') {
            if part.trim().starts_with(|c: char| c.is_ascii_alphabetic()) {
                groups.insert(part.trim().to_owned());
                continue;
            }
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let (first, last) = (number(first)?, number(last)?);
            if first > last {
                return Err(format!("`{}` begins above its end", part.trim()));
            }
            units.extend(first..=last);
        }
        Ok(Self::Some { units, groups })
    }

    /// Whether it takes more than numbers to know which are meant.
    pub(super) fn has_groups(&self) -> bool {
        matches!(self, Self::Some { groups, .. } if !groups.is_empty())
    }

    /// Those of them that are there, in their order; else what is not.
    pub(super) fn of(&self, known: &Known) -> Result<Vec<u32>, String> {
        let Self::Some { units, groups } = self else {
            return Ok(known.units.iter().copied().collect());
        };
        let mut meant = units.clone();
        for group in groups {
            match known.groups.get(group) {
                Some(units) => meant.extend(units),
                None => return Err(format!("there is no group {group}")),
            }
        }
        match meant.iter().find(|unit| !known.units.contains(unit)) {
            Some(missing) => Err(format!("there is no robot {missing}")),
            None => Ok(meant.into_iter().collect()),
        }
    }
}

fn number(text: &str) -> Result<u32, String> {
    let text = text.trim();
    text.parse()
        .ok()
        .filter(|number| (1..=HIGHEST).contains(number))
        .ok_or_else(|| {
            format!(
                "`{text}` is not a number of a robot; numbers, ranges and groups such as 1,3-5,scouts, or all"
            )
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_ranges_groups_and_all() {
        let known = Known {
            units: (1..=6).collect(),
            groups: [("reds".to_owned(), [2, 4].into())].into(),
        };
        for (text, expected) in [
            ("all", Ok(vec![1, 2, 3, 4, 5, 6])),
            ("3", Ok(vec![3])),
            ("5, 1-2,2", Ok(vec![1, 2, 5])),
            ("reds ,6", Ok(vec![2, 4, 6])),
            ("4-9", Err("there is no robot 7".to_owned())),
            ("1,blues", Err("there is no group blues".to_owned())),
        ] {
            let units = Units::parse(text).expect(text);
            assert_eq!(units.of(&known), expected, "{text}");
        }
        for (text, words) in [
            ("", "`` is not a number of a robot"),
            ("0", "`0` is not a number of a robot"),
            ("1-", "`` is not a number of a robot"),
            ("2,*", "`*` is not a number of a robot"),
            ("100000", "`100000` is not a number"),
            ("5-3", "`5-3` begins above its end"),
        ] {
            let error = Units::parse(text).expect_err(text);
            assert!(error.starts_with(words), "{error}");
        }
    }
}
