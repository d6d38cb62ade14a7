//! `mom accept`: a token that is offered, taken and held until Ctrl-C.

use super::hold::{Held, hold};
use super::offers::{Awaited, offer};
use crate::cli::{self, Global};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::interrupt::Interrupt;
use crate::output::Output;

pub(crate) async fn run(args: &cli::Accept, global: &Global, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let path = &args.path;
    let token = client.token(path).await.doing(format!("join {path}"))?;
    let mut events = token.events();
    let awaited = Awaited {
        me: &client.name(),
        peer: args.peer.as_deref(),
        within: args.within,
    };
    let mut result = offer(&token, &mut events, awaited, &mut interrupt, output).await;
    if result.is_ok() {
        result = match token.accept().await.doing(format!("accept {path}")) {
            Ok(guard) => {
                let held = Held {
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
