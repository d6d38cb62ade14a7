//! Which doors a secret goes through: those that nobody can listen at.

use std::net::SocketAddr;
use std::time::Duration;

use mom_client::{Builder, Client, Code, ErrorKind, Family, Key, Parcel, Proof, Trust};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;

use crate::common::{Hub, logged_in, path};

const PATIENCE: Duration = Duration::from_secs(60);
const SECRET: &str = "open sesame";

/// No address of this machine, as far as anybody can tell, although the system takes who connects there to its loopback: so what
/// is sent there can be seen here.
fn elsewhere(scheme: &str, listener: &TcpListener) -> String {
    let port = listener.local_addr().expect("it is bound").port();
    format!("{scheme}://0.0.0.0:{port}")
}

fn builder(address: &str, proof: Proof) -> Builder {
    let builder = Client::builder(address).user("alice").proof(proof);
    builder.request_timeout(PATIENCE).no_reconnect()
}

fn secrets() -> [Proof; 2] {
    [
        Proof::Password(SECRET.to_owned()),
        Proof::Token(SECRET.to_owned()),
    ]
}

async fn listen() -> TcpListener {
    TcpListener::bind("127.0.0.1:0").await.expect("a free port")
}

/// Whether nobody has come before this: who comes first is taken first.
async fn nobody_came(listener: &TcpListener) {
    let address: SocketAddr = listener.local_addr().expect("it is bound");
    let marker = TcpStream::connect(address).await.expect("it listens");
    let (_, first) = listener.accept().await.expect("a client connects");
    assert_eq!(
        Some(first),
        marker.local_addr().ok(),
        "another client came before"
    );
}

/// Over a door that others can listen at no secret is sent: the client says what to write instead, and does not even connect.
#[tokio::test]
async fn no_secret_goes_over_a_plain_door() {
    let listener = listen().await;
    for (plain, safe) in [
        ("tcp", "tcps"),
        ("bin", "bins"),
        ("json", "jsons"),
        ("ws", "wss"),
        ("http", "https"),
    ] {
        let address = elsewhere(plain, &listener);
        for proof in secrets() {
            for waits in [false, true] {
                let builder = builder(&address, proof.clone());
                let builder = if waits { builder.wait_for_hub() } else { builder };
                let refused = timeout(PATIENCE, builder.connect()).await.expect("at once");
                let error = refused.expect_err("others could read it");
                assert_eq!(
                    (error.kind(), error.code()),
                    (ErrorKind::Local, Some(&Code::INSECURE))
                );
                let said = error.to_string();
                assert!(said.contains(&elsewhere(safe, &listener)), "{said}");
                assert!(!said.contains(SECRET), "{said}");
            }
        }
    }
    nobody_came(&listener).await;
}

/// Where an address leaves the door open, a secret tries those with TLS only.
#[tokio::test]
async fn a_secret_tries_no_plain_door_of_several() {
    let listener = listen().await;
    let address = elsewhere("mom", &listener);
    let trust = Trust::Pinned("00".repeat(32).parse().expect("a fingerprint"));
    let client = builder(&address, Proof::Password(SECRET.to_owned()));
    let client = tokio::spawn(client.trust(trust).connect());
    for door in ["bins", "wss", "https"] {
        let (mut stream, _) = timeout(PATIENCE, listener.accept())
            .await
            .expect("in time")
            .expect("it comes");
        assert_eq!(stream.read_u8().await.ok(), Some(0x16), "{door}");
    }
    let connected = client.await.expect("no panic");
    assert_eq!(connected.expect_err("no hub").kind(), ErrorKind::Connection);
    nobody_came(&listener).await;
}

/// What a hub without TLS, or something in its place, gets of a client that wants TLS: the beginning of a handshake, and no second
/// try without.
#[tokio::test]
async fn no_secret_falls_back_to_a_plain_door() {
    let listener = listen().await;
    for scheme in ["tcps", "bins", "jsons", "wss", "https"] {
        let address = elsewhere(scheme, &listener);
        for proof in secrets() {
            let trust = Trust::Pinned("00".repeat(32).parse().expect("a fingerprint"));
            let client = builder(&address, proof).trust(trust).connect();
            let hub = async {
                let (mut stream, _) = listener.accept().await.expect("it comes");
                let mut heard = vec![0; 64 * 1024];
                let length = stream.read(&mut heard).await.expect("it speaks first");
                heard.truncate(length);
                stream.write_all(b"no TLS here\r\n").await.expect("it listens");
                stream.shutdown().await.expect("it listens");
                // It may cut the connection.
                let _ = stream.read_to_end(&mut heard).await;
                heard
            };
            let (connected, heard) = timeout(PATIENCE, async { tokio::join!(client, hub) })
                .await
                .expect("at once");
            assert_eq!(connected.expect_err("no hub").kind(), ErrorKind::Connection);
            assert_eq!(heard.first(), Some(&0x16), "{scheme}");
            assert!(
                !heard
                    .windows(SECRET.len())
                    .any(|bytes| bytes == SECRET.as_bytes())
            );
        }
    }
    nobody_came(&listener).await;
}

/// Who shows no secret goes through any door that the address names; a secret does not come after, either.
#[tokio::test]
async fn keys_and_guests_go_over_plain_doors() {
    let key = Key::generate().expect("randomness");
    for scheme in ["tcp", "bin", "json"] {
        for proof in [Proof::Key(key.clone()), Proof::Guest] {
            let listener = listen().await;
            let address = elsewhere(scheme, &listener);
            let mut hub = Hub::Tcp(listener);
            let (client, mut peer) = logged_in(&mut hub, builder(&address, proof)).await;
            for proof in secrets() {
                let refused = client
                    .authenticate_again(proof)
                    .await
                    .expect_err("others could read it");
                assert_eq!(refused.code(), Some(&Code::INSECURE));
            }
            let after = Parcel::new(Family::Message, "after").context(path("/chat"));
            client.send(after).await.expect("it goes");
            peer.expect("message after /chat").await;
        }
    }
}
