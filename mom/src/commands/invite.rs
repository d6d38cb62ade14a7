//! `mom invite`: invites a peer to a context.

use serde_json::json;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};

pub(crate) async fn run(args: &cli::InviteArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let (peer, path) = (&args.peer, &args.path);
    client
        .invite(path, peer)
        .await
        .doing(format!("invite {peer} to {path}"))?;
    client.close().await;
    output.tell(
        || json!({"state": "invited", "path": path, "peer": peer}),
        || {
            let peer = words::visible(peer);
            ink(format_args!("{peer} is invited to {path}"), Tone::Good)
        },
    )?;
    Ok(())
}
