//! Sequence charts, as the paper's figure 7: time runs down, the middle is to the left and the robot to the right.

use std::fmt::Write as _;

use super::MS;
use super::caller::{Arrow, Told};

/// Of one chart: between its two lines, and to the next chart.
const WIDE: f64 = 150.0;
const APART: f64 = 290.0;
const COLUMNS: usize = 3;
const LEFT: f64 = 60.0;
/// Above the lines, and from one row of charts to the next.
const TOP: f64 = 90.0;
/// Units for each ms, and the ms that are shown after the call.
const SCALE: f64 = 1.0;
const SHOWN: u64 = 400;

const CALL: &str = "#0083cc";
const ACK: &str = "#009e73";
const GREY: &str = "#8c959f";
const LOST: &str = "#d55e00";

/// The file with a chart for each.
pub(super) fn draw(charts: &[(String, Told)]) -> String {
    let row = TOP + SHOWN as f64 * SCALE;
    let height = 20.0 + row * charts.len().div_ceil(COLUMNS) as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 900 {height}\" font-family=\"sans-serif\" font-size=\"11\">\n<style>\n\
         .ground {{ fill: #ffffff }} text {{ fill: #1f2328 }} .life {{ stroke: #57606a }}\n\
         @media (prefers-color-scheme: dark) {{\n.ground {{ fill: #0d1117 }} text {{ fill: #e6edf3 }} .life {{ stroke: #9198a1 }}\n}}\n</style>\n\
         <rect class=\"ground\" width=\"100%\" height=\"100%\"/>\n"
    );
    for (number, (title, told)) in charts.iter().enumerate() {
        let x = LEFT + APART * (number % COLUMNS) as f64;
        let y = TOP + row * (number / COLUMNS) as f64;
        chart(&mut svg, title, told, x, y);
    }
    svg + "</svg>\n"
}

fn chart(svg: &mut String, title: &str, told: &Told, x: f64, y: f64) {
    let right = x + WIDE;
    let end = y + SHOWN as f64 * SCALE;
    let at = |time: u64| y + time.min(SHOWN * MS) as f64 / MS as f64 * SCALE;
    // Writing to a String cannot fail.
    let _ = writeln!(
        svg,
        "<text x=\"{x}\" y=\"{:.0}\" font-size=\"14\">{title}</text>\n\
         <text x=\"{x}\" y=\"{:.0}\" text-anchor=\"middle\">middle</text><text x=\"{right}\" y=\"{:.0}\" text-anchor=\"middle\">robot</text>",
        y - 42.0,
        y - 8.0,
        y - 8.0,
    );
    for life in [x, right] {
        let _ = writeln!(
            svg,
            "<line class=\"life\" x1=\"{life}\" y1=\"{y}\" x2=\"{life}\" y2=\"{end}\"/>"
        );
    }
    for time in (0..=SHOWN).step_by(40) {
        let _ = writeln!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{time} ms</text>",
            x - 8.0,
            at(time * MS) + 4.0
        );
    }
    // Those that say something go over the others.
    let mut arrows: Vec<&Arrow> = told
        .arrows
        .iter()
        .filter(|arrow| arrow.sent < SHOWN * MS)
        .collect();
    arrows.sort_by_key(|arrow| !arrow.label.is_empty());
    for arrow in arrows {
        draw_arrow(svg, arrow, [x, right], at);
    }
    let is_command = told
        .arrows
        .iter()
        .any(|arrow| arrow.down && arrow.label.starts_with("call"));
    for time in told.executed.iter().filter(|time| **time < SHOWN * MS) {
        // A command is carried out at the robot, an event is delivered at the middle.
        let side = if is_command { right } else { x };
        let _ = writeln!(
            svg,
            "<circle cx=\"{side}\" cy=\"{:.1}\" r=\"5\" fill=\"{CALL}\"><title>carried out</title></circle>",
            at(*time)
        );
    }
    if let Some((time, word)) = told.over.filter(|(time, _)| *time < SHOWN * MS) {
        // The one who called is told.
        let _ = writeln!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.1}\">{}</text><text x=\"{:.0}\" y=\"{:.1}\">{word}</text>",
            right + 10.0,
            at(time),
            if is_command {
                "at the middle:"
            } else {
                "at the robot:"
            },
            right + 10.0,
            at(time) + 13.0,
        );
    }
}

fn draw_arrow(svg: &mut String, arrow: &Arrow, [left, right]: [f64; 2], at: impl Fn(u64) -> f64) {
    let (from, to) = if arrow.down { (left, right) } else { (right, left) };
    let (is_said, is_ack) = (!arrow.label.is_empty(), !arrow.label.starts_with("call"));
    let colour = match (arrow.lost, is_said, is_ack) {
        (true, ..) => LOST,
        (_, false, _) => GREY,
        (_, _, true) => ACK,
        _ => CALL,
    };
    // One that is lost, or does not arrive here, ends half way.
    let part = if arrow.lost { 0.5 } else { 1.0 };
    let arrives = arrow.arrived.unwrap_or(arrow.sent + 20 * MS);
    let (y1, y2) = (at(arrow.sent), at(arrives));
    let (x2, y2) = (from + (to - from) * part, y1 + (y2 - y1) * part);
    let (width, opacity) = if is_said { (1.8, 1.0) } else { (0.8, 0.5) };
    let _ = writeln!(
        svg,
        "<line x1=\"{from}\" y1=\"{y1:.1}\" x2=\"{x2}\" y2=\"{y2:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\" opacity=\"{opacity}\"/>"
    );
    if arrow.lost {
        let _ = writeln!(
            svg,
            "<text x=\"{x2}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"15\" style=\"fill: {LOST}\">×</text>",
            y2 + 5.0
        );
    } else if is_said {
        let back = if arrow.down { x2 - 7.0 } else { x2 + 7.0 };
        let _ = writeln!(
            svg,
            "<path d=\"M{x2} {y2:.1}L{back} {:.1}L{back} {:.1}Z\" fill=\"{colour}\"/>",
            y2 - 4.5,
            y2 + 2.5
        );
    }
    if is_said {
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" style=\"fill: {colour}\">{}</text>",
            from + (to - from) * 0.25,
            y1 + (y2 - y1) * 0.25 / part - 4.0,
            arrow.label
        );
    }
}
