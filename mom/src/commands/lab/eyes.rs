//! What the lab's robots show: their own pages (W21), and their cameras on the hub (W22).

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::vec::IntoIter;

use mom_broker::Broker;
use mom_camera::{CameraOptions, Rendition, Source, View};
use mom_client::{Client, Code, Map};
use mom_linuxbot::{Access, Observed, Page, serve_page};
use mom_wheels::Floor;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::time::{Instant, sleep};

use super::{Devices, LOOK, READY, log_in, ready, stopped};
use crate::failure::{Doing as _, Failure};

/// So many robots have a page and a camera: more would keep the machine busy with pictures.
const MOST: u16 = 10;
/// Images per second.
const RATE: f64 = 1.0;

/// The pages of the first robots, and the cameras that look at them.
#[derive(Debug, Default)]
pub(super) struct Eyes {
    addresses: Vec<SocketAddr>,
    listeners: IntoIter<TcpListener>,
}

impl Eyes {
    /// Free ports of this machine for the first of so many robots.
    pub(super) async fn open(robots: u16) -> Result<Self, Failure> {
        let (mut addresses, mut listeners) = (Vec::new(), Vec::new());
        for _ in 0..robots.min(MOST) {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await?;
            addresses.push(listener.local_addr()?);
            listeners.push(listener);
        }
        Ok(Self {
            addresses,
            listeners: listeners.into_iter(),
        })
    }

    /// Where the pages are: that of robot 1 first.
    pub(super) fn addresses(&self) -> &[SocketAddr] {
        &self.addresses
    }

    /// Serves the page of the next robot, if it has one; for its control.
    pub(super) fn page(
        &mut self,
        unit: u32,
        floor: Floor,
        devices: &mut Devices,
        stopping: &watch::Receiver<bool>,
    ) -> Option<Observed> {
        let listener = self.listeners.next()?;
        let (page, observed) = Page::of(unit, Access::default(), floor);
        let stopped = stopped(stopping);
        devices.spawn(async move {
            tokio::select! {
                () = serve_page(listener, page) => {}
                () = stopped => {}
            }
            (format!("page of robot {unit}"), Ok(()))
        });
        Some(observed)
    }

    /// Has a camera in `/fleet/N/camera` show what each of these robots sees, once the gateway has made their places.
    pub(super) async fn start(
        &self,
        broker: &Arc<Broker>,
        together: bool,
        devices: &mut Devices,
        stopping: &watch::Receiver<bool>,
    ) -> Result<(), Failure> {
        for (address, unit) in self.addresses.iter().zip(1_u32..) {
            let camera = log_in(broker, "camera", format!("camera-{unit}")).await?;
            let options = options(unit, *address, together)?;
            let place = options.channel.clone();
            make(&camera, &place).await?;
            let running = mom_camera::peer::run(camera.clone(), options, stopped(stopping));
            devices.spawn(async move { (format!("camera of robot {unit}"), running.await) });
            ready(&camera, &place).await?;
        }
        Ok(())
    }
}

fn options(unit: u32, page: SocketAddr, together: bool) -> Result<CameraOptions, Failure> {
    let url = format!("http://{page}/camera.jpg");
    let channel = format!("/fleet/{unit}/camera");
    Ok(CameraOptions {
        // Nobody tells where an arm is there, so that no arm is drawn over the images.
        robot: channel.clone(),
        channel,
        token: match together {
            true => "/fleet/token".to_owned(),
            false => format!("/fleet/{unit}/token"),
        },
        source: Some(Source {
            url: url
                .parse()
                .map_err(|error: mom_camera::BadUrl| Failure::plain(error.to_string()))?,
            rendition: Rendition::default(),
        }),
        rate: RATE,
        ..CameraOptions::new(View::X)
    })
}

/// Makes a camera's channel, as soon as its robot's session is there.
async fn make(camera: &Client, place: &str) -> Result<(), Failure> {
    let begin = Instant::now();
    loop {
        let made = camera.create(place, Map::new().with("kind", "channel")).await;
        match made {
            Err(error) if error.code() == Some(&Code::EXISTS) => return Ok(()),
            Err(error) if error.code() == Some(&Code::UNKNOWN_PATH) && begin.elapsed() < READY => {
                sleep(LOOK).await;
            }
            made => return made.map(drop).doing(format!("make {place}")),
        }
    }
}
