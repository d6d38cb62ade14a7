//! What permitted peers do, each attack a few times: nothing of the canary's is lost, attackers hear what PROTOCOL.md says,
//! and the hub serves newcomers as before.

use std::net::SocketAddr;

use mom_broker::{Broker, Clock, Config};
use mom_tests::attacks::{Attack, Attackers, configuration};
use mom_tests::canary::Canary;

async fn start() -> Broker {
    let config = Config::load(&configuration()).expect("a right configuration");
    Broker::start_at(config, Clock::system())
        .await
        .expect("it starts")
}

/// Rounds of an attack beside the canary.
async fn attack(attack: Attack, rounds: u64) -> Attackers {
    let broker = start().await;
    let address: SocketAddr = broker.local_addr();
    let mut canary = Canary::start(address).await;
    let mut attackers = Attackers::connect(attack, address).await;
    for _ in 0..rounds {
        attackers.round().await;
        canary.check().await;
    }
    assert!(canary.stop().await > 0);
    for word in attack.hears() {
        assert!(attackers.times(word) > 0, "{word}: {:?}", attackers.heard());
    }
    let others = attackers.heard().keys();
    // Who is put off when it joins is not a member that could leave.
    let others: Vec<_> = others
        .filter(|word| !["try-later", "not-member"].contains(&word.as_str()))
        .filter(|word| !attack.hears().contains(&word.as_str()))
        .collect();
    assert!(others.is_empty(), "{:?}", attackers.heard());
    broker.check();
    broker.stop().await;
    attackers
}

macro_rules! attacks {
    ($(fn $name:ident: $attack:ident, $rounds:literal;)*) => {
        $(#[tokio::test]
        async fn $name() {
            attack(Attack::$attack, $rounds).await;
        })*

        /// Nobody forgets one here.
        #[test]
        fn each_is_tried() {
            let mut tried = [$(Attack::$attack.word()),*];
            let mut all = Attack::ALL.map(Attack::word);
            tried.sort_unstable();
            all.sort_unstable();
            assert_eq!(tried, all);
        }
    };
}

attacks! {
    fn large_delete: LargeDelete, 1;
    fn nils: Nils, 2;
    fn rejoin: Rejoin, 2;
    fn large_slots: LargeSlots, 3;
    fn large_request: LargeRequest, 3;
    fn large_xml: LargeXml, 2;
    fn large_list: LargeList, 1;
    fn crowd: Crowd, 2;
    fn leavers: Leavers, 3;
    fn lidar: Lidar, 3;
    fn sleepers: Sleepers, 8;
    fn chunks: Chunks, 8;
    fn nothing: Nothing, 2;
    fn signs_of_life: SignsOfLife, 3;
    fn later_xml: LaterXml, 4;
    fn urgent: Urgent, 4;
    fn slow_device: SlowDevice, 4;
    fn heads: Heads, 2;
    fn reset: Reset, 1;
}
