//! The console as a broker serves it: what was built into this test, or word that nothing was.

use mom_broker::{Broker, Protocol};
use mom_tests::lab;
use mom_tests::web::{Answer, Connection, ask};
use serde_json::{Value as Json, json};

const BROWSER: &str = "Accept: text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8";
const GZIP: &str = "Accept-Encoding: gzip, deflate, br";

/// The first bytes of anything in gzip.
const GZIP_MAGIC: &[u8] = &[0x1f, 0x8b];

async fn get(broker: &Broker, path: &str, headers: &[&str]) -> Answer {
    ask(broker.local_addr(), &format!("GET {path}"), headers, b"").await
}

/// What belongs to the page, by its path, as the page names it.
async fn assets(broker: &Broker) -> Vec<String> {
    let page = get(broker, "/index.html", &[]).await.text();
    let named = page
        .split('"')
        .filter_map(|word| word.find("assets/").map(|at| format!("/{}", &word[at..])));
    named.collect()
}

fn check_guarded(answer: &Answer, what: &str) {
    let policy = answer.header("content-security-policy").expect(what);
    for part in [
        "default-src 'none'",
        "script-src 'self'",
        "connect-src 'self'",
        "frame-ancestors 'none'",
        "base-uri 'none'",
        "form-action 'none'",
    ] {
        assert!(policy.split("; ").any(|one| one == part), "{what}: {policy}");
    }
    assert!(
        !policy.contains("unsafe") && !policy.contains("http"),
        "{what}: {policy}"
    );
    for (name, value) in [
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-opener-policy", "same-origin"),
    ] {
        assert_eq!(answer.header(name), Some(value), "{what}");
    }
    let features = answer.header("permissions-policy").expect(what);
    assert!(
        features.contains("gamepad=(self)") && features.contains("camera=()"),
        "{features}"
    );
}

#[tokio::test]
async fn a_browser_gets_the_page_and_others_the_text() {
    let broker = lab::start().await;
    for headers in [&[][..], &["Accept: */*"], &["Accept: text/html;q=0, */*"]] {
        let text = get(&broker, "/", headers).await;
        assert_eq!(text.status, 200, "{headers:?}");
        assert_eq!(text.header("content-type"), Some("text/plain; charset=utf-8"));
        assert!(text.text().starts_with("This is a MOM hub."), "{}", text.text());
    }
    let page = get(&broker, "/", &[BROWSER]).await;
    assert_eq!(page.status, 200, "{}", page.text());
    assert_eq!(page.header("content-type"), Some("text/html; charset=utf-8"));
    check_guarded(&page, "/");
    let text = page.text();
    match broker.console() {
        Some(_) => assert_eq!(get(&broker, "/index.html", &[]).await.text(), text),
        None => {
            assert!(
                text.contains("cargo xtask lab --install") && !text.contains("<script"),
                "{text}"
            );
            assert_eq!(get(&broker, "/index.html", &[BROWSER]).await.status, 404);
        }
    }
    broker.stop().await;
}

#[tokio::test]
async fn files_come_in_the_form_that_is_taken_and_once() {
    let broker = lab::start().await;
    if broker.console().is_some() {
        let assets = assets(&broker).await;
        assert!(!assets.is_empty());
        let fixed = ["/index.html", "/panels.js", "/icon.svg"].map(str::to_owned);
        for path in fixed.iter().chain(&assets) {
            let plain = get(&broker, path, &[]).await;
            let small = get(&broker, path, &[GZIP]).await;
            assert_eq!((plain.status, small.status), (200, 200), "{path}");
            assert_eq!(plain.header("content-encoding"), None, "{path}");
            assert_eq!(small.header("content-encoding"), Some("gzip"), "{path}");
            assert!(
                small.body.starts_with(GZIP_MAGIC) && !plain.body.starts_with(GZIP_MAGIC),
                "{path}"
            );
            let refused = get(&broker, path, &["Accept-Encoding: gzip;q=0, br"]).await;
            assert_eq!(refused.body, plain.body, "{path}");
            for answer in [&plain, &small] {
                check_guarded(answer, path);
                let vary = answer.header("vary").unwrap_or_default();
                assert!(vary.contains("accept-encoding"), "{path}: {vary}");
                let hashed = path.starts_with("/assets/");
                let kept = answer.header("cache-control").unwrap_or_default();
                assert_eq!(kept.contains("immutable"), hashed, "{path}: {kept}");
                assert_eq!(kept == "no-cache", !hashed, "{path}: {kept}");
                let shared = hashed || path == "/panels.js";
                let readers = answer.header("cross-origin-resource-policy");
                let expected = if shared { "cross-origin" } else { "same-origin" };
                assert_eq!(readers, Some(expected), "{path}");
            }
            // They are nobody's secret; what they would ask for is guarded.
            let elsewhere = get(&broker, path, &["Origin: https://elsewhere.example"]).await;
            let reader = elsewhere.header("access-control-allow-origin");
            assert_eq!((elsewhere.status, reader), (200, Some("*")), "{path}");
            let tag = small.header("etag").expect("a tag");
            assert!(
                tag.starts_with('"') && Some(tag) != plain.header("etag"),
                "{path}: {tag}"
            );
            let known = get(&broker, path, &[GZIP, &format!("If-None-Match: {tag}")]).await;
            assert_eq!((known.status, known.body.len()), (304, 0), "{path}");
            assert_eq!(known.header("etag"), Some(tag), "{path}");
            assert_eq!(
                get(&broker, path, &[&format!("If-None-Match: {tag}")])
                    .await
                    .status,
                200,
                "{path}"
            );
        }
    }
    broker.stop().await;
}

/// On one connection, where a body too many would be taken for the next answer.
#[tokio::test]
async fn only_reading_is_answered() {
    let broker = lab::start().await;
    let mut connection = Connection::open(broker.local_addr()).await;
    let page = connection.ask("GET /", &[BROWSER], b"").await;
    let head = ask(broker.local_addr(), "HEAD /", &[BROWSER], b"").await;
    assert_eq!((head.status, head.body.len()), (200, 0));
    for name in [
        "content-type",
        "content-length",
        "etag",
        "cache-control",
        "content-security-policy",
    ] {
        assert_eq!(head.header(name), page.header(name), "{name}");
    }
    for method in ["POST", "PUT", "DELETE", "PATCH"] {
        let refused = connection.ask(&format!("{method} /"), &[BROWSER], b"").await;
        assert_eq!(refused.status, 405, "{method}");
        assert_eq!(refused.header("allow"), Some("GET, HEAD"), "{method}");
    }
    assert_eq!(connection.ask("GET /healthz", &[], b"").await.status, 200);
    broker.stop().await;
}

#[tokio::test]
async fn nothing_but_the_console_is_served() {
    let broker = lab::start().await;
    for path in [
        "/assets/none-0000.js",
        "/assets/",
        "/assets",
        "/index.html.gz",
        "/INDEX.HTML",
        "//index.html",
        "/./index.html",
        "/assets/../index.html",
        "/../Cargo.toml",
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/..%2fCargo.toml",
        "/assets/..%5c..%5cCargo.toml",
        "/index.html%00.js",
        "/etc/passwd",
    ] {
        let answer = get(&broker, path, &[BROWSER]).await;
        assert_eq!(
            (answer.status, &answer.json()["code"]),
            (404, &json!("unknown-path")),
            "{path}"
        );
    }
    broker.stop().await;
}

#[tokio::test]
async fn whoever_asks_is_told_what_serves_here() {
    let broker = lab::start().await;
    let told = get(&broker, "/api/console", &[]).await;
    assert_eq!(told.status, 200, "{}", told.text());
    let build = broker.console().map_or(Json::Null, Json::from);
    let version = env!("CARGO_PKG_VERSION");
    assert_eq!(
        told.json(),
        json!({ "console": build, "version": version, "hub": "mom" })
    );
    if let Some(build) = broker.console() {
        assert_eq!(
            get(&broker, "/build.json", &[]).await.json()["build"],
            json!(build)
        );
    }
    let posted = ask(broker.local_addr(), "POST /api/console", &[], b"").await;
    assert_eq!((posted.status, posted.header("allow")), (405, Some("GET, HEAD")));
    broker.stop().await;
}

#[tokio::test]
async fn a_hub_may_be_without_it() {
    let broker = lab::start_with(|config| config.web.console = false).await;
    assert_eq!(broker.console(), None);
    let text = get(&broker, "/", &[BROWSER]).await;
    assert!(text.text().starts_with("This is a MOM hub."), "{}", text.text());
    for path in ["/index.html", "/panels.js", "/build.json"] {
        assert_eq!(get(&broker, path, &[BROWSER]).await.status, 404, "{path}");
    }
    assert_eq!(
        get(&broker, "/api/console", &[]).await.json()["console"],
        Json::Null
    );
    let before = lab::start().await;
    let mut config = mom_broker::Config::lab();
    config.web.console = false;
    before.reload(config).expect("it is right");
    assert_eq!(
        get(&before, "/index.html", &[]).await.status,
        404,
        "from the next request on"
    );
    before.stop().await;
    broker.stop().await;
}

/// A listener that takes no HTTP serves no page, and says so.
#[tokio::test]
async fn the_page_counts_as_http() {
    let broker = lab::start_with(|config| config.listen[0].takes = vec![Protocol::Websocket]).await;
    for path in ["/", "/index.html", "/api/console"] {
        let refused = get(&broker, path, &[BROWSER]).await;
        assert_eq!(
            (refused.status, &refused.json()["code"]),
            (403, &json!("not-taken")),
            "{path}"
        );
    }
    broker.stop().await;
}

/// An address cannot be given to another machine by a name server; a name can.
#[tokio::test]
async fn a_page_opened_by_the_hubs_address_may_use_it() {
    let broker = lab::start_with(|config| config.listen = vec!["127.0.0.2:0".into()]).await;
    let port = broker.local_addr().port();
    for (host, allowed) in [
        (format!("127.0.0.2:{port}"), true),
        (format!("localhost:{port}"), true),
        (format!("127.0.0.3:{port}"), false),
        ("127.0.0.2:1".to_owned(), false),
        (format!("hub.example.net:{port}"), false),
    ] {
        let origin = format!("http://{host}");
        let lines = [&*format!("Origin: {origin}"), "Accept: */*"];
        let answer = get(&broker, "/api/console", &lines).await;
        assert_eq!(answer.status, if allowed { 200 } else { 403 }, "{origin}");
        let reader = answer.header("access-control-allow-origin");
        assert_eq!(reader, allowed.then_some(&*origin), "{origin}");
        if !allowed {
            let text = answer.json()["text"].as_str().unwrap_or_default().to_owned();
            assert!(text.ends_with(&format!("origins = [\"{origin}\"]")), "{text}");
        }
    }
    broker.stop().await;
}
