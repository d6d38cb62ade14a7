//! A hub with a bit of everything.

use mom_hub::{ContextSpec, Hub, Input, PeerId, Settings, User};
use mom_managers::Registry;
use mom_proto::{Limit, Limits, Map, Value, from_value};

/// An operator that only looks.
pub(crate) const ADMIN: PeerId = PeerId(1_000_000);

/// The epoch of its fences.
pub(crate) const EPOCH: u64 = 1;

/// The paths that steps are about: of the configuration, to be made, and never there.
pub(crate) const PATHS: [&str; 18] = [
    "/",
    "/lab",
    "/lab/token",
    "/lab/arm",
    "/lab/talk",
    "/yard",
    "/yard/key",
    "/yard/eager",
    "/yard/work",
    "/yard/press",
    "/a",
    "/a/token",
    "/a/arm",
    "/a/b",
    "/a/b/token",
    "/a/b/arm",
    "/hall",
    "/none",
];

/// Users by number: name, level, group.
pub(crate) const USERS: [(&str, i32, &str); 5] = [
    ("alice", 1, "people"),
    ("bob", 1, "people"),
    ("carol", 5, "operator"),
    ("dave", 2, "people"),
    ("arm", 0, "device"),
];

/// A user by number.
pub(crate) fn user(number: usize) -> User {
    let (name, level, group) = USERS[number % USERS.len()];
    User {
        name: name.to_owned(),
        level,
        groups: vec![group.to_owned()],
        details: Map::new(),
    }
}

/// The hub at its start, with the operator logged in.
pub(crate) fn hub() -> Hub {
    let mut registry = Registry::builtin();
    registry.define("lab", roles());
    registry.define("lab-token", chain());
    let settings = Settings {
        epoch: EPOCH,
        limits: Limits {
            contexts: Limit::At(15),
            joined: Limit::At(9),
            ..Limits::default()
        },
        counts_above: 2,
        ..Settings::default()
    };
    let contexts: Vec<ContextSpec> = contexts()
        .into_iter()
        .map(|(path, map)| from_value(map.with("path", path).into()).unwrap())
        .collect();
    let mut hub = Hub::new(settings, registry, &"open".into(), &contexts).unwrap();
    let login = Input::Login {
        peer: ADMIN,
        user: User {
            name: "admin".to_owned(),
            ..user(2)
        },
        nickname: None,
        id: None,
    };
    hub.handle(0, login, &mut Vec::new());
    hub
}

fn contexts() -> Vec<(&'static str, Map)> {
    let of = |kind: &str| Map::new().with("kind", kind);
    let guard = |token: &str, name: &str| Map::new().with("token", token).with("names", vec![name.into()]);
    let lease = |kind: &str, lease: i64, expiry: &str| of(kind).with("lease", lease).with("expiry", expiry);
    let safe = Map::new().with("channel", "/yard/work").with("name", "lift");
    vec![
        ("/lab", of("session").with("manager", "lab")),
        ("/lab/token", of("token").with("manager", "lab-token")),
        (
            "/lab/arm",
            of("channel").with("guard", guard("/lab/token", "command")),
        ),
        ("/lab/talk", of("channel").with("presence", "counts")),
        ("/yard", of("session").with("presence", "none")),
        (
            "/yard/key",
            of("token")
                .with("manager", lease("first-come", 5000, "lazy"))
                .with("safe", safe),
        ),
        (
            "/yard/eager",
            of("token").with("manager", lease("level-or-lease", 2000, "eager")),
        ),
        ("/yard/work", of("channel").with("guard", guard("/yard/key", "*"))),
        (
            "/yard/press",
            of("channel")
                .with("guard", guard("/yard/eager", "say"))
                .with("delivery", "latest"),
        ),
    ]
}

fn roles() -> Value {
    let rule = |name: &str, verbs: &[&str]| {
        let verbs: Vec<Value> = verbs.iter().map(|verb| Value::from(*verb)).collect();
        Map::new().with("name", name).with("allow", verbs)
    };
    let rules: Vec<Value> = vec![
        rule("operators", &["*"])
            .with("groups", vec!["operator".into()])
            .into(),
        Map::new()
            .with("name", "no stop by dave")
            .with("deny", vec!["stop".into()])
            .with("users", vec!["dave".into()])
            .into(),
        rule(
            "people",
            &[
                "join", "lookup", "list", "info", "members", "send", "grab", "renew", "stop",
            ],
        )
        .with("min-level", 1)
        .into(),
        rule("devices", &["join", "members", "unstop"]).into(),
    ];
    Map::new().with("kind", "roles").with("rules", rules).into()
}

fn chain() -> Value {
    let lease = Map::new().with("kind", "level-or-lease").with("lease", 180_000);
    Map::new()
        .with("kind", "chain")
        .with("of", vec!["lab".into(), lease.into()])
        .into()
}
