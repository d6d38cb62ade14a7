//! A camera by URL: the real program between a web server of these tests and the lab. Whatever the URL sends, it is an
//! error on that camera's channel and nothing else.

use std::net::SocketAddr;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use mom_client::{Client, Code, Event, Events, Family, Identity, Map, Value};
use mom_proto::codec::Form;
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, Running, project, run, text};
use mom_tests::raw::Raw;
use rustls::crypto::ring;
use rustls::{ServerConfig, ServerConnection, StreamOwned};
use rustls_pki_types::pem::PemObject as _;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};
use tokio::io::{AsyncBufReadExt as _, AsyncWriteExt as _, BufReader};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::timeout;

const USER: &str = "Basic YW5uOnMzY3JldA=="; // ann:s3cret
const STREAM: &str = "200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=cut";

/// The web server of a camera; the path says how it behaves.
struct Web {
    address: SocketAddr,
    file: Arc<Vec<u8>>,
    /// Whether `/mended` answers.
    mended: Arc<AtomicBool>,
    /// The bytes of `/flood` that were sent.
    flooded: Arc<AtomicUsize>,
    _tasks: JoinSet<()>,
}

impl Web {
    async fn start() -> Web {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let file = std::fs::read(project().join("docs/images/camera-y.jpg")).expect("it is in the project");
        let mut web = Web {
            address: listener.local_addr().expect("it is bound"),
            file: Arc::new(file),
            mended: Arc::default(),
            flooded: Arc::default(),
            _tasks: JoinSet::new(),
        };
        let (file, mended, flooded) = (web.file.clone(), web.mended.clone(), web.flooded.clone());
        web._tasks.spawn(async move {
            let mut served = JoinSet::new();
            while let Ok((stream, _)) = listener.accept().await {
                let (file, mended, flooded) = (file.clone(), mended.clone(), flooded.clone());
                served.spawn(async move {
                    // The camera hangs up when it has seen enough.
                    let _ = serve(stream, &file, &mended, &flooded).await;
                });
            }
        });
        web
    }

    fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }
}

/// Answers one request.
async fn serve(
    mut stream: TcpStream,
    file: &[u8],
    mended: &AtomicBool,
    flooded: &AtomicUsize,
) -> std::io::Result<()> {
    let (path, login) = request(&mut stream).await?;
    let image = [b"200 OK\r\nContent-Type: image/jpeg\r\n\r\n", file].concat();
    let plain = |answer: &str| answer.as_bytes().to_vec();
    let answer = match path.as_str() {
        "/snapshot" => image,
        "/mended" if mended.load(Ordering::Relaxed) => image,
        "/login" if login.as_deref() == Some(USER) => image,
        "/login" => plain("401 Unauthorized\r\nWWW-Authenticate: Basic realm=\"x\"\r\n\r\n"),
        "/moved" => plain("302 Found\r\nLocation: http://other/video?pwd=hidden\r\n\r\n"),
        "/broken" => plain("500 Internal Server Error\r\n\r\n"),
        "/page" => plain("200 OK\r\nContent-Type: text/html\r\n\r\n<html>"),
        "/ends" => plain(&format!("{STREAM}\r\n\r\n")),
        "/text" => plain(&format!("{STREAM}\r\n\r\n--cut\r\n\r\nno image\r\n--cut\r\n")),
        "/large" => plain(&format!(
            "{STREAM}\r\n\r\n--cut\r\nContent-Length: 9000000\r\n\r\n"
        )),
        "/noise" => plain("\u{1}\u{2}\r\n\r\n"),
        "/endless" => plain(&format!("{STREAM}\r\n\r\n--cut\r\n\r\n")),
        "/stream" | "/wide" | "/flood" | "/hang" => plain(&format!("{STREAM}\r\n\r\n")),
        "/silent" => std::future::pending().await,
        _ => plain("404 Not Found\r\n\r\n"),
    };
    stream.write_all(b"HTTP/1.1 ").await?;
    stream.write_all(&answer).await?;
    match path.as_str() {
        "/stream" | "/wide" => loop {
            // Some cameras append data to their images.
            let more = vec![0; if path == "/wide" { 1 << 20 } else { 0 }];
            let head = format!(
                "--cut\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
                file.len() + more.len()
            );
            stream
                .write_all(&[head.as_bytes(), file, &more, b"\r\n"].concat())
                .await?;
        },
        "/flood" | "/endless" => {
            let block = vec![b'x'; 1 << 20];
            for _ in 0..100 {
                stream.write_all(&block).await?;
                flooded.fetch_add(block.len(), Ordering::Relaxed);
            }
        }
        "/hang" => std::future::pending().await,
        _ => {}
    }
    stream.shutdown().await
}

/// The path that is asked for, and the login.
async fn request(stream: &mut TcpStream) -> std::io::Result<(String, Option<String>)> {
    let mut lines = BufReader::new(stream).lines();
    let first = lines.next_line().await?.unwrap_or_default();
    let path = first.split(' ').nth(1).unwrap_or_default().to_owned();
    let mut login = None;
    while let Some(line) = lines.next_line().await?.filter(|line| !line.is_empty()) {
        if let Some((name, value)) = line.split_once(": ")
            && name.eq_ignore_ascii_case("authorization")
        {
            login = Some(value.to_owned());
        }
    }
    Ok((path, login))
}

/// `mom lab` as a process, with one more camera's channel.
struct Lab {
    _program: Running,
    hub: String,
    carol: Client,
    events: Events,
}

const BENCH: &str = "/camera/bench";

/// `mom-camera` on the bench of this hub.
async fn camera(hub: &str, url: &str, environment: &[(&str, String)], log: Stdio) -> Running {
    let args = ["--hub", hub, "--channel", BENCH, "--rate", "50"].map(str::to_owned);
    let login = [("MOM_PASSWORD", "camera"), ("MOM_CAMERA_URL", url)];
    let login = login.map(|(name, value)| (name.to_owned(), value.to_owned()));
    let more = environment
        .iter()
        .map(|(name, value)| ((*name).to_owned(), value.clone()));
    let environment: Vec<(String, String)> = login.into_iter().chain(more).collect();
    let started = spawn_blocking(move || {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let environment: Vec<(&str, &str)> = environment
            .iter()
            .map(|(name, value)| (&**name, &**value))
            .collect();
        Running::start_with("mom-camera", &args, &environment, log)
    });
    started.await.expect("it starts")
}

impl Lab {
    async fn start() -> Lab {
        let started = spawn_blocking(Running::lab);
        let (program, hub) = started.await.expect("the lab starts");
        let carol = Client::builder(hub.as_str()).user("carol").password("carol");
        let carol = carol.connect().await.expect("the lab knows its users");
        let spec = Map::new().with("kind", "channel");
        carol.create(BENCH, spec).await.expect("an operator");
        let events = carol.channel(BENCH).await.expect("an operator").events();
        Lab {
            _program: program,
            hub,
            carol,
            events,
        }
    }

    /// `mom-camera` on the bench.
    async fn camera(&self, url: &str, log: Stdio) -> Running {
        camera(&self.hub, url, &[], log).await
    }

    /// Runs the command line as alice: its exit code and all that it says.
    async fn mom(&self, args: &[&str]) -> (Option<i32>, String) {
        let hub = self.hub.clone();
        let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        let ran = spawn_blocking(move || {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            let login = [
                ("MOM_HUB", &*hub),
                ("MOM_USER", "alice"),
                ("MOM_PASSWORD", "alice"),
            ];
            run("mom", &args, &login)
        });
        let output = ran.await.expect("it runs");
        (output.status.code(), text(&output.stdout) + &text(&output.stderr))
    }

    /// The content of the next message of this name on the bench.
    async fn hears(&mut self, name: &str) -> Value {
        next(&mut self.events, name, |_| true).await
    }
}

async fn next(events: &mut Events, name: &str, pick: impl Fn(&Value) -> bool) -> Value {
    let wanted = async {
        loop {
            let Event::Message(parcel) = events.next().await.expect("the client lives") else {
                continue;
            };
            if parcel.name() == name && pick(&parcel.value()) {
                return parcel.value();
            }
        }
    };
    timeout(PATIENCE, wanted)
        .await
        .unwrap_or_else(|_| panic!("no {name}"))
}

fn bytes(content: &Value) -> &[u8] {
    content.get("image").and_then(Value::as_binary).expect("an image")
}

fn number(content: &Value, key: &str) -> Option<i64> {
    content.get(key).and_then(Value::as_int)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_and_a_snapshot_are_shown_as_they_come() {
    let web = Web::start().await;
    let mut lab = Lab::start().await;
    for path in ["/stream", "/snapshot"] {
        let camera = lab.camera(&web.url(path), Stdio::inherit()).await;
        // What is still under way of the camera before is smaller, and the first image may come before the arm's first state.
        let large =
            |content: &Value| number(content, "width") == Some(640) && content.get("pose-time").is_some();
        let content = next(&mut lab.events, "image", large).await;
        assert!(bytes(&content) == &web.file[..], "{path}: no byte is changed");
        assert_eq!(
            (number(&content, "width"), number(&content, "height")),
            (Some(640), Some(480))
        );
        assert_eq!(content.get("view").and_then(Value::as_str), Some("bench"));
        assert!(content.get("overlays").is_some(), "of the lab's arm");
        assert_eq!(content.get("matrix"), None);
        lab.hears("image").await;
        let (code, said) = lab.mom(&["camera", "bench"]).await;
        assert_eq!(
            (code, said.trim_end()),
            (Some(0), "/camera/bench  640x480, jpeg, as the camera gives it")
        );
        let (code, said) = lab
            .mom(&["camera", "bench", "--size", "160x160", "--quality", "40"])
            .await;
        assert_eq!(
            (code, said.trim_end()),
            (Some(0), "/camera/bench  160x160, quality 40, jpeg")
        );
        let small = next(&mut lab.events, "image", |content| {
            number(content, "width") == Some(160)
        })
        .await;
        assert_eq!(
            (number(&small, "height"), number(&small, "quality")),
            (Some(120), Some(40))
        );
        assert!(bytes(&small).starts_with(&[0xff, 0xd8]) && bytes(&small).len() < web.file.len());
        let (code, said) = lab.mom(&["snap", "bench", "--output", "-"]).await;
        assert_eq!(code, Some(0), "{said}");
        drop(camera);
    }
}

/// The most memory that the program has had, KiB.
#[cfg(target_os = "linux")]
fn peak(program: &Running) -> usize {
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.id())).expect("it runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let number = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
    number.expect("Linux tells it")
}

/// What each URL has wrong.
fn bad_urls(web: &Web) -> Vec<(String, Code, &'static str)> {
    let refused = {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
        format!("http://{}/", listener.local_addr().expect("it is bound"))
    };
    let mut all = vec![(refused, Code::TRY_LATER, "it cannot be connected: ")];
    let later = [
        ("/missing", "the answer is 404 Not Found"),
        ("/broken", "the answer is 500 Internal Server Error"),
        ("/moved", "it is redirected to http://other/video?…; name the URL"),
        (
            "/page",
            "the answer is text/html, and no multipart stream or image",
        ),
        ("/ends", "the stream has ended"),
        ("/text", "8 bytes came that are neither JPEG nor PNG"),
        ("/large", "a part is larger than 8126464 bytes"),
        ("/noise", "the answer cannot be read: "),
        ("/endless", "a part is larger than 8126464 bytes"),
        ("/flood", "there is no boundary in 65536 bytes"),
    ];
    all.extend(later.map(|(path, words)| (web.url(path), Code::TRY_LATER, words)));
    for path in ["/silent", "/hang"] {
        all.push((web.url(path), Code::TIMED_OUT, "nothing has come for 5 s"));
    }
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_url_is_an_error_on_its_channel_and_nothing_else() {
    let web = Web::start().await;
    let mut lab = Lab::start().await;
    let x = lab.carol.channel("/camera/x").await.expect("an operator");
    let mut x = x.events();
    for (url, code, words) in bad_urls(&web) {
        let camera = lab.camera(&url, Stdio::inherit()).await;
        let error = lab.hears("camera-error").await;
        let said = error
            .get("text")
            .and_then(Value::as_str)
            .unwrap_or_default()
            .to_owned();
        assert!(said.starts_with(&format!("{url}: {words}")), "{said}");
        assert!(said.contains("; trying again in 1 s"), "{said}");
        assert_eq!(number(&error, "code"), Some(i64::from(code.number())), "{said}");
        let (code, told) = lab.mom(&["snap", "bench"]).await;
        assert!(code == Some(1) && told.contains(words), "{told}");
        // The other cameras and the arm go on.
        let moved = lab
            .mom(&["jog", "--for", "200ms", "50", "0", "0", "0", "0"])
            .await;
        assert_eq!(moved.0, Some(0), "{}", moved.1);
        next(&mut x, "image", |_| true).await;
        #[cfg(target_os = "linux")]
        assert!(peak(&camera) < 100 << 10, "{url}: {} KiB", peak(&camera));
        drop(camera);
    }
    let flooded = web.flooded.load(Ordering::Relaxed);
    assert!(
        flooded < 180 << 20,
        "{flooded} bytes were read without any sense in them"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_comes_back_when_its_url_does() {
    let web = Web::start().await;
    let mut lab = Lab::start().await;
    let _camera = lab.camera(&web.url("/mended"), Stdio::inherit()).await;
    lab.hears("camera-error").await;
    web.mended.store(true, Ordering::Relaxed);
    let told = lab.hears("camera-recovered").await;
    let words = told
        .get("text")
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned();
    assert_eq!(words, format!("{} gives images again", web.url("/mended")));
    assert_eq!(bytes(&lab.hears("image").await), &web.file[..]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_password_logs_in_and_is_told_to_nobody() {
    let web = Web::start().await;
    let mut lab = Lab::start().await;
    let with = |login: &str| format!("http://{login}@{}/login?pwd=hidden", web.address);
    let log = tempfile::NamedTempFile::new().expect("a file");
    let stdio = || {
        let appended = std::fs::OpenOptions::new().append(true).open(log.path());
        Stdio::from(appended.expect("it is there"))
    };
    // The server looks at the path alone if there is no query.
    let camera = lab
        .camera(&with("ann:wrong").replace("?pwd=hidden", ""), stdio())
        .await;
    let error = lab.hears("camera-error").await;
    let words = error
        .get("text")
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned();
    assert!(
        words.contains("refuses to answer without the right user and password"),
        "{words}"
    );
    assert!(!words.contains("wrong") && !words.contains("ann:"), "{words}");
    drop(camera);
    let camera = lab
        .camera(&with("ann:s3cret").replace("?pwd=hidden", ""), stdio())
        .await;
    assert_eq!(bytes(&lab.hears("image").await), &web.file[..]);
    drop(camera);
    let camera = lab.camera(&with("ann:s3cret"), stdio()).await;
    let error = lab.hears("camera-error").await;
    let words = error
        .get("text")
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned();
    assert!(words.contains("/login?…: the answer is 404 Not Found"), "{words}");
    drop(camera);
    let mut bad = with("ann:s3cret");
    bad.push_str(" %");
    let camera = lab.camera(&bad, stdio()).await;
    let ended = spawn_blocking(move || camera.wait()).await.expect("waited for");
    assert!(!ended.success());
    let logged = std::fs::read_to_string(log.path()).expect("a log");
    assert!(
        logged.contains("this is not a URL") && logged.contains("/login"),
        "{logged}"
    );
    for secret in ["s3cret", "wrong", "hidden", "YW5u"] {
        assert!(!logged.contains(secret), "{logged}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_camera_says_that_it_fails() {
    let lab = Lab::start().await;
    for name in ["camera-error", "camera-recovered"] {
        let (code, said) = lab.mom(&["send", "/camera/x", name, "nothing works"]).await;
        assert!(
            code == Some(1) && said.contains("only the camera shows images"),
            "{said}"
        );
    }
}

/// An unread image is replaced: a slow reader gets the newest, and holds nobody up.
#[tokio::test(flavor = "multi_thread")]
async fn who_reads_slowly_gets_the_newest_image() {
    const IMAGES: usize = 60;
    let web = Web::start().await;
    let broker = lab::start().await;
    let hub = format!("bin://{}", broker.local_addr());
    let carol = Client::builder(hub.as_str()).user("carol").password("carol");
    let carol = carol.connect().await.expect("the lab knows its users");
    let spec = Map::new().with("kind", "channel");
    carol.create(BENCH, spec).await.expect("an operator");
    let mut bob = Raw::connect_small(broker.local_addr(), Form::Binary).await;
    bob.log_in("bob").await;
    bob.join(&["/camera", BENCH]).await;
    let mut events = carol.channel(BENCH).await.expect("an operator").events();
    let _camera = camera(&hub, &web.url("/wide"), &[], Stdio::inherit()).await;
    let taken = |content: &Value| content.get("taken").and_then(Value::as_time).expect("a time");
    let mut newest = next(&mut events, "image", |_| true).await;
    for _ in 0..IMAGES {
        newest = next(&mut events, "image", |_| true).await;
    }
    // Bob has read nothing so far.
    let mut old = 0;
    while taken(&bob.next_of(Family::Message, "image").await.value()) < taken(&newest) {
        old += 1;
    }
    assert!(old < IMAGES / 3, "{old} images of {IMAGES} waited for him");
}

/// Answers each request over TLS with this file, on a free port.
fn tls_server(identity: &Identity, file: Arc<Vec<u8>>) -> SocketAddr {
    let chain = CertificateDer::pem_file_iter(&identity.certificate).expect("a file");
    let chain = chain.collect::<Result<Vec<_>, _>>().expect("PEM");
    let key = PrivateKeyDer::from_pem_file(&identity.key).expect("PEM");
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, key));
    let config = Arc::new(config.expect("they belong together"));
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("it is bound");
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let connection = ServerConnection::new(config.clone()).expect("a right configuration");
            // A camera that does not trust it hangs up.
            let _ = answer_over_tls(StreamOwned::new(connection, stream), &file);
        }
    });
    address
}

fn answer_over_tls(
    mut stream: StreamOwned<ServerConnection, std::net::TcpStream>,
    file: &[u8],
) -> std::io::Result<()> {
    use std::io::{BufRead as _, Write as _};
    let mut lines = std::io::BufReader::new(&mut stream).lines();
    while lines.next().transpose()?.is_some_and(|line| !line.is_empty()) {}
    let head = format!(
        "HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
        file.len()
    );
    stream.write_all(&[head.as_bytes(), file].concat())?;
    stream.flush()
}

#[tokio::test(flavor = "multi_thread")]
async fn https_needs_a_certificate_that_the_system_trusts() {
    let web = Web::start().await;
    let folder = tempfile::tempdir().expect("a folder");
    let identity = mom_tests::tls::make(folder.path(), "camera");
    let address = tls_server(&identity, web.file.clone());
    let mut lab = Lab::start().await;
    let url = format!("https://localhost:{}/", address.port());
    let untrusted = lab.camera(&url, Stdio::inherit()).await;
    let error = lab.hears("camera-error").await;
    let words = error
        .get("text")
        .and_then(Value::as_str)
        .unwrap_or_default()
        .to_owned();
    assert!(
        words.contains("cannot be connected: ") || words.contains("no certificates to trust"),
        "{words}"
    );
    drop(untrusted);
    let file = identity.certificate.to_str().expect("text").to_owned();
    let _trusted = camera(&lab.hub, &url, &[("SSL_CERT_FILE", file)], Stdio::inherit()).await;
    assert_eq!(bytes(&lab.hears("image").await), &web.file[..]);
}
