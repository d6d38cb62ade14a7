//! `token decline`: no to an offer, or of an owner to who asks.

use mom_proto::{Code, WireError};

use super::Request;
use super::accept::{Args, asking, offered};
use crate::asking::questions::Refusal;
use crate::tree::spec as args;
use crate::{Effect, Hub};

pub(crate) fn on(hub: &mut Hub, request: &Request, out: &mut Vec<Effect>) -> Result<(), Refusal> {
    let number = hub.find_token(request)?;
    let args: Args = args::read_or_default(&request.parcel)?;
    hub.allow(request, number)?;
    if let Some(name) = &args.peer {
        hub.check_owner(request, number)?;
        let to = asking(hub, request, name)?;
        let text = args.text.as_deref().unwrap_or("not now");
        let text = format!("{} declined: {text}", hub.name_of(request.peer));
        let error = WireError::new(Code::DECLINED, text).rule("the owner's word");
        hub.end_asking(number, to, &error, None, out);
    } else {
        offered(hub, request)?;
        hub.end_offer(number, "declined", out);
    }
    hub.push_ok(request.peer, request.parcel.id, &request.path, None, out);
    Ok(())
}
