//! Socket options.
#![expect(
    unsafe_code,
    reason = "TCP_NOTSENT_LOWAT and TCP_INFO have no safe wrapper among our libraries"
)]

use std::io;
use std::os::fd::AsRawFd;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

use crate::TcpState;

/// Bytes that may wait in the kernel unsent: small, so that the queue is ours, where priority works
/// (design §7), yet enough to keep a fast link busy between two turns of the writer.
const UNSENT: libc::c_int = 128 * 1024;

/// Sets what every connection has: no delay for small writes, a short queue in the kernel, and keep-alive
/// for the half-open ones that a heartbeat cannot see because nobody reads.
pub(crate) fn set(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let keepalive = TcpKeepalive::new().with_time(std::time::Duration::from_secs(30));
    SockRef::from(stream).set_tcp_keepalive(&keepalive)?;
    set_unsent_limit(stream)
}

#[cfg(target_os = "linux")]
fn set_unsent_limit(stream: &TcpStream) -> io::Result<()> {
    let size = libc::socklen_t::try_from(size_of_val(&UNSENT)).expect("four bytes fit");
    // SAFETY: the descriptor is open as long as `stream` is borrowed, and the kernel reads `size` bytes from
    // a value that outlives the call.
    let result = unsafe {
        libc::setsockopt(
            stream.as_raw_fd(),
            libc::IPPROTO_TCP,
            libc::TCP_NOTSENT_LOWAT,
            std::ptr::from_ref(&UNSENT).cast(),
            size,
        )
    };
    match result {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(not(target_os = "linux"))]
fn set_unsent_limit(_stream: &TcpStream) -> io::Result<()> {
    Ok(())
}

/// What the kernel knows of the link. None where it cannot be asked.
#[cfg(target_os = "linux")]
pub(crate) fn link(stream: &TcpStream) -> Option<TcpState> {
    // `struct tcp_info` of linux/tcp.h up to `tcpi_min_rtt` as plain words: the one of the libc crate ends before.
    // The kernel writes as much as it knows and says how much that was.
    let mut words = [0_u32; 38];
    let mut size = libc::socklen_t::try_from(size_of_val(&words)).expect("152 bytes fit");
    // SAFETY: the descriptor is open as long as `stream` is borrowed; the kernel writes at most `size` bytes into
    // `words`, which is that large, and any bytes are valid there.
    let result = unsafe {
        libc::getsockopt(
            stream.as_raw_fd(),
            libc::IPPROTO_TCP,
            libc::TCP_INFO,
            words.as_mut_ptr().cast(),
            &raw mut size,
        )
    };
    if result != 0 || size as usize != size_of_val(&words) {
        return None;
    }
    // Of a connection that was reset nothing more is acknowledged: a thread that waits for that shall write, and be told.
    const CLOSED: u8 = 7;
    if words[0].to_ne_bytes()[0] == CLOSED {
        return None;
    }
    // A u64 as it lies in memory, whatever the byte order.
    let long = |at: usize| {
        let (one, two) = (words[at].to_ne_bytes(), words[at + 1].to_ne_bytes());
        u64::from_ne_bytes(std::array::from_fn(
            |at| if at < 4 { one[at] } else { two[at - 4] },
        ))
    };
    Some(TcpState {
        acknowledged: long(30),
        segment: words[4],
        window: words[20],
        pace: long(26),
        least_round_trip: words[37],
    })
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn link(_stream: &TcpStream) -> Option<TcpState> {
    None
}
