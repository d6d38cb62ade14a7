//! Carries the bytes of raw peers through the doors that they cannot open themselves: TLS, a WebSocket, a tunnel. What a peer sends
//! wrong arrives as wrong as it is.

pub(crate) mod tls;
mod tunnel;
pub(crate) mod websocket;

use std::fmt;
use std::io;
use std::net::SocketAddr;

use mom_net::Door;
use mom_proto::codec::Form;
use tokio::net::{TcpSocket, TcpStream};

/// The way to a hub.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Way {
    /// What carries the form.
    pub door: Door,
    /// With TLS, for which the hub has the certificate of [`crate::tls::of_hub`].
    pub tls: bool,
}

impl Way {
    /// TCP alone.
    pub const PLAIN: Way = Way::new(Door::Stream, false);

    /// The ways of a form beside [`Way::PLAIN`]: each door once, TLS alone and below one of them.
    pub fn beside(form: Form) -> Vec<Way> {
        let tunnel = Way::new(Door::Tunnel { polled: true }, false);
        let ways = [
            Way::new(Door::Stream, true),
            tunnel,
            Way::new(Door::WebSocket, true),
        ];
        let carries = |way: &Way| form != Form::Xml || way.door != Door::WebSocket;
        ways.into_iter().filter(carries).collect()
    }

    const fn new(door: Door, tls: bool) -> Way {
        Way { door, tls }
    }

    /// An address on this machine from which all goes this way to the hub.
    pub async fn to(self, hub: SocketAddr, form: Form) -> SocketAddr {
        let hub = match self.tls {
            true => carry(move |near| tls::carry(near, hub)).await,
            false => hub,
        };
        match self.door {
            Door::Stream => hub,
            Door::WebSocket => carry(move |near| websocket::carry(near, hub, form)).await,
            Door::Tunnel { .. } => carry(move |near| tunnel::carry(near, hub)).await,
        }
    }
}

impl fmt::Display for Way {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let door = match self.door {
            Door::Stream => "TCP",
            Door::WebSocket => "WebSocket",
            Door::Tunnel { .. } => "a tunnel",
        };
        let tls = if self.tls { " with TLS" } else { "" };
        write!(formatter, "{door}{tls}")
    }
}

/// Listens, and carries each connection on, as long as the test lasts.
async fn carry<F>(on: impl Fn(TcpStream) -> F + Send + 'static) -> SocketAddr
where
    F: Future<Output = io::Result<()>> + Send + 'static,
{
    let socket = TcpSocket::new_v4().expect("a socket");
    // Little waits here for one who does not read.
    socket.set_send_buffer_size(16 * 1024).expect("a socket option");
    socket.bind(([127, 0, 0, 1], 0).into()).expect("a port");
    let listener = socket.listen(64).expect("a port");
    let address = listener.local_addr().expect("its address");
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            // However it ends, both sides see it.
            drop(tokio::spawn(on(near)));
        }
    });
    address
}

/// Connects to the hub, or to what leads there.
async fn dial(hub: SocketAddr) -> io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.set_recv_buffer_size(16 * 1024)?;
    let stream = socket.connect(hub).await?;
    stream.set_nodelay(true)?;
    Ok(stream)
}
