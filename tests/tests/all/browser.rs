//! A page in headless Chromium: a peer through each door that a browser has, if its origin is on the hub's list.

use std::net::SocketAddr;
use std::process::Stdio;
use std::sync::Arc;

use mom_broker::Broker;
use mom_proto::codec::Form;
use mom_proto::{Family, Map};
use mom_tests::audit::AuditLog;
use mom_tests::lab;
use mom_tests::programs::PATIENCE;
use mom_tests::raw::{Raw, message};
use tokio::io::{AsyncBufReadExt as _, AsyncReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::process::Command;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::timeout;

const PAGE: &str = include_str!("../../pages/doors.html");
const DOORS: [&str; 3] = ["websocket-json", "websocket-binary", "tunnel"];

/// Where a page comes from. What it loads last is answered when the page has said that all is over: until then a browser takes the
/// page for one that loads.
struct Site {
    address: SocketAddr,
    task: JoinHandle<()>,
}

impl Site {
    async fn start() -> Site {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("its address");
        let task = tokio::spawn(async move {
            let over = Arc::new(watch::Sender::new(false));
            while let Ok((stream, _)) = listener.accept().await {
                // A browser may close whenever it likes.
                drop(tokio::spawn(answer(stream, Arc::clone(&over))));
            }
        });
        Site { address, task }
    }

    fn origin(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The page as Chromium has it at the end.
    async fn visit(&self, hub: &Broker) -> String {
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
            .arg(format!("{}/?hub={}", self.origin(), hub.local_addr()))
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
async fn answer(mut stream: TcpStream, over: Arc<watch::Sender<bool>>) -> std::io::Result<()> {
    let mut reader = BufReader::new(&mut stream);
    let mut first = String::new();
    reader.read_line(&mut first).await?;
    let mut line = first.clone();
    while line.trim_end() != "" {
        line.clear();
        reader.read_line(&mut line).await?;
    }
    let (status, body) = match first.split(['?', ' ']).nth(1) {
        Some("/") => ("200 OK", PAGE),
        Some("/over") => {
            over.send_replace(true);
            ("204 No Content", "")
        }
        Some("/wait") => {
            // Whoever asks is there as long as the site is.
            let _ = over.subscribe().wait_for(|over| *over).await;
            ("404 Not Found", "")
        }
        _ => ("404 Not Found", ""),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/html\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream
        .write_all(&[head.as_bytes(), body.as_bytes()].concat())
        .await?;
    stream.shutdown().await?;
    stream.read_to_end(&mut Vec::new()).await?;
    Ok(())
}

/// A hub that knows pages of this site, and where they log in.
async fn hub(known: &Site, audit: &AuditLog) -> Broker {
    lab::start_with(|config| {
        config.web.origins = vec![known.origin()];
        config.login.guests = true;
        // Guests too.
        lab::rule_chat(config, Map::new().with("allow", lab::words(&["*"])));
        config.audit.path = Some(audit.path());
    })
    .await
}

/// Answers everybody who says hello in the chat.
async fn answering(hub: &Broker) -> JoinHandle<()> {
    let mut carol = Raw::login(hub.local_addr(), Form::Binary, "carol").await;
    carol.join(&["/chat"]).await;
    tokio::spawn(async move {
        while let Some(heard) = carol.next().await {
            let own = heard.sender.as_deref() == Some("carol");
            if heard.is(Family::Message, "chat") && !own {
                let said = heard.value();
                let said = said.as_str().expect("text");
                carol
                    .post(message("chat", "/chat", format!("heard {said}")))
                    .await;
            }
        }
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_is_a_peer_through_each_door() {
    let (site, audit) = (Site::start().await, AuditLog::new());
    let hub = hub(&site, &audit).await;
    let carol = answering(&hub).await;
    let page = site.visit(&hub).await;
    for (door, user) in DOORS.into_iter().zip(["alice", "guest", "bob"]) {
        let shown = format!("<li id=\"{door}\" class=\"ok\">{door}: {user} was heard by carol</li>");
        assert!(page.contains(&shown), "{door} in {}", body(&page));
    }
    carol.abort();
    hub.stop().await;
    let lines = audit.lines();
    for user in ["alice", "guest", "bob"] {
        assert_eq!(lines.count(&[("what", "login"), ("user", user)]), 1, "{user}");
    }
}

/// Threat 18, by a browser's own rules: the page hears nothing but that it failed, and nobody has logged in.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_18_a_page_of_another_origin_comes_through_no_door() {
    let (site, other, audit) = (Site::start().await, Site::start().await, AuditLog::new());
    let hub = hub(&site, &audit).await;
    let page = other.visit(&hub).await;
    for (door, why) in DOORS
        .into_iter()
        .zip(["no WebSocket: 1006", "no WebSocket: 1006", "Failed to fetch"])
    {
        let shown = format!("<li id=\"{door}\" class=\"failed\">{door}: {why}</li>");
        assert!(page.contains(&shown), "{door} in {}", body(&page));
    }
    hub.stop().await;
    assert_eq!(audit.lines().count(&[("what", "login")]), 0);
}

/// What a person would see of a page, and not its program.
fn body(page: &str) -> &str {
    page.split("<script>").next().unwrap_or(page)
}
