//! How peers of the load prove who they are, and come back.

use hmac::{Hmac, Mac};
use mom_proto::{Compression, Family, Map, Parcel, ReadCount, Value, link_challenge};
use sha2::Sha256;

use super::Mind;
use super::chance::{Link, one_in, remember};
use super::peer::Peer;
use crate::raw::told;

/// Who they are.
const USERS: [&str; 2] = ["bob", "carol"];

/// Whose passwords are tried in vain: not those who have to log in.
const OTHERS: [&str; 4] = ["model", "servo", "calibrate", "nobody"];

impl Mind {
    /// What a login says that may be right.
    fn right_login(&mut self) -> Map {
        let user = USERS[self.rng.usize(..USERS.len())];
        let mut content = match one_in(&mut self.rng, 4) {
            true => Map::new().with("guest", true),
            false => Map::new().with("name", user).with("password", user),
        };
        // A tunnel has no end but silence: it must not be long, or nobody could see that all have gone.
        content.set("heartbeat", self.rng.i64(500..1500));
        match self.rng.u8(..6) {
            0 => content.set("link", true),
            1..3 => content.set("link", Map::new().with("grace", self.rng.i64(0..3000))),
            _ => {}
        }
        if one_in(&mut self.rng, 4) {
            content.set("nickname", format!("peer-{}", self.rng.u8(..6)));
        }
        content
    }

    fn wrong_login(&mut self) -> Map {
        let other = OTHERS[self.rng.usize(..OTHERS.len())];
        let name = Map::new().with("name", other);
        match self.rng.u8(..7) {
            0 => name.with("key", true),
            1 => name.with("certificate", true),
            2 => Map::new().with("token", "eyJhbGciOiJub25lIn0.e30."),
            3 => Map::new().with("guest", true).with("password", "x"),
            4 => name.with("password", self.text(9000)),
            5 => Map::new()
                .with("name", format!("who-{}", self.rng.u16(..)))
                .with("password", "x"),
            _ => name.with("password", "wrong"),
        }
    }

    /// A login on a connection that may have logged in.
    pub(super) fn login_again(&mut self) -> Map {
        match self.rng.u8(..3) {
            0 => self.wrong_login(),
            _ => self.right_login(),
        }
    }
}

impl Peer {
    /// Becomes one of the hub's peers, or does not.
    pub(super) async fn log_in(&mut self, mind: &mut Mind, back: bool) -> bool {
        let may = !mind.known.links.is_empty();
        if may && (back || one_in(&mut mind.rng, 4)) && self.come_back(mind).await {
            return true;
        }
        if one_in(&mut mind.rng, 10) {
            let content = mind.wrong_login();
            if self.ask(mind, "login", content).await.is_none() {
                return false;
            }
        }
        let mut content = mind.right_login();
        if self.is_packed() {
            content.set("compress", vec![Value::from(Compression::Zstd.word())]);
        }
        let reply = self.ask(mind, "login", content).await;
        let Some(welcome) = reply
            .filter(|reply| reply.family == Family::Reply)
            .map(|reply| reply.value())
        else {
            return false;
        };
        self.decoder().set_limits(&told(&welcome));
        let text = welcome.get("link").and_then(|link| link.get("id")?.as_str());
        let secret = welcome
            .get("link")
            .and_then(|link| link.get("secret")?.as_binary());
        if let (Some(id), Some(secret)) = (text, secret) {
            let (id, secret) = (id.to_owned(), secret.to_vec());
            self.link = Some(Link {
                id,
                secret,
                read: ReadCount::new(),
            });
        }
        true
    }

    /// Goes on with a link: by the right proof, a wrong one, one for an older challenge, or none.
    async fn come_back(&mut self, mind: &mut Mind) -> bool {
        mind.done("resume");
        // The newest may be there still.
        let last = mind.known.links.len() - 1;
        let at = if one_in(&mut mind.rng, 4) {
            mind.rng.usize(..=last)
        } else {
            last
        };
        let mut link = mind.known.links[at].clone();
        let wanted = Map::new().with("link", link.id.as_str());
        let older = mind.known.nonces.back().cloned();
        let Some(challenge) = self.ask(mind, "resume", wanted).await else {
            return false;
        };
        let challenge = challenge.value();
        let nonce = challenge.get("nonce").and_then(Value::as_binary);
        let mut nonce = nonce.map(|nonce| nonce.to_vec()).unwrap_or_default();
        match mind.rng.u8(..12) {
            0 => nonce = older.unwrap_or_default(),
            1 => link.secret = vec![0; 32],
            2 => link.read.parcels += mind.rng.u64(1..1000),
            3 => link.read.parcels = mind.rng.u64(0..=link.read.parcels),
            4 => link.read.checksum = mind.rng.bool().then(|| mind.rng.u32(..)),
            _ => {}
        }
        let hub = challenge.get("hub").and_then(Value::as_str).unwrap_or("mom");
        let mut mac = Hmac::<Sha256>::new_from_slice(&link.secret).expect("any key will do");
        mac.update(&link_challenge(hub, &link.id, &nonce));
        let proof = Value::Binary(mac.finalize().into_bytes().to_vec().into());
        let answer = link.read.put(Map::new().with("proof", proof));
        let Some(reply) = self.ask(mind, "answer", answer).await else {
            return false;
        };
        if reply.family != Family::Reply {
            return false;
        }

        self.decoder().set_limits(&told(&reply.value()));
        (self.link, self.is_back) = (Some(link), true);
        // Some never say that what follows is new.
        if mind.rng.bool() {
            let resent = Parcel::new(Family::Time, "resent");
            return self.send_parcel(&resent).await.is_ok();
        }
        true
    }

    /// Its link is for others now, if it had one.
    pub(super) fn give_up(&mut self, mind: &mut Mind) {
        if let Some(link) = self.link.take() {
            remember(&mut mind.known.links, link);
        }
    }
}
