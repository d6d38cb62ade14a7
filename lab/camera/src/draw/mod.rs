//! Drawing, sorted by what is drawn: the still table, the shadows, the solids, and what is laid over them.

mod canvas;
mod overlay;
mod shadow;
mod solids;
mod table;
mod text;

pub(crate) use canvas::Canvas;
pub(crate) use overlay::{caption, overlays, trail};
pub(crate) use shadow::shadows;
pub(crate) use solids::solids;
pub(crate) use table::backdrop;
