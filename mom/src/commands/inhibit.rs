//! `mom inhibit`: keeps everybody from a token until Ctrl-C.

use serde_json::json;
use tokio::time::Instant;

use super::hold::{tell_lost, wait};
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::style::{Tone, ink};
use mom_pages::Interrupt;

pub(crate) async fn run(args: &cli::InhibitArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let path = &args.path;
    let token = client.token(path).await.doing(format!("join {path}"))?;
    let mut part = token.inhibit().await.doing(format!("inhibit {path}"))?;
    output.tell(
        || json!({"state": "inhibited", "path": path}),
        || ink(format_args!("nobody can own {path}"), Tone::Good),
    )?;
    output.remark(ink("Ctrl-C ends it", Tone::Faint));
    let until = args.time.map(|time| Instant::now() + time);
    let lost = tokio::select! {
        lost = part.lost() => Some(lost),
        () = interrupt.wait() => None,
        () = wait(until) => None,
    };
    let result = match lost {
        Some(lost) => tell_lost(path, &lost, output),
        None => {
            part.release().await.doing(format!("uninhibit {path}"))?;
            output.tell(
                || json!({"state": "uninhibited", "path": path}),
                || format!("{path} can be grabbed again, if nobody else inhibits it"),
            )?;
            Ok(())
        }
    };
    client.close().await;
    result
}
