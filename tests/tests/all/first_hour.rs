//! What the lab prints and README has is what a newcomer types: all of it runs, and runs again.

use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

use mom_client::{Client, Event};
use mom_tests::lab;
use mom_tests::programs::{PATIENCE, Running, example, program, project, text, turn};
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// A lab as README starts it, on a free port, and what it says about itself.
struct Lab {
    running: Running,
    /// The two lines that set the environment: alice's, then bob's.
    people: Vec<String>,
    /// The other commands, alice's first.
    commands: Vec<String>,
}

impl Lab {
    fn start() -> Lab {
        let running = Running::start("mom", &["lab", "--listen", "127.0.0.1:0"], &[]);
        let (mut people, mut commands) = (Vec::new(), Vec::new());
        loop {
            let line = running.line_with("  ");
            let Some(command) = line.strip_prefix("  ").filter(|line| !line.starts_with(' ')) else {
                continue;
            };
            if command.starts_with("export ") {
                people.push(command.to_owned());
            } else if command.contains("mom ") {
                commands.push(command.to_owned());
            }
            if command.contains(" watch ") {
                return Lab {
                    running,
                    people,
                    commands,
                };
            }
        }
    }

    /// Runs a line as it is printed, in a shell in which this person's line was typed before.
    fn type_as(&self, person: usize, line: &str) -> Output {
        let script = format!("{}\n{line}", self.people[person]);
        let mut shell = Command::new("sh");
        let folder = tempfile::tempdir().expect("a folder");
        shell
            .args(["-c", &script])
            .current_dir(folder.path())
            .stdin(Stdio::null());
        shell.output().expect("there is a shell")
    }
}

/// The text of a page.
fn page(path: &str) -> String {
    std::fs::read_to_string(project().join(path)).expect("it is there")
}

/// The script of the lab's page.
fn script() -> String {
    let lab = page("docs/lab.md");
    let block = lab.split("`pick.txt` is a script").nth(1);
    let block = block.and_then(|rest| rest.split("```").nth(1)).expect("a block");
    block.trim_start().to_owned()
}

fn check(output: &Output, line: &str) {
    let said = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{line}: {said}");
}

#[test]
fn what_is_printed_runs_and_runs_again() {
    let _turn = turn().blocking_lock();
    let lab = Lab::start();
    let [alice, bob] = [0, 1];
    let mom = program("mom");
    let mom = mom.to_str().expect("text");
    let script = script();
    assert!(script.contains("grip close"), "{script}");
    for _ in 0..2 {
        let mut tried = 0;
        for line in &lab.commands {
            // These go on until Ctrl-C, which is sent when they have said something.
            let goes_on = line.contains(" grab ") || line.contains(" watch ");
            if goes_on {
                continue;
            }
            check(&lab.type_as(alice, line), line);
            tried += 1;
        }
        assert!(tried >= 5, "{:?}", lab.commands);
        let typed = format!("cat > pick.txt <<'END'\n{script}END\n{mom} run pick.txt");
        check(&lab.type_as(alice, &typed), "the lab page's pick.txt");
        // Bob waits while alice holds it, as the lab proposes; each ends by Ctrl-C.
        let grabs: Vec<&String> = lab
            .commands
            .iter()
            .filter(|line| line.contains(" grab "))
            .collect();
        let [hers, his] = grabs[..] else {
            panic!("{grabs:?}")
        };
        let watch = lab.commands.iter().find(|line| line.contains(" watch "));
        let watch = watch.expect("it is printed");
        let interrupted = |line: &str, sign: &str| {
            format!(
                "{line} > said 2>&1 & child=$!\n\
                 until grep -q '{sign}' said; do kill -0 $child || exit 9; sleep 0.05; done\n"
            )
        };
        let waiting = format!(
            "{}{}\n{}kill -INT $child; wait $child; kill -INT $first; wait $first; exit 0",
            interrupted(hers, "holding")
                .replace("said", "hers")
                .replace("child", "first"),
            lab.people[bob],
            interrupted(his, "place\\|queue\\|1st"),
        );
        check(&lab.type_as(alice, &waiting), hers);
        let watching = format!(
            "{watch} > said 2>&1 & child=$!\n\
             until grep -q arm said; do echo reset | {mom} run - > none; done\n\
             kill -INT $child; wait $child"
        );
        check(&lab.type_as(bob, &watching), watch);
    }
    lab.running.signal("INT");
    assert_eq!(lab.running.wait().code(), Some(0));
}

/// README's block in a language, with this hub for that of the lab.
fn program_of_readme(language: &str, hub: &str) -> String {
    let readme = page("README.md");
    let block = readme.split(&*format!("```{language}\n")).nth(1);
    let block = block.and_then(|rest| rest.split("```").next()).expect("a block");
    assert!(block.contains("mom://localhost"), "{block}");
    block.replace("mom://localhost", hub)
}

/// Each drives the arm of a lab, one after the other: a token that is not given back would refuse the next one.
#[test]
fn the_programs_of_readme_drive_the_arm() {
    let example_text = page("mom-client/examples/drive.rs");
    let (_, code) = example_text.split_once('\n').expect("a heading");
    let code = code.split("\n/// The lab's address").next().expect("its main");
    let code = code.replace("#[rustfmt::skip]\n", "");
    let main = program_of_readme("rust", "mom://localhost").replace("\"mom://localhost\"", "hub()");
    assert_eq!(code.trim(), main.trim(), "README has the example of mom-client");
    let lab = Lab::start();
    let (_, hub) = lab.people[0]
        .split_once("MOM_HUB=")
        .expect("the lab says where it is");
    let hub = hub
        .split_whitespace()
        .next()
        .expect("an address")
        .replace("bin://", "mom://");
    let folder = tempfile::tempdir().expect("a folder");
    let python = folder.path().join("drive.py");
    std::fs::write(&python, program_of_readme("python", &hub)).expect("written");
    let script = folder.path().join("drive.mjs");
    let client = project().join("clients/js/dist/mom-client.js");
    let client = format!("\"{}\"", client.display());
    let text_of_js = program_of_readme("js", &hub).replace("\"mom-client\"", &client);
    std::fs::write(&script, text_of_js).expect("written");
    let mut with_python = Command::new(project().join("target/python/bin/python"));
    with_python
        .arg(python)
        .env("PYTHONPATH", project().join("clients/python/src"));
    let mut with_node = Command::new("node");
    with_node.arg(script);
    for mut program in [
        Command::new(example("mom-client", "drive")),
        with_python,
        with_node,
    ] {
        let output = program
            .env("MOM_HUB", &hub)
            .stdin(Stdio::null())
            .output()
            .expect("it starts");
        check(&output, &format!("{program:?}"));
    }
}

/// The blocks of the section on a broker of one's own, by language and in order.
fn own_broker(language: &str) -> Vec<String> {
    let install = page("docs/install.md");
    let section = install.split("## A broker for your own devices").nth(1);
    let section = section
        .and_then(|rest| rest.split("\n## ").next())
        .expect("a section");
    let fence = format!("```{language}\n");
    let blocks = section.split(&*fence).skip(1);
    let blocks = blocks.map(|rest| rest.split("```").next().expect("it ends"));
    blocks.map(str::to_owned).collect()
}

/// The address of a hub, once the log of its broker says it.
async fn where_it_listens(log: PathBuf) -> String {
    loop {
        let said = std::fs::read_to_string(&log).expect("its words");
        let rest = said.split("tcp://").nth(1).unwrap_or_default();
        if let Some(address) = rest.split_whitespace().next().filter(|_| said.ends_with('\n')) {
            return format!("bin://{address}");
        }
        tokio::task::yield_now().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broker_of_one_s_own_runs_as_its_page_says() {
    let bin = spawn_blocking(|| ["mom", "mom-broker", "mom-arm"].map(program))
        .await
        .expect("built");
    let bin = bin[0].parent().expect("a folder").to_owned();
    let folder = tempfile::tempdir().expect("a folder");
    let [config] = &own_broker("toml")[..] else {
        panic!("one configuration")
    };
    // On a port that is free here.
    let config = format!("listen = [\"127.0.0.1:0\"]\n{config}");
    std::fs::write(folder.path().join("mom.toml"), config).expect("written");
    let [passwd, devices, broker, arm, tree] = &own_broker("sh")[..] else {
        panic!("a block for each terminal, and for what asks for a password")
    };
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").expect("text"));
    let shell = |script: &str, hub: &str| {
        let mut shell = tokio::process::Command::new("sh");
        shell.args(["-ec", script]).current_dir(folder.path());
        shell.envs([("PATH", &*path), ("MOM_PASSWORD", "secret"), ("MOM_HUB", hub)]);
        shell
            .env("XDG_STATE_HOME", folder.path())
            .stdin(Stdio::null())
            .kill_on_drop(true);
        shell
    };
    let made = shell(&format!("{passwd}{devices}"), "")
        .output()
        .await
        .expect("a shell");
    assert!(
        made.status.success(),
        "{}",
        text(&made.stdout) + &text(&made.stderr)
    );
    for one in [passwd, broker, arm, tree] {
        assert_eq!(
            one.lines().count(),
            1,
            "{one}: what goes on, or asks, is alone in its block"
        );
    }
    let log = std::fs::File::create(folder.path().join("log")).expect("a file");
    let mut broker = shell(&format!("exec {broker}"), "")
        .stdout(log)
        .spawn()
        .expect("a shell");
    let listens = where_it_listens(folder.path().join("log"));
    let hub = timeout(PATIENCE, listens).await.expect("it says where");
    let mut arm = shell(&format!("exec {arm}"), &hub).spawn().expect("a shell");
    let arm_is_there = async {
        loop {
            let shown = shell(tree, &hub).output().await.expect("a shell");
            assert!(shown.status.success(), "{}", text(&shown.stderr));
            let shown = text(&shown.stdout);
            if shown.lines().any(|line| line.contains("channel  arm")) {
                return;
            }
        }
    };
    timeout(PATIENCE, arm_is_there).await.expect("it joins");
    for running in [&mut arm, &mut broker] {
        running.kill().await.expect("it runs");
    }
}

/// Who switches everything on at once need not know what has to be there first.
#[tokio::test(flavor = "multi_thread")]
async fn a_device_waits_for_its_hub_and_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let broker = lab::start().await;
    let alice = Client::builder(format!("bin://{}", broker.local_addr()));
    let alice = alice
        .user("alice")
        .password("alice")
        .connect()
        .await
        .expect("a user of the lab");
    let mut events = alice.channel("/robot/arm").await.expect("people may").events();
    for device in ["mom-arm", "mom-camera", "mom-model"] {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let hub = format!("bin://{}", listener.local_addr().expect("bound"));
        let log = folder.path().join(device);
        let file = std::fs::File::create(&log).expect("a file");
        let name = device.trim_start_matches("mom-");
        let running = spawn_blocking(move || {
            let password = [("MOM_PASSWORD", name), ("RUST_LOG", "info")];
            Running::start_with(device, &["--hub", &hub], &password, file.into())
        });
        let running = running.await.expect("it starts");
        // Nobody is there who speaks as a hub does.
        for _ in 0..3 {
            drop(
                timeout(PATIENCE, listener.accept())
                    .await
                    .expect("it tries again"),
            );
        }
        let address = broker.local_addr();
        let relay = tokio::spawn(async move {
            let (mut near, _) = listener.accept().await.expect("it tries again");
            let mut far = TcpStream::connect(address).await.expect("the hub is there");
            // It ends with the device.
            let _ = copy_bidirectional(&mut near, &mut far).await;
        });
        let joined = async {
            loop {
                match events.next().await.expect("the channel stays") {
                    Event::Joined(member) if member.peer == name => return,
                    _ => {}
                }
            }
        };
        timeout(PATIENCE, joined).await.expect("it finds the hub");
        let said = std::fs::read_to_string(&log).expect("its log");
        // Once for each reason, of which there are two: a link that ends and one that is reset.
        let said_so = said.matches("waiting for the hub").count();
        assert!((1..=3).contains(&said_so), "{said}");
        running.signal("INT");
        let status = spawn_blocking(move || running.wait()).await.expect("waited for");
        assert_eq!(status.code(), Some(0), "{device}");
        relay.await.expect("it ends with the device");
    }
    alice.close().await;
    broker.stop().await;
}

/// So need not who only watches.
#[tokio::test(flavor = "multi_thread")]
async fn a_watcher_waits_for_its_hub_and_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let broker = lab::start().await;
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let hub = format!("bin://{}", listener.local_addr().expect("bound"));
    let log = folder.path().join("log");
    let file = std::fs::File::create(&log).expect("a file");
    let said = || std::fs::read_to_string(&log).expect("its words");
    let alice = [("MOM_USER", "alice"), ("MOM_PASSWORD", "alice")];
    let watch = ["--hub".to_owned(), hub, "watch".to_owned(), "/chat".to_owned()];
    let running = spawn_blocking(move || {
        let watch = watch.each_ref().map(String::as_str);
        Running::start_with("mom", &watch, &alice, file.into())
    });
    let running = running.await.expect("it starts");
    for _ in 0..3 {
        let tried = timeout(PATIENCE, listener.accept()).await;
        drop(tried.expect("it tries again"));
    }
    assert_eq!(said().matches("waiting for it").count(), 1, "{}", said());
    let address = broker.local_addr();
    let relay = tokio::spawn(async move {
        let (mut near, _) = listener.accept().await.expect("it tries again");
        let mut far = TcpStream::connect(address).await.expect("the hub is there");
        // It ends with the program.
        let _ = copy_bidirectional(&mut near, &mut far).await;
    });
    let watching = async {
        while !said().contains("watching /chat") {
            tokio::task::yield_now().await;
        }
    };
    timeout(PATIENCE, watching).await.expect("it finds the hub");
    running.signal("INT");
    let status = spawn_blocking(move || running.wait()).await.expect("waited for");
    assert_eq!(status.code(), Some(0), "{}", said());
    relay.await.expect("it ends with the program");
    broker.stop().await;
}

/// Ctrl-C ends a device that waits, too.
#[tokio::test(flavor = "multi_thread")]
async fn a_device_that_waits_can_be_ended() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let hub = format!("bin://{}", listener.local_addr().expect("bound"));
    let running =
        spawn_blocking(move || Running::start("mom-arm", &["--hub", &hub], &[("MOM_PASSWORD", "arm")]));
    let running = running.await.expect("it starts");
    for _ in 0..2 {
        drop(
            timeout(PATIENCE, listener.accept())
                .await
                .expect("it tries again"),
        );
    }
    running.signal("INT");
    let status = spawn_blocking(move || running.wait()).await.expect("waited for");
    assert_eq!(status.code(), Some(0));
}
