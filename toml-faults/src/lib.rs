//! TOML files read key by key, so that each fault names its line, its column, what is expected, and the nearest known word.
//!
//! A file is a [`Section`]: the reader of a format says which keys it knows, and takes their values with [`At::text`],
//! [`At::integer`] and their like. These fail with a [`Misfit`], which is of a [`Shape`] that every format has. What a
//! format finds itself is a [`Found`] of its own kinds, and `?` makes the first the second. With the text it becomes a
//! [`FileError`].
//!
//! ```
//! use mom_toml_faults::{FileError, Found, Section, Shape};
//!
//! #[derive(Clone, Copy, Debug, PartialEq)]
//! enum Fault {
//!     Shape(Shape),
//!     NoPort,
//! }
//!
//! impl From<Shape> for Fault {
//!     fn from(shape: Shape) -> Fault {
//!         Fault::Shape(shape)
//!     }
//! }
//!
//! fn port(text: &str) -> Result<u16, FileError<Fault>> {
//!     let read = || {
//!         let root = Section::parse(text)?;
//!         root.only(&["port", "host"])?;
//!         let port = root.required("port")?;
//!         u16::try_from(port.integer()?).map_err(|_| Found::new(Fault::NoPort, &port.span, "a port is 0 to 65535"))
//!     };
//!     read().map_err(|found: Found<Fault>| found.at(text))
//! }
//!
//! assert_eq!(port("port = 4000"), Ok(4000));
//! for (text, said) in [
//!     ("port = 70000", "line 1, column 8: a port is 0 to 65535"),
//!     ("host = 1\nprot = 4000", "line 2, column 1: there is no key `prot`; did you mean `port`?"),
//!     ("port = '4000'", "line 1, column 8: expected an integer, found a text"),
//!     ("", "line 1, column 1: `port` is missing"),
//! ] {
//!     assert_eq!(port(text).unwrap_err().to_string(), said);
//! }
//! ```

mod fault;
mod section;
mod words;

pub use fault::{FileError, Found, Misfit, Shape, Spot};
pub use section::{At, Item, Section};
pub use words::{hint, nearest, quoted, unknown};
