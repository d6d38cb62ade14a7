//! Socket options.
#![expect(
    unsafe_code,
    reason = "TCP_NOTSENT_LOWAT has no safe wrapper among our libraries"
)]

use std::io;
use std::os::fd::AsRawFd;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

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
