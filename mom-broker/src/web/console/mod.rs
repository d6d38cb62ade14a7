//! The console: the page by which people use the hub, as it was built into this program.

mod accepts;
mod files;

use http::header::{
    ALLOW, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, ETAG, HeaderMap, HeaderName,
    REFERRER_POLICY, VARY, X_CONTENT_TYPE_OPTIONS,
};
use http::{HeaderValue, Method, Response, StatusCode};

use super::answers::{self, Body, refuse};
use accepts::{has, takes_gzip, takes_html};
use files::{File, PAGE};

pub(super) use files::Files;

/// Scripts, styles, images and connections of the hub itself and nothing else; no page around it, and no form that leaves it.
/// `'self'` is the WebSocket of the same host and port, too.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; worker-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

/// A pad may drive a robot; all else that a page could ask a browser for is off.
const FEATURES: &str = "gamepad=(self), accelerometer=(), autoplay=(), camera=(), display-capture=(), encrypted-media=(), geolocation=(), gyroscope=(), hid=(), idle-detection=(), local-fonts=(), magnetometer=(), microphone=(), midi=(), payment=(), publickey-credentials-create=(), publickey-credentials-get=(), screen-wake-lock=(), serial=(), storage-access=(), usb=(), window-management=(), xr-spatial-tracking=()";

const EVERYWHERE: [(HeaderName, &str); 5] = [
    (CONTENT_SECURITY_POLICY, POLICY),
    (HeaderName::from_static("permissions-policy"), FEATURES),
    (REFERRER_POLICY, "no-referrer"),
    (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (
        HeaderName::from_static("cross-origin-opener-policy"),
        "same-origin",
    ),
];

/// Where nothing was built in.
const MISSING: &str = "<!doctype html>
<html lang=\"en\">
<head>
<meta charset=\"utf-8\">
<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">
<meta name=\"color-scheme\" content=\"light dark\">
<title>MOM</title>
</head>
<body>
<h1>This is a MOM hub</h1>
<p>The console was not built into this program. In a checkout of MOM,</p>
<pre>cargo xtask lab --install</pre>
<p>installs what is missing, builds the console and starts the lab with it. Where Node is installed,</p>
<pre>cargo xtask console</pre>
<p>builds the console alone; programs that are built after that have it.</p>
</body>
</html>
";

/// Answers what belongs to the console; none if this does not.
pub(super) fn answer(
    files: &Files,
    method: &Method,
    path: &str,
    headers: &HeaderMap,
) -> Option<Response<Body>> {
    let reads = matches!(*method, Method::GET | Method::HEAD);
    let name = path.strip_prefix('/')?;
    let name = match name {
        // A client that asks for no page is told in a text what this is.
        "" if reads && !takes_html(headers) => return None,
        "" => PAGE,
        name => name,
    };
    let file = files.get(name);
    let shared = file.is_some_and(|file| file.shared);
    let mut answer = match file {
        None if path != "/" => return None,
        _ if !reads => refuse_method(),
        Some(file) => send(file, headers),
        None => answers::bytes(StatusCode::OK, "text/html; charset=utf-8", MISSING),
    };
    for (name, value) in EVERYWHERE {
        answer.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    let readers = HeaderValue::from_static(if shared { "cross-origin" } else { "same-origin" });
    answer
        .headers_mut()
        .insert("cross-origin-resource-policy", readers);
    Some(answer)
}

/// Whether a request only reads a file of the console. Such a one is nobody's secret, and pages of any address may have it: what it shows
/// there says why that address may do no more.
pub(super) fn is_read(files: &Files, method: &Method, path: &str) -> bool {
    let file = path.strip_prefix('/').and_then(|name| files.get(name));
    matches!(*method, Method::GET | Method::HEAD) && file.is_some()
}

/// A file in the form that the client takes, or that it has it.
fn send(file: &File, headers: &HeaderMap) -> Response<Body> {
    let gzip = file.gzip.as_ref().filter(|_| takes_gzip(headers));
    let content = gzip.unwrap_or(&file.plain);
    let mut answer = match has(headers, &content.tag) {
        true => {
            let mut known = Response::new(Body::default());
            *known.status_mut() = StatusCode::NOT_MODIFIED;
            known
        }
        false => {
            let mut answer = answers::bytes(StatusCode::OK, file.media, content.bytes.clone());
            if gzip.is_some() {
                answer
                    .headers_mut()
                    .insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
            }
            answer
        }
    };
    let kept = match file.hashed {
        true => "public, max-age=31536000, immutable",
        false => "no-cache",
    };
    let headers = answer.headers_mut();
    headers.insert(ETAG, content.tag.clone());
    headers.insert(CACHE_CONTROL, HeaderValue::from_static(kept));
    // The page has the address of the text; and only pages of listed origins are told that they may read.
    headers.insert(VARY, HeaderValue::from_static("accept-encoding, accept, origin"));
    answer
}

fn refuse_method() -> Response<Body> {
    let mut answer = refuse(StatusCode::METHOD_NOT_ALLOWED, "unknown-verb", "use GET here");
    answer
        .headers_mut()
        .insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
    answer
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;
    use http::header::CONTENT_TYPE;
    use http_body_util::BodyExt as _;

    const BROWSER: (&str, &str) = ("accept", "text/html,application/xhtml+xml,*/*;q=0.8");
    const GZIP: (&str, &str) = ("accept-encoding", "gzip, deflate, br, zstd");

    fn built() -> Files {
        let files = [
            ("index.html", "page"),
            ("index.html.gz", "small page"),
            ("build.json", r#"{"build":"0123456789abcdef"}"#),
            ("panels.js", "panels"),
            ("assets/page-1a2b.js", "script"),
            ("assets/page-1a2b.js.gz", "small script"),
        ];
        Files::of(files.map(|(name, text)| (name.to_owned(), Bytes::from_static(text.as_bytes()))))
    }

    fn ask(files: &Files, method: &Method, path: &str, lines: &[(&str, &str)]) -> Option<Response<Body>> {
        let mut headers = HeaderMap::new();
        for (name, value) in lines {
            let name = HeaderName::try_from(*name).expect("a name");
            headers.append(name, HeaderValue::try_from(*value).expect("a value"));
        }
        answer(files, method, path, &headers)
    }

    fn get(path: &str, lines: &[(&str, &str)]) -> Response<Body> {
        ask(&built(), &Method::GET, path, lines).unwrap_or_else(|| panic!("{path}"))
    }

    fn header(answer: &Response<Body>, name: impl http::header::AsHeaderName) -> Option<&str> {
        answer.headers().get(name)?.to_str().ok()
    }

    async fn body(answer: Response<Body>) -> String {
        let bytes = answer
            .into_body()
            .collect()
            .await
            .expect("it cannot fail")
            .to_bytes();
        String::from_utf8(bytes.to_vec()).expect("text")
    }

    #[tokio::test]
    async fn files_are_sent_as_they_are_taken() {
        for (path, lines, media, encoding, text) in [
            ("/", &[BROWSER][..], "text/html; charset=utf-8", None, "page"),
            (
                "/",
                &[BROWSER, GZIP],
                "text/html; charset=utf-8",
                Some("gzip"),
                "small page",
            ),
            ("/index.html", &[], "text/html; charset=utf-8", None, "page"),
            (
                "/assets/page-1a2b.js",
                &[GZIP],
                "text/javascript; charset=utf-8",
                Some("gzip"),
                "small script",
            ),
            (
                "/assets/page-1a2b.js",
                &[("accept-encoding", "gzip;q=0")],
                "text/javascript; charset=utf-8",
                None,
                "script",
            ),
            (
                "/panels.js",
                &[GZIP],
                "text/javascript; charset=utf-8",
                None,
                "panels",
            ),
        ] {
            let answer = get(path, lines);
            assert_eq!(answer.status(), StatusCode::OK, "{path}");
            assert_eq!(header(&answer, CONTENT_TYPE), Some(media), "{path}");
            assert_eq!(header(&answer, CONTENT_ENCODING), encoding, "{path}");
            let vary = header(&answer, VARY).unwrap_or_default();
            assert!(
                vary.contains("accept-encoding") && vary.contains("origin"),
                "{path}: {vary}"
            );
            assert_eq!(body(answer).await, text, "{path}");
        }
    }

    #[test]
    fn what_never_changes_is_kept_and_all_else_is_asked_for() {
        for (path, kept, readers) in [
            ("/index.html", "no-cache", "same-origin"),
            ("/build.json", "no-cache", "same-origin"),
            ("/panels.js", "no-cache", "cross-origin"),
            (
                "/assets/page-1a2b.js",
                "public, max-age=31536000, immutable",
                "cross-origin",
            ),
        ] {
            let answer = get(path, &[GZIP]);
            assert_eq!(header(&answer, CACHE_CONTROL), Some(kept), "{path}");
            assert_eq!(
                header(&answer, "cross-origin-resource-policy"),
                Some(readers),
                "{path}"
            );
            for (name, value) in EVERYWHERE {
                assert_eq!(header(&answer, &name), Some(value), "{path}");
            }
            let tag = header(&answer, ETAG).expect("a tag").to_owned();
            let again = get(path, &[GZIP, ("if-none-match", &tag)]);
            assert_eq!(again.status(), StatusCode::NOT_MODIFIED, "{path}");
            assert_eq!(header(&again, ETAG), Some(&*tag), "{path}");
            assert_eq!(header(&again, CACHE_CONTROL), Some(kept), "{path}");
            assert_eq!(header(&again, CONTENT_TYPE), None, "{path}");
        }
        let (plain, gzip) = (get("/index.html", &[]), get("/index.html", &[GZIP]));
        let tag = header(&plain, ETAG).expect("a tag");
        assert_ne!(Some(tag), header(&gzip, ETAG), "another form has another tag");
        let other = get("/index.html", &[GZIP, ("if-none-match", tag)]);
        assert_eq!(other.status(), StatusCode::OK);
    }

    #[test]
    fn what_is_not_the_consoles_is_left_to_others() {
        for (path, lines) in [
            ("/", &[][..]),
            ("/", &[("accept", "*/*")]),
            ("/nothing", &[BROWSER]),
            ("/assets/", &[BROWSER]),
            ("/assets/../index.html", &[BROWSER]),
            ("/%2e%2e/index.html", &[BROWSER]),
            ("//index.html", &[BROWSER]),
            ("*", &[BROWSER]),
        ] {
            assert!(ask(&built(), &Method::GET, path, lines).is_none(), "{path}");
        }
        for path in ["/", "/index.html", "/assets/page-1a2b.js"] {
            let refused = ask(&built(), &Method::POST, path, &[]).unwrap_or_else(|| panic!("{path}"));
            assert_eq!(refused.status(), StatusCode::METHOD_NOT_ALLOWED, "{path}");
            assert_eq!(header(&refused, ALLOW), Some("GET, HEAD"), "{path}");
        }
    }

    #[tokio::test]
    async fn a_page_without_scripts_says_that_there_is_no_console() {
        let none = Files::default();
        assert!(ask(&none, &Method::GET, "/", &[("accept", "*/*")]).is_none());
        assert!(ask(&none, &Method::GET, "/index.html", &[BROWSER]).is_none());
        let page = ask(&none, &Method::GET, "/", &[BROWSER, GZIP]).expect("a page");
        assert_eq!(page.status(), StatusCode::OK);
        assert_eq!(header(&page, CONTENT_SECURITY_POLICY), Some(POLICY));
        assert_eq!(header(&page, CACHE_CONTROL), Some("no-store"));
        let text = body(page).await;
        for part in [
            "not built into this program",
            "cargo xtask lab --install",
            "cargo xtask console",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        for part in ["<script", "style", "src=", "href="] {
            assert!(!text.contains(part), "{part}: {text}");
        }
    }
}
