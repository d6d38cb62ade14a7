//! The cases of `send-queue.json`, replayed by the send queues that are written in Rust: the README beside them says what a
//! step means.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Deserialize;

const SEND_QUEUE: &str = include_str!("../send-queue.json");

/// One case.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// What it shows.
    pub name: String,
    /// The queues that it concerns; none = all.
    on: Option<Vec<String>>,
    /// What happens, in this order.
    pub steps: Vec<Step>,
}

/// What happens, and what is heard of it.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Step {
    /// An item is put in.
    Put(Box<Item>),
    /// The queue is filled.
    Fill(String),
    /// The link takes these parcels, one by one.
    Takes(Vec<String>),
    /// The link takes the first chunk of a parcel.
    Begins(String),
    /// The link takes all that waits.
    Hears(Vec<String>),
    /// The connection is lost.
    Lose(bool),
    /// It is resumed: so many parcels were read.
    Resume(u64),
    /// What has been said to senders.
    Told(BTreeMap<String, String>),
    /// So many ms pass.
    Clock(u64),
}

/// What is put in.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Item {
    /// Its label.
    pub is: String,
    /// Its family.
    #[serde(default = "message")]
    pub family: String,
    /// Its name.
    pub name: String,
    /// Where it is said.
    #[serde(default = "arm")]
    pub context: String,
    /// To whom, if not to all.
    pub address: Option<Vec<String>>,
    /// Its class.
    pub delivery: Option<String>,
    /// Its priority.
    pub priority: Option<i32>,
    /// The bytes of its content.
    #[serde(default)]
    pub bytes: usize,
    /// After how many ms it is worthless.
    pub expires: Option<u64>,
    /// The fence that it names.
    pub fence: Option<u64>,
    /// The stop that an `unstop` names.
    pub stop: Option<u64>,
    /// Whom an `accept` answers.
    pub peer: Option<String>,
    /// Whether its sender's token guards it.
    #[serde(default)]
    pub guarded: bool,
    /// Whether its sender waits for the answer.
    #[serde(default)]
    pub awaited: bool,
    /// Whose it is, in the hub.
    pub sender: Option<String>,
}

fn message() -> String {
    "message".to_owned()
}

fn arm() -> String {
    "/robot/arm".to_owned()
}

impl Item {
    /// A message of class `reliable`, for [`Replay::fill`].
    pub fn reliable(label: &str) -> Item {
        Item {
            is: label.to_owned(),
            family: message(),
            name: "map".to_owned(),
            context: arm(),
            address: None,
            delivery: Some("reliable".to_owned()),
            priority: None,
            bytes: 0,
            expires: None,
            fence: None,
            stop: None,
            peer: None,
            guarded: false,
            awaited: false,
            sender: None,
        }
    }
}

impl Case {
    /// All items that are put in.
    pub fn items(&self) -> impl Iterator<Item = &Item> {
        self.steps.iter().filter_map(|step| match step {
            Step::Put(item) => Some(&**item),
            _ => None,
        })
    }
}

/// A send queue with its link, as the cases need it. Parcels go by their labels.
pub trait Replay {
    /// Takes in an item, without waiting for room.
    fn put(&mut self, item: &Item);
    /// Takes in a `reliable` message, as large as still fits.
    fn fill(&mut self, label: &str);
    /// The link takes the first chunk of a parcel: of which.
    fn begin(&mut self) -> Option<String>;
    /// The link takes until it has a whole parcel more: which; none if nothing waits.
    fn take(&mut self) -> Option<String>;
    /// The connection is lost, and can be resumed.
    fn lose(&mut self);
    /// It is resumed, and so many parcels were read.
    fn resume(&mut self, read: u64);
    /// What senders were told since this was last asked.
    fn told(&mut self) -> BTreeMap<String, String>;
    /// So many ms pass.
    fn pass(&mut self, millis: u64);
    /// What the queue still counts as waiting, where nothing waits: none if it counts right.
    fn left_over(&mut self) -> Option<String>;
}

/// How one queue's words differ from those of the cases.
#[derive(Clone, Copy, Debug)]
pub struct Dialect {
    /// Its name in `on`.
    pub queue: &'static str,
    /// It says `time resent`.
    pub says_resent: bool,
    /// It says `unknown` of what had left when the connection was lost, and not `lost`.
    pub says_unknown: bool,
}

/// Replays all cases that concern a queue.
///
/// # Panics
/// With all that went otherwise, by case and step.
pub fn replay<R: Replay>(dialect: Dialect, mut new: impl FnMut(&Case) -> R) {
    let cases: Vec<Case> = serde_json::from_str(SEND_QUEUE).expect("send-queue.json is a list of cases");
    let concerns = |case: &&Case| {
        let on = case.on.as_ref();
        on.is_none_or(|on| on.iter().any(|queue| queue == dialect.queue))
    };
    let mut failures = String::new();
    for case in cases.iter().filter(concerns) {
        let mut queue = new(case);
        let mut steps = case.steps.iter().enumerate();
        let failed = steps.find_map(|(number, step)| Some((number, go(&mut queue, step, dialect).err()?)));
        if let Some((number, error)) = failed {
            let _ = writeln!(failures, "{}: step {}: {error}", case.name, number + 1);
        }
    }
    assert!(failures.is_empty(), "{}:\n{failures}", dialect.queue);
}

fn go(queue: &mut impl Replay, step: &Step, dialect: Dialect) -> Result<(), String> {
    let known = |label: &&String| dialect.says_resent || *label != "resent";
    match step {
        Step::Put(item) => queue.put(item),
        Step::Fill(label) => queue.fill(label),
        Step::Begins(label) => return equal("begins", &queue.begin(), &Some(label.clone())),
        Step::Takes(labels) => {
            let labels: Vec<String> = labels.iter().filter(known).cloned().collect();
            let taken: Vec<String> = labels.iter().map_while(|_| queue.take()).collect();
            return equal("takes", &taken, &labels);
        }
        Step::Hears(labels) => {
            let labels: Vec<String> = labels.iter().filter(known).cloned().collect();
            let heard: Vec<String> = std::iter::from_fn(|| queue.take()).collect();
            equal("hears", &heard, &labels)?;
            return equal("leaves over", &queue.left_over(), &None);
        }
        Step::Lose(_) => queue.lose(),
        Step::Resume(read) => queue.resume(*read),
        Step::Told(words) => {
            let word = |word: &String| match word.as_str() {
                "unknown" if !dialect.says_unknown => "lost".to_owned(),
                other => other.to_owned(),
            };
            let words = words.iter();
            let words = words.map(|(label, told)| (label.clone(), word(told)));
            return equal("told", &queue.told(), &words.collect());
        }
        Step::Clock(millis) => queue.pass(*millis),
    }
    Ok(())
}

fn equal<T: PartialEq + std::fmt::Debug>(what: &str, found: &T, expected: &T) -> Result<(), String> {
    match found == expected {
        true => Ok(()),
        false => Err(format!("{what} {found:?}, expected {expected:?}")),
    }
}
