//! A raw peer with a link: it counts what it reads, and comes back over another connection.

use std::net::SocketAddr;

use hmac::{Hmac, Mac};
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, ReadCount, Value, WireError, link_challenge};
use sha2::Sha256;

use crate::raw::{Raw, at};

/// What a peer needs to come back.
#[derive(Clone, Debug)]
pub struct Link {
    /// Its id.
    pub id: String,
    /// What only it and the hub know.
    pub secret: Vec<u8>,
    /// The parcels of the hub that it has read.
    pub read: ReadCount,
}

/// A raw connection whose peer may come back.
#[derive(Debug)]
pub struct Linked {
    /// The connection.
    pub raw: Raw,
    /// What it needs to come back.
    pub link: Link,
}

impl Linked {
    /// Logs in as a user of the lab, who may be away for so many ms.
    ///
    /// # Panics
    /// If that is refused, or no link is given.
    pub async fn login(address: SocketAddr, form: Form, user: &str, grace: i64) -> Linked {
        let content = Map::new().with("name", user).with("password", user);
        Linked::log_in(address, form, content, grace).await
    }

    /// Logs in with this proof.
    ///
    /// # Panics
    /// If that is refused, or no link is given.
    pub async fn log_in(address: SocketAddr, form: Form, proof: Map, grace: i64) -> Linked {
        let mut raw = Raw::connect(address, form).await;
        let content = proof.with("link", Map::new().with("grace", grace));
        let login = Parcel::new(Family::Login, "login").content(content);
        let welcome = raw.ask(login).await.expect("a user of the lab").value();
        let link = welcome.get("link").expect("a link");
        let text = |key| link.get(key).and_then(Value::as_str).map(str::to_owned);
        let secret = link.get("secret").and_then(Value::as_binary);
        let link = Link {
            id: text("id").expect("an id"),
            secret: secret.expect("a secret").to_vec(),
            read: ReadCount::new(),
        };
        Linked { raw, link }
    }

    /// The next parcel, counted.
    pub async fn next(&mut self) -> Option<Parcel> {
        let parcel = self.raw.next().await?;
        if parcel.family != Family::Time {
            self.link.read.count(Some(parcel.checksum_word()));
        }
        Some(parcel)
    }

    /// The next parcel of this class, and all before it are counted.
    ///
    /// # Panics
    /// If the connection ends before.
    pub async fn next_of(&mut self, family: Family, name: &str) -> Parcel {
        loop {
            let parcel = self.next().await;
            let parcel = parcel.unwrap_or_else(|| panic!("closed before {family} {name} came"));
            if parcel.is(family, name) {
                return parcel;
            }
        }
    }

    /// Asks, and waits for the answer; what comes before it is counted.
    ///
    /// # Errors
    /// What the broker answered.
    ///
    /// # Panics
    /// If the connection ends before.
    pub async fn ask(&mut self, parcel: Parcel) -> Result<Parcel, WireError> {
        let id = self.raw.post(parcel).await;
        loop {
            let parcel = self.next().await.expect("closed before the answer came");
            if parcel.reference == Some(id) {
                return match parcel.family {
                    Family::Error => Err(WireError::from_parcel(&parcel)),
                    _ => Ok(parcel),
                };
            }
        }
    }

    /// Tells the hub how much was read.
    pub async fn acknowledge(&mut self) {
        let ack = Parcel::new(Family::Time, "ack").content(self.link.read.put(Map::new()));
        self.raw.send_parcel(&ack).await;
    }

    /// Asks for something about a context.
    ///
    /// # Panics
    /// If that is refused.
    pub async fn about(&mut self, family: Family, name: &str, path: &str) -> Value {
        let parcel = Parcel::new(family, name).context(at(path));
        let reply = self.ask(parcel).await;
        reply
            .unwrap_or_else(|error| panic!("{name} {path}: {error}"))
            .value()
    }
}

impl Link {
    /// Goes on over a new connection, which is given back if that is refused.
    ///
    /// # Errors
    /// What the broker answered, and the connection.
    pub async fn resume(&self, address: SocketAddr, form: Form) -> Result<(Linked, Value), (WireError, Raw)> {
        let mut raw = Raw::connect(address, form).await;
        match self.prove(&mut raw).await {
            Ok(reply) => {
                let link = self.clone();
                Ok((Linked { raw, link }, reply))
            }
            Err(error) => Err((error, raw)),
        }
    }

    /// Proves the secret on a connection, to go on there.
    ///
    /// # Errors
    /// What the broker answered.
    ///
    /// # Panics
    /// If it asks for no proof.
    pub async fn prove(&self, raw: &mut Raw) -> Result<Value, WireError> {
        let challenge = self.challenge(raw).await?;
        self.answer(raw, &challenge).await
    }

    /// Asks on a connection for what is to be proven.
    ///
    /// # Errors
    /// What the broker answered.
    pub async fn challenge(&self, raw: &mut Raw) -> Result<Value, WireError> {
        let wanted = Map::new().with("link", self.id.as_str());
        let resume = Parcel::new(Family::Login, "resume").content(wanted);
        Ok(raw.ask(resume).await?.value())
    }

    /// Proves the secret in answer to a challenge.
    ///
    /// # Errors
    /// What the broker answered.
    ///
    /// # Panics
    /// If that is not a challenge, or the connection ends.
    pub async fn answer(&self, raw: &mut Raw, challenge: &Value) -> Result<Value, WireError> {
        let hub = challenge.get("hub").and_then(Value::as_str).expect("a name");
        let nonce = challenge
            .get("nonce")
            .and_then(Value::as_binary)
            .expect("a nonce");
        let mut mac = Hmac::<Sha256>::new_from_slice(&self.secret).expect("any key will do");
        mac.update(&link_challenge(hub, &self.id, nonce));
        let proof = Value::Binary(mac.finalize().into_bytes().to_vec().into());
        let content = self.read.put(Map::new().with("proof", proof));
        let id = raw
            .post(Parcel::new(Family::Login, "answer").content(content))
            .await;
        loop {
            let parcel = raw.next().await.expect("closed without a word");
            match parcel.family {
                // One that closes refers to nothing.
                Family::Error => return Err(WireError::from_parcel(&parcel)),
                Family::Reply if parcel.reference == Some(id) => return Ok(parcel.value()),
                _ => {}
            }
        }
    }
}
