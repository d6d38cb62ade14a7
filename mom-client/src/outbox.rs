//! What waits to be written: control before messages, except where control gives something up.

use std::collections::VecDeque;

use mom_net::Outgoing;
use mom_proto::{Family, Parcel, Path};

/// Handed to the writer at once: small, so that control waits for little.
const BATCH: usize = 64 * 1024;

/// The two queues of one link. The first is bounded by what a peer asks at a time; for the second its
/// senders wait for room.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    control: VecDeque<Control>,
    messages: VecDeque<Message>,
    put: u64,
    taken: u64,
    finished: bool,
}

#[derive(Debug)]
struct Control {
    /// Messages that go first.
    after: u64,
    outgoing: Outgoing,
}

/// A message with the room that it takes.
#[derive(Debug)]
pub(crate) struct Message {
    pub(crate) room: u32,
    pub(crate) path: Option<Path>,
    pub(crate) outgoing: Outgoing,
}

/// What the writer finds.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Found {
    /// Something to write, and room for messages again.
    Some { room: usize },
    /// Nothing yet.
    Nothing,
    /// Nothing, and never again.
    End,
}

impl Outbox {
    pub(crate) fn push_control(&mut self, parcel: &Parcel, outgoing: Outgoing) {
        // Control overtakes messages; but who gives up a token or a channel has sent these before.
        let after = if gives_up(parcel) { self.put } else { 0 };
        self.control.push_back(Control { after, outgoing });
    }

    pub(crate) fn push_message(&mut self, message: Message) {
        self.put += 1;
        self.messages.push_back(message);
    }

    /// Nothing follows what waits now.
    pub(crate) fn finish(&mut self) {
        self.finished = true;
    }

    /// Whether nothing should follow what waits.
    pub(crate) fn is_finished(&self) -> bool {
        self.finished
    }

    /// Moves a batch to the writer.
    pub(crate) fn take(&mut self, batch: &mut VecDeque<Outgoing>) -> Found {
        let (mut bytes, mut room) = (0, 0);
        while bytes < BATCH {
            let outgoing = match self.control.front() {
                Some(control) if control.after <= self.taken => {
                    self.control.pop_front().map(|control| control.outgoing)
                }
                _ => self.messages.pop_front().map(|message| {
                    self.taken += 1;
                    room += message.room as usize;
                    message.outgoing
                }),
            };
            let Some(outgoing) = outgoing else { break };
            bytes += outgoing.len();
            batch.push_back(outgoing);
        }
        match (batch.is_empty(), self.finished) {
            (false, _) => Found::Some { room },
            (true, false) => Found::Nothing,
            (true, true) => Found::End,
        }
    }

    /// Forgets everything, as its link is gone; gives the messages.
    pub(crate) fn clear(&mut self) -> Vec<Message> {
        self.control.clear();
        self.taken = self.put;
        self.messages.drain(..).collect()
    }
}

fn gives_up(parcel: &Parcel) -> bool {
    match (parcel.family, parcel.name()) {
        (Family::Context, "leave" | "delete") | (Family::Login, "logout") => true,
        (Family::Token, "release" | "give") => true,
        // An owner's answer to who asked; that to an offer gives nothing up.
        (Family::Token, "accept") => parcel.value().get("peer").is_some(),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn push(outbox: &mut Outbox, family: Family, name: &str) {
        let parcel = Parcel::new(family, name);
        let outgoing = Outgoing::Parcel(Arc::new(parcel.clone()));
        match family {
            Family::Message => outbox.push_message(Message {
                room: 1,
                path: None,
                outgoing,
            }),
            _ => outbox.push_control(&parcel, outgoing),
        }
    }

    fn taken(outbox: &mut Outbox) -> (Found, String) {
        let mut batch = VecDeque::new();
        let found = outbox.take(&mut batch);
        let names: Vec<String> = batch
            .iter()
            .map(|outgoing| match outgoing {
                Outgoing::Parcel(parcel) => parcel.name().to_owned(),
                Outgoing::Encoded(_) => "encoded".to_owned(),
            })
            .collect();
        (found, names.join(" "))
    }

    #[test]
    fn control_overtakes_messages_but_gives_up_after_them() {
        use Family::{Context, Login, Message, Time, Token};
        for (pushed, expected, room) in [
            (vec![(Message, "a"), (Time, "pong")], "pong a", 1),
            (
                vec![(Message, "a"), (Token, "grab"), (Message, "b")],
                "grab a b",
                2,
            ),
            (
                vec![(Message, "a"), (Token, "release"), (Message, "b")],
                "a release b",
                2,
            ),
            (
                vec![(Message, "a"), (Context, "leave"), (Context, "join")],
                "a leave join",
                1,
            ),
            (
                vec![(Message, "a"), (Context, "join"), (Login, "logout")],
                "join a logout",
                1,
            ),
            (
                vec![(Message, "a"), (Token, "decline"), (Token, "give")],
                "decline a give",
                1,
            ),
            (vec![(Message, "a"), (Token, "accept")], "accept a", 1),
            (vec![(Context, "delete")], "delete", 0),
        ] {
            let mut outbox = Outbox::default();
            pushed
                .iter()
                .for_each(|(family, name)| push(&mut outbox, *family, name));
            assert_eq!(taken(&mut outbox), (Found::Some { room }, expected.to_owned()));
            assert_eq!(taken(&mut outbox).0, Found::Nothing);
            outbox.finish();
            assert_eq!(taken(&mut outbox).0, Found::End);
        }
    }

    #[test]
    fn what_is_cleared_holds_nothing_back() {
        let mut outbox = Outbox::default();
        push(&mut outbox, Family::Message, "a");
        push(&mut outbox, Family::Token, "release");
        assert_eq!(outbox.clear().len(), 1);
        push(&mut outbox, Family::Token, "release");
        assert_eq!(taken(&mut outbox).1, "release");
    }
}
