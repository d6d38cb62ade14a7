//! The client of `clients/js` in a page and in a worker: what it says and hears outlives its connection.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mom_tests::audit::AuditLog;
use mom_tests::programs::project;
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::broadcast;
use tokio::task::JoinHandle;

use super::doors::{answering, hub};
use super::site::{Site, body};

const PAGE: &str = include_str!("../../../pages/client.html");
const WORKER: &str = include_str!("../../../pages/client-worker.mjs");

/// A network between the page and its hub.
struct Network {
    address: SocketAddr,
    cuts: broadcast::Sender<()>,
    no_websockets: Arc<AtomicBool>,
    task: JoinHandle<()>,
}

impl Network {
    /// Its hub is told later, since that has to know where the page comes from.
    async fn start(hub: tokio::sync::oneshot::Receiver<SocketAddr>) -> Network {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("its address");
        let (cuts, no_websockets) = (broadcast::Sender::new(16), Arc::new(AtomicBool::new(false)));
        let (cut, refuses) = (cuts.clone(), Arc::clone(&no_websockets));
        let task = tokio::spawn(async move {
            let hub = hub.await.expect("the hub's address");
            while let Ok((near, _)) = listener.accept().await {
                drop(tokio::spawn(carry(
                    near,
                    hub,
                    cut.subscribe(),
                    Arc::clone(&refuses),
                )));
            }
        });
        Network {
            address,
            cuts,
            no_websockets,
            task,
        }
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Carries a connection until the network is cut.
async fn carry(
    mut near: TcpStream,
    hub: SocketAddr,
    mut cut: broadcast::Receiver<()>,
    refuses: Arc<AtomicBool>,
) {
    let mut first = [0; 8];
    while near
        .peek(&mut first)
        .await
        .is_ok_and(|read| (1..8).contains(&read))
    {}
    if refuses.load(Ordering::SeqCst) && first == *b"GET /mom" {
        return;
    }
    let Ok(mut far) = TcpStream::connect(hub).await else {
        return;
    };
    tokio::select! {
        _ = cut.recv() => {}
        _ = copy_bidirectional(&mut near, &mut far) => {}
    }
}

/// The client as `npm run build` writes it.
fn built() -> String {
    let file = project().join("clients/js/dist/mom-client.js");
    std::fs::read_to_string(&file).unwrap_or_else(|error| {
        panic!(
            "{}: {error}; `cargo xtask test --install` builds it",
            file.display()
        )
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_and_a_worker_resume_over_websocket_and_tunnel() {
    let (tell, told) = tokio::sync::oneshot::channel();
    let network = Network::start(told).await;
    let (cuts, no_websockets) = (network.cuts.clone(), Arc::clone(&network.no_websockets));
    let files = vec![
        ("/", "text/html", PAGE.to_owned()),
        ("/mom-client.js", "text/javascript", built()),
        ("/worker.mjs", "text/javascript", WORKER.to_owned()),
    ];
    let site = Site::start_with(files, move |asked| {
        no_websockets.store(asked == "/cut-websockets", Ordering::SeqCst);
        // Nobody listens where nothing is connected.
        let _ = cuts.send(());
    })
    .await;
    let audit = AuditLog::new();
    let hub = hub(&site, &audit).await;
    tell.send(hub.local_addr()).expect("the network waits for it");
    let carol = answering(&hub).await;
    let page = site.visit(network.address).await;
    for (name, door) in [("page", "ws"), ("worker", "ws"), ("tunnel", "http")] {
        let shown = format!("<li id=\"{name}\" class=\"ok\">{name}: resumed over {door}</li>");
        assert!(page.contains(&shown), "{name} in {}", body(&page));
    }
    carol.abort();
    hub.stop().await;
    // Each has logged in once.
    let lines = audit.lines();
    assert_eq!(lines.count(&[("what", "login"), ("user", "alice")]), 3);
}
