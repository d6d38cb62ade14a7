//! TLS below the forms: who is trusted, who is let in, and what does not get through.

use std::path::Path;

use mom_broker::{Broker, Config};
use mom_client::{Client, ClientError, Code, Identity, Trust};
use mom_net::{Address, ClientTls, NetError};
use mom_proto::codec::Frame;
use mom_proto::{Fingerprint, Limits, Parcel};
use mom_tests::programs::{self, PATIENCE};
use mom_tests::{lab, tls};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

async fn broker(change: impl FnOnce(&mut Config)) -> Broker {
    lab::start_with(|config| {
        config.tls = tls::of_hub();
        change(config);
    })
    .await
}

fn pinned(broker: &Broker) -> Trust {
    Trust::Pinned(broker.fingerprint().expect("it has a certificate"))
}

async fn alice(broker: &Broker, trust: Trust) -> Result<Client, ClientError> {
    let client = Client::builder(format!("bins://{}", broker.local_addr()));
    let client = client.trust(trust).user("alice").password("alice");
    client.no_reconnect().connect().await
}

#[tokio::test]
async fn a_hub_is_known_by_its_fingerprint_or_by_who_signed_it() {
    let broker = broker(|_| {}).await;
    let signed = tls::of_hub().certificate.expect("a file");
    for trust in [pinned(&broker), Trust::Authorities(signed)] {
        let client = alice(&broker, trust).await.expect("the right hub");
        client.close().await;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let other = tls::make(folder.path(), "other").certificate;
    let another = "00".repeat(32).parse().expect("a fingerprint");
    for trust in [Trust::System, Trust::Authorities(other), Trust::Pinned(another)] {
        let shown = format!("{trust:?}");
        let error = alice(&broker, trust).await.expect_err("not to be trusted");
        // Not even the connection is tried where the system trusts nobody.
        assert!(
            matches!(error, ClientError::Connection(_) | ClientError::Local(_)),
            "{shown}: {error:?}"
        );
        assert!(error.to_string().contains("certificate"), "{shown}: {error}");
    }
    broker.stop().await;
}

/// What a person reads about it, and that the address of the lab is enough.
#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_says_whom_it_does_not_trust() {
    let broker = broker(|_| {}).await;
    let (address, pin) = (broker.local_addr(), broker.fingerprint().expect("it has one"));
    let folder = tempfile::tempdir().expect("a folder");
    let stranger = tls::make(folder.path(), "other").certificate;
    let tree = |hub: String, trusted: &Path| {
        let trusted = trusted.to_str().expect("text").to_owned();
        let run = move || {
            let alice = [
                ("MOM_USER", "alice"),
                ("MOM_PASSWORD", "alice"),
                ("SSL_CERT_FILE", &*trusted),
            ];
            programs::run("mom", &["--hub", &hub, "tree"], &alice)
        };
        async { spawn_blocking(run).await.expect("it runs") }
    };
    let unknown = tree(format!("bins://{address}"), &stranger).await;
    let other = tree(format!("tcps://{address}?pin={}", "0".repeat(64)), &stranger).await;
    for (refused, why) in [(unknown, "invalid peer certificate"), (other, &*pin.to_string())] {
        let said = programs::text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{said}");
        for part in ["do not trust the hub", why, "?pin=FINGERPRINT"] {
            assert!(said.contains(part), "{part:?} in {said}");
        }
    }
    let signed = tls::of_hub().certificate.expect("a file");
    for (hub, trusted) in [
        (format!("bins://{address}?pin={pin}"), &stranger),
        (format!("bins://{address}"), &signed),
    ] {
        let shown = tree(hub, trusted).await;
        assert_eq!(shown.status.code(), Some(0), "{}", programs::text(&shown.stderr));
    }
    broker.stop().await;
}

/// A hub without a certificate says so; it does not fall back to plain words.
#[tokio::test]
async fn a_hub_without_a_certificate_speaks_no_tls() {
    let broker = lab::start().await;
    assert_eq!(broker.fingerprint(), None);
    let any = Trust::Pinned("00".repeat(32).parse().expect("a fingerprint"));
    let error = alice(&broker, any).await.expect_err("no TLS");
    assert!(matches!(error, ClientError::Connection(_)), "{error:?}");
    let mut stream = TcpStream::connect(broker.local_addr()).await.expect("it listens");
    stream.write_all(&[0x16, 3, 1]).await.expect("it reads");
    let mut said = String::new();
    let heard = timeout(PATIENCE, stream.read_to_string(&mut said)).await;
    heard.expect("it closes").expect("it is text");
    assert!(said.contains("no certificate for TLS"), "{said}");
    broker.stop().await;
}

fn with_certificate(broker: &Broker, name: &str, identity: &Identity) -> mom_client::Builder {
    let client = Client::builder(format!("bins://{}", broker.local_addr()));
    let client = client
        .trust(pinned(broker))
        .user(name)
        .certificate(identity.clone());
    client.no_reconnect()
}

fn fingerprint(folder: &TempDir, name: &str) -> (Identity, String) {
    let identity = tls::make(folder.path(), name);
    let shown = mom_net::ServerTls::from_files(&identity.certificate, &identity.key);
    (
        identity,
        shown.expect("they belong together").fingerprint().to_string(),
    )
}

#[tokio::test]
async fn a_certificate_logs_its_user_in_and_nobody_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let (arms, of_arm) = fingerprint(&folder, "arm");
    let (others, _) = fingerprint(&folder, "other");
    let arm = |config: &mut Config| {
        let user = config.users.iter_mut().find(|user| user.name == "arm");
        let user = user.expect("a device of the lab");
        user.password = None;
        user.certificates = vec![of_arm.clone()];
    };
    let broker = broker(arm).await;
    let refused = |error: ClientError| error.wire().map(|error| error.code.clone());
    for wrong in [
        with_certificate(&broker, "arm", &others),
        with_certificate(&broker, "alice", &arms),
        // Without TLS it claims a certificate and shows none.
        Client::builder(format!("bin://{}", broker.local_addr()))
            .user("arm")
            .certificate(arms.clone()),
    ] {
        let error = wrong
            .no_reconnect()
            .connect()
            .await
            .expect_err("nobody of that name");
        assert_eq!(refused(error), Some(Code::BAD_LOGIN));
    }
    let client = with_certificate(&broker, "arm", &arms).connect().await;
    let client = client.expect("its own certificate");
    assert_eq!(client.name(), "arm");
    // Without it in the file, who logged in by it is no longer let in.
    let mut without = Config::lab();
    without.listen = vec!["127.0.0.1:0".into()];
    without.tls = tls::of_hub();
    broker.reload(without).expect("a right configuration");
    let ended = async { while client.lookup("/chat").await.is_ok() {} };
    timeout(PATIENCE, ended)
        .await
        .expect("its proof is no longer valid");
    broker.stop().await;
}

/// A key that is there is in use, whatever became of its certificate.
#[tokio::test]
async fn half_of_a_certificate_is_not_overwritten() {
    let folder = tempfile::tempdir().expect("a folder");
    let identity = tls::make(folder.path(), "hub");
    let key = std::fs::read(&identity.key).expect("it is there");
    std::fs::remove_file(&identity.certificate).expect("it is there");
    let mut config = Config::lab();
    config.listen = vec!["127.0.0.1:0".into()];
    config.tls.certificate = Some(identity.certificate.clone());
    config.tls.key = Some(identity.key.clone());
    config.tls.self_signed = true;
    config.tls.hosts = vec!["127.0.0.1".to_owned()];
    let error = Broker::start(config.clone())
        .await
        .expect_err("one half is missing");
    for part in ["hub.crt", "restore it, or remove both"] {
        assert!(error.to_string().contains(part), "{part:?} in {error}");
    }
    assert_eq!(std::fs::read(&identity.key).expect("it stays"), key);
    std::fs::remove_file(&identity.key).expect("it is there");
    let broker = Broker::start(config).await.expect("both are made");
    alice(&broker, Trust::Authorities(identity.certificate))
        .await
        .expect("the right hub")
        .close()
        .await;
    broker.stop().await;
}

/// A certificate is replaced while the hub runs; who is connected stays.
#[tokio::test]
async fn a_new_certificate_is_shown_to_who_comes_next() {
    let folder = tempfile::tempdir().expect("a folder");
    let broker = broker(|_| {}).await;
    let old = pinned(&broker);
    let before = alice(&broker, old.clone()).await.expect("the right hub");
    let identity = tls::make(folder.path(), "new");
    let mut config = Config::lab();
    config.listen = vec!["127.0.0.1:0".into()];
    config.tls.certificate = Some(identity.certificate.clone());
    config.tls.key = Some(folder.path().join("nothing"));
    let error = broker.reload(config.clone()).expect_err("there is no such key");
    assert!(error.to_string().contains("nothing"), "{error}");
    assert_eq!(pinned(&broker), old);
    config.tls.key = Some(identity.key);
    broker.reload(config).expect("a right configuration");
    assert_ne!(pinned(&broker), old);
    alice(&broker, old).await.expect_err("another certificate");
    let after = alice(&broker, pinned(&broker)).await.expect("the new one");
    before.lookup("/chat").await.expect("it is still connected");
    for client in [before, after] {
        client.close().await;
    }
    broker.stop().await;
}

/// Who has begun to shake hands and says no more has as little time, and as few places, as other strangers.
#[tokio::test]
async fn threat_28_half_handshakes() {
    let broker = broker(|config| {
        config.limits.login_time = 2000;
        config.connections = 40;
    })
    .await;
    let connect = || async { TcpStream::connect(broker.local_addr()).await.expect("it listens") };
    // The beginning of a ClientHello that announces 512 bytes.
    let begun = [0x16, 3, 1, 2, 0, 1, 0, 1, 0xfc, 3, 3];
    let mut half = Vec::new();
    for _ in 0..60 {
        let mut stream = connect().await;
        // The oldest may be closed already.
        let _ = stream.write_all(&begun).await;
        half.push(stream);
    }
    let client = alice(&broker, pinned(&broker)).await;
    client.expect("nobody else is affected").close().await;
    for stream in &mut half {
        let closed = timeout(PATIENCE, stream.read_to_end(&mut Vec::new())).await;
        // By a word that it was one too many, without one, or by a reset.
        let _ = closed.expect("its time is over");
    }
    let mut noise = connect().await;
    let mut bytes = vec![0x16, 3, 1, 0x40, 0];
    bytes.extend(std::iter::repeat_n(0xAA, 64 * 1024));
    // It may be closed before all is written.
    let _ = noise.write_all(&bytes).await;
    let heard = timeout(PATIENCE, noise.read_to_end(&mut Vec::new())).await;
    let _ = heard.expect("it is closed");
    broker.stop().await;
}

/// Servers that are no hub, such as collectors of traces, are asked by the same TLS.
#[tokio::test]
async fn a_server_of_http_is_asked_over_tls_if_it_is_trusted() {
    let broker = broker(|_| {}).await;
    let ask = async |trust: Trust, path: &str| {
        let tls = ClientTls::new(&trust, None).expect("whom to trust");
        let url = format!("https://{}{path}", broker.local_addr());
        let request = http::Request::post(url).body(bytes::Bytes::from_static(b"{}"));
        mom_net::ask(Some(&tls), request.expect("a request")).await
    };
    let answer = ask(pinned(&broker), "/v1/traces").await.expect("the right one");
    assert_eq!(answer.status(), http::StatusCode::NOT_FOUND, "{answer:?}");
    let other = Trust::Pinned(Fingerprint::new([1; 32]));
    ask(other, "/v1/traces").await.expect_err("it is another");
    let nowhere = http::Request::post("/v1/traces").body(bytes::Bytes::new());
    let error = mom_net::ask(None, nowhere.expect("a request")).await;
    let error = error.expect_err("nobody is named").to_string();
    assert!(error.contains("https://HOST:PORT"), "{error}");
    broker.stop().await;
}

/// What the network does not take at once goes later, all of it and in order, in both forms.
#[tokio::test(flavor = "multi_thread")]
async fn much_goes_through_a_link_that_stalls() {
    const EACH: usize = 300_000;
    const COUNT: u32 = 40;
    let broker = broker(|config| config.limits.burst = 64 << 20).await;
    let client = alice(&broker, pinned(&broker)).await.expect("the right hub");
    let tls = ClientTls::new(&pinned(&broker), None).expect("a pin");
    for scheme in ["bins", "tcps"] {
        let address: Address = format!("{scheme}://{}", broker.local_addr())
            .parse()
            .expect("an address");
        let mut link = mom_net::connect(&address, &Limits::default(), Some(&tls))
            .await
            .expect("the right hub");
        let login = Parcel::new(mom_proto::Family::Login, "login").context(mom_proto::Path::root());
        let login = login
            .id(1)
            .content(mom_proto::Map::new().with("name", "bob").with("password", "bob"));
        link.writer.send(login).await.expect("it takes it");
        let chat = mom_proto::Path::parse("/chat").expect("a path");
        let join = Parcel::new(mom_proto::Family::Context, "join").context(chat.clone());
        link.writer.send(join.id(2)).await.expect("it takes it");
        hear(&mut link, |parcel| parcel.reference == Some(2)).await;
        let channel = client.channel("/chat").await.expect("alice may");
        // Nobody reads meanwhile: far more than sockets take.
        for number in 0..COUNT {
            let text = format!(
                "{number} {}",
                char::from(b'a' + (number % 26) as u8).to_string().repeat(EACH)
            );
            channel.send("talk", text).await.expect("it goes");
        }
        for number in 0..COUNT {
            let parcel = hear(&mut link, |parcel| parcel.name() == "talk").await;
            let text = parcel.value();
            let text = text.as_str().expect("text");
            let (first, rest) = text.split_once(' ').expect("a number");
            assert_eq!(first, number.to_string());
            assert_eq!(rest.len(), EACH);
            assert!(rest.bytes().all(|byte| byte == b'a' + (number % 26) as u8));
        }
    }
    client.close().await;
    broker.stop().await;
}

async fn hear(link: &mut mom_net::Transceiver, wanted: impl Fn(&Parcel) -> bool) -> Parcel {
    loop {
        let next: Result<Option<Frame>, NetError> =
            timeout(PATIENCE, link.reader.next()).await.expect("it comes");
        match next.expect("the link stays") {
            Some(Frame::Parcel(parcel)) if wanted(&parcel) => return *parcel,
            Some(Frame::Parcel(_)) => {}
            other => panic!("{other:?}"),
        }
    }
}
