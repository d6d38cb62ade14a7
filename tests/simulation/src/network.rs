//! The network between a peer's machine and the hub's.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use mom_broker::Broker;
use mom_net::{LineShape, Transceiver, line, pair};
use mom_proto::Limits;
use mom_proto::codec::Form;
use tokio::runtime::Handle;
use tokio::sync::watch;

/// Where the hub is, while it is.
pub type Door = Arc<Mutex<Option<(Arc<Broker>, Handle)>>>;

/// One peer's way to the hub.
#[derive(Debug)]
pub struct Way {
    door: Door,
    /// Where its bytes travel.
    net: Handle,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    shape: LineShape,
    is_reachable: bool,
    lines: Vec<watch::Sender<LineShape>>,
}

impl Way {
    /// A way with this delay.
    #[must_use]
    pub fn new(door: &Door, net: &Handle, delay: Duration) -> Arc<Way> {
        Arc::new(Way {
            door: Arc::clone(door),
            net: net.clone(),
            state: Mutex::new(State {
                shape: LineShape::with_delay(delay),
                is_reachable: true,
                lines: Vec::new(),
            }),
        })
    }

    /// A connection, or an end whose other one is gone.
    #[must_use]
    pub fn connect(&self) -> Transceiver {
        let mut state = self.lock();
        let door = self.door.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let Some((broker, hub)) = door.filter(|_| state.is_reachable) else {
            return pair().0;
        };
        state.lines.retain(|line| line.receiver_count() > 0);
        let (sender, shape) = watch::channel(state.shape);
        let ends = {
            let _entered = self.net.enter();
            line(Form::Binary, &Limits::default(), shape)
        };
        let Ok((near, far)) = ends else {
            return pair().0;
        };
        state.lines.push(sender);
        let _entered = hub.enter();
        broker.serve(far);
        near
    }

    /// Changes how it carries, also what is connected.
    pub fn shape(&self, change: impl Fn(&mut LineShape)) {
        let mut state = self.lock();
        change(&mut state.shape);
        let shape = state.shape;
        for line in &state.lines {
            line.send_if_modified(|old| {
                let new = LineShape {
                    is_cut: old.is_cut,
                    ..shape
                };
                std::mem::replace(old, new) != new
            });
        }
    }

    /// Cuts what is connected.
    pub fn cut(&self) {
        for line in self.lock().lines.drain(..) {
            line.send_modify(|shape| shape.is_cut = true);
        }
    }

    /// Whether a new connection can be had.
    pub fn set_reachable(&self, is_reachable: bool) {
        self.lock().is_reachable = is_reachable;
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
