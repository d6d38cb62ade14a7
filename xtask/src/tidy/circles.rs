//! Circles among things that use each other.

use std::collections::{BTreeMap, BTreeSet};

/// The sets of things that use each other, directly or by way of others: each in alphabetical order. What is used and uses nothing need not
/// stand among them.
pub(crate) fn circles(uses: &BTreeMap<String, BTreeSet<String>>) -> Vec<Vec<&str>> {
    let reached: BTreeMap<&str, BTreeSet<&str>> = (uses.keys())
        .map(|from| (from.as_str(), reached_from(uses, from)))
        .collect();
    let (mut circles, mut told) = (Vec::new(), BTreeSet::new());
    for (from, there) in &reached {
        let reaches_back = |other: &&str| reached.get(other).is_some_and(|back| back.contains(from));
        let circle: Vec<&str> = there.iter().copied().filter(reaches_back).collect();
        if circle.len() > 1 && told.insert(*from) {
            told.extend(&circle);
            circles.push(circle);
        }
    }
    circles
}

fn reached_from<'a>(uses: &'a BTreeMap<String, BTreeSet<String>>, from: &'a str) -> BTreeSet<&'a str> {
    let (mut seen, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(at) = open.pop() {
        for next in uses.get(at).into_iter().flatten() {
            if seen.insert(next.as_str()) {
                open.push(next);
            }
        }
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn those_who_use_each_other_are_one_circle() {
        let uses = |pairs: &[(&str, &str)]| {
            let mut uses: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
            for (from, to) in pairs {
                uses.entry((*from).to_owned())
                    .or_default()
                    .insert((*to).to_owned());
            }
            uses
        };
        let none: [&[&str]; 0] = [];
        assert_eq!(
            circles(&uses(&[("a", "b"), ("b", "c"), ("a", "c"), ("a", "a")])),
            none
        );
        assert_eq!(
            circles(&uses(&[("a", "b"), ("b", "c"), ("c", "a"), ("d", "a")])),
            [["a", "b", "c"]]
        );
        let two = uses(&[("a", "b"), ("b", "a"), ("b", "c"), ("c", "d"), ("d", "c")]);
        assert_eq!(circles(&two), [["a", "b"], ["c", "d"]]);
    }
}
