//! What the configuration takes away is lost at once, on connections that are open: by a real broker, its files and
//! SIGHUP.

use mom_proto::codec::Form;
use mom_proto::{Family, Value, WireError};
use mom_tests::canary::Canary;
use mom_tests::raw::Raw;
use mom_tests::service::{Home, Service};

use super::arena::{self, ARENA, ARM, Robot, about, command, grab};

/// The arena by file: who is of level 1 may drive there.
const DRIVERS: &str = r#"
[managers.arena]
kind = "roles"

[[managers.arena.rules]]
name = "the robot"
users = ["camera"]
allow = ["*"]

[[managers.arena.rules]]
name = "drivers"
min-level = 1
allow = ["join", "info", "grab", "renew", "send"]

[managers.arena-token]
kind = "chain"
of = ["arena", { kind = "level-or-lease", lease = 60000 }]

[[contexts]]
path = "/arena"
kind = "session"
manager = "arena"

[[contexts]]
path = "/arena/token"
kind = "token"
manager = "arena-token"

[[contexts]]
path = "/arena/arm"
kind = "channel"
guard = { token = "/arena/token", names = ["command"] }
"#;

/// What the rule becomes that let bob drive.
const ONLY_LOOK: (&str, &str) = (
    r#"allow = ["join", "info", "grab", "renew", "send"]"#,
    r#"allow = ["join", "info"]"#,
);

struct Scene {
    home: Home,
    service: Service,
    canary: Canary,
    robot: Robot,
    bob: Raw,
    fence: u64,
}

impl Scene {
    /// A broker with a canary, and bob who drives a robot.
    async fn start(form: Form) -> Scene {
        let home = Home::new(DRIVERS);
        let service = home.start().await;
        let address = service.address();
        let canary = Canary::start(address).await;
        let mut robot = Robot::enter(address, Form::Binary).await;
        let mut bob = arena::driver(address, form, "bob").await;
        let fence = grab(&mut bob).await;
        robot.expect(&format!("grabbed bob {fence}")).await;
        bob.post(command("go", None)).await;
        robot.expect(&format!("command go {fence}")).await;
        Scene {
            home,
            service,
            canary,
            robot,
            bob,
            fence,
        }
    }

    /// Changes something in a file's text, and says so to the broker.
    fn reload(&self, change: impl FnOnce(&Home)) {
        change(&self.home);
        self.service.signal("HUP");
    }

    /// The robot is halted and told, and the next in line has the token.
    async fn check_revoked(&mut self) {
        self.robot.expect("halt").await;
        self.robot
            .expect(&format!("released bob revoked {}", self.fence))
            .await;
        let mut next = arena::driver(self.service.address(), Form::Xml, "alice").await;
        let higher = grab(&mut next).await;
        assert!(higher > self.fence);
        self.robot
            .expect(&format!("grabbed {} {higher}", next.name()))
            .await;
        self.canary.check().await;
    }

    async fn end(self) {
        assert!(self.canary.stop().await > 0);
        assert_eq!(self.service.terminate().await.code(), Some(0));
    }
}

/// The users file without a user, or with another level of one.
fn users_with(text: &str, user: &str, level: Option<i32>) -> String {
    let entries = text.split("[[users]]").enumerate();
    let named = format!("name = \"{user}\"");
    let kept = entries.filter_map(|(index, entry)| match (entry.contains(&named), level) {
        _ if index == 0 => Some(entry.to_owned()),
        (true, None) => None,
        (true, Some(level)) => Some(format!("[[users]]{}", with_level(entry, level))),
        (false, _) => Some(format!("[[users]]{entry}")),
    });
    kept.collect()
}

fn with_level(entry: &str, level: i32) -> String {
    let lines = entry.lines().map(|line| match line.starts_with("level = ") {
        true => format!("level = {level}\n"),
        false => format!("{line}\n"),
    });
    lines.collect()
}

/// The next event of this name at a context.
async fn event(peer: &mut Raw, name: &str, path: &str) -> Value {
    loop {
        let event = peer.next_of(Family::Event, name).await;
        if event
            .context
            .as_ref()
            .is_some_and(|context| context.as_str() == path)
        {
            return event.value();
        }
    }
}

async fn ask_info(peer: &mut Raw) -> Value {
    peer.ask(about("info")).await.expect("allowed").value()
}

async fn refusal(peer: &mut Raw, text: &str) -> WireError {
    let id = peer.post(command(text, None)).await;
    peer.answer(id).await.expect_err("not allowed")
}

/// A user that is removed is out: its link is closed with the reason, what it owned is lost, and its password is
/// worth nothing.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_user_is_removed() {
    for form in Form::ALL {
        let mut scene = Scene::start(form).await;
        scene.reload(|home| home.write_users(&users_with(&home.users(), "bob", None)));
        let released = event(&mut scene.bob, "released", arena::TOKEN).await;
        assert_eq!(released.get("reason"), Some(&Value::from("revoked")));
        assert_eq!(scene.bob.last_error().await.expect("why").word(), "revoked");
        scene.check_revoked().await;
        let mut again = Raw::connect(scene.service.address(), form).await;
        let error = again.try_log_in("bob").await.expect_err("removed");
        assert_eq!(error.code.word(), "bad-login");
        scene.end().await;
    }
}

/// A password that is another one now is worth nothing on a live link either: who knows only the old one is out with all
/// that it owned.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_password_is_changed() {
    let mut scene = Scene::start(Form::Binary).await;
    let fresh = mom_broker::hash("another").expect("a hash");
    scene.reload(|home| {
        let users = home.users();
        let bobs = users
            .split("[[users]]")
            .find(|entry| entry.contains("name = \"bob\""));
        let old = bobs.and_then(|entry| entry.lines().find(|line| line.starts_with("password")));
        let old = old.expect("bob has one");
        // Others may have the same; only bob's entry changes.
        let entry = bobs.expect("he is there");
        let changed = entry.replace(old, &format!("password = \"{fresh}\""));
        home.write_users(&users.replace(entry, &changed));
    });
    let released = event(&mut scene.bob, "released", arena::TOKEN).await;
    assert_eq!(released.get("reason"), Some(&Value::from("revoked")));
    assert_eq!(scene.bob.last_error().await.expect("why").word(), "revoked");
    scene.check_revoked().await;
    scene.end().await;
}

/// A level counts from the moment it changes: below what a rule asks for it loses token and place, above that of a
/// rival it keeps the token.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_level_is_changed() {
    let mut scene = Scene::start(Form::Binary).await;
    let mut carol = arena::enter(scene.service.address(), Form::Xml, "carol").await;

    scene.reload(|home| home.write_users(&users_with(&home.users(), "bob", Some(7))));
    while ask_info(&mut carol).await.get("owner-level") != Some(&Value::Int(7)) {
        scene.canary.check().await;
    }
    let error = carol.ask(about("grab")).await.expect_err("7 is above 5");
    assert_eq!(error.get("owner-level"), Some(&Value::Int(7)), "{error}");

    scene.reload(|home| home.write_users(&users_with(&home.users(), "bob", Some(0))));
    let released = event(&mut scene.bob, "released", arena::TOKEN).await;
    assert_eq!(released.get("reason"), Some(&Value::from("revoked")));
    event(&mut scene.bob, "expelled", ARENA).await;
    scene.check_revoked().await;
    // He is still there, but with nothing.
    scene.bob.check_alive().await;
    let error = refusal(&mut scene.bob, "go on").await;
    assert_eq!(error.code.word(), "denied", "{error}");
    let error = scene.bob.ask_about(Family::Context, "join", ARENA).await;
    assert_eq!(error.expect_err("level 0").code.word(), "denied");
    scene.end().await;
}

/// A rule that is taken away took what it gave: the token, and the verdicts that stood.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_rule_is_taken_away() {
    for form in Form::ALL {
        let mut scene = Scene::start(form).await;
        let mut talker = arena::driver(scene.service.address(), form, "carol").await;
        talker.post(mom_tests::raw::message("chat", ARM, "hello")).await;
        scene.robot.expect("chat").await;
        scene.reload(|home| {
            let text = home.config();
            assert!(text.contains(ONLY_LOOK.0));
            home.write_config(&text.replace(ONLY_LOOK.0, ONLY_LOOK.1));
        });
        scene.robot.expect("halt").await;
        scene
            .robot
            .expect(&format!("released bob revoked {}", scene.fence))
            .await;
        // All are where they were, and none of them drives or talks.
        let error = refusal(&mut scene.bob, "go on").await;
        assert_eq!(error.code.word(), "denied", "{error}");
        let error = scene.bob.ask(about("grab")).await.expect_err("taken away");
        assert_eq!(error.get("rule"), Some(&Value::from("arena")), "{error}");
        let id = talker.post(mom_tests::raw::message("chat", ARM, "hello")).await;
        let error = talker.answer(id).await.expect_err("taken away");
        assert_eq!(error.code.word(), "denied", "{error}");
        assert_eq!(ask_info(&mut scene.bob).await.get("owner"), None);
        scene.robot.expect_nothing().await;
        scene.canary.check().await;
        scene.end().await;
    }
}
