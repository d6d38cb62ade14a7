//! Solids in flat shades, the farthest first.

use super::canvas::{Canvas, Ink};
use crate::geometry::Direction;
use crate::solid::{Solid, painting_order};

/// The direction of the light; its height leaves the colour of a top as it is and gives each side its own shade.
const LIGHT: [f64; 3] = [0.6, -0.3, 1.0];

/// Paints solids so that what is in front covers what is behind.
pub(crate) fn solids(canvas: &mut Canvas<'_>, solids: &[Solid]) {
    for i in painting_order(solids, canvas.camera) {
        paint(canvas, &solids[i]);
    }
}

fn paint(canvas: &mut Canvas<'_>, solid: &Solid) {
    let base = Ink {
        colour: solid.colour,
        opacity: 1.0,
    };
    if let Some(ball) = solid.ball {
        let outline = ball.outline(canvas.camera.position());
        canvas.fill(&outline, base);
        return;
    }
    for face in solid
        .faces
        .iter()
        .filter(|face| solid.faces_eye(face, canvas.camera.position()))
    {
        let shade = base.lit(light_on(&face.normal));
        // A round side gets an edge of its own colour, or the seams between its strips would shine through.
        let edge = if solid.round && !face.cap {
            shade
        } else {
            shade.lit(0.78)
        };
        canvas.fill_with_edge(&solid.outline(face), shade, edge, 1.2);
    }
}

/// How bright a face is: 1 for a top, less for what is turned away from the light.
fn light_on(normal: &Direction) -> f64 {
    let towards = normal.dot(&Direction::from(LIGHT));
    0.62 + 0.38 * ((towards + 0.5) / 1.5).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sides_of_a_box_have_three_shades() {
        let (top, right, front) = (
            light_on(&Direction::z()),
            light_on(&Direction::x()),
            light_on(&-Direction::y()),
        );
        assert_eq!(top, 1.0);
        assert!(top > right + 0.06 && right > front + 0.06 && front > light_on(&-Direction::z()) + 0.06);
    }
}
