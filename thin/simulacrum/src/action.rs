//! What a statement of a mirrored robot's scripts makes it do.

use std::sync::Arc;

use mom_client::{CardArg, CardType, CardVerb};
use mom_device::{Attachments, DeviceError, Word, Words};
use mom_rsp_model::Model;

/// The most elements whose names a card lists.
const MOST_NAMED: usize = 100;
/// The longest time for which one statement sets an effector, ms.
const LONGEST: i32 = 60_000;
const PLAY: &str = "an effector, the sound's name, and maybe `on`: play speaker hello";
const SHOW: &str = "an effector and the picture's name: show lcd face";
const SET: &str = "elements with their values, and maybe `for` and a time in ms: set left-wheel 100 right-wheel 100 for 1000";

/// What a statement makes the robot do.
///
/// | statement | does |
/// |---|---|
/// | those of a fleet's robots | drive a robot that has wheels: [`mom_wheeled::Action`] |
/// | `set left-wheel 100 right-wheel 100 for 1000` | sets effectors, in the units of the model, for so many ms; then they take their safe
/// values. Without `for` they stay; a speed needs it |
/// | `do gesture 3` | has a command executed once; done when the robot has acknowledged it (S19, S20) |
/// | `play speaker hello`, `play speaker song on` | plays the attachment of that name, a WAV file, in blocks of 20 ms (S13); done when it
/// was heard, or with `on` at once, and the next statements are carried out beside it. A halt ends it |
/// | `show lcd face` | hands the attachment of that name to an effector of type bytes |
/// | `activate motion`, `deactivate motion` | an element, or all members of a module (S6, S7) |
/// | `ask camera` | has a sensor or monitor say its value now, or a memory event be said again (S22) |
/// | `period 40` | the time between two packets, ms (S10) |
/// | `clear` | has the robot clear its buffers of memory events (S16) |
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// What wheeled robots do.
    Wheels(mom_wheeled::Action),
    /// Sets effectors.
    Set {
        /// Which, to what.
        settings: Vec<Setting>,
        /// For so many ms.
        ms: Option<u32>,
    },
    /// Plays a sound.
    Play {
        /// Where.
        element: String,
        /// What.
        sound: Attached,
        /// While the next statements are carried out.
        on: bool,
    },
    /// Hands bytes to an effector.
    Show {
        /// To which.
        element: String,
        /// What.
        bytes: Attached,
    },
    /// Executes a command.
    Do(Setting),
    /// Activates an element, or deactivates it.
    Activate {
        /// Which.
        element: String,
        /// Whether it is to be active.
        active: bool,
    },
    /// Asks an element.
    Ask(String),
    /// Sets the period, ms.
    Period(u16),
    /// Clears the robot's buffers.
    Clear,
}

/// An element with its values, in the units of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// Its name.
    pub element: String,
    /// Its values.
    pub values: Vec<f64>,
}

/// An attachment that a statement names.
#[derive(Clone, PartialEq)]
pub struct Attached {
    /// Its name.
    pub name: String,
    /// Its bytes, once the script was read with its attachments.
    pub bytes: Arc<[u8]>,
}

impl std::fmt::Debug for Attached {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Attached({:?}, {} bytes)", self.name, self.bytes.len())
    }
}

impl Attached {
    fn named(word: Word<'_>) -> Self {
        Self {
            name: word.text.to_owned(),
            bytes: Arc::default(),
        }
    }
}

const WHEELS: &[&str] = mom_wheeled::Action::VERBS;
const MODELS: &[&str] = mom_wheeled::Action::OF_MODELS;

/// Both lists in one.
const fn joined() -> [&'static str; WHEELS.len() + MODELS.len()] {
    let mut verbs = [""; WHEELS.len() + MODELS.len()];
    let (wheels, models) = verbs.split_at_mut(WHEELS.len());
    wheels.copy_from_slice(WHEELS);
    models.copy_from_slice(MODELS);
    verbs
}

impl Action {
    /// The verbs: those of wheeled robots, and those of models.
    pub const VERBS: &[&str] = &joined();

    /// The statements of a model as others see them; which elements each is for is checked by the model.
    pub(crate) fn verbs_of_models(model: &Model) -> [CardVerb; 9] {
        let names: Vec<&str> = model.elements().iter().map(|element| &*element.name).collect();
        // A card has its bounds.
        let names = if names.len() <= MOST_NAMED {
            &names[..]
        } else {
            &[]
        };
        let element = || CardArg::one_of("element", names);
        // Or a module.
        let part = || CardArg::new("part", CardType::Word);
        let value = || CardArg::new("value", CardType::Number);
        let attached = || CardArg::new("name", CardType::Attachment);
        let periods = f64::from(*mom_rsp::PERIODS.start())..=f64::from(*mom_rsp::PERIODS.end());
        [
            // The values of an element and `for` with a time stand among the words.
            CardVerb::motion(
                "set",
                "Sets effectors: an element and its values, and maybe `for` and ms",
            )
            .args([element(), CardArg::new("value", CardType::Word)])
            .repeating(1),
            CardVerb::motion("do", "Has a command executed once")
                .args([element(), value()])
                .repeating(1),
            CardVerb::new("play", "Plays a WAV file").args([
                element(),
                attached(),
                CardArg::one_of("beside", &["on"]).or(""),
            ]),
            CardVerb::new("show", "Hands bytes to an effector, such as a picture")
                .args([element(), attached()]),
            CardVerb::new("activate", "Activates an element or a module").args([part()]),
            CardVerb::new("deactivate", "Deactivates an element or a module").args([part()]),
            CardVerb::new("ask", "Has a sensor or monitor say its value now").args([element()]),
            CardVerb::new("period", "Sets the time between two packets")
                .args([CardArg::whole("ms", "ms").within(periods)]),
            CardVerb::new("clear", "Has the robot clear its buffers of memory events"),
        ]
    }

    /// Reads what follows a verb; `None` if there is no such verb.
    ///
    /// # Errors
    ///
    /// `syntax`, at the word that is wrong.
    pub fn read(verb: Word<'_>, words: &mut Words<'_>) -> Option<Result<Self, DeviceError>> {
        let one = "the name of an element";
        Some(match verb.text {
            "set" => set(words),
            "do" => command(words),
            "play" => play(words),
            "show" => words.need("show", SHOW, "the effector").and_then(|element| {
                Ok(Self::Show {
                    element: named(element)?.element,
                    bytes: Attached::named(words.need("show", SHOW, "the picture")?),
                })
            }),
            "activate" | "deactivate" => {
                words
                    .need(verb.text, one, "the element")
                    .map(|word| Self::Activate {
                        element: word.text.to_owned(),
                        active: verb.text == "activate",
                    })
            }
            "ask" => words
                .need("ask", one, "the element")
                .map(|word| Self::Ask(word.text.to_owned())),
            "period" => {
                let range = i32::from(*mom_rsp::PERIODS.start())..=i32::from(*mom_rsp::PERIODS.end());
                words
                    .whole("period", "ms between two packets", "it", range)
                    .map(|ms| Self::Period(u16::try_from(ms).unwrap_or(20)))
            }
            "clear" => Ok(Self::Clear),
            _ => return mom_wheeled::Action::read(verb, words).map(|read| read.map(Self::Wheels)),
        })
    }
}

impl Action {
    /// Takes the bytes that it names.
    ///
    /// # Errors
    ///
    /// `syntax` if they did not come with the script.
    pub fn attach(&mut self, attachments: &Attachments) -> Result<(), DeviceError> {
        match self {
            Self::Play { sound: attached, .. } | Self::Show { bytes: attached, .. } => {
                attached.bytes = attachments.get(&attached.name)?;
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

fn play(words: &mut Words<'_>) -> Result<Action, DeviceError> {
    let element = named(words.need("play", PLAY, "the effector")?)?.element;
    let sound = Attached::named(words.need("play", PLAY, "the sound")?);
    let on = match words.next() {
        None => false,
        Some(word) if word.text == "on" => true,
        Some(word) => {
            let text = format!("`play` takes {PLAY}, and not `{}`", word.short());
            return Err(DeviceError::syntax(word.at, text));
        }
    };
    Ok(Action::Play { element, sound, on })
}

fn set(words: &mut Words<'_>) -> Result<Action, DeviceError> {
    let mut settings: Vec<Setting> = Vec::new();
    let mut next = Some(words.need("set", SET, "the element")?);
    while let Some(word) = next {
        if word.text == "for" && !settings.is_empty() {
            let ms = words.whole("set", SET, "the time after `for`", 1..=LONGEST)?;
            let ms = u32::try_from(ms).ok();
            return Ok(Action::Set { settings, ms });
        }
        match (number(word), settings.last_mut()) {
            (Some(value), Some(setting)) => setting.values.push(value),
            _ => settings.push(named(word)?),
        }
        next = words.next();
    }
    Ok(Action::Set { settings, ms: None })
}

fn command(words: &mut Words<'_>) -> Result<Action, DeviceError> {
    let takes = "a command and its values: do gesture 3";
    let mut setting = named(words.need("do", takes, "the command")?)?;
    while !words.is_over() {
        setting.values.push(words.number("do", takes, "a value")?);
    }
    Ok(Action::Do(setting))
}

fn named(word: Word<'_>) -> Result<Setting, DeviceError> {
    if !word.text.starts_with(|first: char| first.is_ascii_lowercase()) {
        let text = format!("`{}` is not the name of an element", word.short());
        return Err(DeviceError::syntax(word.at, text));
    }
    Ok(Setting {
        element: word.text.to_owned(),
        values: Vec::new(),
    })
}

/// No name of an element begins as a number does; `inf` and `nan` could be names.
fn number(word: Word<'_>) -> Option<f64> {
    let begins = |first: char| first.is_ascii_digit() || matches!(first, '-' | '+' | '.');
    let value: f64 = word.text.parse().ok()?;
    (word.text.starts_with(begins) && value.is_finite()).then_some(value)
}
