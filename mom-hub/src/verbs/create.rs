//! `context create`: a session, channel or token, managed as its creator says (M24).

use mom_proto::{Code, ContextKind, Verb, WireError};

use super::Request;
use crate::args::{self, ContextSpec};
use crate::consult::Wish;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), WireError> {
    let spec: ContextSpec = args::read(&request.parcel)?;
    if spec.path.is_some() {
        return Err(args::bad(
            "path",
            "the path to be made stands in the slot context".to_owned(),
        ));
    }
    if spec
        .manager
        .as_ref()
        .is_some_and(|manager| manager.as_str() == Some("self"))
    {
        let text = "a context that its creator manages itself is not built yet; name a manager of the hub";
        return Err(WireError::new(Code::UNKNOWN_MANAGER, text).slot("content/manager"));
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
        .slot("context"));
    }
    let number = hub.make(request.path.clone(), &spec, false)?;
    hub.grown.insert(number);
    hub.push_created(number, request.peer, out);
    let content = hub.tree.get(number).map(|context| context.summary());
    hub.push_ok(request.peer, request.parcel.id, &request.path, content, out);
    Ok(())
}
