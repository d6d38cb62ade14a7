//! Two arms over one table (M40): each keeps out of the zones that its driver does not own, and keeps others from being granted
//! those in which it stands.

use std::path::Path;

use mom_client::{Client, Code, Event, TokenGuard};
use mom_drive::{CommandEnd, Commander, DeviceChannel, How};
use mom_tests::programs::{PATIENCE, Running, project};
use tokio::time::{Instant, timeout};

async fn arrive(hub: &str, name: &str) -> Client {
    let client = Client::builder(hub).user(name).password(name).connect().await;
    client.expect("the lab knows its users")
}

async fn grab(client: &Client, token: &str) -> Result<TokenGuard, mom_client::ClientError> {
    client.token(token).await.expect("they may look").grab().await
}

/// A robot under its token.
async fn drive(client: &Client, robot: &str) -> (Commander, TokenGuard) {
    let guard = grab(client, &format!("{robot}/token")).await.expect("it is free");
    let channel = DeviceChannel::join(client, &format!("{robot}/arm"))
        .await
        .expect("they may look");
    (Commander::new(channel, guard.fence()), guard)
}

fn refused(end: CommandEnd) -> String {
    match end.how {
        How::Failed(report) => report.wire_error().text,
        other => panic!("not refused: {other:?}"),
    }
}

#[tokio::test]
async fn a_zone_is_open_at_once_to_who_grabbed_it_and_closed_at_once_to_who_lost_it() {
    let (_lab, hub) = Running::lab_with(&["--two-arms"]);
    let alice = arrive(&hub, "alice").await;
    let (mut robot, _token) = drive(&alice, "/robot").await;
    for _ in 0..20 {
        let left = grab(&alice, "/zone/left").await.expect("it is free");
        let end = robot.carry_out("move 0 0 290 0 0; home").await;
        assert!(end.is_finished(), "{end:?}");
        left.release().await.expect("it is hers");
        let why = refused(robot.carry_out("move 0 0 290 0 0").await);
        assert!(why.contains("/zone/left, which alice does not own"), "{why}");
    }
}

#[tokio::test]
async fn what_moves_in_a_zone_that_is_lost_stops_there_and_keeps_others_out() {
    let (_lab, hub) = Running::lab_with(&["--two-arms"]);
    let (alice, bob) = (arrive(&hub, "alice").await, arrive(&hub, "bob").await);
    let (mut robot, _token) = drive(&alice, "/robot").await;
    let left = grab(&alice, "/zone/left").await.expect("it is free");
    let middle = grab(&alice, "/zone/middle").await.expect("it is free");
    robot.carry_out("move 240 0 300 0 0").await;
    // It is lost while the robot moves in it.
    let moving = tokio::spawn(async move {
        let end = robot
            .carry_out("wait 300; move 150 200 300 0 0; move 240 -200 300 0 0; wait 60000")
            .await;
        (robot, end)
    });
    middle.release().await.expect("it is hers");
    let (mut robot, end) = moving.await.expect("it ends");
    let why = refused(end);
    assert!(why.contains("/zone/middle, which alice does not own"), "{why}");
    let denied = grab(&bob, "/zone/middle")
        .await
        .expect_err("the arm stands there");
    assert_eq!(denied.code(), Some(&Code::DECLINED), "{denied}");
    assert!(
        denied.to_string().contains("the arm stands in /zone/middle"),
        "{denied}"
    );
    // The owner of its token may have it, and drives out.
    let middle = grab(&alice, "/zone/middle")
        .await
        .expect("she drives the arm that is in the way");
    robot.carry_out("home").await;
    middle.release().await.expect("it is hers");
    let (mut second, _other) = drive(&bob, "/robot-2").await;
    let _right = grab(&bob, "/zone/right").await.expect("nobody is there");
    let _middle = grab(&bob, "/zone/middle").await.expect("nobody is there");
    let end = second.carry_out("move 240 0 100 0 0").await;
    assert!(end.is_finished(), "{end:?}");
    let why = refused(robot.carry_out("move 240 0 300 0 0").await);
    assert!(why.contains("/zone/middle, which bob owns, not alice"), "{why}");
    left.release().await.expect("it is hers");
}

#[tokio::test]
async fn while_an_arm_is_away_nobody_is_granted_a_zone() {
    let file = project().join("config/two-arms.toml");
    let (_broker, address) = Running::broker(Path::new(&file));
    let hub = format!("bin://{address}");
    let alice = arrive(&hub, "alice").await;
    let denied = grab(&alice, "/zone/left").await.expect_err("there are no arms");
    assert_eq!(denied.code(), Some(&Code::TIMED_OUT), "{denied}");
    let arm = |user: &'static str, channel: &'static str, mount: &'static str| {
        Running::start(
            "mom-arm",
            &[
                "--hub",
                &hub,
                "--user",
                user,
                "--channel",
                channel,
                "--zones",
                "/zone",
                "--mount",
                mount,
            ],
            &[("MOM_PASSWORD", user)],
        )
    };
    let _first = arm("arm", "/robot/arm", "0,0,0");
    joined(&alice, "/zone/middle", "arm").await;
    let denied = grab(&alice, "/zone/middle").await.expect_err("one is missing");
    let (away, asks) = (Some(&Code::TIMED_OUT), "does not know yet where");
    assert!(
        denied.code() == away || denied.to_string().contains(asks),
        "{denied}"
    );
    let _second = arm("arm-2", "/robot-2/arm", "500,0,180");
    joined(&alice, "/zone/middle", "arm-2").await;
    let deadline = Instant::now() + PATIENCE;
    loop {
        match grab(&alice, "/zone/middle").await {
            Ok(_) => break,
            // It may still ask where the zones are.
            Err(error) => {
                let asks = error.to_string().contains("does not know yet where");
                assert!(asks || error.code() == away, "{error}");
                assert!(Instant::now() < deadline, "{error}");
            }
        }
    }
}

/// Waits until a peer is in a context.
async fn joined(client: &Client, token: &str, peer: &str) {
    let token = client.token(token).await.expect("they may look");
    let mut events = token.events();
    let members = client
        .members(token.path().as_str())
        .await
        .expect("they may look");
    if members.iter().any(|member| member.peer == peer) {
        return;
    }
    let arrived = async {
        while !matches!(events.next().await.expect("the hub is there"), Event::Joined(member) if member.peer == peer)
        {
        }
    };
    timeout(PATIENCE, arrived).await.expect("it comes");
}
