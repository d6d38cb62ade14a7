//! Which installed program a device is, so that the same one, started again, takes its own place.

use std::sync::Arc;

use mom_proto::{Map, Time};

use crate::wire::clock::system;
use crate::wire::ids;

/// What a device says of itself beside its stops when it joins.
#[derive(Clone, Debug)]
pub(crate) struct Installation {
    id: Arc<str>,
    begun: Time,
}

impl Installation {
    /// One that has just been started.
    pub(crate) fn new(id: &str) -> Installation {
        Installation {
            id: id.into(),
            begun: system().unwrap_or_default(),
        }
    }

    /// One whose program remembers nothing: it is another one after each start.
    pub(crate) fn unknown() -> Installation {
        Installation::new(&format!("{:016x}", ids::any()))
    }

    pub(crate) fn describe(&self, map: &mut Map) {
        map.set("installation", &*self.id);
        map.set("begun", self.begun);
    }
}
