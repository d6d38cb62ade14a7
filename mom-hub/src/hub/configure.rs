//! A new configuration on a living hub (design §6): what it takes away is lost at once, everywhere.

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_proto::event::Reason;
use mom_proto::{Code, ContextNumber, Path, Value, Verb, WireError};

use super::login::refresh;
use crate::asking::questions::Questions;
use crate::contexts::make::manager_word;
use crate::hub::input::Configuration;
use crate::tree::context::{Context, Role};
use crate::verbs::put_out;
use crate::world::World;
use crate::{Audit, ContextSpec, Effect, PeerId, User};

/// Takes over a configuration that was checked before.
pub(super) fn configure(
    world: &mut World,
    questions: &mut Questions,
    new: Configuration,
    out: &mut Vec<Effect>,
) {
    let Configuration {
        registry,
        root,
        contexts,
        limits,
        users,
    } = new;
    world.registry = registry;
    world.settings.limits = limits;
    manage_root(world, &root);
    world.audit(Audit::new("configured"), out);
    take_contexts(world, &contexts, out);
    renew_managers(world);
    forget_standing(world);
    for (peer, user) in users {
        change_user(world, questions, peer, user, out);
    }
    review(world, questions, out);
    world.stir_all();
}

fn manage_root(world: &mut World, root: &Value) {
    let Ok(manager) = world.registry.build(root) else {
        return world.fault("applying a configuration that was not checked");
    };
    let number = world.tree.root().map(|root| root.number);
    let Some(context) = number.and_then(|number| world.tree.get_mut(number)) else {
        return world.fault("there is no root to manage");
    };
    context.manager = Some(manager);
    context.manager_word = Some(manager_word(root));
    context.manager_spec = Some(root.clone());
}

/// The path of an entry of the file, which was checked with the whole of it.
fn path_of(world: &World, spec: &ContextSpec) -> Option<Path> {
    match spec.path.as_deref().map(Path::parse) {
        Some(Ok(path)) => Some(path),
        _ => world.fault("a context of the configuration has no path"),
    }
}

/// Deletes the contexts that the file names no more, makes new ones, and changes the rest in place.
fn take_contexts(world: &mut World, contexts: &[ContextSpec], out: &mut Vec<Effect>) {
    let named = contexts.iter();
    let named: Vec<(Path, &ContextSpec)> = named
        .filter_map(|spec| Some((path_of(world, spec)?, spec)))
        .collect();
    delete_unnamed(world, &named, out);
    for (path, spec) in named {
        let known = world.tree.find(&path);
        let known = known.map(|known| (known.number, known.kind().word() == spec.kind));
        let result = match known {
            Some((number, true)) => change_context(world, number, spec, out),
            // A peer has made something else at this path meanwhile; the file goes first.
            Some((number, false)) => {
                world.delete_at_once(number, out);
                make_and_tell(world, spec, out)
            }
            None => make_and_tell(world, spec, out),
        };
        if let Err(error) = result {
            let fact = Audit {
                context: Some(path),
                code: Some(error.code.clone()),
                text: Some(error.text),
                ..Audit::new("refused")
            };
            world.audit(fact, out);
        }
    }
}

/// Deletes the contexts of the file before that this one does not have, or has as another kind.
fn delete_unnamed(world: &mut World, named: &[(Path, &ContextSpec)], out: &mut Vec<Effect>) {
    let named: BTreeMap<&Path, &str> = named
        .iter()
        .map(|(path, spec)| (path, spec.kind.as_str()))
        .collect();
    let stays = |context: &Context| named.get(&context.path).copied() == Some(context.kind().word());
    let gone: Vec<ContextNumber> = world
        .tree
        .iter()
        .filter(|context| context.permanent && context.parent.is_some() && !stays(context))
        .map(|context| context.number)
        .collect();
    for number in gone.into_iter().rev() {
        // A child may have gone with its parent.
        if world.tree.get(number).is_some() {
            world.delete_at_once(number, out);
        }
    }
}

fn make_and_tell(world: &mut World, spec: &ContextSpec, out: &mut Vec<Effect>) -> Result<(), WireError> {
    let number = world.make_configured(spec)?;
    world.grown.insert(number);
    world.push_created(number, None, out);
    Ok(())
}

/// Gives a context what the file says of it now; members, owner and fence stay.
fn change_context(
    world: &mut World,
    number: ContextNumber,
    spec: &ContextSpec,
    out: &mut Vec<Effect>,
) -> Result<(), WireError> {
    let manager = spec
        .manager
        .as_ref()
        .map(|spec| world.registry.build(spec))
        .transpose()?;
    let parent = world.tree.get(number).and_then(|context| context.parent);
    let managed = match &manager {
        Some(manager) => manager.terms(),
        None => parent.map(|parent| world.terms_above(parent)).unwrap_or_default(),
    };
    let role = world.make_role(spec, managed)?;
    let guarded = guard_of(&role) != world.tree.get(number).and_then(|context| guard_of(&context.role));
    lose_guarding(world, number, &role, out);
    world.unguard(number);
    let Some(context) = world.tree.get_mut(number) else {
        return Err(world.faulted("changing a context that does not exist"));
    };
    context.manager = manager;
    context.manager_word = spec.manager.as_ref().map(manager_word);
    context.manager_spec.clone_from(&spec.manager);
    context.presence = spec.presence.unwrap_or_default();
    context.transient = spec.transient;
    // The file manages it now, and not its creator.
    context.creator = None;
    world.tree.make_permanent(number);
    let Some(context) = world.tree.get_mut(number) else {
        return Err(world.faulted("changing a context that does not exist"));
    };
    let mut changed = None;
    match (&mut context.role, role) {
        (Role::Token(token), Role::Token(new)) => changed = Some(token.take_terms(*new, world.now)),
        (old, new) => *old = new,
    }
    world.link_guards(number);
    world.changed.insert(number);
    if guarded {
        world.push_guard(number, out);
    }
    if let Some(changed) = changed {
        if changed {
            world.correct_record(number, out);
        }
        world.retime(number);
        world.change_guarded_routes(number);
    }
    Ok(())
}

/// The token that guards a channel, and the messages that need it.
fn guard_of(role: &Role) -> Option<(Path, Arc<[String]>)> {
    let guard = match role {
        Role::Channel(channel) => channel.guard.as_ref()?,
        Role::Session | Role::Token(_) => return None,
    };
    Some((guard.token.clone(), Arc::clone(&guard.names)))
}

/// Takes the token of a channel from its owner if the channel has another guard from now on, or none: the owner could
/// not stop any more what it has set in motion there.
fn lose_guarding(world: &mut World, channel: ContextNumber, new: &Role, out: &mut Vec<Effect>) {
    let old = world
        .tree
        .get(channel)
        .and_then(|context| guard_of(&context.role));
    let new = guard_of(new).map(|(token, _)| token);
    let token = old
        .map(|(token, _)| token)
        .filter(|old| new.as_ref() != Some(old));
    // The token may have been deleted before.
    let token = token.and_then(|token| world.tree.token_at(&token).map(|(number, _)| number));
    if let Some(token) = token {
        world.lose(token, Reason::Revoked, None, out);
    }
}

/// Makes the managers of peers' contexts anew, because their names may mean something else now. A context whose manager
/// was removed is closed.
fn renew_managers(world: &mut World) {
    let made = world.tree.iter().filter(|context| !context.permanent);
    let made: Vec<(ContextNumber, Value)> = made
        .filter_map(|context| Some((context.number, context.manager_spec.clone()?)))
        .collect();
    for (number, spec) in made {
        let manager = world
            .registry
            .build(&spec)
            .or_else(|_| world.registry.build(&Value::from("closed")));
        match (manager, world.tree.get_mut(number)) {
            (Ok(manager), Some(context)) => context.manager = Some(manager),
            _ => world.fault("neither the manager nor a closed one could be built"),
        }
    }
}

/// Drops all verdicts that stand.
fn forget_standing(world: &mut World) {
    for context in world.tree.iter_mut() {
        if context.channel().is_some() {
            for member in context.members.values_mut() {
                *member = Arc::new(member.unjudged(Arc::clone(&member.facts)));
            }
            world.changed.insert(context.number);
        }
    }
}

fn change_user(
    world: &mut World,
    questions: &mut Questions,
    peer: PeerId,
    user: Option<User>,
    out: &mut Vec<Effect>,
) {
    // It may have gone while the configuration was read.
    if world.peers.get(peer).is_none() {
        return;
    }
    if let Some(user) = user {
        refresh(world, peer, user);
        return;
    }
    let Some(root) = world.tree.root().map(|root| root.number) else {
        return world.fault("there is no root to expel from");
    };
    let text = "this user, or the credential it logged in with, was removed from the configuration";
    put_out(world, questions, (root, peer, None), Some(text), out);
}

/// Asks the managers again about every membership and every ownership, and ends those that they would refuse now.
fn review(world: &mut World, questions: &mut Questions, out: &mut Vec<Effect>) {
    let peers: Vec<PeerId> = world.peers.iter().map(|(peer, _)| peer).collect();
    for peer in peers {
        // Others may have been put out with one that was looked at before.
        let Some(known) = world.peers.get(peer) else {
            continue;
        };
        let joined: Vec<ContextNumber> = known.joined.iter().copied().collect();
        let owns: Vec<ContextNumber> = known.owns.iter().copied().collect();
        for token in owns {
            // A delegate needs no right to grab; who may not renew cannot keep the token.
            if world.owner_of(token) == Some(peer) && world.refused(peer, Verb::Renew, token) {
                world.lose(token, Reason::Revoked, None, out);
            }
        }
        review_promises(world, peer, out);
        for place in joined {
            let place = world.tree.get(place).filter(|place| place.parent.is_some());
            let place = place.filter(|place| place.members.contains_key(&peer));
            let place = place.filter(|place| !world.is_leaving(peer, &place.path));
            let Some(place) = place.map(|place| place.number) else {
                continue;
            };
            review_device(world, peer, place);
            if world.refused(peer, Verb::Join, place) {
                let text = "the configuration has changed: this peer may no longer be here";
                put_out(world, questions, (place, peer, None), Some(text), out);
            }
        }
    }
    thin_devices(world, questions, out);
}

/// Leaves one device in each channel that has one at most by now: the first of those whose links live.
fn thin_devices(world: &mut World, questions: &mut Questions, out: &mut Vec<Effect>) {
    let mut surplus = Vec::new();
    for context in world.tree.iter().filter(|context| context.has_one_device()) {
        let devices = context.members.values().filter(|member| member.device);
        let mut devices: Vec<PeerId> = devices.map(|member| member.peer).collect();
        devices.sort_by_key(|peer| world.peers.get(*peer).is_none_or(|known| known.lost.is_some()));
        surplus.extend(devices.into_iter().skip(1).map(|peer| (context.number, peer)));
    }
    for (place, peer) in surplus {
        let text = "the configuration has changed: only one device may be here, and another was here first";
        put_out(world, questions, (place, peer, None), Some(text), out);
    }
}

/// Takes a member that may not be a device any more for an ordinary one.
fn review_device(world: &mut World, peer: PeerId, place: ContextNumber) {
    let member = world.tree.get(place).and_then(|place| place.members.get(&peer));
    let Some(thinning) = member
        .filter(|member| member.device)
        .map(|member| member.thinning)
    else {
        return;
    };
    if world.refused(peer, Verb::Device, place) {
        world.set_terms(place, peer, thinning, false);
    }
}

/// Ends the part of a peer in shared holds, and grants to it that are being stored, where it may not any more.
fn review_promises(world: &mut World, peer: PeerId, out: &mut Vec<Effect>) {
    let known = world.peers.get(peer);
    let involved: Vec<ContextNumber> = known
        .map(|known| known.involved.iter().copied().collect())
        .unwrap_or_default();
    for number in involved {
        let token = world.token(number);
        let holds = token.is_some_and(|token| token.holders.contains_key(&peer));
        let promised = token.is_some_and(|token| token.promised() == Some(peer));
        if holds && world.refused(peer, Verb::Inhibit, number) {
            world.uninhibit(number, peer, Reason::Revoked.word(), out);
        }
        if promised && world.refused(peer, Verb::Renew, number) {
            let text = "the configuration has changed: this peer may no longer own it";
            let error = WireError::new(Code::DENIED, text);
            world.call_off_for(number, peer, &error, Reason::Revoked.word(), out);
        }
    }
}
