//! The real programs through HTTP proxies: those that people run, and one that waits for the end of everything (M19, M58).

use std::process::Output;
use std::sync::Arc;

use mom_broker::Broker;
use mom_client::{Channel, Client, Event, Events, Trust};
use mom_tests::login::DeviceKey;
use mom_tests::network::{Namespaces, Network, ip};
use mom_tests::programs::{self, PATIENCE, Running, text};
use mom_tests::proxies::{BufferingProxy, Daemon, Kind, Manners};
use mom_tests::{lab, tls};
use tempfile::TempDir;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

/// Nobody listens there: ports below 1024 are not given to programs.
const NOWHERE: &str = "http://127.0.0.1:1";

/// A hub with TLS, and who looks at it from this process, past all proxies.
struct Scene {
    broker: Broker,
    carol: Client,
    chat: Channel,
    events: Events,
    folder: TempDir,
}

impl Scene {
    /// Alice has a key beside her password: through a proxy nothing else is taken without TLS.
    async fn start() -> Scene {
        let broker = lab::start_with(|config| {
            config.tls = tls::of_hub();
            let alice = config.users.iter_mut().find(|user| user.name == "alice");
            alice.expect("a user of the lab").keys = vec![DeviceKey::number(3).public()];
        })
        .await;
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("alice.key"), DeviceKey::number(3).pem()).expect("a file");
        let carol = Client::builder(format!("bin://{}", broker.local_addr()));
        let carol = carol.user("carol").password("carol").no_reconnect().connect();
        let carol = carol.await.expect("a user of the lab");
        let chat = carol.channel("/chat").await.expect("everybody may");
        let events = chat.events();
        Scene {
            broker,
            carol,
            chat,
            events,
            folder,
        }
    }

    fn hub(&self, scheme: &str) -> String {
        let pin = match (scheme.ends_with('s') && scheme != "ws", self.broker.fingerprint()) {
            (true, Some(pin)) => format!("?pin={pin}"),
            _ => String::new(),
        };
        format!("{scheme}://{}{pin}", self.broker.local_addr())
    }

    /// How alice types a command, with her key or with her password.
    fn command(&self, hub: &str, keyed: bool, words: &[&str]) -> Vec<String> {
        let key = self.folder.path().join("alice.key").display().to_string();
        let mut args = vec!["--hub", hub, "--user", "alice"];
        if keyed {
            args.extend(["--key", &key]);
        }
        args.extend(words);
        args.into_iter().map(str::to_owned).collect()
    }

    /// Runs `mom` to its end.
    async fn mom(&self, hub: &str, keyed: bool, proxy: &Environment, words: &[&str]) -> Output {
        let (args, proxy) = (self.command(hub, keyed, words), proxy.clone());
        let run = move || programs::run("mom", &strs(&args), &proxy.pairs());
        spawn_blocking(run).await.expect("it runs")
    }

    /// Logs in, joins, says something, hears something and asks for something.
    async fn talk(&mut self, hub: &str, keyed: bool, proxy: &Environment) {
        let what = format!("{hub} {proxy:?}");
        let shown = self.mom(hub, keyed, proxy, &["tree"]).await;
        let (tree, told) = (text(&shown.stdout), text(&shown.stderr));
        assert!(
            shown.status.success() && tree.contains("chat"),
            "{what}: {tree} {told}"
        );

        let args = self.command(hub, keyed, &["watch", "/chat", "--messages", "--count", "1"]);
        let variables = proxy.clone();
        let start = move || Running::start("mom", &strs(&args), &variables.pairs());
        let watching = spawn_blocking(start).await.expect("it starts");
        self.heard(|event| matches!(event, Event::Joined(member) if member.user == "alice"))
            .await;
        let scheme = hub.split(':').next().unwrap_or_default();
        let down = format!("down by {scheme}");
        self.chat.send("chat", down.clone()).await.expect("it goes");
        let watched = spawn_blocking(move || {
            watching.line_with(&down);
            watching.wait()
        });
        assert!(watched.await.expect("it is told").success(), "{what}");

        let up = format!("up by {scheme}");
        let sent = self.mom(hub, keyed, proxy, &["send", "/chat", "chat", &up]).await;
        assert!(sent.status.success(), "{what}: {}", text(&sent.stderr));
        self.heard(|event| matches!(event, Event::Message(parcel) if parcel.value().as_str() == Some(&up)))
            .await;
    }

    async fn heard(&mut self, wanted: impl Fn(&Event) -> bool) {
        let heard = async { while !wanted(&self.events.next().await.expect("carol's link stays")) {} };
        timeout(PATIENCE, heard).await.expect("it comes");
    }

    async fn end(self) {
        self.carol.close().await;
        self.broker.stop().await;
    }
}

fn strs(args: &[String]) -> Vec<&str> {
    args.iter().map(String::as_str).collect()
}

/// What a program knows of proxies.
#[derive(Clone, Debug, Default)]
struct Environment(Arc<[(&'static str, String)]>);

impl Environment {
    fn proxy(url: &str) -> Environment {
        Environment::of(url, "")
    }

    fn of(url: &str, no_proxy: &str) -> Environment {
        Environment(Arc::new([
            ("HTTPS_PROXY", url.to_owned()),
            ("HTTP_PROXY", url.to_owned()),
            ("NO_PROXY", no_proxy.to_owned()),
            ("MOM_PASSWORD", "alice".to_owned()),
        ]))
    }

    fn pairs(&self) -> Vec<(&str, &str)> {
        self.0.iter().map(|(name, value)| (*name, &**value)).collect()
    }
}

async fn daemon(kind: Kind, connects: bool) -> Daemon {
    let start = move || Daemon::start(kind, &Network::Loopback, connects);
    spawn_blocking(start).await.expect("it starts")
}

/// A proxy that waits for the end of an answer lets no stream through: the tunnel notices, and asks again and again instead.
#[tokio::test(flavor = "multi_thread")]
async fn a_tunnel_polls_where_answers_are_held_back() {
    let mut scene = Scene::start().await;
    let hub = scene.hub("http");
    for (old, closes) in [(false, false), (true, true)] {
        let manners = Manners {
            old,
            closes,
            ..Manners::default()
        };
        let proxy = BufferingProxy::start(manners).await;
        scene.talk(&hub, true, &Environment::proxy(&proxy.url())).await;
        let asked = proxy.asked();
        let down = |polls: bool| {
            let gets = asked.iter().filter(|line| line.starts_with("GET http://"));
            gets.filter(|line| line.contains("wait=") == polls).count()
        };
        assert!(down(false) >= 1 && down(true) >= 1, "{manners:?}: {asked:?}");
    }
    scene.end().await;
}

async fn through(kind: Kind) {
    let mut scene = Scene::start().await;
    let proxy = daemon(kind, true).await;
    let environment = Environment::proxy(&proxy.url());
    // The proxy reads along: by the id it could take the tunnel over, whatever proof its user has.
    let plain = scene.hub("http");
    for keyed in [true, false] {
        let refused = scene.mom(&plain, keyed, &environment, &["tree"]).await;
        let told = text(&refused.stderr);
        assert!(!refused.status.success() && told.contains("TLS"), "{told}");
    }
    for scheme in ["https", "bins", "wss"] {
        let hub = scene.hub(scheme);
        scene.talk(&hub, false, &environment).await;
    }
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn through_squid() {
    through(Kind::Squid).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn through_tinyproxy() {
    through(Kind::Tinyproxy).await;
}

/// Who is in the way is named, and what to do about it.
#[tokio::test(flavor = "multi_thread")]
async fn a_proxy_that_lets_nothing_through_is_named() {
    let scene = Scene::start().await;
    let refusing = Manners {
        refuses_connect: true,
        ..Manners::default()
    };
    let (own, squid, tinyproxy) = (
        BufferingProxy::start(refusing).await,
        daemon(Kind::Squid, false).await,
        daemon(Kind::Tinyproxy, false).await,
    );
    for (url, why) in [
        (own.url(), "403"),
        (squid.url(), "403"),
        (tinyproxy.url(), "403"),
        (NOWHERE.to_owned(), "refused"),
        ("socks5://127.0.0.1:1080".to_owned(), "not an HTTP proxy"),
    ] {
        for scheme in ["bins", "wss", "https"] {
            let hub = scene.hub(scheme);
            let refused = scene.mom(&hub, false, &Environment::proxy(&url), &["tree"]).await;
            let told = text(&refused.stderr);
            assert_eq!(refused.status.code(), Some(1), "{scheme}: {told}");
            let named = url.split_once("//").map_or(&*url, |(_, named)| named);
            for part in ["the proxy ", named, why, "NO_PROXY"] {
                assert!(told.contains(part), "{scheme}: {part:?} in {told}");
            }
        }
    }
    // Who answers a request in the hub's place is named too: here there is no such hub.
    for url in [squid.url(), tinyproxy.url()] {
        let refused = scene
            .mom("http://127.0.0.1:1", true, &Environment::proxy(&url), &["tree"])
            .await;
        let (told, named) = (text(&refused.stderr), &url["http://".len()..]);
        assert!(
            told.contains(&format!("the proxy {named}: ")) && told.contains("NO_PROXY"),
            "{told}"
        );
    }
    scene.end().await;
}

/// `NO_PROXY` names what is reached without one, and doors that no proxy knows go past it anyway.
#[tokio::test(flavor = "multi_thread")]
async fn what_needs_no_proxy_goes_past_it() {
    let scene = Scene::start().await;
    for (scheme, keyed) in [("https", false), ("bins", false), ("wss", false), ("http", true)] {
        let hub = scene.hub(scheme);
        for (no_proxy, reached) in [
            ("127.0.0.0/8", true),
            ("example.org, 127.0.0.1", true),
            ("10.0.0.1", false),
        ] {
            let environment = Environment::of(NOWHERE, no_proxy);
            let shown = scene.mom(&hub, keyed, &environment, &["tree"]).await;
            assert_eq!(
                shown.status.success(),
                reached,
                "{scheme}: {}",
                text(&shown.stderr)
            );
        }
    }
    for scheme in ["bin", "tcp", "ws"] {
        let hub = scene.hub(scheme);
        let shown = scene
            .mom(&hub, false, &Environment::proxy(NOWHERE), &["tree"])
            .await;
        assert!(shown.status.success(), "{scheme}: {}", text(&shown.stderr));
    }
    scene.end().await;
}

/// A network that reaches the hub through a proxy only.
struct Confined {
    ends: Namespaces,
}

/// The hub's address: its neighbour has no way there.
const INSIDE: &str = "10.77.0.1";

impl Confined {
    fn make() -> std::io::Result<Confined> {
        let ends = Namespaces::new()?;
        if let (Network::Namespace(hub, _), Network::Namespace(far, _)) = (&ends.hub, &ends.far) {
            let device = "mom";
            ip(&[
                "link", "add", device, "netns", hub, "type", "veth", "peer", "name", device, "netns", far,
            ])?;
            ends.connect(device, "cubic")?;
            ip(&["-n", hub, "addr", "add", &format!("{INSIDE}/32"), "dev", "lo"])?;
        }
        Ok(Confined { ends })
    }

    /// What `mom` says in the far network.
    fn mom(&self, hub: &str, environment: &Environment) -> Output {
        let mut command = self.ends.far.command(&programs::program("mom"));
        command
            .args(["--hub", hub, "--user", "alice", "tree"])
            .envs(environment.pairs());
        command.output().expect("it runs")
    }
}

/// Where namespaces may be made, that is as root; elsewhere the reason is told.
#[test]
fn through_proxies_where_nothing_else_gets_through() {
    let confined = match Confined::make() {
        Ok(confined) => confined,
        Err(error) => return eprintln!("left out: no network namespaces here: {error}"),
    };
    let runtime = tokio::runtime::Runtime::new().expect("there are threads");
    // The listening socket belongs to the namespace, not to the thread that polls it.
    let broker = confined.ends.hub.within(|| {
        runtime.block_on(lab::start_with(|config| {
            config.tls = tls::of_hub();
            config.listen = vec![format!("{INSIDE}:0").into()];
        }))
    });
    let broker = broker.expect("the namespace is there");
    let pin = broker.fingerprint().map(Trust::Pinned);
    let Some(Trust::Pinned(pin)) = pin else {
        panic!("it has a certificate")
    };
    let at = broker.local_addr();
    let doors = ["bins", "wss", "https"].map(|scheme| format!("{scheme}://{at}?pin={pin}"));
    let direct = Environment::of("", "");
    for door in &doors {
        let blocked = confined.mom(door, &direct);
        let told = text(&blocked.stderr);
        assert!(
            !blocked.status.success() && told.contains("unreachable"),
            "{told}"
        );
    }
    for kind in Kind::ALL {
        let proxy = Daemon::start(kind, &confined.ends.hub, true);
        let environment = Environment::proxy(&proxy.url());
        for door in &doors {
            let shown = confined.mom(door, &environment);
            let told = text(&shown.stderr);
            assert!(
                shown.status.success() && text(&shown.stdout).contains("chat"),
                "{kind:?} {door}: {told}"
            );
        }
        // The way from the proxy to the hub is a network, where others could take such a tunnel over.
        let refused = confined.mom(&format!("http://{at}"), &environment);
        let told = text(&refused.stderr);
        assert!(!refused.status.success() && told.contains("TLS"), "{told}");
    }
    runtime.block_on(broker.stop());
}
