//! The static background: the room, the arm's foot, the table with its grid and its scales.

use tiny_skia::{
    Color, GradientStop, LinearGradient, Paint, Point as SkiaPoint, Rect, SpreadMode, Transform,
};

use super::canvas::{Canvas, Ink, solid};
use super::solids::solids;
use super::text::text_height;
use crate::View;
use crate::geometry::{Direction, Point};
use crate::pan;
use crate::robot;
use crate::scene::Colour;
use crate::solid::Solid;

/// Half an edge of the table, mm.
pub(crate) const TABLE: f64 = 375.0;
/// Half an edge of the workspace, mm (M50).
const WORKSPACE: f64 = 300.0;
/// The height of the workspace, mm (M50).
const CEILING: f64 = 450.0;
/// From the camera that turns to the scale of its angles, mm.
const WALL: f64 = 4000.0;
/// Lower letters cannot be read, pixels.
const READABLE: f32 = 4.5;
/// Between two lines of the grid, mm.
const GRID: i32 = 50;

/// Lines and letters.
pub(crate) const INK: Ink = solid(52, 62, 80);
const TOP: Colour = Colour([240, 242, 245]);
const LINE: Ink = solid(150, 162, 180);
const X_AXIS: Ink = solid(196, 62, 58);
const Y_AXIS: Ink = solid(52, 140, 78);
const Z_AXIS: Ink = solid(52, 100, 190);

/// Draws everything behind the shadows and the solids.
pub(crate) fn backdrop(canvas: &mut Canvas<'_>, view: View) {
    room(canvas);
    if view == View::Pan {
        bearings(canvas);
    }
    // The table stands in front of the foot in every view of a camera above it.
    solids(canvas, &robot::foot());
    solids(canvas, &furniture());
    grid(canvas);
    axes(canvas);
    scales(canvas);
    match view {
        View::X => ruler(canvas, -WORKSPACE, WORKSPACE, Direction::y()),
        View::Y => ruler(canvas, WORKSPACE, WORKSPACE, Direction::x()),
        View::Pan => ruler(canvas, WORKSPACE, WORKSPACE, Direction::x()),
        View::Top | View::Wrist => {}
    }
}

/// A pale wall that darkens a little towards the floor.
fn room(canvas: &mut Canvas<'_>) {
    let (width, height) = (canvas.pixels.width() as f32, canvas.pixels.height() as f32);
    let stops = vec![
        GradientStop::new(0.0, Color::from_rgba8(226, 233, 241, 255)),
        GradientStop::new(0.45, Color::from_rgba8(208, 217, 228, 255)),
        GradientStop::new(1.0, Color::from_rgba8(172, 184, 199, 255)),
    ];
    let down = (SkiaPoint::from_xy(0.0, 0.0), SkiaPoint::from_xy(0.0, height));
    let shader = LinearGradient::new(down.0, down.1, stops, SpreadMode::Pad, Transform::identity());
    if let (Some(shader), Some(all)) = (shader, Rect::from_xywh(0.0, 0.0, width, height)) {
        let paint = Paint {
            shader,
            ..Paint::default()
        };
        canvas.pixels.fill_rect(all, &paint, Transform::identity(), None);
    }
}

/// The degrees to which the camera turns, on the wall around it: without them it would see nothing turn when it looks away.
fn bearings(canvas: &mut Canvas<'_>) {
    let lens = Point::from(pan::MOUNT);
    let at = |pan: i32, up: f64| {
        let foot = lens + pan::direction(f64::from(pan), 0.0) * WALL;
        foot + Direction::z() * up
    };
    let mut lines = Vec::new();
    for pan in (-180..180).step_by(5) {
        let tick = if pan % 10 == 0 { 120.0 } else { 60.0 };
        lines.push((at(pan, 0.0), at(pan + 5, 0.0)));
        lines.push((at(pan, 0.0), at(pan, tick)));
    }
    canvas.lines(&lines, LINE.at(0.7), 1.2);
    let step = canvas.unit() * 1.6;
    for pan in (-170..=180).step_by(10).filter(|_| text_height(step) >= READABLE) {
        if let Some(pixel) = canvas.pixel(&at(pan, 200.0)) {
            canvas.text_around(&format!("{pan}°"), pixel, step, INK.at(0.6));
        }
    }
}

/// The table's top and legs.
fn furniture() -> Vec<Solid> {
    let half = |x: f64, y: f64, z: f64| [Direction::x() * x, Direction::y() * y, Direction::z() * z];
    let wood = Colour([196, 203, 213]);
    let leg_height = (-36.0 - robot::FLOOR) / 2.0;
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
    let leg = |(a, b): (f64, f64)| {
        let middle = Point::new(a * (TABLE - 40.0), b * (TABLE - 40.0), robot::FLOOR + leg_height);
        Solid::cuboid(middle, half(22.0, 22.0, leg_height), wood)
    };
    let mut solids: Vec<Solid> = corners.into_iter().map(leg).collect();
    solids.push(Solid::cuboid(
        Point::new(0.0, 0.0, -18.0),
        half(TABLE, TABLE, 18.0),
        TOP,
    ));
    solids
}

/// Fine lines every 50 mm, stronger ones every 100 mm and the border of the workspace.
fn grid(canvas: &mut Canvas<'_>) {
    let across = |at: f64| {
        [
            (Point::new(at, -WORKSPACE, 0.0), Point::new(at, WORKSPACE, 0.0)),
            (Point::new(-WORKSPACE, at, 0.0), Point::new(WORKSPACE, at, 0.0)),
        ]
    };
    let steps = WORKSPACE as i32 / GRID;
    let (strong, fine): (Vec<i32>, Vec<i32>) = (1 - steps..steps).partition(|i| i % 2 == 0);
    let lines = |at: Vec<i32>| -> Vec<(Point, Point)> {
        at.into_iter().flat_map(|i| across(f64::from(i * GRID))).collect()
    };
    canvas.lines(&lines(fine), LINE.at(0.35), 0.8);
    canvas.lines(&lines(strong), LINE.at(0.75), 1.0);
    let border: Vec<(Point, Point)> = [-WORKSPACE, WORKSPACE].into_iter().flat_map(across).collect();
    canvas.lines(&border, INK.at(0.7), 1.6);
}

/// The two axes of the table from its middle, with arrow heads and names.
fn axes(canvas: &mut Canvas<'_>) {
    let origin = Point::origin();
    for (name, along, across, ink) in [
        ("x", Direction::x(), Direction::y(), X_AXIS),
        ("y", Direction::y(), Direction::x(), Y_AXIS),
    ] {
        let tip = origin + along * 100.0;
        canvas.lines(&[(origin, tip - along * 16.0)], ink, 2.4);
        canvas.fill(
            &[
                tip,
                tip - along * 20.0 + across * 7.0,
                tip - along * 20.0 - across * 7.0,
            ],
            ink,
        );
        label(canvas, &(tip + along * 18.0), name, ink);
    }
}

/// The millimetres along two edges of the workspace, which are in front or at the side in every fixed view.
fn scales(canvas: &mut Canvas<'_>) {
    let edge = WORKSPACE;
    let mut ticks = Vec::new();
    for at in (-3..=3).map(|i| i * 100) {
        let v = f64::from(at);
        ticks.push((Point::new(v, -edge, 0.0), Point::new(v, -edge - 10.0, 0.0)));
        ticks.push((Point::new(edge, v, 0.0), Point::new(edge + 10.0, v, 0.0)));
        label(canvas, &Point::new(v, -edge - 32.0, 0.0), &at.to_string(), INK);
        label(canvas, &Point::new(edge + 34.0, v, 0.0), &at.to_string(), INK);
    }
    canvas.lines(&ticks, INK.at(0.8), 1.2);
}

/// The millimetres above the table at one corner of the workspace, with the ticks pointing `outwards`.
fn ruler(canvas: &mut Canvas<'_>, x: f64, y: f64, outwards: Direction) {
    let at = |z: f64| Point::new(x, y, z);
    let mut lines = vec![(at(0.0), at(CEILING))];
    for z in (0..=450).step_by(50).map(f64::from) {
        let long = z % 100.0 == 0.0;
        lines.push((at(z), at(z) + outwards * if long { 14.0 } else { 8.0 }));
        if long && z > 0.0 {
            label(canvas, &(at(z) + outwards * 42.0), &format!("{z:.0}"), Z_AXIS);
        }
    }
    canvas.lines(&lines, Z_AXIS.at(0.85), 1.5);
    label(canvas, &at(CEILING + 26.0), "z", Z_AXIS);
}

/// Letters around a point of the world, if they would be large enough to be read.
fn label(canvas: &mut Canvas<'_>, at: &Point, text: &str, ink: Ink) {
    let scale = canvas.camera.scale_at(at) as f32;
    let step = (scale * 2.2).min(canvas.unit() * 1.6);
    if text_height(step) < READABLE {
        return;
    }
    if let Some(pixel) = canvas.pixel(at) {
        canvas.text_around(text, pixel, step, ink);
    }
}
