//! Brings plain connections through a door of a hub: a part of `bench-doors`.

use std::io::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Parser;
use mom_rivals::{Gateway, Passage, trusting};
use tokio::net::TcpListener;

/// Listens on a free port of loopback, prints it, and passes on.
#[derive(Parser)]
struct Cli {
    /// Where to.
    #[arg(long)]
    to: SocketAddr,
    /// Through which door: tcp, tls, ws, wss.
    #[arg(long)]
    door: String,
    /// The hub's certificate.
    #[arg(long)]
    certificate: Option<PathBuf>,
    /// The path of the WebSocket.
    #[arg(long, default_value = "/")]
    path: String,
    /// Its subprotocol.
    #[arg(long, default_value = "")]
    protocol: String,
}

#[tokio::main(flavor = "current_thread")]
async fn main() -> Result<()> {
    let cli = Cli::parse();
    mom_rivals::raise_files();
    let passage = Passage::ALL
        .into_iter()
        .find(|passage| passage.name() == cli.door);
    let gateway = Gateway {
        to: cli.to,
        passage: passage.context("a door is tcp, tls, ws or wss")?,
        websocket: (cli.path, cli.protocol),
        tls: cli.certificate.as_deref().map(trusting).transpose()?,
    };
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    writeln!(
        std::io::stdout(),
        "listening at tcp://{} (any)",
        listener.local_addr()?
    )?;
    std::io::stdout().flush()?;
    gateway.serve(listener).await
}
