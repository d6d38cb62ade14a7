//! Makes managers from their configuration.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use mom_proto::nearest::nearest;
use mom_proto::{Code, Map, Value, WireError, from_value};
use serde::de::DeserializeOwned;

use crate::Manager;

/// Makes a manager of one kind.
pub type Factory = fn(&Setup<'_>) -> Result<Box<dyn Manager>, WireError>;

/// The deepest nesting of managers.
const DEPTH: usize = 4;

/// The kinds of manager, and the managers that the configuration names.
#[derive(Clone, Debug)]
pub struct Registry {
    kinds: BTreeMap<&'static str, Factory>,
    named: BTreeMap<String, Value>,
}

/// The input of a factory.
#[derive(Debug)]
pub struct Setup<'a> {
    /// The manager's name for rules in errors and logs.
    pub label: &'a str,
    params: &'a Map,
    registry: &'a Registry,
    depth: usize,
    /// The labels of the managers inside this one that have no name of their own.
    inner_labels: RefCell<BTreeSet<String>>,
}

impl Registry {
    /// These kinds, without named managers.
    pub(crate) fn of(kinds: impl Into<BTreeMap<&'static str, Factory>>) -> Registry {
        Registry {
            kinds: kinds.into(),
            named: BTreeMap::new(),
        }
    }

    /// Adds a kind of manager, or replaces it.
    pub fn add_kind(&mut self, kind: &'static str, factory: Factory) {
        self.kinds.insert(kind, factory);
    }

    /// Names a manager. It is checked when it is built, because it may refer to later ones.
    pub fn define(&mut self, name: &str, spec: Value) {
        self.named.insert(name.to_owned(), spec);
    }

    /// All kinds, in alphabetical order.
    pub fn kinds(&self) -> impl Iterator<Item = &str> {
        self.kinds.keys().copied()
    }

    /// The defined names.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.named.keys().map(String::as_str)
    }

    /// Makes a manager: a name of the configuration or of a kind without parameters, or a map with `kind`
    /// and the parameters.
    ///
    /// # Errors
    /// `unknown-manager` with the nearest name, or `bad-content` with the key at fault as slot.
    pub fn build(&self, spec: &Value) -> Result<Box<dyn Manager>, WireError> {
        self.build_inner(spec, None, DEPTH)
    }

    fn build_inner(
        &self,
        spec: &Value,
        label: Option<&str>,
        depth: usize,
    ) -> Result<Box<dyn Manager>, WireError> {
        let Some(depth) = depth.checked_sub(1) else {
            return Err(WireError::new(
                Code::BAD_CONTENT,
                "managers are nested too deep, or contain each other",
            ));
        };
        match spec {
            Value::String(name) => match self.named.get(name) {
                Some(spec) => self.build_inner(spec, Some(name), depth),
                None => self.make(name, label.unwrap_or(name), &Map::new(), depth),
            },
            Value::Map(map) => {
                let kind = map.get("kind").and_then(Value::as_str).ok_or_else(|| {
                    WireError::new(Code::BAD_CONTENT, "a manager needs its kind, such as roles").slot("kind")
                })?;
                let mut params = map.clone();
                params.remove("kind");
                let label = label.map_or_else(|| kind.to_owned(), str::to_owned);
                self.make(kind, &label, &params, depth)
            }
            _ => Err(WireError::new(
                Code::BAD_CONTENT,
                "a manager is a name, or a map with its kind",
            )),
        }
    }

    fn make(
        &self,
        kind: &str,
        label: &str,
        params: &Map,
        depth: usize,
    ) -> Result<Box<dyn Manager>, WireError> {
        let Some(factory) = self.kinds.get(kind) else {
            let known = self.kinds().chain(self.names());
            let error = WireError::new(Code::UNKNOWN_MANAGER, format!("there is no manager {kind:?}"));
            return Err(error.slot("kind").nearest_opt(nearest(kind, known)));
        };
        factory(&Setup {
            label,
            params,
            registry: self,
            depth,
            inner_labels: RefCell::default(),
        })
    }
}

impl Setup<'_> {
    /// The parameters, typed.
    ///
    /// # Errors
    /// `bad-content` with the key at fault as slot.
    pub fn params<T: DeserializeOwned>(&self) -> Result<T, WireError> {
        from_value(Value::Map(self.params.clone())).map_err(|error| {
            let place = error
                .get("slot")
                .and_then(Value::as_str)
                .unwrap_or_default()
                .to_owned();
            let key = place
                .strip_prefix("content")
                .unwrap_or(&place)
                .trim_start_matches('/')
                .to_owned();
            // The text of a fault inside of a parameter begins with its place, which the slot names.
            let told = error
                .text
                .strip_prefix(&format!("{place}: "))
                .unwrap_or(&error.text);
            let text = format!("in the manager {}: {told}", self.label);
            let nearest = error.get("nearest").and_then(Value::as_str);
            WireError::new(error.code.clone(), text)
                .slot(&key)
                .nearest_opt(nearest)
        })
    }

    /// Makes a manager inside this one, at the parameter `key`.
    ///
    /// # Errors
    /// As [`Registry::build`], the slot prefixed with `key`.
    pub fn inner(&self, key: &str, spec: &Value) -> Result<Box<dyn Manager>, WireError> {
        let kind = spec.get("kind").and_then(Value::as_str);
        let label = kind.map(|kind| self.inner_label(kind));
        self.registry
            .build_inner(spec, label.as_deref(), self.depth)
            .map_err(|error| {
                let inner = error
                    .get("slot")
                    .and_then(Value::as_str)
                    .map(|slot| format!("/{slot}"))
                    .unwrap_or_default();
                error.slot(&format!("{key}{inner}"))
            })
    }

    /// A label that no other manager has: it identifies answers to deferred questions, and one chair's answer must
    /// not count for another's.
    fn inner_label(&self, kind: &str) -> String {
        let plain = format!("{}/{kind}", self.label);
        let mut used = self.inner_labels.borrow_mut();
        let mut label = plain.clone();
        let mut number = 2;
        while used.contains(&label) || self.registry.named.contains_key(&label) {
            label = format!("{plain}~{number}");
            number += 1;
        }
        used.insert(label.clone());
        label
    }

    /// An error about the parameter `key`.
    pub fn error(&self, key: &str, text: &str) -> WireError {
        WireError::new(
            Code::BAD_CONTENT,
            format!("in the manager {}: {text}", self.label),
        )
        .slot(key)
    }
}
