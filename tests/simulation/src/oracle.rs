//! Which promises were broken, by what has happened.

use std::collections::{BTreeMap, BTreeSet};

use crate::log::{Fact, Instant};

/// What is known of a command that was sent.
struct Sent<'a> {
    by: &'a str,
    fence: u64,
}

/// The promises that were broken.
#[must_use]
pub fn broken(facts: &[(Instant, Fact)]) -> Vec<String> {
    let mut broken = begun_in_order(facts);
    broken.extend(stops_hold(facts));
    broken.extend(each_fence_is_one_owners(facts));
    broken.extend(facts.iter().filter_map(|(at, fact)| match fact {
        Fact::Broken(words) => Some(format!("{at}: {words}")),
        _ => None,
    }));
    broken
}

/// A device begins each command once, those of one owner in the order in which they were sent, and none of an earlier owner when it has
/// begun one of a later.
fn begun_in_order(facts: &[(Instant, Fact)]) -> Vec<String> {
    let mut broken = Vec::new();
    let mut sent: BTreeMap<u64, Sent<'_>> = BTreeMap::new();
    let mut begun: BTreeSet<u64> = BTreeSet::new();
    // The fence and the command that each device began last.
    let mut last: BTreeMap<usize, (u64, u64)> = BTreeMap::new();
    for (at, fact) in facts {
        match fact {
            Fact::Sent {
                by, command, fence, ..
            } => {
                sent.insert(*command, Sent { by, fence: *fence });
            }
            Fact::Began { device, command } => {
                let Some(known) = sent.get(command) else {
                    broken.push(format!("{at}: d{device} began {command}, which nobody has sent"));
                    continue;
                };
                if !begun.insert(*command) {
                    broken.push(format!("{at}: d{device} began {command} of {} twice", known.by));
                }
                if let Some((fence, before)) = last.get(device) {
                    if known.fence < *fence {
                        let by = known.by;
                        broken.push(format!(
                            "{at}: d{device} began {command} of {by} under {}, behind {before} under {fence}",
                            known.fence
                        ));
                    } else if known.fence == *fence && command < before {
                        broken.push(format!(
                            "{at}: d{device} began {command} behind {before}, which was sent later"
                        ));
                    }
                }
                last.insert(*device, (known.fence, *command));
            }
            _ => {}
        }
    }
    broken
}

/// A fence is given out once, and none is lower than one before.
fn each_fence_is_one_owners(facts: &[(Instant, Fact)]) -> Vec<String> {
    let mut broken = Vec::new();
    let mut owners: BTreeMap<(usize, u64), &str> = BTreeMap::new();
    for (at, fact) in facts {
        let Fact::Granted { by, device, fence } = fact else {
            continue;
        };
        // The same grant may be told twice, and a frozen operator learns of it late.
        match owners.insert((*device, *fence), by) {
            Some(before) if before != by => {
                broken.push(format!(
                    "{at}: {by} has d{device} under fence {fence}, as {before} had"
                ));
            }
            _ => {}
        }
    }
    broken
}

/// A stop that a device was said to obey holds until an unstop is asked for that names it or a newer one; but for a hub that has forgotten
/// it at its restart, and a device that has.
fn stops_hold(facts: &[(Instant, Fact)]) -> Vec<String> {
    let mut broken = Vec::new();
    // The newest stop that each device obeys, and whether the device and the hub have been started again since.
    let mut held: BTreeMap<usize, (u64, bool, bool)> = BTreeMap::new();
    // The highest number that an unstop has named.
    let mut lifted: BTreeMap<usize, u64> = BTreeMap::new();
    for (at, fact) in facts {
        match fact {
            Fact::StopObeyed { device, number, .. }
                if lifted.get(device).is_none_or(|lifted| lifted < number) =>
            {
                held.insert(*device, (*number, false, false));
            }
            Fact::UnstopAsked { device, number, .. } => {
                let highest = lifted.entry(*device).or_default();
                *highest = (*highest).max(*number);
                if held.get(device).is_some_and(|(held, ..)| *held <= *number) {
                    held.remove(device);
                }
            }
            Fact::Started { device } => {
                if let Some((_, is_new, _)) = held.get_mut(device) {
                    *is_new = true;
                }
            }
            Fact::HubKilled => {
                held.values_mut()
                    .for_each(|(_, _, is_forgotten)| *is_forgotten = true);
            }
            Fact::Began { device, command } => {
                if let Some((number, is_new, is_forgotten)) = held.get(device)
                    && !(*is_new && *is_forgotten)
                {
                    broken.push(format!(
                        "{at}: d{device} began {command}, though it obeys stop {number}"
                    ));
                }
            }
            _ => {}
        }
    }
    broken
}

/// How much of what has happened.
#[must_use]
pub fn counts(facts: &[(Instant, Fact)]) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for (_, fact) in facts {
        let what = match fact {
            Fact::Sent { .. } => "sent",
            Fact::Taken { .. } => "taken",
            Fact::Began { .. } => "began",
            Fact::Halted { .. } => "halted",
            Fact::Started { .. } => "starts",
            Fact::Granted { .. } => "granted",
            Fact::Lost { .. } => "lost",
            Fact::StopAsked { .. } => "stops",
            Fact::StopObeyed { .. } => "obeyed",
            Fact::UnstopAsked { .. } => "unstops",
            Fact::Fault(_) => "faults",
            Fact::HubKilled => "hub-killed",
            Fact::Healed => "healed",
            Fact::Broken(_) => "broken",
            Fact::Served { .. } => "served",
        };
        *counts.entry(what).or_default() += 1;
    }
    counts
}
