//! All that is wrong in a file: what is at fault is struck out, and the rest is read again.

use std::collections::BTreeSet;
use std::ops::Range;

use mom_toml_faults::{At, Item, Section};

use crate::check;
use crate::fault::{Fault, Found};
use crate::model::HIGHEST_PACKET;
use crate::text::Source;

/// The most faults that are told: who has so many looks at the first ones.
const MOST: usize = 50;
/// The most times that a file is read for them.
const READS: usize = 1000;

/// What follows from a fault that is struck out.
enum Struck {
    /// It is a fault of its own.
    Told,
    /// It is one only because of something that was struck out before.
    Follows,
    /// The same, or told and the last: nothing is left to read.
    End { told: bool },
}

/// What was struck out.
#[derive(Default)]
struct Gone {
    /// Names of elements.
    elements: BTreeSet<String>,
    /// Places of sections with an unknown key, which may stand for one that is missing.
    misspelt: BTreeSet<usize>,
}

/// The faults of a file, in the order of their places; none in one that can be read.
///
/// Of an element whose kind, type or numbers are at fault nothing more is told, as what they should have been is not known.
pub(crate) fn all(mut source: Source) -> Vec<Found> {
    let (mut found, mut gone) = (Vec::new(), Gone::default());
    for _ in 0..READS {
        let Err(fault) = check::model(&source) else { break };
        let struck = strike(&mut source, &fault, &mut gone);
        if matches!(struck, Struck::Told | Struck::End { told: true }) {
            found.push(fault);
        }
        if matches!(struck, Struck::End { .. }) || found.len() == MOST {
            break;
        }
    }
    found.sort_by_key(|fault| fault.start);
    found
}

fn strike(source: &mut Source, fault: &Found, gone: &mut Gone) -> Struck {
    match fault.fault {
        // Without those that were struck out there may be none.
        Fault::Elements => {
            return Struck::End {
                told: gone.elements.is_empty(),
            };
        }
        // It is found last.
        Fault::Packet => return Struck::End { told: true },
        _ => {}
    }
    let (is_unknown, is_missing) = (fault.fault == Fault::UnknownKey, fault.fault == Fault::MissingKey);
    if let Some(entry) = entry_at(&source.root, fault.start) {
        strike_root(&mut source.root, entry);
        gone.misspelt.extend(is_unknown.then_some(source.root.span.start));
        return Struck::Told;
    }
    for index in 0..source.elements.len() {
        let element = &mut source.elements[index];
        let (entry, place) = (entry_at(element, fault.start), element.span.start);
        if entry.is_none() && place != fault.start {
            continue;
        }
        let follows = match fault.fault {
            Fault::Reference => refers_to(element, fault.start, &gone.elements),
            _ => is_missing && gone.misspelt.contains(&place),
        };
        gone.misspelt.extend(is_unknown.then_some(place));
        if !entry.is_some_and(|entry| mend(element, entry, fault, index)) {
            gone.elements.extend(name_of(element));
            source.elements.remove(index);
        }
        return if follows { Struck::Follows } else { Struck::Told };
    }
    if !is_missing {
        return Struck::End { told: true };
    }
    let root = &mut source.root;
    match has(root, "name") {
        true => give(root, "id", Item::Integer(0)),
        false => give(root, "name", Item::Text("struck-out".to_owned())),
    }
    match gone.misspelt.contains(&root.span.start) {
        true => Struck::Follows,
        false => Struck::Told,
    }
}

/// The entry whose key or value is at a place of the text.
fn entry_at(section: &Section, start: usize) -> Option<usize> {
    let is_at = |span: &Range<usize>| span.start == start || span.contains(&start);
    let mut entries = section.entries.iter();
    entries.position(|(key, item)| is_at(&key.span) || is_at(&item.span))
}

fn has(section: &Section, key: &str) -> bool {
    section.entries.iter().any(|(name, _)| name.value == key)
}

fn give(section: &mut Section, key: &str, value: Item) {
    // No place of the text is theirs.
    let span = usize::MAX..usize::MAX;
    let name = At {
        value: key.to_owned(),
        span: span.clone(),
    };
    section.entries.push((name, At { value, span }));
}

/// Strikes an entry of the file's own, so that the rest can be read.
fn strike_root(root: &mut Section, entry: usize) {
    let (key, _) = root.entries.remove(entry);
    match key.value.as_str() {
        // No default says them.
        "name" => give(root, "name", Item::Text("struck-out".to_owned())),
        "id" => give(root, "id", Item::Integer(0)),
        "largest-packet" => give(root, "largest-packet", Item::Integer(HIGHEST_PACKET.into())),
        // A watchdog is measured by it.
        "period" => root.entries.retain(|(key, _)| key.value != "watchdog"),
        _ => {}
    }
}

/// Strikes what nothing else of the element depends upon; false if that is not so.
fn mend(element: &mut Section, entry: usize, fault: &Found, index: usize) -> bool {
    let (key, item) = &mut element.entries[entry];
    let free =
        ["doc", "period", "lasts", "unit", "rate", "sound", "interpolate"].contains(&key.value.as_str());
    match (&mut item.value, key.value.as_str()) {
        _ if free || matches!(fault.fault, Fault::UnknownKey | Fault::NotOfKind) => {
            element.entries.remove(entry);
            true
        }
        (name @ (Item::Text(_) | Item::Raw(_)), "name") => {
            *name = Item::Text(format!("struck-out-{index}"));
            true
        }
        (Item::List(members), "members") => {
            let before = members.len();
            members.retain(|member| member.span.start != fault.start);
            members.len() < before
        }
        _ => false,
    }
}

fn name_of(element: &Section) -> Option<String> {
    let (_, name) = element.entries.iter().find(|(key, _)| key.value == "name")?;
    match &name.value {
        Item::Text(name) | Item::Raw(name) => Some(name.clone()),
        _ => None,
    }
}

/// Whether the name that stands there is that of an element that was struck out.
fn refers_to(element: &Section, start: usize, gone: &BTreeSet<String>) -> bool {
    let is_gone = |item: &At<Item>| match &item.value {
        Item::Text(name) => gone.contains(name),
        Item::Raw(names) => names.split_whitespace().any(|name| gone.contains(name)),
        _ => false,
    };
    element.entries.iter().any(|(_, item)| match &item.value {
        Item::List(list) => list.iter().any(|item| item.span.start == start && is_gone(item)),
        _ => item.span.start == start && is_gone(item),
    })
}
