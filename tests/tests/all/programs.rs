//! The product's main job through its real programs: a broker, a robot, a camera and two users, each a
//! process of its own talking over TCP (M32, M36–M38).

use std::io::{Read as _, Write as _};
use std::time::Duration;

use mom_client::{Channel, Client, Event, Events, from_value};
use mom_proto::Code;
use mom_proto::codec::Form;
use mom_tests::programs::{PATIENCE, Running, program, project, run, text};
use mom_tests::raw::Raw;
use tokio::time::timeout;

/// Picks the red block and puts it on the blue one.
const SCRIPT: &str = "# pick and place
grip open
move -150 100 20 0 0; grip close   # the red block
move -150 100 120 0 0
move 150 100 60 0 0; grip open
";

struct Lab {
    broker: Running,
    arm: Running,
    camera: Running,
    address: String,
}

impl Lab {
    /// A broker with the lab's own configuration file, the arm over binary, the camera over XML.
    fn start() -> Lab {
        let (broker, address) = Running::broker(&project().join("config/lab.toml"));
        let device = |name: &str, password, scheme: &str| {
            let hub = format!("{scheme}://{address}");
            Running::start(
                name,
                &["--hub", &hub],
                &[("MOM_PASSWORD", password), ("MOM_USER", password)],
            )
        };
        let (arm, camera) = (
            device("mom-arm", "arm", "bin"),
            device("mom-camera", "camera", "tcp"),
        );
        Lab {
            broker,
            arm,
            camera,
            address,
        }
    }

    fn hub(&self, scheme: &str) -> String {
        format!("{scheme}://{}", self.address)
    }

    async fn join(&self, user: &str) -> Client {
        let client = Client::builder(self.hub("tcp"))
            .user(user)
            .password(user)
            .connect()
            .await;
        client.expect("the lab knows its users")
    }

    /// Runs the command line as a user.
    fn mom(&self, user: &str, args: &[&str]) -> std::process::Output {
        let hub = self.hub("bin");
        run(
            "mom",
            args,
            &[("MOM_HUB", &hub), ("MOM_USER", user), ("MOM_PASSWORD", user)],
        )
    }
}

/// The next event that `pick` takes.
async fn next<T>(events: &mut Events, what: &str, mut pick: impl FnMut(Event) -> Option<T>) -> T {
    let wanted = async {
        loop {
            let event = events.next().await.expect("the client lives");
            assert!(
                !matches!(event, Event::Lagged(_)),
                "an idle observer does not lag"
            );
            if let Some(found) = pick(event) {
                return found;
            }
        }
    };
    timeout(PATIENCE, wanted)
        .await
        .unwrap_or_else(|_| panic!("never came: {what}"))
}

/// Waits until a peer is in a channel.
async fn wait_for(client: &Client, channel: &Channel, peer: &str) {
    let mut events = channel.events();
    let there = client
        .members(channel.path().as_str())
        .await
        .expect("carol may ask");
    if !there.iter().any(|member| member.peer == peer) {
        next(&mut events, peer, |event| match event {
            Event::Joined(member) => (member.peer == peer).then_some(()),
            _ => None,
        })
        .await;
    }
}

fn state_of(parcel: &mom_client::Parcel) -> Option<mom_arm::ArmState> {
    (parcel.name() == "state").then(|| from_value(parcel.value()).expect("a state of the arm"))
}

#[tokio::test(flavor = "multi_thread")]
async fn two_users_contend_for_the_robot() {
    let lab = tokio::task::spawn_blocking(Lab::start)
        .await
        .expect("the lab starts");
    let carol = lab.join("carol").await;
    let arm = carol.channel("/robot/arm").await.expect("carol may join");
    let camera = carol.channel("/camera/x").await.expect("carol may join");
    wait_for(&carol, &arm, "arm").await;
    wait_for(&carol, &camera, "camera").await;
    let (mut events, mut images) = (arm.events(), camera.events());

    let folder = tempfile::tempdir().expect("a folder");
    let script = folder.path().join("pick.txt");
    std::fs::write(&script, SCRIPT).expect("a script");
    let alice = Running::start(
        "mom",
        &["run", script.to_str().expect("text")],
        &[
            ("MOM_HUB", &lab.hub("bin")),
            ("MOM_USER", "alice"),
            ("MOM_PASSWORD", "alice"),
        ],
    );
    let fence = next(&mut events, "alice's grab", |event| match event {
        Event::Grabbed { owner, fence, .. } if owner == "alice" => Some(fence),
        _ => None,
    })
    .await;

    refuse_bob(&lab);
    let released = follow_alice(&mut events).await;
    assert_eq!(released, fence);
    let status = tokio::task::spawn_blocking(move || alice.wait())
        .await
        .expect("waited for");
    assert_eq!(status.code(), Some(0));

    check_images(&lab, &mut images, folder.path()).await;

    // Alice is done, so bob may; the fence has risen.
    let held = Running::start(
        "mom",
        &["grab", "/robot/token"],
        &[
            ("MOM_HUB", &lab.hub("tcp")),
            ("MOM_USER", "bob"),
            ("MOM_PASSWORD", "bob"),
        ],
    );
    let higher = next(&mut events, "bob's grab", |event| match event {
        Event::Grabbed { owner, fence, .. } if owner == "bob" => Some(fence),
        _ => None,
    })
    .await;
    assert!(higher > fence);
    held.signal("INT");
    next(&mut events, "bob's release", |event| match event {
        Event::Released { owner, .. } => (owner == "bob").then_some(()),
        _ => None,
    })
    .await;
    end(lab).await;
}

/// Bob is refused, and told by whom and until when.
fn refuse_bob(lab: &Lab) {
    let refused = lab.mom("bob", &["grab", "/robot/token"]);
    let words = text(&refused.stderr) + &text(&refused.stdout);
    assert_eq!(refused.status.code(), Some(1), "{words}");
    for word in [
        "/robot/token is held by alice",
        "robot-token/level-or-lease",
        "level 1",
        "held (101)",
    ] {
        assert!(words.contains(word), "{word:?} is in {words}");
    }
    let sent = lab.mom(
        "bob",
        &[
            "send",
            "/robot/arm",
            "command",
            "move 0 0 400 0 0",
            "--acknowledge",
        ],
    );
    assert_eq!(sent.status.code(), Some(1));
    assert!(
        text(&sent.stderr).contains("not-owner (204)"),
        "{}",
        text(&sent.stderr)
    );
}

/// The robot moves by alice's script alone, every state in order, and carries the block away; gives the fence
/// that she released.
async fn follow_alice(events: &mut Events) -> u64 {
    let mut finished = 0;
    let (mut poses, mut last) = (Vec::new(), None);
    let released = next(events, "the end of alice's script", |event| match event {
        Event::Message(parcel) => {
            if let Some(state) = state_of(&parcel) {
                assert!(
                    last.as_ref()
                        .is_none_or(|last: &mom_arm::ArmState| last.seq < state.seq),
                    "in order"
                );
                poses.push(state.pose);
                last = Some(state);
            }
            if parcel.name() == "status" {
                let status: mom_arm::Status = from_value(parcel.value()).expect("a status");
                assert_eq!(&*status.peer, "alice", "only the owner is obeyed");
                finished += usize::from(status.state == mom_arm::CommandState::Finished);
            }
            None
        }
        Event::Released {
            owner, fence: lost, ..
        } if owner == "alice" => Some(lost),
        _ => None,
    })
    .await;
    assert_eq!(finished, 4, "one end for each line of the script");
    assert!(
        poses.len() > 20,
        "20 poses a second while moving, not {}",
        poses.len()
    );
    let last = last.expect("the robot told its state");
    let red = &last.blocks[0];
    assert!(
        (red.x - 150.0).abs() < 1.0 && (red.y - 100.0).abs() < 1.0 && red.z > 41.0,
        "red stands on blue: {red:?}"
    );
    released
}

/// A new image for new states (M38), and one on request, saved by the command line (M37).
async fn check_images(lab: &Lab, images: &mut Events, folder: &std::path::Path) {
    let image = next(images, "an image", |event| match event {
        Event::Message(parcel) if parcel.name() == "image" => Some(parcel.value()),
        _ => None,
    })
    .await;
    let bytes = image
        .get("image")
        .and_then(|image| image.as_binary().cloned())
        .expect("bytes in a part");
    assert!(bytes.starts_with(&[0xff, 0xd8]), "a JPEG");
    let file = folder.join("x.jpg");
    let saved = lab.mom("bob", &["snap", "x", "--output", file.to_str().expect("text")]);
    assert_eq!(saved.status.code(), Some(0), "{}", text(&saved.stderr));
    assert!(std::fs::read(&file).expect("saved").starts_with(&[0xff, 0xd8]));
}

/// SIGTERM drains within 10 s and exits 0; the devices end by theirs.
async fn end(lab: Lab) {
    let Lab {
        broker, arm, camera, ..
    } = lab;
    broker.signal("TERM");
    let ended = tokio::task::spawn_blocking(move || broker.wait());
    let status = timeout(Duration::from_secs(10), ended)
        .await
        .expect("within 10 s")
        .expect("waited for");
    assert_eq!(status.code(), Some(0));
    for device in [arm, camera] {
        device.signal("TERM");
        let ended = tokio::task::spawn_blocking(move || device.wait())
            .await
            .expect("waited for");
        assert_eq!(ended.code(), Some(0));
    }
}

/// Signals that mean nothing here end nothing, and SIGQUIT ends it as SIGTERM does: connected peers are told.
#[tokio::test(flavor = "multi_thread")]
async fn only_signals_that_say_so_stop_a_broker() {
    let (broker, address) = Running::broker(&project().join("config/lab.toml"));
    let address = address.parse().expect("an address");
    let mut bob = Raw::login(address, Form::Json, "bob").await;
    for name in ["USR1", "USR2", "ALRM"] {
        broker.signal(name);
        bob.check_alive().await;
    }
    broker.signal("QUIT");
    assert_eq!(bob.next_error().await.code, Code::SHUTDOWN);
    let status = tokio::task::spawn_blocking(move || broker.wait()).await;
    assert_eq!(status.expect("waited for").code(), Some(0));
}

/// Whether what this process starts ignores SIGHUP.
pub(crate) fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").expect("the system tells");
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = u64::from_str_radix(ignored.expect("it is told").trim(), 16);
    ignored.expect("a number") & 1 == 1
}

/// A device halts when its program ends, so nothing ends it at once that can be asked for an end in order.
#[test]
fn a_device_ends_in_order_at_each_signal_that_asks_it_to() {
    let (_broker, hub) = Running::broker(&project().join("config/lab.toml"));
    let hub = format!("bin://{hub}");
    let user = [
        ("MOM_HUB", hub.as_str()),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ];
    // Who starts one by `nohup` wants it to outlive the terminal.
    let mut command = std::process::Command::new("sh");
    command
        .args(["-c", "trap '' HUP; exec \"$0\" \"$@\""])
        .arg(program("mom-linuxbot"));
    let kept = Running::of("mom-linuxbot", command.args(["--listen", "127.0.0.1:0"]));
    let line = kept.line_with("127.0.0.1:");
    let place = line.split_once("127.0.0.1:").expect("a port").1;
    let digits = place
        .find(|next: char| !next.is_ascii_digit())
        .unwrap_or(place.len());
    let place = format!("127.0.0.1:{}", &place[..digits]);
    kept.signal("HUP");
    let mut station = std::net::TcpStream::connect(&place).expect("it takes connections");
    let mut answer = [0; 2];
    for _ in 0..300 {
        station.write_all(b"00").expect("it is still there");
        station.read_exact(&mut answer).expect("it answers");
        assert_eq!(&answer, b"00");
    }
    drop(kept);
    // Tests that were started by `nohup` have what they start ignore SIGHUP.
    let signals = match ignores_hangup() {
        true => &["INT", "TERM", "QUIT"][..],
        false => &["INT", "TERM", "QUIT", "HUP"],
    };
    for signal in signals {
        let linuxbot = Running::start("mom-linuxbot", &["--listen", "127.0.0.1:0"], &[]);
        let cubo = Running::start("mom-cubo", &["--listen", "127.0.0.1:0"], &[]);
        let arm = Running::start("mom-arm", &["--hub", &hub], &[("MOM_PASSWORD", "arm")]);
        linuxbot.line_with("127.0.0.1:");
        cubo.line_with("cubo listens on");
        let until = std::time::Instant::now() + PATIENCE;
        while !run("mom", &["stop", "/robot/arm"], &user).status.success() {
            assert!(std::time::Instant::now() < until, "the arm never answered");
        }
        for device in [linuxbot, cubo, arm] {
            device.signal(signal);
            assert_eq!(device.wait().code(), Some(0), "{signal}");
        }
    }
    for signal in &signals[2..] {
        let (lab, _) = Running::lab();
        lab.signal(signal);
        assert_eq!(lab.wait().code(), Some(0), "{signal}");
    }
}

/// SIGHUP has a gateway read its fleet's file again, also while it waits for its hub.
#[test]
fn a_gateway_that_waits_for_its_hub_goes_on_at_hangup() {
    let folder = tempfile::tempdir().expect("a folder");
    let fleet = folder.path().join("fleet.toml");
    std::fs::write(&fleet, "[[robot]]\nunit = 1\naddress = \"127.0.0.1:1\"\n").expect("it is written");
    // It takes connections, and says nothing.
    let hub = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = format!("bin://{}", hub.local_addr().expect("an address"));
    let fleet = fleet.to_str().expect("a path");
    let args = ["--fleet", fleet, "--hub", &address];
    let gateway = Running::start("mom-gateway", &args, &[("MOM_PASSWORD", "gateway")]);
    let _connection = hub.accept().expect("it comes");
    gateway.signal("HUP");
    gateway.signal("TERM");
    assert_eq!(gateway.wait().code(), Some(0));
}

/// README's first command: a hub, an arm and a camera in one process, and what to try next.
#[tokio::test(flavor = "multi_thread")]
async fn the_lab_in_one_process() {
    let (lab, hub) = Running::lab();
    lab.line_with("as bob");
    let as_alice = [
        ("MOM_HUB", hub.as_str()),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ];
    let tree = run("mom", &["tree"], &as_alice);
    assert_eq!(tree.status.code(), Some(0), "{}", text(&tree.stderr));
    for word in [
        "robot",
        "token",
        "camera",
        "chat",
        "command guarded by /robot/token",
    ] {
        assert!(
            text(&tree.stdout).contains(word),
            "{word} is in {}",
            text(&tree.stdout)
        );
    }
    // Said twice while the robot rests: both are answered at once.
    for _ in 0..2 {
        let snap = run("mom", &["snap", "--output", "-"], &as_alice);
        assert!(snap.stdout.starts_with(&[0xff, 0xd8]), "{}", text(&snap.stderr));
    }
    lab.signal("INT");
    let status = tokio::task::spawn_blocking(move || lab.wait())
        .await
        .expect("waited for");
    assert_eq!(status.code(), Some(0));
    assert!(program("mom").exists());
}
