//! The lab's fleet: robots, their base station, and the gateway that makes them devices of the hub (W1).

use std::fmt::Write as _;
use std::net::Ipv4Addr;
use std::sync::Arc;

use mom_base_station::fleet::Fleet;
use mom_base_station::station::Station;
use mom_broker::Broker;
use mom_brs::file::EXTENDED;
use mom_client::ClientError;
use mom_gateway::GatewayOptions;
use mom_linuxbot::{Robot, Rules};
use mom_wheels::{Chassis, Simulated};
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::JoinSet;

use super::eyes::Eyes;
use super::{Devices, log_in, ready, stopped};
use crate::failure::Failure;

/// Starts robots on free ports, a base station that drives them, and the gateway.
pub(super) async fn start(
    broker: &Arc<Broker>,
    robots: u16,
    together: bool,
    eyes: &mut Eyes,
    stopping: &watch::Receiver<bool>,
) -> Result<Devices, Failure> {
    let mut devices = JoinSet::new();
    let mut addresses = String::new();
    for (driver, unit) in Simulated::fleet(robots).into_iter().zip(1..) {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await?;
        // Writing to a string does not fail.
        let _ = write!(
            addresses,
            "[[robot]]\nunit = {unit}\naddress = \"{}\"\n",
            listener.local_addr()?
        );
        let observed = eyes.page(unit, driver.floor(), &mut devices, stopping);
        let robot = Robot::new(Box::new(driver), Chassis::LINUXBOT, Rules::default());
        let serving = mom_linuxbot::serve_observed(
            listener,
            robot,
            mom_linuxbot::Options::default(),
            observed,
            stopped(stopping),
        );
        devices.spawn(async move {
            let served = serving.await;
            let ended = served.map_err(|error| ClientError::Connection(error.to_string()));
            (format!("robot {unit}"), ended)
        });
    }
    let fleet = Fleet::parse(&addresses).map_err(|error| Failure::plain(error.to_string()))?;
    let station = Station::new(&fleet, &EXTENDED, mom_gateway::settings());
    let lines = mom_gateway::lines(&station);
    station.connect_all();
    let mut gateway = Vec::new();
    for _ in 0..mom_gateway::connections(robots.into()) {
        gateway.push(log_in(broker, "gateway", "gateway".to_owned()).await?);
    }
    let options = GatewayOptions {
        together: together.then(|| "/fleet/token".to_owned()),
        manager: Some("robot-token".to_owned()),
        ..GatewayOptions::default()
    };
    let last = options.channel(robots.into());
    let running = mom_gateway::run(gateway.clone(), lines, options, None, stopped(stopping));
    devices.spawn(async move {
        let ended = running.await;
        station.halt().await;
        station.close().await;
        ("gateway".to_owned(), ended)
    });
    if let Some(client) = gateway.first() {
        ready(client, &last).await?;
    }
    eyes.start(broker, together, &mut devices, stopping).await?;
    Ok(devices)
}
