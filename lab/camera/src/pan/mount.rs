//! The mount as a machine: how it turns, and where it is to look in the end. [`mom_device`] has its queue and its answers.

use mom_client::{Card, CardArg, CardVerb, Map};
use mom_device::{DeviceError, DeviceTime, Machine, Script, Word, Words};
use mom_trace::Trace;

use super::aim::{Aim, HOME, PANS, TILTS};
use super::slew::Slew;

/// The mount.
///
/// It has no mass to speak of: it stands as soon as it is halted, wherever it looks then.
#[derive(Debug)]
pub struct Mount {
    now: DeviceTime,
    slew: Slew,
    /// Where it will look after the last waiting command; the next one is checked from there.
    planned: Aim,
    /// Where it is written where it looks.
    trace: Option<Trace>,
}

/// What a statement of its scripts makes it do.
///
/// | statement | does |
/// |---|---|
/// | `look pan tilt` | turns to these angles, in degrees |
/// | `turn dpan dtilt` | turns by so much from where it looks then |
/// | `home` | turns to [`HOME`] |
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MountAction {
    /// Turn to these angles.
    To(Aim),
    /// Turn by so much.
    By(Aim),
    /// Turn home.
    Home,
}

impl MountAction {
    /// Where it leads from this aim.
    pub(super) fn target(&self, from: Aim) -> Aim {
        match self {
            // The motors have steps here as well.
            Self::To(aim) => Aim::new(0.0, 0.0).plus(aim),
            Self::By(by) => from.plus(by),
            Self::Home => HOME,
        }
    }
}

impl Default for Mount {
    /// A mount at home, at rest.
    fn default() -> Self {
        Self {
            now: 0,
            slew: Slew::rest(HOME),
            planned: HOME,
            trace: None,
        }
    }
}

impl Mount {
    /// A mount at home, at rest, that writes there where it looks: pan and tilt in degrees.
    #[must_use]
    pub fn traced(trace: Trace) -> Self {
        Self {
            trace: Some(trace),
            ..Self::default()
        }
    }

    /// Writes where it has looked until now, before that changes.
    fn trace(&mut self, now: DeviceTime) {
        let slew = self.slew;
        if let Some(trace) = &mut self.trace {
            trace.until(now, |at| {
                let Aim { pan, tilt } = slew.at(at);
                [pan, tilt]
            });
        }
    }

    /// Reads a script of the mount.
    ///
    /// ```
    /// use mom_camera::pan::{Aim, Mount, MountAction};
    /// use mom_device::Statement;
    ///
    /// let script = Mount::script("look 20 -10; wait 500 # for the picture")?;
    /// assert_eq!(script.statements()[0], Statement::Do(MountAction::To(Aim::new(20.0, -10.0))));
    /// let error = Mount::script("home; lok 20 -10").unwrap_err();
    /// assert_eq!(error.to_string(), "statement 2: there is no `lok`; did you mean `look`?");
    /// # Ok::<(), mom_device::DeviceError>(())
    /// ```
    ///
    /// # Errors
    ///
    /// `syntax`, as of any device.
    pub fn script(text: &str) -> Result<Script<MountAction>, DeviceError> {
        Script::read::<Self>(text)
    }

    /// What it does now, by which any later image knows where it was taken: the turn under way, or the rest at the end of the last
    /// one.
    #[must_use]
    pub fn slew(&self) -> Slew {
        self.slew
    }

    /// Where it looks after a script, if each of its turns can be made from this aim on.
    pub(super) fn end(script: &Script<MountAction>, from: Aim) -> Result<Aim, DeviceError> {
        script.actions().try_fold(from, |aim, (turn, number)| {
            let target = turn.target(aim);
            target.check().map_err(|error| error.at_statement(number))?;
            Ok(target)
        })
    }
}

impl Machine for Mount {
    type Action = MountAction;

    const NAME: &str = "the camera";
    const VERBS: &[&str] = &["look", "turn", "home"];
    const STOPPING_TIME: DeviceTime = 200_000;
    // Degrees.
    const TOLERANCE: f64 = 0.1;

    fn card(&self) -> Card {
        let by = |name: &str| CardArg::number(name, "°");
        let turn = CardVerb {
            relative: true,
            ..CardVerb::motion("turn", "Turns by so much from where it looks")
        };
        Card::new("camera-mount", "Turns the camera")
            .verbs([
                CardVerb::motion("look", "Turns to these angles")
                    .args([by("pan").within(PANS), by("tilt").within(TILTS)]),
                turn.args([by("dpan"), by("dtilt")]),
                CardVerb::motion("home", "Turns to where it looks at the start"),
            ])
            .measures("pan", "°", "Where it looks: to the left")
            .measures("tilt", "°", "Where it looks: upwards")
    }

    fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<MountAction, DeviceError>> {
        let mut angles = |takes, names: [&str; 2]| {
            let mut angle = |which| words.number(verb.text, takes, which);
            Ok(Aim::new(angle(names[0])?, angle(names[1])?))
        };
        Some(match verb.text {
            "look" => angles("two angles, pan tilt", ["pan", "tilt"]).map(MountAction::To),
            "turn" => angles("two angles, dpan dtilt", ["dpan", "dtilt"]).map(MountAction::By),
            "home" => Ok(MountAction::Home),
            _ => return None,
        })
    }

    fn is_relative(action: &MountAction) -> Option<bool> {
        Some(matches!(action, MountAction::By(_)))
    }

    fn is_moving(&self) -> bool {
        self.slew.ends() > self.now
    }

    fn plan(&mut self, script: &Script<MountAction>) -> Result<(), DeviceError> {
        self.planned = Self::end(script, self.planned)?;
        Ok(())
    }

    fn begin(&mut self, action: &MountAction, now: DeviceTime) -> Result<(), DeviceError> {
        self.trace(now);
        let aim = self.slew.at(now);
        self.slew = Slew::new(aim, action.target(aim), now);
        Ok(())
    }

    fn done_at(&self) -> Option<DeviceTime> {
        Some(self.slew.ends())
    }

    fn halt(&mut self, now: DeviceTime) {
        self.trace(now);
        let aim = self.slew.at(now);
        (self.slew, self.planned) = (Slew::rest(aim), aim);
    }

    fn advance(&mut self, now: DeviceTime) {
        self.trace(now);
        self.now = now;
    }

    /// `{pan, tilt}`.
    fn position(&self) -> Map {
        self.slew.at(self.now).to_map()
    }
}

#[cfg(test)]
mod tests {
    use mom_device::{Command, CommandQueue, ErrorName, Order, QueueEvent};
    use proptest::prelude::*;

    use super::super::slew::{PAN_SPEED, TILT_SPEED};
    use super::*;

    fn command(script: &str) -> Command<MountAction> {
        Command {
            order: Order {
                peer: "alice".into(),
                id: None,
                fence: None,
            },
            script: Mount::script(script).expect("a script"),
            use_by: None,
        }
    }

    fn aim_of(mount: &CommandQueue<Mount>) -> Aim {
        let mount = mount.machine();
        mount.slew().at(mount.now)
    }

    fn pan_of(state: &mom_device::State) -> f64 {
        match state.position.get("pan") {
            Some(mom_client::Value::Double(pan)) => *pan,
            other => panic!("pan is {other:?}"),
        }
    }

    /// What may be done to a mount, and how many µs later.
    #[derive(Debug, Clone)]
    enum Deed {
        Submit(String),
        Halt,
        Stop,
        Unstop,
        Nothing,
    }

    fn deed() -> impl Strategy<Value = (Deed, DeviceTime)> {
        let angle = || -200.0..200.0_f64;
        let statement = prop_oneof![
            (angle(), angle()).prop_map(|(pan, tilt)| format!("look {pan} {tilt}")),
            (-40.0..40.0, -20.0..20.0).prop_map(|(pan, tilt)| format!("turn {pan} {tilt}")),
            Just("home".to_owned()),
            (0..900).prop_map(|ms| format!("wait {ms}")),
        ];
        let script = proptest::collection::vec(statement, 1..4).prop_map(|all| all.join(";"));
        let deed = prop_oneof![
            6 => script.prop_map(Deed::Submit),
            1 => Just(Deed::Halt),
            1 => Just(Deed::Stop),
            2 => Just(Deed::Unstop),
            4 => Just(Deed::Nothing),
        ];
        (deed, 0..1_500_000_i64)
    }

    proptest! {
        /// Whatever is done to it: it stays within reach, is never too fast, ends each command once, and ends where it
        /// was to look.
        #[test]
        fn it_keeps_what_it_promises(deeds in proptest::collection::vec(deed(), 1..30)) {
            let (mut mount, mut now, mut events) = (CommandQueue::new(Mount::default()), 0, Vec::new());
            let mut before = (0, HOME);
            let (mut taken, mut ended) = (0, 0);
            for (deed, later) in deeds {
                match &deed {
                    Deed::Submit(script) => taken += usize::from(mount.submit(command(script), now, &mut events).is_ok()),
                    Deed::Halt => mount.halt(now, "a test", &mut events),
                    Deed::Stop => mount.stop(now, "a test", ErrorName::Stopped, &mut events),
                    Deed::Unstop => mount.unstop(now, &mut events),
                    Deed::Nothing => mount.advance(now, &mut events),
                }
                if matches!(deed, Deed::Halt | Deed::Stop) {
                    prop_assert!(!mount.machine().is_moving() && !mount.is_busy());
                }
                let until = now + later;
                while let Some(due) = mount.next_wake().filter(|due| *due < until) {
                    prop_assert!(due >= now, "no wake lies in the past");
                    now = due;
                    mount.advance(now, &mut events);
                    let aim = aim_of(&mount);
                    prop_assert!(aim.check().is_ok(), "{aim}");
                    let seconds = (now - before.0) as f64 / 1e6;
                    prop_assert!((aim.pan - before.1.pan).abs() <= PAN_SPEED * seconds + 1e-6);
                    prop_assert!((aim.tilt - before.1.tilt).abs() <= TILT_SPEED * seconds + 1e-6);
                    before = (now, aim);
                }
                now = until;
            }
            let planned = mount.machine().planned;
            while let Some(due) = mount.next_wake() {
                mount.advance(due, &mut events);
            }
            prop_assert_eq!(aim_of(&mount), planned, "it ends where it was to look");
            for event in &events {
                ended += usize::from(matches!(event, QueueEvent::Finished(_) | QueueEvent::Failed(..)));
            }
            prop_assert_eq!((ended, mount.is_busy()), (taken, false));
            let seqs: Vec<u64> = events.iter().filter_map(|event| match event {
                QueueEvent::State(state) => Some(state.seq),
                _ => None,
            }).collect();
            prop_assert!(seqs.is_sorted_by(|a, b| a < b), "{:?}", seqs);
        }
    }

    #[test]
    fn a_turn_takes_its_time_and_is_told_at_20_hz() {
        let (mut mount, mut events) = (CommandQueue::new(Mount::default()), Vec::new());
        mount
            .submit(command("turn 60 0"), 0, &mut events)
            .expect("it can");
        while let Some(due) = mount.next_wake() {
            mount.advance(due, &mut events);
        }
        let states: Vec<(f64, bool)> = events
            .iter()
            .filter_map(|event| match event {
                QueueEvent::State(state) => Some((pan_of(state), state.moving)),
                _ => None,
            })
            .collect();
        assert_eq!(states.len(), 21, "{states:?}");
        assert_eq!(states[9], (30.0, true));
        assert_eq!(states[19], (60.0, false));
        assert_eq!(states[20], (60.0, false), "it has measured that it rests");
    }

    #[test]
    fn a_command_that_is_too_old_takes_those_behind_it_along() {
        let (mut mount, mut events) = (CommandQueue::new(Mount::default()), Vec::new());
        let fresh = Command {
            use_by: Some(100_000),
            ..command("home")
        };
        for command in [command("wait 200"), fresh, command("turn 1 0")] {
            mount.submit(command, 0, &mut events).expect("it can");
        }
        mount.advance(200_000, &mut events);
        let errors: Vec<ErrorName> = events
            .iter()
            .filter_map(|event| match event {
                QueueEvent::Failed(_, error) => Some(error.name()),
                _ => None,
            })
            .collect();
        assert_eq!(errors, [ErrorName::TooOld, ErrorName::Halted]);
        assert!(!mount.is_busy());
    }
}
