//! Pages in headless Chromium.

use std::net::SocketAddr;
use std::process::Stdio;
use std::sync::Arc;

use mom_tests::programs::PATIENCE;
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::Command;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// What a site has.
struct Content {
    files: Vec<(&'static str, &'static str, String)>,
    told: Box<dyn Fn(&str) + Send + Sync>,
}

/// Where a page comes from. What it loads last is answered when the page has said that all is over: until then a browser takes the
/// page for one that loads.
pub(super) struct Site {
    address: SocketAddr,
    task: JoinHandle<()>,
}

impl Site {
    /// A page alone.
    pub(super) async fn start(page: &'static str) -> Site {
        Site::start_with(vec![("/", "text/html", page.into())], |_| ()).await
    }

    /// These files, by path and type; a request for another path is told.
    pub(super) async fn start_with(
        files: Vec<(&'static str, &'static str, String)>,
        told: impl Fn(&str) + Send + Sync + 'static,
    ) -> Site {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("its address");
        let task = tokio::spawn(async move {
            let over = Arc::new(watch::Sender::new(false));
            let content = Arc::new(Content {
                files,
                told: Box::new(told),
            });
            while let Ok((stream, _)) = listener.accept().await {
                // A browser may close whenever it likes.
                drop(tokio::spawn(answer(
                    stream,
                    Arc::clone(&over),
                    Arc::clone(&content),
                )));
            }
        });
        Site { address, task }
    }

    pub(super) fn origin(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The page as Chromium has it at the end.
    pub(super) async fn visit(&self, hub: SocketAddr) -> String {
        let profile = tempfile::tempdir().expect("a folder");
        let mut chromium = Command::new("chromium");
        chromium
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
            ])
            .args([
                "--no-first-run",
                "--disable-background-networking",
                "--disable-sync",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("--dump-dom")
            .arg(format!("{}/?hub={}", self.origin(), hub))
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .kill_on_drop(true);
        let output = timeout(PATIENCE, chromium.output()).await;
        let output = output.expect("the page comes to an end");
        let output = output.expect("Debian's chromium is installed: cargo xtask test --install");
        String::from_utf8(output.stdout).expect("text")
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Answers one request, and closes.
async fn answer(
    mut stream: TcpStream,
    over: Arc<watch::Sender<bool>>,
    content: Arc<Content>,
) -> std::io::Result<()> {
    let mut reader = BufReader::new(&mut stream);
    let mut first = String::new();
    reader.read_line(&mut first).await?;
    let mut line = first.clone();
    while line.trim_end() != "" {
        line.clear();
        reader.read_line(&mut line).await?;
    }
    let path = first.split(['?', ' ']).nth(1).unwrap_or_default();
    let file = content.files.iter().find(|(known, _, _)| *known == path);
    let (status, kind, body) = match (file, path) {
        (Some((_, kind, text)), _) => ("200 OK", *kind, text.as_str()),
        (None, "/over") => {
            over.send_replace(true);
            ("204 No Content", "text/plain", "")
        }
        (None, "/wait") => {
            // The requester is there as long as the site is.
            let _ = over.subscribe().wait_for(|over| *over).await;
            ("404 Not Found", "text/plain", "")
        }
        (None, other) => {
            (content.told)(other);
            ("404 Not Found", "text/plain", "")
        }
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream
        .write_all(&[head.as_bytes(), body.as_bytes()].concat())
        .await?;
    stream.shutdown().await?;
    stream.read_to_end(&mut Vec::new()).await?;
    Ok(())
}

/// What a person would see of a page, and not its program.
pub(super) fn body(page: &str) -> &str {
    page.split("<script").next().unwrap_or(page)
}
