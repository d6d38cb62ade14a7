//! Peers whose link is a program in another language: what they say and hear passes through its client.
//!
//! The program gets an address on its command line and connects there, without a login. It writes an empty line once
//! it is connected, then each parcel that it hears as a line of the JSON form; each such line that it reads it sends,
//! unchanged. It ends with its input, and with its connection. It answers the hub's pings by itself, without stamps,
//! as the clock of a dialogue stands still.

use std::process::Stdio;

use mom_net::{Address, Door, NetError, Transceiver};
use mom_proto::Limits;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};

use super::root;

/// The programs, by language: the command that starts one, from the project's folder.
pub const CLIENTS: [Client; 2] = [
    Client {
        language: "python",
        command: &["target/python/bin/python", "clients/python/tests/adapter.py"],
        doors: &[
            (Door::Stream, false),
            (Door::Stream, true),
            (Door::WebSocket, false),
            (TUNNEL, false),
        ],
    },
    // It trusts the certificates that browsers trust, and no fingerprint.
    Client {
        language: "javascript",
        command: &["node", "clients/js/test/adapter.mjs"],
        doors: &[(Door::WebSocket, false), (TUNNEL, false)],
    },
];

const TUNNEL: Door = Door::Tunnel { polled: false };

/// A client in another language.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Client {
    /// What it is written in.
    pub language: &'static str,
    command: &'static [&'static str],
    /// The doors that it can take, with TLS or without: through the first go all dialogues.
    pub doors: &'static [(Door, bool)],
}

impl Client {
    /// Starts it, and waits until it is connected.
    pub(super) async fn connect(self, address: &Address) -> Result<Transceiver, String> {
        let (program, args) = self.command.split_first().ok_or("it has no command")?;
        let failed = |error: std::io::Error| {
            format!("{program} does not run: {error}; `cargo xtask test --install` installs what it needs")
        };
        let inside = program.contains('/');
        let mut child = Command::new(if inside {
            root().join(program)
        } else {
            program.into()
        })
        .args(args)
        .arg(address.to_string())
        .current_dir(root())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .map_err(failed)?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(format!("{program} has no pipes"));
        };
        let mut output = BufReader::new(output);
        let mut first = String::new();
        output.read_line(&mut first).await.map_err(failed)?;
        if first != "\n" {
            return Err(format!("{} does not connect: {first:?}", self.language));
        }
        let (here, there) = joined().await.map_err(|error| error.to_string())?;
        tokio::spawn(carry(there, child, input, output));
        Ok(here)
    }
}

/// A link of the JSON form, and the socket at its other end: no codec but the program's own may look at what is said.
async fn joined() -> Result<(Transceiver, TcpStream), NetError> {
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    let address: Address = format!("json://{}", listener.local_addr()?).parse()?;
    let limits = Limits::default();
    let (here, there) = tokio::join!(mom_net::connect(&address, &limits, None), listener.accept());
    Ok((here?, there?.0))
}

/// Passes on what either side says until one of them ends.
async fn carry(
    there: TcpStream,
    mut child: Child,
    mut input: ChildStdin,
    mut output: BufReader<ChildStdout>,
) {
    let (mut said, mut heard) = there.into_split();
    let saying = async {
        if tokio::io::copy(&mut said, &mut input).await.is_err() {
            // Its connection has ended; what it heard before is still to come.
            std::future::pending::<()>().await;
        }
    };
    tokio::select! {
        () = saying => {}
        _ = tokio::io::copy_buf(&mut output, &mut heard) => {}
    }
    // Its end closes the connection, if that is not closed already.
    drop(input);
    let _ = child.wait().await;
}
