//! `mom accept`: accepts an offered token and holds it until Ctrl-C.

use super::hold::{TokenToHold, hold};
use super::offers::{AwaitedOffer, offer};
use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::Output;
use mom_pages::Interrupt;

pub(crate) async fn run(args: &cli::AcceptArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let path = &args.path;
    let token = client.token(path).await.doing(format!("join {path}"))?;
    let mut events = token.events();
    let awaited = AwaitedOffer {
        me: &client.name(),
        peer: args.peer.as_deref(),
        within: args.within,
    };
    let mut result = offer(&token, &mut events, awaited, &mut interrupt, output).await;
    if result.is_ok() {
        result = match token.accept().await.doing(format!("accept {path}")) {
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
    }
    client.close().await;
    result
}
