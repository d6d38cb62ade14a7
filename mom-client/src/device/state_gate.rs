//! The device's check of states (M35): a command is valid only if its state still holds.

use mom_proto::{Code, MAX_ID, Parcel, Time, Value, WireError};

/// The slot of a command that names the state which it was based on, by the id of that state's parcel.
pub const BASED_ON: &str = "based-on";

/// The ids of states lie in this half of all; those that the client itself gives out never get here.
const FIRST: u64 = 1 << 52;

/// Refuses commands based on an outdated state: "ten millimetres to the left" is wrong once the device has moved.
///
/// A device gives each state that it sends an id by this gate, and says which of them tell of a motion. A command
/// that names a state in its slot `based-on` ([`Message::based_on`](crate::Message::based_on)) is to be obeyed only
/// if the device has not moved since, and does not move now. One without the slot is not checked.
///
/// ```
/// use mom_client::{Family, Parcel, StateGate, Time};
///
/// let mut gate = StateGate::new(Time::default());
/// let mut state = Parcel::new(Family::Message, "state");
/// gate.stamp(&mut state, true);
/// let mut command = Parcel::new(Family::Message, "command");
/// command.extra.set("based-on", state.id.unwrap() as i64);
/// assert!(gate.check(&command).is_ok());
///
/// gate.stamp(&mut Parcel::new(Family::Message, "state"), false);
/// assert!(gate.check(&command).is_ok(), "the device is where it was");
/// gate.stamp(&mut Parcel::new(Family::Message, "state"), true);
/// assert_eq!(gate.check(&command).unwrap_err().code.word(), "stale-state");
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StateGate {
    /// The id of the newest state.
    newest: u64,
    /// That of the newest state which told of a motion.
    moved: u64,
    moving: bool,
}

impl StateGate {
    /// A gate of a device that starts at this time of day. Its ids are higher than all of an earlier start, so that
    /// old states cannot be mistaken for new ones.
    pub fn new(start: Time) -> StateGate {
        let start = u64::try_from(start.micros()).unwrap_or_default() % FIRST;
        StateGate {
            newest: FIRST + start,
            // None of the states before the first one holds.
            moved: FIRST + start + 1,
            moving: false,
        }
    }

    /// Gives a state that is about to be sent its id. `moved` tells whether the device is in another position than
    /// in the state before.
    pub fn stamp(&mut self, state: &mut Parcel, moved: bool) {
        self.newest = (self.newest + 1).min(MAX_ID);
        if moved {
            self.moved = self.newest;
        }
        state.id = Some(self.newest);
    }

    /// Notes that the device moves now, or has motions ahead of it: no state holds until it stops.
    pub fn set_moving(&mut self, moving: bool) {
        self.moving = moving;
    }

    /// Whether the state of a command still holds.
    ///
    /// # Errors
    /// `stale-state` with the id of the newest state as detail `state`; `bad-slot` for a slot that is not an id.
    pub fn check(&self, command: &Parcel) -> Result<(), WireError> {
        let Some(given) = command.extra.get(BASED_ON) else {
            return Ok(());
        };
        let Some(given) = id_of(given) else {
            let text = format!("the slot {BASED_ON} is the id of a state, a number from 0 to {MAX_ID}");
            return Err(WireError::new(Code::BAD_SLOT, text).slot(BASED_ON));
        };
        let text = match given {
            _ if given > self.newest => "the device has not published this state since it was started",
            _ if given < self.moved => "the device has moved since the state that this was based on",
            _ if self.moving => "the device is still moving, so no state of it holds",
            _ => return Ok(()),
        };
        let newest = i64::try_from(self.newest).unwrap_or(i64::MAX);
        Err(WireError::new(Code::STALE_STATE, text).detail("state", newest))
    }
}

fn id_of(value: &Value) -> Option<u64> {
    let id = u64::try_from(value.as_int()?).ok()?;
    (id <= MAX_ID).then_some(id)
}

#[cfg(test)]
mod tests {
    use mom_proto::Family;

    use super::*;

    fn told(gate: &mut StateGate, moved: bool) -> u64 {
        let mut state = Parcel::new(Family::Message, "state");
        gate.stamp(&mut state, moved);
        state.id.unwrap()
    }

    fn check(gate: &StateGate, based_on: impl Into<Value>) -> Result<(), (Code, Option<i64>)> {
        let mut command = Parcel::new(Family::Message, "command");
        command.extra.set(BASED_ON, based_on);
        gate.check(&command).map_err(|error| {
            let state = error.get("state").and_then(Value::as_int);
            (error.code, state)
        })
    }

    fn id(id: u64) -> Value {
        Value::Int(i64::try_from(id).unwrap())
    }

    #[test]
    fn only_a_motion_makes_older_states_stale() {
        let mut gate = StateGate::new(Time::default());
        let [moved, rest, again] = [true, false, false].map(|moved| told(&mut gate, moved));
        for state in [moved, rest, again] {
            assert_eq!(check(&gate, id(state)), Ok(()));
        }
        let other = told(&mut gate, true);
        let stale = Err((Code::STALE_STATE, i64::try_from(other).ok()));
        for state in [0, moved, rest, again, other + 1] {
            assert_eq!(check(&gate, id(state)), stale, "{state}");
        }
        assert_eq!(check(&gate, id(other)), Ok(()));
        gate.set_moving(true);
        assert_eq!(check(&gate, id(other)), stale);
        assert_eq!(gate.check(&Parcel::new(Family::Message, "command")), Ok(()));
    }

    #[test]
    fn nothing_holds_before_the_first_state_nor_from_an_earlier_start() {
        let start = |micros| StateGate::new(Time::from_micros(micros).unwrap());
        let mut before = start(1_700_000_000_000_000);
        let old = told(&mut before, true);
        let mut gate = start(1_700_000_000_000_500);
        for state in [old, old + 499] {
            assert!(check(&gate, id(state)).is_err(), "{state}");
        }
        let first = told(&mut gate, false);
        assert!(first > old && first <= MAX_ID);
        assert!(check(&gate, id(old)).is_err());
        assert_eq!(
            check(&gate, id(first)),
            Ok(()),
            "the first state holds, moved or not"
        );
    }

    #[test]
    fn a_slot_that_is_no_id_is_refused_as_such() {
        let gate = StateGate::new(Time::default());
        for value in [Value::from("7"), Value::Int(-1), Value::Int(1 << 53), Value::Null] {
            assert_eq!(check(&gate, value), Err((Code::BAD_SLOT, None)));
        }
    }
}
