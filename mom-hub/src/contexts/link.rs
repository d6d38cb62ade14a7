//! What the loss of a connection, or its return, means where its peer is: devices are made safe, members are told.

use std::sync::Arc;

use mom_proto::ContextNumber;
use mom_proto::event;

use crate::world::World;
use crate::world::events::peer_map;
use crate::world::steps::{Job, LinkNews, STEP, TOLD, told};
use crate::{Effect, PeerId};

impl World {
    /// Makes safe what a peer owns that has lost its connection, then tells the members of what it has joined; or tells
    /// them that it is back. Much of that is done in steps.
    pub(crate) fn tell_of_link(&mut self, peer: PeerId, out: &mut Vec<Effect>) {
        let Some(known) = self.peers.get(peer) else {
            return self.fault("reporting a peer that does not exist to members");
        };
        let lost = known.lost.is_some();
        let mut news = LinkNews {
            peer,
            lost,
            halts: known.owns.iter().copied().filter(|_| lost).collect(),
            told: known.owns.union(&known.joined).copied().collect(),
        };
        if !self.link_step(&mut news, out) {
            self.begin_job(Job::Link(news));
        }
    }

    /// One step; true with the last.
    pub(super) fn link_step(&mut self, news: &mut LinkNews, out: &mut Vec<Effect>) -> bool {
        let start = out.len();
        for _ in 0..STEP {
            if let Some(token) = news.halts.pop() {
                self.halt_owned(token, news.peer, out);
            } else if let Some(context) = news.told.pop() {
                self.push_news(context, news.peer, news.lost, out);
            } else {
                return true;
            }
            if told(&out[start..]) >= TOLD {
                break;
            }
        }
        news.halts.is_empty() && news.told.is_empty()
    }

    /// Tells the members of a context, or whom a token concerns, unless that has changed since the first step.
    fn push_news(&mut self, context: ContextNumber, peer: PeerId, lost: bool, out: &mut Vec<Effect>) {
        let known = self.peers.get(peer);
        let Some(known) = known.filter(|known| known.lost.is_some() == lost) else {
            return;
        };
        if known.owns.contains(&context) {
            return self.push_link(context, peer, out);
        }
        let facts = Arc::clone(&known.facts);
        let content = peer_map(&facts);
        match known.lost {
            Some(until) => {
                let content = content.with("within", self.millis_until(until));
                self.push_by_name(context, event::LOST, (&facts, content), out);
            }
            None => self.push_by_name(context, event::RESUMED, (&facts, content), out),
        }
    }
}
