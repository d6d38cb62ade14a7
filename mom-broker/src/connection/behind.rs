//! What has come behind something that its sender's connection waits for: read on so far that a stop need not wait.

use std::collections::VecDeque;

use mom_net::NetError;
use mom_proto::codec::Frame;
use mom_proto::{Code, ContextNumber, Family, Parcel, Verb, WireError};

/// Parcels and bytes that are read on at most, so that the network goes on holding the sender back.
const MOST_PARCELS: usize = 256;
const MOST_BYTES: usize = 64 * 1024;

/// What a parcel needs, about, besides its content.
const SLOTS: usize = 128;

/// What stands at one turn.
#[derive(Debug)]
pub(super) enum Queued {
    Frame(Frame),
    /// One that is handled already: it is only counted when its turn comes, as [`checksum_word`] says.
    Passed(Option<u32>),
}

/// Parcels in their order that were read while one before them waited.
#[derive(Debug, Default)]
pub(super) struct Behind {
    parcels: VecDeque<Queued>,
    bytes: usize,
    /// What follows them is broken.
    fault: Option<NetError>,
}

impl Behind {
    /// About how many bytes they hold.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Whether one more is read on.
    pub(super) fn takes_more(&self) -> bool {
        self.fault.is_none() && self.parcels.len() < MOST_PARCELS && self.bytes < MOST_BYTES
    }

    /// Whether bytes are read on, while so many are here of parcels that are not taken yet.
    pub(super) fn reads_on(&self, held: usize) -> bool {
        self.takes_more() && self.bytes + held < MOST_BYTES
    }

    pub(super) fn push(&mut self, frame: Frame) {
        self.bytes += size(&frame);
        self.parcels.push_back(Queued::Frame(frame));
    }

    /// Nothing that follows can be read.
    pub(super) fn break_off(&mut self, fault: NetError) {
        self.fault = Some(fault);
    }

    /// What is wrong behind all these, once they are taken out.
    pub(super) fn fault(self) -> Option<NetError> {
        self.fault
    }

    /// The next one.
    pub(super) fn pop(&mut self) -> Option<Queued> {
        let next = self.parcels.pop_front()?;
        if let Queued::Frame(frame) = &next {
            self.bytes -= size(frame);
        }
        Some(next)
    }

    /// Whether a parcel that comes behind all these is handled before them: a stop, unless they decide whether its sender may say
    /// it; a sign of life; and a renewal, unless they concern a token.
    pub(super) fn lets_pass(&self, frame: &Frame) -> bool {
        match frame {
            Frame::Parcel(parcel) => match Verb::of(parcel.family, &parcel.name) {
                // Not `resent`, which tells those before it from those behind.
                Ok(Verb::Ping | Verb::Pong | Verb::Ack) => true,
                Ok(Verb::Stop) => !self.holds(|parcel| parcel.family == Family::Login || is_join(parcel)),
                Ok(Verb::Renew) => {
                    !self.holds(|parcel| matches!(parcel.family, Family::Login | Family::Token))
                }
                _ => false,
            },
            Frame::Malformed { .. } => false,
        }
    }

    /// Notes that a parcel behind all these has passed them.
    pub(super) fn note_passed(&mut self, frame: &Frame) {
        self.parcels.push_back(Queued::Passed(checksum_word(frame)));
    }

    /// Takes out each `unstop` that a stop which passes takes back; gives their ids. `number` says which context is meant.
    pub(super) fn withdraw(
        &mut self,
        stop: &Parcel,
        number: impl Fn(&Parcel) -> Option<ContextNumber>,
    ) -> Vec<Option<u64>> {
        let context = number(stop);
        let mut withdrawn = Vec::new();
        for place in &mut self.parcels {
            let taken_back = |parcel: &Parcel| {
                Verb::of(parcel.family, &parcel.name) == Ok(Verb::Unstop)
                    && number(parcel) == context
                    && overlap(parcel, stop)
            };
            if let Queued::Frame(frame) = place
                && let Frame::Parcel(parcel) = &*frame
                && taken_back(parcel)
            {
                withdrawn.push(parcel.id);
                self.bytes -= size(frame);
                *place = Queued::Passed(checksum_word(frame));
            }
        }
        withdrawn
    }

    fn holds(&self, what: impl Fn(&Parcel) -> bool) -> bool {
        self.parcels
            .iter()
            .any(|place| matches!(place, Queued::Frame(Frame::Parcel(parcel)) if what(parcel)))
    }
}

/// What the sender of an `unstop` hears that a stop of its own has taken back.
pub(super) fn withdrawn() -> WireError {
    let text = "a stop was sent after it, before it was processed";
    WireError::new(Code::WITHDRAWN, text)
}

/// Its word in the checksum of a link; none of what nobody could read.
pub(super) fn checksum_word(frame: &Frame) -> Option<u32> {
    match frame {
        Frame::Parcel(parcel) => Some(parcel.checksum_word()),
        Frame::Malformed { .. } => None,
    }
}

fn size(frame: &Frame) -> usize {
    match frame {
        Frame::Parcel(parcel) => SLOTS + parcel.size(),
        Frame::Malformed { .. } => SLOTS,
    }
}

fn is_join(parcel: &Parcel) -> bool {
    Verb::of(parcel.family, &parcel.name) == Ok(Verb::Join)
}

/// Whether some peer is an addressee of both.
fn overlap(one: &Parcel, other: &Parcel) -> bool {
    match (&one.address, &other.address) {
        (Some(one), Some(other)) => one.iter().any(|name| other.contains(name)),
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use mom_proto::Path;

    use super::*;

    fn said(family: Family, name: &str) -> Parcel {
        Parcel::new(family, name).context(Path::parse("/robot/arm").expect("a path"))
    }

    fn frame(parcel: Parcel) -> Frame {
        Frame::Parcel(Box::new(parcel))
    }

    fn behind(parcels: impl IntoIterator<Item = Parcel>) -> Behind {
        let mut behind = Behind::default();
        parcels.into_iter().for_each(|parcel| behind.push(frame(parcel)));
        behind
    }

    #[test]
    fn what_passes_depends_on_what_it_would_pass() {
        let cases = [
            ("message stop", "message block", true),
            ("message stop", "message command", true),
            ("message stop", "token grab", true),
            ("message stop", "context join", false),
            ("message stop", "login login", false),
            ("time ping", "login login", true),
            ("time pong", "context join", true),
            ("time ack", "message block", true),
            ("time resent", "message block", false),
            ("token renew", "message block", true),
            ("token renew", "token grab", false),
            ("token renew", "login login", false),
            ("token release", "message block", false),
            ("message unstop", "message block", false),
            ("message chat", "message block", false),
            ("context info", "message block", false),
        ];
        let parcel = |words: &str| {
            let (family, name) = words.split_once(' ').expect("two words");
            said(Family::from_word(family).expect("a family"), name)
        };
        for (comes, waits, passes) in cases {
            let behind = behind([parcel(waits)]);
            assert_eq!(
                behind.lets_pass(&frame(parcel(comes))),
                passes,
                "{comes} behind {waits}"
            );
        }
        let malformed = Frame::Malformed {
            reference: None,
            error: withdrawn(),
        };
        assert!(!Behind::default().lets_pass(&malformed));
    }

    #[test]
    fn a_stop_takes_back_each_unstop_before_it_that_concerns_the_same_device() {
        let unstop = |id: u64, path: &str, to: &[&str]| {
            let mut parcel = said(Family::Message, "unstop")
                .context(Path::parse(path).expect("a path"))
                .id(id);
            let to: Vec<_> = to.iter().map(|name| (*name).into()).collect();
            parcel.address = Some(to).filter(|to| !to.is_empty());
            parcel
        };
        let mut behind = behind([
            unstop(1, "/robot/arm", &[]),
            said(Family::Message, "command").id(2),
            unstop(3, "/other/arm", &[]),
            unstop(4, "/robot/arm", &["arm", "rover"]),
            unstop(5, "/robot/arm", &["camera"]),
        ]);
        let before = behind.bytes();
        let mut stop = said(Family::Message, "stop");
        stop.address = Some(vec!["arm".into()]);
        let number = |parcel: &Parcel| {
            let other = parcel
                .context
                .as_ref()
                .is_some_and(|path| path.as_str() == "/other/arm");
            Some(ContextNumber(u64::from(other)))
        };
        assert_eq!(behind.withdraw(&stop, number), [Some(1), Some(4)]);
        behind.note_passed(&frame(stop));
        assert!(behind.bytes() < before);
        let left: Vec<_> = std::iter::from_fn(|| behind.pop())
            .map(|next| match next {
                Queued::Frame(Frame::Parcel(parcel)) => Ok(parcel.id),
                Queued::Frame(malformed) => panic!("{malformed:?}"),
                Queued::Passed(word) => Err(word),
            })
            .collect();
        assert_eq!(
            left,
            [
                Err(Some(1)),
                Ok(Some(2)),
                Ok(Some(3)),
                Err(Some(4)),
                Ok(Some(5)),
                Err(Some(0))
            ],
            "each in its place, with its word"
        );
        assert_eq!(behind.bytes(), 0);
    }

    #[test]
    fn so_much_is_read_on_and_no_more() {
        let mut many = behind((0..MOST_PARCELS - 1).map(|_| said(Family::Time, "resent")));
        assert!(many.takes_more());
        many.note_passed(&frame(said(Family::Message, "stop")));
        assert!(!many.takes_more(), "those that have passed count, too");
        let large = said(Family::Message, "block").content("x".repeat(MOST_BYTES));
        assert!(!behind([large]).takes_more());
        let few = behind([said(Family::Message, "chat")]);
        assert!(few.reads_on(MOST_BYTES / 2) && !few.reads_on(MOST_BYTES));
    }

    #[test]
    fn a_fault_comes_behind_what_was_read() {
        let mut behind = behind([said(Family::Message, "chat")]);
        behind.break_off(NetError::Wire(withdrawn()));
        assert!(!behind.takes_more());
        assert!(matches!(behind.pop(), Some(Queued::Frame(_))) && behind.pop().is_none());
        assert!(behind.fault().is_some());
    }
}
