//! The invariants, stated and asserted (design §4).

use std::collections::BTreeSet;

use mom_proto::{Card, ContextNumber, Fence};

use crate::token::state::Token;
use crate::tree::context::Context;
use crate::tree::peers::Peer;
use crate::world::Timer;
use crate::{Hub, PeerId};

impl Hub {
    /// Asserts what holds after every input; every test calls it after each.
    ///
    /// - One owner at most, and it is there and knows that it owns.
    /// - The members of a context are members of its parent, and know it.
    /// - An owner is a member of its token's parent.
    /// - The fence of an owner is above all of the epochs before.
    /// - Guards and the tokens they name know each other.
    /// - A timer waits for exactly each deadline of a token.
    /// - A token is owned or shared, not both; each peer that waits, asks, is offered or holds is in its parent, and
    ///   knows it.
    /// - Requests on a token are held back only while a change of it is being stored.
    /// - Pending questions have a peer to answer them, and a timer.
    /// - A timer waits for exactly each peer that may come back.
    ///
    /// # Panics
    /// If one of them does not hold: the hub's own fault.
    pub fn check(&self) {
        self.world
            .tree
            .iter()
            .for_each(|context| self.check_context(context));
        for (id, peer) in self.world.peers.iter() {
            assert_eq!(
                self.world.peers.id_of(&peer.facts.name),
                Some(id),
                "names and peers agree"
            );
            for number in &peer.moves_in {
                let channel = self
                    .world
                    .tree
                    .get(*number)
                    .expect("where a device is, is a channel");
                assert!(
                    channel.members.get(&id).is_some_and(|member| member.device),
                    "{} is a device where it says so",
                    peer.facts.name
                );
            }
            self.check_cards(id, peer);
            for number in &peer.joined {
                let context = self.world.tree.get(*number).expect("a joined context exists");
                assert!(
                    context.members.contains_key(&id),
                    "{} is a member of {}",
                    peer.facts.name,
                    context.path
                );
            }
            for number in &peer.owns {
                let owner = self.world.token(*number).and_then(|token| token.owner.as_ref());
                assert_eq!(
                    owner.map(|owner| owner.peer),
                    Some(id),
                    "{} owns what it knows",
                    peer.facts.name
                );
            }
        }
        let lost = self.world.peers.iter();
        let lost = lost.filter_map(|(id, peer)| Some((peer.lost?, Timer::Grace(id))));
        let timers = self.world.timers.iter().copied();
        let timers = timers.filter(|(_, timer)| matches!(timer, Timer::Grace(_)));
        assert_eq!(
            lost.collect::<BTreeSet<_>>(),
            timers.collect(),
            "who may come back has a timer"
        );
        self.questions.check();
        for (question, pending) in &self.questions.pending {
            assert!(
                self.world.peers.get(pending.request.peer).is_some(),
                "who asks is there"
            );
            assert!(!pending.asked.is_empty(), "a peer is asked");
            let timer = (pending.until, Timer::Answer(*question));
            assert!(self.world.timers.contains(&timer), "question {question} ends");
        }
        assert!(
            self.world.changed.is_empty() && self.world.grown.is_empty(),
            "changed routes were given out"
        );
        assert!(
            self.world.stirred.is_empty() && self.world.to_ask.is_empty(),
            "queues that were stirred were looked at"
        );
    }

    /// The room of a peer's cards is counted.
    fn check_cards(&self, id: PeerId, peer: &Peer) {
        let cards = peer.joined.iter().filter_map(|number| {
            let member = self.world.tree.get(*number)?.members.get(&id)?;
            member.card.as_deref().map(Card::size)
        });
        assert_eq!(
            cards.sum::<usize>(),
            peer.card_bytes,
            "the room of the cards of {} is counted",
            peer.facts.name
        );
    }

    fn check_context(&self, context: &Context) {
        let path = &context.path;
        assert_eq!(
            self.world.tree.find(path).map(|found| found.number),
            Some(context.number),
            "{path} is found"
        );
        let parent = context.parent.and_then(|parent| self.world.tree.get(parent));
        assert_eq!(
            parent.map(|parent| &parent.path),
            path.parent().as_ref(),
            "{path} lies in its parent"
        );
        for (id, member) in &context.members {
            let peer = self.world.peers.get(*id).expect("a member is there");
            assert!(
                peer.joined.contains(&context.number),
                "{} knows that it joined {path}",
                member.facts.name
            );
            assert_eq!(
                peer.moves_in.contains(&context.number),
                member.device,
                "{} knows whether it is a device in {path}",
                peer.facts.name
            );
            assert_eq!(
                peer.facts, member.facts,
                "facts of a member of {path} are of today"
            );
            let in_parent = parent.is_none_or(|parent| parent.members.contains_key(id));
            assert!(
                in_parent,
                "{} joined {path} through its parent (M23)",
                member.facts.name
            );
        }
        let guard = context.channel().and_then(|channel| channel.guard.as_ref());
        let token = guard.and_then(|guard| self.world.tree.token_at(&guard.token));
        if let (Some(guard), Some((_, token))) = (guard, token) {
            assert!(
                token.guarded.contains(&context.number),
                "{} knows that it guards {path}",
                guard.token
            );
        }
        self.check_token(context);
    }

    fn check_token(&self, context: &Context) {
        let Some(token) = context.token() else { return };
        let path = &context.path;
        let epoch = Fence::floor(self.world.settings.epoch);
        assert!(
            token.owner.is_none() || token.fence > epoch,
            "the fence of {path} is of this epoch"
        );
        let guarded: BTreeSet<ContextNumber> = token
            .guarded
            .iter()
            .copied()
            .filter(|channel| self.world.tree.get(*channel).is_some())
            .collect();
        assert_eq!(guarded, token.guarded, "{path} guards channels that exist");
        assert_eq!(
            token.timer,
            token.deadline(),
            "the timer of {path} is its deadline"
        );
        let timer = token.timer.map(|at| (at, Timer::Lease(context.number)));
        let timers: Vec<_> = self
            .world
            .timers
            .iter()
            .filter(|(_, timer)| *timer == Timer::Lease(context.number))
            .collect();
        assert_eq!(timers, timer.iter().collect::<Vec<_>>(), "one timer for {path}");
        self.check_waiting(context, token);
        let Some(owner) = &token.owner else { return };
        let peer = self.world.peers.get(owner.peer).expect("an owner is there");
        assert!(
            peer.owns.contains(&context.number),
            "{} knows that it owns {path}",
            peer.facts.name
        );
        let parent = context.parent.expect("a token has a parent");
        assert!(
            peer.joined.contains(&parent),
            "{} is in the parent of {path}",
            peer.facts.name
        );
    }

    fn check_waiting(&self, context: &Context, token: &Token) {
        let path = &context.path;
        assert!(
            token.owner.is_none() || token.holders.is_empty(),
            "{path} is owned or shared"
        );
        let parent = context.parent.expect("a token has a parent");
        let waiting = token.queue.iter().map(|waiter| waiter.peer);
        let asking = token.asking.iter().map(|asking| asking.peer);
        let offered = token.offer.iter().map(|offer| offer.to);
        let held_back = token.held_back.iter().map(|held| held.peer);
        let all = waiting.clone().chain(asking).chain(offered);
        let all = all.chain(token.promised()).chain(token.giver());
        for peer in all.chain(token.holders.keys().copied()).chain(held_back) {
            let known = self.world.peers.get(peer).expect("who waits is there");
            assert!(
                known.involved.contains(&context.number),
                "{} knows that it waits for {path}",
                known.facts.name
            );
        }
        for peer in waiting.chain(token.holders.keys().copied()) {
            assert!(
                self.world.tree.is_member(peer, parent),
                "who waits for {path} is in its parent"
            );
        }
        let peers: BTreeSet<PeerId> = token.queue.iter().map(|waiter| waiter.peer).collect();
        assert_eq!(peers.len(), token.queue.len(), "each waits once for {path}");
        for waiter in token.queue.iter().filter(|waiter| waiter.until.is_some()) {
            let timer = (
                waiter.until.unwrap_or_default(),
                Timer::Wait(context.number, waiter.ticket),
            );
            assert!(self.world.timers.contains(&timer), "the wait for {path} ends");
        }
        let owned = token.owner.is_some();
        assert!(owned || token.offer.is_none(), "only an owner offers {path}");
        assert!(
            owned || token.asking.is_empty(),
            "only an owner is asked for {path}"
        );
        let storing = token.granting.as_ref().map(|granting| granting.ticket);
        assert!(
            storing.is_some() || token.held_back.is_empty(),
            "nothing waits for {path} without cause"
        );
        let storing = storing.map(|ticket| ticket.expect("a change that is not stored has ended"));
        let known = storing.and_then(|ticket| self.world.storing.get(&ticket));
        assert_eq!(
            known.copied(),
            storing.map(|_| context.number),
            "the store of {path} is awaited"
        );
    }
}

#[cfg(test)]
mod tests {
    use mom_managers::Registry;
    use mom_proto::{Family, Map, Parcel, Path, from_value};

    use super::*;
    use crate::{ContextSpec, Input, Settings, User};

    const KEY: &str = "/lab/key";

    /// Peer 1 owns the token, peer 2 waits for it.
    fn hub() -> Hub {
        let context = |path: &str, kind: &str| Map::new().with("path", path).with("kind", kind);
        let contexts = [
            context("/lab", "session"),
            context(KEY, "token").with("manager", "queue"),
        ];
        let contexts: Vec<ContextSpec> = contexts
            .into_iter()
            .map(|spec| from_value(spec.into()).unwrap())
            .collect();
        let mut hub = Hub::new(
            Settings::default(),
            Registry::builtin(),
            &"open".into(),
            &contexts,
        )
        .unwrap();
        for peer in [PeerId(1), PeerId(2)] {
            let user = User {
                name: format!("user-{}", peer.0),
                level: 1,
                groups: Vec::new(),
                details: Map::new(),
            };
            let (nickname, id) = (None, Some(1));
            let login = Input::Login {
                peer,
                user,
                nickname,
                id,
            };
            let join = Parcel::new(Family::Context, "join").context(Path::parse("/lab").unwrap());
            let grab = Parcel::new(Family::Token, "grab").context(Path::parse(KEY).unwrap());
            let grab = grab.content(Map::new().with("wait", "unlimited"));
            let request = |parcel: Parcel| Input::Request {
                peer,
                parcel: Box::new(parcel.id(1)),
                clock: None,
            };
            for input in [login, request(join), request(grab)] {
                hub.handle(0, input, &mut Vec::new());
            }
        }
        hub.check();
        hub
    }

    fn number(hub: &Hub) -> ContextNumber {
        hub.world.tree.find(&Path::parse(KEY).unwrap()).unwrap().number
    }

    #[test]
    #[should_panic(expected = "the timer of /lab/key is its deadline")]
    fn a_timer_that_is_no_deadline_is_found() {
        let mut hub = hub();
        let number = number(&hub);
        hub.world.tree.token_mut(number).unwrap().timer = Some(7);
        hub.check();
    }

    #[test]
    #[should_panic(expected = "user-2 knows that it waits for /lab/key")]
    fn a_peer_that_does_not_know_that_it_waits_is_found() {
        let mut hub = hub();
        hub.world.peers.get_mut(PeerId(2)).unwrap().involved.clear();
        hub.check();
    }
}
