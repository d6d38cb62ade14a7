//! Threat 19 on the hub alone: many peers grab one token at once, again and again.

use mom_hub::{Effect, Hub, Input, PeerId, Settings, User};
use mom_managers::Registry;
use mom_proto::{Family, Map, Parcel, Path, Value, from_value};

const PEERS: u64 = 1000;
/// Every peer grabs in each of these.
const FULL_ROUNDS: u64 = 100;
/// A handful of peers grabs in each of these: what grows with the rounds would show here.
const ROUNDS: u64 = 10_000;
const EPOCH: u64 = 1_800_000_000;

fn hub() -> Hub {
    let spec = |path: &str, kind: &str| Map::new().with("path", path).with("kind", kind);
    let manager = Map::new().with("kind", "level-or-lease");
    let token = spec("/robot/token", "token").with("manager", manager);
    let contexts = [spec("/robot", "session").with("presence", "none"), token];
    let contexts = contexts.map(|spec| from_value(Value::Map(spec)).expect("a context"));
    let settings = Settings {
        epoch: EPOCH,
        ..Settings::default()
    };
    let mut hub = Hub::new(settings, Registry::builtin(), &"open".into(), &contexts).expect("a hub");
    for peer in 1..=PEERS {
        let user = User {
            name: format!("peer{peer}"),
            level: 1,
            groups: Vec::new(),
            details: Map::new(),
        };
        let login = Input::Login {
            peer: PeerId(peer),
            user,
            nickname: None,
            id: Some(0),
        };
        hub.handle(0, login, &mut Vec::new());
        ask(&mut hub, peer, Family::Context, "join", "/robot");
    }
    hub
}

/// The one answer to a request.
fn ask(hub: &mut Hub, peer: u64, family: Family, name: &str, path: &str) -> Parcel {
    let path = Path::parse(path).expect("a path");
    let parcel = Box::new(Parcel::new(family, name).context(path).id(7));
    let mut effects = Vec::new();
    let peer = PeerId(peer);
    hub.handle(
        1,
        Input::Request {
            peer,
            parcel,
            clock: None,
        },
        &mut effects,
    );
    let mut answers = effects.into_iter().filter_map(|effect| match effect {
        Effect::Reply { to, parcel } if to == peer => Some(parcel),
        _ => None,
    });
    let answer = answers.next().expect("every request is answered");
    assert!(answers.next().is_none(), "once");
    assert_eq!(answer.reference, Some(7));
    (*answer).clone()
}

/// Lets these peers grab one after the other; gives the fence of the one that got it, who gives it back.
fn round(hub: &mut Hub, peers: impl Iterator<Item = u64>) -> u64 {
    let mut winner = None;
    for peer in peers {
        let answer = ask(hub, peer, Family::Token, "grab", "/robot/token");
        if answer.is(Family::Reply, "ok") {
            let fence = answer.value().get("fence").and_then(Value::as_int);
            let before = winner.replace((peer, fence.expect("a fence")));
            assert_eq!(before, None, "one grant each");
        } else {
            assert!(answer.is(Family::Error, "held"), "{answer:?}");
        }
    }
    let (peer, fence) = winner.expect("a peer gets a free token");
    let released = ask(hub, peer, Family::Token, "release", "/robot/token");
    assert!(released.is(Family::Reply, "ok"), "{released:?}");
    u64::try_from(fence).expect("a fence")
}

#[test]
fn one_grant_each_and_fences_rise() {
    let mut hub = hub();
    let mut highest = EPOCH << 20;
    for number in 0..ROUNDS {
        let first = number % PEERS;
        let most = if number < FULL_ROUNDS { PEERS } else { 5 };
        // Another one is the first each time.
        let peers = (0..most).map(|place| 1 + (first + place) % PEERS);
        let fence = round(&mut hub, peers);
        assert!(fence > highest, "{fence} after {highest}");
        highest = fence;
    }
    hub.check();
}
