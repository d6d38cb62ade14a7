//! Threats 2, 4, 5, 6 and 13 in JSON: what stands in a line, and where it ends.

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Value};
use mom_tests::raw::{Raw, at, message};

use super::{After, CHAT, World, chat_json};

/// Threat 2: levels without end, also where each is in a tag.
#[tokio::test]
async fn threat_2_nesting_in_json() {
    let mut world = World::start().await;
    for (what, level) in [
        ("lists", "["),
        ("maps", "{\"a\":"),
        ("tags", "{\"$map\":{\"$a\":"),
    ] {
        for levels in [33, 1000, 8 * 1024 * 1024 / level.len() - 100] {
            let bytes = chat_json(format!("\"content\":{}", level.repeat(levels)));
            let what = format!("{levels} {what}");
            let error = world
                .attack(&what, Form::Json, &bytes, "too-deep", After::Kept)
                .await;
            let position = error.get("position").and_then(Value::as_int).expect("a position");
            assert!(
                position < 1000,
                "{what} are refused before the rest is read: {error:?}"
            );
        }
    }
    world.end().await;
}

/// Threat 4: what is kept of a stranger is bounded at once, not when its line ends.
#[tokio::test]
async fn threat_4_lines_before_login() {
    before_login(World::start().await).await;
}

pub(super) async fn before_login(mut world: World) {
    let endless = chat_json(format!("\"content\":\"{}", "x".repeat(17 * 1024)));
    let endless = &endless[..16 * 1024 + 1];
    let blank = [b"{}\n".to_vec(), vec![b' '; 16 * 1024 + 1]].concat();
    for (what, bytes) in [("a line without end", endless), ("blanks without end", &blank)] {
        let mut stranger = world.stranger(Form::Json).await;
        stranger.send(bytes).await;
        assert_eq!(
            stranger.last_error().await.expect("a reason").word(),
            "too-large",
            "{what}"
        );
        world.check_nothing_arrived(what).await;
    }
    let stranger = world.stranger(Form::Json).await;
    let bytes = chat_json("\"content\":\"psst\"");
    world
        .attack_from(stranger, "a message", &bytes, "not-logged-in", After::Kept)
        .await;
    world.end().await;
}

/// Threat 5: text that is none, as it is and escaped.
#[tokio::test]
async fn threat_5_encoding_in_json() {
    encoding(World::start().await).await;
}

pub(super) async fn encoding(mut world: World) {
    encoding_that(&mut world, After::Kept).await;
    world.end().await;
}

/// After bytes that are no UTF-8 a text message of WebSocket is over, and with it the connection (RFC 6455, 8.1).
pub(super) async fn encoding_that(world: &mut World, after_no_text: After) {
    let with = |bytes: &[u8]| chat_json([b"\"content\":\"", bytes, b"\""].concat());
    for (what, bytes, code) in [
        ("no UTF-8", &b"\xff"[..], "bad-encoding"),
        ("overlong", b"\xc0\xaf", "bad-encoding"),
        ("a surrogate in UTF-8", b"\xed\xa0\x80", "bad-encoding"),
        ("half a character", b"\xe2\x82", "bad-encoding"),
        ("NUL", b"a\0b", "bad-encoding"),
        ("an escape sequence", b"\x1b[2J", "bad-encoding"),
        ("U+FFFE", b"\xef\xbf\xbe", "bad-encoding"),
        ("NUL escaped", b"\\u0000", "bad-encoding"),
        ("an escape sequence escaped", b"\\u001b[2J", "bad-encoding"),
        ("U+FFFE escaped", b"\\ufffe", "bad-encoding"),
        ("a lone surrogate", b"\\ud800", "bad-json"),
        ("the other alone", b"\\udc00", "bad-json"),
        ("two of one kind", b"\\ud800\\ud800", "bad-json"),
        ("a tab as it is", b"\t", "bad-json"),
    ] {
        let (code, after) = match (std::str::from_utf8(bytes), after_no_text) {
            (Err(_), After::Closed) => ("bad-frame", After::Closed),
            _ => (code, After::Kept),
        };
        world.attack(what, Form::Json, &with(bytes), code, after).await;
    }
    let marked = ["\u{feff}".as_bytes(), &with(b"")].concat();
    world
        .attack(
            "a byte order mark",
            Form::Json,
            &marked,
            "bad-encoding",
            After::Kept,
        )
        .await;
}

/// Threat 6: lines that are no parcel, cut or joined, and one that is longer than any may be.
#[tokio::test]
async fn threat_6_lines() {
    lines(World::start().await).await;
}

pub(super) async fn lines(mut world: World) {
    let smuggled = chat_json("\"content\":\"smuggled\"");
    let whole = &smuggled[..smuggled.len() - 1];
    for (what, bytes, code) in [
        ("two in one line", [whole, &smuggled].concat(), "bad-json"),
        ("one in a list", [b"[", whole, b"]\n"].concat(), "bad-json"),
        ("cut", [&whole[..whole.len() - 1], b"\n"].concat(), "bad-json"),
        (
            "a slot twice",
            chat_json("\"content\":\"a\",\"content\":\"b\""),
            "bad-slot",
        ),
        (
            "an escaped key twice",
            chat_json("\"content\":\"a\",\"c\\u006fntent\":\"b\""),
            "bad-slot",
        ),
        (
            "a tag and more",
            chat_json("\"content\":{\"$map\":{},\"sender\":\"hub\"}"),
            "bad-slot",
        ),
        (
            "half a million numbers in a slot",
            chat_json(format!("\"a\":[{}0]", "0,".repeat(500_000))),
            "too-long",
        ),
    ] {
        world.attack(what, Form::Json, &bytes, code, After::Kept).await;
    }
    let most = vec![b'x'; 8 * 1024 * 1024];
    let endless = [&b"{\"content\":\""[..], &most].concat();
    world
        .attack(
            "8 MiB and no end",
            Form::Json,
            &endless,
            "too-large",
            After::Closed,
        )
        .await;
    world.end().await;
}

/// Threat 13: what would be a tag in JSON is what it is in every other form.
#[tokio::test]
async fn threat_13_tags_between_forms() {
    let world = World::start().await;
    let mut heard = Vec::new();
    for form in Form::ALL {
        let mut peer = Raw::login(world.address(), form, "carol").await;
        peer.join(&[CHAT]).await;
        heard.push(peer);
    }
    let content = Map::new()
        .with("like a tag", Map::new().with("$time", "now").with("b", 1))
        .with("like two", Map::new().with("$map", Map::new().with("$int", "1")))
        .with("large", i64::MAX)
        .with("whole", Value::Double(1.0))
        .with("markup", "</content>\"}\n{\"family\":\"login\"}\\\r\n");
    for form in Form::ALL {
        let mut bob = world.attacker(form).await;
        let mut said = message("chat", CHAT, content.clone());
        said.extra.set("$sender", Map::new().with("$binary", "AAEC"));
        bob.post(said.clone()).await;
        for peer in &mut heard {
            let parcel = peer.next_of(Family::Message, "chat").await;
            assert_eq!(parcel.value(), said.value(), "{form:?} to {:?}", peer.form());
            assert_eq!(parcel.extra, said.extra, "{form:?} to {:?}", peer.form());
            assert_eq!(parcel.context, Some(at(CHAT)));
        }
    }
    world.end().await;
}
