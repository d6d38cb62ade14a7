//! Wrong contexts and users, and all that is wrong at once.

use std::fs;

use mom_config::Config;
use mom_login::hash;
use tempfile::TempDir;

use super::files::{check, load};

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

#[test]
fn wrong_safe_states() {
    let (token, channel) = (
        "[[contexts]]\npath = \"/t\"\nkind = \"token\"\n",
        "[[contexts]]\npath = \"/c\"\nkind = \"channel\"\n",
    );
    check(
        &format!("{token}¦safe = {{ channel = \"/c\", name = \"home\" }}\n{channel}"),
        "contexts[0].safe.channel",
        "/c is not guarded by /t",
    );
    check(
        &format!(
            "{token}¦safe = {{ channel = \"/c\", name = \"home\" }}\n{}{channel}guard = {{ token = \"/u\", names = [\"*\"] }}\n",
            token.replace("/t", "/u")
        ),
        "contexts[0].safe.channel",
        "/c is guarded by /u, not by /t",
    );
    let guard = "guard = { token = \"/t\", names = [\"*\"] }\n";
    check(
        &format!("{token}¦safe = {{ channel = \"/c\", name = \"stop\" }}\n{channel}{guard}"),
        "contexts[0].safe.name",
        "leave safe out to send halt",
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
        "¦[[users]]\nname = \"ann\"\nlevel = 1\n",
        "users[0]",
        "no password, key or certificate",
    );
    check_users(
        &(user("ann") + "¦rights = 1\n"),
        "users[0].rights",
        "there is no key",
    );
    check_users(
        &(user("ann") + "¦level = \"high\"\n"),
        "users[0].level",
        "a whole number, not \"high\"",
    );
    check_users(
        &(user("ann") + "¦level = 4294967296\n"),
        "users[0].level",
        "too large or too small; must be a whole number",
    );
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

/// What one login may cost is bounded.
#[test]
fn hashes_of_wrong_costs() {
    let hash = hash("secret").expect("a hash");
    for (costs, words) in [
        ("m=4194304,t=9", "too costly"),
        ("m=7,t=1", "costs that argon2 does not have"),
    ] {
        let costly = hash.replace("m=19456,t=2", costs);
        assert_ne!(costly, hash);
        let user = format!("[[users]]\nname = \"ann\"\n¦password = \"{costly}\"\n");
        check_users(&user, "users[0].password", words);
    }
}

#[test]
fn wrong_keys_of_users() {
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
    check_users(&arm("7"), "users[0].keys[0]", "a text in quotes");
}

/// What comes of a fault is not told beside it; `load` takes one alone.
#[test]
fn what_follows_from_a_fault_is_not_told() {
    let (token, channel) = (
        "[[contexts]]\npath = \"/s\"\nkind = \"session\"\n[[contexts]]\npath = \"/s/t\"\nkind = \"token\"\n",
        "[[contexts]]\npath = \"/s/c\"\nkind = \"channel\"\n",
    );
    let safe = "safe = { channel = \"/s/c\", name = \"home\" }\n";
    let guard = "guard = { token = \"/s/t\", names = [\"*\"] }\n";
    let lab = format!("{token}{safe}{channel}{guard}");
    assert!(load(&[("mom.toml", &lab)]).is_ok());
    let marked = |text: &str, with: &str| lab.replacen(text, with, 1);
    check(
        &marked("kind = \"session\"", "¦kind = \"sesion\""),
        "contexts[0].kind",
        "session",
    );
    check(
        &marked("kind = \"token\"", "¦kind = \"tokn\""),
        "contexts[1].kind",
        "token",
    );
    check(
        &marked("guard = { token = \"/s/t\"", "¦guard = { token = \"/s/tt\""),
        "contexts[2].guard.token",
        "no token /s/tt",
    );
    check(
        &marked(
            "guard = { token = \"/s/t\", names = [\"*\"]",
            "¦guard = { token = \"/s/t\", names = 4",
        ),
        "contexts[2].guard.names",
        "list",
    );
    let managed = "root = \"m\"\n[managers.m]\n¦kind = \"rolls\"\nrules = []\n[[contexts]]\npath = \"/a\"\nkind = \"channel\"\nmanager = \"m\"\n";
    check(managed, "managers.m.kind", "roles");
    // Where keys belong below a header that cannot be read is not known; below the rest it is.
    check("¦[limits\nparcel = 0\n", "[limits", "");
    let folder = TempDir::new().expect("a folder");
    fs::write(folder.path().join("mom.toml"), "log = info\nconnections = 0\n").expect("written");
    let errors = Config::load(&folder.path().join("mom.toml")).expect_err("two are wrong");
    let lines: Vec<_> = errors.iter().map(|error| error.line).collect();
    assert_eq!(lines, [Some(1), Some(2)], "{errors}");
}

/// Wrong in many places, some of which make others look wrong.
const MUCH: &str = "\
listen = [\"127.0.0.1:7666\", \"127.0.0.1:99999\"]
conections = 5
users = \"staff.toml\"
root = \"lab\"
[limits]
outbox = \"4 MB\"
heartbeat = 1000
gone = 500
parts = 0
[managers.lab]
kind = \"roles\"
[[managers.lab.rules]]
allow = [\"jion\", \"talk\"]
[[managers.lab.rules]]
users = [\"ann\"]
[managers.token]
kind = \"first-com\"
[[contexts]]
path = \"/robot\"
kind = \"sesion\"
[[contexts]]
path = \"/robot/token\"
kind = \"token\"
manager = \"token\"
safe = { channel = \"/robot/arm\", name = \"unstop\" }
[[contexts]]
path = \"/robot/arm\"
kind = \"channel\"
guard = { token = \"/robot/token\", names = [\"command\"] }
[[contexts]]
path = \"/chat\"
kind = \"channel\"
manager = \"talkers\"
guard = { token = \"/nowhere\", names = [\"*\"] }
lease = 5
[[contexts]]
path = \"/t\"
kind = \"token\"
safe = { channel = \"/v\", name = \"\" }
[[contexts]]
path = \"/v\"
kind = \"channel\"
";
const STAFF: &str =
    "[[users]]\nname = \"ann\"\npassword = \"secret\"\nlevel = \"high\"\n[[users]]\nkeys = []\n";

/// All that is wrong is told, each once and in the order of the files; what only comes of it is not.
#[test]
fn all_faults_are_told_at_once() {
    let folder = TempDir::new().expect("a folder");
    for (name, text) in [("mom.toml", MUCH), ("staff.toml", STAFF)] {
        fs::write(folder.path().join(name), text).expect("written");
    }
    let errors = Config::load(&folder.path().join("mom.toml")).expect_err("much is wrong");
    let told: Vec<String> = errors
        .iter()
        .map(|error| {
            format!(
                "{} {}",
                error.line.unwrap_or(0),
                error.key.as_deref().unwrap_or("-")
            )
        })
        .collect();
    let expected = [
        "1 listen[1]",
        "2 conections",
        "6 limits.outbox",
        "8 limits.gone",
        "9 limits.parts",
        "13 managers.lab.rules[0].allow[0]",
        "13 managers.lab.rules[0].allow[1]",
        "14 managers.lab.rules[1].allow",
        "17 managers.token.kind",
        "20 contexts[0].kind",
        "25 contexts[1].safe.name",
        "33 contexts[3].manager",
        "34 contexts[3].guard.token",
        "35 contexts[3].lease",
        "39 contexts[4].safe.name",
        "39 contexts[4].safe.channel",
        "3 users[0].password",
        "4 users[0].level",
        "5 users[1].name",
    ];
    assert_eq!(told, expected, "{errors}");
}

/// However much is wrong, and in a file that names itself as its users file, reading comes to an end.
#[test]
fn the_list_is_bounded() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("mom.toml");
    let told = |text: &str| {
        fs::write(&file, text).expect("written");
        let errors = Config::load(&file).expect_err("much is wrong");
        errors.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let entry = |index: usize| format!("[[contexts]]\npath = \"/{index}\"\nkind = \"channel\"\n");
    let wrong: [&dyn Fn(usize) -> String; 2] = [&|index| entry(index) + "colour = 1\n", &|index| {
        entry(index) + "manager = \"nobody\"\n"
    }];
    for wrong in wrong {
        let told = told(&(0..150).map(wrong).collect::<String>());
        assert_eq!(told.len(), 101, "{told:#?}");
        assert!(told[100].contains("more may be wrong"), "{}", told[100]);
    }
    let told = told("users = \"mom.toml\"\nlog = \"info\"\n");
    assert!(!told.is_empty() && told.len() < 5, "{told:#?}");
}
