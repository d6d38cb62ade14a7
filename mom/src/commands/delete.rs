//! `mom delete`: deletes a context with all below it.

use serde_json::json;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::style::{Tone, ink};

pub(crate) async fn run(args: &cli::DeleteArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let path = &args.path;
    client.delete(path).await.doing(format!("delete {path}"))?;
    client.close().await;
    output.tell(
        || json!({"state": "deleted", "path": path}),
        || ink(format_args!("{path} is deleted, with all below it"), Tone::Good),
    )?;
    Ok(())
}
