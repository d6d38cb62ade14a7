//! How a command ended is what its device says of it, and nothing else: no status of another connection, none of before.

use std::process::Stdio;

use mom_broker::Broker;
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value};
use mom_tests::lab;
use mom_tests::linked::Linked;
use mom_tests::programs::{program, text};
use mom_tests::raw::at;
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::{Child, Command};
use tokio::task::spawn_blocking;

const ARM: &str = "/robot/arm";

/// A lab whose arm's channel keeps what is said in it, and the arm, as the test plays it.
async fn lab_with(kept: i64) -> (Broker, Linked) {
    let keep = Map::new().with("parcels", kept);
    let broker = lab::start_with(|config| {
        let mut contexts = config.contexts.iter_mut();
        let arm = contexts.find(|spec| spec.path.as_deref() == Some(ARM));
        arm.expect("the lab has an arm").keep = mom_proto::from_value(keep.into()).expect("a number");
    })
    .await;
    let mut arm = Linked::login(broker.local_addr(), Form::Binary, "arm", 60_000).await;
    arm.about(Family::Context, "join", "/robot").await;
    let join = Parcel::new(Family::Context, "join")
        .context(at(ARM))
        .content(Map::new().with("device", true));
    arm.ask(join).await.expect("it is the arm");
    (broker, arm)
}

fn status(of: &Parcel, state: &str) -> Parcel {
    let content = Map::new()
        .with("peer", of.sender.as_deref().unwrap_or_default())
        .with("state", state)
        .with("statement", 1)
        .with("of", 1)
        .with(
            "id",
            i64::try_from(of.id.expect("it has one")).expect("a small one"),
        );
    Parcel::new(Family::Message, "status")
        .context(at(ARM))
        .content(content)
}

/// `mom run` with one command, as alice.
async fn run(broker: &Broker) -> Child {
    let program = spawn_blocking(|| program("mom")).await.expect("it is built");
    let hub = format!("bin://{}", broker.local_addr());
    let mut command = Command::new(program);
    command.args(["run", "--json", "-"]).kill_on_drop(true);
    command.envs([
        ("MOM_HUB", &*hub),
        ("MOM_USER", "alice"),
        ("MOM_PASSWORD", "alice"),
    ]);
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let mut running = command.spawn().expect("it starts");
    let mut stdin = running.stdin.take().expect("its input is piped");
    tokio::io::AsyncWriteExt::write_all(&mut stdin, b"home")
        .await
        .expect("it reads");
    running
}

/// Statuses of all ids that a client counts from 1 are kept in the channel: none of them ends the command, and none that another
/// connection was given.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_was_said_before_is_no_answer_to_a_command() {
    let (broker, mut arm) = lab_with(200).await;
    let older = |id| Parcel {
        sender: Some("alice".into()),
        ..Parcel::new(Family::Message, "command").id(id)
    };
    for id in 1..=100 {
        arm.raw.send_parcel(&status(&older(id), "finished")).await;
    }
    let running = run(&broker).await;
    let command = arm.next_of(Family::Message, "command").await;
    for id in 1..=100 {
        arm.raw.send_parcel(&status(&older(id), "finished")).await;
    }
    let mut end = status(&command, "error").value();
    if let Value::Map(end) = &mut end {
        let error = Map::new()
            .with("name", "workspace-boundary")
            .with("text", "the wall is there");
        end.set("error", error);
    }
    let end = Parcel::new(Family::Message, "status")
        .context(at(ARM))
        .content(end);
    arm.raw.send_parcel(&end).await;
    let done = running.wait_with_output().await.expect("it ends");
    let said = text(&done.stderr) + &text(&done.stdout);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(said.contains("the wall is there"), "{said}");
    broker.stop().await;
}

/// The driver hears at once that the device's connection is lost, though the device may come back.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_run_ends_when_its_device_is_lost() {
    let (broker, mut arm) = lab_with(1).await;
    let mut running = run(&broker).await;
    let command = arm.next_of(Family::Message, "command").await;
    arm.raw.send_parcel(&status(&command, "executing")).await;
    // Events overtake messages: only then does it know who the arm is.
    let mut told = BufReader::new(running.stdout.take().expect("it is piped")).lines();
    while let Some(line) = told.next_line().await.expect("it is text") {
        if line.contains("executing") {
            break;
        }
    }
    drop(arm);
    let done = running.wait_with_output().await.expect("it ends");
    let said = text(&done.stderr);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(
        said.contains("the hub has lost the connection of arm, the device in /robot/arm"),
        "{said}"
    );
    broker.stop().await;
}
