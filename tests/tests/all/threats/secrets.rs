//! What a broker writes down, with everything switched on: who did what, and nothing by which another could.

use std::net::SocketAddr;
use std::path::Path;

use mom_broker::TlsConfig;
use mom_proto::codec::Form;
use mom_proto::{Family, Map, Value};
use mom_tests::asking::Asking;
use mom_tests::bridge::Way;
use mom_tests::login::{AUDIENCE, DeviceKey, ISSUER, Issuer, challenge, claims, password, token};
use mom_tests::raw::{Raw, message};
use mom_tests::service::Home;
use mom_tests::tls;
use serde_json::json;

use super::CHAT;
use super::arena::create;

const PASSWORD: &str = "correct-Horse-7f3a";
const SAID: &str = "for-your-eyes-only-91c4";
/// 2040, in seconds.
const LATER: i64 = 2_208_988_800;

/// Everything is logged, audited, recorded and stored.
fn config() -> String {
    format!(
        r#"
[store]
path = "state"

[audit]
path = "audit.jsonl"

[record]
path = "control.jsonl"

[tls]
certificate = "hub.crt"
key = "hub.key"

[login.jwt]
issuer = "{ISSUER}"
audience = "{AUDIENCE}"
algorithms = ["EdDSA"]
key = "issuer.pem"
"#
    )
}

/// All that lies in a folder and was written by the broker, by its file's name.
fn written(folder: &Path, texts: &mut Vec<(String, Vec<u8>)>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("a file").path();
        let name = path.display().to_string();
        if path.is_dir() {
            written(&path, texts);
        } else if ![".toml", ".pem", ".crt", ".key"]
            .iter()
            .any(|end| name.ends_with(end))
        {
            texts.push((name, std::fs::read(&path).expect("a file")));
        }
    }
}

fn contains(bytes: &[u8], part: &[u8]) -> bool {
    !part.is_empty() && bytes.windows(part.len()).any(|window| window == part)
}

/// A secret as it is, and as logs and JSON might show it.
fn forms(secret: &[u8]) -> Vec<Vec<u8>> {
    use base64::Engine;
    use base64::engine::general_purpose::{STANDARD, URL_SAFE_NO_PAD};
    let hex: String = secret.iter().map(|byte| format!("{byte:02x}")).collect();
    let list: Vec<String> = secret.iter().map(u8::to_string).collect();
    vec![
        secret.to_vec(),
        STANDARD.encode(secret).into_bytes(),
        URL_SAFE_NO_PAD.encode(secret).into_bytes(),
        hex.into_bytes(),
        list.join(", ").into_bytes(),
    ]
}

/// Logs in by all three ways, speaks, drives, is refused, and gives what must be nowhere.
async fn live(home: &Home, device: &DeviceKey, issuer: &Issuer) -> Vec<(&'static str, Vec<u8>)> {
    let service = home.start().await;
    let address = service.address();
    let mut zoe = Raw::connect(address, Form::Xml).await;
    password(&mut zoe, "zoe", PASSWORD).await.expect("her password");
    let mut robot = Raw::connect(address, Form::Binary).await;
    let challenged = challenge(&mut robot, "zoe").await.expect("she has a key");
    let answer = device.answer(&challenged, "zoe");
    robot.ask(answer.clone()).await.expect("her key");
    let mut agent = Raw::connect(address, Form::Json).await;
    let jwt = issuer.sign(&claims("zoe", LATER));
    token(&mut agent, &jwt).await.expect("her token");

    let mut other = Raw::connect(address, Form::Json).await;
    password(&mut other, "zoe", PASSWORD).await.expect("her password");

    // A secret in the wrong place, refused ones, and secrets between people.
    let mut stranger = Raw::connect(address, Form::Xml).await;
    let wrong = format!("{PASSWORD}!");
    password(&mut stranger, "zoe", &wrong)
        .await
        .expect_err("not hers");
    password(&mut stranger, PASSWORD, "zoe")
        .await
        .expect_err("no user");
    for peer in [&mut zoe, &mut robot] {
        peer.join(&[CHAT]).await;
    }
    let mut said = message("say", CHAT, SAID);
    said.receipt = Some(true);
    zoe.ask(said).await.expect("she may talk");
    robot.next_of(Family::Message, "say").await;
    create(&mut zoe, "/own", Map::new().with("kind", "session")).await;
    zoe.join(&["/own"]).await;
    let token = Map::new().with("kind", "token").with("manager", "robot-token");
    create(&mut zoe, "/own/token", token).await;
    zoe.ask_about(Family::Token, "grab", "/own/token")
        .await
        .expect("it is free");
    let ids = at_doors(address, device, &jwt).await;
    assert_eq!(service.terminate().await.code(), Some(0));

    let nonce = binary(&challenged, "nonce");
    let signature = binary(&answer.value(), "signature");
    let (_, jwt_signature) = jwt.rsplit_once('.').expect("three parts");
    let ids = ids.into_iter().map(|id| ("the id of a tunnel", id.into_bytes()));
    let secrets = vec![
        ("the hub's key", key_line(&home.file("hub.key"))),
        ("the password", PASSWORD.as_bytes().to_vec()),
        ("what was said", SAID.as_bytes().to_vec()),
        ("the token", jwt_signature.as_bytes().to_vec()),
        ("the nonce", nonce),
        ("the signature", signature),
        ("a password's hash", b"argon2".to_vec()),
    ];
    secrets.into_iter().chain(ids).collect()
}

/// Logs in by all three ways through all other doors, and is refused there; gives the ids of a tunnel, by which another could
/// go on with it.
async fn at_doors(address: SocketAddr, device: &DeviceKey, jwt: &str) -> Vec<String> {
    for form in Form::ALL {
        for way in Way::beside(form) {
            let entrance = way.to(address, form).await;
            let mut zoe = Raw::connect(entrance, form).await;
            password(&mut zoe, "zoe", PASSWORD).await.expect("her password");
            let mut robot = Raw::connect(entrance, form).await;
            let asked = challenge(&mut robot, "zoe").await.expect("she has a key");
            robot.ask(device.answer(&asked, "zoe")).await.expect("her key");
            let mut agent = Raw::connect(entrance, form).await;
            token(&mut agent, jwt).await.expect("her token");
            let mut stranger = Raw::connect(entrance, form).await;
            let error = password(&mut stranger, PASSWORD, "zoe").await;
            let said = format!("{:?}", error.expect_err("no user"));
            assert!(!said.contains(PASSWORD), "{way}: {said}");
        }
    }
    // What belongs into no request, and is refused.
    for (first, line) in [
        (format!("GET /mom?password={PASSWORD}"), "Host: hub".to_owned()),
        (format!("POST /{PASSWORD}?token={jwt}"), "Host: hub".to_owned()),
        (
            format!("GET /tunnel/{PASSWORD}"),
            format!("Authorization: Bearer {jwt}"),
        ),
        (
            "GET /mom".to_owned(),
            format!("Cookie: password={PASSWORD}; token={jwt}"),
        ),
        ("GET /".to_owned(), format!("{PASSWORD} : {jwt}")),
        (format!("GET /{PASSWORD} {jwt}"), "Host: hub".to_owned()),
        (
            "GET /".to_owned(),
            format!("Origin: https://zoe:{PASSWORD}@example.org"),
        ),
        (
            "POST /tunnel/0".to_owned(),
            format!("Transfer-Encoding: {PASSWORD}"),
        ),
    ] {
        let mut asking = Asking::connect(address).await;
        let answer = asking.ask(&first, &[&line], b"").await;
        assert!(!format!("{answer:?}").contains(PASSWORD), "{first}: {answer:?}");
        assert!(
            !contains(&answer.body, PASSWORD.as_bytes()),
            "{first}: {answer:?}"
        );
    }
    let mut asking = Asking::connect(address).await;
    let opened = asking.ask("POST /tunnel", &["Host: hub"], b"").await;
    let before = opened.header("mom-tunnel").expect("an id").to_owned();
    let login = json!({"family": "login", "name": "login", "id": 1, "content": {"name": "zoe", "password": PASSWORD}});
    let first = format!("POST /tunnel/{before}?at=0");
    let renewed = asking
        .ask(&first, &["Host: hub"], format!("{login}\n").as_bytes())
        .await;
    let after = renewed.header("mom-tunnel").expect("another id").to_owned();
    vec![before, after]
}

/// A line of a key in PEM.
fn key_line(file: &Path) -> Vec<u8> {
    let text = std::fs::read_to_string(file).expect("a key");
    text.lines().nth(1).expect("a line").as_bytes().to_vec()
}

fn binary(map: &Value, key: &str) -> Vec<u8> {
    let bytes = map.get(key).and_then(Value::as_binary).expect("bytes");
    bytes.to_vec()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_secret_is_written_down() {
    let (device, issuer) = (DeviceKey::number(1), Issuer::number(2));
    let home = Home::new(&config());
    home.write_config(&format!("log = \"trace\"\n{}", home.config()));
    let TlsConfig { certificate, key, .. } = tls::of_hub();
    for (file, name) in [(certificate, "hub.crt"), (key, "hub.key")] {
        std::fs::copy(file.expect("a file"), home.file(name)).expect("copied");
    }
    std::fs::write(home.file("issuer.pem"), issuer.public_pem()).expect("a file");
    let hash = mom_broker::hash(PASSWORD).expect("a hash");
    let zoe = format!(
        "\n[[users]]\nname = \"zoe\"\npassword = \"{hash}\"\nkeys = [\"{}\"]\nlevel = 5\ngroups = [\"operator\"]\n",
        device.public()
    );
    home.write_users(&format!("{}{zoe}", home.users()));
    let secrets = live(&home, &device, &issuer).await;

    let mut texts = Vec::new();
    written(home.folder(), &mut texts);
    let wrote = |file: &str, part: &str| {
        let found = texts.iter().find(|(name, _)| name.ends_with(file));
        found.is_some_and(|(_, text)| contains(text, part.as_bytes()))
    };
    // It was all switched on, and each has what it is for.
    for (file, part) in [
        ("mom.log", "logged in"),
        ("mom.log", "login refused"),
        ("audit.jsonl", "\"granted\""),
        ("audit.jsonl", "\"bad-login\""),
        ("control.jsonl", "/own/token"),
    ] {
        assert!(wrote(file, part), "{part} in {file}");
    }
    for (what, secret) in secrets {
        for form in forms(&secret) {
            let found = texts.iter().find(|(_, text)| contains(text, &form));
            assert_eq!(found.map(|(name, _)| name), None, "{what}");
        }
    }
}
