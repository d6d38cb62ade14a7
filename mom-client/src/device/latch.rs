//! The device's side of stops: what holds, by the order of causes, and what it waits for (M43).

use mom_proto::event as names;
use mom_proto::{HUB, Map, Parcel, STOP, Value};

use crate::words::{map_of, owned};
use crate::{Event, StopState};

/// What a device does about an event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reaction {
    /// It halts, and moves no more until it is told so; why, for people.
    Stop(String),
    /// It may move again.
    Free,
    /// It halts; the next command moves it again, as soon as it [may move](Latch::may_move).
    Halt,
    /// It was told of stops, and nothing changes: it says how it stands.
    Same,
}

/// Whether a device may move, by what it has heard: fed with the events of its channel in their order.
///
/// Every stop has a number that only rises. An unstop below the newest stop frees nobody, whichever way it came. A device moves
/// nothing before it has heard on this connection how it stands, and a gap in its events counts as a stop of its own, because it
/// may have contained one.
///
/// ```
/// use mom_client::{Event, Family, Latch, Parcel, Reaction};
///
/// let stop = |name: &str, number: i64| {
///     let mut parcel = Parcel::new(Family::Message, name);
///     parcel.extra.set("stop", number);
///     Event::Message(parcel)
/// };
/// let mut latch = Latch::default();
/// assert!(latch.may_move().is_err(), "it has heard nothing");
/// latch.observe(&Event::Stops(Default::default()));
/// assert!(latch.may_move().is_ok());
/// assert!(matches!(latch.observe(&stop("stop", 7)), Some(Reaction::Stop(_))));
/// assert_eq!(latch.observe(&stop("unstop", 6)), Some(Reaction::Same), "there is a newer stop");
/// assert_eq!(latch.observe(&stop("unstop", 7)), Some(Reaction::Free));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Latch {
    /// The newest stop that it has heard of.
    number: u64,
    /// What an unstop has lifted.
    lifted: u64,
    held: Option<Held>,
    /// It has heard on this connection how it stands.
    known: bool,
}

/// Why a device may not move.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Held {
    /// A peer has stopped it.
    #[error("stopped by {by}{}", .reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default())]
    Stopped {
        /// Who.
        by: String,
        /// Why, in that one's words.
        reason: Option<String>,
        /// The number of the stop.
        number: u64,
    },
    /// It has stopped itself, and the hub has not given that a number yet.
    #[error("stopped by itself: {0}")]
    Own(String),
    /// It has not heard on this connection how it stands.
    #[error("the hub has not said yet whether it is stopped")]
    Unknown,
}

impl Latch {
    /// Takes in an event of the device's channel; gives what it means for the device.
    pub fn observe(&mut self, event: &Event) -> Option<Reaction> {
        match event {
            Event::Message(parcel) if parcel.name() == names::STOP => Some(self.stop(parcel)),
            Event::Message(parcel) if parcel.name() == names::UNSTOP => Some(self.unstop(slot(parcel))),
            Event::Stops(state) => self.learn(state),
            Event::Lagged(lost) => Some(self.stop_itself(&format!("it has missed {lost} events"))),
            Event::LinkDown => {
                self.known = false;
                Some(Reaction::Halt)
            }
            _ => None,
        }
    }

    /// Whether the device may move.
    ///
    /// # Errors
    /// [`Held`]: why not.
    pub fn may_move(&self) -> Result<(), Held> {
        match &self.held {
            Some(held) => Err(held.clone()),
            None if !self.known => Err(Held::Unknown),
            None => Ok(()),
        }
    }

    /// The newest stop that it has heard of: the key `stop` of its states.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Whether it is stopped.
    pub fn is_stopped(&self) -> bool {
        self.held.is_some()
    }

    /// Whether it has stopped itself and the hub does not know: it says `stop` with itself as the only address.
    pub fn is_own(&self) -> bool {
        matches!(self.held, Some(Held::Own(_)))
    }

    /// Stops by itself, until that is lifted.
    pub fn stop_itself(&mut self, why: &str) -> Reaction {
        if self.held.is_none() {
            self.held = Some(Held::Own(why.to_owned()));
        }
        Reaction::Stop(why.to_owned())
    }

    /// What it says of itself when it joins: `{stop, stopped}`.
    pub(crate) fn word(&self) -> Map {
        let number = i64::try_from(self.number).unwrap_or(i64::MAX);
        let stopped = matches!(self.held, Some(Held::Stopped { .. }));
        Map::new().with(STOP, number).with("stopped", stopped)
    }

    fn stop(&mut self, parcel: &Parcel) -> Reaction {
        // So it tells a device that has come back how it stands.
        self.known |= parcel.sender.as_deref() == Some(HUB);
        let number = slot(parcel).unwrap_or(self.number);
        let content = map_of(parcel);
        let by = owned(&content, "by");
        let by = by.or_else(|| parcel.sender.as_deref().map(str::to_owned));
        let reason = owned(&content, "reason").or_else(|| parcel.value().as_str().map(str::to_owned));
        self.take(number, by, reason)
    }

    fn take(&mut self, number: u64, by: Option<String>, reason: Option<String>) -> Reaction {
        self.number = self.number.max(number);
        if number > 0 && number <= self.lifted {
            // It was lifted before it came: the cause is an old one. To halt is never wrong.
            return Reaction::Halt;
        }
        let held = Held::Stopped {
            by: by.unwrap_or_else(|| "a peer".to_owned()),
            reason,
            number: self.number,
        };
        let why = held.to_string();
        self.held = Some(held);
        Reaction::Stop(why)
    }

    /// `up_to` is none from hubs that give stops no numbers.
    fn unstop(&mut self, up_to: Option<u64>) -> Reaction {
        let lifts = match (&self.held, up_to) {
            (_, None) => true,
            // What it has stopped for itself has a higher number, which has not come yet.
            (Some(Held::Own(_)), Some(_)) => false,
            (_, Some(up_to)) => up_to >= self.number,
        };
        self.lifted = self.lifted.max(up_to.unwrap_or_default());
        match lifts && self.held.take().is_some() {
            true => Reaction::Free,
            false => Reaction::Same,
        }
    }

    fn learn(&mut self, state: &StopState) -> Option<Reaction> {
        // Of others: what concerns this device comes by a message.
        if state.stopped && !(state.only.is_empty() && state.except.is_empty()) {
            return None;
        }
        self.known = true;
        if state.stopped {
            return Some(self.take(state.number, state.by.clone(), state.reason.clone()));
        }
        Some(self.unstop(Some(state.number)))
    }
}

/// The number that a stop has, or that an unstop names.
fn slot(parcel: &Parcel) -> Option<u64> {
    match parcel.extra.get(STOP) {
        Some(Value::Int(number)) => u64::try_from(*number).ok(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use mom_proto::Family;
    use proptest::collection::vec;
    use proptest::prelude::*;
    use serde::Deserialize;

    use super::*;

    /// One case of `tests/cases/latch.json`.
    #[derive(Deserialize)]
    struct Case {
        name: String,
        steps: Vec<Step>,
    }

    /// An event, and how the device stands after it.
    #[derive(Deserialize)]
    struct Step {
        event: String,
        #[serde(default)]
        number: Option<u64>,
        /// Who says it.
        #[serde(default)]
        sender: Option<String>,
        #[serde(default)]
        stopped: bool,
        #[serde(default)]
        only: Vec<String>,
        #[serde(default)]
        except: Vec<String>,
        turn: Option<String>,
        moves: bool,
        says: u64,
    }

    impl Step {
        fn event(&self) -> Event {
            let message = |name: &str| {
                let mut parcel = Parcel::new(Family::Message, name);
                parcel.sender = Some(self.sender.as_deref().unwrap_or("bob").into());
                if let Some(number) = self.number {
                    parcel.extra.set(STOP, i64::try_from(number).expect("small"));
                }
                Event::Message(parcel)
            };
            match self.event.as_str() {
                "stop" | "unstop" => message(&self.event),
                "state" => Event::Stops(StopState {
                    number: self.number.unwrap_or_default(),
                    stopped: self.stopped,
                    only: self.only.clone(),
                    except: self.except.clone(),
                    ..StopState::default()
                }),
                "gap" => Event::Lagged(3),
                "link-down" => Event::LinkDown,
                "resumed" => Event::Resumed,
                other => panic!("there is no event {other}"),
            }
        }
    }

    /// What operators do, each behind a link of its own: they stop, or lift the newest stop that they have seen.
    #[derive(Clone, Copy, Debug)]
    enum Act {
        Stop,
        /// With what was seen so many stops ago.
        Unstop(u64),
    }

    fn acts() -> impl Strategy<Value = Vec<(Act, u64)>> {
        let act = prop_oneof![Just(Act::Stop), (0..3_u64).prop_map(Act::Unstop)];
        // With the time that what comes of it takes to the device, over whichever link.
        vec((act, 0..20_u64), 0..40)
    }

    proptest! {
        /// The hub numbers in the order of causes; on its way to the device anything may overtake anything.
        #[test]
        fn the_last_in_the_order_of_causes_is_what_a_device_obeys(acts in acts()) {
            let (mut newest, mut lifted) = (0, 0);
            let mut under_way = Vec::new();
            for (at, (act, delay)) in acts.into_iter().enumerate() {
                let arrives = at as u64 + delay;
                match act {
                    Act::Stop => {
                        newest += 1;
                        under_way.push((arrives, at, message("stop", newest)));
                    }
                    // The hub hands out no unstop that names an older stop than the one that holds.
                    Act::Unstop(behind) if behind == 0 && newest > 0 => {
                        lifted = newest;
                        under_way.push((arrives, at, message("unstop", newest)));
                    }
                    // An old hub, or another one, might: it frees nobody from what came since.
                    Act::Unstop(behind) if newest > behind => {
                        under_way.push((arrives, at, message("unstop", newest - behind)));
                        lifted = lifted.max(newest - behind);
                    }
                    Act::Unstop(_) => {}
                }
            }
            under_way.sort_by_key(|(arrives, at, _)| (*arrives, *at));
            let mut latch = Latch::default();
            latch.observe(&Event::Stops(StopState::default()));
            for (_, _, event) in &under_way {
                latch.observe(event);
            }
            prop_assert_eq!(latch.is_stopped(), newest > lifted, "{:?}", under_way);
            prop_assert_eq!(latch.number(), newest);
        }
    }

    fn message(name: &str, number: u64) -> Event {
        let mut parcel = Parcel::new(Family::Message, name);
        parcel.extra.set(STOP, i64::try_from(number).expect("small"));
        Event::Message(parcel)
    }

    #[test]
    fn the_cases_of_all_clients() {
        let text = include_str!("../../../tests/cases/latch.json");
        let cases: Vec<Case> = serde_json::from_str(text).expect("cases");
        assert!(cases.len() >= 15);
        for case in cases {
            let mut latch = Latch::default();
            for (at, step) in case.steps.iter().enumerate() {
                let turn = latch.observe(&step.event()).map(|turn| match turn {
                    Reaction::Stop(_) => "stop",
                    Reaction::Free => "free",
                    Reaction::Halt => "halt",
                    Reaction::Same => "same",
                });
                let place = format!("{}: step {at}", case.name);
                assert_eq!(turn, step.turn.as_deref(), "{place}");
                assert_eq!(latch.may_move().is_ok(), step.moves, "{place}");
                assert_eq!(latch.number(), step.says, "{place}");
            }
        }
    }
}
