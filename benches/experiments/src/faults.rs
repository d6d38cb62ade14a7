//! What kept users of the paper from its hub (M58), as real sockets of this machine that behave so.

use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::thread;
use std::time::Duration;

use socket2::{Domain, SockRef, Socket, Type};

/// What is in a client's way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// Its resolver does not know the hub's name.
    UnknownName,
    /// What it sends to the hub's port is dropped.
    TimedOut,
    /// The hub's port is answered by a refusal.
    Refused,
    /// It has no way to the hub.
    Unreachable,
    /// Its connection is cut.
    Reset,
}

impl Fault {
    /// All of them, in the paper's order.
    pub(super) const ALL: [Fault; 5] = [
        Fault::UnknownName,
        Fault::TimedOut,
        Fault::Refused,
        Fault::Unreachable,
        Fault::Reset,
    ];

    /// How many of the paper's 1339 hosts had it.
    pub(super) fn in_paper(self) -> usize {
        match self {
            Fault::UnknownName => 64,
            Fault::TimedOut => 56,
            Fault::Refused => 39,
            Fault::Unreachable => 12,
            Fault::Reset => 6,
        }
    }

    /// The paper's word, and ours.
    pub(super) fn name(self) -> &'static str {
        match self {
            Fault::UnknownName => "unknown name (UnknownHost)",
            Fault::TimedOut => "timed out",
            Fault::Refused => "refused",
            Fault::Unreachable => "unreachable",
            Fault::Reset => "reset (SocketException)",
        }
    }

    /// What a client sees.
    pub(super) fn seen(error: &io::Error) -> Option<Fault> {
        match error.kind() {
            ErrorKind::TimedOut => Some(Fault::TimedOut),
            ErrorKind::ConnectionRefused => Some(Fault::Refused),
            ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable => Some(Fault::Unreachable),
            ErrorKind::ConnectionReset | ErrorKind::BrokenPipe | ErrorKind::UnexpectedEof => {
                Some(Fault::Reset)
            }
            // The resolver's errors have no kind.
            _ if error.to_string().contains("lookup") => Some(Fault::UnknownName),
            _ => None,
        }
    }
}

/// The sockets that behave so, until this is dropped.
#[derive(Debug)]
pub(super) struct Faults {
    full: SocketAddr,
    refusing: SocketAddr,
    cutting: SocketAddr,
    _kept: (Socket, Vec<Socket>, Socket),
}

impl Faults {
    pub(super) fn new() -> io::Result<Faults> {
        let bound = || -> io::Result<(Socket, SocketAddr)> {
            let socket = Socket::new(Domain::IPV4, Type::STREAM, None)?;
            socket.bind(&SocketAddr::from((Ipv4Addr::LOCALHOST, 0)).into())?;
            let at = socket.local_addr()?.as_socket();
            Ok((socket, at.ok_or(ErrorKind::AddrNotAvailable)?))
        };
        // Nobody accepts, so the queue is full at once, and the system drops who comes then, as a firewall does.
        let (listener, full) = bound()?;
        listener.listen(0)?;
        let mut waiting = Vec::new();
        for _ in 0..4 {
            let socket = Socket::new(Domain::IPV4, Type::STREAM, None)?;
            socket.set_nonblocking(true)?;
            // It is under way, or waits for ever.
            let _ = socket.connect(&full.into());
            waiting.push(socket);
        }
        // Bound and not listening: the system refuses, and nobody else gets the port.
        let (idle, refusing) = bound()?;
        let cutter = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let cutting = cutter.local_addr()?;
        // It ends with the program.
        thread::spawn(move || cutter.incoming().flatten().for_each(|stream| cut(&stream)));
        let faults = Faults {
            full,
            refusing,
            cutting,
            _kept: (listener, waiting, idle),
        };
        match TcpStream::connect_timeout(&full, Duration::from_millis(300)) {
            Err(error) if error.kind() == ErrorKind::TimedOut => Ok(faults),
            _ => Err(io::Error::other(
                "a full queue takes connections here: nothing times out",
            )),
        }
    }

    /// Where the client of this number finds that fault.
    pub(super) fn host(&self, fault: Fault, client: usize) -> String {
        match fault {
            // No name has a part of more than 63 letters: the resolver says what it says of any unknown name, and asks no
            // server, which might be slow or have a name of that kind.
            Fault::UnknownName => format!("{:x<64}.invalid:7666", format!("hub-{client}-")),
            Fault::TimedOut => self.full.to_string(),
            Fault::Refused => self.refusing.to_string(),
            // TCP goes to no group of hosts: the system has no route, and nothing leaves this machine.
            Fault::Unreachable => "224.0.0.1:7666".to_owned(),
            Fault::Reset => self.cutting.to_string(),
        }
    }
}

/// Closes a connection by a reset.
fn cut(stream: &TcpStream) {
    let _ = SockRef::from(stream).set_linger(Some(Duration::ZERO));
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;
    use std::net::ToSocketAddrs as _;

    use super::*;

    #[test]
    fn every_fault_is_seen_as_what_it_is() {
        let faults = Faults::new().unwrap();
        for fault in Fault::ALL {
            let connect = || -> io::Result<()> {
                let named = faults.host(fault, 7).to_socket_addrs();
                let at = named
                    .map_err(|error| io::Error::other(format!("lookup: {error}")))?
                    .next();
                let at = at.ok_or(ErrorKind::AddrNotAvailable)?;
                let mut stream = TcpStream::connect_timeout(&at, Duration::from_millis(300))?;
                stream.read(&mut [0; 1]).map(drop)
            };
            let error = connect().expect_err("a fault");
            assert_eq!(Fault::seen(&error), Some(fault), "{error:?}");
        }
    }
}
