//! Models of robots (S4 to S6), and what is made of them.
//!
//! A model is a TOML file; [`Model::read`] reads and checks it, and what is wrong is a [`ModelError`] with line and column, of
//! which [`Model::faults`] gives all.
//! The packets of `mom-rsp` need its [`Layout`](mom_rsp::Layout), whose hash both ends must have alike.
//!
//! ```
//! use mom_rsp_model::Model;
//!
//! let model = Model::read(
//!     r#"
//!     name = "cart"
//!     id = 7
//!
//!     [[element]]
//!     name = "wheel"
//!     kind = "effector"
//!     type = "i16"
//!     unit = "mm/s"
//!     range = [-500, 500]
//!     "#,
//! )?;
//! let elements = model.wire_elements();
//! let layout = model.layout(&elements);
//! assert_eq!((layout.id(), layout.elements()[0].payload.size()), (7, 2));
//!
//! let error = Model::read("name = \"cart\"\nid = 7\nperoid = 20\n").unwrap_err();
//! assert_eq!(error.to_string(), "line 3, column 1: there is no key `peroid`; did you mean `period`?");
//! # Ok::<(), mom_rsp_model::ModelError>(())
//! ```

pub mod build;
mod canonical;
mod check;
mod export;
mod fault;
mod faults;
pub mod generate;
mod keys;
mod model;
mod quantities;
mod read;
mod text;
#[cfg(feature = "verb")]
pub mod verb;
mod xmi;

pub use fault::{Fault, ModelError};
pub use model::{
    Direction, HEADER, HIGHEST_PACKET, LONGEST_NAME, MOST_ELEMENTS, Model, ModelElement, Quantity, TAG,
};
