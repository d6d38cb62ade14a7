//! The managers of a configuration, and the locations of their rules.

use std::collections::BTreeSet;

use mom_proto::{Map, Path, Value};

use super::{Config, Location};

/// The deepest nesting of managers that can be built.
const DEPTH: usize = 4;

/// One manager of the configuration.
#[derive(Clone, Debug)]
pub(super) struct ManagerNode<'a> {
    /// Its name in verdicts.
    pub(super) label: String,
    pub(super) kind: &'a str,
    /// None for a kind without parameters.
    pub(super) params: Option<&'a Map>,
    /// The keys that lead to it.
    pub(super) keys: Vec<String>,
}

impl ManagerNode<'_> {
    /// The keys of one of its parameters.
    pub(super) fn at(&self, inner: &[&str]) -> Vec<String> {
        let inner = inner.iter().map(|key| (*key).to_owned());
        self.keys.iter().cloned().chain(inner).collect()
    }

    /// The keys of the entry that verdicts call by this name: its own, or such as `rule 2` for the second of
    /// `rules`.
    fn entry(&self, name: &str) -> Option<Vec<String>> {
        let lists = self.params?.iter();
        let lists = lists.filter_map(|(key, value)| Some((key, value.as_list()?)));
        lists.into_iter().find_map(|(key, list)| {
            let named = |entry: &Value| entry.get("name").and_then(Value::as_str) == Some(name);
            let numbered = || {
                let number = name.strip_prefix(key.trim_end_matches('s'))?.strip_prefix(' ')?;
                let index = number.parse::<usize>().ok()?.checked_sub(1)?;
                list.get(index).and_then(Value::as_map).map(|_| index)
            };
            let index = list.iter().position(named).or_else(numbered)?;
            Some(self.at(&[key, &index.to_string()]))
        })
    }
}

impl Config {
    /// All managers of the configuration, each once: the named ones, and those that the root, contexts and other
    /// managers define on the spot.
    pub(super) fn all_managers(&self) -> Vec<ManagerNode<'_>> {
        let mut all = Vec::new();
        for name in self.managers.keys() {
            self.walk_named(name, DEPTH, &mut all);
        }
        self.walk(&self.root, None, vec!["root".to_owned()], DEPTH, &mut all);
        for entry in 0..self.contexts.len() {
            all.extend(self.managers_of_context(entry));
        }
        let mut known = BTreeSet::new();
        all.retain(|node| known.insert(node.keys.clone()));
        all
    }

    /// The manager that a context names, and all inside it, outermost first.
    pub(super) fn managers_at(&self, context: &Path) -> Vec<ManagerNode<'_>> {
        if *context == Path::root() {
            let mut found = Vec::new();
            self.walk(&self.root, None, vec!["root".to_owned()], DEPTH, &mut found);
            return found;
        }
        let entry = self.entry_of(context.as_str());
        entry
            .map(|entry| self.managers_of_context(entry))
            .unwrap_or_default()
    }

    pub(super) fn entry_of(&self, context: &str) -> Option<usize> {
        self.contexts
            .iter()
            .position(|spec| spec.path.as_deref() == Some(context))
    }

    fn managers_of_context(&self, entry: usize) -> Vec<ManagerNode<'_>> {
        let mut found = Vec::new();
        if let Some(spec) = &self.contexts[entry].manager {
            let keys = ["contexts", &entry.to_string(), "manager"].map(str::to_owned);
            self.walk(spec, None, keys.to_vec(), DEPTH, &mut found);
        }
        found
    }

    fn walk_named<'a>(&'a self, name: &'a str, depth: usize, out: &mut Vec<ManagerNode<'a>>) {
        if let Some(spec) = self.managers.get(name) {
            let keys = vec!["managers".to_owned(), name.to_owned()];
            self.walk(spec, Some(name.to_owned()), keys, depth, out);
        }
    }

    /// Names and labels are resolved as a registry does it when it builds them.
    fn walk<'a>(
        &'a self,
        spec: &'a Value,
        label: Option<String>,
        keys: Vec<String>,
        depth: usize,
        out: &mut Vec<ManagerNode<'a>>,
    ) {
        let Some(depth) = depth.checked_sub(1) else { return };
        match spec {
            Value::String(name) if self.managers.contains_key(name) => self.walk_named(name, depth, out),
            Value::String(kind) => out.push(ManagerNode {
                label: label.unwrap_or_else(|| kind.clone()),
                kind,
                params: None,
                keys,
            }),
            _ => {
                let (Some(kind), params) = (kind_of(spec), spec.as_map()) else {
                    return;
                };
                let label = label.unwrap_or_else(|| kind.to_owned());
                let node = ManagerNode {
                    label,
                    kind,
                    params,
                    keys,
                };
                out.push(node.clone());
                let inner = spec.get("of").and_then(Value::as_list).unwrap_or_default();
                let mut used = BTreeSet::new();
                for (index, spec) in inner.iter().enumerate() {
                    let label = kind_of(spec).map(|kind| self.inner_label(&node.label, kind, &mut used));
                    self.walk(spec, label, node.at(&["of", &index.to_string()]), depth, out);
                }
            }
        }
    }

    fn inner_label(&self, outer: &str, kind: &str, used: &mut BTreeSet<String>) -> String {
        let plain = format!("{outer}/{kind}");
        let numbered = (2..).map(|number| format!("{plain}~{number}"));
        let mut labels = std::iter::once(plain.clone()).chain(numbered);
        let free = labels.find(|label| !used.contains(label) && !self.managers.contains_key(label));
        let label = free.unwrap_or(plain);
        used.insert(label.clone());
        label
    }

    /// The location of a rule, by its name in a verdict or an audit record; if the name does not identify one part of
    /// a manager, the manager's location. `managed_at` is the context whose manager decided. None for the hub's own
    /// rules.
    pub fn locate_rule(&self, rule: &str, managed_at: &Path) -> Option<Location> {
        if let Some(channel) = rule.strip_prefix("guard of ") {
            let entry = self.entry_of(channel)?;
            return self.place(&["contexts", &entry.to_string(), "guard"].map(str::to_owned));
        }
        let nodes = self.managers_at(managed_at);
        let exactly = nodes.iter().find(|node| node.label == rule);
        let keys = exactly.map(|node| node.keys.clone());
        let inside = |node: &ManagerNode<'_>| {
            let name = rule.strip_prefix(&*node.label)?.strip_prefix('/')?;
            Some((node.entry(name), node.label.len(), node.keys.clone()))
        };
        let keys = keys.or_else(|| {
            let found: Vec<_> = nodes.iter().filter_map(inside).collect();
            let entry = found.iter().find_map(|(entry, ..)| entry.clone());
            let longest = || found.into_iter().max_by_key(|(_, length, _)| *length);
            entry.or_else(|| longest().map(|(_, _, keys)| keys))
        })?;
        self.place(&keys)
    }

    /// The location of a rule that decided about a context: in the manager of the context, or of the nearest above that
    /// has one.
    pub fn locate_rule_from(&self, rule: &str, context: &Path) -> Option<Location> {
        let mut at = Some(context.clone());
        while let Some(context) = at {
            if let Some(place) = self.locate_rule(rule, &context) {
                return Some(place);
            }
            at = context.parent();
        }
        None
    }

    /// The location of a context's manager.
    pub(super) fn locate_manager_of(&self, managed_at: &Path) -> Option<Location> {
        self.place(&self.managers_at(managed_at).first()?.keys)
    }

    pub(super) fn place(&self, keys: &[String]) -> Option<Location> {
        let keys: Vec<&str> = keys.iter().map(String::as_str).collect();
        self.source.as_ref()?.place(&keys)
    }
}

fn kind_of(spec: &Value) -> Option<&str> {
    spec.get("kind").and_then(Value::as_str)
}
