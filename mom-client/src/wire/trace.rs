//! Spans of messages that are part of a trace.

use mom_proto::{Parcel, TraceParent};
use tracing::Span;

/// The span in which a message is sent; none without a slot `trace`.
pub(crate) fn sending(parcel: &Parcel) -> Span {
    let Some(trace) = TraceParent::of(parcel) else {
        return Span::none();
    };
    tracing::debug_span!(
        target: "mom::trace",
        "send",
        trace = trace.trace_id(),
        parent = trace.span_id(),
        sampled = trace.is_sampled(),
        context = parcel.context.as_ref().map(tracing::field::display),
        message = parcel.name(),
    )
}

/// Notes that it is sent, or why it is not.
pub(crate) fn sent<T>(span: &Span, sent: &Result<T, crate::ClientError>) {
    if !span.is_disabled() {
        span.in_scope(|| match sent {
            Ok(_) => tracing::debug!(target: "mom::trace", "sent"),
            Err(error) => tracing::debug!(target: "mom::trace", %error, "not sent"),
        });
    }
}

/// Notes that a message has arrived.
pub(crate) fn received(parcel: &Parcel) {
    let Some(trace) = TraceParent::of(parcel) else {
        return;
    };
    let span = tracing::debug_span!(
        target: "mom::trace",
        "receive",
        trace = trace.trace_id(),
        parent = trace.span_id(),
        sampled = trace.is_sampled(),
        context = parcel.context.as_ref().map(tracing::field::display),
        message = parcel.name(),
        sender = parcel.sender.as_deref(),
        age = parcel.age,
    );
    span.in_scope(|| tracing::debug!(target: "mom::trace", "received"));
}
