//! What is opened of a parcel is small, whatever it is called and in whatever form it comes.

use std::fs;

use bytes::Bytes;
use mom_proto::codec::Form;
use mom_proto::{Code, Content, Family, Map, Parcel, Value, Verb, WireError};
use mom_tests::attacks::configuration;
use mom_tests::canary::Canary;
use mom_tests::programs::Running;
use mom_tests::raw::{Raw, at};
use tokio::task::spawn_blocking;

/// A little less than a parcel may have.
const LARGE: usize = 8 * 1024 * 1024 - 4096;
/// Of all else: reading text takes long in a debug build.
const TEXT: usize = 256 * 1024;
const MIB: usize = 1 << 20;

/// MessagePack: nils of so many bytes, the worst of all, and less of lists in lists, maps of short keys, and text.
fn encoded(nils: usize, size: usize) -> [Content; 4] {
    let list = |items: usize, item: &[u8]| {
        let count = u32::try_from(items).expect("few enough").to_be_bytes();
        [&[0xdd][..], &count, &item.repeat(items)].concat()
    };
    let keys = u32::try_from(size / 4).expect("few enough").to_be_bytes();
    let mut map = [&[0xdf][..], &keys].concat();
    for key in 0..size / 4 {
        // The same ones again: that is found when it is opened.
        let key = (key % 10_000).to_be_bytes();
        map.extend_from_slice(&[0xa2, key[6], key[7], 0xc0]);
    }
    let text = u32::try_from(size).expect("few enough").to_be_bytes();
    let text = [&[0xdb][..], &text, &b"x".repeat(size)].concat();
    [
        list(nils, &[0xc0]),
        list(size / 25, &[&[0x91; 24][..], &[0xc0]].concat()),
        map,
        text,
    ]
    .map(|bytes| Content::Encoded(Bytes::from(bytes)))
}

/// The same as values, for the forms that are text.
fn values(size: usize) -> [Content; 3] {
    let nils = Value::List(vec![Value::Null; size / 2]);
    let keys = (0..size / 16).fold(Map::new(), |map, key| map.with(&format!("k{key}"), Value::Null));
    [nils, keys.into(), "x".repeat(size).into()].map(Content::Value)
}

/// The most memory that a program ever had, in bytes.
fn most_memory(id: u32) -> usize {
    let status = fs::read_to_string(format!("/proc/{id}/status")).expect("it runs");
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kib = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<usize>().ok());
    kib.expect("Linux says so") * 1024
}

/// Everything that can be asked for, and what cannot.
fn requests() -> Vec<(Family, &'static str)> {
    let asked = Verb::ALL.into_iter().filter(|verb| *verb != Verb::Send);
    let messages = [Verb::Stop, Verb::Unstop].map(|verb| (Family::Context, verb.word()));
    asked
        .filter(|verb| verb.family() != Family::Message)
        .map(|verb| (verb.family(), verb.word()))
        .chain(messages)
        .chain([
            (Family::Token, "info"),
            (Family::Time, "nonsense"),
            (Family::Login, "nonsense"),
        ])
        .chain([
            (Family::Reply, "joined"),
            (Family::Event, "stopped"),
            (Family::Error, "denied"),
        ])
        .collect()
}

async fn refused(raw: &mut Raw, family: Family, name: &str, content: Content) -> WireError {
    let mut parcel = Parcel::new(family, name).context(at("/chat"));
    parcel.content = Some(content);
    let form = raw.form();
    let answer = raw.ask(parcel).await;
    answer.expect_err(&format!("{family} {name} in {form:?}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn of_no_parcel_more_is_opened_than_its_verb_needs() {
    let started = spawn_blocking(|| Running::broker(&configuration())).await;
    let (broker, address) = started.expect("it starts");
    let address = address.parse().expect("an address");
    let mut canary = Canary::start(address).await;
    let mut raw = Raw::login(address, Form::Binary, "bob").await;
    raw.join(&["/chat"]).await;
    let begin = most_memory(broker.id());
    for (family, name) in requests() {
        for content in encoded(LARGE, TEXT) {
            let error = refused(&mut raw, family, name, content).await;
            assert_eq!(error.code, Code::TOO_LONG, "{family} {name}: {error}");
        }
        canary.check().await;
    }
    // What of it is here at a time: the frame itself, and what the network has of the next one.
    let most = most_memory(broker.id());
    assert!(most < begin + 64 * MIB, "{} MiB of {}", most / MIB, begin / MIB);
    for form in [Form::Json, Form::Xml] {
        let mut raw = Raw::login(address, form, "bob").await;
        for (family, name) in requests() {
            for content in values(TEXT) {
                let error = refused(&mut raw, family, name, content).await;
                assert_eq!(error.code, Code::TOO_LONG, "{family} {name} in {form:?}: {error}");
            }
        }
        canary.check().await;
    }
    let most = most_memory(broker.id());
    assert!(most < begin + 64 * MIB, "{} MiB of {}", most / MIB, begin / MIB);
    assert!(canary.stop().await > 0);
    drop(broker);
}
