//! What is drawn into the picture where it is asked for: the pose, the path with its last poses (M44), the blocks'
//! outlines and a line of numbers.

use tiny_skia::Rect;

use super::canvas::{Canvas, Ink, solid};
use super::text::{text_height, text_width};
use crate::geometry::Point;
use crate::overlay::PREDICTED;
use crate::scene::{DrawnGripper, DrawnPose};
use crate::{Overlay, Scene, View};

const PATH: Ink = solid(0, 128, 140);
/// Where the gripper is by now.
const AHEAD: Ink = solid(206, 44, 120);
const HALO: Ink = solid(255, 255, 255);
const BAR: Ink = solid(24, 31, 44);
const LETTERS: Ink = solid(236, 240, 246);
/// Letters lower than this cannot be read, pixels.
const READABLE: f32 = 4.5;

/// Draws the lines of the pose and of the blocks; the path is drawn by [`trail`].
pub(crate) fn overlays(canvas: &mut Canvas<'_>, overlays: &[Overlay]) {
    for overlay in overlays.iter().filter(|overlay| overlay.name != "path") {
        let lines: Vec<(Point, Point)> = overlay
            .points
            .windows(2)
            .map(|pair| (Point::from(pair[0]), Point::from(pair[1])))
            .collect();
        let (ink, width) = match overlay.name.as_str() {
            PREDICTED => (AHEAD, 2.0),
            _ => (PATH, 1.2),
        };
        canvas.lines(&lines, ink, width);
    }
}

/// Draws the path over everything, fading towards its beginning, with a dot at each pose.
pub(crate) fn trail(canvas: &mut Canvas<'_>, trail: &[DrawnPose]) {
    let points: Vec<Point> = trail
        .iter()
        .map(|pose| Point::new(pose.x, pose.y, pose.z))
        .collect();
    let whole: Vec<(Point, Point)> = points.windows(2).map(|pair| (pair[0], pair[1])).collect();
    canvas.lines(&whole, HALO.at(0.45), 4.6);
    let age = |i: usize| 0.35 + 0.65 * (i + 1) as f32 / points.len() as f32;
    for (i, line) in whole.iter().enumerate() {
        canvas.lines(&[*line], PATH.at(age(i + 1)), 2.0);
    }
    for (i, point) in points.iter().enumerate() {
        let radius = if i + 1 == points.len() { 4.2 } else { 2.8 };
        canvas.dot(point, radius + 1.2, HALO.at(0.8 * age(i)));
        canvas.dot(point, radius, PATH.at(age(i)));
    }
}

/// Writes the view's name, the pose and the gripper under the picture, if the image is wide enough to read them.
pub(crate) fn caption(canvas: &mut Canvas<'_>, view: View, scene: &Scene) {
    let (width, height) = (canvas.pixels.width() as f32, canvas.pixels.height() as f32);
    let (left, right) = (format!("{view} camera"), numbers(&scene.pose, &scene.gripper));
    let step = (width / 400.0).min(height / 300.0);
    let letters = text_height(step);
    if letters < READABLE {
        return;
    }
    let bar = letters * 2.2;
    if let Some(rect) = Rect::from_xywh(0.0, height - bar, width, bar) {
        canvas.fill_path(Some(tiny_skia::PathBuilder::from_rect(rect)), BAR.at(0.82));
    }
    let top = height - (bar + letters) / 2.0;
    let margin = letters * 0.9;
    canvas.text(&left, (margin, top), step, LETTERS);
    let start = (width - margin - text_width(&right, step)).max(margin + text_width(&left, step) + margin);
    canvas.text(&right, (start, top), step, LETTERS);
}

fn numbers(pose: &DrawnPose, gripper: &DrawnGripper) -> String {
    format!(
        "x {:.0}  y {:.0}  z {:.0} mm  spin {:.0}°  tilt {:.0}°  grip {:.0}",
        // Adding 0 turns the -0 that rounding leaves into 0.
        pose.x.round() + 0.0,
        pose.y.round() + 0.0,
        pose.z.round() + 0.0,
        pose.spin.round() + 0.0,
        pose.tilt.round() + 0.0,
        gripper.opening
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_are_those_of_the_pose() {
        let pose = DrawnPose {
            x: 120.4,
            y: -40.6,
            z: -0.2,
            spin: 30.0,
            tilt: 0.0,
        };
        let text = numbers(&pose, &DrawnGripper { opening: 40.0 });
        assert_eq!(text, "x 120  y -41  z 0 mm  spin 30°  tilt 0°  grip 40");
    }
}
