//! `mom grab`: waits for a token and holds it until Ctrl-C.

use std::io::{self, IsTerminal as _};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use mom_client::{Place, Token, TokenGuard, ordinal};
use serde_json::json;

use super::hold::{TokenToHold, hold};
use crate::cli::{self, GlobalArgs, WaitArg};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};
use mom_pages::Interrupt;

const TICK: Duration = Duration::from_millis(100);

pub(crate) async fn run(args: &cli::GrabArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let client = connect(global, Stay::Once).await?;
    let mut interrupt = Interrupt::install()?;
    let token = client
        .token(&args.path)
        .await
        .doing(format!("join {}", args.path))?;
    let events = token.events();
    let result = match grab(&token, args.wait, &mut interrupt, output).await {
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

/// Grabs a token, and shows the place in the queue while it waits.
pub(super) async fn grab(
    token: &Token,
    wait: Option<WaitArg>,
    interrupt: &mut Interrupt,
    output: Output,
) -> Result<TokenGuard, Failure> {
    let path = token.path().as_str();
    let queue = PlaceDisplay::new(path, output);
    let grab = match wait {
        None => token.grab(),
        Some(WaitArg::For(most)) => token.grab().wait(most),
        Some(WaitArg::Forever) => token.grab().wait_forever(),
    };
    let grab = grab.on_place(|place| queue.show(place));
    // If the interrupt drops it, it leaves the queue.
    let granted = tokio::select! {
        granted = grab => granted.doing(format!("grab {path}")),
        () = interrupt.wait() => Err(Failure::plain(format!("interrupted before it was your turn at {path}"))),
    };
    queue.end();
    granted
}

/// The place in the queue: a moving line at a terminal, one line per change elsewhere.
struct PlaceDisplay<'a> {
    path: &'a str,
    output: Output,
    bar: Option<ProgressBar>,
}

impl<'a> PlaceDisplay<'a> {
    fn new(path: &'a str, output: Output) -> PlaceDisplay<'a> {
        let terminal = !output.is_json() && io::stdout().is_terminal() && io::stderr().is_terminal();
        PlaceDisplay {
            path,
            output,
            bar: terminal.then(make_bar),
        }
    }

    fn show(&self, place: Place) {
        let words = place_words(self.path, place);
        if let Some(bar) = &self.bar {
            bar.set_message(format!("{words}; Ctrl-C leaves the queue"));
            bar.enable_steady_tick(TICK);
            return;
        }
        let expected = place.expected.map(words::in_millis);
        let told = self.output.tell(
            || json!({"state": "waiting", "path": self.path, "place": place.place, "expected": expected}),
            || ink(&words, Tone::Notice),
        );
        if told.is_err() {
            // Nobody reads this output any more; the grab still matters.
            self.output.remark(&words);
        }
    }

    fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

/// `waiting for /robot/token: 2nd in the queue, your turn is expected in 3 min`
fn place_words(path: &str, place: Place) -> String {
    let expected = match place.expected {
        Some(expected) => format!(", your turn is expected in {}", words::duration(expected)),
        None => String::new(),
    };
    format!(
        "waiting for {path}: {} in the queue{expected}",
        ordinal(place.place)
    )
}

fn make_bar() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {wide_msg} {elapsed}") {
        bar.set_style(style);
    }
    bar
}
