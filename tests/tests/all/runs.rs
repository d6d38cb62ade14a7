//! Plain messages that arrive together and pass together: what holds for one holds for each of them.

use mom_broker::Broker;
use mom_proto::codec::Form;
use mom_proto::{ContextNumber, Family, Map, Parcel, Path, Value};
use mom_tests::lab;
use mom_tests::raw::{Raw, at, message};

const PLACE: &str = "/booth";

/// A channel in which each peer may say five things at once, by a clock that stands; carol made it, bob listens.
async fn booth() -> (Broker, Raw, Raw) {
    let broker = lab::start_at(lab::clock(), |_| {}).await;
    let mut carol = Raw::login(broker.local_addr(), Form::Binary, "carol").await;
    let mut bob = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    let limit = Map::new().with("parcels", 1).with("burst", 5);
    let quota = Map::new().with("kind", "quota").with(
        "limits",
        vec![Value::Map(limit.with("verbs", vec!["send".into()]))],
    );
    let open = Map::new()
        .with("kind", "chain")
        .with("of", vec![Value::Map(quota)]);
    let spec = Map::new().with("kind", "channel").with("manager", open);
    let create = Parcel::new(Family::Context, "create")
        .context(at(PLACE))
        .content(spec);
    carol.ask(create).await.expect("operators may");
    bob.join(&[PLACE]).await;
    (broker, carol, bob)
}

/// So many messages as one write; the channel by its number, as peers of the binary form do.
fn burst(number: u64, names: &[&str]) -> Vec<u8> {
    let frame = |(id, name): (usize, &&str)| {
        let mut parcel = message(name, PLACE, "words").id(1000 + id as u64);
        (parcel.context, parcel.number) = (None::<Path>, Some(ContextNumber(number)));
        parcel.echo = Some(false);
        Form::Binary.encode(&parcel).expect("a frame").to_vec()
    };
    names.iter().enumerate().flat_map(frame).collect()
}

#[tokio::test]
async fn a_burst_counts_as_its_messages() {
    let (broker, mut carol, mut bob) = booth().await;
    let join = Parcel::new(Family::Context, "join").context(at(PLACE));
    let joined = carol.ask(join).await.expect("its maker may").value();
    let number = joined.get("number").and_then(Value::as_int).expect("a number");
    let names = ["state", "state", "state", "chat", "chat", "chat", "state", "chat"];
    carol.send(&burst(number.unsigned_abs(), &names)).await;
    for id in 1000..1005 {
        let parcel = bob.next_of(Family::Message, names[id as usize - 1000]).await;
        assert_eq!(
            (parcel.id, parcel.sender.as_deref()),
            (Some(id), Some("carol")),
            "in their order, stamped"
        );
    }
    for id in 1005..1008 {
        let error = carol.answer(id).await.expect_err("the burst is used up");
        assert_eq!(error.code.word(), "over-quota", "{id}");
    }
    bob.check_alive().await;
    broker.stop().await;
}
