//! The check of fences on the device's side (design §6).

use std::sync::Arc;

use mom_proto::event as names;
use mom_proto::{Family, HUB, Map, Parcel, Path, Value};
use parking_lot::Mutex;

use crate::words::{map_of, number, text};

/// Refuses messages of earlier owners of a device's token.
///
/// The hub refuses such parcels too, but only the device can refuse those that were in a socket when the token
/// changed hands. A channel's gate learns owner and fence from the join's reply and from the token's events, before
/// any of them reaches [`Events`](crate::Events); while the link is down there is no owner. Fences never fall.
///
/// ```
/// use mom_client::{Family, FenceGate, Map, Parcel};
///
/// let gate = FenceGate::new();
/// let guard = Map::new().with("token", "/robot/token").with("names", vec!["command".into()]);
/// gate.joined(&Map::new().with("guard", guard.with("owner", "ally").with("fence", 7)));
///
/// let mut command = Parcel::new(Family::Message, "command").content("grip open");
/// command.fence = Some(6);
/// assert!(gate.check(&command).is_err(), "of the owner before");
/// command.fence = Some(7);
/// assert!(gate.check(&command).is_ok());
/// ```
#[derive(Clone, Debug, Default)]
pub struct FenceGate {
    state: Arc<Mutex<Option<GuardState>>>,
}

/// The last known state of the token that guards a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GuardState {
    /// The token.
    pub token: Path,
    /// The messages that need it; `*` stands for all.
    pub names: Vec<String>,
    /// The peer that owns it now.
    pub owner: Option<String>,
    /// The highest fence heard of.
    pub fence: u64,
}

/// A guarded message that was not sent by the token's present owner.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name} is stale: its fence is {given:?}, that of {owner:?} is {fence}")]
pub struct Stale {
    /// The message's name.
    pub name: String,
    /// The fence that it carries.
    pub given: Option<u64>,
    /// The highest fence heard of.
    pub fence: u64,
    /// The present owner; none = nobody may send it now.
    pub owner: Option<String>,
}

impl GuardState {
    /// Whether messages of this name need the token. Stop, unstop and the hub's safe state never do.
    pub fn covers(&self, name: &str) -> bool {
        !matches!(name, names::STOP | names::UNSTOP | names::HALT)
            && self.names.iter().any(|listed| listed == name || listed == "*")
    }
}

impl FenceGate {
    /// A gate that lets everything pass until it learns of a guard.
    pub fn new() -> FenceGate {
        FenceGate::default()
    }

    /// The last known guard; none = the channel is not guarded.
    pub fn guard(&self) -> Option<GuardState> {
        self.state.lock().clone()
    }

    /// Whether a message may be obeyed now: it needs no token, carries the fence of the present owner, or is the safe state
    /// that the hub itself sends.
    ///
    /// # Errors
    /// [`Stale`], for all others.
    pub fn check(&self, parcel: &Parcel) -> Result<(), Stale> {
        // No peer is called so: the hub writes the senders.
        if parcel.sender.as_deref() == Some(HUB) && parcel.fence.is_none() {
            return Ok(());
        }
        let state = self.state.lock();
        let Some(guard) = state.as_ref().filter(|guard| guard.covers(parcel.name())) else {
            return Ok(());
        };
        if guard.owner.is_some() && parcel.fence == Some(guard.fence) {
            return Ok(());
        }
        Err(Stale {
            name: parcel.name().to_owned(),
            given: parcel.fence,
            fence: guard.fence,
            owner: guard.owner.clone(),
        })
    }

    /// Learns from the content of a join's reply: `{guard {token, names, fence, owner?}?}`.
    pub fn joined(&self, reply: &Map) {
        let told = reply.get("guard").and_then(Value::as_map).and_then(read_guard);
        let mut state = self.state.lock();
        *state = match (told, state.take()) {
            // A hub with older fences must not make old commands valid again.
            (Some(told), Some(known)) if told.token == known.token && told.fence < known.fence => {
                Some(GuardState {
                    owner: None,
                    fence: known.fence,
                    ..told
                })
            }
            (told, _) => told,
        };
    }

    /// Learns from `grabbed` and `released` of the guarding token; ignores other events.
    pub fn observe(&self, parcel: &Parcel) {
        let mut state = self.state.lock();
        let Some(guard) = state.as_mut() else { return };
        if parcel.family != Family::Event || parcel.context.as_ref() != Some(&guard.token) {
            return;
        }
        let map = map_of(parcel);
        let Some(fence) = number(&map, "fence") else {
            return;
        };
        match parcel.name() {
            names::GRABBED if fence > guard.fence => {
                guard.fence = fence;
                guard.owner = text(&map, "owner").map(str::to_owned);
            }
            names::RELEASED if fence >= guard.fence => {
                guard.fence = fence;
                guard.owner = None;
            }
            _ => {}
        }
    }

    /// Nobody is known to own the token until the channel is joined again.
    pub(crate) fn forget_owner(&self) {
        if let Some(guard) = self.state.lock().as_mut() {
            guard.owner = None;
        }
    }

    /// The token that messages of this name need.
    pub(crate) fn token_for(&self, name: &str) -> Option<Path> {
        let state = self.state.lock();
        let guard = state.as_ref().filter(|guard| guard.covers(name))?;
        Some(guard.token.clone())
    }

    /// The token whose events this gate follows.
    pub(crate) fn token(&self) -> Option<Path> {
        self.state.lock().as_ref().map(|guard| guard.token.clone())
    }
}

fn read_guard(map: &Map) -> Option<GuardState> {
    let names = map.get("names").and_then(Value::as_list).unwrap_or_default();
    Some(GuardState {
        token: Path::parse(text(map, "token")?).ok()?,
        names: names
            .iter()
            .filter_map(Value::as_str)
            .map(str::to_owned)
            .collect(),
        owner: text(map, "owner").map(str::to_owned),
        fence: number(map, "fence").unwrap_or_default(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "/robot/token";

    fn guard(owner: Option<&str>, fence: i64) -> Map {
        let mut guard = Map::new()
            .with("token", TOKEN)
            .with("names", vec!["command".into()])
            .with("fence", fence);
        if let Some(owner) = owner {
            guard.set("owner", owner);
        }
        Map::new().with("guard", guard)
    }

    fn told(gate: &FenceGate, path: &str, name: &str, owner: &str, fence: i64) {
        let content = Map::new().with("owner", owner).with("fence", fence);
        gate.observe(
            &Parcel::new(Family::Event, name)
                .context(Path::parse(path).unwrap())
                .content(content),
        );
    }

    /// Each step is `verb owner fence`, then whose command with which fence passes.
    fn check(steps: &[(&str, &str, i64)], owner: Option<&str>, fence: u64) {
        let gate = FenceGate::new();
        let mut highest = 0;
        for (verb, owner, fence) in steps {
            match *verb {
                "join" => gate.joined(&guard(Some(owner), *fence)),
                "join-free" => gate.joined(&guard(None, *fence)),
                "link-down" => gate.forget_owner(),
                "other-grabbed" => told(&gate, "/other/token", "grabbed", owner, *fence),
                name => told(&gate, TOKEN, name, owner, *fence),
            }
            let now = gate.guard().unwrap().fence;
            assert!(now >= highest, "{steps:?}: a fence fell to {now}");
            highest = now;
        }
        let state = gate.guard().unwrap();
        assert_eq!((state.owner.as_deref(), state.fence), (owner, fence), "{steps:?}");
        for given in [None, Some(fence.wrapping_sub(1)), Some(fence), Some(fence + 1)] {
            let mut command = Parcel::new(Family::Message, "command");
            command.fence = given;
            let passes = owner.is_some() && given == Some(fence);
            assert_eq!(gate.check(&command).is_ok(), passes, "{steps:?} {given:?}");
            command.sender = Some(HUB.into());
            let safe = given.is_none();
            assert_eq!(
                gate.check(&command).is_ok(),
                passes || safe,
                "{steps:?} {given:?}"
            );
            command.sender = None;
            for name in ["state", "stop", "unstop", "halt"] {
                command.name = name.into();
                assert_eq!(gate.check(&command), Ok(()), "{name} needs no token");
            }
        }
    }

    #[test]
    fn only_the_present_owner_passes() {
        check(&[("join-free", "", 0)], None, 0);
        check(&[("join", "ally", 5)], Some("ally"), 5);
        check(&[("join-free", "", 5), ("grabbed", "bob", 6)], Some("bob"), 6);
        check(&[("join", "ally", 5), ("released", "ally", 5)], None, 5);
        check(
            &[
                ("join", "ally", 5),
                ("released", "ally", 5),
                ("grabbed", "bob", 6),
            ],
            Some("bob"),
            6,
        );
        check(
            &[
                ("join", "ally", 5),
                ("grabbed", "bob", 6),
                ("released", "ally", 5),
            ],
            Some("bob"),
            6,
        );
        check(
            &[("join", "ally", 5), ("other-grabbed", "bob", 9)],
            Some("ally"),
            5,
        );
    }

    #[test]
    fn fences_never_fall() {
        check(&[("join", "ally", 5), ("grabbed", "old", 4)], Some("ally"), 5);
        check(
            &[
                ("join", "ally", 5),
                ("released", "ally", 5),
                ("grabbed", "ally", 5),
            ],
            None,
            5,
        );
        check(&[("join", "ally", 5), ("join", "old", 3)], None, 5);
        check(
            &[("join", "ally", 5), ("join", "old", 3), ("grabbed", "bob", 6)],
            Some("bob"),
            6,
        );
        check(
            &[
                ("join-free", "", 2),
                ("released", "ally", 4),
                ("grabbed", "old", 3),
            ],
            None,
            4,
        );
    }

    #[test]
    fn without_a_link_nobody_is_owner() {
        check(&[("join", "ally", 5), ("link-down", "", 0)], None, 5);
        check(
            &[("join", "ally", 5), ("link-down", "", 0), ("join", "ally", 5)],
            Some("ally"),
            5,
        );
        check(
            &[("join", "ally", 5), ("link-down", "", 0), ("join", "bob", 7)],
            Some("bob"),
            7,
        );
    }

    #[test]
    fn a_star_covers_all_but_what_halts() {
        let gate = FenceGate::new();
        let mut any = Parcel::new(Family::Message, "anything");
        assert_eq!(gate.check(&any), Ok(()), "no guard");
        let names = Map::new()
            .with("token", TOKEN)
            .with("names", vec!["*".into()])
            .with("fence", 1);
        gate.joined(&Map::new().with("guard", names));
        let stale = gate.check(&any).unwrap_err();
        assert_eq!(
            (stale.name.as_str(), stale.given, stale.fence, stale.owner),
            ("anything", None, 1, None)
        );
        any.name = "stop".into();
        assert_eq!(gate.check(&any), Ok(()));
        gate.joined(&Map::new());
        any.name = "anything".into();
        assert_eq!(gate.check(&any), Ok(()), "the channel is not guarded any more");
    }
}
