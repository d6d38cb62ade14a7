use std::future::pending;

use mom_wheels::{Chassis, Driver, DriverError, Fault, Motors, Sensors, Simulated, WheelTime};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::task::JoinHandle;

use super::*;
use crate::{Options, Robot, Rules, serve_observed};

const PATIENCE: Duration = Duration::from_secs(30);

/// A robot and its page, each on a port of its own.
struct Served {
    control: SocketAddr,
    page: SocketAddr,
    _tasks: [Task; 2],
}

struct Task(JoinHandle<()>);

impl Drop for Task {
    fn drop(&mut self) {
        self.0.abort();
    }
}

async fn start(driver: Box<dyn Driver>, access: Access, eye: Option<Eye>) -> Served {
    start_with(driver, access, eye, None).await
}

async fn start_with(
    driver: Box<dyn Driver>,
    access: Access,
    eye: Option<Eye>,
    login: Option<Login>,
) -> Served {
    let [control, page] = [
        TcpListener::bind("127.0.0.1:0").await.expect("a free port"),
        TcpListener::bind("127.0.0.1:0").await.expect("a free port"),
    ];
    let address = |listener: &TcpListener| listener.local_addr().expect("it has one");
    let (at, page_at) = (address(&control), address(&page));
    let (observer, observed) = Observed::pair();
    let robot = Robot::new(driver, Chassis::LINUXBOT, Rules::default());
    let served = Page {
        unit: 7,
        access,
        login,
        observer,
        eye: eye.map(Arc::new),
    };
    let control = tokio::spawn(async move {
        let _ = serve_observed(control, robot, Options::default(), Some(observed), pending()).await;
    });
    let page = tokio::spawn(serve_page(page, served));
    Served {
        control: at,
        page: page_at,
        _tasks: [Task(control), Task(page)],
    }
}

async fn linuxbot() -> Served {
    let driver = Simulated::linuxbot();
    let eye = Eye::new(driver.floor());
    start(Box::new(driver), Access::default(), Some(eye)).await
}

/// Status line and headers, and the body.
async fn ask(address: SocketAddr, request: &str) -> (String, Vec<u8>) {
    ask_with(address, request, "").await
}

/// The same with more lines of the head.
async fn ask_with(address: SocketAddr, request: &str, head: &str) -> (String, Vec<u8>) {
    let asked = async {
        let mut stream = TcpStream::connect(address).await.expect("it listens");
        let request = format!("{request} HTTP/1.1\r\nHost: robot\r\n{head}\r\n");
        stream.write_all(request.as_bytes()).await.expect("it reads");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).await.expect("it answers");
        answer
    };
    let answer = timeout(PATIENCE, asked).await.expect("in time");
    let end = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n");
    let (head, body) = answer.split_at(end.expect("a head") + 4);
    (String::from_utf8_lossy(head).into_owned(), body.to_vec())
}

#[tokio::test]
async fn who_has_not_logged_in_is_shown_nothing() {
    let driver = Simulated::linuxbot();
    let eye = Eye::new(driver.floor());
    let login = Login::parse("alice:open:sesame").expect("a login");
    let served = start_with(Box::new(driver), Access::default(), Some(eye), Some(login)).await;
    // alice:open:sesame, and with a letter less, another one, and one more.
    let right = "YWxpY2U6b3BlbjpzZXNhbWU=";
    for (header, is_in) in [
        (String::new(), false),
        (format!("Authorization: Basic {right}\r\n"), true),
        (format!("authorization: basic {right}\r\n"), true),
        (format!("Authorization: Bearer {right}\r\n"), false),
        (
            "Authorization: Basic YWxpY2U6b3BlbjpzZXNhbQ==\r\n".to_owned(),
            false,
        ),
        (
            "Authorization: Basic YWxpY2U6b3BlbjpzZXNhbWU0\r\n".to_owned(),
            false,
        ),
        ("Authorization: Basic Ym9iOm9wZW46c2VzYW1l\r\n".to_owned(), false),
        ("Authorization: Basic \r\n".to_owned(), false),
        ("Authorization: Basic ???\r\n".to_owned(), false),
    ] {
        for path in ["/", "/status.json", "/camera.jpg", "/secret"] {
            let (head, body) = ask_with(served.page, &format!("GET {path}"), &header).await;
            let body = String::from_utf8_lossy(&body);
            if is_in {
                assert!(!head.contains(" 401 "), "{path} {header}: {head}");
                continue;
            }
            assert!(
                head.starts_with("HTTP/1.1 401 ")
                    && head.contains("www-authenticate: Basic realm=\"robot 7\"")
            );
            assert!(
                body.starts_with("this page requires a login"),
                "{path} {header}: {body}"
            );
        }
    }
}

#[tokio::test]
async fn each_path_has_its_answer_and_others_have_words() {
    let served = linuxbot().await;
    for (request, status, media_type, said) in [
        ("GET /", "200 OK", "text/html; charset=utf-8", "<td>nobody</td>"),
        ("GET /?again=1", "200 OK", "text/html; charset=utf-8", "Robot 7"),
        (
            "GET /status.json",
            "200 OK",
            "application/json",
            "\"battery\":100",
        ),
        ("GET /camera.jpg", "200 OK", "image/jpeg", "JFIF"),
        (
            "GET /secret",
            "404 Not Found",
            "text/plain; charset=utf-8",
            "a robot has /, /status.json and /camera.jpg\n",
        ),
        (
            "GET /../etc/passwd",
            "404 Not Found",
            "text/plain; charset=utf-8",
            "a robot has",
        ),
        (
            "POST /",
            "405 Method Not Allowed",
            "text/plain; charset=utf-8",
            "GET and HEAD",
        ),
        (
            "DELETE /camera.jpg",
            "405 Method Not Allowed",
            "text/plain; charset=utf-8",
            "GET and HEAD",
        ),
    ] {
        let (head, body) = ask(served.page, request).await;
        assert!(
            head.starts_with(&format!("HTTP/1.1 {status}\r\n")),
            "{request}: {head}"
        );
        for line in [
            &*format!("content-type: {media_type}\r\n"),
            "cache-control: no-store\r\n",
            "content-security-policy: default-src 'none';",
            "connection: close\r\n",
        ] {
            assert!(head.contains(line), "{request}: {line} in {head}");
        }
        let body = String::from_utf8_lossy(&body);
        assert!(body.contains(said), "{request}: {body}");
        assert_eq!(
            head.contains("allow: GET, HEAD\r\n"),
            status.starts_with("405"),
            "{head}"
        );
        // The same without the body.
        if let Some(path) = request.strip_prefix("GET ") {
            let (only, nothing) = ask(served.page, &format!("HEAD {path}")).await;
            assert!(only.starts_with(&format!("HTTP/1.1 {status}\r\n")), "{only}");
            assert!(only.contains("content-length: "), "{only}");
            assert!(nothing.is_empty(), "HEAD {path}");
        }
    }
}

#[tokio::test]
async fn the_page_tells_who_drives_and_what_they_do() {
    let served = linuxbot().await;
    let mut station = TcpStream::connect(served.control).await.expect("it listens");
    let said = b"06 00100 -010007 0000504";
    station.write_all(said).await.expect("it reads");
    let mut reply = [0; 8];
    station.read_exact(&mut reply).await.expect("a STATUS");
    let (_, body) = ask(served.page, "GET /status.json").await;
    let state: serde_json::Value = serde_json::from_slice(&body).expect("JSON");
    let station = station.local_addr().expect("it has one");
    for (key, value) in [
        ("unit", 7.into()),
        ("left", 100.into()),
        ("right", (-100).into()),
        ("leds", 5.into()),
        ("moving", true.into()),
        ("x", 2500.0.into()),
        ("station", station.to_string().into()),
    ] {
        let value: serde_json::Value = value;
        assert_eq!(state[key], value, "{key} in {state}");
    }
}

#[tokio::test]
async fn those_who_may_not_drive_may_not_look() {
    let driver = Simulated::linuxbot();
    let elsewhere = Access::only(["192.168.1.5".parse().expect("an address")]);
    let served = start(Box::new(driver), elsewhere, Some(Eye::new(Floor::ARENA))).await;
    for request in ["GET /", "GET /camera.jpg", "POST /x"] {
        let (head, body) = ask(served.page, request).await;
        assert!(head.starts_with("HTTP/1.1 403 Forbidden\r\n"), "{head}");
        let said = String::from_utf8_lossy(&body);
        assert!(said.starts_with("127.0.0.1 is not allowed to drive"), "{said}");
    }
}

/// A robot that cannot be read.
struct Broken;

impl Driver for Broken {
    fn set_motors(&mut self, _: Motors, _: WheelTime) -> Result<(), DriverError> {
        Ok(())
    }

    fn set_leds(&mut self, _: u8, _: WheelTime) -> Result<(), DriverError> {
        Ok(())
    }

    fn sensors(&mut self, _: WheelTime) -> Result<Sensors, DriverError> {
        Err(DriverError::new(Fault::Sensors, "they are unplugged"))
    }

    fn next_wake(&mut self) -> Option<WheelTime> {
        None
    }
}

#[tokio::test]
async fn a_robot_without_sensors_eyes_or_odometry_says_so() {
    let broken = start(Box::new(Broken), Access::default(), Some(Eye::new(Floor::ARENA))).await;
    let (head, body) = ask(broken.page, "GET /").await;
    assert!(head.starts_with("HTTP/1.1 503 "), "{head}");
    assert_eq!(body, b"the sensors of this robot cannot be read\n");
    let blind = Simulated::linuxbot();
    let lost = Simulated::linuxbot().without_odometry();
    for (driver, eye) in [(blind, None), (lost, Some(Eye::new(Floor::ARENA)))] {
        let served = start(Box::new(driver), Access::default(), eye).await;
        let (head, body) = ask(served.page, "GET /camera.jpg").await;
        assert!(head.starts_with("HTTP/1.1 404 "), "{head}");
        assert_eq!(body, b"this robot has no camera\n");
    }
}

#[tokio::test]
async fn seventeen_at_once_are_one_too_many_and_a_silent_one_goes() {
    let served = linuxbot().await;
    let mut silent = Vec::new();
    for _ in 0..MOST {
        silent.push(TcpStream::connect(served.page).await.expect("it listens"));
    }
    let mut one_more = TcpStream::connect(served.page).await.expect("it listens");
    let closed = timeout(PATIENCE, one_more.read(&mut [0])).await.expect("at once");
    assert!(matches!(closed, Ok(0) | Err(_)), "{closed:?}");
    // Meanwhile the robot is driven.
    let mut station = TcpStream::connect(served.control).await.expect("it listens");
    station.write_all(b"00").await.expect("it reads");
    station.read_exact(&mut [0; 2]).await.expect("a NULL");
    let mut first = silent.swap_remove(0);
    let mut said = Vec::new();
    let _ = timeout(PATIENCE, first.read_to_end(&mut said))
        .await
        .expect("it is closed");
    let (head, _) = ask(served.page, "GET /").await;
    assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
}
