//! The mount as a part of the camera's peer: it hears the camera's channel beside what draws, so that neither a slow link nor
//! an image that is being drawn holds a halt up.

use mom_client::{Channel, Client};
use mom_device::DevicePeer;
use tokio::sync::{oneshot, watch};
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::mount::Mount;
use super::slew::Slew;

/// A mount at work, until it is dropped.
pub(crate) struct RunningMount {
    slews: watch::Receiver<Slew>,
    stop: oneshot::Sender<()>,
    work: JoinSet<()>,
}

impl RunningMount {
    /// Begins to obey the commands of this channel. `begin` is when its time and that of the images began.
    pub(crate) fn start(client: &Client, channel: &Channel, mount: Mount, begin: Instant) -> RunningMount {
        let device = DevicePeer::start(client, channel, mount, begin);
        let (sender, slews) = watch::channel(device.machine().slew());
        let (stop, stopping) = oneshot::channel();
        let mut work = JoinSet::new();
        work.spawn(drive(device, sender, stopping));
        RunningMount { slews, stop, work }
    }

    /// What it does now.
    pub(crate) fn slew(&self) -> Slew {
        *self.slews.borrow()
    }

    /// Waits until it does something else.
    pub(crate) async fn changed(&mut self) {
        if self.slews.changed().await.is_err() {
            // It has ended, as what it hears has; that is told there.
            std::future::pending::<()>().await;
        }
    }

    /// Halts it, and lets it say so.
    pub(crate) async fn end(mut self) {
        let _ = self.stop.send(());
        while self.work.join_next().await.is_some() {}
    }
}

async fn drive(
    mut mount: DevicePeer<Mount>,
    slews: watch::Sender<Slew>,
    mut stopping: oneshot::Receiver<()>,
) {
    loop {
        // Before it is said: who asks for an image because of that is shown it.
        let slew = mount.machine().slew();
        slews.send_if_modified(|known| std::mem::replace(known, slew) != slew);
        tokio::select! {
            _ = &mut stopping => break,
            more = mount.step() => if !more { return },
        }
    }
    mount.end("its program ends").await;
}
