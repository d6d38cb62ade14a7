//! The Robot API (S7, S8) of a mirror whose robot is a simulated CUBO, over a socket.

use std::future::pending;
use std::net::Ipv4Addr;
use std::sync::mpsc;
use std::time::Duration;

use mom_cubo::{Cubo, CuboHandle, Touch};
use mom_rsp::middle::{Notice, Settings};
use mom_rsp::robot;
use mom_rsp_model::Model;
use mom_simulacrum::{Simulacrum, serve, to_wire};
use mom_wheels::Pose;
use tokio::net::UdpSocket;
use tokio::time::timeout;

const PATIENCE: Duration = Duration::from_secs(20);

/// A robot that is served, and its mirror once there is a session.
async fn pair() -> (CuboHandle, Simulacrum) {
    let robot = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let middle = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.expect("a port");
    let address = robot.local_addr().expect("it has one");
    middle.connect(address).await.expect("a way");
    let body = Cubo::new(Pose::new(1000.0, 2000.0, 90.0)).expect("a place");
    let settings = robot::Settings {
        watchdog: 5000,
        ..robot::Settings::default()
    };
    let cubo = CuboHandle::new(body, settings).expect("settings");
    tokio::spawn(mom_cubo::serve(robot, cubo.clone(), pending()));
    let settings = Settings {
        silence: 5000,
        ..Settings::default()
    };
    let model = Model::read(mom_cubo::MODEL).expect("a model");
    let mirror = Simulacrum::new("cubo", model, settings).expect("settings");
    let mut notices = mirror.notices();
    tokio::spawn(serve(mirror.clone(), middle, pending()));
    let up = async { while *notices.recv().await.expect("it lives") != Notice::Up {} };
    timeout(PATIENCE, up).await.expect("there is a session");
    (cubo, mirror)
}

/// A consumer waits until the value it wants has come.
async fn comes(mirror: &Simulacrum, name: &str, wanted: impl Fn(&[f64]) -> bool) -> Vec<f64> {
    let (element, _) = mirror.element(name).expect("CUBO has it");
    let heard = async {
        loop {
            let known = mirror.changed(element).await.expect("it is heard");
            if wanted(&known.values) {
                return known.values;
            }
        }
    };
    timeout(PATIENCE, heard)
        .await
        .unwrap_or_else(|_| panic!("{name} comes"))
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_written_is_read_back_and_consumers_wait_for_it() {
    let (_cubo, mirror) = pair().await;
    let (joints, model) = mirror.element("joints").expect("CUBO has them");
    let (pose, _) = mirror.element("pose").expect("CUBO has it");
    let value = to_wire(model, &[30.0, -20.0, 10.0]).expect("in range");
    mirror.write(joints, &value).expect("there is a session");
    assert_eq!(mirror.wanted(joints), Some(vec![30.0, -20.0, 10.0]));
    let posture = comes(&mirror, "posture", |values| {
        values.first().is_some_and(|left| *left > 25.0)
    })
    .await;
    assert!(posture.get(1).is_some_and(|right| *right < 0.0), "{posture:?}");
    // The body can only follow what has arrived, and the posture that says so acknowledges it.
    let all = mirror.read_list(&[joints, pose]);
    let values: Vec<_> = all.into_iter().flatten().map(|known| known.values).collect();
    assert_eq!(values, [vec![30.0, -20.0, 10.0], vec![1000.0, 2000.0, 90.0]]);
    assert!(to_wire(model, &[91.0, 0.0, 0.0]).is_err(), "out of its range");
}

#[tokio::test(flavor = "multi_thread")]
async fn listeners_are_called_as_an_event_is_heard_and_once() {
    let (cubo, mirror) = pair().await;
    let (button, _) = mirror.element("service-button").expect("CUBO has it");
    let (say, heard) = mpsc::channel();
    let listener = move |notice: &Notice, _: &Simulacrum| {
        // Who does not look any more hears nothing.
        let _ = say.send(matches!(notice, Notice::Raised { .. }));
    };
    mirror.listen(button, Box::new(listener));
    cubo.touch(Touch::ServiceButton);
    cubo.touch(Touch::ServiceButton);
    let heard = tokio::task::spawn_blocking(move || {
        let twice = [heard.recv_timeout(PATIENCE), heard.recv_timeout(PATIENCE)];
        (twice, heard)
    });
    let (twice, heard) = heard.await.expect("it ran");
    assert_eq!(twice, [Ok(true), Ok(true)]);
    // A value that comes later shows that nothing was heard in between.
    let (joints, model) = mirror.element("joints").expect("CUBO has them");
    let value = to_wire(model, &[40.0, 0.0, 0.0]).expect("in range");
    mirror.write(joints, &value).expect("there is a session");
    comes(&mirror, "posture", |values| {
        values.first().is_some_and(|left| *left > 30.0)
    })
    .await;
    assert!(heard.try_recv().is_err(), "each event once");
}
