//! A hub with a bit of everything, and what may become of its configuration.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use mom_hub::{Configuration, ContextSpec, Hub, Input, PeerId, Record, Settings, User};
use mom_managers::Registry;
use mom_proto::{Limit, Limits, Map, Path, Value, from_value};

use crate::kinds::{HOLD, NOTICE, add_kinds};

/// An operator that only looks.
pub(crate) const ADMIN: PeerId = PeerId(1_000_000);

/// The epoch of the first fences.
pub(crate) const EPOCH: u64 = 1;

/// The configurations that there are; the first is that of the start.
pub(crate) const VARIANTS: usize = 6;

/// The paths that steps are about: of the configuration, to be made, and never there.
pub(crate) const PATHS: [&str; 31] = [
    "/",
    "/lab",
    "/lab/token",
    "/lab/arm",
    "/lab/talk",
    "/yard",
    "/yard/key",
    "/yard/eager",
    "/yard/dead",
    "/yard/turns",
    "/yard/moody",
    "/yard/chaired",
    "/yard/work",
    "/yard/press",
    "/yard/belt",
    "/yard/gate",
    "/yard/bay",
    "/yard/dock",
    "/yard/mill",
    "/yard/tap",
    "/yard/extra",
    "/a",
    "/a/token",
    "/a/arm",
    "/a/own",
    "/a/b",
    "/a/b/token",
    "/a/b/arm",
    "/hall",
    "/lab/talk/deep",
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

/// A user by number, as a configuration has it; none = not any more.
pub(crate) fn user(number: usize, variant: usize) -> Option<User> {
    let (name, level, group) = USERS[number % USERS.len()];
    let (level, group) = match (variant, name) {
        (1, "dave") => return None,
        (1, "alice") => (6, group),
        (1, "bob") => (1, "operator"),
        (1, "carol") => (0, "people"),
        _ => (level, group),
    };
    Some(User {
        name: name.to_owned(),
        level,
        groups: vec![group.to_owned()],
        details: Map::new(),
    })
}

/// A hub at its start, with the operator logged in.
pub(crate) fn hub(variant: usize, durable: bool, epoch: u64, records: Vec<Record>) -> Hub {
    let settings = Settings {
        epoch,
        durable,
        records,
        limits: limits(),
        counts_above: 2,
        ..Settings::default()
    };
    let mut hub = Hub::new(settings, registry(variant), &"open".into(), &specs(variant)).unwrap();
    let user = User {
        name: "admin".to_owned(),
        ..user(2, 0).unwrap()
    };
    let (nickname, id) = (None, None);
    let login = Input::Login {
        peer: ADMIN,
        user,
        nickname,
        id,
    };
    hub.handle(0, login, &mut Vec::new());
    hub
}

/// A configuration; who is logged in under which user is the log's business.
pub(crate) fn configuration(variant: usize, users: Vec<(PeerId, Option<User>)>) -> Configuration {
    Configuration {
        registry: registry(variant),
        root: "open".into(),
        contexts: specs(variant),
        limits: limits(),
        users,
    }
}

fn limits() -> Limits {
    Limits {
        contexts: Limit::At(25),
        joined: Limit::At(16),
        ..Limits::default()
    }
}

fn registry(variant: usize) -> Registry {
    let mut registry = Registry::builtin();
    add_kinds(&mut registry);
    registry.define("lab", roles(variant));
    registry.define("lab-token", chain());
    registry
}

fn specs(variant: usize) -> Vec<ContextSpec> {
    let contexts = contexts(variant).into_iter();
    contexts
        .map(|(path, map)| from_value(map.with("path", path).into()).unwrap())
        .collect()
}

fn of(kind: &str) -> Map {
    Map::new().with("kind", kind)
}

fn managed(kind: &str, lease: i64, expiry: &str) -> Map {
    of("token").with("manager", of(kind).with("lease", lease).with("expiry", expiry))
}

fn guarded(token: &str, name: &str) -> Map {
    let guard = Map::new().with("token", token).with("names", vec![name.into()]);
    of("channel").with("guard", guard)
}

fn contexts(variant: usize) -> Vec<(&'static str, Map)> {
    let safe = Map::new().with("channel", "/yard/work").with("name", "lift");
    let key = match variant {
        2 => managed("level-or-lease", 8000, "eager"),
        _ => managed("first-come", 5000, "lazy"),
    };
    let eager = match variant {
        2 => managed("level-or-lease", 7000, "lazy"),
        _ => managed("level-or-lease", 2000, "eager").with("safe-on-give", false),
    };
    let dead = managed("level-or-lease", 5000, "lazy").with("safe-on-give", false);
    let dead = match variant {
        2 => dead,
        _ => dead.with("deadman", 2000),
    };
    let turns = match variant {
        2 => managed("first-come", 1000, "lazy"),
        _ => of("token").with("manager", "turns"),
    };
    let yard = of("session").with("presence", "none");
    let yard = match variant {
        4 => yard.with("manager", "closed"),
        _ => yard,
    };
    let talk = match variant {
        3 => of("session"),
        _ => of("channel").with("presence", "counts"),
    };
    let mut contexts = vec![
        ("/lab", of("session").with("manager", "lab")),
        ("/lab/token", of("token").with("manager", "lab-token")),
        ("/lab/arm", guarded("/lab/token", "command")),
        ("/lab/talk", talk),
        ("/yard", yard),
        ("/yard/key", key.with("safe", safe)),
        ("/yard/eager", eager),
        ("/yard/dead", dead),
        ("/yard/turns", turns),
        ("/yard/moody", of("token").with("manager", "moody")),
        ("/yard/chaired", of("token").with("manager", "chaired")),
        ("/yard/work", guarded("/yard/key", "*")),
        (
            "/yard/press",
            guarded("/yard/eager", "say").with("delivery", "latest"),
        ),
        ("/yard/belt", guarded("/yard/dead", "command")),
        (
            "/yard/gate",
            guarded("/yard/turns", "command").with("manager", "counted"),
        ),
        (
            "/yard/bay",
            guarded("/yard/chaired", "command").with("manager", "chaired"),
        ),
        (
            "/yard/dock",
            guarded("/yard/eager", "command").with("manager", "chaired"),
        ),
        ("/yard/mill", guarded("/yard/moody", "command")),
        ("/yard/tap", of("channel").with("manager", "counted")),
    ];
    if variant == 3 {
        contexts.retain(|(path, _)| !matches!(*path, "/yard/turns" | "/yard/gate"));
        contexts.push(("/yard/extra", of("channel")));
    }
    contexts
}

fn roles(variant: usize) -> Value {
    let rule = |name: &str, verbs: &[&str]| {
        let verbs: Vec<Value> = verbs.iter().map(|verb| Value::from(*verb)).collect();
        Map::new().with("name", name).with("allow", verbs)
    };
    let looks: &[&str] = &["join", "lookup", "list", "info", "members", "stats", "stop"];
    let acts: &[&str] = &[
        "send", "grab", "renew", "give", "accept", "request", "inhibit", "invite",
    ];
    let people = match variant {
        5 => looks.to_vec(),
        _ => [looks, acts].concat(),
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
        rule("people", &people).with("min-level", 1).into(),
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

/// What holds for a token of the configuration, in µs.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Rules {
    pub(crate) lease: Option<u64>,
    pub(crate) eager: bool,
    pub(crate) deadman: Option<u64>,
    /// The longest turn while others wait, and the least once the first waits.
    pub(crate) hold: Option<(u64, u64)>,
    pub(crate) by_level: bool,
    pub(crate) safe_on_give: bool,
    /// The one channel that hears its safe state.
    pub(crate) safe: Option<Path>,
    /// Who waits for it is let have it when it is free.
    pub(crate) calm: bool,
}

/// What holds for a token; none = it is not of the configuration.
pub(crate) fn rules(path: &Path, variant: usize) -> Option<Rules> {
    // Asked several times a step for each token, so worked out once.
    static ALL: LazyLock<Vec<BTreeMap<Path, Rules>>> = LazyLock::new(|| {
        let of = |variant| {
            let contexts = contexts(variant).into_iter();
            let rules = contexts.filter_map(|(path, spec)| Some((Path::parse(path).ok()?, rules_of(&spec)?)));
            rules.collect()
        };
        (0..VARIANTS).map(of).collect()
    });
    ALL[variant].get(path).cloned()
}

fn rules_of(spec: &Map) -> Option<Rules> {
    let word = |key: &str| spec.get(key).and_then(Value::as_str);
    if word("kind") != Some("token") {
        return None;
    }
    let manager = spec.get("manager").unwrap();
    let kind = manager
        .as_str()
        .or_else(|| manager.get("kind")?.as_str())
        .unwrap();
    let micros = |value: &Value| value.as_int().and_then(|ms| u64::try_from(ms * 1000).ok());
    let lease = match kind {
        "lab-token" => Some(180_000_000),
        "turns" => Some(20_000_000),
        _ => manager.get("lease").and_then(micros),
    };
    Some(Rules {
        lease,
        eager: manager.get("expiry").and_then(Value::as_str) == Some("eager"),
        deadman: spec.get("deadman").and_then(micros),
        hold: (kind == "turns").then_some((HOLD, NOTICE)),
        by_level: matches!(kind, "lab-token" | "level-or-lease"),
        safe_on_give: spec.get("safe-on-give").is_none(),
        safe: spec
            .get("safe")
            .and_then(|safe| Path::parse(safe.get("channel")?.as_str()?).ok()),
        calm: !matches!(kind, "moody" | "chaired"),
    })
}
