//! What people read of what is generated: its Rust is formatted, and the page describes the packets of the model. `../typed` compiles the
//! Rust, and `c.rs` the header.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use mom_rsp_model::{Direction, Model, generate};

const MODELS: [(&str, &str); 4] = [
    ("cubo", include_str!("../../../config/cubo.toml")),
    ("ir-robot", include_str!("../../../config/ir-robot.toml")),
    ("kinds", include_str!("models/kinds.toml")),
    ("bare", include_str!("models/bare.toml")),
];

/// The boxes of a packet as the page draws them: offset, label, size; the last is the end of the packet, without a label.
fn boxes(page: &str, title: &str) -> Vec<(usize, String, usize)> {
    let (_, rest) = page
        .split_once(&format!("## {title}\n"))
        .expect("a packet of each direction");
    let (_, rest) = rest.split_once("```text\n").expect("a drawing");
    let (drawing, _) = rest.split_once("```").expect("its end");
    let mut boxes: Vec<(usize, String, usize)> = Vec::new();
    for line in drawing.lines() {
        if let Some((offset, _)) = line.split_once('+') {
            boxes.push((offset.trim().parse().expect("an offset"), String::new(), 0));
            continue;
        }
        let words = line.trim().trim_matches('|').trim();
        let (label, size) = words.rsplit_once(' ').expect("a label and a size");
        let last = boxes.last_mut().expect("an offset before each label");
        (last.1, last.2) = (label.trim().to_owned(), size.parse().expect("a size"));
    }
    boxes
}

#[test]
fn the_page_draws_each_packet_without_a_gap() {
    for (name, text) in MODELS {
        let model = Model::read(text).unwrap();
        let page = generate::markdown(&model);
        for (title, direction) in [
            ("To the robot", Direction::Down),
            ("From the robot", Direction::Up),
        ] {
            let boxes = boxes(&page, title);
            for pair in boxes.windows(2) {
                assert_eq!(pair[0].0 + pair[0].2, pair[1].0, "{name}, {title}: {pair:?}");
            }
            let sent: Vec<&str> = model
                .elements()
                .iter()
                .filter(|element| element.payload_size(direction) > 0)
                .map(|element| element.name.as_str())
                .collect();
            let drawn: Vec<&str> = boxes[2..boxes.len() - 1]
                .iter()
                .map(|(_, label, _)| label.split_once(" (").expect("what it is").0)
                .collect();
            assert_eq!(drawn, sent, "{name}, {title}");
            let end = boxes.last().expect("its end").0;
            assert_eq!(end, model.packet_size(direction), "{name}, {title}");
        }
        for (bit, element) in model.elements().iter().enumerate() {
            let row = format!("\n| {bit} | `{}` |", element.name);
            assert_eq!(page.matches(&row).count(), 1, "{name}: {row}");
        }
    }
}

/// S26: motion ends at byte 34, music at byte 1992.
#[test]
fn the_page_of_cubo_has_the_papers_sizes() {
    let page = generate::markdown(&Model::read(MODELS[0].1).unwrap());
    let boxes = boxes(&page, "To the robot");
    let offset = |label: &str| {
        boxes
            .iter()
            .find(|(_, found, _)| found == label)
            .map(|found| found.0)
    };
    assert_eq!(offset("speaker (length 2, bytes)"), Some(34));
    assert_eq!(offset("lcd (length 2; the bytes go in fragments)"), Some(1992));
    for line in [
        "| 2 | `joints` | effector | 3 × i16 | deg | -90 to 90 | 0.1 | 0 | `left-arm`: ",
        "| | | | | deg | -20 to 40 | 0.1 | 0 | `head-tilt` |",
        "Members: `left-wheel`, `right-wheel`, `joints`, `lips`.",
        "with everything in it has 1999 B, 99950 B a second at 20 ms.",
        "The bit alone says all of `surroundings`, `pose`, `microphone`, `camera`, `posture`, `motion`:",
    ] {
        assert!(page.contains(line), "{line} is not in\n{page}");
    }
}

/// Generated Rust is read by people: it is written as rustfmt would write it.
#[test]
fn generated_rust_is_formatted() {
    for (name, text) in MODELS.into_iter().take(2) {
        let made = generate::rust(&Model::read(text).unwrap());
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        let file = folder.join(format!("format-{name}.rs"));
        fs::write(&file, &made).unwrap();
        let formatted = Command::new("rustfmt")
            .args(["--edition", "2024", "--check", "--config-path", "/dev/null"])
            .arg(&file)
            .stdin(Stdio::null())
            .output()
            .expect("rustfmt comes with the toolchain");
        assert!(
            formatted.status.success(),
            "{}",
            String::from_utf8_lossy(&formatted.stdout)
        );
    }
}
