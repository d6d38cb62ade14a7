//! A slow way to the hub: what is urgent goes between the pieces of what is large, also in this direction, and waits for no
//! room behind what does.

use std::future::ready;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use mom_client::Client;
use mom_proto::codec::Form;
use mom_proto::{Family, Value};
use mom_tests::lab;
use mom_tests::raw::{PATIENCE, Raw};
use tokio::io::{AsyncReadExt, AsyncWriteExt, copy};
use tokio::net::{TcpSocket, TcpStream};
use tokio::sync::{Semaphore, watch};
use tokio::time::timeout;

/// A map, which leaves room in the queue of the client.
const MAP: usize = 3 << 20;
/// What is let through at a time.
const STEP: usize = 64 << 10;
const ARM: &str = "/robot/arm";

/// A link to the broker that lets as much through towards it as the test says.
struct Narrow {
    address: SocketAddr,
    allowed: Arc<Semaphore>,
    /// All that was ever allowed.
    total: usize,
    passed: watch::Receiver<usize>,
}

impl Narrow {
    async fn to(broker: SocketAddr, total: usize) -> Narrow {
        let socket = TcpSocket::new_v4().expect("a socket");
        // What waits in the network is not the client's any more: little, as on a radio link.
        socket.set_recv_buffer_size(128 << 10).expect("a socket option");
        socket
            .bind(SocketAddr::from(([127, 0, 0, 1], 0)))
            .expect("a port");
        let listener = socket.listen(1).expect("a listener");
        let address = listener.local_addr().expect("an address");
        let allowed = Arc::new(Semaphore::new(total));
        let (count, passed) = watch::channel(0);
        let credits = Arc::clone(&allowed);
        tokio::spawn(async move {
            let (peer, _) = listener.accept().await.expect("the client connects");
            let hub = TcpStream::connect(broker).await.expect("the broker listens");
            hub.set_nodelay(true).expect("a socket option");
            let (mut from_peer, mut to_peer) = peer.into_split();
            let (mut from_hub, mut to_hub) = hub.into_split();
            tokio::spawn(async move { copy(&mut from_hub, &mut to_peer).await });
            let mut buffer = [0; 4096];
            while let Ok(size @ 1..) = from_peer.read(&mut buffer).await {
                let credit = credits.acquire_many(size as u32).await.expect("never closed");
                credit.forget();
                if to_hub.write_all(&buffer[..size]).await.is_err() {
                    return;
                }
                count.send_modify(|passed| *passed += size);
            }
        });
        Narrow {
            address,
            allowed,
            total,
            passed,
        }
    }

    /// Lets so many bytes more through, and waits until all but less than a read of what was allowed has passed.
    async fn allow(&mut self, bytes: usize) {
        self.allowed.add_permits(bytes);
        self.total += bytes;
        let goal = self.total - 4096;
        let passed = timeout(PATIENCE, self.passed.wait_for(|passed| *passed >= goal)).await;
        passed.expect("there is more to send").expect("the link stands");
    }
}

/// A stop, and a command of a higher priority, while a map is under way: they are there long before it.
/// On one thread, so that the client sends nothing between what is said in one go.
#[tokio::test]
async fn a_stop_passes_a_map_on_a_slow_uplink() {
    // Two maps wait at once where a receiver is slow, and nobody is to be put out for that.
    let broker = lab::start_with(|config| config.limits.outbox = 64 << 20).await;
    let mut bob = Raw::login(broker.local_addr(), Form::Binary, "bob").await;
    bob.join(&["/chat", "/robot", ARM]).await;
    let mut narrow = Narrow::to(broker.local_addr(), 4 * STEP).await;
    let client = Client::builder(format!("bin://{}", narrow.address));
    let client = client.user("carol").password("carol").connect().await;
    let client = client.expect("an operator of the lab");
    let chat = client.channel("/chat").await.expect("people may");
    let arm = client.channel(ARM).await.expect("operators may");

    let map = Value::Binary(Bytes::from(vec![7; MAP]));
    let send = async |name| chat.message(name).no_echo().content(map.clone()).send().await;
    send("map").await.expect("room");
    narrow.allow(STEP).await;
    let mut second = pin!(send("second"));
    tokio::select! {
        biased;
        sent = &mut second => panic!("there is no room for it: {sent:?}"),
        () = ready(()) => {}
    }
    chat.message("look")
        .priority(10)
        .content("here")
        .send()
        .await
        .expect("room that is kept for what is urgent");
    arm.send("stop", "now").await.expect("a stop needs no room");
    let mut heard = Vec::new();
    while heard.len() < 2 {
        narrow.allow(STEP).await;
        let passed = *narrow.passed.borrow();
        assert!(passed < MAP / 2, "{heard:?} after {passed} bytes of {MAP}");
        while let Some(parcel) = bob.next_within(Duration::from_millis(2)).await {
            let parcel = parcel.expect("the broker stays");
            if parcel.family == Family::Message {
                heard.push(parcel.name().to_owned());
            }
        }
    }
    assert_eq!(heard, ["stop", "look"], "a stop before all else");
    narrow.allowed.add_permits(3 * MAP);
    timeout(PATIENCE, second)
        .await
        .expect("room")
        .expect("the link stands");
    for name in ["map", "second"] {
        let parcel = bob.next().await.expect("the broker stays");
        assert!(
            parcel.is(Family::Message, name),
            "in their order: {}",
            parcel.name()
        );
        let whole = Value::Binary(Bytes::from(vec![7; MAP]));
        assert!(parcel.value() == whole, "as it was");
    }
    broker.stop().await;
}
