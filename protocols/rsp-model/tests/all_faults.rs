//! All that is wrong in a model's file, told at once.

use mom_rsp_model::{Fault, Model};

const SOUND: &str =
    "name = \"cart\"\nid = 7\n[[element]]\nname = \"wheel\"\nkind = \"effector\"\ntype = \"i16\"\n";

/// The lines and kinds of all faults of a text.
fn all(text: &str) -> Vec<(usize, Fault)> {
    let faults = Model::faults(text);
    faults
        .iter()
        .map(|fault| (fault.place().0, fault.fault()))
        .collect()
}

#[test]
fn all_faults_are_told_and_none_that_follows_from_another() {
    let text = "\
name = \"Cart\"
id = 70000
peroid = 20
period = 0
watchdog = 1
[[element]]
name = \"wheel\"
kind = \"effecter\"
type = \"i16\"
[[element]]
name = \"seen\"
kind = \"monitor\"
of = \"wheel\"
[[element]]
name = \"arm\"
kind = \"effector\"
type = \"i16\"
lasts = 5
rate = -1.0
period = 99999
[[element]]
name = \"arm\"
kynd = \"sensor\"
doc = 7
[[element]]
name = \"both\"
kind = \"module\"
members = [\"arm\", \"none\", \"seen\", \"nobody\"]
";
    let expected = vec![
        (1, Fault::Name),
        (2, Fault::Number),
        (3, Fault::UnknownKey),
        (4, Fault::Number),
        (8, Fault::UnknownWord),
        (18, Fault::NotOfKind),
        (19, Fault::Number),
        (20, Fault::NotOfKind),
        (22, Fault::NameTwice),
        (23, Fault::UnknownKey),
        (28, Fault::Reference),
        (28, Fault::Reference),
    ];
    assert_eq!(all(text), expected);
    for (text, expected) in [
        (
            "",
            vec![
                (1, Fault::MissingKey),
                (1, Fault::MissingKey),
                (1, Fault::Elements),
            ],
        ),
        ("name = = 1\n", vec![(1, Fault::Syntax)]),
        (SOUND, vec![]),
    ] {
        assert_eq!(all(text), expected, "{text}");
    }
}

#[test]
fn the_first_fault_is_among_all_and_so_many_are_told() {
    let many = (0..256).map(|unit| format!("[[element]]\nname = \"e-{unit}\"\nkind = \"x\"\n"));
    let text = format!("name = \"cart\"\nid = 7\n{}", many.collect::<String>());
    let first = Model::read(&text).expect_err("no kind is known");
    let faults = Model::faults(&text);
    assert_eq!((faults.first(), faults.len()), (Some(&first), 50));
}
