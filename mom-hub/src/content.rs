//! Reading what stands in the content of requests.

use mom_proto::{Code, Micros, Parcel, Path, WireError};
use serde::de::DeserializeOwned;

/// The content of a request that needs some.
pub(crate) fn read<T: DeserializeOwned>(parcel: &Parcel) -> Result<T, WireError> {
    match &parcel.content {
        Some(content) => content.read(),
        None => {
            Err(WireError::new(Code::BAD_CONTENT, format!("{} needs content", parcel.name())).slot("content"))
        }
    }
}

/// The content of a request that may have none.
pub(crate) fn read_or_default<T: DeserializeOwned + Default>(parcel: &Parcel) -> Result<T, WireError> {
    match &parcel.content {
        Some(_) => read(parcel),
        None => Ok(T::default()),
    }
}

/// A path inside content.
pub(crate) fn path(text: &str, slot: &str) -> Result<Path, WireError> {
    Path::parse(text).map_err(|error| error.slot(&format!("content/{slot}")))
}

/// An error about a member of the content.
pub(crate) fn bad(slot: &str, text: String) -> WireError {
    WireError::new(Code::BAD_CONTENT, text).slot(&format!("content/{slot}"))
}

/// A duration in ms as µs, from 1 ms on.
pub(crate) fn micros(millis: u64, slot: &str) -> Result<Micros, WireError> {
    let micros = millis.checked_mul(1000);
    micros
        .filter(|micros| *micros > 0 && *micros < 1 << 53)
        .ok_or_else(|| bad(slot, format!("{slot} must be a number of ms, at least 1")))
}
