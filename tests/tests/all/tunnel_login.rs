//! A tunnel whose answer to the login is lost: its new id is given again, and to nobody else; once it has ended, to nobody.

use mom_broker::Broker;
use mom_proto::{Family, Map, Parcel};
use mom_tests::lab;
use mom_tests::programs::PATIENCE;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::tunnel::{ByHand, ask, chat, hear, request, send};

/// The answer to a login has the new id. Where it is lost, it is given again to who brings the same bytes, with the
/// same proof, and to nobody else: other bytes, or the use of the new id, end that.
#[tokio::test]
async fn the_lost_answer_to_a_login_is_given_again_to_who_has_logged_in() {
    let broker = lab::start().await;
    for guessed in [false, true] {
        let mut tunnel = ByHand::open(&broker).await;
        let content = Map::new().with("name", "alice").with("password", "alice");
        let login = tunnel.encode(Parcel::new(Family::Login, "login").content(content));
        let lost = tunnel.post(0, &login).await;
        let id = lost.field("mom-tunnel").expect("a new id").to_owned();
        // A client that waits for bytes hears nothing by the old id.
        assert_eq!(tunnel.get(0).await.status, 404);
        if guessed {
            let mut guess = login.clone();
            let last = guess.len() - 4;
            guess[last] = b'x';
            assert_eq!(tunnel.post(0, &guess).await.status, 404);
            assert_eq!(tunnel.post(0, &login).await.status, 404, "one guess ends it");
            continue;
        }
        for _ in 0..2 {
            let again = tunnel.post(0, &login).await;
            assert_eq!(
                (again.status, again.field("mom-tunnel"), again.number("mom-taken")),
                (200, Some(id.as_str()), Some(login.len())),
                "{again:?}"
            );
        }
        let before = std::mem::replace(&mut tunnel.id, id);
        tunnel.up = login.len();
        tunnel
            .say(Parcel::new(Family::Context, "join").context(chat()))
            .await;
        tunnel.until("\"reference\":2").await;
        tunnel.id = before;
        assert_eq!(tunnel.post(0, &login).await.status, 404, "the new id is known");
    }
    broker.stop().await;
}

/// A request whose last byte comes when its tunnel has ended brings nothing back.
#[tokio::test]
async fn threat_17_a_tunnel_that_has_ended_does_not_come_back() {
    let broker = lab::start().await;
    // Where the hub is quicker than the cut, the old id is that of a login whose answer is given again.
    let attempts = async {
        loop {
            if let Some(attempt) = ended_amid_its_login(&broker).await {
                return attempt;
            }
        }
    };
    let (tunnel, mut late, last) = timeout(PATIENCE, attempts).await.expect("a cut in time");
    let gone = async {
        loop {
            let asked = request("GET", &tunnel.path("at=0&wait=1"), "", b"");
            if ask(tunnel.address, &asked).await.status == 404 {
                return;
            }
        }
    };
    timeout(PATIENCE, gone).await.expect("it ends");
    late.write_all(&last).await.expect("the hub reads it");
    let answer = hear(late).await;
    assert_eq!(
        (answer.status, answer.field("mom-tunnel")),
        (410, None),
        "{answer:?}"
    );
    broker.stop().await;
}

/// A tunnel whose peer logs in and out by a request that is cut before it is answered, the same request without its last byte,
/// and that byte; none if it was answered.
async fn ended_amid_its_login(broker: &Broker) -> Option<(ByHand, TcpStream, Vec<u8>)> {
    let mut tunnel = ByHand::open(broker).await;
    let content = Map::new().with("name", "alice").with("password", "alice");
    let login = tunnel.encode(Parcel::new(Family::Login, "login").content(content));
    let logout = tunnel.encode(Parcel::new(Family::Login, "logout"));
    let both = [login, logout].concat();
    let whole = request("POST", &tunnel.path("at=0"), "", &both);
    let (begin, last) = whole.split_at(whole.len() - 1);
    let late = send(tunnel.address, begin).await;
    let mut cut = send(tunnel.address, &whole).await;
    let taken = async {
        // Bytes that do not follow are not taken, and the answer says how many are here.
        while tunnel.post(1 << 20, b"x").await.number("mom-taken") != Some(both.len()) {}
    };
    timeout(PATIENCE, taken).await.expect("they come");
    let mut answer = Vec::new();
    cut.shutdown().await.expect("the end of a request");
    let _ = timeout(PATIENCE, cut.read_to_end(&mut answer))
        .await
        .expect("the hub ends it");
    answer.is_empty().then(|| (tunnel, late, last.to_vec()))
}
