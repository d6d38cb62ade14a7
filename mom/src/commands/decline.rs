//! `mom decline`: declines an offered token.

use serde_json::json;

use super::offers::{AwaitedOffer, offer};
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use mom_pages::Interrupt;

pub(crate) async fn run(args: &cli::DeclineArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let path = &args.path;
    let token = client.token(path).await.doing(format!("join {path}"))?;
    let awaited = AwaitedOffer {
        me: &client.name(),
        peer: args.peer.as_deref(),
        within: args.within,
    };
    let mut result = offer(&token, &mut token.events(), awaited, &mut interrupt, output).await;
    if result.is_ok() {
        result = token.decline().await.doing(format!("decline {path}"));
    }
    if result.is_ok() {
        output.tell(
            || json!({"state": "declined", "path": path}),
            || format!("declined {path}"),
        )?;
    }
    client.close().await;
    result
}
