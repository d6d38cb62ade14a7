//! One connection.

use crate::{Privacy, Reader, Writer};

/// One connection in two halves.
#[derive(Debug)]
pub struct Transceiver {
    /// Gives frames.
    pub reader: Reader,
    /// Takes parcels.
    pub writer: Writer,
    /// Who could have read along, and who is at the other side.
    pub privacy: Privacy,
}
