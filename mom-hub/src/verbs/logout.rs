//! `login logout`: the departure of a peer.

use mom_proto::Path;

use super::Request;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) {
    // The departure first: whoever reads `ok` has left everything and owns nothing.
    hub.handle_gone(request.peer, out);
    hub.push_ok(request.peer, request.parcel.id, &Path::root(), None, out);
    out.push(Effect::Close {
        peer: request.peer,
        error: None,
    });
}
