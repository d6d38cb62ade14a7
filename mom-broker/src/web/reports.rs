//! What programs report of their errors, without a login: who cannot connect can say at least why (M56).
//!
//! The hub says each report in the channel that the configuration names. Who may read it is that channel's manager's affair, and
//! what is kept of it the channel's own.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv4Addr};
use std::time::Duration;

use http::header::{ALLOW, RETRY_AFTER};
use http::{HeaderValue, Method, Request, Response, StatusCode};
use http_body_util::{BodyExt as _, LengthLimitError, Limited};
use hyper::body::Incoming;
use mom_login::network;
use mom_proto::{Gcra, Map, Micros, Pace, Wait, visible};
use parking_lot::Mutex;
use serde::Deserialize;
use tokio::time::timeout;

use super::HttpConnection;
use super::answers::{Body, refuse};

/// The name of the messages.
const NAME: &str = "log";

/// The bytes of one report, and the time that it has to come.
const MOST: usize = 4096;
const BODY: Duration = Duration::from_secs(10);

/// The letters of what is not text.
const WORD: usize = 64;

const MINUTE: Micros = 60_000_000;

/// Reports of one address (an IPv6 network of 64 bits is one) and of all, in a minute and at once.
const PER_ADDRESS: u64 = 10;
const ALL: u64 = 100;

/// How many reports there were lately.
#[derive(Debug, Default)]
pub(super) struct Reports {
    state: Mutex<State>,
}

/// As times up to which what was used is paid back.
#[derive(Debug, Default)]
struct State {
    all: Micros,
    /// Only of those who owe something: never more than all may report in a minute and at once.
    addresses: HashMap<IpAddr, Micros>,
}

impl Reports {
    /// Counts a report.
    ///
    /// # Errors
    /// After which time there may be one more.
    fn take(&self, from: IpAddr, now: Micros) -> Result<(), Duration> {
        let from = network(from);
        let mut state = self.state.lock();
        state.addresses.retain(|_, paid| *paid > now);
        let paid = state.addresses.get(&from).copied().unwrap_or_default();
        // One address that asks again and again uses up nothing of the others.
        let paid = charged(paid, PER_ADDRESS, now)?;
        state.all = charged(state.all, ALL, now)?;
        state.addresses.insert(from, paid);
        Ok(())
    }
}

/// One more of so many in a minute.
fn charged(paid: Micros, most: u64, now: Micros) -> Result<Micros, Duration> {
    let each = MINUTE / most;
    let pace = Pace::every_within(each, MINUTE - each);
    let mut used = Gcra::paid_at(paid);
    used.take(&pace, 1, now).map_err(|wait| match wait {
        Wait::For(micros) => Duration::from_micros(micros),
        Wait::Never => Duration::from_micros(MINUTE),
    })?;
    Ok(used.next(&pace))
}

/// What a program reports.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Report {
    text: String,
    level: ReportLevel,
    code: Option<String>,
    program: Option<String>,
    version: Option<String>,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum ReportLevel {
    Error,
    Warn,
    Info,
}

impl Report {
    fn read(bytes: &[u8]) -> Result<Report, String> {
        let report: Report = serde_json::from_slice(bytes).map_err(|error| {
            format!(
                "a report is {{\"text\": …, \"level\": \"error\", \"warn\" or \"info\"}} with \"code\", \"program\", \"version\" if \
                 there are such, in JSON: line {}, column {}",
                error.line(),
                error.column()
            )
        })?;
        let words = [&report.code, &report.program, &report.version];
        let long = words
            .into_iter()
            .flatten()
            .any(|word| word.chars().count() > WORD);
        match () {
            () if long => Err(format!("code, program and version have at most {WORD} letters")),
            () if report.text.trim().is_empty() => Err("the text is empty".to_owned()),
            () => Ok(report),
        }
    }

    /// As it is said; nothing in it moves a reader's cursor.
    fn content(&self, from: IpAddr) -> Map {
        let level = match self.level {
            ReportLevel::Error => "error",
            ReportLevel::Warn => "warn",
            ReportLevel::Info => "info",
        };
        let mut content = Map::new()
            .with("text", visible(&self.text))
            .with("level", level)
            .with("from", from.to_canonical().to_string());
        for (key, word) in [
            ("code", &self.code),
            ("program", &self.program),
            ("version", &self.version),
        ] {
            if let Some(word) = word {
                content.set(key, visible(word));
            }
        }
        content
    }
}

impl HttpConnection {
    /// Says a report in the channel for them.
    pub(super) async fn take_report(&self, request: Request<Incoming>) -> Response<Body> {
        if request.method() != Method::POST {
            let text = "use POST to report an error; read reports with mom logs";
            let mut answer = refuse(StatusCode::METHOD_NOT_ALLOWED, "unknown-verb", text);
            answer
                .headers_mut()
                .insert(ALLOW, HeaderValue::from_static("POST"));
            return answer;
        }
        let Some(log) = self.web.rules().log.clone() else {
            return no_log();
        };
        let remote = self.remote_of(request.headers());
        let from = remote.from.unwrap_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED));
        if let Err(wait) = self.web.reports.take(from, self.services.board.clock.now()) {
            let text = format!(
                "at most {PER_ADDRESS} reports a minute are accepted from one address, and {ALL} in total"
            );
            let mut answer = refuse(StatusCode::TOO_MANY_REQUESTS, "try-later", &text);
            let seconds = wait.as_millis().div_ceil(1000).max(1) as u64;
            answer
                .headers_mut()
                .insert(RETRY_AFTER, HeaderValue::from(seconds));
            return answer;
        }
        let body = match timeout(BODY, Limited::new(request.into_body(), MOST).collect()).await {
            Ok(Ok(body)) => body.to_bytes(),
            Ok(Err(error)) if error.is::<LengthLimitError>() => {
                let text = format!("a report must not exceed {MOST} bytes");
                return refuse(StatusCode::PAYLOAD_TOO_LARGE, "too-long", &text);
            }
            Ok(Err(_)) => return refuse(StatusCode::BAD_REQUEST, "bad-content", "the body ended early"),
            Err(_) => {
                return refuse(
                    StatusCode::REQUEST_TIMEOUT,
                    "timed-out",
                    "the body did not arrive in time",
                );
            }
        };
        let report = match Report::read(&body) {
            Ok(report) => report,
            Err(text) => return refuse(StatusCode::BAD_REQUEST, "bad-content", &text),
        };
        if !self.services.board.say(&log, NAME, report.content(from)) {
            return no_log();
        }
        let mut answer = Response::new(Body::default());
        *answer.status_mut() = StatusCode::NO_CONTENT;
        answer
    }
}

fn no_log() -> Response<Body> {
    let text = "this hub does not accept reports; its owner can set a channel for them: [web] log";
    refuse(StatusCode::NOT_FOUND, "unknown-path", text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_are_bounded_by_address_and_in_all() {
        let reports = Reports::default();
        let address = |number: u8| IpAddr::from([10, 0, 0, number]);
        let taken = |from, now| (0..200).filter(|_| reports.take(from, now).is_ok()).count();
        assert_eq!(taken(address(1), 1), PER_ADDRESS as usize);
        let wait = reports.take(address(1), 1).expect_err("too many");
        assert!(wait <= Duration::from_secs(6), "{wait:?}");
        let all: usize = (1..=100).map(|number| taken(address(number), 1)).sum();
        assert_eq!(all as u64 + PER_ADDRESS, ALL);
        assert!(
            reports.state.lock().addresses.len() <= 10,
            "an address without reports is not counted"
        );
        assert_eq!(taken(address(200), 1 + MINUTE), PER_ADDRESS as usize);
        assert_eq!(
            reports.state.lock().addresses.len(),
            1,
            "an address that owes nothing is forgotten"
        );
    }

    #[test]
    fn nothing_in_a_report_moves_a_cursor() {
        let body = r#"{"text": "no\nroute\u001b[2J", "level": "warn", "program": "\u202e"}"#;
        let content = Report::read(body.as_bytes())
            .expect("right")
            .content(IpAddr::from([10, 0, 0, 1]));
        let shown = format!("{content:?}");
        assert!(
            !shown.contains('\u{1b}') && !shown.contains('\u{202e}'),
            "{shown}"
        );
        assert_eq!(
            content.get("text").and_then(mom_proto::Value::as_str),
            Some("no\\nroute\\u{1b}[2J")
        );
        for (bad, why) in [
            ("", "line 1"),
            (r#"{"text": "x"}"#, "level"),
            (r#"{"text": "x", "level": "loud"}"#, "column"),
            (r#"{"text": " ", "level": "info"}"#, "empty"),
            (r#"{"text": "x", "level": "info", "password": "p"}"#, "column"),
        ] {
            let error = Report::read(bad.as_bytes()).expect_err(bad);
            assert!(error.contains(why) && !error.contains("loud"), "{bad}: {error}");
        }
    }
}
