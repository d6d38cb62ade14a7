//! The header that a proxy puts in front of a connection, to tell whose it is: PROXY protocol, versions 1 and 2.
//!
//! Its author can claim anything, so it is read only from the proxies that the configuration names. Its last part, where a
//! proxy may speak of a TLS that ended there, is skipped: nobody here has seen that.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};

use mom_proto::{Code, WireError};
use tokio::io::AsyncReadExt as _;
use tokio::net::TcpStream;

use crate::NetError;

/// How the header begins as a line of text.
const TEXT: &[u8] = b"PROXY ";
/// `PROXY UNKNOWN` with its line end, and the longest line.
const SHORTEST: usize = 15;
const LONGEST: usize = 107;

/// How it begins in binary; then follow version and command, family, and the length of the rest.
const SIGNATURE: &[u8] = b"\r\n\r\n\0\r\nQUIT\n";
const FIXED: usize = 16;
/// What the rest may have at most: addresses, and whatever else the proxy has to say.
const REST: usize = 4096;

/// Reads the header, and not a byte more; gives whose connection it is, none if it is the proxy's own.
///
/// # Errors
/// `bad-frame` for anything else, or a link that failed.
pub async fn proxied(stream: &mut TcpStream) -> Result<Option<SocketAddr>, NetError> {
    let mut header = Vec::with_capacity(LONGEST);
    loop {
        match step(&header) {
            Ok(Step::Done(client)) => return Ok(client),
            Ok(Step::More(count)) => {
                if stream.take(count as u64).read_buf(&mut header).await? == 0 {
                    return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
                }
            }
            Err(why) => {
                let text = format!(
                    "a proxy of this listener begins each connection with a PROXY protocol header; {why}"
                );
                return Err(WireError::new(Code::BAD_FRAME, text).into());
            }
        }
    }
}

#[derive(Debug, PartialEq)]
enum Step {
    /// So many bytes are missing at least.
    More(usize),
    Done(Option<SocketAddr>),
}

fn step(header: &[u8]) -> Result<Step, &'static str> {
    let begins = |how: &[u8]| how.iter().zip(header).all(|(one, other)| one == other);
    match () {
        () if header.is_empty() => Ok(Step::More(SHORTEST)),
        () if begins(SIGNATURE) => binary(header),
        () if begins(TEXT) => text(header),
        () => Err("this is none"),
    }
}

fn text(header: &[u8]) -> Result<Step, &'static str> {
    if let Some(line) = header.strip_suffix(b"\r\n") {
        let line = std::str::from_utf8(line).map_err(|_| "it contains non-ASCII characters")?;
        return told(line).map(Step::Done);
    }
    if header.len() >= LONGEST || header.contains(&b'\n') {
        return Err("its line must end with CR LF within 107 bytes");
    }
    let missing = match header.ends_with(b"\r") {
        _ if header.len() < SHORTEST => SHORTEST - header.len(),
        true => 1,
        false => 2,
    };
    Ok(Step::More(missing.min(LONGEST - header.len())))
}

fn told(line: &str) -> Result<Option<SocketAddr>, &'static str> {
    let mut words = line.split(' ').skip(1);
    let family = words.next();
    if family == Some("UNKNOWN") {
        return Ok(None);
    }
    let words: Vec<&str> = words.collect();
    let [from, to, from_port, to_port] = words[..] else {
        return Err("it is PROXY TCP4, TCP6 or UNKNOWN, two addresses and two ports");
    };
    let address = |text: &str| match family {
        Some("TCP4") => text.parse().ok().map(IpAddr::V4),
        Some("TCP6") => text.parse().ok().map(IpAddr::V6),
        _ => None,
    };
    let port = |text: &str| {
        let digits = text.bytes().all(|byte| byte.is_ascii_digit());
        text.parse::<u16>().ok().filter(|_| digits)
    };
    let wrong = "its addresses or ports are wrong";
    let (_, _) = address(to).zip(port(to_port)).ok_or(wrong)?;
    let (ip, port) = address(from).zip(port(from_port)).ok_or(wrong)?;
    Ok(Some(SocketAddr::new(ip, port)))
}

fn binary(header: &[u8]) -> Result<Step, &'static str> {
    let Some((fixed, rest)) = header.split_first_chunk::<FIXED>() else {
        return Ok(Step::More(FIXED - header.len()));
    };
    let [.., command, family, high, low] = *fixed;
    let length = usize::from(u16::from_be_bytes([high, low]));
    if length > REST {
        return Err("it is longer than 4096 bytes");
    }
    let own = match (command, family) {
        (0x20, _) => true,
        // Unix sockets, or nothing that is known.
        (0x21, 0x00 | 0x31 | 0x32) => true,
        (0x21, 0x11 | 0x21) => false,
        (0x21, _) => return Err("its addresses are not TCP addresses"),
        _ => return Err("its version or command is unknown"),
    };
    if rest.len() < length {
        return Ok(Step::More(length - rest.len()));
    }
    if own {
        return Ok(Step::Done(None));
    }
    let short = "its addresses are truncated";
    let (ip, ports) = match family {
        0x11 => {
            let (addresses, ports) = rest.split_first_chunk::<8>().ok_or(short)?;
            let [a, b, c, d, ..] = *addresses;
            (IpAddr::V4(Ipv4Addr::new(a, b, c, d)), ports)
        }
        _ => {
            let (from, rest) = rest.split_first_chunk::<16>().ok_or(short)?;
            let (_, ports) = rest.split_first_chunk::<16>().ok_or(short)?;
            (IpAddr::V6(Ipv6Addr::from(*from)), ports)
        }
    };
    let [high, low, _, _, ..] = *ports else {
        return Err(short);
    };
    let port = u16::from_be_bytes([high, low]);
    Ok(Step::Done(Some(SocketAddr::new(ip, port))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gives a whole header byte by byte, as far as it is asked for.
    fn read(header: &[u8]) -> Result<Option<SocketAddr>, &'static str> {
        for end in 0..header.len() {
            match step(&header[..end])? {
                Step::More(count) => assert!(count <= header.len() - end, "{count} too many after {end}"),
                Step::Done(_) => panic!("done after {end} of {}", header.len()),
            }
        }
        match step(header)? {
            Step::Done(client) => Ok(client),
            Step::More(_) => Err("more"),
        }
    }

    fn binary_header(command: u8, family: u8, rest: &[u8]) -> Vec<u8> {
        let length = u16::try_from(rest.len()).expect("short").to_be_bytes();
        [SIGNATURE, &[command, family], &length, rest].concat()
    }

    #[test]
    fn headers_tell_the_client() {
        let long = [&[0; 32][..], &[0x1F, 0x90, 0, 1], &[7; 900]].concat();
        let v4 = [10, 1, 2, 3, 10, 0, 0, 1, 0x1F, 0x90, 0, 1];
        for (header, client) in [
            (
                b"PROXY TCP4 10.1.2.3 10.0.0.1 8080 7666\r\n".to_vec(),
                Some("10.1.2.3:8080"),
            ),
            (b"PROXY TCP4 1.1.1.1 2.2.2.2 0 0\r\n".to_vec(), Some("1.1.1.1:0")),
            (
                b"PROXY TCP6 2001:db8::1 ::1 65535 1\r\n".to_vec(),
                Some("[2001:db8::1]:65535"),
            ),
            (b"PROXY UNKNOWN\r\n".to_vec(), None),
            (b"PROXY UNKNOWN whatever it says\r\n".to_vec(), None),
            (binary_header(0x21, 0x11, &v4), Some("10.1.2.3:8080")),
            (binary_header(0x21, 0x21, &long), Some("[::]:8080")),
            (binary_header(0x20, 0x11, &v4), None),
            (binary_header(0x20, 0x00, &[]), None),
            (binary_header(0x21, 0x00, &[1, 2, 3]), None),
            (binary_header(0x21, 0x31, &[0; 216]), None),
        ] {
            let client = client.map(|client| client.parse().expect("an address"));
            assert_eq!(read(&header), Ok(client), "{}", header.escape_ascii());
        }
    }

    #[test]
    fn other_headers_are_refused() {
        let line = |middle: &str| format!("PROXY {middle}\r\n").into_bytes();
        for header in [
            b"<parcel/>".to_vec(),
            b"GET / HTTP/1.1\r\n".to_vec(),
            b"PROXY TCP4 1.1.1.1 2.2.2.2 1 1\n".to_vec(),
            line("TCP5 1.1.1.1 2.2.2.2 1 1"),
            line("TCP4 ::1 2.2.2.2 1 1"),
            line("TCP4 1.1.1.1 ::1 1 1"),
            line("TCP6 1.1.1.1 2.2.2.2 1 1"),
            line("TCP4 1.1.1.1 2.2.2.2 +1 1"),
            line("TCP4 1.1.1.1 2.2.2.2 1 65536"),
            line("TCP4 01.1.1.1 2.2.2.2 1 1"),
            line("TCP4 1.1.1.1 2.2.2.2 1"),
            line("TCP4 1.1.1.1  2.2.2.2 1 1"),
            line("TCP4 1.1.1.1 2.2.2.2 1 1 1"),
            line(&format!("UNKNOWN {}", "x".repeat(LONGEST))),
            [&b"PROXY "[..], &[0xFF; 20], b"\r\n"].concat(),
            binary_header(0x31, 0x11, &[0; 12]),
            binary_header(0x22, 0x11, &[0; 12]),
            binary_header(0x21, 0x12, &[0; 12]),
            binary_header(0x21, 0x11, &[0; 11]),
            binary_header(0x21, 0x21, &[0; 35]),
            binary_header(0x21, 0x11, &[0; REST + 1]),
        ] {
            let mut refused = false;
            for end in 0..=header.len() {
                match step(&header[..end]) {
                    Ok(Step::Done(_)) => panic!("taken: {}", header.escape_ascii()),
                    Ok(Step::More(_)) => {}
                    Err(_) => {
                        refused = true;
                        break;
                    }
                }
            }
            assert!(refused, "{}", header.escape_ascii());
        }
    }

    #[test]
    fn the_longest_line_is_taken() {
        let middle = "x".repeat(LONGEST - SHORTEST - 1);
        let line = format!("PROXY UNKNOWN {middle}\r\n");
        assert_eq!(line.len(), LONGEST);
        assert_eq!(read(line.as_bytes()), Ok(None));
    }
}
