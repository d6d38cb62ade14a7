//! A connection that goes on with the peer of another one.

use std::sync::{Arc, Weak};
use std::time::Duration;

use mom_hub::Input;
use mom_login::{ResumeAnswer, ResumeChallenge};
use mom_net::{BadCount, COMPRESSION_MEMORY, Reader, Rewound};
use mom_proto::{Code, Family, Map, Parcel, Path, ReadCount, WireError};
use tokio::time::{Instant, timeout};

use super::links::PeerLink;
use super::parked::Parked;
use super::{Asked, Connection};
use crate::traffic::outbox::Paths;
use crate::traffic::switchboard::{Touched, flush};

/// How long the connection before may take to give up its peer.
const PATIENCE: Duration = Duration::from_secs(5);

impl Connection {
    /// Asks who wants to go on with a link for a proof.
    pub(super) fn ask_for_proof(&mut self, parcel: &Parcel, touched: &mut Touched) -> Result<(), WireError> {
        if self.logged_in {
            let text = "resume before any login on a connection of its own";
            return Err(WireError::new(Code::BAD_CONTENT, text));
        }
        let challenge = self.services.logins.resume(parcel)?;
        self.challenge(challenge.content(), parcel.id, touched);
        self.asked = Some(Box::new(Asked::Link(
            challenge,
            self.services.links.next_number(),
        )));
        Ok(())
    }

    /// Goes on with the peer of a link, if this is the proof of its secret.
    pub(super) async fn resume(
        &mut self,
        reader: &mut Reader,
        (challenge, number): (&ResumeChallenge, u64),
        parcel: &Parcel,
    ) -> Result<(), WireError> {
        let answer = ResumeAnswer::read(parcel)?;
        let now = self.services.board.clock.now();
        let link = self.services.links.find(challenge);
        let proven = link
            .as_ref()
            .filter(|link| link.is_proven(challenge, &answer, now));
        let Some(link) = proven else {
            self.audit_resume(link.as_deref());
            return Err(not_resumed(
                "there is no such link, or this is not proof of its secret",
            ));
        };
        // An answer that was under way for long: its peer goes on elsewhere by now.
        let claim = link.claim(number, answer.read.parcels);
        let claim = claim.ok_or_else(|| old_answer(link.outbox.acknowledged_count()))?;
        let parked = match timeout(PATIENCE, claim).await {
            Ok(Ok(parked)) => parked,
            // Another one has come after this one.
            Ok(Err(_)) => return Err(taken_over()),
            Err(_) => return Err(not_resumed("the previous connection does not release it")),
        };
        let outbox = Arc::clone(parked.outbox());
        let Some(writer) = self.outbox.writer() else {
            parked.wait();
            return Err(not_resumed("this connection is lost, too"));
        };
        let board: Arc<dyn Paths> = Arc::clone(&self.services.board) as Arc<dyn Paths>;
        let paths: Weak<dyn Paths> = Arc::downgrade(&board);
        let dropped = match outbox.resend(answer.read, &writer, paths) {
            Ok(Rewound::Dropped(dropped)) => dropped,
            Ok(Rewound::Lost(lost)) => {
                let error = not_resumed(
                    "more unacknowledged data was in flight than limits.outbox allows the hub to keep",
                );
                let count = i64::try_from(lost).unwrap_or(i64::MAX);
                parked.end(Some(error.clone()));
                return Err(error.detail("lost", count));
            }
            Err(bad) if bad.read < bad.acknowledged => {
                parked.wait();
                return Err(old_answer(bad.acknowledged));
            }
            Err(bad) => {
                let error = bad_count(bad);
                parked.end(Some(error.clone()));
                return Err(error);
            }
        };
        self.welcome_back(&parked, dropped, parcel.id).await;
        self.become_peer(reader, parked);
        Ok(())
    }

    /// Says how it goes on, before anything that was under way.
    async fn welcome_back(&mut self, parked: &Parked, dropped: u64, reference: Option<u64>) {
        let board = &self.services.board;
        let int = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
        let content = Map::new().with("resumed", true);
        let content = parked
            .served
            .read
            .put(content)
            .with("dropped", int(dropped))
            .with("peer", &*parked.outbox().name())
            .with("limits", parked.services.limits.to_map())
            .with("time", board.clock.wall());
        let mut reply = Parcel::new(Family::Reply, "ok")
            .context(Path::root())
            .content(content);
        reply.reference = reference;
        let mut touched = Touched::new();
        board.tell(self.peer(), reply, &mut touched);
        flush(&mut touched);
        // A link that does not take it is lost, and its reader hears so.
        let _ = timeout(PATIENCE, self.outbox.drained()).await;
    }

    /// From here on this is the connection of that peer.
    fn become_peer(&mut self, reader: &mut Reader, parked: Parked) {
        let board = Arc::clone(&self.services.board);
        let (peer, outbox) = (parked.peer(), Arc::clone(parked.outbox()));
        let Parked {
            services,
            mut served,
            proven_until,
            requests,
            pings,
            measure,
            charge,
            place,
        } = parked;
        let writer = self.outbox.take_writer();
        board.remove_outbox(&self.outbox);
        if let (Some(seat), Some(place)) = (&mut self.arrival.seat, place) {
            seat.take_over(place);
        }
        (served.told, served.told_at, served.resending) = (served.read.parcels, 0, true);
        self.services.limits = services.limits;
        (self.outbox, self.logged_in) = (outbox, true);
        (self.proven_until, self.requests, self.charge) = (proven_until, requests, charge);
        (self.pings, self.measure, self.link) = (pings, measure, Some(served));
        self.heard_at = Instant::now();
        self.arrival.unfinished = None;
        self.beat_at = self.heard_at + Duration::from_millis(self.services.limits.heartbeat);
        reader.set_limits(&self.services.limits);
        if self.outbox.packs() {
            reader.take_packed();
        }
        if let Some((way, account)) = self.outbox.stream().zip(self.outbox.account()) {
            reader.take_compressed(way);
            let charge = account.charge(COMPRESSION_MEMORY);
            self.arrival.compression = Some(Box::new((way, charge)));
        }
        reader.trust();
        let link = self.arrival.link();
        board.tap.audit.moved(peer, link.from);
        self.outbox.note_move(link.from, link.private);
        self.outbox.note_heard(reader.received());
        let mut touched = Touched::new();
        board.decide(Input::Resumed { peer }, &mut touched);
        match writer {
            Some(writer) => self.outbox.attach(writer),
            // The reader hears of it.
            None => self.outbox.end.notify_one(),
        }
        flush(&mut touched);
        let user = board.tap.audit.user(peer);
        if self.services.is_first("resumed", link.from, user.as_deref()) {
            tracing::info!(peer = peer.0, name = %self.outbox.name(), from = ?link.from, "resumed");
        }
    }

    /// Notes a request for a link without its secret.
    fn audit_resume(&self, link: Option<&PeerLink>) {
        let tap = &self.services.board.tap;
        let name = link.map(|link| link.outbox.name());
        let user = link.and_then(|link| tap.audit.user(link.peer()));
        tap.resume_refused(self.peer(), name, user);
    }

    /// Takes in how much of what was said to the peer it has read.
    pub(super) fn acknowledged(&self, parcel: &Parcel) -> Result<(), WireError> {
        if self.link.is_none() {
            return Ok(());
        }
        let value = parcel.value();
        let read = value.as_map().and_then(ReadCount::of).ok_or_else(|| {
            let text = "time ack needs content {read}: how many parcels were read";
            WireError::new(Code::BAD_COUNT, text).slot("content/read")
        })?;
        self.outbox.acknowledge(read).map_err(bad_count)
    }

    /// Tells the peer how much of what it has said was read, if it does not know.
    pub(super) fn tell_read(&mut self, brought: u64, touched: &mut Touched) {
        let Some(served) = self.link.as_mut().filter(|served| served.untold() > 0) else {
            return;
        };
        (served.told, served.told_at) = (served.read.parcels, brought);
        let ack = Parcel::new(Family::Time, "ack")
            .context(Path::root())
            .content(served.read.put(Map::new()));
        self.services.board.tell(self.peer(), ack, touched);
    }
}

pub(super) fn taken_over() -> WireError {
    WireError::new(Code::TAKEN_OVER, "the link goes on over another connection")
}

fn not_resumed(text: &str) -> WireError {
    let text = format!("{text}; log in and join again");
    WireError::new(Code::NOT_RESUMED, text).detail("resumed", false)
}

fn old_answer(acknowledged: u64) -> WireError {
    let error = not_resumed("the link has been resumed, or more was read, since this answer was given");
    error.detail("acknowledged", i64::try_from(acknowledged).unwrap_or(i64::MAX))
}

fn bad_count(bad: BadCount) -> WireError {
    let BadCount {
        read,
        sent,
        acknowledged,
        differs,
    } = bad;
    if differs {
        let text = format!(
            "checksum: the {read} parcels read differ from the first {read} parcels sent; log in again"
        );
        return WireError::new(Code::BAD_COUNT, text).slot("content/checksum");
    }
    let text = format!("{read} parcels cannot have been read: {sent} were sent, {acknowledged} acknowledged");
    WireError::new(Code::BAD_COUNT, text).slot("content/read")
}
