//! Tells systemd that the broker listens, so that what is started after it finds it (`Type=notify`).

use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Says so at the socket that `NOTIFY_SOCKET` names. Without it nobody asks.
pub(super) fn tell() {
    let Some(socket) = std::env::var_os("NOTIFY_SOCKET") else {
        return;
    };
    if let Err(error) = send(&socket) {
        tracing::warn!(
            "NOTIFY_SOCKET: {}: {error}; systemd does not hear that the broker listens",
            socket.display()
        );
    }
}

fn send(socket: &OsStr) -> io::Result<()> {
    // A name that begins with @ is in the abstract namespace, which has no files.
    let address = match socket.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name)?,
        None => SocketAddr::from_pathname(socket)?,
    };
    UnixDatagram::unbound()?.send_to_addr(b"READY=1", &address)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_heard_at_a_file_and_at_an_abstract_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("notify");
        let name = format!("mom-test-{}", file.display());
        let abstract_name = SocketAddr::from_abstract_name(&name).unwrap();
        for (hears, told) in [
            (UnixDatagram::bind(&file).unwrap(), file.clone().into_os_string()),
            (
                UnixDatagram::bind_addr(&abstract_name).unwrap(),
                format!("@{name}").into(),
            ),
        ] {
            send(&told).unwrap();
            let mut heard = [0; 64];
            let length = hears.recv(&mut heard).unwrap();
            assert_eq!(&heard[..length], b"READY=1");
        }
        assert!(send(OsStr::new("/nobody/is/there")).is_err());
    }
}
