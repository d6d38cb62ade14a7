//! What the robot's page and its `/status.json` say.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::Glance;

/// The switches and LEDs, as bits of their masks.
const SWITCHES: [&str; 4] = ["front left", "front right", "rear left", "rear right"];
const LEDS: u8 = 8;

const STYLE: &str = "body{font:16px sans-serif;margin:1em}th{text-align:left;padding-right:1em}img{image-rendering:pixelated}";

/// The state as JSON: lengths in mm, degrees, percent, motors in per mille, and masks as the wire has them.
pub(crate) fn json(unit: u32, glance: &Glance) -> Value {
    let status = &glance.status;
    json!({
        "unit": unit,
        "x": glance.pose.map(|pose| pose.x),
        "y": glance.pose.map(|pose| pose.y),
        "heading": glance.pose.map(|pose| pose.heading),
        "left": glance.motors.left(),
        "right": glance.motors.right(),
        "moving": status.moving,
        "battery": status.battery,
        "charging": status.charging,
        "switches": status.switches,
        "leds": glance.leds,
        "expired": status.expired,
        "on-its-way": status.on_its_way,
        "gave-up": status.gave_up,
        "station": glance.station.map(|station| station.to_string()),
    })
}

/// The page, which gets itself again once a second.
pub(crate) fn html(unit: u32, glance: &Glance, has_camera: bool) -> String {
    let title = escaped(&format!("Robot {unit}"));
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta http-equiv=\"refresh\" content=\"1\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n\
         <body>\n<h1>{title}</h1>\n"
    );
    if has_camera {
        page.push_str("<img src=\"/camera.jpg\" width=\"320\" height=\"240\" alt=\"what the robot sees\">\n");
    }
    page.push_str("<table>\n");
    for (name, value) in rows(glance) {
        // Writing to a string does not fail.
        let _ = writeln!(page, "<tr><th>{name}</th><td>{}</td></tr>", escaped(&value));
    }
    page.push_str("</table>\n<p><a href=\"/status.json\">as JSON</a></p>\n</body>\n</html>\n");
    page
}

fn rows(glance: &Glance) -> [(&'static str, String); 7] {
    let status = &glance.status;
    let flags = [
        (status.moving, "moving"),
        (status.on_its_way, "on its way to a point"),
        (status.gave_up, "gave its way up"),
        (status.expired, "stopped by its watchdog"),
    ];
    let said: Vec<&str> = flags
        .iter()
        .filter_map(|(set, word)| set.then_some(*word))
        .collect();
    [
        (
            "pose",
            glance
                .pose
                .map_or("not known".to_owned(), |pose| pose.to_string()),
        ),
        ("motors", format!("{} per mille", glance.motors)),
        ("state", or(said.join(", "), "standing")),
        (
            "battery",
            format!(
                "{} %{}",
                status.battery,
                if status.charging { ", charging" } else { "" }
            ),
        ),
        ("switches", or(pressed(status.switches), "none is pressed")),
        ("LEDs", lit(glance.leds)),
        (
            "driven by",
            glance
                .station
                .map_or("nobody".to_owned(), |station| station.to_string()),
        ),
    ]
}

fn or(text: String, none: &str) -> String {
    if text.is_empty() { none.to_owned() } else { text }
}

fn pressed(switches: u8) -> String {
    let pressed = (0..).zip(SWITCHES).filter(|(bit, _)| switches >> bit & 1 == 1);
    pressed.map(|(_, name)| name).collect::<Vec<_>>().join(", ")
}

/// The LEDs, number 7 first, as bits are written.
fn lit(leds: u8) -> String {
    let lit = (0..LEDS)
        .rev()
        .map(|bit| if leds >> bit & 1 == 1 { '●' } else { '○' });
    lit.collect()
}

fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            other => escaped.push(other),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use mom_wheels::{Motors, Pose, switch};

    use super::*;
    use crate::Status;

    #[test]
    fn the_page_has_all_that_the_robot_knows() {
        let glance = Glance {
            pose: Some(Pose::new(1234.4, 500.0, 90.0)),
            motors: Motors::new(300, -300),
            leds: 0b101,
            status: Status {
                switches: switch::FRONT_LEFT | switch::REAR_RIGHT,
                moving: true,
                battery: 81,
                charging: true,
                ..Status::default()
            },
            station: Some("192.168.1.5:50000".parse().expect("an address")),
        };
        let page = html(7, &glance, true);
        for part in [
            "<title>Robot 7</title>",
            "http-equiv=\"refresh\" content=\"1\"",
            "src=\"/camera.jpg\"",
            "<td>1234 mm, 500 mm, 90°</td>",
            "<td>300 -300 per mille</td>",
            "<td>moving</td>",
            "<td>81 %, charging</td>",
            "<td>front left, rear right</td>",
            "<td>○○○○○●○●</td>",
            "<td>192.168.1.5:50000</td>",
        ] {
            assert!(page.contains(part), "{part} in\n{page}");
        }
        assert!(!html(7, &glance, false).contains("camera.jpg"));
        let glance = Glance {
            pose: None,
            motors: Motors::STOP,
            leds: 0,
            status: Status::default(),
            station: None,
        };
        let page = html(1, &glance, true);
        for part in ["not known", "standing", "none is pressed", "nobody"] {
            assert!(page.contains(&format!("<td>{part}</td>")), "{part} in\n{page}");
        }
        assert_eq!(json(1, &glance)["x"], Value::Null);
    }

    #[test]
    fn nothing_of_a_text_is_markup() {
        assert_eq!(
            escaped("<a href=\"x\">'&"),
            "&lt;a href=&quot;x&quot;&gt;&#39;&amp;"
        );
    }
}
