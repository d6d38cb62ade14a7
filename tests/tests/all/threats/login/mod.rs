//! Threats 14 to 16: logins that are replayed, forged, guessed or too many.

mod guessing;
mod replay;
mod tokens;

use mom_broker::Clock;
use mom_proto::{Time, WireError};
use mom_tests::raw::Raw;

/// 2026-11-21T10:00:00Z, in seconds: when these tests begin.
const BEGIN: i64 = 1_795_255_200;

fn clock() -> Clock {
    Clock::manual(Time::from_micros(BEGIN * 1_000_000).expect("a time"))
}

fn check_bad_login<T: std::fmt::Debug>(outcome: Result<T, WireError>, what: &str) -> String {
    let error = outcome.expect_err(what);
    assert_eq!(error.code.word(), "bad-login", "{what}: {error}");
    error.text
}

/// Who was refused is not in, whatever it heard.
async fn check_outside(raw: &mut Raw, what: &str) {
    let members = raw.ask_about(mom_proto::Family::Context, "members", "/").await;
    assert_eq!(members.expect_err(what).code.word(), "not-logged-in", "{what}");
}
