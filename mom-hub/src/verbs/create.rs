//! `context create`: a session, channel or token, managed as its creator says (M24).

use mom_proto::{Code, ContextKind, Verb, WireError};

use super::checks::Request;
use crate::asking::refusal::Refusal;
use crate::asking::wish::Wish;
use crate::content;
use crate::world::World;
use crate::{ContextSpec, Effect};

pub(crate) fn on(world: &mut World, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let spec: ContextSpec = content::read(&request.parcel)?;
    if spec.path.is_some() {
        return Err(content::bad("path", "put the path to create in the slot context".to_owned()).into());
    }
    let above = world
        .tree
        .find_or_above(&request.path)
        .map(|context| context.number);
    let at = above.ok_or_else(|| world.tree.unknown_path(&request.path, None))?;
    let wish = Wish {
        path: Some(&request.path),
        kind: ContextKind::from_word(&spec.kind),
        ..Wish::new(Verb::Create, at)
    };
    world.ask(request.peer, &wish, &request.answers)?;
    if let Some(guard) = &spec.guard {
        // The members of a guarded channel hear who owns the token, so its manager decides who may guard by it.
        let token = content::path(&guard.token, "guard/token")?;
        let found = world.tree.token_at(&token).map(|(number, _)| number);
        let found = found.filter(|found| !world.is_hidden(request.peer, *found));
        if found.is_none() {
            let error = world.unknown_to(request.peer, &token, &request.answers);
            return Err(error.slot("content/guard/token").into());
        }
        if let Some(token) = found {
            world.ask(request.peer, &Wish::new(Verb::Join, token), &request.answers)?;
        }
    }
    let parent = world.tree.parent_for(&request.path)?;
    if !world.tree.is_member(request.peer, parent) {
        let above = request
            .path
            .parent()
            .map(|above| above.to_string())
            .unwrap_or_default();
        return Err(WireError::new(
            Code::NOT_MEMBER,
            format!("join {above} before making something in it"),
        )
        .slot("context")
        .into());
    }
    let number = world.make(request.path.clone(), &spec, Some(request.peer))?;
    world.grown.insert(number);
    world.audit_context("created", &request.path, Some(request.peer), out);
    world.push_created(number, Some(request.peer), out);
    let content = world.tree.get(number).map(|context| context.summary());
    request.push_ok(world, content, out);
    Ok(())
}
