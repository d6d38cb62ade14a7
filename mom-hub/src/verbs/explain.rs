//! `context explain`: who may do what there, and by which rule. Who may ask is decided here. The broker asks the hub what it
//! would answer to each request ([`Hub::appraise`]), and knows in which line of which file the rule stands.
//!
//! [`Hub::appraise`]: crate::Hub::appraise

use mom_proto::nearest::nearest;
use mom_proto::{Code, ContextKind, Family, Verb, WireError};
use serde::Deserialize;

use super::checks::{Request, no_context};
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::content;
use crate::world::World;
use crate::{About, Effect, Explain, Inquiry, PeerId};

/// Users about whom one request may be.
const MOST: usize = 32;

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Args {
    user: Option<String>,
    peer: Option<String>,
    users: Option<Vec<String>>,
    verb: Option<String>,
    message: Option<String>,
    kind: Option<String>,
}

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let args: Args = content::read_or_default(&request.parcel)?;
    let verb = args.verb.as_deref().map(verb).transpose()?;
    let peer = request.peer;
    // What the peer may not look up is explained as if nothing were there.
    let here = world.seen_at(peer, &request.path);
    let Some(at) = here.or_else(|| world.seen_above(peer, &request.path)) else {
        return Err(no_context(&request.path).into());
    };
    if !is_about_itself(world, peer, &args) {
        let wish = Wish {
            path: Some(&request.path),
            ..Wish::new(Verb::Explain, at)
        };
        world.ask(peer, &wish, &request.answers)?;
    }
    check_message(verb, &args)?;
    let kind = args.kind.as_deref().map(kind).transpose()?;
    if here.is_none() && verb != Some(Verb::Create) {
        return Err(world.absent(request).into());
    }
    let inquiry = Inquiry::Explain(Explain {
        path: request.path.clone(),
        about: about(world, peer, &args)?,
        verb,
        message: args.message,
        kind,
    });
    request.push_inquiry(world, inquiry, out);
    Ok(())
}

/// Whether a peer asks about nobody but itself, which everybody may.
fn is_about_itself(world: &World, peer: PeerId, args: &Args) -> bool {
    let Some(facts) = world.peers.get(peer).map(|peer| &peer.facts) else {
        return false;
    };
    let mut users = args.user.iter().chain(args.users.iter().flatten());
    let mut peers = args.peer.iter();
    users.all(|user| **user == *facts.user) && peers.all(|peer| **peer == *facts.name)
}

fn verb(word: &str) -> Result<Verb, WireError> {
    let asked = |verb: &Verb| !matches!(verb.family(), Family::Login | Family::Manager | Family::Time);
    let found = Verb::from_word(word).filter(asked);
    found.ok_or_else(|| {
        let words = Verb::ALL.into_iter().filter(asked).map(Verb::word);
        let text = format!(
            "no manager is asked about {word:?}, which is not a verb of contexts, tokens or messages"
        );
        content::bad("verb", text).nearest_opt(nearest(word, words))
    })
}

fn kind(word: &str) -> Result<ContextKind, WireError> {
    let text = || format!("{word:?} is not one of session, channel, token");
    ContextKind::from_word(word).ok_or_else(|| content::bad("kind", text()))
}

fn check_message(verb: Option<Verb>, args: &Args) -> Result<(), WireError> {
    if args.message.is_some() && verb != Some(Verb::Send) {
        return Err(content::bad(
            "message",
            "message requires the verb send".to_owned(),
        ));
    }
    if args.kind.is_some() && verb != Some(Verb::Create) {
        return Err(content::bad("kind", "kind requires the verb create".to_owned()));
    }
    Ok(())
}

fn about(world: &World, asks: PeerId, args: &Args) -> Result<Vec<About>, WireError> {
    match (&args.user, &args.peer, &args.users) {
        (None, None, None) => Ok(vec![About::Peer(asks)]),
        (Some(user), None, None) => Ok(vec![about_user(world, asks, user)]),
        (None, Some(name), None) => {
            let peer = world.peers.id_of(name).ok_or_else(|| {
                let text = format!("there is no peer {name:?}");
                WireError::new(Code::UNKNOWN_PEER, text).slot("content/peer")
            })?;
            Ok(vec![About::Peer(peer)])
        }
        (None, None, Some(users)) if users.len() > MOST => Err(content::bad(
            "users",
            format!("at most {MOST} users can be asked about at once"),
        )),
        (None, None, Some(users)) => Ok(users.iter().map(|user| about_user(world, asks, user)).collect()),
        _ => Err(content::bad(
            "user",
            "give one of user, peer and users".to_owned(),
        )),
    }
}

/// A user is judged as its first peer, if one is here: what it has joined and owns counts.
fn about_user(world: &World, asks: PeerId, user: &str) -> About {
    let is = |peer: &PeerId| {
        world
            .peers
            .get(*peer)
            .is_some_and(|peer| *peer.facts.user == *user)
    };
    if is(&asks) {
        return About::Peer(asks);
    }
    let mut peers = world.peers.iter().map(|(peer, _)| peer);
    peers
        .find(is)
        .map_or_else(|| About::User(user.to_owned()), About::Peer)
}
