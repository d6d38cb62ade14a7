//! Nobody drives a device after losing its token, and the device hears so, in the cases where that is easily missed.

use std::sync::Arc;

use mom_hub::{Admission, Effect, Hub, Ingress, Input, PeerId, Route, Settings, User, admit};
use mom_managers::Registry;
use mom_proto::{Code, Content, Family, Map, Micros, Parcel, Path, Time};

const OWNER: PeerId = PeerId(1);
const DEVICE: PeerId = PeerId(2);
/// ms
const LEASE: i64 = 1000;

fn ask(
    hub: &mut Hub,
    peer: PeerId,
    family: Family,
    name: &str,
    path: &str,
    content: Option<Map>,
) -> Vec<Effect> {
    let mut parcel = Parcel::new(family, name)
        .context(Path::parse(path).expect("a path"))
        .id(7);
    parcel.content = content.map(Content::from);
    let mut effects = Vec::new();
    let parcel = Box::new(parcel);
    hub.handle(
        0,
        Input::Request {
            peer,
            parcel,
            clock: None,
        },
        &mut effects,
    );
    hub.check();
    for effect in &effects {
        if let Effect::Reply { parcel, .. } = effect {
            assert_eq!(
                parcel.family,
                Family::Reply,
                "{name} {path}: {:?}",
                parcel.content
            );
        }
    }
    effects
}

/// A session `/lab` with the token `/lab/key` that guards this channel; one peer owns, another one is the device.
fn lab(channel: &str) -> Hub {
    let mut hub = Hub::new(Settings::default(), Registry::builtin(), &"open".into(), &[]).expect("a hub");
    for (peer, name) in [(OWNER, "owner"), (DEVICE, "device")] {
        let user = User {
            name: name.to_owned(),
            level: 1,
            groups: Vec::new(),
            details: Map::new(),
        };
        let (nickname, id) = (None, Some(1));
        hub.handle(
            0,
            Input::Login {
                peer,
                user,
                nickname,
                id,
            },
            &mut Vec::new(),
        );
    }
    let token = Map::new()
        .with("kind", "token")
        .with("lease", LEASE)
        .with("expiry", "eager");
    let guard = Map::new()
        .with("token", "/lab/key")
        .with("names", vec!["command".into()]);
    let session = || Map::new().with("kind", "session");
    let mut own = |family, name, path: &str, content| drop(ask(&mut hub, OWNER, family, name, path, content));
    own(Family::Context, "create", "/lab", Some(session()));
    own(Family::Context, "join", "/lab", None);
    own(Family::Context, "create", "/lab/key", Some(token));
    own(Family::Context, "create", "/lab/inner", Some(session()));
    own(Family::Context, "join", "/lab/inner", None);
    let guarded = Map::new().with("kind", "channel").with("guard", guard);
    own(Family::Context, "create", channel, Some(guarded));
    own(Family::Context, "join", channel, None);
    own(Family::Token, "grab", "/lab/key", None);
    for path in ["/lab", "/lab/inner", channel] {
        ask(&mut hub, DEVICE, Family::Context, "join", path, None);
    }
    hub
}

/// Whatever the names and depths, the device is halted before the channel to it goes.
#[test]
fn a_device_is_halted_before_its_channel_is_deleted() {
    for channel in ["/lab/arm", "/lab/wheels", "/lab/inner/arm"] {
        let mut hub = lab(channel);
        let effects = ask(&mut hub, OWNER, Family::Context, "delete", "/lab", None);
        let heard: Vec<String> = effects
            .iter()
            .filter_map(|effect| match effect {
                Effect::Deliver { to, parcel } if to.contains(&DEVICE) => Some(parcel.name().to_owned()),
                _ => None,
            })
            .collect();
        assert_eq!(
            heard[..3],
            ["halt", "released", "deleted"],
            "{channel}: {heard:?}"
        );
    }
}

fn route_of(effects: &[Effect]) -> Arc<Route> {
    let mut routes = effects.iter().filter_map(|effect| match effect {
        Effect::Route(route) => Some(Arc::clone(route)),
        _ => None,
    });
    routes.next_back().expect("a route")
}

/// A deadline acts before whatever comes at it, also where the hub has not been called yet.
#[test]
fn an_eager_lease_ends_for_who_holds_a_route() {
    let mut hub = lab("/lab/arm");
    let route = route_of(&ask(
        &mut hub,
        OWNER,
        Family::Message,
        "command",
        "/lab/arm",
        None,
    ));
    let end = Micros::try_from(LEASE * 1000).expect("positive");
    let command = || Parcel::new(Family::Message, "command").context(route.path.clone());
    let at = |now| {
        admit(
            &route,
            OWNER,
            &mut command(),
            &Ingress {
                now,
                wall: Time::default(),
                clock: None,
                waited: 0,
            },
        )
    };
    assert!(matches!(at(end - 1), Ok(Admission::Pass(..))));
    assert_eq!(at(end), Ok(Admission::Consult));
    let mut effects = Vec::new();
    let parcel = Box::new(command());
    hub.handle(
        end,
        Input::Request {
            peer: OWNER,
            parcel,
            clock: None,
        },
        &mut effects,
    );
    let refused = effects.iter().any(|effect| match effect {
        Effect::Reply { parcel, .. } => parcel.name() == Code::NOT_OWNER.word(),
        _ => false,
    });
    assert!(refused, "{effects:?}");
}
