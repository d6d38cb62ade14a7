//! What each attack does, in rounds: each ends when the hub has answered.

use std::time::Duration;

use bytes::Bytes;
use mom_proto::codec::Form;
use mom_proto::{Content, Family, Map, PRIORITY, Parcel, Value};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::task::JoinSet;
use tokio::time::sleep;

use super::attackers::{about, make};
use super::strangers::{NOTHING, ask_much, flood};
use super::{Attack, Attackers};
use crate::raw::{Raw, at, message};

/// A little less than a parcel may have.
const LARGE: usize = 8 * 1024 * 1024 - 4096;
const TOKENS: usize = 5000;
const CHILDREN: usize = 9000;
const MEMBERS: usize = 200;
/// Requests that are on their way together.
const TOGETHER: usize = 250;
const SLEEPERS: usize = 16;
const CHANNELS: usize = 200;
const LISTENERS: usize = 16;
const CROWD: usize = 1000;
const ROBOT: &str = "/robot/arm";

impl Attackers {
    pub(super) async fn prepare(&mut self) {
        let here = self.channel();
        match self.attack {
            Attack::LargeDelete => self.enter(Form::Binary, &["/free"]).await,
            Attack::Nils | Attack::Lidar | Attack::LaterXml => {
                self.listen(Form::Xml, &[&here]).await;
                self.enter(Form::Binary, &[&here]).await;
            }
            Attack::Rejoin => {
                self.enter(Form::Binary, &[&here]).await;
                self.enter(Form::Xml, &[]).await;
                for _ in 0..16 {
                    let block = message("block", &here, Value::Binary(vec![7; 60 * 1024].into()));
                    let _ = self.ask(0, receipted(block)).await;
                }
            }
            Attack::LargeSlots => self.enter(Form::Binary, &[&here]).await,
            Attack::LargeRequest | Attack::SignsOfLife => self.enter(Form::Binary, &[]).await,
            Attack::LargeXml => {
                self.listen(Form::Binary, &[&here]).await;
                self.enter(Form::Xml, &[&here]).await;
            }
            Attack::LargeList => {
                self.enter(Form::Binary, &["/free"]).await;
                let session = self.session().await;
                self.fill(&session, CHILDREN).await;
            }
            Attack::Crowd => {
                for _ in 0..MEMBERS {
                    self.listen(Form::Binary, &[&here]).await;
                }
                self.enter(Form::Binary, &[]).await;
            }
            Attack::Leavers => {
                self.enter(Form::Binary, &["/free"]).await;
                let session = self.session().await;
                for number in 0..CHANNELS {
                    let _ = self.ask(0, make(&format!("{session}/{number}"), "channel")).await;
                }
                let all: Vec<String> = (0..CHANNELS)
                    .map(|number| format!("{session}/{number}"))
                    .collect();
                let all: Vec<&str> = ["/free", &session]
                    .into_iter()
                    .chain(all.iter().map(String::as_str))
                    .collect();
                for _ in 0..LISTENERS {
                    self.listen(Form::Binary, &all).await;
                }
            }
            Attack::Sleepers => {
                self.enter(Form::Binary, &[&here]).await;
                self.sleep_in(&here).await;
            }
            Attack::Urgent => self.enter(Form::Binary, &["/robot", ROBOT]).await,
            Attack::SlowDevice => {
                self.enter(Form::Binary, &[&here]).await;
                let mut device = Raw::connect_small(self.address, Form::Binary).await;
                device.log_in("carol").await;
                let join = about("join", &here).content(Map::new().with("device", true));
                device.ask(join).await.expect("it may be one");
                self.sleepers.push(device);
            }
            Attack::Reset => make_room(),
            Attack::Chunks | Attack::Nothing | Attack::Heads => {}
        }
    }

    /// One round.
    pub async fn round(&mut self) {
        self.rounds += 1;
        let here = self.channel();
        match self.attack {
            Attack::LargeDelete => {
                let session = self.session().await;
                self.fill(&session, TOKENS).await;
                let _ = self.ask(0, about("delete", &session)).await;
            }
            Attack::Nils => {
                self.send_content(&here, nils()).await;
                self.hear_of_drops("dropped: bad-content").await;
            }
            Attack::Rejoin => {
                for peer in 0..2 {
                    self.join_and_leave(peer, &here, 20).await;
                }
            }
            Attack::LargeSlots => {
                let mut parcel = message("block", &here, 7);
                parcel.extra = Map::new().with("note", "x".repeat(4 * 1024 * 1024));
                let _ = self.ask(0, receipted(parcel)).await;
            }
            Attack::LargeRequest => {
                let parcel = about("join", &here).content(Value::Binary(vec![7; LARGE].into()));
                let _ = self.ask(0, parcel).await;
            }
            Attack::LargeXml => {
                let items = vec![Value::Int(1); LARGE / 26];
                let _ = self.ask(0, receipted(message("list", &here, items))).await;
            }
            Attack::LargeList => {
                let session = self.first_session();
                let first = self.post_many(0, (0..16).map(|_| about("list", &session))).await;
                let _ = self.answers(0, first, 16).await;
            }
            Attack::Crowd => self.join_and_leave(0, &here, 20).await,
            Attack::Leavers => {
                let session = self.first_session();
                self.insist(about("join", &session)).await;
                let joins = (0..CHANNELS).map(|number| about("join", &format!("{session}/{number}")));
                let count = u64::try_from(CHANNELS).expect("few");
                let first = self.post_many(0, joins).await;
                let _ = self.answers(0, first, count).await;
                self.insist(about("leave", &session)).await;
            }
            Attack::Lidar
            | Attack::Sleepers
            | Attack::Chunks
            | Attack::Nothing
            | Attack::Heads
            | Attack::SignsOfLife
            | Attack::LaterXml
            | Attack::Urgent
            | Attack::SlowDevice => self.round_of_bytes(&here).await,
            Attack::Reset => self.be_reset(&here).await,
        }
    }

    /// A round of what costs by what is sent, not by what is asked for.
    async fn round_of_bytes(&mut self, here: &str) {
        match self.attack {
            Attack::Lidar => {
                self.send_content(here, doubles()).await;
                sleep(Duration::from_millis(100)).await; // tidy: a lidar turns ten times a second
            }
            Attack::Sleepers => {
                let block = || message("block", here, Value::Binary(vec![7; 64 * 1024].into()));
                let first = self.post_many(0, (0..16).map(|_| receipted(block()))).await;
                let _ = self.answers(0, first, 16).await;
                // By then the outboxes are full.
                if self.rounds == 8 {
                    self.hear_of_drops("dropped: queue-full").await;
                }
            }
            Attack::Urgent => {
                let note = || {
                    let mut note = message("note", ROBOT, Value::Binary(vec![7; 60_000].into()));
                    (note.priority, note.address) = (Some(*PRIORITY.end()), Some(vec!["arm".into()]));
                    receipted(note)
                };
                let first = self.post_many(0, (0..16).map(|_| note())).await;
                let _ = self.answers(0, first, 16).await;
            }
            Attack::SlowDevice => {
                let block = || message("block", here, Value::Binary(vec![7; 64 * 1024].into()));
                let first = self.post_many(0, (0..16).map(|_| receipted(block()))).await;
                let _ = self.answers(0, first, 16).await;
            }
            Attack::Chunks => self.begin_chunks().await,
            Attack::Nothing => {
                let floods = NOTHING.into_iter().chain(NOTHING);
                let mut floods: JoinSet<u16> = floods.map(|frame| flood(self.address, frame)).collect();
                while let Some(status) = floods.join_next().await {
                    self.note(&format!("closed: {}", status.expect("it ends")));
                }
            }
            Attack::Heads => {
                let mut asking: JoinSet<_> = (0..4).map(|_| ask_much(self.address, 1000)).collect();
                while let Some(statuses) = asking.join_next().await {
                    let statuses = statuses.expect("it ends");
                    statuses
                        .iter()
                        .for_each(|status| self.note(&format!("status: {status}")));
                }
            }
            Attack::SignsOfLife => {
                for (family, name) in [
                    (Family::Time, "ping"),
                    (Family::Time, "ack"),
                    (Family::Login, "login"),
                ] {
                    let mut parcel = Parcel::new(family, name);
                    parcel.content = Some(Content::Encoded(nils().into()));
                    let _ = self.ask(0, parcel).await;
                }
            }
            Attack::LaterXml => {
                let mut parcel = Parcel::new(Family::Message, "scan").context(at(here));
                parcel.echo = Some(false);
                parcel.content = Some(Content::Encoded(doubles().into()));
                for _ in 0..16 {
                    self.peers[0].send_parcel(&parcel).await;
                }
                self.hear_of_drops("dropped: queue-full").await;
            }
            _ => {}
        }
    }

    /// The channel of this attack.
    fn channel(&self) -> String {
        format!("/{}", self.attack.word())
    }

    /// A new session of the attacker's own.
    async fn session(&mut self) -> String {
        let path = format!("/free/{}-{}", self.attack.word(), self.rounds);
        self.insist(make(&path, "session")).await;
        self.insist(about("join", &path)).await;
        path
    }

    /// Asks until it goes well, or the hub has had enough.
    async fn insist(&mut self, parcel: Parcel) {
        while self.ask(0, parcel.clone()).await.is_none() && self.times("closed") == 0 {}
    }

    /// The session that was made before the first round.
    fn first_session(&self) -> String {
        format!("/free/{}-0", self.attack.word())
    }

    /// Makes so many tokens, however often the hub puts some off.
    async fn fill(&mut self, session: &str, count: usize) {
        let (mut made, mut tried) = (0, 0);
        while made < count {
            let together = (tried..tried + TOGETHER).map(|at| make(&format!("{session}/{at}"), "token"));
            let first = self.post_many(0, together).await;
            let together = u64::try_from(TOGETHER).expect("few");
            made += self.answers(0, first, together).await.len();
            tried += TOGETHER;
        }
    }

    async fn join_and_leave(&mut self, peer: usize, path: &str, times: usize) {
        let pairs = (0..times).flat_map(|_| [about("join", path), about("leave", path)]);
        let first = self.post_many(peer, pairs).await;
        let _ = self
            .answers(peer, first, 2 * u64::try_from(times).expect("few"))
            .await;
    }

    /// Sends requests together; gives the id of the first.
    async fn post_many(&mut self, peer: usize, parcels: impl Iterator<Item = Parcel>) -> u64 {
        let mut first = None;
        for parcel in parcels {
            let id = self.peers[peer].post(parcel).await;
            first.get_or_insert(id);
        }
        first.unwrap_or_default()
    }

    /// Sends a message with this content, which the hub need not open.
    async fn send_content(&mut self, path: &str, content: Vec<u8>) {
        let mut parcel = Parcel::new(Family::Message, "scan").context(at(path));
        parcel.echo = Some(false);
        parcel.content = Some(Content::Encoded(Bytes::from(content)));
        let _ = self.ask(0, receipted(parcel)).await;
    }

    /// Waits until the hub has said that it dropped something for this reason.
    async fn hear_of_drops(&mut self, what: &str) {
        let before = self.times(what);
        while self.times(what) == before && self.times("closed") == 0 {
            let _ = self.ask(0, Parcel::new(Family::Time, "ping")).await;
        }
    }

    async fn sleep_in(&mut self, path: &str) {
        for _ in 0..SLEEPERS {
            let mut raw = Raw::connect_small(self.address, Form::Binary).await;
            raw.log_in("carol").await;
            raw.join(&[path]).await;
            self.sleepers.push(raw);
        }
    }

    /// Many join a channel, and are all gone in one moment.
    async fn be_reset(&mut self, here: &str) {
        let mut coming = JoinSet::new();
        let mut come: Vec<Raw> = Vec::new();
        for _ in 0..CROWD {
            let (address, here) = (self.address, here.to_owned());
            coming.spawn(async move {
                let mut raw = Raw::login(address, Form::Binary, "guest").await;
                raw.join(&[&here]).await;
                raw
            });
            // What a flood of logins costs is another question.
            if coming.len() >= 8 {
                come.extend(coming.join_next().await.map(|raw| raw.expect("it comes")));
            }
        }
        come.extend(coming.join_all().await);
        come.into_iter().for_each(Raw::reset);
    }

    /// A frame of 8 MiB of which all but the end comes, on connections of which the oldest go when there are many.
    async fn begin_chunks(&mut self) {
        let mut raw = Raw::login(self.address, Form::Binary, "bob").await;
        raw.send(&first_chunk(LARGE, LARGE - 4096)).await;
        raw.check_alive().await;
        self.sleepers.push(raw);
        if self.sleepers.len() > SLEEPERS {
            drop(self.sleepers.remove(0));
        }
    }
}

/// A list of nils, of almost the size that a parcel may have.
fn nils() -> Vec<u8> {
    let mut nils = vec![0xc0; LARGE];
    nils[0] = 0xdd;
    nils[1..5].copy_from_slice(&u32::try_from(LARGE - 5).expect("small").to_be_bytes());
    nils
}

/// A list of 100 000 doubles.
fn doubles() -> Vec<u8> {
    let mut doubles = vec![0xdd];
    doubles.extend(100_000_u32.to_be_bytes());
    for number in 0..100_000_u32 {
        doubles.push(0xcb);
        doubles.extend((f64::from(number) * 0.001_37).to_be_bytes());
    }
    doubles
}

/// Has the system let this process have a connection for each of the crowd, and as many more.
fn make_room() {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let wanted = u64::try_from(4 * CROWD).expect("few");
    if current.is_some_and(|current| current < wanted) {
        let current = Some(maximum.map_or(wanted, |maximum| maximum.min(wanted)));
        setrlimit(Resource::Nofile, Rlimit { current, maximum }).expect("up to what the system allows");
    }
}

fn receipted(mut parcel: Parcel) -> Parcel {
    parcel.receipt = Some(true);
    parcel
}

/// The first chunk of a parcel of `whole` bytes, with `part` of them.
fn first_chunk(whole: usize, part: usize) -> Vec<u8> {
    let mut chunk = vec![1, 0, 1];
    let mut left = whole;
    while left >= 0x80 {
        chunk.push(u8::try_from(left & 0x7f).expect("seven bits") | 0x80);
        left >>= 7;
    }
    chunk.push(u8::try_from(left).expect("seven bits"));
    chunk.resize(chunk.len() + part, 0);
    let length = u32::try_from(chunk.len()).expect("small");
    [&length.to_be_bytes()[..], &chunk].concat()
}
