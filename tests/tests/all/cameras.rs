//! The cameras of `mom lab` through a real broker (M37, M38, M54), and the command that sets them.

use mom_client::{Client, Event, Events, Value};
use mom_tests::programs::{PATIENCE, Running, run, text};
use tokio::time::timeout;

const VIEWS: [&str; 5] = ["x", "y", "top", "wrist", "pan"];

/// `mom lab` as a process, on a free port.
struct Lab {
    program: Running,
    hub: String,
}

impl Lab {
    async fn start() -> Lab {
        let started = tokio::task::spawn_blocking(|| {
            let (program, hub) = Running::lab();
            Lab { program, hub }
        });
        started.await.expect("the lab starts")
    }

    async fn join(&self, user: &str) -> Client {
        let client = Client::builder(self.hub.as_str()).user(user).password(user);
        client.connect().await.expect("the lab knows its users")
    }

    /// Runs the command line as a user.
    async fn mom(&self, user: &str, args: &[&str]) -> std::process::Output {
        let (hub, user) = (self.hub.clone(), user.to_owned());
        let args: Vec<String> = args.iter().map(|&arg| arg.to_owned()).collect();
        let ran = tokio::task::spawn_blocking(move || {
            let args: Vec<&str> = args.iter().map(String::as_str).collect();
            let login = [("MOM_HUB", &*hub), ("MOM_USER", &*user), ("MOM_PASSWORD", &*user)];
            run("mom", &args, &login)
        });
        ran.await.expect("it runs")
    }

    async fn end(self) {
        self.program.signal("INT");
        let ended = tokio::task::spawn_blocking(move || self.program.wait());
        assert_eq!(ended.await.expect("waited for").code(), Some(0));
    }
}

fn said(bytes: &[u8]) -> String {
    text(bytes).trim_end().to_owned()
}

/// The next image to everybody that `pick` takes.
async fn image(events: &mut Events, pick: impl Fn(&Value) -> bool) -> Value {
    let wanted = async {
        loop {
            match events.next().await.expect("the client lives") {
                Event::Message(parcel) if parcel.name() == "image" => {
                    let content = parcel.value();
                    if pick(&content) {
                        return content;
                    }
                }
                _ => {}
            }
        }
    };
    timeout(PATIENCE, wanted).await.expect("an image comes")
}

fn number(content: &Value, key: &str) -> i64 {
    let number = content.get(key).and_then(Value::as_int);
    number.unwrap_or_else(|| panic!("{key} is a number"))
}

/// The names of the lines that may be laid over an image.
fn names(content: &Value) -> Vec<&str> {
    let overlays = content.get("overlays").and_then(Value::as_list);
    let names = overlays.into_iter().flatten();
    names
        .filter_map(|overlay| overlay.get("name")?.as_str())
        .collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn all_cameras_show_each_new_state() {
    let lab = Lab::start().await;
    let bob = lab.join("bob").await;
    let mut cameras = Vec::new();
    for view in VIEWS {
        let channel = bob.channel(&format!("/camera/{view}")).await;
        cameras.push((view, channel.expect("people may").events()));
    }
    let script = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(script.path(), "move 250 200 300 30 0; move 100 50 200 30 0\n").expect("written");
    let moved = lab
        .mom("alice", &["run", script.path().to_str().expect("text")])
        .await;
    assert_eq!(moved.status.code(), Some(0), "{}", text(&moved.stderr));
    for (view, events) in &mut cameras {
        let first = image(events, |_| true).await;
        let later = image(events, |content| {
            content.get("pose-time") != first.get("pose-time") && names(content).contains(&"predicted")
        })
        .await;
        for content in [&first, &later] {
            assert_eq!(content.get("view").and_then(Value::as_str), Some(*view));
            assert_eq!((number(content, "width"), number(content, "height")), (640, 480));
            let bytes = content.get("image").and_then(Value::as_binary).expect("bytes");
            assert!(bytes.starts_with(&[0xff, 0xd8]), "{view}: a JPEG");
            let matrix = content.get("matrix").and_then(Value::as_list).expect("a matrix");
            assert_eq!(matrix.len(), 12, "{view}");
            let names = names(content);
            assert!(
                names.contains(&"pose") && names.contains(&"block red"),
                "{view}: {names:?}"
            );
            let pose = content.get("pose-time").and_then(Value::as_time).expect("a time");
            let taken = content.get("taken").and_then(Value::as_time).expect("a time");
            assert!(pose <= taken, "{view}: {pose} is before {taken}");
        }
        let fixed = first.get("matrix") == later.get("matrix");
        assert_eq!(
            fixed,
            *view != "wrist",
            "{view}: only the wrist's camera moves with the arm"
        );
    }
    for view in VIEWS {
        let snap = lab.mom("alice", &["snap", view, "--output", "-"]).await;
        assert!(
            snap.stdout.starts_with(&[0xff, 0xd8]),
            "{view}: {}",
            text(&snap.stderr)
        );
    }
    lab.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn only_the_owner_of_the_token_sets_a_camera() {
    let lab = Lab::start().await;
    let told = async |user: &str, args: &[&str]| {
        let output = lab.mom(user, &[&["camera"], args].concat()).await;
        (output.status.code(), said(&output.stdout), said(&output.stderr))
    };
    let done = |line: &str| (Some(0), line.to_owned(), String::new());
    assert_eq!(
        told("bob", &["x"]).await,
        done("/camera/x  640x480, quality 80, jpeg")
    );

    // Nobody owns the token: it is taken for the change.
    let change = ["x", "--size", "320x240", "--quality", "60"];
    assert_eq!(
        told("bob", &change).await,
        done("/camera/x  320x240, quality 60, jpeg")
    );
    let carol = lab.join("carol").await;
    let token = carol.token("/robot/token").await.expect("operators may");
    assert_eq!(
        token.status().await.expect("told").owner,
        None,
        "it is given back"
    );
    let channel = carol.channel("/camera/x").await.expect("operators may");
    let mut events = channel.events();
    let ask = channel.message("request").send().await;
    ask.expect("anybody may ask");
    let seen = image(&mut events, |_| true).await;
    assert_eq!((number(&seen, "width"), number(&seen, "quality")), (320, 60));

    // Another peer owns it: the camera says who, to the requester.
    let guard = token.grab().await.expect("it is free");
    let (code, out, words) = told("bob", &["x", "--size", "64x48"]).await;
    assert_eq!((code, out.as_str()), (Some(1), ""));
    let reason = "only the owner of /robot/token changes the settings, and that is carol";
    assert!(words.contains(reason), "{words}");
    assert_eq!(
        told("bob", &["x"]).await,
        done("/camera/x  320x240, quality 60, jpeg"),
        "anybody may look"
    );
    // Another program of hers is not.
    assert_eq!(
        told("carol", &["x", "--quality", "70"]).await,
        done("/camera/x  320x240, quality 70, jpeg")
    );
    assert!(!guard.is_lost());
    guard.release().await.expect("it is hers");

    // What the camera cannot do it refuses, with its limits.
    let (code, _, words) = told("bob", &["top", "--size", "5000x480"]).await;
    assert_eq!(code, Some(1));
    assert!(
        words.contains("width is 5000; it must be 64 to 1920 pixels"),
        "{words}"
    );
    assert_eq!(
        told("bob", &["top", "--format", "png", "--overlay", "on"]).await,
        done("/camera/top  640x480, quality 80, png, overlays drawn in"),
        "the token is free again"
    );
    // The command line makes no sense, or nobody is there.
    let (code, _, words) = told("bob", &["x", "--size", "640"]).await;
    assert_eq!(code, Some(2), "{words}");
    assert!(words.contains("640x480"), "{words}");
    let (code, _, words) = told("bob", &["z"]).await;
    assert_eq!(code, Some(1), "{words}");
    lab.end().await;
}
