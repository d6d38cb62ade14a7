//! Warnings: valid settings that look like mistakes.

use std::collections::BTreeSet;

use mom_hub::ContextSpec;
use mom_login::{GUEST, JwtConfig, JwtUsers};
use mom_proto::{Map, Value, event};

use super::managers::ManagerNode;
use super::{Config, ConfigError};

impl Config {
    /// Warnings with their locations, ordered by kind.
    pub fn warnings(&self) -> Vec<ConfigError> {
        let mut found = Vec::new();
        for manager in self.all_managers() {
            if manager.kind == "roles" {
                self.review_rules(&manager, &mut found);
            }
            for (key, value) in manager.params.into_iter().flat_map(Map::iter) {
                if key != "of" {
                    self.review_people(value, &mut manager.at(&[key]), &mut found);
                }
            }
        }
        self.review_use(&mut found);
        for entry in 0..self.contexts.len() {
            self.review_context(entry, &mut found);
        }
        found
    }

    fn warn(&self, keys: &[String], text: String, found: &mut Vec<ConfigError>) {
        let keys: Vec<&str> = keys.iter().map(String::as_str).collect();
        found.push(self.remark(&keys, text));
    }

    /// Rules that never decide, and rules with the same name.
    fn review_rules(&self, manager: &ManagerNode<'_>, found: &mut Vec<ConfigError>) {
        let rules = manager.params.and_then(|params| params.get("rules")?.as_list());
        let rules: Vec<ReviewedRule<'_>> = rules
            .unwrap_or_default()
            .iter()
            .enumerate()
            .map(|(index, rule)| ReviewedRule::read(index, rule))
            .collect();
        for (index, rule) in rules.iter().enumerate() {
            let keys = manager.at(&["rules", &index.to_string()]);
            let before = &rules[..index];
            if let Some(same) = before.iter().find(|other| other.called == rule.called) {
                let line = self.line_of(&manager.at(&["rules", &same.index.to_string()]));
                let text = format!(
                    "another rule{line} is called {} too; an answer would not say which of them decided",
                    rule.called
                );
                self.warn(&keys, text, found);
            }
            if let Some(first) = before.iter().find(|earlier| earlier.covers(rule)) {
                let line = self.line_of(&manager.at(&["rules", &first.index.to_string()]));
                let text = format!(
                    "it never decides: {}{line} comes first and covers all that it does",
                    first.called
                );
                self.warn(&keys, text, found);
            }
        }
    }

    fn line_of(&self, keys: &[String]) -> String {
        let place = self.place(keys);
        place
            .map(|place| format!(" (line {})", place.line))
            .unwrap_or_default()
    }

    /// Users, groups and levels that nobody has. Not checked if users also come from elsewhere.
    fn review_people(&self, value: &Value, keys: &mut Vec<String>, found: &mut Vec<ConfigError>) {
        let from_claims = |jwt: &JwtConfig| jwt.users == JwtUsers::FromClaims;
        let Some(highest) = self.users.iter().map(|user| user.level).max() else {
            return;
        };
        if self.login.jwt.as_ref().is_some_and(from_claims) {
            return;
        }
        let guest = |name: &str| self.login.guests && name == GUEST;
        let key = keys.last().map(String::as_str).unwrap_or_default();
        match (key, value) {
            ("users", Value::List(names)) => {
                for name in names.iter().filter_map(Value::as_str) {
                    if !guest(name) && !self.users.iter().any(|user| user.name == name) {
                        self.warn(keys, format!("the users file has no user {name:?}"), found);
                    }
                }
            }
            ("groups", Value::List(groups)) => {
                for group in groups.iter().filter_map(Value::as_str) {
                    let known = self
                        .users
                        .iter()
                        .any(|user| user.groups.iter().any(|own| own == group));
                    if !known {
                        self.warn(keys, format!("no user is in the group {group:?}"), found);
                    }
                }
            }
            ("min-level", Value::Int(least)) if *least > highest.into() => {
                let text = format!("no user has the level {least}; the highest is {highest}");
                self.warn(keys, text, found);
            }
            (_, Value::List(list)) => {
                for (index, inner) in list.iter().enumerate() {
                    keys.push(index.to_string());
                    self.review_people(inner, keys, found);
                    keys.pop();
                }
            }
            (_, Value::Map(map)) => {
                for (key, inner) in map.iter() {
                    keys.push(key.to_owned());
                    self.review_people(inner, keys, found);
                    keys.pop();
                }
            }
            _ => {}
        }
    }

    /// Managers that nothing in the file uses.
    fn review_use(&self, found: &mut Vec<ConfigError>) {
        let mut used = BTreeSet::new();
        self.collect_names(&self.root, &mut used);
        let contexts = self
            .contexts
            .iter()
            .filter_map(|context| context.manager.as_ref());
        contexts.for_each(|spec| self.collect_names(spec, &mut used));
        for name in self.managers.keys().filter(|name| !used.contains(name.as_str())) {
            let text = "nothing in this file uses it; only a peer that creates a context could name it";
            self.warn(&["managers".to_owned(), name.clone()], text.to_owned(), found);
        }
    }

    fn collect_names<'a>(&'a self, spec: &'a Value, used: &mut BTreeSet<&'a str>) {
        if let Some(name) = spec.as_str()
            && let Some(inner) = self.managers.get(name)
            && used.insert(name)
        {
            self.collect_names(inner, used);
        }
        let inner = spec.get("of").and_then(Value::as_list).unwrap_or_default();
        inner.iter().for_each(|spec| self.collect_names(spec, used));
    }

    /// Safe states that can never be sent: no message has such a name, or the token does not guard the channel.
    pub(super) fn unsafe_states(&self) -> Vec<ConfigError> {
        let mut found = Vec::new();
        for (entry, token) in self.contexts.iter().enumerate() {
            let Some(safe) = &token.safe else { continue };
            let at = ["contexts", &entry.to_string()];
            found.extend(safe.check_name().err().map(|error| self.at(&at, &error)));
            let mut contexts = self.contexts.iter();
            let channel = contexts.find(|context| context.path.as_deref() == Some(&safe.channel));
            let guard = channel.map(|channel| channel.guard.as_ref().map(|guard| &guard.token));
            let path = token.path.as_deref().unwrap_or_default();
            let why = match guard {
                None => continue,
                // A guard by a token that is not there is told as that.
                Some(Some(guard)) if guard == path || self.entry_of(guard).is_none() => continue,
                Some(Some(guard)) => format!("{} is guarded by {guard}, not by {path}", safe.channel),
                Some(None) => format!("{} is not guarded by {path}", safe.channel),
            };
            let text = format!(
                "{why}, so this safe state could never be sent there; name a channel that this token guards"
            );
            found.push(self.remark(&[at[0], at[1], "safe", "channel"], text));
        }
        found
    }

    /// A channel for reports that is none of this file.
    pub(super) fn misplaced_log(&self) -> Option<ConfigError> {
        let log = self.web.log.as_deref()?;
        let entry = self.entry_of(log).map(|entry| self.contexts[entry].kind.as_str());
        let why = match entry {
            Some("channel") => return None,
            Some(kind) => format!("{log} is a {kind}, and reports are said in a channel"),
            None => format!(
                "this file has no {log}; add it to [[contexts]] as a channel, with keep for those who read later"
            ),
        };
        Some(self.remark(&["web", "log"], why))
    }

    /// Guards that guard nothing, and safe states that reach nobody.
    fn review_context(&self, entry: usize, found: &mut Vec<ConfigError>) {
        let context = &self.contexts[entry];
        let at = |inner: &[&str]| {
            let inner = inner.iter().map(|key| (*key).to_owned());
            ["contexts".to_owned(), entry.to_string()]
                .into_iter()
                .chain(inner)
                .collect::<Vec<_>>()
        };
        for name in context.guard.iter().flat_map(|guard| &guard.names) {
            if matches!(name.as_str(), event::STOP | event::UNSTOP | event::HALT) {
                let text = format!("{name} never needs a token, so guarding it changes nothing");
                self.warn(&at(&["guard", "names"]), text, found);
            }
            if matches!(name.as_str(), "*" | "state") {
                let text = format!(
                    "{name} covers what a device says of itself, so nobody hears that it stands: guard command"
                );
                self.warn(&at(&["guard", "names"]), text, found);
            }
        }
        if let Some(safe) = &context.safe {
            let named = |channel: &ContextSpec| channel.path.as_deref() == Some(safe.channel.as_str());
            if !self.contexts.iter().any(named) {
                let text = format!(
                    "this file has no {}; the safe state is delivered only if a peer makes that channel, guarded by this token",
                    safe.channel
                );
                self.warn(&at(&["safe", "channel"]), text, found);
            }
        }
    }
}

/// A rule of the manager `roles`, as it stands in the file.
struct ReviewedRule<'a> {
    index: usize,
    /// Its name in quotes, or its number.
    called: String,
    verbs: Vec<&'a str>,
    users: Vec<&'a str>,
    groups: Vec<&'a str>,
    min_level: Option<i64>,
    places: Vec<&'a str>,
    messages: Vec<&'a str>,
    /// Conditions that are not analysed.
    more: Vec<(&'a str, &'a Value)>,
}

impl<'a> ReviewedRule<'a> {
    fn read(index: usize, rule: &'a Value) -> ReviewedRule<'a> {
        let words = |key: &str| -> Vec<&'a str> {
            let list = rule.get(key).and_then(Value::as_list).unwrap_or_default();
            list.iter().filter_map(Value::as_str).collect()
        };
        let known = [
            "name",
            "allow",
            "deny",
            "users",
            "groups",
            "min-level",
            "where",
            "messages",
        ];
        let keys = rule.as_map().into_iter().flat_map(Map::iter);
        ReviewedRule {
            index,
            called: match rule.get("name").and_then(Value::as_str) {
                Some(name) => format!("{name:?}"),
                None => format!("rule {}", index + 1),
            },
            verbs: [words("allow"), words("deny")].concat(),
            users: words("users"),
            groups: words("groups"),
            min_level: rule.get("min-level").and_then(Value::as_int),
            places: words("where"),
            messages: words("messages"),
            more: keys.filter(|(key, _)| !known.contains(key)).collect(),
        }
    }

    /// Whether it covers every question that the other rule covers.
    fn covers(&self, later: &ReviewedRule<'_>) -> bool {
        let within = |one: &[&str], all: &[&str]| one.iter().all(|word| all.contains(word));
        let verbs = self.verbs.contains(&"*") || within(&later.verbs, &self.verbs);
        let anybody = self.users.is_empty() && self.groups.is_empty();
        let somebody = !later.users.is_empty() || !later.groups.is_empty();
        let people =
            anybody || (somebody && within(&later.users, &self.users) && within(&later.groups, &self.groups));
        // No bound is below every bound.
        let level = self
            .min_level
            .is_none_or(|least| later.min_level.is_some_and(|other| least <= other));
        let place = |later: &&str| self.places.iter().any(|place| pattern_covers(place, later));
        let places = self.places.is_empty() || (!later.places.is_empty() && later.places.iter().all(place));
        let messages = self.messages.is_empty()
            || (!later.messages.is_empty() && within(&later.messages, &self.messages));
        let more = self.more.iter().all(|condition| later.more.contains(condition));
        verbs && people && level && places && messages && more
    }
}

/// Whether every path that matches the second pattern matches the first.
fn pattern_covers(wide: &str, narrow: &str) -> bool {
    let read = |pattern: &str| -> (Vec<String>, bool) {
        let (fixed, below) = match pattern.strip_suffix("/**") {
            Some(fixed) => (fixed, true),
            None => (pattern, false),
        };
        let segments = fixed.split('/').filter(|segment| !segment.is_empty());
        (segments.map(str::to_owned).collect(), below)
    };
    let ((wide, wide_below), (narrow, narrow_below)) = (read(wide), read(narrow));
    let long_enough = match wide_below {
        true => narrow.len() >= wide.len(),
        false => narrow.len() == wide.len() && !narrow_below,
    };
    let fits = |(wide, narrow): (&String, &String)| wide == "*" || wide == narrow;
    long_enough && wide.iter().zip(&narrow).all(fits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_cover_patterns() {
        for (wide, narrow, expected) in [
            ("/a", "/a", true),
            ("/a", "/b", false),
            ("/a/*", "/a/b", true),
            ("/a/*", "/a/*", true),
            ("/a/b", "/a/*", false),
            ("/a/**", "/a", true),
            ("/a/**", "/a/b/c", true),
            ("/a/**", "/a/b/**", true),
            ("/a/b/**", "/a/**", false),
            ("/a/*", "/a/**", false),
            ("/**", "/", true),
            ("/*/t", "/a/t", true),
        ] {
            assert_eq!(pattern_covers(wide, narrow), expected, "{wide} over {narrow}");
        }
    }
}
