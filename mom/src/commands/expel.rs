//! `mom expel`: expels a peer from a context.

use serde_json::json;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};

pub(crate) async fn run(args: &cli::ExpelArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let (peer, path) = (&args.peer, &args.path);
    let text = args.text.as_deref().unwrap_or_default();
    client
        .expel(path, peer, text, args.time)
        .await
        .doing(format!("expel {peer} from {path}"))?;
    client.close().await;
    output.tell(
        || json!({"state": "expelled", "path": path, "peer": peer}),
        || {
            let peer = words::visible(peer);
            ink(format_args!("{peer} is expelled from {path}"), Tone::Good)
        },
    )?;
    Ok(())
}
