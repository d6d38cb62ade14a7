//! Threat 11: paths and names that would lead somewhere else.

use mom_proto::codec::Form;
use mom_proto::{Family, Map, Parcel, Value};
use mom_tests::raw::Raw;

use super::{After, World, entity, frame};

pub(super) fn join_xml(path: &str) -> Vec<u8> {
    let path = path.replace('&', "&amp;").replace('<', "&lt;");
    entity(format!(
        "<parcel><family>context</family><name>join</name><id>7</id><context>{path}</context></parcel>"
    ))
}

pub(super) fn join_json(path: &str) -> Vec<u8> {
    let path = path.replace('\\', "\\\\").replace('\0', "\\u0000");
    let line = format!("{{\"family\":\"context\",\"name\":\"join\",\"id\":7,\"context\":\"{path}\"}}\n");
    line.into_bytes()
}

/// `join`, id 7, the path, in each form.
pub(super) fn joins(path: &str) -> [(Form, Vec<u8>); 3] {
    [
        (Form::Xml, join_xml(path)),
        (Form::Binary, join_binary(path)),
        (Form::Json, join_json(path)),
    ]
}

/// `join`, id 7, the path: bits name, id, family, context by path.
pub(super) fn join_binary(path: &str) -> Vec<u8> {
    let mut bytes = vec![0, 0x92, 0x88, 0x10, 17 << 1 | 1, 7, 2];
    let mut length = path.len();
    while length >= 0x80 {
        bytes.push((length & 0x7f) as u8 | 0x80);
        length >>= 7;
    }
    bytes.push(length as u8);
    bytes.extend_from_slice(path.as_bytes());
    frame(&bytes)
}

/// Threat 11: one canonical form; what is not in it is refused, in all wire forms.
#[tokio::test]
async fn threat_11_paths() {
    let mut world = World::start().await;
    let long = format!("/{}", "a".repeat(1024));
    let most = format!("/{}", "a".repeat(63 * 1024));
    let deep = "/a".repeat(1000);
    for path in [
        "/robot/../chat",
        "/chat/..",
        "/./chat",
        "//chat",
        "/chat/",
        "/robot//arm",
        "chat",
        "",
        "/%2e%2e/chat",
        "/chat%00",
        "\\chat",
        "/robot\\arm",
        "/*",
        "/#",
        "/chat?x",
        "/chat#x",
        "/chat;x",
        " /chat",
        "/chat ",
        "/ch\u{200b}at",
        "/\u{202e}tahc",
        "/cafe\u{301}",
        "/<b>",
        long.as_str(),
        &most,
        &deep,
    ] {
        let what: String = path.chars().take(30).collect();
        for (form, bytes) in joins(path) {
            let error = world.attack(&what, form, &bytes, "bad-path", After::Kept).await;
            assert_eq!(error.get("slot"), Some(&Value::from("context")), "{what}");
        }
    }
    for (form, bytes) in joins("/chat\0") {
        world
            .attack("NUL", form, &bytes, "bad-encoding", After::Kept)
            .await;
    }
    let megabyte = format!("/{}", "a".repeat(1024 * 1024));
    // The binary decoder looks at each slot before it looks at all.
    for (form, bytes, code) in [
        (Form::Xml, join_xml(&megabyte), "too-long"),
        (Form::Binary, join_binary(&megabyte), "bad-path"),
        (Form::Json, join_json(&megabyte), "too-long"),
    ] {
        world.attack("1 MB", form, &bytes, code, After::Kept).await;
    }
    let huge = format!("/{}", "a".repeat(10 * 1024 * 1024));
    for (form, bytes) in joins(&huge) {
        world
            .attack("10 MB", form, &bytes, "too-large", After::Closed)
            .await;
    }
    world.end().await;
}

/// Threat 11: look-alikes of paths are other paths, and rules apply to what is there.
#[tokio::test]
async fn threat_11_look_alikes_lead_nowhere() {
    let world = World::start().await;
    for form in Form::ALL {
        let mut bob = Raw::login(world.address(), form, "bob").await;
        // Capitals and dots: paths, but of nothing. What cannot be told from another by the eye is not a path at all.
        for path in ["/CHAT", "/Chat", "/chat.", "/chat/x"] {
            let error = bob
                .ask_about(Family::Context, "join", path)
                .await
                .expect_err(path);
            assert_eq!(error.code.word(), "unknown-path", "{path}");
        }
        // What bob may not do there he may not do by any name.
        for path in ["/robot", "/robot/token", "/camera/x"] {
            let error = bob
                .ask_about(Family::Context, "delete", path)
                .await
                .expect_err(path);
            assert_eq!(error.code.word(), "denied", "{path}");
        }
        bob.check_alive().await;
    }
    world.end().await;
}

/// Threat 11: users and nicknames that would be patterns, paths, or another user's.
#[tokio::test]
async fn threat_11_users() {
    let world = World::start().await;
    let login = |name: &str, nickname: Option<&str>| {
        let mut content = Map::new().with("name", name).with("password", "bob");
        if let Some(nickname) = nickname {
            content.set("nickname", nickname);
        }
        Parcel::new(Family::Login, "login").content(content)
    };
    for user in [
        "*",
        "#",
        "..",
        "/",
        "hub",
        "bob\u{200b}",
        "b\u{43e}b",
        "BOB",
        "bob~2",
        "bob ",
    ] {
        let mut stranger = Raw::connect(world.address(), Form::Xml).await;
        let error = stranger.ask(login(user, None)).await.expect_err(user);
        assert_eq!(error.code.word(), "bad-login", "{user:?}");
        stranger.check_alive().await;
    }
    for nickname in [
        "*",
        "#",
        "..",
        "a/b",
        "hub",
        "alice",
        "arm",
        "a\u{202e}b",
        "al\u{200b}",
        "e\u{301}",
        "bob~2",
        "a b",
    ] {
        for form in Form::ALL {
            let mut stranger = Raw::connect(world.address(), form).await;
            let error = stranger
                .ask(login("bob", Some(nickname)))
                .await
                .expect_err(nickname);
            assert_eq!(error.code.word(), "bad-name", "{nickname:?}");
            assert_eq!(error.get("slot"), Some(&Value::from("content/nickname")));
            stranger.log_in("bob").await;
        }
    }
    world.end().await;
}
