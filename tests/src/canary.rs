//! A pair of peers, an operator and a robot, that must not notice what is done to the hub beside them.

use std::net::SocketAddr;

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value};
use tokio::sync::{oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;

use crate::raw::{PATIENCE, Raw, at, message};

const TOKEN: &str = "/robot/token";
const ARM: &str = "/robot/arm";
/// A robot that only listens has to say that it is there.
const PINGS: u64 = 16;

/// An operator that owns the robot's token and commands without a pause, and the robot that hears it.
///
/// Every command is acknowledged by a receipt that nothing dropped, arrives at the robot in order and exactly
/// once, and carries the one fence of the grant. The operator speaks XML and the robot binary.
#[derive(Debug)]
pub struct Canary {
    exchanges: watch::Receiver<u64>,
    stop: oneshot::Sender<()>,
    task: JoinHandle<()>,
}

impl Canary {
    /// Connects both, takes the token, and lets them begin.
    ///
    /// # Panics
    /// If the broker refuses: the canary dies.
    pub async fn start(address: SocketAddr) -> Canary {
        let mut robot = Raw::login(address, Form::Binary, "arm").await;
        robot.join(&["/robot"]).await;
        let join = Parcel::new(Family::Context, "join").context(at(ARM));
        // A device, where it may be one: that is not closed for what others say to it.
        let joined = robot.ask(join.content(Map::new().with("device", true))).await;
        if joined.is_err() {
            robot.join(&[ARM]).await;
        }
        let mut operator = Raw::login(address, Form::Xml, "alice").await;
        operator.join(&["/robot", ARM]).await;
        let granted = operator.ask_about(Family::Token, "grab", TOKEN).await;
        let fence = fence_of(&granted.expect("a free token"));
        let (count, exchanges) = watch::channel(0);
        let (stop, mut stopped) = oneshot::channel();
        let task = tokio::spawn(async move {
            for number in 1.. {
                exchange(&mut operator, &mut robot, number, fence).await;
                count.send_replace(number);
                if stopped.try_recv().is_ok() {
                    return;
                }
            }
        });
        Canary {
            exchanges,
            stop,
            task,
        }
    }

    /// Waits until some more commands went through, all of them begun after this call.
    ///
    /// # Panics
    /// If the canary is dead.
    pub async fn check(&mut self) {
        // The next one may have begun before, those after it did not.
        let goal = *self.exchanges.borrow() + 4;
        let sung = timeout(PATIENCE, self.exchanges.wait_for(|count| *count >= goal)).await;
        let alive = sung.is_ok_and(|sung| sung.is_ok());
        assert!(
            alive,
            "the canary died after {} commands",
            *self.exchanges.borrow()
        );
    }

    /// Ends it and gives the number of commands that went through, all of those that were sent.
    ///
    /// # Panics
    /// If it has lost one.
    pub async fn stop(mut self) -> u64 {
        self.check().await;
        let _ = self.stop.send(());
        self.task.await.expect("the canary lives");
        *self.exchanges.borrow()
    }
}

async fn exchange(operator: &mut Raw, robot: &mut Raw, number: u64, fence: u64) {
    let text = format!("move {number}");
    let mut command = message("command", ARM, text.as_str());
    command.receipt = Some(true);
    command.address = Some(vec!["arm".into()]);
    let receipt = operator
        .ask(command)
        .await
        .expect("the owner may command")
        .value();
    let nobody = Value::List(Vec::new());
    assert_eq!(receipt.get("delivered"), Some(&Value::Int(1)), "{receipt:?}");
    assert_eq!(receipt.get("dropped"), Some(&nobody), "{receipt:?}");
    if number.is_multiple_of(PINGS) {
        robot.send_parcel(&Parcel::new(Family::Time, "ping")).await;
    }
    let heard = loop {
        let parcel = robot.next().await.expect("the robot is connected");
        // Who comes and goes is not a message; a halt would be one.
        match parcel.family {
            Family::Event | Family::Time => answer(robot, &parcel).await,
            // What a peer says that owns nothing.
            Family::Message if parcel.name() == "note" => {}
            _ => break parcel,
        }
    };
    assert!(heard.is(Family::Message, "command"), "{heard:?}");
    assert_eq!(
        heard.value(),
        Value::from(text),
        "in order, none twice, none lost"
    );
    assert_eq!(heard.fence, Some(fence), "the fence of the one grant");
}

async fn answer(robot: &mut Raw, parcel: &Parcel) {
    if parcel.is(Family::Time, "ping") {
        let mut pong = Parcel::new(Family::Time, "pong");
        pong.reference = parcel.id;
        robot.send_parcel(&pong).await;
    }
}

/// The fence in a grant.
///
/// # Panics
/// If there is none.
pub fn fence_of(grant: &Value) -> u64 {
    let fence = grant.get("fence").and_then(Value::as_int);
    fence
        .and_then(|fence| u64::try_from(fence).ok())
        .expect("a grant has a fence")
}
