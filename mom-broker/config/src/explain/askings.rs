//! All that can be asked of a context.

use mom_hub::ContextOutline;
use mom_proto::{ContextKind, Map, Path, Pattern, Value, Verb};

use crate::Config;

/// Stands for every message that no rule names.
const ANY_OTHER: &str = "*";

/// One request that could be made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asking {
    /// For what.
    pub verb: Verb,
    /// Where: the context, or for `create` a child of it.
    pub context: Path,
    /// The name of the message, for `send`.
    pub message: Option<String>,
}

/// The message of a request as the hub is asked about it.
pub fn message_of(verb: Verb, message: Option<&str>) -> Option<&str> {
    match verb {
        Verb::Send => Some(message.unwrap_or(ANY_OTHER)),
        // Messages with a verb of their own.
        Verb::Stop | Verb::Unstop => Some(verb.word()),
        _ => message,
    }
}

impl Config {
    /// All that can be asked of a context, or of a path where nothing is: each verb, and each message that a rule names.
    pub fn askings(&self, context: &Path, place: Option<&ContextOutline>) -> Vec<Asking> {
        let of = |verb: Verb, context: Path, message: Option<String>| Asking {
            verb,
            context,
            message,
        };
        let Some(place) = place else {
            let verbs = [Verb::Create, Verb::Lookup].into_iter();
            return verbs.map(|verb| of(verb, context.clone(), None)).collect();
        };
        let verbs: &[Verb] = match place.kind {
            ContextKind::Session => &[Verb::List],
            ContextKind::Channel => &[],
            ContextKind::Token => &[
                Verb::Grab,
                Verb::Renew,
                Verb::Give,
                Verb::Accept,
                Verb::Request,
                Verb::Break,
                Verb::Inhibit,
            ],
        };
        let everywhere = [
            Verb::Lookup,
            Verb::Info,
            Verb::Join,
            Verb::Members,
            Verb::Stats,
            Verb::Audit,
            Verb::Explain,
            Verb::Invite,
            Verb::Expel,
        ];
        let of_root = [Verb::WhatIf].into_iter().filter(|_| context.is_root());
        let verbs = everywhere.into_iter().chain(of_root).chain(verbs.iter().copied());
        let mut all: Vec<Asking> = verbs.map(|verb| of(verb, context.clone(), None)).collect();
        match place.kind {
            ContextKind::Session => {
                // A path that is as long as may be has no child.
                let child = context.child("new").ok();
                all.extend(child.map(|child| of(Verb::Create, child, None)));
            }
            ContextKind::Channel => {
                let names = self.message_names(context, &place.managed_at).into_iter();
                all.extend(names.map(|name| of(Verb::Send, context.clone(), Some(name))));
                let stops = [Verb::Stop, Verb::Unstop].into_iter();
                all.extend(stops.map(|verb| of(verb, context.clone(), None)));
            }
            ContextKind::Token => {}
        }
        all
    }

    /// The messages that rules distinguish on a channel, and one for all others.
    fn message_names(&self, channel: &Path, managed_at: &Path) -> Vec<String> {
        let mut specs = self.contexts.iter();
        let spec = specs.find(|spec| spec.path.as_deref() == Some(channel.as_str()));
        let guard = spec.and_then(|spec| spec.guard.as_ref());
        let mut names = guard.map(|guard| guard.names.clone()).unwrap_or_default();
        for manager in self.managers_at(managed_at) {
            if let Some(params) = manager.params {
                collect_messages(params, channel, &mut names);
            }
        }
        names.retain(|name| !matches!(name.as_str(), "stop" | "unstop" | "halt" | ANY_OTHER));
        names.sort_unstable();
        names.dedup();
        names.push(ANY_OTHER.to_owned());
        names
    }
}

/// Collects the members of every list `messages`, except of rules for other contexts.
fn collect_messages(map: &Map, channel: &Path, names: &mut Vec<String>) {
    let strings = |key: &str| {
        let list = map.get(key).and_then(Value::as_list).unwrap_or_default();
        list.iter().filter_map(Value::as_str)
    };
    let mut places = strings("where").filter_map(|place| Pattern::parse(place).ok());
    if map.contains_key("where") && !places.any(|place| place.matches(channel)) {
        return;
    }
    names.extend(strings("messages").map(str::to_owned));
    for inner in map.iter().filter_map(|(_, value)| value.as_list()).flatten() {
        if let Some(inner) = inner.as_map() {
            collect_messages(inner, channel, names);
        }
    }
}
