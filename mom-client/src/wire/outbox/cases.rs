//! The cases of what overtakes, replaces and outlives, with a client's queue as its callers use it, and a hub that reads what leaves.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use mom_cases::{Case, Dialect, Item, Replay, replay};
use mom_net::{Allowance, Piece};
use mom_proto::binary::{BinaryDecoder, PREFACE};
use mom_proto::codec::{Form, Frame};
use mom_proto::{Code, Delivery, Family, Limits, Map, Parcel, Path, ReadCount, Time, Value};
use tokio::sync::oneshot;

use super::{Capacity, Entry};
use crate::device::installation::Installation;
use crate::peer::pending::AnswerTo;
use crate::peer::shared::{Settings, Shared};
use crate::peer::subscribers::EventQueue;
use crate::wire::clock::HubClock;
use crate::wire::link_secret::{LinkSecret, Resumption};
use crate::wire::proof::Credentials;
use crate::wire::welcome::Welcome;
use crate::{ClientError, ErrorKind, Event, Proof};

const DIALECT: Dialect = Dialect {
    queue: "rust",
    says_resent: true,
    says_unknown: true,
};

/// How large chunks are.
const CHUNK: usize = 32 * 1024;

const TOKEN: &str = "/robot/token";

#[test]
fn a_client_keeps_to_the_table() {
    replay(DIALECT, Talker::new);
}

/// Who waits for room with a command waits in vain when the connection is lost meanwhile; what may be late goes on.
#[test]
fn no_command_waits_for_room_over_a_loss() {
    for (name, expected) in [("command", Some(ErrorKind::Connection)), ("note", None)] {
        let mut talker = Talker::new(&Case::default());
        talker.fill("f");
        let parcel = Parcel::new(Family::Message, name).context(path("/chat"));
        let mut said = pin!(talker.shared.post(parcel, None));
        let mut look = Context::from_waker(Waker::noop());
        assert!(said.as_mut().poll(&mut look).is_pending(), "it is full");
        assert!(talker.shared.suspend(), "it has a link");
        assert!(said.as_mut().poll(&mut look).is_pending(), "it still is");
        let resumption = Resumption {
            read: ReadCount::new(),
            dropped: 0,
            content: Map::new(),
        };
        assert!(talker.shared.go_on(&resumption), "a count that can be");
        talker.shared.give_capacity(Capacity {
            usual: talker.capacity,
            urgent: 0,
        });
        let Poll::Ready(put) = said.as_mut().poll(&mut look) else {
            panic!("there is room")
        };
        assert_eq!(put.err().map(|error| error.kind()), expected, "{name}");
    }
}

/// A client that is told what to say, and its link.
struct Talker {
    shared: Shared,
    /// µs.
    wall: Arc<AtomicI64>,
    /// What was put in, by its id.
    said: BTreeMap<u64, Said>,
    /// What is told in each context.
    told_in: HashMap<Path, Arc<EventQueue>>,
    told: BTreeMap<String, String>,
    bytes: BytesMut,
    decoder: BinaryDecoder,
    /// What the hub has read and no step has asked for yet.
    read: VecDeque<String>,
    /// Of a queue in which nothing waits.
    capacity: usize,
}

/// What was put in.
struct Said {
    label: String,
    name: String,
    guarded: bool,
    context: Path,
    left: bool,
    answer: Option<oneshot::Receiver<Result<Parcel, ClientError>>>,
    told: bool,
}

impl Talker {
    fn new(case: &Case) -> Talker {
        let wall = Arc::new(AtomicI64::new(1_000_000));
        let link = Map::new()
            .with("id", "link")
            .with("secret", Value::Binary(vec![0; 32].into()))
            .with("grace", 1000);
        let welcome = Map::new()
            .with("peer", "alice")
            .with("user", "alice")
            .with("link", link);
        let settings = Settings {
            request_timeout: Duration::from_secs(1),
            connect_timeout: Duration::from_secs(1),
            event_buffer: 1024,
            installation: Installation::unknown(),
        };
        let credentials = Credentials {
            user: "alice".to_owned(),
            proof: Proof::Guest,
            nickname: None,
            hub: None,
            address: None,
            link: None,
            heartbeat: None,
            compress: false,
        };
        let now = Arc::clone(&wall);
        let clock = HubClock::new(Arc::new(move || Time::from_micros(now.load(Ordering::Relaxed))));
        let secret = LinkSecret::read(&welcome);
        let me = Welcome::read(welcome).expect("a welcome");
        let shared = Shared::new(
            settings,
            credentials,
            clock,
            Some(Form::Binary),
            AtomicU64::new(1_000_000),
            me,
        );
        shared.begin_link(&mut shared.lock(), secret);
        let (decoder, bytes) = decoder();
        let talker = Talker {
            capacity: shared.capacity_left(),
            shared,
            wall,
            said: BTreeMap::new(),
            told_in: HashMap::new(),
            told: BTreeMap::new(),
            bytes,
            decoder,
            read: VecDeque::new(),
        };
        talker.guard(case);
        talker
    }

    /// Has the client know what its token guards.
    fn guard(&self, case: &Case) {
        let mut names: BTreeMap<&str, Vec<Value>> = BTreeMap::new();
        for item in case.items().filter(|item| item.guarded) {
            names
                .entry(&item.context)
                .or_default()
                .push(item.name.as_str().into());
        }
        for (context, names) in names {
            let mut state = self.shared.lock();
            let (path, guard) = (
                path(context),
                Map::new().with("token", TOKEN).with("names", names),
            );
            let (serial, _) = state.places.want(&path);
            let place = state.places.get(&path, serial).expect("it is wanted");
            place.gate.joined(&Map::new().with("guard", guard));
        }
    }

    /// Notes what is put in; gives its id, and where its answer goes if a caller waits for it.
    fn note(&mut self, item: &Item, awaited: bool) -> (u64, Option<AnswerTo>) {
        let id = self.said.len() as u64 + 1;
        let context = path(&item.context);
        if !self.told_in.contains_key(&context) {
            let events = self.shared.subscribe(&context);
            self.told_in.insert(context.clone(), events);
        }
        let (sender, receiver) = oneshot::channel();
        let said = Said {
            label: item.is.clone(),
            name: item.name.clone(),
            guarded: item.guarded,
            context,
            left: false,
            answer: awaited.then_some(receiver),
            told: false,
        };
        self.said.insert(id, said);
        (id, awaited.then_some(AnswerTo::Caller(sender)))
    }

    fn say(&mut self, mut parcel: Parcel, item: &Item) {
        // Only messages are told of without an answer.
        let message = parcel.family == Family::Message;
        let (id, mut waiter) = self.note(item, item.awaited || !message);
        parcel.id = Some(id);
        let put = match message {
            true => {
                let put = at_once(self.shared.post(parcel, waiter));
                put.unwrap_or_else(|| panic!("{} waits for room", item.is))
            }
            false => self.shared.ask_in(&mut self.shared.lock(), parcel, &mut waiter),
        };
        if let Err(error) = put {
            let said = self.said.get_mut(&id).expect("it is noted");
            (said.told, said.answer) = (true, None);
            self.told.insert(item.is.clone(), refused(&error));
        }
    }

    /// Has the link take one piece, and takes back the rest of what was taken; gives what it is a piece of, by its id.
    fn write(&mut self) -> Option<u64> {
        let mut batch: VecDeque<Piece<Entry>> = VecDeque::new();
        let all = Allowance {
            bytes: usize::MAX,
            piece: CHUNK,
            stops: usize::MAX,
        };
        let now = u64::try_from(self.wall.load(Ordering::Relaxed)).expect("after 1970");
        let mut state = self.shared.lock();
        let (parcel, mark) = (state.me.limits.parcel, state.outbox.mark());
        state.outbox.take(now, all, parcel, &mut batch);
        let expired = state.outbox.take_dropped();
        drop(state);
        self.shared.tell_dropped(&expired);
        let mut piece = batch.pop_front()?;
        let mut slices = Vec::new();
        piece.append_to(Some(Form::Binary), &mut slices);
        slices
            .iter()
            .for_each(|slice| self.bytes.extend_from_slice(slice));
        piece.advance(piece.left());
        if let Some(ledger) = self.shared.ledger.lock().as_mut() {
            ledger.note(&piece, Some(Form::Binary));
        }
        let entry = piece.item().expect("nothing is given up").clone();
        let id = entry.id.expect("all have one");
        if piece.is_last() {
            self.shared.give_capacity(entry.take_capacity());
            if let Some(said) = self.said.get_mut(&id) {
                said.left = true;
            }
        }
        let mut state = self.shared.lock();
        state.outbox.put_back(&mut batch, mark);
        let dropped = state.outbox.take_dropped();
        drop(state);
        self.shared.tell_dropped(&dropped);
        while let Some(frame) = self.decoder.decode(&mut self.bytes).expect("frames") {
            let Frame::Parcel(parcel) = frame else {
                panic!("{frame:?}")
            };
            let known = parcel.id.and_then(|id| self.said.get(&id));
            self.read
                .push_back(known.map_or(parcel.name(), |said| &said.label).to_owned());
        }
        Some(id)
    }

    /// Takes in what was told of messages for whose answer nobody waits: how many, in which context, and why.
    fn take_events(&mut self) {
        let mut told = Vec::new();
        for (path, events) in &self.told_in {
            while let Some(Some(event)) = at_once(events.next()) {
                if let Event::Dropped { reason, count, .. } = event {
                    told.push((path.clone(), reason, count));
                }
            }
        }
        for (path, reason, count) in told {
            // Of those that are alike the oldest.
            let fits = |said: &&mut Said| {
                let of_its_kind = match reason.as_str() {
                    "withdrawn" => said.name == "unstop",
                    "lost" | "unknown" => said.guarded || ["command", "unstop"].contains(&said.name.as_str()),
                    _ => true,
                };
                // What has expired may have left, and come back.
                let left = reason == "expired" || said.left == (reason == "unknown");
                said.context == path && said.answer.is_none() && !said.told && left && of_its_kind
            };
            for _ in 0..count {
                let said = self.said.values_mut().find(fits);
                let said = said.unwrap_or_else(|| panic!("{count} {reason} in {path}"));
                said.told = true;
                self.told.insert(said.label.clone(), reason.clone());
            }
        }
    }
}

impl Replay for Talker {
    fn put(&mut self, item: &Item) {
        let family = Family::from_word(&item.family).expect("a family");
        let mut parcel = Parcel::new(family, item.name.as_str()).context(path(&item.context));
        let names = |names: &Vec<String>| names.iter().map(|name| name.as_str().into()).collect();
        parcel.address = item.address.as_ref().map(names);
        parcel.delivery = item.delivery.as_deref().and_then(Delivery::from_word);
        (parcel.priority, parcel.expires, parcel.fence) = (item.priority, item.expires, item.fence);
        if item.bytes > 0 {
            parcel.content = Some(Value::from(Bytes::from(vec![7; item.bytes])).into());
        }
        if let Some(peer) = &item.peer {
            parcel.content = Some(Map::new().with("peer", peer.as_str()).into());
        }
        self.say(parcel, item);
    }

    fn fill(&mut self, label: &str) {
        let item = Item {
            bytes: (self.shared.capacity_left() - 1) * 1024,
            ..Item::reliable(label)
        };
        self.put(&item);
        assert_eq!(self.shared.capacity_left(), 0, "it is full");
    }

    fn begin(&mut self) -> Option<String> {
        let id = self.write()?;
        assert!(self.read.is_empty(), "it was all of it");
        self.said.get(&id).map(|said| said.label.clone())
    }

    fn take(&mut self) -> Option<String> {
        while self.read.is_empty() {
            self.write()?;
        }
        self.read.pop_front()
    }

    fn lose(&mut self) {
        assert!(self.shared.suspend(), "it has a link");
        (self.decoder, self.bytes) = decoder();
    }

    fn resume(&mut self, read: u64) {
        let resumption = Resumption {
            read: ReadCount {
                parcels: read,
                checksum: None,
            },
            dropped: 0,
            content: Map::new(),
        };
        assert!(self.shared.go_on(&resumption), "a count that can be");
    }

    fn told(&mut self) -> BTreeMap<String, String> {
        self.shared.lock().tell_replaced();
        self.take_events();
        for said in self.said.values_mut() {
            if let Some(Ok(answer)) = said.answer.as_mut().map(|answer| answer.try_recv()) {
                let error = answer.expect_err("no hub answers");
                self.told.insert(said.label.clone(), word(&error));
                said.answer = None;
                said.told = true;
            }
        }
        std::mem::take(&mut self.told)
    }

    fn left_over(&mut self) -> Option<String> {
        let state = self.shared.lock();
        let (bytes, empty) = (state.outbox.queue.bytes(), state.outbox.queue.is_empty());
        drop(state);
        let capacity = self.shared.capacity_left();
        let right = bytes == 0 && empty && capacity == self.capacity;
        (!right).then(|| format!("{bytes} bytes, {capacity} of {}", self.capacity))
    }

    fn pass(&mut self, millis: u64) {
        let micros = i64::try_from(millis * 1000).expect("some seconds");
        self.wall.fetch_add(micros, Ordering::Relaxed);
    }
}

/// What comes of something without waiting.
fn at_once<T>(future: impl Future<Output = T>) -> Option<T> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(output) => Some(output),
        Poll::Pending => None,
    }
}

fn path(text: &str) -> Path {
    Path::parse(text).expect("a path")
}

fn decoder() -> (BinaryDecoder, BytesMut) {
    let mut decoder = BinaryDecoder::new(&Limits::default());
    decoder.set_limits(&Limits::default());
    (decoder, BytesMut::from(&PREFACE[..]))
}

/// What a caller is told that may not even put it in.
fn refused(error: &ClientError) -> String {
    match error {
        ClientError::Connection(text) if text.contains("too late") => "lost".to_owned(),
        other => panic!("{other}"),
    }
}

/// The word for what who waits for an answer is told.
fn word(error: &ClientError) -> String {
    let text = error.to_string();
    let code = error.code();
    let word = if error.kind() == ErrorKind::Unknown {
        assert!(
            text.contains("cannot be known") && !text.contains("before"),
            "{text}"
        );
        "unknown"
    } else if code == Some(&Code::EXPIRED) {
        "expired"
    } else if error.kind() == ErrorKind::Connection {
        "lost"
    } else if code == Some(&Code::WITHDRAWN) && text.contains("stop") {
        "withdrawn"
    } else if code == Some(&Code::WITHDRAWN) {
        "replaced"
    } else {
        panic!("{text}")
    };
    word.to_owned()
}

/// A hub that has counted other parcels than this peer has sent is not gone on with: something would come twice, or never.
#[test]
fn a_hub_that_has_read_other_parcels_is_no_hub_to_go_on_with() {
    let item = Item::reliable("a");
    // All that it has sent has the id 1.
    for (word, goes_on) in [(1, true), (2, false)] {
        let mut talker = Talker::new(&Case::default());
        let parcel = Parcel::new(Family::Message, "note").context(path("/chat"));
        talker.say(parcel, &item);
        assert_eq!(talker.take().as_deref(), Some("a"));
        let mut read = ReadCount::new();
        read.count(Some(word));
        talker.lose();
        let resumption = Resumption {
            read,
            dropped: 0,
            content: Map::new(),
        };
        assert_eq!(talker.shared.go_on(&resumption), goes_on);
    }
}
