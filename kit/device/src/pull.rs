//! Devices that ask for their commands (W22): behind a bad link nothing is carried out late.

use mom_client::{Age, Code, HUB, Parcel, WireError};

use crate::DeviceTime;

/// The message by which a device asks for its next command.
pub(crate) const NEXT: &str = "next";

/// What a device has asked for, and which command it takes.
///
/// It takes the answer to its newest request, once, and only while it is surely good: a request that was asked again is void, so that a
/// command that comes late is never carried out, and who feeds the device may send it anew.
#[derive(Debug)]
pub(crate) struct Pull {
    /// For how long a request waits.
    wait: DeviceTime,
    /// The id of the newest request, while it is not answered.
    asked: Option<u64>,
    /// When it is asked again.
    due: DeviceTime,
}

impl Pull {
    pub(crate) fn new(wait: DeviceTime) -> Self {
        Self {
            wait,
            asked: None,
            due: 0,
        }
    }

    pub(crate) fn wait(&self) -> DeviceTime {
        self.wait
    }

    pub(crate) fn due(&self) -> DeviceTime {
        self.due
    }

    /// Notes that it asks now, by a message of this id.
    pub(crate) fn ask(&mut self, id: Option<u64>, now: DeviceTime) {
        self.asked = id;
        self.due = now.saturating_add(self.wait);
    }

    /// Has it ask as soon as it has nothing to do, as its request was answered or there is another owner to ask.
    pub(crate) fn renew(&mut self, now: DeviceTime) {
        self.asked = None;
        self.due = now;
    }

    /// Whether a command may be taken; the safe state that the hub orders always.
    pub(crate) fn check(&self, command: &Parcel, age: Option<Age>) -> Result<(), WireError> {
        if command.sender.as_deref() == Some(HUB) {
            return Ok(());
        }
        let slot = |text: &str, slot| Err(WireError::new(Code::BAD_SLOT, text).slot(slot));
        let expired = |text: String| Err(WireError::new(Code::EXPIRED, text));
        let Some(life) = command.expires.map(u128::from) else {
            let text = "this device asks for its commands, so each requires the slot `expires` (ms)";
            return slot(text, "expires");
        };
        if command.reference.is_none() {
            let text = "this device asks for its commands: answer its message `next`, with its id in the slot `reference`";
            return slot(text, "reference");
        }
        let Some(age) = age.and_then(|age| age.at_most()) else {
            let text = "how old the command is is not known, as a clock is not measured yet; the device does not carry it out, and asks again";
            return expired(text.to_owned());
        };
        if age.as_micros() >= life.saturating_mul(1000) {
            let age = age.as_micros().div_ceil(1000);
            return expired(format!(
                "the command may be {age} ms old, and was good for {life} ms; the device does not carry it out, and asks again"
            ));
        }
        if command.reference != self.asked {
            let text = "the command answers an earlier request, which is void since the device has asked again or was answered";
            return expired(text.to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use mom_client::Family;

    use super::*;

    fn command(reference: Option<u64>, expires: Option<u64>) -> Parcel {
        let mut parcel = Parcel::new(Family::Message, "command");
        (parcel.reference, parcel.expires) = (reference, expires);
        parcel
    }

    fn aged(micros: i64, error_micros: Option<u64>) -> Option<Age> {
        Some(Age { micros, error_micros })
    }

    #[test]
    fn only_a_surely_fresh_answer_to_the_newest_request_is_taken() {
        let mut pull = Pull::new(1_000_000);
        pull.ask(Some(7), 0);
        pull.ask(Some(8), 1_000_000);
        for (reference, expires, age, code) in [
            (Some(8), Some(100), aged(50_000, Some(49_999)), None),
            (
                Some(8),
                Some(100),
                aged(50_000, Some(50_000)),
                Some(Code::EXPIRED),
            ),
            (Some(8), Some(100), aged(0, None), Some(Code::EXPIRED)),
            (Some(8), Some(100), None, Some(Code::EXPIRED)),
            (Some(7), Some(100), aged(0, Some(0)), Some(Code::EXPIRED)),
            (Some(8), None, aged(0, Some(0)), Some(Code::BAD_SLOT)),
            (None, Some(100), aged(0, Some(0)), Some(Code::BAD_SLOT)),
        ] {
            let taken = pull.check(&command(reference, expires), age);
            assert_eq!(
                taken.err().map(|error| error.code),
                code,
                "{reference:?} {expires:?} {age:?}"
            );
        }
        pull.renew(1_000_001);
        let again = pull.check(&command(Some(8), Some(100)), aged(0, Some(0)));
        assert!(again.is_err(), "an answer is taken once");
    }

    #[test]
    fn the_safe_state_of_the_hub_needs_no_request() {
        let mut safe = command(None, None);
        safe.sender = Some(HUB.into());
        assert_eq!(Pull::new(1).check(&safe, None), Ok(()));
    }
}
