//! The owner of the robot's token, as known to the camera (M33).

use mom_client::{Code, Event, Map, Path, Value, WireError};

/// The owner of a token.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Owner {
    name: Option<String>,
    /// The newest known fence. Late reports about older fences change nothing.
    fence: u64,
}

impl Owner {
    pub(crate) fn handle(&mut self, event: &Event) {
        match event {
            Event::Grabbed { owner, fence, .. } => self.set(Some(owner), *fence),
            Event::Released { fence, .. } => self.set(None, *fence),
            // After a lost link the hub is asked again; a restarted hub may have other fences.
            Event::LinkDown => *self = Owner::default(),
            _ => {}
        }
    }

    /// Takes the token's facts as the hub tells them: `{owner?, fence, …}`.
    pub(crate) fn handle_info(&mut self, info: &Map) {
        let fence = info.get("fence").and_then(Value::as_int).unwrap_or_default();
        self.set(
            info.get("owner").and_then(Value::as_str),
            u64::try_from(fence).unwrap_or_default(),
        );
    }

    /// The peer that owns it.
    pub(crate) fn name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// Whether this peer owns the token; the error names the owner, and what only the owner does.
    pub(crate) fn check(&self, peer: Option<&str>, token: &Path, what: &str) -> Result<(), WireError> {
        match &self.name {
            Some(owner) if peer == Some(owner) => Ok(()),
            Some(owner) => {
                let text = format!("only the owner of {token} {what}, and that is {owner}");
                Err(WireError::new(Code::NOT_OWNER, text).detail("owner", owner.as_str()))
            }
            None => {
                let text = format!("only the owner of {token} {what}, and nobody owns it; grab it first");
                Err(WireError::new(Code::NOT_OWNER, text))
            }
        }
    }

    fn set(&mut self, name: Option<&str>, fence: u64) {
        if fence >= self.fence {
            self.fence = fence;
            self.name = name.map(str::to_owned);
        }
    }
}
