//! CUBO, the robot of the third paper (S25): thin, so that it plans nothing by itself (S1), and mirrored over RSP.
//!
//! [`model`] is generated from `config/cubo.toml`; with the feature `opus` its loudspeaker takes Opus instead of
//! samples. [`Cubo`] is its body, here a simulated one; [`serve`] connects both to a socket.

mod body;
mod page;
pub mod program;
mod serve;

pub use body::{Cubo, Doings, Glance, Touch};
pub use page::serve_page;
pub use serve::{CuboHandle, serve};

/// The model's file, for the middle.
pub const MODEL: &str = include_str!(concat!(env!("OUT_DIR"), "/cubo.toml"));

/// Both ends of the model, generated.
#[allow(
    dead_code,
    reason = "the middle's half is for programs that are built for this robot alone"
)]
pub mod model {
    include!(concat!(env!("OUT_DIR"), "/cubo.rs"));
}

/// Buffers for spoken messages that the middle has not got yet (S16).
const BUFFERS: usize = 8;

/// The robot's end.
pub type End = model::robot::Robot<BUFFERS>;
