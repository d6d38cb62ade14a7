//! What requests are answered with.

use http::header::{
    ACCESS_CONTROL_ALLOW_CREDENTIALS, ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS,
    ACCESS_CONTROL_ALLOW_ORIGIN, ACCESS_CONTROL_EXPOSE_HEADERS, CACHE_CONTROL, CONTENT_TYPE, HeaderMap, VARY,
    X_CONTENT_TYPE_OPTIONS,
};
use http::{HeaderValue, Response, StatusCode};
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

/// Lets a page of another origin that is on the list read an answer.
pub(super) fn allow(headers: &mut HeaderMap, origin: HeaderValue) {
    headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, origin);
    headers.insert(ACCESS_CONTROL_ALLOW_CREDENTIALS, HeaderValue::from_static("true"));
    headers.insert(
        ACCESS_CONTROL_EXPOSE_HEADERS,
        HeaderValue::from_static("mom-tunnel, mom-taken, mom-sent, mom-end"),
    );
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
