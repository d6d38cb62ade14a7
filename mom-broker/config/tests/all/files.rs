//! The annotated default is the default, and wrong configurations are refused at their place.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use mom_config::{Config, ConfigError};
use mom_net::{Protocol, TlsUse};
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
    let file = Config::load(&shipped("two-arms.toml")).expect("right");
    assert_eq!(facts(&file), facts(&Config::two_arms()));
    let file = Config::load(&shipped("fleet.toml")).expect("right");
    assert_eq!(facts(&file), facts(&Config::fleet()));
}

pub(crate) fn load(files: &[(&str, &str)]) -> Result<Config, ConfigError> {
    let folder = TempDir::new().expect("a folder");
    for (name, text) in files {
        fs::write(folder.path().join(name), text).expect("written");
    }
    let loaded = Config::load(&folder.path().join("mom.toml"));
    loaded.map_err(|errors| {
        let told: Vec<ConfigError> = errors.iter().cloned().collect();
        let Ok([error]) = <[ConfigError; 1]>::try_from(told) else {
            panic!("one fault is told once: {errors}")
        };
        error
    })
}

/// A wrong file: where `¦` stands is the line that has to be named, then the key and some of the words.
pub(crate) fn check(marked: &str, key: &str, words: &str) {
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
    check(
        "log = \"info\"\n¦listne = []\n",
        "listne",
        "did you mean `listen`?",
    );
    check(
        "[limits]\n¦parcels = 1\n",
        "limits.parcels",
        "did you mean `parcel`?",
    );
    check(
        "[login]\n¦hashes = 1\n",
        "login.hashes",
        "did you mean `hashers`?",
    );
    check("¦listen = 7666\n", "listen", "a list in brackets, not 7666");
    check(
        "¦connections = \"many\"\n",
        "connections",
        "must be a whole number above 0, not \"many\"",
    );
    check(
        "\n[limits]\ndepth = 32\n¦outbox = \"1 MB\"\n",
        "limits.outbox",
        "a whole number above 0, not \"1 MB\"",
    );
    check("¦connections = -1\n", "connections", "above 0, not -1");
    check(
        "¦connections = 99999999999999999999\n",
        "connections",
        "too large or too small; must be a whole number above 0",
    );
    check("¦reload = \"never\"\n", "reload", "signal");
    check("¦log = \"mom=loud\"\n", "log", "not a filter");
    check(
        "[[contexts]]\npath = \"/a\"\nkind = \"channel\"\n¦color = 1\n",
        "contexts[0].color",
        "there is no key `color`; expected one of `path`",
    );
    check("[limits]\nparcel = 1\n¦parcel = 2\n", "parcel", "duplicate");
    check("log = \"a\"\n¦log \"b\"\n", "log \"b\"", "");
    check("¦log = info # words\n", "log", "in quotes: log = \"…\"");
    check(
        "listen = [\"127.0.0.1:0\"\n¦connections = 5\n",
        "connections",
        "comma",
    );
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
    check(
        "[store]\n¦path = 4\n",
        "store.path",
        "a text in quotes, not a number without them",
    );
    check(
        "[store]\n¦paht = \"state\"\n",
        "store.paht",
        "did you mean `path`?",
    );
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
            "above 0",
        );
    }
    for key in ["parcel", "contexts", "joined"] {
        check(
            &format!("[limits]\n¦{key} = 0\n"),
            &format!("limits.{key}"),
            "above 0 or \"unlimited\"",
        );
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
            "above 0",
        );
    }
    for key in ["per-address", "per-account"] {
        check(
            &format!("[login.throttle]\n¦{key} = {{ per-minute = 0, burst = 1 }}\n"),
            &format!("login.throttle.{key}.per-minute"),
            "above 0",
        );
        check(
            &format!("[login.throttle]\n¦{key} = {{ per-minute = 1, burst = 0 }}\n"),
            &format!("login.throttle.{key}.burst"),
            "above 0",
        );
    }
    check("¦connections = 0\n", "connections", "above 0");
    check("[limits]\n¦depth = 129\n", "limits.depth", "128");
    check(
        "[limits]\nheartbeat = 500\n¦gone = 500\n",
        "limits.gone",
        "must exceed `heartbeat`",
    );
    check(
        "[limits]\n¦gone = 9999\n",
        "limits.gone",
        "must exceed `heartbeat`",
    );
    check("¦listen = []\n", "listen", "address");
    check(
        "[limits]\n¦heartbeat = 40000\n",
        "limits.heartbeat",
        "must exceed `heartbeat`",
    );
}

#[test]
fn addresses_that_cannot_be_listened_at() {
    for (address, words) in [
        (
            "127.0.0.1:99999",
            "a port is a whole number from 0 to 65535, not \"99999\"",
        ),
        ("127.0.0.1:http", "a port is a whole number"),
        ("127.0.0.1", "has no port"),
        (":7666", "127.0.0.1:7666"),
        ("::1:7666", "[::1]:7666"),
        ("tcp://127.0.0.1:7666", "not an address of this machine"),
    ] {
        check(&format!("¦listen = [\"{address}\"]\n"), "listen[0]", words);
    }
}

/// Listeners as tables: each fault at its line, and in words.
#[test]
fn listeners_that_contradict_themselves() {
    let entry = |line: &str| format!("[[listen]]\naddress = \"127.0.0.1:7666\"\n¦{line}\n");
    for (line, key, words) in [
        (
            "takes = []",
            "takes",
            "a listener that takes nothing is of no use; name some of xml, binary",
        ),
        ("takes = [\"xlm\"]", "takes[0]", "did you mean `xml`?"),
        ("takes = \"xml\"", "takes", "a list in brackets"),
        ("tls = \"required\"", "tls", "there is no certificate"),
        ("tls = true", "tls", "\"allowed\", \"required\", \"refused\""),
        (
            "proxies = []",
            "proxies",
            "expected one of `address`, `takes`, `tls`, `proxy`",
        ),
        (
            "proxy = [\"10.0.0.0/33\"]",
            "proxy",
            "not an IP address or network",
        ),
        (
            "proxy = [\"::1\", \"localhost\"]",
            "proxy",
            "not an IP address or network",
        ),
        ("proxy = [\"10.0.0.1/8\"]", "proxy", "did you mean `10.0.0.0/8`?"),
        ("proxy = [\"fd00::1/8\"]", "proxy", "did you mean `fd00::/8`?"),
        ("proxy = [\"0.0.0.0/0\"]", "proxy", "every address"),
        ("proxy = [\"::ffff:10.0.0.1\"]", "proxy", "write it as 10.0.0.1"),
    ] {
        check(&entry(line), &format!("listen[0].{key}"), words);
    }
    check(
        "[[listen]]\n¦address = \"127.0.0.1\"\n",
        "listen[0].address",
        "has no port",
    );
    check(
        "¦listen = [{ takes = [\"xml\"] }]\n",
        "listen[0].address",
        "is missing",
    );
    check("¦listen = [7666]\n", "listen[0]", "a text in quotes or a table");
}

#[test]
fn listeners_are_addresses_or_tables() {
    let text = "listen = [\"127.0.0.1:1\", { address = \"[::1]:2\", takes = [\"xml\", \"tunnel\"], tls = \"required\", \
                proxy = [\"10.0.0.0/8\", \"::1\"] }]\n[tls]\ncertificate = \"hub.crt\"\nkey = \"hub.key\"\n";
    let config = load(&[("mom.toml", text)]).expect("right");
    let [plain, table] = &config.listen[..] else {
        panic!("{:?}", config.listen)
    };
    assert_eq!(*plain, "127.0.0.1:1".into());
    assert_eq!((plain.takes.len(), plain.tls), (6, TlsUse::Allowed));
    assert_eq!((&*table.address, table.tls), ("[::1]:2", TlsUse::Required));
    assert_eq!(table.takes, [Protocol::Xml, Protocol::Tunnel]);
    let among = |address: &str| {
        let address = address.parse().expect("an address");
        table.proxy.iter().any(|proxy| proxy.contains(address))
    };
    assert!(among("10.255.0.1") && among("::ffff:10.0.0.1") && among("::1"));
    assert!(!among("11.0.0.1") && !among("::2") && !among("127.0.0.1"));
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
        ("\"none\"", ED25519, "algorithms", "not a signature"),
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
        "login.jwt.users",
        "from-claims",
    );
    check_jwt(
        &right.replacen("[login", "¦[login", 1).replace("issuer = ", "# "),
        ED25519,
        "login.jwt.issuer",
        "is missing",
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
    check("¦root = \"opne\"\n", "root", "did you mean `open`?");
    let lab = "[managers.lab]\nkind = \"roles\"\nrules = []\n";
    check(
        &format!("{lab}[[contexts]]\npath = \"/a\"\nkind = \"channel\"\n¦manager = \"lba\"\n"),
        "contexts[0].manager",
        "lab",
    );
    check(
        "[managers.a]\n¦kind = \"role\"\nrules = []\n",
        "managers.a.kind",
        "did you mean `roles`?",
    );
    check("¦[managers.a]\nrules = []\n", "managers.a.kind", "kind");
    check(
        "[managers.a]\nkind = \"level-or-lease\"\n¦lease = 0\n",
        "managers.a.lease",
        "above 0",
    );
    check(
        "[managers.a]\nkind = \"closed\"\n¦rules = []\n",
        "managers.a.rules",
        "there is no key",
    );
    check(
        "[managers.a]\nkind = \"roles\"\n[[managers.a.rules]]\nname = \"x\"\n¦allow = [\"jion\"]\n",
        "managers.a.rules[0].allow[0]",
        "did you mean `join`?",
    );
    check(
        "[managers.a]\nkind = \"chain\"\n¦of = [\"a\"]\n",
        "managers.a.of[0]",
        "contain each other",
    );
}
