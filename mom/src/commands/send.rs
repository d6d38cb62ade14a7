//! `mom send`: one message.

use mom_client::{Channel, Delivery, Message, Value, to_value};
use serde_json::json;

use crate::cli::{self, GlobalArgs};
use crate::connect::{Stay, connect};
use crate::failure::{Doing as _, Failure};
use crate::input;
use crate::output::style::{Tone, ink};
use crate::output::{Output, words};

pub(crate) async fn run(args: &cli::SendArgs, global: &GlobalArgs, output: Output) -> Result<(), Failure> {
    let content = content(args)?;
    if !args.path.starts_with('/') {
        return Err(Failure::usage(
            format!(
                "{:?} is not a path, and send takes its own even if --hub has one",
                args.path
            ),
            format!(
                "mom send PATH NAME [CONTENT], such as: mom send /chat {}",
                args.path
            ),
        ));
    }
    let client = connect(global, Stay::Once).await?;
    let channel = client
        .channel(&args.path)
        .await
        .doing(format!("join {}", args.path))?;
    let message = message(&channel, args, content);
    let what = format!("send {} to {}", args.name, args.path);
    let result = send(message, &what, args.acknowledge, output).await;
    client.close().await;
    result
}

/// The content, if there is to be one.
fn content(args: &cli::SendArgs) -> Result<Option<Value>, Failure> {
    let Some(content) = given(args)? else {
        return Ok(None);
    };
    // A value without a form on the wire is better refused here than by its receivers.
    to_value(&content).map(Some).map_err(|error| {
        Failure::usage(
            error.text,
            "a string holds letters, blanks and line ends, but no control characters",
        )
    })
}

fn given(args: &cli::SendArgs) -> Result<Option<Value>, Failure> {
    if let Some(json) = &args.content_json {
        return serde_json::from_str(json).map(Some).map_err(|error| {
            Failure::usage(
                format!("--content-json: {error}"),
                "quote it for the shell: --content-json '{\"width\": 640}'",
            )
        });
    }
    Ok(match args.content.as_deref() {
        None => None,
        Some("-") => Some(input::text("-")?.into()),
        Some(text) => Some(text.into()),
    })
}

fn message(channel: &Channel, args: &cli::SendArgs, content: Option<Value>) -> Message {
    // Nobody would read the echo: this peer logs out as soon as its message is sent.
    let mut message = channel.message(&args.name).no_echo();
    if let Some(content) = content {
        message = message.content(content);
    }
    if !args.to.is_empty() {
        message = message.to(args.to.iter().map(String::as_str));
    }
    if let Some(priority) = args.priority {
        message = message.priority(priority);
    }
    if let Some(expires) = args.expires {
        message = message.expires(expires);
    }
    if let Some(delivery) = args.delivery.as_deref().and_then(Delivery::from_word) {
        message = message.delivery(delivery);
    }
    message
}

/// Sends; reports how many receivers got it, if that is asked for.
async fn send(message: Message, what: &str, acknowledge: bool, output: Output) -> Result<(), Failure> {
    // A refusal may come late: from a manager that has to be asked, or where a receiver has no capacity.
    let receipt = message.send_acknowledged().await.doing(what)?;
    if !acknowledge {
        return Ok(output.tell(|| json!({"sent": true}), || ink("sent", Tone::Good))?);
    }
    output.tell(
        || json!({"delivered": receipt.delivered, "dropped": receipt.dropped}),
        || match receipt.delivered {
            0 => ink("delivered to nobody: no one else is there", Tone::Notice),
            count => ink(
                format_args!("delivered to {}", words::count(count, "member")),
                Tone::Good,
            ),
        },
    )?;
    match receipt.dropped.is_empty() {
        true => Ok(()),
        false => Err(Failure::plain(format!(
            "{what}: dropped for {}",
            receipt.dropped.join(", ")
        ))),
    }
}
