//! The annotated default is the default, and wrong configurations are refused at their place.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use mom_config::{Config, ConfigError};
use mom_login::hash;
use mom_proto::Limits;
use tempfile::TempDir;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../config")
        .join(name)
}

/// All that a configuration holds, but for where it comes from.
fn facts(config: &Config) -> String {
    let all = format!("{config:#?}");
    let (facts, source) = all.rsplit_once("    source: ").expect("the last field");
    assert!(source.contains("Some") || source.contains("None"));
    facts.to_owned()
}

#[test]
fn the_annotated_default_is_the_default() {
    let file = Config::load(&shipped("mom.toml")).expect("right");
    assert_eq!(facts(&file), facts(&Config::default()));
}

#[test]
fn the_annotated_default_has_every_key() {
    let text = fs::read_to_string(shipped("mom.toml")).expect("readable");
    let table: toml::Table = text.parse().expect("TOML");
    let keys = |table: &toml::Table| table.keys().cloned().collect::<BTreeSet<_>>();
    let limits = toml::Table::try_from(Limits::default()).expect("limits are a table");
    assert_eq!(keys(table["limits"].as_table().expect("a table")), keys(&limits));
    // What has no default is there as a comment.
    let stands = |key: &str| {
        let marks = [
            format!("# {key} = "),
            format!("# [{key}]"),
            format!("# [[{key}]]"),
            format!("# [{key}."),
        ];
        marks.iter().any(|mark| text.contains(mark.as_str()))
    };
    let schema = mom_config::config_schema();
    let named = |schema: &serde_json::Value| -> Vec<String> {
        let properties = schema["properties"].as_object().expect("a table");
        properties.keys().cloned().collect()
    };
    for key in named(&schema) {
        assert!(table.contains_key(&key) || stands(&key), "{key}");
    }
    for name in ["login", "audit", "record"] {
        let inner = table[name].as_table().expect("a table");
        for key in named(&schema["properties"][name]) {
            let alone = key == "path" && text.contains(&format!("\n[{name}]\n# path = "));
            assert!(
                inner.contains_key(&key) || alone || stands(&format!("{name}.{key}")),
                "{name}.{key}"
            );
        }
    }
}

#[test]
fn the_lab_is_what_is_built_in() {
    let file = Config::load(&shipped("lab.toml")).expect("right");
    assert_eq!(facts(&file), facts(&Config::lab()));
}

fn load(files: &[(&str, &str)]) -> Result<Config, ConfigError> {
    let folder = TempDir::new().expect("a folder");
    for (name, text) in files {
        fs::write(folder.path().join(name), text).expect("written");
    }
    Config::load(&folder.path().join("mom.toml"))
}

/// A wrong file: where `¦` stands is the line that has to be named, then the key and some of the words.
fn check(marked: &str, key: &str, words: &str) {
    let (before, after) = marked.split_once('¦').expect("a mark");
    let line = before.matches('\n').count() + 1;
    let error = load(&[("mom.toml", &format!("{before}{after}"))]).expect_err(marked);
    let file = error.file.clone().unwrap_or_default();
    assert!(file.ends_with("mom.toml"), "{error}");
    assert_eq!(
        (error.line, error.key.as_deref()),
        (Some(line), Some(key)),
        "{error}"
    );
    assert!(error.text.contains(words), "{words:?} in {error}");
    let shown = error.to_string();
    assert!(shown.starts_with(&format!("{file}:{line}: {key}: ")), "{shown}");
}

#[test]
fn wrong_keys_and_types() {
    check("log = \"info\"\n¦listne = []\n", "listne", "unknown field");
    check("[limits]\n¦parcels = 1\n", "parcels", "unknown field");
    check("[login]\n¦hashes = 1\n", "hashes", "unknown field");
    check("¦listen = 7666\n", "listen", "invalid type");
    check("¦connections = \"many\"\n", "connections", "invalid type");
    check(
        "\n[limits]\ndepth = 32\n¦outbox = \"1 MB\"\n",
        "outbox",
        "invalid type",
    );
    check("¦connections = -1\n", "connections", "");
    check("¦reload = \"never\"\n", "reload", "signal");
    check("¦log = \"mom=loud\"\n", "log", "no filter");
    check(
        "[[contexts]]\npath = \"/a\"\nkind = \"channel\"\n¦color = 1\n",
        "color",
        "unknown field",
    );
    check("[limits]\nparcel = 1\n¦parcel = 2\n", "parcel", "duplicate");
    check("log = \"a\"\n¦log \"b\"\n", "log \"b\"", "");
}

/// The store lies relative to the file, as the users do.
#[test]
fn the_store_is_a_directory() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    let path_of = |text: &str| {
        fs::write(&file, text).expect("written");
        Config::load(&file).expect("right").store.path
    };
    assert_eq!(path_of(""), None);
    assert_eq!(path_of("[store]\n"), None);
    assert_eq!(
        path_of("[store]\npath = \"state\"\n"),
        Some(folder.path().join("state"))
    );
    assert_eq!(
        path_of("[store]\npath = \"/var/lib/mom\"\n"),
        Some(PathBuf::from("/var/lib/mom"))
    );
    check("[store]\n¦path = \"\"\n", "store.path", "directory");
    check("[store]\n¦path = 4\n", "path", "invalid type");
    check("[store]\n¦paht = \"state\"\n", "paht", "unknown field");
}

#[test]
fn numbers_that_cannot_be() {
    for key in [
        "depth",
        "attributes",
        "attribute-size",
        "path",
        "path-levels",
        "header",
        "parts",
        "before-login",
        "login-time",
        "outbox",
        "heartbeat",
    ] {
        check(
            &format!("[limits]\n¦{key} = 0\n"),
            &format!("limits.{key}"),
            "from 1",
        );
    }
    for key in ["parcel", "contexts", "joined"] {
        check(&format!("[limits]\n¦{key} = 0\n"), key, "unlimited");
    }
    for table in ["audit", "record"] {
        check(
            &format!("[{table}]\n¦size = 4095\n"),
            &format!("{table}.size"),
            "from 4096",
        );
    }
    for key in ["hashers", "waiting", "attempts", "challenge-time"] {
        check(
            &format!("[login]\n¦{key} = 0\n"),
            &format!("login.{key}"),
            "from 1",
        );
    }
    for key in ["per-address", "per-account"] {
        check(
            &format!("[login.throttle]\n¦{key} = {{ per-minute = 0, burst = 1 }}\n"),
            &format!("login.throttle.{key}.per-minute"),
            "from 1",
        );
        check(
            &format!("[login.throttle]\n¦{key} = {{ per-minute = 1, burst = 0 }}\n"),
            &format!("login.throttle.{key}.burst"),
            "from 1",
        );
    }
    check("¦connections = 0\n", "connections", "from 1");
    check("[limits]\n¦depth = 129\n", "limits.depth", "128");
    check(
        "[limits]\nheartbeat = 500\n¦gone = 500\n",
        "limits.gone",
        "longer than heartbeat",
    );
    check("[limits]\n¦gone = 9999\n", "limits.gone", "longer than heartbeat");
    check("¦listen = []\n", "listen", "address");
}

/// The table of tokens, with one line of it changed and marked.
fn jwt(key: &str, line: &str) -> String {
    let mut text = "[login.jwt]\n".to_owned();
    for (known, value) in [
        ("issuer", "\"https://id.example.org\""),
        ("audience", "\"mom\""),
        ("algorithms", "[\"EdDSA\"]"),
        ("key", "\"issuer.pem\""),
    ] {
        match known == key {
            true => text.push_str(&format!("¦{line}\n")),
            false => text.push_str(&format!("{known} = {value}\n")),
        }
    }
    text
}

/// A wrong table of tokens beside this key.
fn check_jwt(marked: &str, key_file: &str, key: &str, words: &str) {
    let (before, after) = marked.split_once('¦').expect("a mark");
    let line = before.matches('\n').count() + 1;
    let files = [
        ("mom.toml", &*format!("{before}{after}")),
        ("issuer.pem", key_file),
    ];
    let error = load(&files).expect_err(marked);
    assert_eq!(
        (error.line, error.key.as_deref()),
        (Some(line), Some(key)),
        "{error}"
    );
    assert!(error.text.contains(words), "{words:?} in {error}");
    assert!(!error.to_string().contains("0123456789"), "a secret in {error}");
}

/// The public key of RFC 8410, 10.1.
const ED25519: &str = "-----BEGIN PUBLIC KEY-----\nMCowBQYDK2VwAyEAGb9ECWmEzf6FQbrBZ9w7lshQhqowtrbLDFw4rXAxZuE=\n-----END PUBLIC KEY-----\n";
/// The private key of RFC 8410, 10.3.
const PRIVATE: &str = "-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VwBCIEINTuctv5E1hK1bbY8fdp+K06/nwoy/HU++CXqI9EdVhC\n-----END PRIVATE KEY-----\n";

#[test]
fn wrong_tokens() {
    let right = jwt("", "");
    assert!(load(&[("mom.toml", &right), ("issuer.pem", ED25519)]).is_ok());
    let secret = "0123456789".repeat(4);
    let shared = right.replace("EdDSA", "HS256");
    assert!(load(&[("mom.toml", &shared), ("issuer.pem", &secret)]).is_ok());
    let missing = check_marked(&right.replace("key", "¦key"));
    assert!(missing.text.contains("issuer.pem"), "{missing}");
    let algorithms = |list: &str| jwt("algorithms", &format!("algorithms = [{list}]"));
    for (list, key_file, key, words) in [
        ("", ED25519, "algorithms", "EdDSA"),
        ("\"none\"", ED25519, "algorithms", "no signature"),
        ("\"ED25519\"", ED25519, "algorithms", "EdDSA"),
        ("\"EdDSA\", \"HS256\"", ED25519, "algorithms", "different kinds"),
    ] {
        check_jwt(&algorithms(list), key_file, &format!("login.jwt.{key}"), words);
    }
    let key = |algorithm: &str| right.replace("EdDSA", algorithm).replace("key", "¦key");
    for (algorithm, key_file, words) in [
        ("EdDSA", "", "public key in PEM"),
        ("EdDSA", secret.as_str(), "public key in PEM"),
        ("EdDSA", PRIVATE, "private"),
        ("ES256", ED25519, "ECDSA"),
        ("RS256", ED25519, "RSA"),
        ("HS256", ED25519, "must not be used"),
        ("HS256", "0123456789", "at least 32"),
    ] {
        check_jwt(&key(algorithm), key_file, "login.jwt.key", words);
    }
    check_jwt(
        &jwt("issuer", "issuer = \"\""),
        ED25519,
        "login.jwt.issuer",
        "empty",
    );
    check_jwt(
        &jwt("audience", "audience = \"\""),
        ED25519,
        "login.jwt.audience",
        "empty",
    );
    check_jwt(
        &(right.clone() + "¦users = \"claims\"\n"),
        ED25519,
        "users",
        "from-claims",
    );
    check_jwt(
        &right.replacen("[login", "¦[login", 1).replace("issuer = ", "# "),
        ED25519,
        "[login.jwt]",
        "issuer",
    );
}

/// The error of a file without those beside it.
fn check_marked(marked: &str) -> ConfigError {
    let (before, after) = marked.split_once('¦').expect("a mark");
    let error = load(&[("mom.toml", &format!("{before}{after}"))]).expect_err(marked);
    assert_eq!(error.line, Some(before.matches('\n').count() + 1), "{error}");
    error
}

#[test]
fn a_secret_is_not_shown() {
    let secret = "0123456789".repeat(4);
    let shared = jwt("", "").replace("EdDSA", "HS256");
    let config = load(&[("mom.toml", &shared), ("issuer.pem", &secret)]).expect("right");
    assert!(!format!("{config:?}").contains("0123456789"));
}

#[test]
fn wrong_managers() {
    check("¦root = \"opne\"\n", "root.kind", "did you mean open");
    let lab = "[managers.lab]\nkind = \"roles\"\nrules = []\n";
    check(
        &format!("{lab}[[contexts]]\npath = \"/a\"\nkind = \"channel\"\n¦manager = \"lba\"\n"),
        "contexts[0].manager.kind",
        "lab",
    );
    check("[managers.a]\n¦kind = \"role\"\n", "managers.a.kind", "roles");
    check("¦[managers.a]\nrules = []\n", "managers.a.kind", "kind");
    check(
        "[managers.a]\nkind = \"level-or-lease\"\n¦lease = 0\n",
        "managers.a.lease",
        "from 1",
    );
    check(
        "[managers.a]\nkind = \"closed\"\n¦rules = []\n",
        "managers.a.rules",
        "not known",
    );
    check(
        "[managers.a]\nkind = \"roles\"\n[[managers.a.rules]]\nname = \"x\"\n¦allow = [\"jion\"]\n",
        "managers.a.rules[0].allow",
        "jion",
    );
    check(
        "[managers.a]\nkind = \"chain\"\n¦of = [\"a\"]\n",
        "managers.a.of[0].of[0]",
        "contain each other",
    );
}

#[test]
fn wrong_contexts() {
    let session = "[[contexts]]\npath = \"/a\"\nkind = \"session\"\n";
    check(
        "[[contexts]]\npath = \"/a\"\n¦kind = \"chanel\"\n",
        "contexts[0].kind",
        "channel",
    );
    check(
        &format!("{session}¦[[contexts]]\nkind = \"channel\"\n"),
        "contexts[1].path",
        "path",
    );
    check(
        "[[contexts]]\n¦path = \"/a/../b\"\nkind = \"channel\"\n",
        "contexts[0].path",
        "..",
    );
    check(
        "[[contexts]]\n¦path = \"a\"\nkind = \"channel\"\n",
        "contexts[0].path",
        "slash",
    );
    check(
        "[[contexts]]\n¦path = \"/a/b\"\nkind = \"channel\"\n",
        "contexts[0].path",
        "/a",
    );
    check(
        &format!("{session}[[contexts]]\n¦path = \"/a\"\nkind = \"channel\"\n"),
        "contexts[1].path",
        "already",
    );
    check(
        "[[contexts]]\npath = \"/a\"\nkind = \"channel\"\n¦guard = { token = \"/t\", names = [\"*\"] }\n",
        "contexts[0].guard.token",
        "/t",
    );
    check(
        &format!(
            "{session}[[contexts]]\npath = \"/c\"\nkind = \"channel\"\n¦guard = {{ token = \"/a\", names = [\"*\"] }}\n"
        ),
        "contexts[1].guard.token",
        "no token /a",
    );
    check(
        "[[contexts]]\npath = \"/t\"\nkind = \"token\"\n[[contexts]]\npath = \"/c\"\nkind = \"channel\"\n¦guard = { token = \"/t\", names = [] }\n",
        "contexts[1].guard.names",
        "names",
    );
    check(
        &session.replace("kind", "¦lease = 1\nkind"),
        "contexts[0].lease",
        "only a token",
    );
    check(
        "[[contexts]]\npath = \"/a\"\nkind = \"channel\"\n¦delivery = \"maybe\"\n",
        "contexts[0].delivery",
        "latest",
    );
}

/// A wrong users file: the line in it, the key, and some of the words.
fn check_users(marked: &str, key: &str, words: &str) {
    let (before, after) = marked.split_once('¦').expect("a mark");
    let line = before.matches('\n').count() + 1;
    let text = format!("{before}{after}");
    let error = load(&[("mom.toml", "users = \"staff.toml\"\n"), ("staff.toml", &text)]).expect_err(marked);
    assert!(
        error
            .file
            .as_ref()
            .is_some_and(|file| file.ends_with("staff.toml")),
        "{error}"
    );
    assert_eq!(
        (error.line, error.key.as_deref()),
        (Some(line), Some(key)),
        "{error}"
    );
    assert!(error.text.contains(words), "{words:?} in {error}");
}

#[test]
fn wrong_users() {
    check(
        "log = \"info\"\n¦users = \"nobody.toml\"\n",
        "users",
        "nobody.toml",
    );
    let hash = hash("secret").expect("a hash");
    let user = |name: &str| format!("[[users]]\nname = \"{name}\"\npassword = \"{hash}\"\n");
    let good = load(&[
        ("mom.toml", "users = \"staff.toml\"\n"),
        ("staff.toml", &user("ann")),
    ]);
    assert_eq!(good.expect("right").users[0].name, "ann");
    check_users(
        "[[users]]\nname = \"ann\"\n¦password = \"secret\"\n",
        "users[0].password",
        "mom-broker passwd ann",
    );
    check_users(
        &(user("ann") + &user("ann").replace("name", "¦name")),
        "users[1].name",
        "two users",
    );
    check_users(&user("*").replace("name", "¦name"), "users[0].name", "'*'");
    check_users(&user("hub").replace("name", "¦name"), "users[0].name", "hub");
    check_users(
        "[[users]]\n¦name = \"ann\"\nlevel = 1\n",
        "users[0].name",
        "neither password nor keys",
    );
    check_users(&(user("ann") + "¦rights = 1\n"), "rights", "unknown field");
    check_users(&(user("ann") + "¦level = \"high\"\n"), "level", "invalid type");
    let key = "ed25519 Gb9ECWmEzf6FQbrBZ9w7lshQhqowtrbLDFw4rXAxZuE=";
    let arm = |keys: &str| format!("[[users]]\nname = \"arm\"\n¦keys = [{keys}]\n");
    let good = load(&[
        ("mom.toml", "users = \"staff.toml\"\n"),
        (
            "staff.toml",
            &arm(&format!("\"{key} arm of lab 3\"")).replace('¦', ""),
        ),
    ]);
    assert_eq!(good.expect("right").users[0].password, None);
    check_users(
        &arm(&format!("\"{key}\", \"{}\"", &key[8..])),
        "users[0].keys[1]",
        "mom keygen",
    );
    check_users(&arm("\"ed25519 AAAA\""), "users[0].keys[0]", "3 bytes");
    let many = vec![format!("\"{key}\""); 17].join(", ");
    check_users(&arm(&many), "users[0].keys", "at most 16");
    check_users(&arm("7"), "keys", "invalid type");
    let error = load(&[
        ("mom.toml", "users = \"staff.toml\"\n[login]\nguests = true\n"),
        ("staff.toml", &user("guest")),
    ]);
    let error = error.expect_err("guests have the name");
    assert_eq!(
        (error.line, error.key.as_deref()),
        (Some(2), Some("users[0].name")),
        "{error}"
    );
    check("[login]\n¦hub = \"a/b\"\n", "login.hub", "a/b");
    let argon2i = hash.replace("argon2id", "argon2i");
    check_users(
        &user("ann")
            .replace(&hash, &argon2i)
            .replace("password", "¦password"),
        "users[0].password",
        "argon2id",
    );
}
