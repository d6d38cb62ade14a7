//! `mom request`: asks the owner for its token and holds it until Ctrl-C.

use super::hold::{TokenToHold, hold};
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use crate::output::style::{Tone, ink};
use mom_pages::Interrupt;

pub(crate) async fn run(args: &cli::RequestArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let path = &args.path;
    let token = client.token(path).await.doing(format!("join {path}"))?;
    let events = token.events();
    let mut request = token.request();
    if let Some(within) = args.within {
        request = request.within(within);
    }
    if let Some(text) = &args.text {
        request = request.text(text);
    }
    output.remark(ink(
        format_args!("asking for {path} as {}; Ctrl-C ends", client.name()),
        Tone::Faint,
    ));
    let granted = tokio::select! {
        granted = request => granted.doing(format!("request {path}")),
        () = interrupt.wait() => Err(Failure::plain(format!("interrupted before {path} was handed over"))),
    };
    let result = match granted {
        Ok(guard) => {
            let held = TokenToHold {
                client: &client,
                token: &token,
                events,
                guard,
            };
            hold(held, &args.hold, &mut interrupt, output).await
        }
        Err(failure) => Err(failure),
    };
    client.close().await;
    result
}
