//! One connection with its reader and its writer, in one task.

use std::future::poll_fn;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use mom_hub::PeerId;
use mom_net::{Reader, Transceiver};
use tokio::time::{Instant, timeout};

use super::doors::Seat;
use super::measure::{Measure, Pings};
use super::{Arrival, Connection, Remote, Services, Settled, requests};
use crate::traffic::outbox::Outbox;

/// A stop lets what waits go out for at most so long.
pub(crate) const DRAIN: Duration = Duration::from_secs(10);

/// A larger document is read by a thread that gives way to those that serve connections.
const LARGE: usize = 16 * 1024;

/// How long an ending connection may take to hear why.
const FAREWELL: Duration = Duration::from_secs(1);

/// A connection that is served. Its futures borrow it: what a future is given by value it keeps twice.
pub(crate) struct Serving {
    connection: Connection,
    reader: Reader,
}

impl Serving {
    /// Begins to serve a connection.
    pub(crate) fn begin(
        services: Services,
        transceiver: Transceiver,
        remote: Remote,
        seat: Option<Seat>,
        login_by: Instant,
    ) -> Serving {
        let Transceiver {
            mut reader,
            writer,
            privacy,
        } = transceiver;
        reader.defer_above(LARGE);
        let peer = services.board.next_peer();
        let outbox = Arc::new(Outbox::new(
            peer,
            services.board.clock.clone(),
            writer,
            services.limits.before_login,
        ));
        services.board.tap.audit.arrived(peer, remote.from);
        services.board.add_outbox(&outbox);
        if let Some(Err(error)) = seat.as_ref().map(|seat| seat.begin(&outbox)) {
            services.board.close(&outbox, Some(error));
        }
        let beat = Duration::from_millis(services.limits.heartbeat);
        let connection = Connection {
            services,
            outbox,
            arrival: Box::new(Arrival {
                remote,
                privacy,
                seat,
                login_by,
                behind: None,
                unfinished: None,
                opening: 0,
                compression: None,
            }),
            logged_in: false,
            failures: 0,
            heard_at: Instant::now(),
            beat_at: Instant::now() + beat,
            pings: Pings::default(),
            measure: Measure::default(),
            asked: None,
            link: None,
            proven_until: None,
            requests: requests::Requests::default(),
            charge: None,
            ended: false,
        };
        Serving { connection, reader }
    }

    /// Whom it serves.
    pub(crate) fn peer(&self) -> PeerId {
        self.connection.peer()
    }

    /// Serves it until it ends.
    pub(crate) async fn run(&mut self) {
        // Once more for each peer that it becomes the connection of.
        loop {
            let outbox = Arc::clone(&self.connection.outbox);
            // In the same task: for a connection that waits, a task of its own would be a tenth of its memory.
            let mut writer = Writing {
                future: pin!(outbox.run()),
                over: false,
            };
            let end = {
                let mut read = pin!(self.connection.read(&mut self.reader));
                poll_fn(|task| {
                    outbox.begin_slice();
                    let _ = writer.poll(task);
                    read.as_mut().poll(task).map(Box::new)
                })
                .await
            };
            Box::pin(self.connection.services.turn()).await;
            match self.connection.settle(*end) {
                Settled::Became => {}
                Settled::Lost => return,
                Settled::Parts => return Box::pin(self.part(&mut writer)).await,
            }
        }
    }

    /// Gives the last words their time.
    async fn part(&mut self, writer: &mut Writing<'_, impl Future<Output = ()>>) {
        let board = &self.connection.services.board;
        // The error gets a second to go out, and when the broker stops all that waits gets its time; a link that does
        // not take it is cut.
        let patience = match board.is_stopping() {
            true => DRAIN,
            false => FAREWELL,
        };
        let evicted = self
            .connection
            .arrival
            .seat
            .as_ref()
            .is_some_and(Seat::was_evicted);
        let written = poll_fn(|task| match writer.poll(task) {
            // A peer that had to make room gets no time: its descriptor is needed.
            Poll::Pending if evicted => Poll::Ready(()),
            polled => polled,
        });
        if evicted {
            written.await;
        } else if timeout(patience, written).await.is_err() {
            let peer = self.connection.peer().0;
            tracing::debug!(peer, "its queued parcels were not read in time");
        } else if timeout(FAREWELL, self.reader.drain()).await.is_err() {
            // What the peer still said was read and thrown away so long: closing with unread bytes would have reset
            // the link, and the error with it.
            tracing::debug!(
                peer = self.connection.peer().0,
                "not closed by the remote end in time"
            );
        }
        board.remove_outbox(&self.connection.outbox);
    }
}

/// The writer of a connection, which may end before the reader does.
struct Writing<'a, F> {
    future: Pin<&'a mut F>,
    over: bool,
}

impl<F: Future<Output = ()>> Writing<'_, F> {
    fn poll(&mut self, task: &mut std::task::Context<'_>) -> Poll<()> {
        if !self.over {
            self.over = self.future.as_mut().poll(task).is_ready();
        }
        match self.over {
            true => Poll::Ready(()),
            false => Poll::Pending,
        }
    }
}
