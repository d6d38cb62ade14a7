//! The model server (M62): where the objects are, by what the cameras see, and since when that is known.
//!
//! [`ModelServer`] decides without a connection, a clock or threads; [`peer::run`] connects it to the hub. It takes the
//! cameras' images alone: what the arm's simulation knows of its blocks, nobody asks. A peer that joins the model's channel
//! gets all [`Object`]s and then their differences, and may ask; owners of tokens may write.
//!
//! [`verb`] has commands in terms of objects, `mom put red on blue`, which [`plan`] makes into moves.

mod look;
mod object;
mod objects;
mod owners;
pub mod peer;
pub mod plan;
pub mod program;
pub mod server;
pub mod verb;

pub use look::{Image, Look};
pub use object::Object;
pub use objects::Objects;
pub use peer::ModelOptions;
pub use server::{Kind, ModelServer, ServerOptions};
