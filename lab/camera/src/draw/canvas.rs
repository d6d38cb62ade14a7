//! A picture being drawn: polygons, lines and dots in the world, through the camera, onto the pixels.

use tiny_skia::{FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};

use crate::Camera;
use crate::geometry::{Pixel, Point};
use crate::scene::Colour;

/// A colour with its opacity, 0 to 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ink {
    pub(crate) colour: Colour,
    pub(crate) opacity: f32,
}

/// Ink that covers.
pub(crate) const fn solid(red: u8, green: u8, blue: u8) -> Ink {
    Ink {
        colour: Colour([red, green, blue]),
        opacity: 1.0,
    }
}

impl Ink {
    /// The same ink at another opacity, 0 to 1.
    pub(crate) const fn at(self, opacity: f32) -> Ink {
        Ink { opacity, ..self }
    }

    /// The ink in more or less light: 1 leaves it as it is.
    pub(crate) fn lit(self, light: f64) -> Ink {
        let channel = |c: u8| (f64::from(c) * light).round().clamp(0.0, 255.0) as u8;
        Ink {
            colour: Colour(self.colour.0.map(channel)),
            ..self
        }
    }

    fn paint(self) -> Paint<'static> {
        let [red, green, blue] = self.colour.0;
        let mut paint = Paint::default();
        paint.set_color_rgba8(
            red,
            green,
            blue,
            (self.opacity.clamp(0.0, 1.0) * 255.0).round() as u8,
        );
        paint
    }
}

/// The pixels and the camera through which the world falls on them.
pub(crate) struct Canvas<'a> {
    pub(crate) pixels: &'a mut Pixmap,
    pub(crate) camera: &'a Camera,
}

impl Canvas<'_> {
    /// The unit of widths and letters, pixels: 1 for an image of 640×480.
    pub(crate) fn unit(&self) -> f32 {
        (self.pixels.width() as f32 / 640.0).min(self.pixels.height() as f32 / 480.0)
    }

    /// A width in units as pixels, never so thin that the line breaks up.
    pub(crate) fn width(&self, units: f32) -> f32 {
        (self.unit() * units).max(0.6)
    }

    /// Fills a polygon of the world.
    pub(crate) fn fill(&mut self, points: &[Point], ink: Ink) {
        self.fill_all(&[points.to_vec()], ink);
    }

    /// Fills several polygons as one, so that they do not darken each other where they overlap.
    ///
    /// All must run in the same direction.
    pub(crate) fn fill_all(&mut self, polygons: &[Vec<Point>], ink: Ink) {
        let mut path = PathBuilder::new();
        for polygon in polygons {
            push_polygon(&mut path, &self.camera.polygon(polygon));
        }
        self.fill_path(path.finish(), ink);
    }

    /// Fills a polygon and draws a line around it; `width` in units.
    pub(crate) fn fill_with_edge(&mut self, points: &[Point], ink: Ink, edge: Ink, width: f32) {
        let mut path = PathBuilder::new();
        push_polygon(&mut path, &self.camera.polygon(points));
        let Some(path) = path.finish() else { return };
        self.stroke_path(Some(path.clone()), edge, self.width(width));
        self.fill_path(Some(path), ink);
    }

    /// Draws lines of the world with one ink; `width` in units.
    pub(crate) fn lines(&mut self, lines: &[(Point, Point)], ink: Ink, width: f32) {
        let mut path = PathBuilder::new();
        for (from, to) in lines {
            if let Some((a, b)) = self.camera.line(from, to) {
                path.move_to(a.0, a.1);
                path.line_to(b.0, b.1);
            }
        }
        self.stroke_path(path.finish(), ink, self.width(width));
    }

    /// A dot over a point of the world; `radius` in units.
    pub(crate) fn dot(&mut self, point: &Point, radius: f32, ink: Ink) {
        if let Some((x, y)) = self.pixel(point) {
            let path = PathBuilder::from_circle(x, y, self.width(radius));
            self.fill_path(path, ink);
        }
    }

    /// The pixel of a point if it is in the image or close to it.
    pub(crate) fn pixel(&self, point: &Point) -> Option<Pixel> {
        self.camera.line(point, point).map(|(pixel, _)| pixel)
    }

    /// Fills a path in pixels.
    pub(crate) fn fill_path(&mut self, path: Option<Path>, ink: Ink) {
        if let Some(path) = path {
            self.pixels.fill_path(
                &path,
                &ink.paint(),
                FillRule::Winding,
                Transform::identity(),
                None,
            );
        }
    }

    /// Draws a path in pixels; `width` in pixels.
    pub(crate) fn stroke_path(&mut self, path: Option<Path>, ink: Ink, width: f32) {
        if let Some(path) = path {
            let stroke = Stroke {
                width,
                line_cap: LineCap::Round,
                line_join: LineJoin::Round,
                ..Stroke::default()
            };
            self.pixels
                .stroke_path(&path, &ink.paint(), &stroke, Transform::identity(), None);
        }
    }
}

fn push_polygon(path: &mut PathBuilder, polygon: &[Pixel]) {
    for (i, (x, y)) in polygon.iter().enumerate() {
        if i == 0 {
            path.move_to(*x, *y);
        } else {
            path.line_to(*x, *y);
        }
    }
    if !polygon.is_empty() {
        path.close();
    }
}
