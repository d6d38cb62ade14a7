//! One connection, from its first byte to its end.

mod behind;
mod doors;
mod heartbeat;
mod links;
mod login;
mod measure;
mod parked;
mod requests;
mod resume;
mod services;
mod serving;
#[cfg(test)]
mod tests;
mod waiting;

use std::cell::Cell;
use std::net::IpAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use mom_hub::{Input, PeerClock, PeerId};
use mom_login::{Challenge, LoginLink, ResumeChallenge};
use mom_net::{NetError, Privacy, Reader};
use mom_proto::codec::{Deferred, Frame};
use mom_proto::{Code, Compression, Content, Family, Limits, Micros, Parcel, Verb, WireError, outlives_loss};
use mom_system::Expiry;
use tokio::time::{Instant, timeout_at};

use crate::traffic::capacity::WaitingMessage;
use crate::traffic::channel::{Sender, said_before_the_loss};
use crate::traffic::memory::{Charge, Gate, over_memory};
use crate::traffic::outbox::Outbox;
use crate::traffic::switchboard::{Handled, Touched, flush};

use behind::{Behind, Queued, checksum_word};
use heartbeat::Unfinished;
use links::Served;
use measure::{Measure, Pings};

pub(crate) use doors::{AdmissionLimiter, Seat, full};
pub(crate) use login::{login_timeout, too_late};
pub(crate) use services::{Seated, Services};
pub(crate) use serving::{DRAIN, Serving};

/// Frames after which a reader flushes and yields: a peer inside this process may never pause, and a task that adds
/// something that is not urgent to an outbox that another task has touched leaves the flush to that one.
const FRAMES: usize = 256;

/// The same after so long: others wait for this thread, and some of them want to stop a robot.
const SLICE: Micros = 200;

/// After so many frames the time is looked at.
const LOOK: usize = 8;

/// Unfinished parcels of fewer bytes are not charged: most are here for a moment.
const SMALL: usize = 16 * 1024;

/// One connection as its reader sees it.
struct Connection {
    services: Services,
    outbox: Arc<Outbox>,
    arrival: Box<Arrival>,
    logged_in: bool,
    /// Logins that failed.
    failures: u32,
    /// When bytes came last. The time in which nothing is read does not count: it is moved by that.
    heard_at: Instant,
    /// When to look next whether the peer is there.
    beat_at: Instant,
    pings: Pings,
    /// What its pongs say of its clock.
    measure: Measure,
    /// What it has to answer.
    asked: Option<Box<Asked>>,
    /// None if the end of the connection is the end of the peer.
    link: Option<Box<Served>>,
    /// When the proof of who it is will be over, none if it lasts.
    proven_until: Option<Box<Expiry>>,
    requests: requests::Requests,
    /// What is here of parcels that are not whole or wait for their turn, charged to the user; none before login.
    charge: Option<Charge>,
    ended: bool,
}

/// A challenge that is open.
enum Asked {
    Key(Challenge),
    /// With its number: later ones have higher numbers.
    Link(ResumeChallenge, u64),
}

/// Where a connection comes from.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Remote {
    /// None inside this process.
    pub(crate) from: Option<IpAddr>,
    /// A proxy says so, or has come for itself.
    pub(crate) relayed: bool,
    /// A proxy that the configuration names says that nobody has read along before it.
    pub(crate) secured: bool,
    /// A user who asks by HTTP, inside this process.
    pub(crate) visit: bool,
}

/// What a connection has brought.
struct Arrival {
    remote: Remote,
    /// What is known of who is between.
    privacy: Privacy,
    /// Its part in the counts of connections from outside.
    seat: Option<doors::Seat>,
    /// When it is too late to log in.
    login_by: Instant,
    /// What was read behind a message that waits.
    behind: Option<Box<Behind>>,
    /// What is here of parcels that are not whole.
    unfinished: Option<Unfinished>,
    /// The bytes of a whole one that waits for a thread which opens it.
    opening: usize,
    /// How all that follows is compressed, and the memory for it; boxed, for few are.
    compression: Option<Box<(Compression, Charge)>>,
}

impl Arrival {
    fn link(&self) -> LoginLink {
        let (private, certificate) = match self.privacy {
            Privacy::Tls { certificate } => (true, certificate),
            Privacy::Local | Privacy::Plain => (self.remote.secured, None),
        };
        LoginLink {
            from: self.remote.from,
            relayed: self.remote.relayed,
            private,
            certificate,
        }
    }
}

/// How reading ends.
enum End {
    /// The connection is over, for this reason if there is one to tell.
    Over(Option<WireError>),
    /// It is the connection of another peer from now on.
    Became,
}

/// What follows when reading has ended.
enum Settled {
    /// It has said that it ends, and gives its last words their time.
    Parts,
    /// Its peer waits for another connection.
    Lost,
    /// It goes on as the connection of another peer.
    Became,
}

impl From<Option<WireError>> for End {
    fn from(error: Option<WireError>) -> End {
        End::Over(error)
    }
}

/// What a reader takes.
enum Came {
    Whole(Frame),
    /// A whole frame that is large, and not decoded.
    Large(Deferred),
    /// Something that has passed what waited before it, with its word in the checksum of a link.
    Passed(Option<u32>),
}

/// What a reader does after a frame.
enum Next {
    /// It reads on.
    Frame,
    /// It ends the connection.
    End(Box<WireError>),
    /// It logs its peer in.
    Login(Box<Parcel>),
    /// It waits so long: too many requests were refused.
    Pause(Duration),
    /// It waits until the hub has memory for a message.
    Memory(Box<Parcel>),
    /// It waits for capacity for a message of this id.
    Capacity(Box<WaitingMessage>, Option<u64>),
}

/// However a connection ends, cut off or by a fault of its own, its peer must not stay behind as the owner of
/// anything.
impl Drop for Connection {
    fn drop(&mut self) {
        if !self.ended {
            self.end(None);
            self.services.board.remove_outbox(&self.outbox);
        }
    }
}

impl Connection {
    fn peer(&self) -> PeerId {
        self.outbox.peer
    }

    /// Reads until the connection ends, or goes on as that of another peer.
    #[expect(clippy::manual_async_fn, reason = "an async fn keeps what it is given twice")]
    fn read<'a>(&'a mut self, reader: &'a mut Reader) -> impl Future<Output = End> + 'a {
        async move {
            // What came with the first bytes, by which the form was told.
            if let Err(end) = self.handle_arrived(reader).await {
                return end;
            }
            let outbox = Arc::clone(&self.outbox);
            loop {
                if self.charge.as_ref().is_some_and(Charge::is_held)
                    && let Err(end) = Box::pin(self.wait_for_memory(reader, false, &mut Touched::new())).await
                {
                    return end;
                }
                if self.is_late() {
                    tokio::task::yield_now().await;
                }
                let arrived = tokio::select! {
                    biased;
                    () = outbox.end.notified() => match self.is_called() {
                        true => return self.closing().into(),
                        // It was called before, on another connection of the same peer.
                        false => continue,
                    },
                    () = self.proof_over() => return Some(login::proof_over()).into(),
                    arrived = timeout_at(self.look_at(), reader.arrive()) => arrived,
                };
                match arrived {
                    Ok(Ok(true)) => {
                        self.note_arrived(reader);
                        if !self.logged_in {
                            Box::pin(self.services.turn()).await;
                        }
                    }
                    Ok(Ok(false)) => return End::Over(None),
                    Ok(Err(error)) => return self.failed(error).into(),
                    Err(_) => {
                        if let Err(end) = self.look(self.look_at(), reader) {
                            return end;
                        }
                    }
                }
                if let Err(end) = self.handle_arrived(reader).await {
                    return end;
                }
            }
        }
    }

    /// Whether others should have the thread.
    fn is_late(&self) -> bool {
        let began = self.outbox.slice_began.load(Ordering::Relaxed);
        self.services.board.clock.now().saturating_sub(began) > SLICE
    }

    /// Handles all that has arrived, and flushes what it caused.
    async fn handle_arrived(&mut self, reader: &mut Reader) -> Result<(), End> {
        let mut touched = Touched::new();
        let mut handled = 0;
        // One that is not a mere sign of life was.
        let mut whole = false;
        let result = loop {
            let goes_on = !self.outbox.is_closed() && !self.is_proof_over();
            if !goes_on {
                break Ok(());
            }
            let is_run = self.run(reader, &mut touched);
            let mut counts = self.link.is_some();
            if is_run {
                whole = true;
            } else {
                let frame = match self.next(reader) {
                    Ok(None) => break Ok(()),
                    // It is handled, and was only to be counted in its turn.
                    Ok(Some(Came::Passed(word))) => {
                        self.count_read(word);
                        continue;
                    }
                    Ok(Some(Came::Whole(frame))) => frame,
                    Ok(Some(Came::Large(frame))) => {
                        match Box::pin(self.open(frame, reader, &mut touched)).await {
                            Ok(frame) => frame,
                            Err(end) => break Err(end),
                        }
                    }
                    Err(end) => break Err(end),
                };
                let says = !is_sign_of_life(&frame);
                (counts, whole) = (counts && says, whole || says);
                let word = checksum_word(&frame);
                let next = self.handle(frame, &mut touched);
                // It is answered: if the connection is lost in the pause, it must not be answered again.
                if counts && matches!(next, Next::Pause(_)) {
                    self.count_read(word);
                    counts = false;
                }
                // Apart, for it is rare and needs more memory than all the rest of a connection.
                if !matches!(next, Next::Frame)
                    && let Err(end) = Box::pin(self.go_on(next, reader, &mut touched)).await
                {
                    break Err(end);
                }
                // Not before all is done with it: what was not handled comes again after a loss.
                if counts {
                    self.count_read(word);
                }
            }
            handled += 1;
            let late = (is_run || handled % LOOK == 0) && self.is_late();
            if late || handled % FRAMES == 0 {
                flush(&mut touched);
                tokio::task::yield_now().await;
            }
        };
        let link = self.link.as_ref();
        if link.is_some_and(|served| served.is_due(reader.brought())) {
            self.tell_read(reader.brought(), &mut touched);
        }
        flush(&mut touched);
        self.count_held(reader, whole || (handled > 0 && !reader.assembles()));
        result
    }

    /// What comes next: first what has come behind a message that waited.
    fn next(&mut self, reader: &mut Reader) -> Result<Option<Came>, End> {
        if let Some(next) = self.arrival.behind.as_mut().and_then(|behind| behind.pop()) {
            return Ok(Some(match next {
                Queued::Frame(frame) => Came::Whole(frame),
                Queued::Passed(word) => Came::Passed(word),
            }));
        }
        if let Some(fault) = self.arrival.behind.take().and_then(|behind| behind.fault()) {
            return Err(self.failed(fault).into());
        }
        match reader.try_next() {
            Ok(Some(frame)) => Ok(Some(Came::Whole(frame))),
            Ok(None) => Ok(reader.take_deferred().map(Came::Large)),
            Err(error) => Err(self.failed(error).into()),
        }
    }

    /// Passes on plain messages that are alike, and counts them; false if nothing of that kind is here.
    fn run(&mut self, reader: &mut Reader, touched: &mut Touched) -> bool {
        let clock = |now| self.peer_clock(now);
        let sender = self.sender(&clock);
        let runs =
            self.gate() == Gate::Open && self.logged_in && !sender.late && self.arrival.behind.is_none();
        if !runs {
            return false;
        }
        let read = self.link.as_ref().map(|served| Cell::new(served.read));
        let sender = Sender {
            read: read.as_ref(),
            ..sender
        };
        let is_run = self.services.board.run(&sender, reader, touched);
        if let Some((served, read)) = self.link.as_mut().zip(read) {
            served.read = read.get();
        }
        is_run
    }

    /// As whom it sends.
    fn sender<'a>(&self, clock: &'a dyn Fn(Micros) -> Option<PeerClock>) -> Sender<'a> {
        Sender {
            peer: self.peer(),
            clock,
            late: self.link.as_ref().is_some_and(|served| served.resending),
            read: None,
        }
    }

    /// Counts what was read and handled, where both sides count.
    fn count_read(&mut self, word: Option<u32>) {
        if let Some(served) = &mut self.link {
            served.read.count(word);
        }
    }

    /// Why a connection ends that gives nothing more.
    fn failed(&self, error: NetError) -> Option<WireError> {
        match error {
            NetError::Wire(error) => Some(error),
            error => {
                tracing::debug!(peer = self.peer().0, %error, "link failed");
                None
            }
        }
    }

    /// Handles one frame; gives back what takes its time.
    fn handle(&mut self, frame: Frame, touched: &mut Touched) -> Next {
        let parcel = match frame {
            Frame::Malformed { reference, error } => {
                self.refuse(&error, reference, touched);
                return Next::Frame;
            }
            Frame::Parcel(parcel) => parcel,
        };
        if let Err(error) = self.check_content(&parcel) {
            self.refuse(&error, parcel.id, touched);
            return Next::Frame;
        }
        match parcel.family {
            Family::Message if self.logged_in => {
                return match self.gate() == Gate::Open || is_control(&parcel) {
                    true => self.send(parcel, touched),
                    false => Next::Memory(parcel),
                };
            }
            Family::Time => {
                if let Err(error) = self.time(&parcel, touched) {
                    return Next::End(Box::new(error));
                }
            }
            Family::Login if login::concerns(&parcel) => return Next::Login(parcel),
            _ if self.logged_in => {
                let now = self.services.board.clock.now();
                if let Err(error) = self.requests.take(&parcel, self.services.limits.requests, now) {
                    self.refuse(&error, parcel.id, touched);
                    let pause = self.requests.refused(self.services.limits.requests, now);
                    return pause.map_or(Next::Frame, Next::Pause);
                }
                let resent = self.link.as_ref().is_some_and(|served| served.resending);
                if resent && !outlives_loss(&parcel, false) {
                    self.refuse(&said_before_the_loss(), parcel.id, touched);
                    return Next::Frame;
                }
                let counts = requests::counts(&parcel);
                let request = Input::Request {
                    peer: self.peer(),
                    parcel,
                    // Only messages have an age.
                    clock: None,
                };
                let work = self.services.board.decide(request, touched);
                self.requests
                    .charge(counts, work, self.services.limits.requests, now);
            }
            _ => {
                let text = "log in first: family login, name login, content {name, password}";
                self.refuse(&WireError::new(Code::NOT_LOGGED_IN, text), parcel.id, touched);
            }
        }
        Next::Frame
    }

    /// Refuses content that is larger than what is opened of such a parcel, before anything looks into it. That of messages stays closed.
    fn check_content(&self, parcel: &Parcel) -> Result<(), WireError> {
        let Some(content) = parcel
            .content
            .as_ref()
            .filter(|_| parcel.family != Family::Message)
        else {
            return Ok(());
        };
        let limits = &self.services.limits;
        let verb = Verb::of(parcel.family, &parcel.name);
        let most = verb.map_or(limits.control, |verb| verb.opens(limits));
        if content.size() <= most {
            return Ok(());
        }
        let text = format!(
            "the content of {} {} has at most {most} bytes",
            parcel.family,
            parcel.name()
        );
        Err(WireError::new(Code::TOO_LONG, text).slot("content"))
    }

    /// Sends a message, unless the hub has no memory for more of this user.
    fn send(&self, parcel: Box<Parcel>, touched: &mut Touched) -> Next {
        let reference = parcel.id;
        if self.gate() == Gate::Refused && !is_control(&parcel) {
            self.refuse(&over_memory(), reference, touched);
            return Next::Frame;
        }
        let clock = |now| self.peer_clock(now);
        let sender = self.sender(&clock);
        match self
            .services
            .board
            .message(&sender, &self.services.limits, parcel, touched)
        {
            Ok(Handled::Done) => {}
            Ok(Handled::Waits(held)) => return Next::Capacity(held, reference),
            Err(error) => self.refuse(&error, reference, touched),
        }
        Next::Frame
    }

    /// Whether the hub has memory for more of this user.
    fn gate(&self) -> Gate {
        self.charge
            .as_ref()
            .map_or(Gate::Open, |charge| charge.account().gate())
    }

    /// Charges what is here of parcels that are not whole or wait for their turn, and is not small. `whole`: another one was.
    fn count_held(&mut self, reader: &Reader, whole: bool) {
        let held = reader.held();
        self.watch_unfinished(held, whole);
        if let Some(charge) = &mut self.charge {
            let behind = self.arrival.behind.as_ref().map_or(0, |behind| behind.bytes());
            let held = held + behind + self.arrival.opening;
            charge.set(if held > SMALL { held } else { 0 });
        }
    }

    fn refuse(&self, error: &WireError, reference: Option<u64>, touched: &mut Touched) {
        // Not its words: they quote what was said, and that may have been a password.
        tracing::debug!(peer = self.peer().0, code = %error.code, "refused");
        self.services
            .board
            .tell(self.peer(), error.to_parcel(reference), touched);
    }

    /// Does what the end of reading asks for.
    fn settle(&mut self, end: End) -> Settled {
        match end {
            End::Became => Settled::Became,
            End::Over(error) if self.is_lost(error.as_ref()) => {
                self.lose(error);
                Settled::Lost
            }
            End::Over(error) => {
                self.end(error);
                Settled::Parts
            }
        }
    }

    /// Ends the connection: the hub first, so that tokens are free before anything else.
    fn end(&mut self, error: Option<WireError>) {
        self.ended = true;
        let mut touched = Touched::new();
        self.services.logins.forget(self.peer());
        self.end_link();
        if self.logged_in {
            let name = self.services.board.peer_name(self.peer()).unwrap_or_default();
            let user = self.services.board.tap.audit.user(self.peer());
            self.services
                .board
                .decide(Input::Gone { peer: self.peer() }, &mut touched);
            if self
                .services
                .is_first("gone", self.arrival.remote.from, user.as_deref())
            {
                tracing::info!(peer = self.peer().0, %name, code = ?error.as_ref().map(|error| error.code.word()), "gone");
            }
        } else if let Some(error) = &error
            && self
                .services
                .is_first("closed", self.arrival.remote.from, Some(error.code.word()))
        {
            tracing::info!(peer = self.peer().0, from = ?self.arrival.remote.from, code = %error.code, "closed");
        }
        self.services.board.close(&self.outbox, error);
        flush(&mut touched);
    }
}

/// Whether a message is never refused for memory.
fn is_control(parcel: &Parcel) -> bool {
    let verb = Verb::of(parcel.family, &parcel.name);
    matches!(verb, Ok(Verb::Stop | Verb::Unstop))
}

/// Content that took so long to read stays closed from here on: it is measured, counted and passed on at no cost.
fn closed(frame: Frame) -> Frame {
    let Frame::Parcel(mut parcel) = frame else {
        return frame;
    };
    if let Some(Ok(bytes)) = parcel.content.as_ref().map(Content::to_msgpack) {
        parcel.content = Some(Content::Encoded(bytes));
    }
    Frame::Parcel(parcel)
}

/// Whether a frame says only that its sender is there.
fn is_sign_of_life(frame: &Frame) -> bool {
    matches!(frame, Frame::Parcel(parcel) if parcel.family == Family::Time)
}

/// The time that a peer has to log in.
pub(crate) fn login_time(limits: &Limits) -> Duration {
    Duration::from_millis(limits.login_time)
}
