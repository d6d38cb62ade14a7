//! Threat 12: names that look like other names. Each is the same name, or none.

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value, WireError};
use mom_tests::raw::Raw;

use super::arena::create;
use super::names::joins;
use super::{After, World};

/// What looks like `alice`, and is not.
const ALICES: [&str; 18] = [
    "\u{430}lice",                         // Cyrillic а
    "al\u{456}ce",                         // Cyrillic і
    "alic\u{435}",                         // Cyrillic е
    "\u{430}\u{4cf}\u{456}\u{441}\u{435}", // all of it Cyrillic: аӏісе
    "\u{3b1}lice",                         // Greek α
    "\u{251}lice",                         // Latin ɑ
    "\u{ff41}lice",                        // full width
    "al\u{131}ce",                         // ı without its dot
    "a\u{200b}lice",                       // zero width space
    "alice\u{200d}",                       // zero width joiner
    "\u{2060}alice",                       // word joiner
    "\u{feff}alice",                       // byte order mark
    "ali\u{ad}ce",                         // soft hyphen
    "alice\u{fe0f}",                       // a variation of e
    "alice\u{34f}",                        // a joiner that counts as a mark
    "alice\u{3164}",                       // a filler that counts as a letter
    "\u{202e}ecila",                       // written from right to left
    "a\u{2066}lice\u{2069}",               // isolated
];

/// Zoë in two characters for ë: the same name by looks, which only one spelling may have.
const DECOMPOSED: &str = "Zoe\u{308}";
const COMPOSED: &str = "Zo\u{eb}";

async fn login(peer: &mut Raw, user: &str, nickname: Option<&str>) -> Result<Value, WireError> {
    let mut content = Map::new().with("name", user).with("password", user);
    if let Some(nickname) = nickname {
        content.set("nickname", nickname);
    }
    let login = Parcel::new(Family::Login, "login").content(content);
    peer.ask(login).await.map(|welcome| welcome.value())
}

/// Threat 12: nobody has a name that others would read as another user's.
#[tokio::test]
async fn threat_12_nicknames() {
    let world = World::start().await;
    for form in Form::ALL {
        let mut bob = Raw::connect(world.address(), form).await;
        for nickname in ALICES.into_iter().chain([DECOMPOSED]) {
            let error = login(&mut bob, "bob", Some(nickname)).await.expect_err(nickname);
            assert_eq!(error.code.word(), "bad-name", "{nickname:?}: {error}");
            assert_eq!(error.get("slot"), Some(&Value::from("content/nickname")));
        }
        // Letters of any one script are a name, also with digits, and those that are written together.
        for nickname in [COMPOSED, "Маша", "Ελένη", "名前", "арм-2", "Tokyo東京タワー"] {
            let welcome = login(&mut bob, "bob", Some(nickname)).await.expect(nickname);
            assert!(welcome.get("peer").is_some());
            bob = Raw::connect(world.address(), form).await;
        }
    }
    let tried = Form::ALL.len() as u64 * (ALICES.len() as u64 + 1);
    let refused = [("what", "refused"), ("user", "bob"), ("code", "bad-name")];
    assert_eq!(world.end().await.count(&refused), tried);
}

/// Threat 12: a user's look-alike is not a user, and no token of guessing who is.
#[tokio::test]
async fn threat_12_users() {
    let world = World::start_with(|config| {
        config.login.throttle.per_address.burst = 1000;
        config.login.throttle.per_account.burst = 1000;
    })
    .await;
    for form in Form::ALL {
        for user in ALICES.into_iter().chain([DECOMPOSED]) {
            let mut stranger = Raw::connect(world.address(), form).await;
            let content = Map::new().with("name", user).with("password", "alice");
            let login = Parcel::new(Family::Login, "login").content(content);
            let error = stranger.ask(login).await.expect_err(user);
            let code = error.code.word();
            assert!(matches!(code, "bad-login" | "bad-name"), "{user:?}: {error}");
        }
    }
    world.end().await;
}

/// Threat 12: beside a context there is none that looks like it, and none is reached by another's looks.
#[tokio::test]
async fn threat_12_paths() {
    let mut world = World::start().await;
    for path in [
        "/r\u{43e}bot",       // Cyrillic о
        "/robot\u{200b}",     // zero width space
        "/rob\u{fe0f}ot",     // a variation of b
        "/robot\u{3164}",     // a filler
        "/\u{ff52}obot",      // full width
        "/\u{202e}tobor",     // written from right to left
        "/robot/t\u{43e}ken", // below
        "/cafe\u{301}",       // é in two characters
    ] {
        for (form, bytes) in joins(path) {
            world.attack(path, form, &bytes, "bad-path", After::Kept).await;
        }
    }
    let mut carol = Raw::login(world.address(), Form::Xml, "carol").await;
    for path in ["/caf\u{e9}", "/цех", "/цех/арм-2", "/東京lab"] {
        create(&mut carol, path, Map::new().with("kind", "session")).await;
        carol.join(&[path]).await;
    }
    world.end().await;
}
