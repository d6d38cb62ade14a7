//! What requests are answered with.

use http::header::{
    ACCESS_CONTROL_ALLOW_CREDENTIALS, ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS,
    ACCESS_CONTROL_ALLOW_ORIGIN, ACCESS_CONTROL_EXPOSE_HEADERS, CACHE_CONTROL, CONTENT_TYPE, HeaderMap,
    RETRY_AFTER, VARY, WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS,
};
use http::{HeaderValue, Response, StatusCode};
use mom_proto::{Code, WireError};
use serde_json::json;

/// The body of every answer.
pub(super) type Body = mom_net::TunnelBody;

/// Bytes of this media type.
pub(super) fn bytes(
    status: StatusCode,
    media: &'static str,
    bytes: impl Into<bytes::Bytes>,
) -> Response<Body> {
    let mut answer = Response::new(Body::whole(bytes));
    *answer.status_mut() = status;
    let headers = answer.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(media));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    answer
}

/// Text for people.
pub(super) fn text(status: StatusCode, text: impl Into<bytes::Bytes>) -> Response<Body> {
    bytes(status, "text/plain; charset=utf-8", text)
}

/// JSON for programs.
pub(super) fn document(status: StatusCode, document: &serde_json::Value) -> Response<Body> {
    bytes(status, "application/json", format!("{document}\n"))
}

/// An error, in the words of the protocol.
pub(super) fn refuse(status: StatusCode, code: &str, text: &str) -> Response<Body> {
    document(status, &json!({ "code": code, "text": text }))
}

/// An error of the hub.
pub(super) fn refuse_wire(error: &WireError) -> Response<Body> {
    let code = &error.code;
    let status = match code {
        _ if [Code::BAD_LOGIN, Code::NOT_LOGGED_IN, Code::REVOKED].contains(code) => StatusCode::UNAUTHORIZED,
        _ if [Code::DENIED, Code::INSECURE, Code::NOT_MEMBER, Code::NOT_TAKEN].contains(code) => {
            StatusCode::FORBIDDEN
        }
        _ if [Code::UNKNOWN_PATH, Code::UNKNOWN_PEER, Code::TIMED_OUT].contains(code) => {
            StatusCode::NOT_FOUND
        }
        _ if [Code::TOO_LARGE, Code::TOO_LONG].contains(code) => StatusCode::PAYLOAD_TOO_LARGE,
        _ if [Code::TRY_LATER, Code::TOO_MANY_LOGINS].contains(code) => StatusCode::TOO_MANY_REQUESTS,
        _ if code.may_retry() || (300..400).contains(&code.number()) => StatusCode::SERVICE_UNAVAILABLE,
        _ => StatusCode::BAD_REQUEST,
    };
    let mut answer = refuse(status, code.word(), &error.text);
    let headers = answer.headers_mut();
    if status == StatusCode::UNAUTHORIZED {
        headers.insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"mom\""));
    }
    if let Some(wait) = error.retry_in() {
        headers.insert(
            RETRY_AFTER,
            HeaderValue::from(wait.as_millis().div_ceil(1000) as u64),
        );
    }
    answer
}

/// An answer that nobody has asked for, before the connection is closed.
pub(super) fn raw(status: StatusCode, error: &WireError) -> Vec<u8> {
    let body = json!({ "code": error.code.word(), "text": error.text });
    let length = body.to_string().len();
    let head = "Connection: close\r\nContent-Type: application/json";
    format!("HTTP/1.1 {status}\r\n{head}\r\nContent-Length: {length}\r\n\r\n{body}").into_bytes()
}

/// Lets a page of another origin that is on the list read an answer.
pub(super) fn allow(headers: &mut HeaderMap, origin: HeaderValue) {
    headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, origin);
    headers.insert(ACCESS_CONTROL_ALLOW_CREDENTIALS, HeaderValue::from_static("true"));
    headers.insert(
        ACCESS_CONTROL_EXPOSE_HEADERS,
        HeaderValue::from_static("mom-tunnel, mom-taken, mom-sent, mom-end, mom-age"),
    );
    let lines = headers.get_all(VARY).iter().filter_map(|line| line.to_str().ok());
    let told = lines
        .flat_map(|line| line.split(", "))
        .any(|name| name == "origin");
    if !told {
        headers.append(VARY, HeaderValue::from_static("origin"));
    }
}

/// Lets any page read an answer that holds nothing of any user.
pub(super) fn allow_all(headers: &mut HeaderMap) {
    headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, HeaderValue::from_static("*"));
    headers.append(VARY, HeaderValue::from_static("origin"));
}

/// What a browser asks before it lets a page of another origin ask.
pub(super) fn options() -> Response<Body> {
    let mut answer = Response::new(Body::default());
    *answer.status_mut() = StatusCode::NO_CONTENT;
    let headers = answer.headers_mut();
    headers.insert(
        ACCESS_CONTROL_ALLOW_METHODS,
        HeaderValue::from_static("GET, POST"),
    );
    headers.insert(
        ACCESS_CONTROL_ALLOW_HEADERS,
        HeaderValue::from_static("authorization, content-type"),
    );
    answer
}
