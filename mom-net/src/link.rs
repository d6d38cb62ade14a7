//! What is known of the network below a connection, and of the other side.

use mom_proto::Fingerprint;

/// The state of a TCP connection, as its kernel tells it (`TCP_INFO`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TcpState {
    /// Bytes that the other side has acknowledged since the connection began.
    pub acknowledged: u64,
    /// The largest segment, in bytes.
    pub segment: u32,
    /// The congestion window, in segments.
    pub window: u32,
    /// The rate at which the kernel sends, in bytes per second, if it paces at all, which it does not say.
    pub pace: u64,
    /// The least round trip seen, in µs; the largest number before the first.
    pub least_round_trip: u32,
}

/// What is known of the other side of a connection, and of those between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Privacy {
    /// It is in this process.
    Local,
    /// Others on the path can read along.
    Plain,
    /// Nobody between can read along.
    Tls {
        /// The certificate that the other side has shown, if it has one, and has proved to have the key of.
        certificate: Option<Fingerprint>,
    },
}
