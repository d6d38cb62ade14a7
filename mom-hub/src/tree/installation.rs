//! Which installed program a device is: the same one, started again, takes its own place.

use std::sync::Arc;

use mom_proto::{Code, Time, Value, WireError, check_name};

/// Which installed program a device is, and when it was started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Installation {
    /// The same after each start of the program, and of no other.
    id: Arc<str>,
    /// By the clock of its machine, which all starts of an installation share.
    begun: Time,
}

/// The keys of an installation in what a device says when it joins.
pub(crate) const KEYS: [&str; 2] = ["installation", "begun"];

impl Installation {
    /// From what a device says when it joins; none if it says nothing of that.
    ///
    /// # Errors
    /// `bad-content`.
    pub(crate) fn read(device: &Value) -> Result<Option<Installation>, WireError> {
        let bad = |key: &str, text: &str| {
            WireError::new(Code::BAD_CONTENT, text).slot(&format!("content/device/{key}"))
        };
        let [id, begun] = KEYS.map(|key| device.as_map().and_then(|map| map.get(key)));
        match (id, begun) {
            (None, None) => Ok(None),
            (Some(Value::String(id)), Some(Value::Time(begun))) if check_name(id).is_ok() => {
                Ok(Some(Installation {
                    id: id.as_str().into(),
                    begun: *begun,
                }))
            }
            (Some(_), Some(Value::Time(_))) => {
                Err(bad(KEYS[0], "installation must be a name of at most 64 bytes"))
            }
            (Some(_), _) => Err(bad(KEYS[1], "begun must be a time")),
            (None, _) => Err(bad(KEYS[0], "begun requires installation")),
        }
    }

    /// Whether this is the other one, started again or just connected again.
    pub(crate) fn follows(&self, other: &Installation) -> bool {
        self.id == other.id && other.begun <= self.begun
    }
}
