//! The lab's thin robot: CUBO, and the computer that thinks for it, between them datagrams over loopback (S25).

use std::net::Ipv4Addr;
use std::sync::Arc;

use mom_broker::Broker;
use mom_client::ClientError;
use mom_cubo::{Cubo, CuboHandle};
use mom_rsp::{middle, robot};
use mom_rsp_model::Model;
use mom_simulacrum::{RobotLine, Simulacrum, SimulacrumOptions};
use mom_wheels::{Chassis, Pose};
use tokio::net::UdpSocket;
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::{Devices, log_in, ready, stopped};
use crate::failure::Failure;

/// Its session: it is a robot of the fleet as any other.
pub(super) const PATH: &str = "/fleet/1";

/// Starts the robot on a free port with a key of its own, and mirrors it.
pub(super) async fn start(
    broker: &Arc<Broker>,
    stopping: &watch::Receiver<bool>,
) -> Result<Devices, Failure> {
    let plain = |error: &dyn std::fmt::Display| Failure::plain(error.to_string());
    let mut key = [0; 32];
    getrandom::fill(&mut key).map_err(|error| plain(&error))?;
    let body = Cubo::new(Pose::new(2500.0, 2500.0, 0.0)).map_err(|error| plain(&error))?;
    let settings = robot::Settings {
        key: Some(key),
        ..robot::Settings::default()
    };
    let cubo = CuboHandle::new(body, settings).map_err(|error| plain(&error))?;
    let theirs = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await?;
    let ours = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await?;
    ours.connect(theirs.local_addr()?).await?;

    let model = Model::read(mom_cubo::MODEL).map_err(|error| plain(&error))?;
    let settings = middle::Settings {
        key: Some(key),
        period: model.period(),
        ..middle::Settings::default()
    };
    let mirror = Simulacrum::new("cubo", model, settings).map_err(|error| plain(&error))?;
    let mut devices: Devices = JoinSet::new();
    let failed = |error: std::io::Error| ClientError::Connection(error.to_string());
    let serving = mom_cubo::serve(theirs, cubo, stopped(stopping));
    devices.spawn(async move { ("cubo".to_owned(), serving.await.map_err(failed)) });
    let serving = mom_simulacrum::serve(mirror.clone(), ours, stopped(stopping));
    devices.spawn(async move { ("middle".to_owned(), serving.await.map_err(failed)) });

    let gateway = log_in(broker, "gateway", "gateway".to_owned()).await?;
    let line = RobotLine {
        robot: mirror,
        path: PATH.to_owned(),
        chassis: Chassis::CUBO,
    };
    let options = SimulacrumOptions {
        manager: Some("robot-token".to_owned()),
    };
    let running = mom_simulacrum::run(gateway.clone(), vec![line], options, stopped(stopping));
    devices.spawn(async move { ("gateway".to_owned(), running.await) });
    ready(&gateway, &format!("{PATH}/robot")).await?;
    Ok(devices)
}
