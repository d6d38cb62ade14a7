//! The agents of `docs/agents.md`: given a token they work, report and return it, and stop when they are interrupted.

use std::fs;
use std::process::Command;
use std::time::Instant;

use mom_client::{Client, Event, Events, Given, Value};
use mom_tests::programs::{PATIENCE, Running, example, program, project, text};
use tokio::time::timeout;

const TOKEN: &str = "/robot/token";
const RUST: &str = "kit/drive/examples/agent.rs";
const PYTHON: &str = "clients/python/examples/agent.py";
const WAVER: &str = "clients/python/examples/waver.py";

/// The template in Rust, at this hub.
fn rust(hub: &str) -> Running {
    start(Command::new(example("mom-drive", "agent")), hub)
}

/// The one in Python.
fn python(hub: &str) -> Running {
    start(in_python(PYTHON), hub)
}

fn in_python(file: &str) -> Command {
    let mut command = Command::new(project().join("target/python/bin/python"));
    command
        .arg(project().join(file))
        .env("PYTHONPATH", project().join("clients/python/src"));
    command
}

fn start(mut command: Command, hub: &str) -> Running {
    command.envs([("MOM_HUB", hub), ("MOM_PASSWORD", "assistant")]);
    Running::of("the agent", &mut command)
}

/// A person with what is said in the chat.
struct Person {
    client: Client,
    chat: Events,
}

impl Person {
    async fn at(hub: &str, name: &str) -> Person {
        let client = Client::builder(hub).user(name).password(name).connect().await;
        let client = client.expect("the lab knows its users");
        let chat = client.channel("/chat").await.expect("people may").events();
        Person { client, chat }
    }

    /// Waits until the agent says this.
    async fn hears(&mut self, words: &str) {
        let heard = async {
            loop {
                if let Some(Event::Message(parcel)) = self.chat.next().await
                    && parcel.sender.as_deref() == Some("assistant")
                    && parcel.value().as_str().is_some_and(|said| said.contains(words))
                {
                    return;
                }
            }
        };
        let heard = timeout(PATIENCE, heard).await;
        heard.unwrap_or_else(|_| panic!("nobody says {words:?}"));
    }

    /// Grabs the token and gives it to the agent for 30 s and 5 commands.
    async fn gives(&self) -> Given {
        let token = self.client.token(TOKEN).await.expect("people may");
        let guard = token.grab().await.expect("it is free");
        let give = guard.give("assistant").time(std::time::Duration::from_secs(30));
        let mut given = give.commands(5).await.expect("it is here");
        given.accepted().await.expect("it takes what it has asked for");
        given
    }
}

/// It asks, works, reports and returns the token.
async fn works(start: fn(&str) -> Running, reports: [&str; 3]) {
    let (_lab, hub) = Running::lab();
    let mut alice = Person::at(&hub, "alice").await;
    let agent = start(&hub);
    alice.hears("may I have the arm").await;
    let given = alice.gives().await;
    for report in reports {
        alice.hears(report).await;
    }
    given.returned().await.expect("it is hers again");
    assert!(agent.wait().success());
}

/// Carol takes the token while it works.
async fn is_interrupted(start: fn(&str) -> Running, report: &str) -> (Running, Running, Person) {
    let (lab, hub) = Running::lab();
    let mut alice = Person::at(&hub, "alice").await;
    let carol = Person::at(&hub, "carol").await;
    let token = carol.client.token(TOKEN).await.expect("people may");
    let mut arm = carol
        .client
        .channel("/robot/arm")
        .await
        .expect("people may")
        .events();
    let agent = start(&hub);
    alice.hears("may I have the arm").await;
    let given = alice.gives().await;
    alice.hears(report).await;
    let guard = token.grab().await.expect("she is an operator");
    assert!(given.returned().await.is_err(), "it is carol's");
    // The arm stands for carol: nothing of it is carried out any more.
    let fence = i64::try_from(guard.fence()).expect("a number");
    let stands = async {
        loop {
            let event = arm.next().await.expect("the lab runs");
            if let Event::Message(parcel) = event
                && parcel.value().get("fence").and_then(Value::as_int) == Some(fence)
            {
                return;
            }
        }
    };
    timeout(PATIENCE, stands).await.expect("the arm stands");
    guard.release().await.expect("it is hers");
    (lab, agent, alice)
}

#[tokio::test(flavor = "multi_thread")]
async fn the_one_in_rust_works_and_returns() {
    works(rust, ["at 350 mm", "at 250 mm", "at 300 mm"]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_one_in_rust_is_interrupted() {
    let (_lab, agent, mut alice) = is_interrupted(rust, "at 350 mm").await;
    alice
        .hears("I stop: lost /robot/token: carol has a higher level and took it")
        .await;
    assert!(agent.wait().success());
}

#[tokio::test(flavor = "multi_thread")]
async fn the_one_in_python_works_and_returns() {
    works(
        python,
        ["finished: 350 mm", "finished: 250 mm", "finished: 300 mm"],
    )
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_one_in_python_is_interrupted() {
    let (_lab, agent, _alice) = is_interrupted(python, "finished: 350 mm").await;
    agent.line_with("interrupted: preempted by carol");
    assert!(agent.wait().success());
}

/// `mom` as this user, whose password is the name.
fn mom(hub: &str, user: &str, args: &[&str]) -> Command {
    let mut mom = Command::new(program("mom"));
    mom.args(args)
        .envs([("MOM_HUB", hub), ("MOM_USER", user), ("MOM_PASSWORD", user)]);
    mom
}

/// A lab with the agent for hire in its channel.
fn with_waver() -> (Running, Running, String) {
    let (lab, hub) = Running::lab();
    let made = mom(&hub, "carol", &["create", "channel", "/waving"]).output();
    assert!(made.expect("it starts").status.success());
    let absent = mom(&hub, "alice", &["hire", "/waving", "wave"]).output();
    let absent = text(&absent.expect("it starts").stderr);
    assert!(
        absent.contains("the agent is not in /waving") && absent.contains("start the agent"),
        "{absent}"
    );
    let waver = start(in_python(WAVER), &hub);
    (lab, waver, hub)
}

/// Hires it as soon as it is there.
fn hire(hub: &str, more: &[&str]) -> std::process::Output {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let hired = mom(hub, "alice", &[&["hire", "/waving", "wave"], more].concat()).output();
        let hired = hired.expect("it starts");
        if !text(&hired.stderr).contains("not in /waving") || Instant::now() > deadline {
            return hired;
        }
    }
}

#[test]
fn the_one_for_hire_waves_for_who_hires_it() {
    let (_lab, _waver, hub) = with_waver();
    let hired = hire(&hub, &["--for", "1m"]);
    let (said, wrong) = (text(&hired.stdout), text(&hired.stderr));
    assert!(hired.status.success(), "{said}\n{wrong}");
    for line in [
        "working: I am at 350 mm",
        "working: I am at 250 mm",
        "working: I am at 300 mm",
        "done: I have waved",
    ] {
        assert!(said.contains(line), "{line} in {said}\n{wrong}");
    }
    // Its scope is two commands.
    let hired = hire(&hub, &["--commands", "2"]);
    assert!(!hired.status.success());
    let wrong = text(&hired.stderr);
    assert!(wrong.contains("used up"), "{wrong}");
    let wrong = mom(&hub, "alice", &["hire", "/waving", "wave", "5"]).output();
    let wrong = text(&wrong.expect("it starts").stderr);
    assert!(wrong.contains("a task is a map in JSON"), "{wrong}");
}

#[test]
fn the_page_shows_them_as_they_are() {
    let page = fs::read_to_string(project().join("docs/agents.md")).expect("it is there");
    for (language, place, file) in [("rust", 1, RUST), ("python", 1, WAVER), ("python", 2, PYTHON)] {
        let text = fs::read_to_string(project().join(file)).expect("it is there");
        let shown = page.split(&format!("```{language}\n")).nth(place);
        let shown = shown.and_then(|rest| rest.split("```").next());
        assert_eq!(shown, Some(text.as_str()), "docs/agents.md shows {file}");
        assert!(text.lines().count() <= 50, "{file} is short");
    }
}
