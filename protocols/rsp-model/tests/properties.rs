//! Properties of any text and any model.

mod any_text;

use mom_rsp_model::Model;
use proptest::prelude::*;

const CUBO: &str = include_str!("../../../config/cubo.toml");
const IR_ROBOT: &str = include_str!("../../../config/ir-robot.toml");
const XMI: &str = include_str!("ir-robot.xmi");

/// One of the examples, with some of its bytes replaced, doubled or left out.
fn nearly_right() -> impl Strategy<Value = Vec<u8>> {
    let text = prop::sample::select(vec![CUBO, IR_ROBOT, XMI]);
    let changes = prop::collection::vec(
        (any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0..4u8),
        1..4,
    );
    (text, changes).prop_map(|(text, changes)| {
        let mut bytes = text.as_bytes().to_vec();
        for (at, with, how) in changes {
            let (at, with) = (at.index(bytes.len()), with.index(bytes.len()));
            match how {
                0 => bytes[at] = bytes[with],
                1 => bytes.insert(at, bytes[with]),
                2 => drop(bytes.remove(at)),
                _ => {
                    let (from, to) = (at.min(with), at.max(with).min(at.min(with) + 200));
                    drop(bytes.drain(from..to));
                }
            }
        }
        bytes
    })
}

#[derive(Clone, Debug)]
struct Line {
    key: String,
    value: String,
}

/// The lines of an element that is right.
fn element(index: usize) -> impl Strategy<Value = Vec<Line>> {
    let number = prop::sample::select(vec!["u8", "i8", "u16", "i16", "u32", "i32", "f32"]);
    let kind = prop::sample::select(vec![
        "effector",
        "sensor",
        "command",
        "event",
        "memory-command",
        "memory-event",
    ]);
    let unit = prop::sample::select(vec!["", "mm", "mm/s", "m/s^2", "%"]);
    let scale = prop::sample::select(vec![1.0, 0.1, 0.001, 2.0, 1e-6]);
    (
        number,
        kind,
        unit,
        scale,
        1..6u16,
        0..=40u32,
        0..=40u32,
        any::<bool>(),
    )
        .prop_map(move |(number, kind, unit, scale, count, a, b, flag)| {
            let (min, max) = (f64::from(a.min(b)) * scale, f64::from(a.max(b)) * scale);
            let mut lines = vec![
                ("name", format!("\"e{index}\"")),
                ("kind", format!("\"{kind}\"")),
                ("type", format!("\"{number}\"")),
                ("count", count.to_string()),
                ("unit", format!("\"{unit}\"")),
                ("scale", format!("{scale:?}")),
                ("range", format!("[{min:?}, {max:?}]")),
                ("doc", format!("\"about {a} | `{b}`\"")),
            ];
            if kind == "effector" {
                lines.push(("safe", format!("{min:?}")));
                lines.push(("rate", format!("{:?}", scale * 3.0)));
                lines.push(("interpolate", flag.to_string()));
            }
            if kind == "sensor" {
                lines.push(("period", a.to_string()));
            }
            if kind.ends_with("command") {
                lines.push(("lasts", a.to_string()));
            }
            let line = |(key, value): (&str, String)| Line {
                key: key.to_owned(),
                value,
            };
            lines.into_iter().map(line).collect()
        })
}

fn elements() -> impl Strategy<Value = Vec<Vec<Line>>> {
    (1..12usize).prop_flat_map(|count| (0..count).map(element).collect::<Vec<_>>())
}

fn written(elements: &[Vec<Line>]) -> String {
    let mut text = "name = \"x\"\nid = 1\nlargest-packet = 2000\n".to_owned();
    for lines in elements {
        text.push_str("[[element]]\n");
        for Line { key, value } in lines {
            text.push_str(&format!("{key} = {value}\n"));
        }
    }
    text
}

proptest! {
    #[test]
    fn any_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        any_text::any_bytes(&bytes);
    }

    #[test]
    fn what_is_nearly_right_never_panics(bytes in nearly_right()) {
        any_text::any_bytes(&bytes);
    }

    #[test]
    fn what_is_right_is_read_and_written(elements in elements()) {
        let model = Model::read(&written(&elements)).unwrap();
        any_text::holds(&model);
    }

    /// White space, comments, the order of keys and doc texts do not count.
    #[test]
    fn the_hash_is_stable_under_reformatting(
        elements in elements(),
        order in any::<prop::sample::Index>(),
        spaces in 1..4usize,
    ) {
        let model = Model::read(&written(&elements)).unwrap();
        let mut others = elements.clone();
        for lines in &mut others {
            let by = order.index(lines.len());
            lines.rotate_left(by);
            for line in lines {
                if line.key == "doc" {
                    line.value = "'something else'".to_owned();
                }
            }
        }
        let text = written(&others)
            .replace(" = ", &format!("{}={}", " ".repeat(spaces), "\t".repeat(spaces)))
            .replace('\n', "  # a comment\n\n");
        let other = Model::read(&text).unwrap();
        prop_assert_eq!(other.canonical(), model.canonical());
        prop_assert_eq!(other.hash(), model.hash());
        let digests = |model: &Model| -> Vec<u32> {
            model.elements().iter().map(|element| element.digest).collect()
        };
        prop_assert_eq!(digests(&other), digests(&model));
    }
}

/// Each change that both ends must agree on is another hash, and another digest of the element it is in.
#[test]
fn the_hash_changes_with_all_that_counts() {
    let base = Model::read(CUBO).unwrap();
    let header = [
        ("name = \"cubo\"", "name = \"cuba\""),
        ("id = 0xc0b0", "id = 0xc0b1"),
        ("period = 20\n", "period = 40\n"),
        ("largest-packet = 2048", "largest-packet = 2049"),
        ("watchdog = 500", "watchdog = 501"),
    ];
    for (old, new) in header {
        assert!(CUBO.contains(old), "{old}");
        let changed = Model::read(&CUBO.replacen(old, new, 1)).expect(new);
        assert_ne!(changed.hash(), base.hash(), "{new}");
    }
    for (element, old, new) in [
        (
            "left-wheel",
            "kind = \"effector\"",
            "kind = \"effector\"\nmotion = \"incremental\"",
        ),
        ("left-wheel", "type = \"i16\"", "type = \"i32\""),
        ("left-wheel", "unit = \"mm/s\"", "unit = \"cm/s\""),
        ("left-wheel", "range = [-500, 500]", "range = [-500, 501]"),
        ("left-wheel", "range = [-500, 500]", "range = [-501, 500]"),
        ("left-wheel", "rate = 2000", "rate = 2001"),
        ("left-wheel", "rate = 2000\n", "rate = 2000\nsafe = 1\n"),
        ("left-wheel", "rate = 2000\n", "rate = 2000\ninterpolate = true\n"),
        ("left-wheel", "rate = 2000\n", "rate = 2000\ncount = 2\n"),
        ("joints", "scale = 0.1", "scale = 0.2"),
        ("joints", "\"left-arm\"", "\"left-leg\""),
        ("speaker", "max = 1956", "max = 1957"),
        ("speaker", "pcm 48900", "pcm 48000"),
        ("speaker", "sound = \"pcm 48900\"\n", ""),
        ("lcd", "max = 65535", "max = 65534"),
        ("surroundings", "period = 100", "period = 101"),
        ("gesture", "lasts = 2100", "lasts = 2101"),
        ("gesture", "lasts = 2100\n", ""),
        ("posture", "of = \"joints\"", "of = \"lips\""),
        ("lips", "\"joints\", \"lips\"]", "\"joints\"]"),
        ("service-button", "kind = \"event\"", "kind = \"command\""),
    ] {
        let at = CUBO.find(&format!("name = \"{element}\"")).unwrap();
        let from = CUBO[at..].find(old).expect(old) + at;
        let text = format!("{}{new}{}", &CUBO[..from], &CUBO[from + old.len()..]);
        let changed = Model::read(&text).expect(new);
        assert_ne!(changed.hash(), base.hash(), "{new}");
        let digest = |model: &Model| model.find(element).unwrap().1.digest;
        assert_ne!(digest(&changed), digest(&base), "{new}");
    }
    // A name, and the order.
    let renamed = Model::read(&CUBO.replace("lips", "mouth")).unwrap();
    assert_ne!(renamed.hash(), base.hash());
    let first = CUBO.find("[[element]]").unwrap();
    let second = CUBO[first + 1..].find("[[element]]").unwrap() + first + 1;
    let third = CUBO[second + 1..].find("[[element]]").unwrap() + second + 1;
    let swapped = format!(
        "{}{}{}{}",
        &CUBO[..first],
        &CUBO[second..third],
        &CUBO[first..second],
        &CUBO[third..]
    );
    assert_ne!(Model::read(&swapped).unwrap().hash(), base.hash());
}

/// What a file may leave out is as good as written.
#[test]
fn defaults_count_as_if_they_were_written() {
    let short = "name = \"x\"\nid = 1\n[[element]]\nname = \"a\"\nkind = \"effector\"\ntype = \"i8\"\n";
    let long = "name = \"x\"\nid = 0x01\nperiod = 20\nlargest-packet = 1472\nwatchdog = 500\n[[element]]\nname = \"a\"\nkind = \"effector\"\ntype = \"i8\"\ncount = 1\nunit = \"\"\nscale = 1.0\nrange = [-128, 127.0]\nsafe = [-0.0]\nmotion = \"absolute\"\ninterpolate = false\n";
    assert_eq!(Model::read(long).unwrap(), Model::read(short).unwrap());
    // Once for all, or once for each.
    let once = "name = \"x\"\nid = 1\n[[element]]\nname = \"a\"\nkind = \"sensor\"\ntype = \"i8\"\ncount = 2\nunit = \"mm\"\n";
    let each = once.replace("\"mm\"", "[\"mm\", \"mm\"]");
    assert_eq!(Model::read(&each).unwrap(), Model::read(once).unwrap());
}
