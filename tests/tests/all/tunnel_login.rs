//! A tunnel whose answer to the login is lost: its new id is given again, and to nobody else.

use mom_proto::{Family, Map, Parcel};
use mom_tests::lab;

use crate::tunnel::{ByHand, chat};

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
