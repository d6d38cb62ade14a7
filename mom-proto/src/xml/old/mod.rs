//! The reader before quick-xml, to compare with.

use super::{multipart, name, text};

mod lexeme;
pub(super) mod read;
