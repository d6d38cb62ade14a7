//! The table `[login]`.

use mom_login::{FailureRate, LoginConfig};
use serde_json::{Value, json};

use super::{flag, millis, names, number, positive, table, text, with_default, words};

pub(super) fn login() -> Value {
    let default = LoginConfig::default();
    let properties = json!({
        "hashers": with_default(positive("Passwords hashed at once."), default.hashers),
        "waiting": with_default(positive("Logins that may wait for that; more are told try-later."), default.waiting),
        "attempts": with_default(positive("Failed logins after which a connection is closed."), default.attempts),
        "hub": with_default(text("This hub's name in what keys sign; give each hub its own."), &default.hub),
        "challenge-time": with_default(millis("The time for answering a challenge, in ms."), default.challenge_time),
        "guests": with_default(flag("Whether anybody may log in as guest, level 0, group guest."), default.guests),
        "throttle": throttle(&default),
        "jwt": jwt(),
    });
    table("How logins are checked.", &properties, &[])
}

fn throttle(default: &LoginConfig) -> Value {
    let rate = |description: &str, default: FailureRate| {
        let properties = json!({
            "per-minute": positive("Failures a minute in the long run."),
            "burst": positive("Failures at once before the rate applies."),
        });
        let default = json!({ "per-minute": default.per_minute, "burst": default.burst });
        with_default(table(description, &properties, &["per-minute", "burst"]), default)
    };
    let properties = json!({
        "per-address": rate("From one address.", default.throttle.per_address),
        "per-place": rate("At one account by password, from one address where its user has logged in before.", default.throttle.per_place),
        "per-account": rate("At one account by password, except from addresses where its user has logged in before.", default.throttle.per_account),
    });
    table(
        "How often logins may fail before more are refused with try-later.",
        &properties,
        &[],
    )
}

fn jwt() -> Value {
    let users =
        "Where level and groups come from: the users file, where sub names a user, or the token's claims.";
    let properties = json!({
        "issuer": text("The one issuer, as the claim iss has it."),
        "audience": text("This hub, as the claim aud has it."),
        "algorithms": names("The algorithms that may sign, such as EdDSA, ES256, PS256, or HS256 with a secret."),
        "key": text("The file of the issuer's public key (PEM) or secret, relative to this file."),
        "leeway": with_default(number("How far the issuer's clock may be off, in ms."), 0),
        "users": with_default(words(users, &["file", "from-claims"]), "file"),
        "max-level": with_default(number("The highest level that a claim gives."), 0),
    });
    let required = ["issuer", "audience", "algorithms", "key"];
    table(
        "The issuer of accepted tokens (JWT); absent = no tokens.",
        &properties,
        &required,
    )
}
