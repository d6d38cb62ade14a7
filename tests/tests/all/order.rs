//! One order for all receivers (M27, M35): whatever the sender and its way, everybody in a reliable channel hears the same
//! sequence, without a gap, and each sender's messages in the order in which it sent them. What a token guards is a sequence of its own.

use std::collections::{HashMap, VecDeque};

use bytes::Bytes;
use mom_broker::Broker;
use mom_net::{Outgoing, Progress, Reader, Transceiver, Writer};
use mom_proto::codec::{Form, Frame};
use mom_proto::{Content, ContextNumber, Family, Limits, Map, Parcel, Path, Value};
use mom_tests::lab;
use mom_tests::raw::{PATIENCE, Raw, at};
use tokio::sync::{oneshot, watch};
use tokio::task::{JoinSet, yield_now};
use tokio::time::timeout;

const FLOOR: &str = "/floor";
const TOKEN: &str = "/floor-token";
/// Where nobody else says anything.
const DOOR: &str = "/chat";

/// Messages of each sender.
const MESSAGES: u64 = 96;

/// From nothing to more than goes in one piece: beside small ones what is too large for a run, for a copy, for a chunk.
const SIZES: [usize; 12] = [0, 16, 300, 0, 2000, 64, 5000, 1, 9000, 0, 70_000, 16];
const HUGE: usize = 700_000;

/// How much is said between two visits of one who comes and goes.
const OUTSIDE: usize = 120;

/// A message as it is told apart: who said it, and its number there.
type Said = (String, u64);

/// How a peer is connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Over {
    Tcp(Form),
    Local,
}

const BINARY: Over = Over::Tcp(Form::Binary);
const XML: Over = Over::Tcp(Form::Xml);

/// By which way the messages of a sender pass the hub.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// Nothing but content, many in one write, the channel by its number: what may go in a run.
    Plain,
    /// The same without an echo.
    Mute,
    /// Each answered.
    Receipts,
    /// Needing the token, which this sender owns.
    Guarded,
    /// To a list, which is everybody.
    Listed,
}

async fn start() -> Broker {
    let broker = lab::start_with(|config| {
        // Nobody is put out for being slow on a busy machine: order is what is looked at.
        config.limits.outbox = 256 << 20;
    })
    .await;
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    let create = |path, content: Map| {
        Parcel::new(Family::Context, "create")
            .context(at(path))
            .content(content)
    };
    let token = Map::new().with("kind", "token").with("manager", "first-come");
    let guard = Map::new()
        .with("token", TOKEN)
        .with("names", vec![Value::from("guarded")]);
    let floor = Map::new()
        .with("kind", "channel")
        .with("manager", "open")
        .with("guard", guard);
    for (path, spec) in [(TOKEN, token), (FLOOR, floor)] {
        carol.ask(create(path, spec)).await.expect("operators may");
    }
    broker
}

/// One peer.
struct Peer {
    over: Over,
    name: String,
    reader: Reader,
    writer: Writer,
    /// The channel's number.
    number: u64,
    last_id: u64,
}

impl Peer {
    async fn enter(broker: &Broker, over: Over, user: &str) -> Peer {
        let Transceiver { reader, writer, .. } = match over {
            Over::Local => broker.connect_local(),
            Over::Tcp(form) => {
                let scheme = if form == Form::Xml { "tcp" } else { "bin" };
                let address = format!("{scheme}://{}", broker.local_addr());
                let address = address.parse().expect("an address");
                mom_net::connect(&address, &Limits::default(), None)
                    .await
                    .expect("the broker listens")
            }
        };
        let mut peer = Peer {
            over,
            name: String::new(),
            reader,
            writer,
            number: 0,
            last_id: 1 << 30,
        };
        peer.reader.set_limits(&Limits::default());
        let content = Map::new().with("name", user).with("password", user);
        let login = Parcel::new(Family::Login, "login").content(content);
        let welcome = peer.ask(login).await.value();
        peer.name = text(&welcome, "peer");
        peer
    }

    /// Joins the channel; nothing of it was heard before.
    async fn join(&mut self) {
        let reply = self
            .ask(Parcel::new(Family::Context, "join").context(at(FLOOR)))
            .await;
        let number = reply.value().get("number").and_then(Value::as_int);
        self.number = number.expect("a channel has a number").unsigned_abs();
    }

    async fn ask(&mut self, parcel: Parcel) -> Parcel {
        let id = self.post(parcel).await;
        loop {
            let heard = next(&mut self.reader).await.expect("an answer");
            if heard.reference == Some(id) {
                assert!(heard.family == Family::Reply, "{heard:?}");
                return heard;
            }
        }
    }

    async fn post(&mut self, parcel: Parcel) -> u64 {
        self.last_id += 1;
        let id = self.last_id;
        self.writer.send(parcel.id(id)).await.expect("the broker reads");
        id
    }
}

async fn next(reader: &mut Reader) -> Option<Parcel> {
    let frame = timeout(PATIENCE, reader.next())
        .await
        .expect("the broker says something");
    match frame.expect("what the broker says is well-formed")? {
        Frame::Parcel(parcel) => Some(*parcel),
        Frame::Malformed { error, .. } => panic!("the broker sent what it would refuse: {error}"),
    }
}

fn text(value: &Value, key: &str) -> String {
    value.get(key).and_then(Value::as_str).expect("a word").to_owned()
}

/// What a listener hears until the word that ends it; with an answer to its last question it says so.
async fn listen(
    mut reader: Reader,
    mut settled: Option<oneshot::Sender<()>>,
    count: watch::Sender<usize>,
) -> Heard {
    let mut heard = Heard::default();
    while let Some(parcel) = next(&mut reader).await {
        match parcel.family {
            Family::Message if parcel.name() == "end" => return heard,
            Family::Message => {
                heard.said.push(said(&parcel));
                count.send_replace(heard.said.len());
            }
            Family::Reply => heard.answers += 1,
            Family::Time if parcel.name() == "pong" => drop(settled.take().map(|settled| settled.send(()))),
            Family::Time | Family::Event => {}
            _ => panic!("{parcel:?}"),
        }
    }
    panic!("closed before the end, after {} messages", heard.said.len());
}

#[derive(Debug, Default)]
struct Heard {
    said: Vec<Said>,
    answers: u64,
}

/// Who said it and its number, if it is as long as the number says.
fn said(parcel: &Parcel) -> Said {
    let id = parcel.id.expect("messages are numbered");
    let length = match parcel.content.as_ref().map(Content::to_value) {
        Some(Ok(Value::Binary(bytes))) => bytes.len(),
        other => panic!("{other:?}"),
    };
    assert_eq!(length, size(id), "whole");
    (
        parcel.sender.as_deref().expect("the hub stamps it").to_owned(),
        id,
    )
}

fn size(id: u64) -> usize {
    match id % 48 {
        47 => HUGE,
        _ => SIZES[id as usize % SIZES.len()],
    }
}

fn parcel(peer: &Peer, way: Way, id: u64, everybody: &[String]) -> Parcel {
    let name = if way == Way::Guarded { "guarded" } else { "state" };
    let content = Value::Binary(Bytes::from(vec![id as u8; size(id)]));
    let mut parcel = Parcel::new(Family::Message, name)
        .context(at(FLOOR))
        .id(id)
        .content(content);
    if peer.over == BINARY && !id.is_multiple_of(5) {
        (parcel.context, parcel.number) = (None::<Path>, Some(ContextNumber(peer.number)));
    }
    match way {
        Way::Plain | Way::Guarded => {}
        Way::Mute => parcel.echo = Some(false),
        Way::Receipts => parcel.receipt = Some(true),
        Way::Listed => parcel.address = Some(everybody.iter().map(|name| name.as_str().into()).collect()),
    }
    parcel
}

/// Sends all messages of one sender, the plain ones many at once, and asks last whether they are there.
async fn speak(writer: Writer, parcels: Vec<Parcel>, at_once: usize) -> Writer {
    let ping = Parcel::new(Family::Time, "ping").id(1 << 40);
    let mut queue: VecDeque<Outgoing> = VecDeque::new();
    for parcel in parcels.into_iter().chain([ping]) {
        let last = parcel.family == Family::Time;
        queue.push_back(writer.prepare(parcel.into()).expect("a frame"));
        while (last || queue.len() >= at_once) && !queue.is_empty() {
            if writer.try_write(&mut queue).expect("the broker reads") == Progress::Blocked {
                timeout(PATIENCE, writer.ready())
                    .await
                    .expect("the broker reads")
                    .expect("and stays");
            }
            yield_now().await;
        }
    }
    writer
}

/// Comes and goes until all is said, first when a listener has heard `first` messages; gives what it heard each time.
async fn come_and_go(
    mut peer: Peer,
    first: usize,
    mut over: watch::Receiver<bool>,
    heard: watch::Receiver<usize>,
) -> Vec<Vec<Said>> {
    let mut visits = Vec::new();
    let (mut there, mut at_least) = (heard, first);
    let door = Parcel::new(Family::Context, "join").context(at(DOOR));
    peer.ask(door).await;
    loop {
        tokio::select! {
            _ = over.wait_for(|over| *over) => return visits,
            _ = there.wait_for(|count| *count >= at_least) => {}
        }
        peer.join().await;
        let mut heard = Vec::new();
        while heard.len() < 25 + 10 * visits.len() && !*over.borrow() {
            let frame = tokio::select! {
                frame = next(&mut peer.reader) => frame,
                _ = over.changed() => break,
            };
            let parcel = frame.expect("nobody is put out");
            if parcel.family == Family::Message {
                heard.push(said(&parcel));
            }
        }
        let leave = Parcel::new(Family::Context, "leave").context(at(FLOOR));
        peer.post(leave).await;
        // Answers overtake messages; what still waited when it left lies before this one.
        let mut last = Parcel::new(Family::Message, "gone").context(at(DOOR));
        last.address = Some(vec![peer.name.as_str().into()]);
        peer.post(last).await;
        loop {
            let parcel = next(&mut peer.reader).await.expect("nobody is put out");
            match parcel.family {
                Family::Message if parcel.name() == "gone" => break,
                Family::Message => heard.push(said(&parcel)),
                _ => {}
            }
        }
        visits.push(heard);
        at_least = *there.borrow() + OUTSIDE;
    }
}

/// Who takes part.
struct Cast {
    /// Who sends, how, and whether it reads only when all is said.
    senders: Vec<(Over, Way, bool)>,
    listeners: Vec<(Over, bool)>,
    comers: Vec<Over>,
}

/// What everybody heard.
struct Outcome {
    heard: Vec<(String, Option<Way>, Heard)>,
    visits: Vec<Vec<Said>>,
}

async fn check(cast: Cast) {
    let broker = start().await;
    let mut chair = Peer::enter(&broker, BINARY, "carol").await;
    chair.join().await;
    let mut peers = Vec::new();
    for (over, way, late) in &cast.senders {
        let mut peer = Peer::enter(&broker, *over, "alice").await;
        peer.join().await;
        if *way == Way::Guarded {
            let grab = Parcel::new(Family::Token, "grab").context(at(TOKEN));
            peer.ask(grab).await;
        }
        peers.push((peer, Some(*way), *late));
    }
    for (over, late) in &cast.listeners {
        let mut peer = Peer::enter(&broker, *over, "bob").await;
        peer.join().await;
        peers.push((peer, None, *late));
    }
    let mut comers = Vec::new();
    for over in &cast.comers {
        comers.push(Peer::enter(&broker, *over, "bob").await);
    }
    run(chair, peers, comers).await.judge();
    broker.stop().await;
}

/// Lets everybody speak and listen, and ends it when all is said.
async fn run(mut chair: Peer, peers: Vec<(Peer, Option<Way>, bool)>, comers: Vec<Peer>) -> Outcome {
    let everybody: Vec<String> = peers.iter().map(|(peer, ..)| peer.name.clone()).collect();
    let all_said = watch::Sender::new(false);
    let heard = watch::Sender::new(0);
    let (mut ears, mut mouths, mut visits) = (JoinSet::new(), JoinSet::new(), JoinSet::new());
    for (nth, peer) in comers.into_iter().enumerate() {
        visits.spawn(come_and_go(
            peer,
            nth * OUTSIDE,
            all_said.subscribe(),
            heard.subscribe(),
        ));
    }
    let (mut prompt, mut late_ones) = (Vec::new(), Vec::new());
    // The end of a writer would be the end of its connection.
    let mut writers = Vec::new();
    for (peer, way, late) in peers {
        let parcels = way.map(|way| {
            (1..=MESSAGES)
                .map(|id| parcel(&peer, way, id, &everybody))
                .collect()
        });
        let (tell, told) = oneshot::channel();
        let tell = way.map(|_| tell);
        let (name, reader) = (peer.name, peer.reader);
        let mut begin = all_said.subscribe();
        let count = if late || way.is_some() {
            watch::Sender::new(0)
        } else {
            heard.clone()
        };
        ears.spawn(async move {
            if late {
                begin.wait_for(|over| *over).await.expect("the test lives");
            }
            (name, way, listen(reader, tell, count).await)
        });
        match parcels {
            None => writers.push(peer.writer),
            Some(parcels) => {
                let at_once = if way == Some(Way::Plain) { 24 } else { 3 };
                mouths.spawn(speak(peer.writer, parcels, at_once));
                let list = if late { &mut late_ones } else { &mut prompt };
                list.push(told);
            }
        }
    }
    writers.extend(mouths.join_all().await);
    taken_in(prompt).await;
    all_said.send_replace(true);
    taken_in(late_ones).await;
    let visits = visits.join_all().await.into_iter().flatten().collect();
    let end = Parcel::new(Family::Message, "end").context(at(FLOOR));
    chair.post(end).await;
    let heard = ears.join_all().await;
    Outcome { heard, visits }
}

/// Waits until the hub has taken in what each of these has said.
async fn taken_in(settled: Vec<oneshot::Receiver<()>>) {
    for settled in settled {
        let settled = timeout(PATIENCE, settled).await.expect("the broker reads");
        settled.expect("its listener lives");
    }
}

impl Outcome {
    fn judge(self) {
        let way_of: HashMap<&str, Way> = self
            .heard
            .iter()
            .filter_map(|(name, way, _)| Some((name.as_str(), (*way)?)))
            .collect();
        let listener = self.heard.iter().find(|(_, way, _)| way.is_none());
        let order = &listener.expect("a peer only listens").2.said;
        assert_eq!(order.len() as u64, MESSAGES * way_of.len() as u64, "no gap");
        for name in way_of.keys() {
            let own = order
                .iter()
                .filter(|(sender, _)| sender == name)
                .map(|(_, id)| *id);
            assert!(own.eq(1..=MESSAGES), "{name} in its order");
        }
        for (name, way, heard) in &self.heard {
            let mute = *way == Some(Way::Mute);
            let expected = order.iter().filter(|(sender, _)| !(mute && sender == name));
            let expected: Vec<&Said> = expected.collect();
            for guarded in [true, false] {
                let expected = part(&way_of, guarded, expected.iter().copied());
                assert_same(name, &expected, &part(&way_of, guarded, &heard.said));
            }
            let answers = if *way == Some(Way::Receipts) { MESSAGES } else { 0 };
            assert_eq!(heard.answers, answers, "{name}");
        }
        // What went to a list of others is not for who came later.
        let public: Vec<&Said> = order
            .iter()
            .filter(|(sender, _)| way_of[sender.as_str()] != Way::Listed)
            .collect();
        for guarded in [true, false] {
            let public = part(&way_of, guarded, public.iter().copied());
            self.check_visits(&public, |visit| part(&way_of, guarded, visit));
        }
    }

    fn check_visits(&self, public: &[&Said], part: impl Fn(&[Said]) -> Vec<&Said>) {
        let place: HashMap<&Said, usize> = public.iter().enumerate().map(|(at, said)| (*said, at)).collect();
        assert!(
            self.visits.iter().any(|visit| !visit.is_empty()),
            "a peer came in time"
        );
        for visit in &self.visits {
            let visit = part(visit);
            let Some(first) = visit.first() else { continue };
            let from = place[*first];
            let to = (from + visit.len()).min(public.len());
            assert_same("a visitor", &public[from..to], &visit);
        }
    }
}

/// What needed the token, which each receiver gets before what waits for it, or all else.
fn part<'a>(
    way_of: &HashMap<&str, Way>,
    guarded: bool,
    said: impl IntoIterator<Item = &'a Said>,
) -> Vec<&'a Said> {
    let is_part = |(sender, _): &&Said| (way_of[sender.as_str()] == Way::Guarded) == guarded;
    said.into_iter().filter(is_part).collect()
}

/// Says where two sequences part.
fn assert_same(who: &str, expected: &[&Said], heard: &[&Said]) {
    let differs = expected.iter().zip(heard).position(|(one, other)| one != other);
    if let Some(at) = differs {
        let around = at.saturating_sub(3)..(at + 4).min(expected.len()).min(heard.len());
        panic!(
            "{who} hears another order from {at} on: {:?} instead of {:?}",
            &heard[around.clone()],
            &expected[around]
        );
    }
    assert_eq!(heard.len(), expected.len(), "{who} hears all of it");
}

/// Senders and receivers of all codecs; no message goes in a run, as some receivers need each by itself.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_order_across_codecs() {
    check(Cast {
        senders: vec![
            (BINARY, Way::Plain, false),
            (XML, Way::Plain, false),
            (Over::Local, Way::Plain, false),
            (BINARY, Way::Mute, true),
            (XML, Way::Receipts, false),
            (Over::Local, Way::Receipts, false),
            (BINARY, Way::Guarded, false),
            (XML, Way::Listed, true),
        ],
        listeners: vec![
            (BINARY, false),
            (XML, false),
            (Over::Local, false),
            (BINARY, true),
            (XML, true),
        ],
        comers: vec![BINARY, XML, Over::Local],
    })
    .await;
}

/// Where all speak binary plain messages pass in runs, until a peer comes that does not, and again when that one has
/// left; beside them go messages that pass one by one.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_order_of_runs_and_single_messages() {
    check(Cast {
        senders: vec![
            (BINARY, Way::Plain, false),
            (BINARY, Way::Plain, false),
            (BINARY, Way::Plain, true),
            (BINARY, Way::Mute, false),
            (BINARY, Way::Receipts, false),
            (BINARY, Way::Receipts, false),
            (BINARY, Way::Guarded, false),
            (BINARY, Way::Listed, false),
        ],
        listeners: vec![(BINARY, false), (BINARY, false), (BINARY, true)],
        comers: vec![BINARY, XML, Over::Local],
    })
    .await;
}
