//! Threat 22: owners that die while they drive. Their ownership ends on time, the robot is told and halted, and
//! the next peer to grab has the token.

use std::net::SocketAddr;
use std::time::Duration;

use mom_broker::{Broker, Clock};
use mom_proto::Map;
use mom_proto::codec::Form;
use mom_tests::canary::{Canary, fence_of};
use mom_tests::lab;
use mom_tests::programs::{Running, program};
use mom_tests::raw::Raw;

use super::arena::{self, Robot, about, command, grab};

/// What ends an ownership whose owner only is silent: µs do not pass by themselves here.
const TIMES: [(&str, Duration); 2] = [
    ("lease", Duration::from_secs(10)),
    ("deadman", Duration::from_millis(500)),
];

struct Scene {
    broker: Broker,
    clock: Clock,
    canary: Canary,
    robot: Robot,
}

impl Scene {
    /// A broker with a canary, and an arena whose token has this time.
    async fn start(key: &str, time: Duration) -> Scene {
        let clock = lab::clock();
        let broker = lab::start_at(clock.clone(), |_| {}).await;
        let address = broker.local_addr();
        let canary = Canary::start(address).await;
        let millis = i64::try_from(time.as_millis()).expect("a time");
        arena::make(address, Map::new().with(key, millis).with("expiry", "eager")).await;
        let robot = Robot::enter(address, Form::Binary).await;
        Scene {
            broker,
            clock,
            canary,
            robot,
        }
    }

    fn address(&self) -> SocketAddr {
        self.broker.local_addr()
    }

    /// A peer that owns the token and drives.
    async fn owner(&mut self, form: Form) -> (Raw, u64) {
        let mut owner = arena::driver(self.address(), form, "alice").await;
        let fence = grab(&mut owner).await;
        self.robot
            .expect(&format!("grabbed {} {fence}", owner.name()))
            .await;
        owner.post(command("go", None)).await;
        self.robot.expect(&format!("command go {fence}")).await;
        (owner, fence)
    }

    /// The robot is halted and told, and the next grab works.
    async fn check_lost(&mut self, owner: &str, reason: &str, fence: u64) {
        self.robot.expect("halt").await;
        self.robot
            .expect(&format!("released {owner} {reason} {fence}"))
            .await;
        let mut next = arena::enter(self.address(), Form::Xml, "bob").await;
        let higher = grab(&mut next).await;
        assert!(higher > fence);
        self.robot
            .expect(&format!("grabbed {} {higher}", next.name()))
            .await;
        next.ask(about("release")).await.expect("the owner may");
        self.robot.expect("halt").await;
        self.robot
            .expect(&format!("released {} released {higher}", next.name()))
            .await;
        self.canary.check().await;
    }

    async fn end(self) {
        assert!(self.canary.stop().await > 0);
        self.broker.stop().await;
    }
}

/// A link that ends, in order or by a reset, ends the ownership at once, whatever is left of lease and deadman time.
#[tokio::test]
async fn threat_22_closed_and_reset() {
    for (key, time) in TIMES {
        let mut scene = Scene::start(key, time).await;
        for form in Form::ALL {
            for reset in [false, true] {
                let (owner, fence) = scene.owner(form).await;
                let name = owner.name().to_owned();
                match reset {
                    true => owner.reset(),
                    false => drop(owner),
                }
                scene.check_lost(&name, "disconnected", fence).await;
            }
        }
        scene.end().await;
    }
}

/// Who waits gets the token of a dead owner without asking again.
#[tokio::test]
async fn threat_22_the_queue_moves_on() {
    let (key, time) = TIMES[0];
    let mut scene = Scene::start(key, time).await;
    let (owner, fence) = scene.owner(Form::Binary).await;
    let name = owner.name().to_owned();
    let mut next = arena::enter(scene.address(), Form::Xml, "bob").await;
    let waiting = next
        .post(about("grab").content(Map::new().with("wait", "unlimited")))
        .await;
    next.next_of(mom_proto::Family::Event, "queued").await;
    owner.reset();
    let granted = next.answer(waiting).await.expect("it is its turn");
    let higher = fence_of(&granted.value());
    scene.robot.expect("halt").await;
    scene
        .robot
        .expect(&format!("released {name} disconnected {fence}"))
        .await;
    scene.robot.expect(&format!("grabbed bob {higher}")).await;
    scene.end().await;
}

/// A real program that owns the token and is killed.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn threat_22_killed() {
    // Built before anybody is connected: a robot that waits for a compiler would be given up as silent.
    let built = tokio::task::spawn_blocking(|| program("mom")).await;
    assert!(built.expect("built").exists());
    for (key, time) in TIMES {
        let mut scene = Scene::start(key, time).await;
        let hub = format!("bin://{}", scene.address());
        let owner = tokio::task::spawn_blocking(move || {
            let login = [
                ("MOM_HUB", &*hub),
                ("MOM_USER", "alice"),
                ("MOM_PASSWORD", "alice"),
            ];
            Running::start("mom", &["grab", arena::TOKEN], &login)
        });
        let owner = owner.await.expect("the program starts");
        let grabbed = scene.robot.hears().await;
        let fence = grabbed.strip_prefix("grabbed alice~2 ").map(str::parse);
        let Some(Ok(fence)) = fence else {
            panic!("{grabbed}");
        };
        owner.signal("KILL");
        scene.check_lost("alice~2", "disconnected", fence).await;
        scene.end().await;
    }
}

/// An owner whose link is half open, or whose program hangs: nothing is heard of it and nothing ends. Its time
/// does, to the millisecond.
#[tokio::test]
async fn threat_22_silent_until_its_time_is_over() {
    for (key, time) in TIMES {
        let mut scene = Scene::start(key, time).await;
        for form in Form::ALL {
            let (mut owner, fence) = scene.owner(form).await;
            let name = owner.name().to_owned();
            scene.clock.advance(time - Duration::from_millis(1));
            scene.robot.expect_nothing().await;
            scene.clock.advance(Duration::from_millis(1));
            scene.check_lost(&name, "expired", fence).await;
            // It was there all the time, and finds that it owns nothing.
            let error = owner.ask(about("renew")).await.expect_err("too late");
            assert_eq!(error.code.word(), "not-owner");
        }
        scene.end().await;
    }
}

/// Without lease and deadman time a half-open link is noticed by its silence: the hub gives the peer up.
#[tokio::test]
async fn threat_22_half_open() {
    let broker = lab::start_at(lab::clock(), |config| {
        config.limits.heartbeat = 500;
        config.limits.gone = 4000;
    })
    .await;
    let address = broker.local_addr();
    let first_come = Map::new().with("kind", "first-come");
    arena::make(address, Map::new().with("manager", first_come)).await;
    let mut scene = Scene {
        robot: Robot::enter(address, Form::Binary).await,
        canary: Canary::start(address).await,
        clock: lab::clock(),
        broker,
    };
    let (mut owner, fence) = scene.owner(Form::Xml).await;
    let name = owner.name().to_owned();
    scene.check_lost(&name, "disconnected", fence).await;
    assert_eq!(owner.last_error().await.expect("why").word(), "silent");
    scene.end().await;
}
