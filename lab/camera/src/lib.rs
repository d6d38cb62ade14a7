//! The camera of the demonstration lab: it renders the robot's workspace as five cameras see it.
//!
//! The workspace is a box of 600×600×450 mm on a table (M50), with an industrial arm beside it (M49). [`Renderer`]
//! draws a [`Scene`], which is read from the arm's state, and gives a JPEG or PNG [`Image`] with the matrix that maps
//! millimetres on the table to its pixels (M54, M55).
//!
//! [`ImageServer`] decides how the camera reacts to the parcels and events of its contexts; [`peer::run`] connects it
//! to the hub and draws on a thread of its own, in a program (`mom-camera`) or in another one.
//!
//! One of them turns and tilts by commands of the owner of its own token: [`pan`].
//!
//! A camera may also be a real one: [`source`] takes its pictures from a URL, and they go the same way as drawn ones.

mod calibration;
mod draw;
mod encode;
mod error;
mod geometry;
mod overlay;
mod owner;
pub mod pan;
pub mod peer;
mod predicted;
pub mod program;
mod renderer;
mod robot;
mod scene;
pub mod server;
mod settings;
mod shot;
mod solid;
pub mod source;
mod trail;
mod view;

pub use calibration::Calibration;
pub use error::SettingsError;
pub use geometry::Camera;
pub use overlay::Overlay;
pub use peer::CameraOptions;
pub use predicted::PosePredictor;
pub use renderer::{Image, Renderer};
pub use robot::{MARKER, MARKER_COLOUR, MARKER_RADIUS};
pub use scene::{Colour, DrawnBlock, DrawnGripper, DrawnPose, Scene};
pub use server::{ImageServer, ServerOptions};
pub use settings::{CameraSettings, Format, HEIGHTS, QUALITIES, SettingsChange, WIDTHS};
pub use shot::{Picture, Shot};
pub use source::{BadUrl, Rendition, Source, SourceUrl};
pub use view::View;
