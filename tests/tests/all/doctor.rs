//! `mom doctor` against hubs, and against what is not a hub: what blocks has a name, and what is open is measured (M58-M60).

use std::process::Output;

use mom_broker::Broker;
use mom_tests::programs::{self, text};
use mom_tests::{lab, tls};
use serde_json::Value as Json;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::spawn_blocking;

async fn doctor(args: &[&str]) -> Output {
    doctor_in(args, &[]).await
}

async fn doctor_in(args: &[&str], environment: &[(&'static str, String)]) -> Output {
    let environment = environment.to_vec();
    let args: Vec<String> = args.iter().map(|arg| (*arg).to_owned()).collect();
    let run = move || {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        // The environment of the tests may have a proxy, and trusts some or nobody.
        let environment: Vec<(&str, &str)> = environment
            .iter()
            .map(|(name, value)| (*name, &**value))
            .collect();
        programs::run("mom", &[&["doctor", "--quick"], &args[..]].concat(), &environment)
    };
    spawn_blocking(run).await.expect("it runs")
}

/// What it says of each door, and its exit code.
async fn examine(host: &str) -> (Vec<Json>, Option<i32>) {
    examine_in(host, &[]).await
}

async fn examine_in(host: &str, environment: &[(&'static str, String)]) -> (Vec<Json>, Option<i32>) {
    let output = doctor_in(&["--json", host], environment).await;
    let said: Json = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{error}: {} {}", text(&output.stdout), text(&output.stderr)));
    let doors = said["doors"].as_array().expect("a list").clone();
    for name in ["binary", "XML, TLS", "WebSocket", "tunnel, TLS"] {
        assert!(doors.iter().any(|door| door["door"] == name), "{name}: {said}");
    }
    (doors, output.status.code())
}

/// Whether a door is one with TLS.
fn has_tls(door: &Json) -> bool {
    door["door"].as_str().is_some_and(|name| name.ends_with("TLS"))
}

/// Expects every door to be blocked by this.
async fn all_blocked(host: &str, word: &str, why: &str) {
    let (doors, code) = examine(host).await;
    assert_eq!(code, Some(1));
    for door in doors {
        assert_eq!(
            (&door["open"], &door["password"]),
            (&Json::from(false), &Json::from(false)),
            "{door}"
        );
        assert_eq!(door["blocked"], word, "{door}");
        assert!(
            door["text"].as_str().is_some_and(|text| text.contains(why)),
            "{door}"
        );
        assert!(
            door["hint"].as_str().is_some_and(|hint| hint.len() > 20),
            "{door}"
        );
    }
}

/// A server that does something with each connection.
async fn serve<F>(serve: impl Fn(TcpStream) -> F + Send + 'static) -> String
where
    F: Future<Output = ()> + Send + 'static,
{
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = listener.local_addr().expect("it is bound").to_string();
    tokio::spawn(async move {
        while let Ok((stream, _)) = listener.accept().await {
            tokio::spawn(serve(stream));
        }
    });
    address
}

/// A server that says this, and then listens to the end.
async fn serve_words(first: bool, words: &'static str) -> String {
    serve(move |mut stream| async move {
        // Some servers speak first, some want to hear something.
        if !first && stream.read(&mut [0; 1]).await.is_err() {
            return;
        }
        // Who asked may be gone.
        let _ = stream.write_all(words.as_bytes()).await;
        let _ = stream.shutdown().await;
        let _ = stream.read_to_end(&mut Vec::new()).await;
    })
    .await
}

async fn hub_with_tls() -> Broker {
    lab::start_with(|config| config.tls = tls::of_hub()).await
}

#[tokio::test(flavor = "multi_thread")]
async fn all_doors_of_a_hub_are_open_and_measured() {
    let broker = hub_with_tls().await;
    let pin = broker.fingerprint().expect("it has a certificate");
    let host = format!("{}?pin={pin}", broker.local_addr());
    let folder = tempfile::tempdir().expect("a folder");
    let plots = folder.path().join("plots");
    let (doors, code) = examine(&host).await;
    assert_eq!(code, Some(0));
    for door in &doors {
        assert_eq!(
            (&door["open"], &door["password"]),
            (&Json::from(true), &Json::from(true)),
            "{door}"
        );
        for step in ["name", "tcp", "open", "answer"] {
            assert!(door["connect"][step].is_u64(), "{step}: {door}");
        }
        let trips = door["round-trips"].as_array().expect("a list");
        let sizes: Vec<u64> = trips.iter().filter_map(|trip| trip["size"].as_u64()).collect();
        assert_eq!((sizes.first(), sizes.last()), (Some(&1), Some(&10_000)), "{door}");
        for trip in trips {
            assert!(
                trip["count"].as_u64() > Some(0) && trip["mean"].as_u64() > Some(0),
                "{trip}"
            );
        }
    }
    let output = doctor(&[&host, "--save", plots.to_str().expect("text")]).await;
    let (said, told) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "{told}");
    for part in ["its clock ", " ± ", "bins://127.0.0.1", "password", "10 kB"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    for part in ["measuring XML, TLS", "written", "round-trip.svg"] {
        assert!(told.contains(part), "{part}: {told}");
    }
    for (file, part) in [
        ("connect.svg", ">first answer<"),
        ("round-trip.svg", ">binary, TLS<"),
    ] {
        let plot = std::fs::read_to_string(plots.join(file)).expect("it was written");
        assert!(plot.contains(part), "{part}: {plot}");
    }
    broker.stop().await;
}

/// An unknown certificate is told with its fingerprint, and the advice works as it stands.
#[tokio::test(flavor = "multi_thread")]
async fn an_unknown_certificate_is_told_with_what_to_do() {
    let broker = hub_with_tls().await;
    let pin = broker.fingerprint().expect("it has a certificate").to_string();
    let (doors, code) = examine(&broker.local_addr().to_string()).await;
    // The doors without TLS take passwords on this machine.
    assert_eq!(code, Some(0));
    for door in doors.iter().filter(|door| has_tls(door)) {
        assert_eq!(door["blocked"], "not-trusted", "{door}");
        let hint = door["hint"].as_str().expect("text");
        let (_, host) = hint.split_once("mom doctor '").expect("a command");
        let host = host.trim_end_matches('\'');
        assert!(host.ends_with(&format!("?pin={pin}")), "{hint}");
        assert!(examine(host).await.0.iter().all(|door| door["open"] == true));
    }
    let other = format!("{}?pin={}", broker.local_addr(), "0".repeat(64));
    let (doors, _) = examine(&other).await;
    for door in doors.iter().filter(|door| has_tls(door)) {
        assert_eq!(door["blocked"], "not-trusted", "{door}");
        assert!(door["text"].to_string().contains(&pin), "{door}");
    }
    broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hub_that_does_not_take_this_says_so_itself() {
    let broker = lab::start().await;
    let (doors, code) = examine(&broker.local_addr().to_string()).await;
    assert_eq!(code, Some(0));
    let (with, without): (Vec<_>, Vec<_>) = doors.iter().partition(|door| has_tls(door));
    assert!(without.iter().all(|door| door["open"] == true), "{doors:?}");
    for door in with {
        assert_eq!(door["blocked"], "not-taken", "{door}");
        assert!(
            door["text"].to_string().contains("no certificate for TLS"),
            "{door}"
        );
    }
    broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_blocks_on_the_way_has_a_name() {
    // No name has a part of more than 63 letters: the resolver says so without a server, which may be slow.
    let nobody = format!("{}.invalid", "x".repeat(64));
    all_blocked(&nobody, "unknown-name", "name").await;
    // TCP goes to no group of hosts: the system refuses by itself, and nothing leaves this machine.
    all_blocked("224.0.0.1", "unreachable", "unreachable").await;
    let free = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = free.local_addr().expect("it is bound").to_string();
    drop(free);
    all_blocked(&address, "refused", "nothing listens").await;
    let silent = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
    let address = silent.local_addr().expect("it is bound").to_string();
    all_blocked(&address, "timed-out", "too long").await;
    let address = serve(|mut stream| async move {
        // It has said something, so that the cut comes on the first word and not on the connection.
        let _ = stream.read(&mut [0; 1]).await;
        let _ = stream.set_zero_linger();
    })
    .await;
    all_blocked(&address, "reset", "cut").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_is_no_hub_is_told_by_what_it_says() {
    let ssh = serve_words(true, "SSH-2.0-OpenSSH_9.2\r\n").await;
    all_blocked(&ssh, "no-hub", "an SSH server").await;
    let http = serve_words(false, "HTTP/1.1 400 Bad Request\r\nServer: any\r\n\r\n").await;
    all_blocked(&http, "no-hub", "an HTTP server").await;
    let gate = serve_words(false, "HTTP/1.1 403 Forbidden\r\nVia: 1.1 gate\r\n\r\n").await;
    all_blocked(&gate, "proxy", "403").await;
    let mute = serve_words(false, "").await;
    all_blocked(&mute, "closed", "without an answer").await;
}

/// What the environment names is where the doors go that know of proxies, and nothing else is tried for them.
#[cfg(target_os = "linux")]
#[tokio::test(flavor = "multi_thread")]
async fn doors_go_through_the_proxy_of_the_environment() {
    use mom_tests::proxies::{BufferingProxy, Manners};
    let broker = hub_with_tls().await;
    let pin = broker.fingerprint().expect("it has a certificate");
    // TCP goes to no group of hosts, so what gets there went through the proxy.
    let host = format!("224.0.0.1:7666?pin={pin}");
    let manners = Manners {
        to: Some(broker.local_addr()),
        ..Manners::default()
    };
    let proxy = BufferingProxy::start(manners).await;
    let names = |url: String| [("HTTPS_PROXY", url.clone()), ("HTTP_PROXY", url)];
    let (doors, code) = examine_in(&host, &names(proxy.url())).await;
    assert_eq!(code, Some(0));
    for door in &doors {
        let through = has_tls(door) || door["door"] == "tunnel";
        assert_eq!(door["open"], through, "{door}");
        assert_eq!(door["password"], has_tls(door), "the proxy reads along: {door}");
        match through {
            true => assert_eq!(door["proxy"], proxy.address().to_string(), "{door}"),
            false => assert_eq!(
                (&door["proxy"], &door["blocked"]),
                (&Json::Null, &Json::from("unreachable"))
            ),
        }
    }
    let asked = proxy.asked();
    for line in ["CONNECT 224.0.0.1:7666 ", "POST http://224.0.0.1:7666/tunnel"] {
        assert!(asked.iter().any(|asked| asked.starts_with(line)), "{asked:?}");
    }
    let output = doctor_in(&[&host], &names(proxy.url())).await;
    let told = text(&output.stderr);
    for part in [
        &*proxy.address().to_string(),
        "go through",
        "binary, TLS; ",
        "the others go past it",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
    let named = |door: &Json| {
        let text = door["text"].as_str().unwrap_or_default();
        door["blocked"] == "proxy" && text.contains("the proxy 127.0.0.1:")
    };
    // One that refuses, one that is not there, and none for this hub.
    let refusing = BufferingProxy::start(Manners {
        refuses_connect: true,
        ..manners
    })
    .await;
    let hub = format!("{}?pin={pin}", broker.local_addr());
    for url in [refusing.url(), "http://127.0.0.1:1".to_owned()] {
        let (doors, _) = examine_in(&hub, &names(url)).await;
        assert!(doors.iter().filter(|door| has_tls(door)).all(named), "{doors:?}");
        assert!(
            doors
                .iter()
                .any(|door| door["door"] == "binary" && door["open"] == true)
        );
    }
    let past = [
        &names("http://127.0.0.1:1".to_owned())[..],
        &[("NO_PROXY", "127.0.0.1".to_owned())],
    ]
    .concat();
    let (doors, _) = examine_in(&hub, &past).await;
    assert!(
        doors
            .iter()
            .all(|door| door["open"] == true && door["proxy"].is_null()),
        "{doors:?}"
    );
    broker.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn it_takes_the_hub_of_all_commands_and_refuses_what_is_no_host() {
    let broker = lab::start().await;
    let hub = format!("bin://{}", broker.local_addr());
    let said = text(&doctor(&["--hub", &hub]).await.stdout);
    assert!(said.contains(&broker.local_addr().to_string()), "{said}");
    let wrong = doctor(&["no host"]).await;
    assert_eq!(wrong.status.code(), Some(2));
    assert!(
        text(&wrong.stderr).contains("mom doctor HOST"),
        "{}",
        text(&wrong.stderr)
    );
    broker.stop().await;
}
