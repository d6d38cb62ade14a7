//! What the hub says when it is asked.

use std::collections::{BTreeMap, BTreeSet};

use mom_hub::{Effect, Hub, Input};
use mom_proto::{Code, Family, Parcel, Path, Value, WireError};

use crate::lab::{ADMIN, PATHS};
use crate::log::at;

/// A token.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Look {
    pub(crate) owner: Option<String>,
    /// How long it may still come back, if it is lost, ms.
    pub(crate) owner_lost: Option<i64>,
    pub(crate) queue: Vec<String>,
    pub(crate) holders: Vec<String>,
    pub(crate) offered: Option<String>,
    pub(crate) requests: Vec<String>,
    pub(crate) reserved: bool,
}

/// Asks about something; looking changes nothing.
pub(crate) fn ask(
    hub: &mut Hub,
    now: u64,
    family: Family,
    verb: &str,
    path: &Path,
) -> Result<Value, WireError> {
    let mut effects = Vec::new();
    let request = Input::Request {
        peer: ADMIN,
        parcel: Box::new(Parcel::new(family, verb).context(path.clone())),
        clock: None,
    };
    hub.handle(now, request, &mut effects);
    effects.retain(|effect| !matches!(effect, Effect::Audit(_)));
    match &effects[..] {
        [Effect::Reply { parcel, .. }] if parcel.family == Family::Reply => Ok(parcel.value()),
        [Effect::Reply { parcel, .. }] => Err(WireError::from_parcel(parcel)),
        other => panic!("looking changes nothing: {other:?}"),
    }
}

/// All tokens.
#[derive(Debug, Default)]
pub(crate) struct Looks {
    pub(crate) seen: BTreeMap<Path, Look>,
    /// What the operator may not look at.
    hidden: BTreeSet<Path>,
}

impl Looks {
    pub(crate) fn at(hub: &mut Hub, now: u64) -> Looks {
        Looks::on(hub, now, PATHS.map(at))
    }

    /// Looks again, where nothing was made or deleted since.
    pub(crate) fn again(&self, hub: &mut Hub, now: u64) -> Looks {
        Looks {
            hidden: self.hidden.clone(),
            ..Looks::on(hub, now, self.seen.keys().cloned())
        }
    }

    fn on(hub: &mut Hub, now: u64, paths: impl IntoIterator<Item = Path>) -> Looks {
        let mut looks = Looks::default();
        for path in paths {
            match ask(hub, now, Family::Token, "info", &path) {
                Ok(info) if info.get("kind").and_then(Value::as_str) == Some("token") => {
                    looks.seen.insert(path, look(&info));
                }
                Err(error) if error.code == Code::DENIED => drop(looks.hidden.insert(path)),
                _ => {}
            }
        }
        looks
    }

    /// Whether there is no such token.
    pub(crate) fn lack(&self, path: &Path) -> bool {
        !self.seen.contains_key(path) && !self.hidden.contains(path)
    }
}

fn look(info: &Value) -> Look {
    let word = |value: &Value| value.as_str().map(str::to_owned);
    let list = |key: &str| info.get(key).and_then(Value::as_list).unwrap_or_default();
    let peers = |key: &str| {
        let peers = list(key).iter();
        peers.filter_map(|peer| word(peer.get("peer")?)).collect()
    };
    Look {
        owner: info.get("owner").and_then(word),
        owner_lost: info.get("owner-lost").and_then(Value::as_int),
        queue: peers("queue"),
        holders: list("holders").iter().filter_map(word).collect(),
        offered: info.get("offer").and_then(|offer| word(offer.get("to")?)),
        requests: peers("requests"),
        reserved: info.get("reserved").is_some(),
    }
}
