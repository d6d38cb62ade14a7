//! `context create`: a session, channel or token, managed as its creator says (M24).

use mom_proto::{Code, ContextKind, Verb, WireError};

use super::Request;
use crate::asking::consult::Wish;
use crate::asking::questions::Refusal;
use crate::tree::spec::{self as args, ContextSpec};
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let spec: ContextSpec = args::read(&request.parcel)?;
    if spec.path.is_some() {
        return Err(args::bad(
            "path",
            "the path to be made stands in the slot context".to_owned(),
        )
        .into());
    }
    let above = hub
        .tree
        .find_or_above(&request.path)
        .map(|context| context.number);
    let at = above.ok_or_else(|| hub.unknown_path(&request.path, None))?;
    let wish = Wish {
        path: Some(&request.path),
        kind: ContextKind::from_word(&spec.kind),
        ..Wish::new(Verb::Create, at)
    };
    hub.ask(request.peer, &wish)?;
    if let Some(guard) = &spec.guard {
        // The members of a guarded channel hear who owns the token, so its manager decides who may guard by it.
        let token = args::path(&guard.token, "guard/token")?;
        if let Some(token) = hub.tree.find(&token).map(|token| token.number) {
            hub.ask(request.peer, &Wish::new(Verb::Join, token))?;
        }
    }
    let parent = hub.parent_for(&request.path)?;
    if !hub.is_member(request.peer, parent) {
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
    let number = hub.make(request.path.clone(), &spec, Some(request.peer))?;
    hub.grown.insert(number);
    hub.audit_context("created", &request.path, Some(request.peer), out);
    hub.push_created(number, Some(request.peer), out);
    let content = hub.tree.get(number).map(|context| context.summary());
    hub.push_ok(request.peer, request.parcel.id, &request.path, content, out);
    Ok(())
}
