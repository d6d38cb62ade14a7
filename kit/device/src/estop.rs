//! The emergency stop at the device itself: what its button says, and what the hub does not know of it yet.

use mom_client::{Event, event};

/// Whether it is pressed, and whether the hub owes a number for that.
///
/// Each press and each reset is a stop of its own, also of a device that is stopped already, so that an `unstop` said before it lifts
/// nothing: until the hub has given the device's own stop a number, no `unstop` lets it go.
#[derive(Debug)]
pub(crate) struct Estop {
    /// What the device has said last; none = it knows of no such button.
    known: Option<bool>,
    owed: Option<Owed>,
    linked: bool,
}

/// A stop of its own that the hub has not numbered.
#[derive(Debug)]
struct Owed {
    why: &'static str,
    /// The id of the newest message that says so.
    said: Option<u64>,
}

impl Estop {
    pub(crate) fn new() -> Estop {
        Estop {
            known: None,
            owed: None,
            linked: true,
        }
    }

    /// Takes in what the device says of its button; why it has to stop, if that is another thing than before.
    pub(crate) fn look(&mut self, known: Option<bool>) -> Option<&'static str> {
        let was_pressed = self.is_pressed();
        self.known = known;
        let why = match (was_pressed, self.is_pressed()) {
            (false, true) => "its emergency stop was pressed",
            (true, false) => "its emergency stop was reset",
            _ => return None,
        };
        self.owed = Some(Owed { why, said: None });
        Some(why)
    }

    /// What the device has said of its button.
    pub(crate) fn known(&self) -> Option<bool> {
        self.known
    }

    pub(crate) fn is_pressed(&self) -> bool {
        self.known == Some(true)
    }

    /// Why nothing lets the device go: it has stopped itself, and the hub has not given that a number.
    pub(crate) fn owed(&self) -> Option<&'static str> {
        self.owed.as_ref().map(|owed| owed.why)
    }

    /// Takes in an event of the device's channel, where it is called so.
    pub(crate) fn hear(&mut self, event: &Event, name: Option<&str>) {
        match event {
            Event::LinkDown => self.linked = false,
            Event::Rejoined | Event::Resumed => self.linked = true,
            // Its own stop comes back with a number; one that was said for an earlier press says nothing of this one.
            Event::Message(parcel) if parcel.name() == event::STOP && parcel.sender.as_deref() == name => {
                let answers = |owed: &Owed| owed.said.is_some() && parcel.id >= owed.said;
                if self.owed.as_ref().is_some_and(answers) {
                    self.owed = None;
                }
            }
            _ => {}
        }
    }

    /// Why it is to be said now that it has stopped itself, if that is so: not over a lost link, which it is said again when it is back.
    pub(crate) fn to_say(&self) -> Option<&'static str> {
        self.owed().filter(|_| self.linked)
    }

    /// It was said by a message of this id.
    pub(crate) fn said(&mut self, id: Option<u64>) {
        if let Some(owed) = &mut self.owed {
            owed.said = id;
        }
    }
}

#[cfg(test)]
mod tests {
    use mom_client::{Family, Parcel};

    use super::*;

    fn said(name: &str, sender: &str, id: u64) -> Event {
        let mut parcel = Parcel::new(Family::Message, name);
        (parcel.sender, parcel.id) = (Some(sender.into()), Some(id));
        Event::Message(parcel)
    }

    #[test]
    fn only_its_own_stop_for_this_press_is_its_number() {
        let mut estop = Estop::new();
        estop.look(Some(false));
        assert_eq!(estop.look(Some(true)), Some("its emergency stop was pressed"));
        estop.hear(&said(event::STOP, "arm", 4), Some("arm"));
        assert!(estop.owed().is_some(), "nothing was said of it yet");
        estop.said(Some(5));
        for other in [
            said(event::STOP, "alice", 5),
            said(event::UNSTOP, "arm", 5),
            said(event::STOP, "arm", 4),
        ] {
            estop.hear(&other, Some("arm"));
            assert!(estop.owed().is_some(), "{other:?}");
        }
        estop.hear(&Event::LinkDown, Some("arm"));
        assert_eq!(estop.to_say(), None);
        estop.hear(&Event::Resumed, Some("arm"));
        assert_eq!(estop.to_say(), Some("its emergency stop was pressed"));
        estop.hear(&said(event::STOP, "arm", 5), Some("arm"));
        assert_eq!(estop.owed(), None);
        assert!(estop.is_pressed());
    }
}
