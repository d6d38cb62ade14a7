//! Tokens of all kinds of key, and what the configuration takes.
//!
//! The keys were made for these tests with `openssl genpkey`, the tokens signed once with another program; their
//! private halves are gone.

use super::*;
use crate::KeyFile;

/// 2048 bits.
const RSA: &str = "\
-----BEGIN PUBLIC KEY-----\n\
MIIBIjANBgkqhkiG9w0BAQEFAAOCAQ8AMIIBCgKCAQEArGSmPfW97NoLIUYZQNFY\n\
sMKCG2UPloubnbp3p2/RUjJI9rldp01v6n77Rd0EaMQWlSUFoa4UKWJNWnPdXkkX\n\
VeNjI47os4lJv2w+LbVxALtFJNfV6OQM1NQmEYG+QkRdVvogqBRe9oSuGqav0bVA\n\
DEhQI30YcCEcxLgHTnwlgAOD3dot+G6w9xBxqSqtASOLBbq4ez/frPQSfvjVUR5A\n\
5oWOOm/aYi5AbYnWwwrbTDBkMm8xY5+MvH8yzFmstF2k22Qbq+Wyuq9C8s+Ce4B7\n\
iiGNvsY3JxhUX/m8CuGEdVC4tNzrZVs+i0dAjAoQUh4UCuPi42FD0RJAPUp5g5Ax\n\
CQIDAQAB\n\
-----END PUBLIC KEY-----\n\
";
/// 1024 bits.
const SHORT_RSA: &str = "\
-----BEGIN PUBLIC KEY-----\n\
MIGfMA0GCSqGSIb3DQEBAQUAA4GNADCBiQKBgQC85HhJ7Vf4HUXKJ/VVpLxt2WwL\n\
JWH9ARgYM2uAmRFjEjexYwzpGDwP1q4jFZAQS4siOKE0J4IJt6Bwpr6sGP/YfKAd\n\
QDOEZgCoStvVy8qHIg0kpWyH8LsnqsB3lRLngbp2QNKz7vx7t0VC3A2FDoNIfCPn\n\
ByUmZewd35L2gFyhbQIDAQAB\n\
-----END PUBLIC KEY-----\n\
";
/// Of the curve P-256.
const P256: &str = "\
-----BEGIN PUBLIC KEY-----\n\
MFkwEwYHKoZIzj0CAQYIKoZIzj0DAQcDQgAE4zta92XZ/lKACkrrU63iGpbA1Se5\n\
XdWPU0OjJIN6g5NcOC+3iND0xGg/E5+7N8XIC2HB//JtN3FDcjJAT0eIwg==\n\
-----END PUBLIC KEY-----\n\
";
/// Of the curve P-384.
const P384: &str = "\
-----BEGIN PUBLIC KEY-----\n\
MHYwEAYHKoZIzj0CAQYFK4EEACIDYgAEcjK04H0qxiLmIt5E0UvUndBI0V+OzYUP\n\
BwjYMBdxs53rkJcwKdz0I25CdskGZOHh+p++9TXt0gTkX0+Bn04njvG6DctPXtC6\n\
0KfvFdaRgE5dUOyXMpgeZeUhtZUVVb4i\n\
-----END PUBLIC KEY-----\n\
";
/// Of the other curve for EdDSA.
const ED448: &str = "\
-----BEGIN PUBLIC KEY-----\n\
MEMwBQYDK2VxAzoAG93MGbQRQE7IKWuebksUnjsHU4+fZrMmUO7i+82vMpEGvA1b\n\
8/FLTKNQs8IphYasfttYfLU5PU+A\n\
-----END PUBLIC KEY-----\n\
";

/// All four: iss https://id.example.org, aud mom, sub alice, exp 2026-11-21T10:00:00Z.
const RS256: &str = "\
eyJ0eXAiOiJKV1QiLCJhbGciOiJSUzI1NiJ9.eyJhdWQiOiJtb20iLCJleHAiOjE3OTUyNTUyMDAsImlzcyI6Imh0dHBzOi8vaWQ\
uZXhhbXBsZS5vcmciLCJzdWIiOiJhbGljZSJ9.eK7OeCfvV6YUPserbkU5NTGYY0Siv3Y1HYsDGfb7uxvvRWTrJo4jrMkm95E-kE\
ci0NYCtyItTCaFDMws_qZ7DA8QNqXje9jNko9l_sFXuAOfjlIpKQYGansR4a2mpHqDXr2sWn2c_juhTQpIJXlnJQXSlHOhl2TwXr\
ijTFzlVWOW0E75Wu3Sx1mOiOa9aw6Ow2JeDkVFphYolxf6kzVsPK3l_V5AyYEYzB1y-SuEcOAAyrcgm1LXoV7_T_NZ3j63rn9UEE\
PSb3YxNvQ6Ag-0svSkjwiZVDKpYZlxehxMqKHcHWOLVmMsRM4zcbEwj3EL7MuNicCzimLSAPkxjXLzZw";
const PS256: &str = "\
eyJ0eXAiOiJKV1QiLCJhbGciOiJQUzI1NiJ9.eyJhdWQiOiJtb20iLCJleHAiOjE3OTUyNTUyMDAsImlzcyI6Imh0dHBzOi8vaWQ\
uZXhhbXBsZS5vcmciLCJzdWIiOiJhbGljZSJ9.Fipwc8VczuNTStuNAVgm-_CvgpRuAitab04Nz5Lafz0E3DHz9vUZ2A_Fiqje-c\
_SpacgOr-Blp3PztJrGNG4qMFp9EYpzD0std2w27BQiwNLoGXJO6SuwT345hAsEmUqxGEUA2MTyzvTLXhnArHgObFmM2JB0fxCX1\
yohCbpoh4_BSYlTA7gaaGgOyGF0o6wTnk415OCZkNkR3SjmH6Ob9x82WYcZHn6Uq-O7ahrPPtoUM85cfkLIXGF6K5Q-bLWUUOLlf\
yBGbHPaOr6NOdqZwE07o__LzImWcTsKyrAiE_LQJGjtvRU6tk8hk544Z0NQVC6n5LCweofj8svZ644Kw";
const ES256: &str = "\
eyJ0eXAiOiJKV1QiLCJhbGciOiJFUzI1NiJ9.eyJhdWQiOiJtb20iLCJleHAiOjE3OTUyNTUyMDAsImlzcyI6Imh0dHBzOi8vaWQ\
uZXhhbXBsZS5vcmciLCJzdWIiOiJhbGljZSJ9.genulb2t9n0cBlvQ0Rg2ixOxmN3ce7tmWfYDaLLOqQJZoU_sUGHkhbHGHdaiVN\
lqrdecUYwRleZCgQpkhIQH3w";
const ES384: &str = "\
eyJ0eXAiOiJKV1QiLCJhbGciOiJFUzM4NCJ9.eyJhdWQiOiJtb20iLCJleHAiOjE3OTUyNTUyMDAsImlzcyI6Imh0dHBzOi8vaWQ\
uZXhhbXBsZS5vcmciLCJzdWIiOiJhbGljZSJ9.2xBsEEBzcaMWUXvfOIPwG16BmUwjeviHjbnyVzcJ3W_haCYb3XGjZ2q5MjFgjF\
e2VK6AECuMIgOFYdiW141mzB61a-PvGQ6Fqb29l-jrkPAMxobDx6P-cmuqZE3uIBnN";
const EXPIRES: i64 = 1_795_255_200;

fn config(algorithm: &str, key: &str) -> JwtConfig {
    JwtConfig {
        issuer: "https://id.example.org".to_owned(),
        audience: "mom".to_owned(),
        algorithms: vec![algorithm.to_owned()],
        key: KeyFile::from_text(key),
        leeway: 0,
        users: JwtUsers::File,
        max_level: 0,
    }
}

fn at(micros: i64) -> Time {
    Time::from_micros(EXPIRES * 1_000_000 + micros).expect("a time")
}

/// Every token is taken by its own algorithm and key, to its last microsecond, and by no other.
#[test]
fn each_kind_of_key() {
    let all = [
        ("RS256", RSA, RS256),
        ("PS256", RSA, PS256),
        ("ES256", P256, ES256),
        ("ES384", P384, ES384),
    ];
    for (algorithm, key, _) in all {
        let verifier = Verifier::new(&config(algorithm, key)).expect(algorithm);
        for (other, _, token) in all {
            let told = verifier.verify(token, at(-1));
            assert_eq!(
                told.is_ok(),
                algorithm == other,
                "{other} at {algorithm}: {told:?}"
            );
            let Ok(proven) = told else { continue };
            assert_eq!((proven.name.as_str(), proven.until), ("alice", at(0)));
            let error = verifier.verify(token, at(0)).expect_err("expired");
            assert!(error.text.contains("expired"), "{error}");
        }
    }
    let both = JwtConfig {
        algorithms: vec!["PS256".to_owned(), "RS256".to_owned()],
        ..config("", RSA)
    };
    let both = Verifier::new(&both).expect("one key for both");
    for token in [RS256, PS256] {
        assert!(both.verify(token, at(-1)).is_ok());
    }
}

#[test]
fn a_leeway_is_given_and_known() {
    let lenient = JwtConfig {
        leeway: 1500,
        ..config("ES256", P256)
    };
    let verifier = Verifier::new(&lenient).expect("right");
    let proven = verifier.verify(ES256, at(1_499_999)).expect("within it");
    assert_eq!(proven.until, at(1_500_000));
    assert!(verifier.verify(ES256, at(1_500_000)).is_err());
}

/// One byte anywhere makes it another token.
#[test]
fn a_changed_token_is_none() {
    let verifier = Verifier::new(&config("ES256", P256)).expect("right");
    for position in 0..ES256.len() {
        let mut changed = ES256.to_owned().into_bytes();
        changed[position] = if changed[position] == b'x' { b'y' } else { b'x' };
        let changed = String::from_utf8(changed).expect("ASCII");
        let error = verifier.verify(&changed, at(-1)).expect_err(&changed);
        assert_eq!(error.code, Code::BAD_LOGIN);
    }
    for cut in 0..ES256.len() {
        assert!(verifier.verify(&ES256[..cut], at(-1)).is_err(), "{cut}");
    }
}

#[test]
fn keys_that_do_not_fit_are_told_before() {
    let secret = "0123456789abcdef0123456789abcdef";
    for (algorithm, key, words) in [
        ("ES256", P384, "not a key for ES256"),
        ("ES384", P256, "not a key for ES384"),
        ("ES256", RSA, "not a public key of ECDSA"),
        ("EdDSA", P256, "not a public key of Ed25519"),
        ("EdDSA", ED448, "Ed25519"),
        ("RS256", SHORT_RSA, "2048 bits"),
        ("RS256", P256, "not a public key of RSA"),
        ("RS256", secret, "public key in PEM"),
        ("HS256", RSA, "not a secret"),
        ("HS512", &secret[1..], "at least 32"),
    ] {
        let error = Verifier::new(&config(algorithm, key)).expect_err(algorithm);
        assert_eq!(error.keys(), ["key"]);
        assert!(error.text.contains(words), "{algorithm}: {}", error.text);
    }
    for text in [
        "",
        "-----BEGIN PUBLIC KEY-----",
        "-----BEGIN PUBLIC KEY-----\n-----END PUBLIC KEY-----\n",
    ] {
        for algorithm in ["EdDSA", "ES256", "RS256"] {
            assert!(
                Verifier::new(&config(algorithm, text)).is_err(),
                "{algorithm} {text:?}"
            );
        }
    }
    assert!(Verifier::new(&config("HS256", secret)).is_ok());
}
