//! Dialogues: text files that say who says what and who hears what.
//!
//! A dialogue reads like a manual and runs as a test, unchanged over every transceiver ([`Carrier`]), against a
//! broker of its own whose clock stands still until the dialogue moves it. One line is one step:
//!
//! ```text
//! # a comment
//! config config/mom.toml          another configuration than config/lab.toml, or lines of it, indented:
//! config
//!     root = "open"
//!
//! connect alice bob               links, and logins with the name as password
//! connect bob as bob~2            the name that the hub is to give
//! connect carol nickname=cap as cap
//! link eve                        a link without a login
//! alice joins /robot /robot/arm   joins, each answered with ok
//! ignore joined left              events that nobody waits for from here on
//! clock +181s                     time passes: ms, s, m or h
//! alice gone                      the link is cut
//!
//! alice: grab /robot/token        says: the verb and the path; create also the kind
//! alice: give /robot/token to=bob for=60000     further words are members of the content
//! alice: create /lab channel guard={token=/robot/token names=[command]}
//! alice: send /robot/arm command "grip open" to=[arm] fence=1 receipt no-echo colour=red
//! eve: login eve password=guess
//! carol: verdict consult=1 allow=true           the answer to a question of the hub
//! eve: parcel context grib context=/robot       any family and name, any slots
//!
//! alice< ok fence=1               hears: a reply, with these members in its content
//! bob< error held owner=alice retry-after=180000 text*="renews it"
//! alice< event released /robot/token owner=alice reason=expired by=bob
//! alice< message command "grip open" in=/robot/arm from=alice fence=1
//! carol< consult /robot id=1 verb=join peer=bob        a question, and its number
//! alice< pong
//! alice< nothing                  two round trips bring nothing else
//! eve< closed                     the link ends
//! ```
//!
//! What one peer hears is matched in order, and only what is written is compared: in maps the members that are
//! written, of strings after `*=` a part. A `fence`, and a `stop`, is its number without the epoch. Whatever a peer hears
//! that no line expects fails the dialogue, up to its end. An answer has to refer to a request that was
//! open, and at the end none may be.
//!
//! Values are written as in requests above: `null`, `true`, `-3`, `0.5`, `word`, `"any string"`,
//! `2026-11-21T10:00:00Z`, `hex:00ff`, `[1 2]`, `{key=value}`. Content that is a string stands in quotes.

mod carrier;
mod hear;
mod notation;
mod peer;
mod program;
mod runner;
mod say;
mod script;
mod show;

use std::path::Path;

pub use carrier::Carrier;
pub use program::{CLIENTS, Client};
use script::Script;

/// A dialogue that did not go as written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A line that is not a line of a dialogue.
    #[error("line {line}: {text}")]
    Notation {
        /// From 1.
        line: usize,
        /// What is wrong.
        text: String,
    },
    /// A broker that does not start.
    #[error("the broker does not start: {0}")]
    Broker(String),
    /// A peer heard something else.
    #[error("line {line}: {said}\n{text}\n\nthe dialogue up to there:\n{transcript}")]
    Otherwise {
        /// From 1; the last line for what was still to be heard at the end.
        line: usize,
        /// The line.
        said: String,
        /// What was heard instead.
        text: String,
        /// All that was said and heard before, one line each.
        transcript: String,
    },
}

/// A dialogue.
///
/// ```
/// # let runtime = tokio::runtime::Runtime::new().unwrap();
/// use mom_tests::dialogue::{Carrier, Dialogue};
///
/// let dialogue = Dialogue::parse("connect alice\nalice: lookup /chat\nalice< ok kind=channel\n").unwrap();
/// runtime.block_on(dialogue.run(Carrier::Local)).unwrap();
/// ```
#[derive(Debug)]
pub struct Dialogue {
    script: Script,
}

impl Dialogue {
    /// Reads a dialogue.
    ///
    /// # Errors
    /// [`Error::Notation`] for a line that is none.
    pub fn parse(text: &str) -> Result<Dialogue, Error> {
        Script::parse(text).map(|script| Dialogue { script })
    }

    /// Runs it against a broker of its own; asserts the hub's invariants after each line.
    ///
    /// # Errors
    /// What went otherwise than written.
    pub async fn run(&self, carrier: Carrier) -> Result<(), Error> {
        runner::run(&self.script, carrier).await
    }
}

/// The folder in which the configurations of the project lie.
pub(crate) fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}
