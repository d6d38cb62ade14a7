//! The threats of strangers and bad input at the doors beside TCP: TLS, WebSocket, the tunnel, HTTP.

mod forms;
mod origins;
mod requests;
mod strangers;
mod tunnels;
