//! What a device itself can do.

use std::fmt;

use mom_client::{Card, Map};

use crate::{Attachments, DeviceError, DeviceTime, Sample, Script, Word, Words};

/// µs between two states while a device moves, unless its machine says otherwise: 20 Hz.
pub const STATE_PERIOD: DeviceTime = 50_000;

/// A device without its queue, its owner and its link: what its actions are, and how it carries one out.
///
/// Its methods are called with times that never go back. It knows the time of the latest call.
pub trait Machine: fmt::Debug {
    /// What a statement of its scripts makes it do; `wait` is not among them, as every device waits alike.
    type Action: Clone + fmt::Debug + PartialEq;

    /// What it is called in texts, such as `the camera`.
    const NAME: &str;

    /// The first words of its statements, for the nearest one to a wrong word; without `wait`.
    const VERBS: &[&str];

    /// µs between two states while it moves.
    const PERIOD: DeviceTime = STATE_PERIOD;

    /// µs within which it stands once it is halted, whatever it did before. It says that it rests by this only where it does not measure.
    const STOPPING_TIME: DeviceTime = 1_000_000;

    /// µs for which what was begun may go on while the program stands still, and by which a later statement may begin too late. The
    /// mechanism has a deadline of its own; whatever is under way after a longer silence is ended.
    const PATIENCE: DeviceTime = 1_000_000;

    /// The numbers of its position differ by less than this, each in its unit, while it rests.
    const TOLERANCE: f64 = 1.0;

    /// What it can do, and what it tells of itself: its statements are those of [`Machine::VERBS`]. [`card`](crate::card) adds what every
    /// device has.
    fn card(&self) -> Card;

    /// Reads what follows the verb of a statement; `None` if there is no such verb.
    ///
    /// # Errors
    ///
    /// `syntax`, at the word that is wrong.
    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Self::Action, DeviceError>>;

    /// Whether what its owner began may come to the end of the present statement where he gives its token away, and the hub sends no
    /// `halt`. Else it is halted then, too.
    const COMPLETES: bool = false;

    /// Gives an action the bytes that it names, of those that came with its script.
    ///
    /// # Errors
    ///
    /// `syntax` if they did not come.
    fn attach(_action: &mut Self::Action, _attachments: &Attachments) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Whether an action says only how far it goes from where the device is, so that it is wrong from anywhere else (M35); none of one that
    /// takes it nowhere.
    fn is_relative(_action: &Self::Action) -> Option<bool> {
        Some(false)
    }

    /// Whether an action waits behind no other: it takes the place of one that gives way, and is refused as `busy` behind any other.
    fn never_waits(_action: &Self::Action) -> bool {
        false
    }

    /// Whether it is busy with something that no command began, or moves on after one.
    fn is_moving(&self) -> bool;

    /// Whether a halt would change nothing: it does not move, and nothing that a command left behind goes on.
    fn is_at_rest(&self) -> bool {
        !self.is_moving()
    }

    /// Whether it can tell its mechanism what to do, and hears of it. What is not reached is never said to rest.
    fn is_reached(&self) -> bool {
        true
    }

    /// Whether an emergency stop at the device itself is pressed, such as a button on it or its pendant; `None` if it knows of none. It is
    /// asked at each turn of its server, so a device that has one asks to be called each [`LOOK_AT_REST`](crate::LOOK_AT_REST).
    fn estop(&self) -> Option<bool> {
        None
    }

    /// Whether what it reports changes by itself although it does not move, such as where a thing is that falls. States follow meanwhile.
    fn is_changing(&self) -> bool {
        false
    }

    /// Checks a script from where the device will be after those that were planned before, and plans on from its end.
    ///
    /// # Errors
    ///
    /// What cannot be carried out, with the statement's number. Then nothing is planned.
    fn plan(&mut self, script: &Script<Self::Action>) -> Result<(), DeviceError>;

    /// Begins an action.
    ///
    /// # Errors
    ///
    /// Why it cannot be begun. Then all commands end.
    fn begin(&mut self, action: &Self::Action, now: DeviceTime) -> Result<(), DeviceError>;

    /// When the action that was begun last is done, as far as that is known.
    fn done_at(&self) -> Option<DeviceTime>;

    /// Goes on with the action that was begun last, until then at most, and says when it was done, or has failed
    /// ([`Machine::take_failure`]), if it was. Only a machine that does not know that time before has more to do here.
    fn pursue(&mut self, until: DeviceTime) -> Option<DeviceTime> {
        self.done_at().filter(|done| *done <= until)
    }

    /// Why everything has to end that is being carried out or waits, if it has; once.
    fn take_failure(&mut self) -> Option<DeviceError> {
        None
    }

    /// Whether what was begun goes on until another command comes. Then it gives way, and its command is finished.
    fn gives_way(&self) -> bool {
        false
    }

    /// Gives way to the command that begins next.
    fn give_way(&mut self, now: DeviceTime) {
        self.halt(now);
    }

    /// Comes to a stand at once, and forgets what was planned. Each stop and each halt comes here, also at rest: the mechanism may not do
    /// what is known of it.
    fn halt(&mut self, now: DeviceTime);

    /// Lets time pass until `now`.
    fn advance(&mut self, now: DeviceTime);

    /// When [`Machine::advance`] has to be called next; `None` if it changes by commands only. What something else may move asks for it
    /// each [`LOOK_AT_REST`](crate::LOOK_AT_REST) also while it rests: what is not looked at is believed to rest on.
    fn next_wake(&self) -> Option<DeviceTime> {
        None
    }

    /// Since when what the state tells may have been so, if that is not now: of a device that is asked, when it was.
    fn known_at(&self) -> Option<DeviceTime> {
        None
    }

    /// What commands may be based on: where the device is, as it stands in the state, key by key (M35).
    fn position(&self) -> Map;

    /// What is measured of all of it that can move, at this time, by which it rests; none where something that may have moved is not
    /// measured.
    fn measured(&self, at: DeviceTime) -> Option<Sample> {
        Sample::of(&self.position(), at)
    }

    /// What else stands in the state.
    fn report(&self) -> Map {
        Map::new()
    }
}

/// The card of a device, with how soon it stands; it joins its channel with that
/// ([`Client::channel_with_card`](mom_client::Client::channel_with_card)).
#[must_use]
pub fn card<M: Machine>(machine: &M) -> Card {
    Card {
        stops_within: u32::try_from(M::STOPPING_TIME / 1000).ok(),
        ..machine.card()
    }
}
