//! What a user may see of the hub, as JSON.

use std::time::Duration;

use http::header::{ALLOW, HeaderMap, SET_COOKIE};
use http::{HeaderValue, Method, Request, Response, StatusCode};
use http_body_util::{BodyExt as _, Limited};
use hyper::body::Incoming;
use mom_client::{ContextInfo, ContextKind, Family, Parcel, Proof};
use mom_proto::{Map, Path, Value};
use serde::Deserialize;
use serde_json::{Value as Json, json};
use tokio::time::timeout;

use super::HttpConnection;
use super::answers::{Body, document, refuse, refuse_wire};
use super::visitors::{Visitor, refuse_client};

/// The time that a body has to come, and its bytes.
const BODY: Duration = Duration::from_secs(10);
const MOST: usize = 16 * 1024;

/// What a login brings.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Login {
    #[serde(default)]
    user: String,
    password: Option<String>,
    jwt: Option<String>,
}

type Answer = Result<Response<Body>, Response<Body>>;

impl HttpConnection {
    /// Answers what stands below `/api/`.
    pub(super) async fn api(&self, request: Request<Incoming>) -> Response<Body> {
        let path = request.uri().path().to_owned();
        let path = path.trim_start_matches("/api/");
        let (verb, rest) = path.split_once('/').unwrap_or((path, ""));
        let wanted = match verb {
            "login" | "logout" => Method::POST,
            _ => Method::GET,
        };
        if *request.method() != wanted && !(wanted == Method::GET && *request.method() == Method::HEAD) {
            let mut answer = refuse(
                StatusCode::METHOD_NOT_ALLOWED,
                "unknown-verb",
                &format!("use {wanted} here"),
            );
            let allowed = HeaderValue::from_static(if wanted == Method::GET {
                "GET, HEAD"
            } else {
                "POST"
            });
            answer.headers_mut().insert(ALLOW, allowed);
            return answer;
        }
        let place = match decode(rest) {
            Some(rest) => format!("/{}", rest.trim_end_matches('/')),
            None => {
                return refuse(
                    StatusCode::BAD_REQUEST,
                    "bad-path",
                    "%XX are two hexadecimal digits of UTF-8",
                );
            }
        };
        let answer = match (verb, rest) {
            ("login", "") => self.login(request).await,
            ("logout", "") => Ok(self.logout(request.headers())),
            ("console", "") => Ok(self.tell_console()),
            ("peers", "") => self.peers(request.headers()).await,
            ("contexts", _) => self.contexts(request.headers(), &place).await,
            ("image", _) => self.image(request.headers(), &place).await,
            _ => {
                let text = "there are console, login, logout, peers, contexts/PATH and image/PATH below /api";
                Err(refuse(StatusCode::NOT_FOUND, "unknown-path", text))
            }
        };
        answer.unwrap_or_else(|refusal| refusal)
    }

    /// What serves here, so that a page of another build notices; anybody may know.
    fn tell_console(&self) -> Response<Body> {
        let told = json!({
            "console": self.web.console(),
            "version": env!("CARGO_PKG_VERSION"),
            "hub": self.services.logins.hub(),
        });
        document(StatusCode::OK, &told)
    }

    async fn login(&self, request: Request<Incoming>) -> Answer {
        let (head, body) = request.into_parts();
        let body = timeout(BODY, Limited::new(body, MOST).collect()).await;
        let body = body.ok().and_then(Result::ok).ok_or_else(|| {
            refuse(
                StatusCode::BAD_REQUEST,
                "bad-content",
                "a login request must not exceed 16 KiB and must arrive within 10 s",
            )
        })?;
        let login: Login = serde_json::from_slice(&body.to_bytes()).map_err(|error| {
            // Its text says where, and never what stood there: that may be the password.
            let text = format!(
                "a login is {{\"user\": …, \"password\": …}} or {{\"jwt\": …}}, in JSON: line {}, column {}",
                error.line(),
                error.column()
            );
            refuse(StatusCode::BAD_REQUEST, "bad-content", &text)
        })?;
        let proof = match (login.password, login.jwt) {
            (Some(password), None) => Proof::Password(password),
            (None, Some(jwt)) => Proof::Token(jwt),
            (None, None) => Proof::Guest,
            (Some(_), Some(_)) => {
                let text = "a login has a password or a token, not both";
                return Err(refuse(StatusCode::BAD_REQUEST, "bad-content", text));
            }
        };
        let (client, cookie) = self.begin_visit(&head.headers, &login.user, proof).await?;
        let known = json!({ "user": client.user(), "peer": client.name(), "level": client.level() });
        let mut answer = document(StatusCode::OK, &known);
        answer.headers_mut().insert(SET_COOKIE, cookie);
        Ok(answer)
    }

    fn logout(&self, headers: &HeaderMap) -> Response<Body> {
        let cookie = self.end_visit(headers);
        let mut answer = document(StatusCode::OK, &json!({}));
        answer.headers_mut().insert(SET_COOKIE, cookie);
        answer
    }

    /// The peers, as `context stats` of the root tells them to whom it is permitted.
    async fn peers(&self, headers: &HeaderMap) -> Answer {
        let visitor = self.visitor(headers).await?;
        let stats = visitor.stats().await?;
        let mut found = Map::new();
        for key in ["time", "peers", "more-peers"] {
            if let Some(value) = stats.get(key) {
                found.set(key, value.clone());
            }
        }
        Ok(document(StatusCode::OK, &to_json(&found)))
    }

    /// One context with what the user may know of it; of a session its children too.
    async fn contexts(&self, headers: &HeaderMap, path: &str) -> Answer {
        let visitor = self.visitor(headers).await?;
        let client = &visitor.client;
        let path = match path {
            "/" => Path::root(),
            path => Path::parse(path).map_err(|error| refuse_wire(&error))?,
        };
        let info = client.info(path.as_str()).await;
        let info = info.map_err(|error| refuse_client(&error))?;
        let mut found = to_json(&info);
        if info.get("kind").and_then(Value::as_str) == Some(ContextKind::Session.word()) {
            let children = client.list(path.as_str()).await;
            let children = children.map_err(|error| refuse_client(&error))?;
            found["contexts"] = children.iter().map(summary).collect();
        }
        Ok(document(StatusCode::OK, &found))
    }
}

impl Visitor {
    /// The figures of the hub, if the user may have them.
    pub(super) async fn stats(&self) -> Result<Map, Response<Body>> {
        let request = Parcel::new(Family::Context, "stats").context(Path::root());
        let reply = self.client.request(request).await;
        match reply.map_err(|error| refuse_client(&error))?.value() {
            Value::Map(map) => Ok(map),
            _ => Ok(Map::new()),
        }
    }
}

fn summary(info: &ContextInfo) -> Json {
    let mut json = json!({
        "path": info.path.as_str(),
        "kind": info.kind.word(),
        "number": info.number,
    });
    if let Some(members) = info.members {
        json["members"] = members.into();
    }
    json
}

fn to_json(map: &Map) -> Json {
    // Every value of the wire has a form in JSON.
    serde_json::to_value(map).unwrap_or_default()
}

/// Undoes `%XX`.
fn decode(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte != b'%' {
            bytes.push(byte);
            continue;
        }
        let (digits, after) = rest.split_first_chunk::<2>()?;
        let digit = |byte: u8| char::from(byte).to_digit(16);
        bytes.push(u8::try_from(digit(digits[0])? * 16 + digit(digits[1])?).ok()?);
        rest = after;
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::decode;

    #[test]
    fn paths_are_decoded_once() {
        for (text, decoded) in [
            ("lab/camera", Some("lab/camera")),
            ("caf%C3%A9", Some("café")),
            ("%2525", Some("%25")),
            ("%2", None),
            ("%zz", None),
            ("%+1", None),
            ("%ff", None),
        ] {
            assert_eq!(decode(text).as_deref(), decoded, "{text}");
        }
    }
}
