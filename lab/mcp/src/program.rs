//! The tools for language models as a program of its own.

use std::ffi::OsString;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, anyhow};
use clap::Parser;
use mom_client::{Builder, LinkState};
use mom_program::{HubArgs, begin, shutdown};
use rmcp::ServiceExt;
use rmcp::service::ServerInitializeError;
use tokio::sync::watch;
use tokio::time::timeout;

use crate::assistant::{Assistant, Places};
use crate::server::{CallOrder, Tools};
use crate::stdio::{self, Stdio};

/// So long what is under way may take at the end.
const LAST_TURN: Duration = Duration::from_secs(2);

const EXAMPLES: &str = "\
It speaks the Model Context Protocol (MCP) over its standard input and output, one JSON-RPC message a line, with the tools
look, where, request_token, move, stop and return_token. Programs that work with language models start it by themselves:

  {\"mcpServers\": {\"mom\": {\"command\": \"mom-mcp\", \"args\": [\"--hub\", \"bin://127.0.0.1:7666\"],
                          \"env\": {\"MOM_PASSWORD\": \"assistant\"}}}}

A model drives only while a person lends it the token: mom give assistant /robot/token --for 2m --commands 5

Examples:
  MOM_PASSWORD=assistant mom-mcp
  mom-mcp --hub bins://lab.example.org --user assistant --key assistant.key
  mom-mcp --robot /crane/arm --token /crane/token --cameras /crane/camera

The password is that of MOM_PASSWORD, unless --password-file names a file. A key (mom keygen) is taken from
anywhere, a password over TLS (bins://, tcps://) or loopback. The log goes to the standard error; RUST_LOG says how much of
it. It ends with its standard input, at Ctrl-C and at SIGTERM, and gives the token back before.";

/// Tools for language models (MCP): look at a robot, ask a person for it, drive it under that grant, stop it.
#[derive(Debug, Parser)]
#[command(name = "mom-mcp", version, after_help = EXAMPLES, mut_arg("user", |user| user.default_value("assistant")))]
struct McpArgs {
    #[command(flatten)]
    hub: HubArgs,
    /// The channel of the robot
    #[arg(long, value_name = "PATH", default_value = "/robot/arm")]
    robot: String,
    /// The token that a person gives
    #[arg(long, value_name = "PATH", default_value = "/robot/token")]
    token: String,
    /// The session of the cameras
    #[arg(long, value_name = "PATH", default_value = "/camera")]
    cameras: String,
    /// The channel of a model server, which knows where objects are; there may be none
    #[arg(long, value_name = "PATH", default_value = "/model/objects")]
    objects: String,
}

/// Runs the program with these arguments, of which the first is its name, until it is done or told to end.
///
/// # Errors
///
/// What the program ends by; wrong arguments end the process.
// One thread: calls of one client begin in the order in which they came.
#[tokio::main(flavor = "current_thread")]
pub async fn run(args: Vec<OsString>) -> anyhow::Result<()> {
    let Some(args) = begin::<McpArgs>(args, "info,rmcp=error")? else {
        return Ok(());
    };
    let mut shutdown = pin!(shutdown()?);
    let login = args.hub.login("mom-mcp", env!("CARGO_PKG_VERSION"))?;
    let (stdio, gone, written) = stdio::open();
    let (ready, assistant) = watch::channel(None);
    let turn = CallOrder::default();
    let tools = Tools::new(
        assistant.clone(),
        gone.subscribe(),
        &args.hub.hub,
        Arc::clone(&turn),
    );
    let ended = tokio::select! {
        ended = serve(tools, stdio) => ended,
        failed = stay(&args, login, &ready) => failed,
        () = &mut shutdown => Ok(()),
    };
    gone.send_replace(true);
    let assistant = assistant.borrow().clone();
    if let Some(assistant) = assistant {
        // A running task gives the token back by itself.
        let _turn = timeout(LAST_TURN, turn.lock()).await;
        assistant.end().await;
    }
    written.wait().await;
    ended
}

/// Serves until the client is gone.
async fn serve(tools: Tools, stdio: Stdio) -> anyhow::Result<()> {
    match tools.serve(stdio).await {
        Ok(running) => {
            running.waiting().await.context("the server of MCP ended")?;
            Ok(())
        }
        Err(ServerInitializeError::ConnectionClosed(_)) => Ok(()),
        Err(ServerInitializeError::ExpectedInitializeRequest(_)) => {
            Err(anyhow!("the client of MCP began without `initialize`"))
        }
        Err(error) => Err(error).context("the client of MCP was not understood"),
    }
}

/// Logs in, which may take until there is a hub, and stays until the hub wants this peer no more.
async fn stay(
    args: &McpArgs,
    login: Builder,
    ready: &watch::Sender<Option<Arc<Assistant>>>,
) -> anyhow::Result<()> {
    let connected = login.connect().await;
    let client =
        connected.with_context(|| format!("{} cannot log in at {}", args.hub.user(), args.hub.hub))?;
    let mut state = client.state();
    let places = Places {
        robot: args.robot.clone(),
        token: args.token.clone(),
        cameras: args.cameras.clone(),
        objects: args.objects.clone(),
    };
    let assistant = Assistant::begin(client, places).await?;
    tracing::info!("{} is at {}", assistant.client.name(), args.hub.hub);
    ready.send_replace(Some(assistant));
    let closed = state
        .wait_for(|state| matches!(state, LinkState::Closed(_)))
        .await;
    match closed.as_deref() {
        Ok(LinkState::Closed(Some(why))) => Err(anyhow!("the hub has closed the connection: {}", why.text)),
        _ => Err(anyhow!("the connection to the hub is closed")),
    }
}
