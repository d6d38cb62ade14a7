//! `mom break`: takes a token away from its owner.

use serde_json::json;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};

pub(crate) async fn run(args: &cli::BreakArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let path = &args.path;
    let token = client.token(path).await.doing(format!("join {path}"))?;
    let had = token.break_hold().await.doing(format!("break {path}"))?;
    client.close().await;
    output.tell(
        || json!({"state": "broken", "path": path, "had": had}),
        || match had.is_empty() {
            true => format!("nobody had {path}"),
            false => {
                let had: Vec<String> = had.iter().map(|peer| words::visible(peer)).collect();
                let who = had.join(", ");
                let verb = if had.len() == 1 { "has" } else { "have" };
                ink(
                    format_args!("broke {path}: {who} no longer {verb} it"),
                    Tone::Good,
                )
            }
        },
    )?;
    Ok(())
}
