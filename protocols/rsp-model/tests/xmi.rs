//! Models drawn in UML (S4): what is read of XMI, every fault with its place, and what must not grow.

use mom_rsp_model::{Fault, Model};

const XMI: &str = include_str!("ir-robot.xmi");
const TOML: &str = include_str!("../../../config/ir-robot.toml");

/// The fault, its place and its words, with something replaced in the example.
fn fault(old: &str, new: &str) -> (Fault, (usize, usize), String) {
    assert!(XMI.contains(old), "{old}");
    let error = Model::import_xmi(&XMI.replacen(old, new, 1)).expect_err(new);
    let (line, column) = error.place();
    let words = error.to_string();
    let words = words.strip_prefix(&format!("line {line}, column {column}: "));
    (
        error.fault(),
        (line, column),
        words.expect("the place comes first").to_owned(),
    )
}

fn check(old: &str, new: &str, kind: Fault, place: (usize, usize), words: &str) {
    let found = fault(old, new);
    assert_eq!(found, (kind, place, words.to_owned()), "{new}");
}

#[test]
fn a_drawn_model_is_the_one_that_is_written() {
    let drawn = Model::import_xmi(XMI).unwrap();
    let written = Model::read(TOML).unwrap();
    assert_eq!(drawn.canonical(), written.canonical());
    assert_eq!(drawn.hash(), written.hash());
    let (_, turret) = drawn.find("turret").unwrap();
    assert_eq!(
        turret.doc,
        "Steps by which the turret turns; to the left is positive."
    );
    assert_eq!(Model::read(&drawn.to_toml()).unwrap(), drawn);
}

#[test]
fn what_is_no_xmi_is_refused_at_its_place() {
    let (kind, place, _) = fault("<rsp:Monitor", "<rsp:Monitor of=\"_3\"");
    assert_eq!((kind, place.0), (Fault::Syntax, 43));
    let error = Model::import_xmi("<html/>").unwrap_err();
    assert_eq!(
        error.to_string(),
        "line 1, column 1: this is not XMI: `xmi:XMI` or `uml:Model` is expected, and there is `html`"
    );
    let words = "there is no `uml:Model` in `xmi:XMI`";
    let empty = "<x:XMI xmlns:x=\"http://www.omg.org/spec/XMI/20131001\"/>";
    assert_eq!(
        Model::import_xmi(empty).unwrap_err().to_string(),
        format!("line 1, column 1: {words}")
    );
}

#[test]
fn what_is_outside_the_subset_is_refused() {
    check(
        "<ownedAttribute xmi:id=\"_8\" name=\"motion\"/>",
        "<ownedOperation xmi:id=\"_8\" name=\"motion\"/>",
        Fault::Xmi,
        (26, 9),
        "`ownedOperation` is outside the part of XMI that is read: the robot's class has attributes and comments alone",
    );
    check(
        "<rsp:Robot xmi:id=\"_s0\" base_Class=\"_r\"",
        "<rsp:Robot xmi:id=\"_s0\" base_Class=\"_x\"",
        Fault::Xmi,
        (3, 3),
        "no class has the stereotype `Robot` or a tag `id`: it is the robot, and its attributes are the elements",
    );
    check(
        "<rsp:Monitor xmi:id=\"_s5\" base_Property=\"_5\"",
        "<rsp:Monitor xmi:id=\"_s5\" base_Property=\"_x\"",
        Fault::Xmi,
        (23, 9),
        "`turret_state` has no kind: give it a stereotype such as `Effector`, or a tag `kind`",
    );
    check(
        "<rsp:Command ",
        "<rsp:Comand ",
        Fault::UnknownWord,
        (44, 3),
        "there is no stereotype `comand`; did you mean `command`?",
    );
}

#[test]
fn what_is_checked_in_toml_is_checked_in_xmi() {
    check(
        "type=\"i8\" unit=\"%\" range=\"-100 100\"",
        "type=\"i8\" unit=\"%\" range=\"100 -100\"",
        Fault::Range,
        (41, 75),
        "the range is reversed: 100 is more than -100; the least value goes first",
    );
    check(
        "period=\"40\"",
        "peroid=\"40\"",
        Fault::UnknownKey,
        (36, 50),
        "there is no key `peroid`; did you mean `period`?",
    );
    check(
        "members=\"_1 _2 _3\"",
        "members=\"_1 _2 _4711\"",
        Fault::Name,
        (46, 56),
        "`_4711` is not a name: lower-case letters and digits, a letter first, `-` between them, at most 48",
    );
    check(
        "id=\"8\" period",
        "id=\"eight\" period",
        Fault::Type,
        (36, 47),
        "expected an integer, found a text",
    );
}

#[test]
fn entities_do_not_grow_and_deep_trees_do_not_overflow() {
    let bomb = "<!DOCTYPE x [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;\">]><x>&b;</x>";
    assert_eq!(Model::import_xmi(bomb).unwrap_err().fault(), Fault::Syntax);
    for depth in [100, 60_000, 100_000] {
        let deep = format!("{}{}", "<a>".repeat(depth), "</a>".repeat(depth));
        assert!(Model::import_xmi(&deep).is_err());
        let open = "<a>".repeat(depth);
        assert_eq!(Model::import_xmi(&open).unwrap_err().fault(), Fault::Syntax);
    }
    let long = " ".repeat((1 << 20) + 1);
    assert_eq!(Model::import_xmi(&long).unwrap_err().fault(), Fault::TooLong);
}
