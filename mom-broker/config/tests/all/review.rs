//! What looks like a mistake is named at its place, and rules are found by the names that answers give them.

use std::fs;

use mom_config::Config;
use mom_login::hash;
use mom_proto::Path;
use tempfile::TempDir;

const STAFF: &str =
    "users = \"staff.toml\"\nroot = \"m\"\n[managers.m]\nkind = \"roles\"\n[[managers.m.rules]]\n";

fn load(text: &str) -> Config {
    let folder = TempDir::new().expect("a folder");
    let hash = hash("secret").expect("a hash");
    let users = format!(
        "[[users]]\nname = \"ann\"\npassword = \"{hash}\"\nlevel = 5\ngroups = [\"staff\"]\n\
         [[users]]\nname = \"ben\"\npassword = \"{hash}\"\n"
    );
    fs::write(folder.path().join("staff.toml"), users).expect("written");
    let file = folder.path().join("mom.toml");
    fs::write(&file, text).expect("written");
    Config::load(&file).expect(text)
}

/// A file with one remark: where `¦` stands is its line, then the key and some of the words.
fn check(marked: &str, key: &str, words: &str) {
    let (before, after) = marked.split_once('¦').expect("a mark");
    let line = before.matches('\n').count() + 1;
    let warnings = load(&format!("{before}{after}")).warnings();
    let [warning] = &warnings[..] else {
        panic!("one warning, not {warnings:#?}, about {marked}")
    };
    let place = (warning.line, warning.key.as_deref());
    assert_eq!(place, (Some(line), Some(key)), "{warning}");
    assert!(warning.text.contains(words), "{words:?} in {warning}");
}

/// A file without any.
fn check_quiet(text: &str) {
    let warnings = load(text).warnings();
    assert!(warnings.is_empty(), "{warnings:#?} about {text}");
}

/// Two rules, where the later one is never asked, or is.
fn rules(first: &str, second: &str) -> String {
    format!("{STAFF}{first}\n¦[[managers.m.rules]]\n{second}\n")
}

#[test]
fn the_shipped_configurations_look_well() {
    for config in [Config::lab(), Config::two_arms(), Config::fleet()] {
        assert!(config.warnings().is_empty(), "{:#?}", config.warnings());
    }
    assert!(Config::default().warnings().is_empty());
}

#[test]
fn rules_that_never_decide() {
    for (first, second) in [
        ("allow = [\"*\"]", "deny = [\"send\"]"),
        ("allow = [\"join\", \"send\"]", "allow = [\"send\"]"),
        (
            "allow = [\"send\"]\nwhere = [\"/a/**\"]",
            "deny = [\"send\"]\nwhere = [\"/a/b\", \"/a/*\"]",
        ),
        (
            "deny = [\"send\"]\nmessages = [\"x\", \"y\"]",
            "allow = [\"send\"]\nmessages = [\"y\"]",
        ),
        ("allow = [\"*\"]\nmin-level = 1", "allow = [\"*\"]\nmin-level = 2"),
        (
            "allow = [\"*\"]\ngroups = [\"staff\"]",
            "deny = [\"*\"]\ngroups = [\"staff\"]",
        ),
        (
            "allow = [\"*\"]\nusers = [\"ann\", \"ben\"]",
            "deny = [\"*\"]\nusers = [\"ben\"]",
        ),
    ] {
        check(
            &rules(first, second),
            "managers.m.rules[1]",
            "never decides: rule 1 (line 5)",
        );
    }
    for (first, second) in [
        ("allow = [\"send\"]", "allow = [\"*\"]"),
        (
            "allow = [\"send\"]\nwhere = [\"/a/*\"]",
            "deny = [\"send\"]\nwhere = [\"/a/**\"]",
        ),
        ("allow = [\"send\"]\nwhere = [\"/a\"]", "deny = [\"send\"]"),
        ("deny = [\"send\"]\nmessages = [\"x\"]", "allow = [\"send\"]"),
        ("allow = [\"*\"]\nmin-level = 2", "allow = [\"*\"]\nmin-level = 1"),
        ("allow = [\"*\"]\nmin-level = 2", "allow = [\"*\"]"),
        (
            "allow = [\"*\"]\ngroups = [\"staff\"]",
            "deny = [\"*\"]\nusers = [\"ann\"]",
        ),
        ("allow = [\"*\"]\nusers = [\"ann\"]", "deny = [\"*\"]"),
    ] {
        check_quiet(&rules(first, second).replace('¦', ""));
    }
}

#[test]
fn names_that_nobody_has() {
    check(
        &format!("{STAFF}allow = [\"*\"]\n¦users = [\"ann\", \"anne\"]\n"),
        "managers.m.rules[0].users",
        "no user \"anne\"",
    );
    check(
        &format!("{STAFF}allow = [\"*\"]\n¦groups = [\"stuff\"]\n"),
        "managers.m.rules[0].groups",
        "group \"stuff\"",
    );
    check(
        &format!("{STAFF}allow = [\"*\"]\n¦min-level = 6\n"),
        "managers.m.rules[0].min-level",
        "the highest is 5",
    );
    check(
        &rules(
            "name = \"x\"\nallow = [\"send\"]",
            "name = \"x\"\nallow = [\"join\"]",
        ),
        "managers.m.rules[1]",
        "another rule (line 5) is called \"x\" too",
    );
    // Who else there is cannot be known where nobody is listed, or tokens bring their own.
    let anybody = format!("{STAFF}allow = [\"*\"]\nusers = [\"zoe\"]\n");
    check_quiet(&anybody.replace("users = \"staff.toml\"\n", ""));
    check_quiet(&(anybody.replace("zoe", "guest") + "[login]\nguests = true\n"));
    let secret =
        "[login.jwt]\nissuer = \"i\"\naudience = \"a\"\nalgorithms = [\"HS256\"]\nkey = \"staff.toml\"\n";
    check_quiet(&format!("{anybody}{secret}users = \"from-claims\"\n"));
}

#[test]
fn managers_that_nothing_uses() {
    check(
        "¦[managers.spare]\nkind = \"open\"\n",
        "managers.spare",
        "nothing in this file uses it",
    );
    check_quiet(
        "root = \"a\"\n[managers]\nb = \"open\"\n[managers.a]\nkind = \"chain\"\nof = [\"b\", \"c\"]\n[managers.c]\nkind = \"closed\"\n",
    );
}

#[test]
fn guards_and_safe_states_without_effect() {
    let token = "[[contexts]]\npath = \"/t\"\nkind = \"token\"\n";
    let channel = "[[contexts]]\npath = \"/c\"\nkind = \"channel\"\n";
    check(
        &format!("{token}{channel}¦guard = {{ token = \"/t\", names = [\"command\", \"stop\"] }}\n"),
        "contexts[1].guard.names",
        "stop never needs a token",
    );
    check(
        &format!("{token}{channel}¦guard = {{ token = \"/t\", names = [\"*\"] }}\n"),
        "contexts[1].guard.names",
        "* covers what a device says of itself",
    );
    check(
        &format!("{token}¦safe = {{ channel = \"/x\", name = \"home\" }}\n{channel}"),
        "contexts[0].safe.channel",
        "this file has no /x",
    );
    let guard = "guard = { token = \"/t\", names = [\"command\"] }\n";
    check_quiet(&format!(
        "{token}safe = {{ channel = \"/c\", name = \"home\" }}\n{channel}{guard}"
    ));
}

#[test]
fn rules_are_found_by_their_names() {
    let text = "root = \"lab\"\n[managers.lab]\nkind = \"roles\"\n[[managers.lab.rules]]\nname = \"staff\"\nallow = [\"*\"]\n\
        [[managers.lab.rules]]\nallow = [\"join\"]\n[managers.token]\nkind = \"chain\"\nof = [\n  \"lab\",\n  { kind = \"first-come\" },\n]\n\
        [[contexts]]\npath = \"/t\"\nkind = \"token\"\nmanager = \"token\"\n\
        [[contexts]]\npath = \"/u\"\nkind = \"token\"\nmanager = { kind = \"roles\", rules = [{ allow = [\"grab\"] }] }\n\
        [[contexts]]\npath = \"/c\"\nkind = \"channel\"\nguard = { token = \"/t\", names = [\"x\"] }\n\
        [[contexts]]\npath = \"/d\"\nkind = \"channel\"\n[contexts.manager]\nkind = \"chain\"\nof = [\n\
          { kind = \"quota\", limits = [{ parcels = 1 }] },\n\
          { kind = \"quota\", limits = [{ parcels = 2 }] },\n\
        ]\n";
    let config = load(text);
    for (rule, at, line, key) in [
        ("lab/staff", "/", 4, "managers.lab.rules[0]"),
        ("lab/rule 2", "/", 7, "managers.lab.rules[1]"),
        ("lab", "/", 2, "managers.lab"),
        ("lab/staff", "/t", 4, "managers.lab.rules[0]"),
        ("token/first-come", "/t", 13, "managers.token.of[1]"),
        ("token", "/t", 9, "managers.token"),
        ("roles/rule 1", "/u", 22, "contexts[1].manager.rules[0]"),
        ("roles", "/u", 22, "contexts[1].manager"),
        ("guard of /c", "/", 26, "contexts[2].guard"),
        (
            "chain/quota/limit 1",
            "/d",
            33,
            "contexts[3].manager.of[0].limits[0]",
        ),
        (
            "chain/quota~2/limit 1",
            "/d",
            34,
            "contexts[3].manager.of[1].limits[0]",
        ),
        // What cannot be told closer.
        ("lab/gone", "/", 2, "managers.lab"),
    ] {
        let place = config.locate_rule(rule, &Path::parse(at).expect("a path"));
        let place = place.unwrap_or_else(|| panic!("{rule} at {at}"));
        assert_eq!((place.line, place.key.as_str()), (line, key), "{rule} at {at}");
    }
    for (rule, at) in [
        ("one owner at most", "/t"),
        ("lab/staff", "/u"),
        ("guard of /x", "/"),
        ("lab", "/x"),
    ] {
        assert_eq!(
            config.locate_rule(rule, &Path::parse(at).expect("a path")),
            None,
            "{rule}"
        );
    }
    assert_eq!(
        Config::default().locate_rule("closed", &Path::root()),
        None,
        "no file"
    );
}
