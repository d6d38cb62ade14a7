//! Much under way when the connection is lost: what the hub has not said that it has read is kept, so that the link goes on.

use std::net::SocketAddr;
use std::time::Duration;

use mom_client::{Builder, Client, Event, Family, LinkState, Parcel, Path, Value};
use mom_tests::faulty::{Fault, FaultyNetwork};
use mom_tests::lab;
use mom_tests::programs::PATIENCE;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::time::timeout;

const PARTS: u8 = 255;
const PART: usize = 64 * 1024;

/// What the network lets pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Passes {
    All,
    /// Only what goes to the hub: it reads, and nobody hears that it has.
    Up,
    /// Nothing: the connections that are there end.
    Nothing,
}

/// A network in front of a hub.
async fn network(hub: SocketAddr, passes: watch::Receiver<Passes>) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = listener.local_addr().expect("an address");
    tokio::spawn(async move {
        while let Ok((near, _)) = listener.accept().await {
            if let Ok(far) = TcpStream::connect(hub).await {
                tokio::spawn(carry(near, far, passes.clone()));
            }
        }
    });
    address
}

async fn carry(near: TcpStream, far: TcpStream, mut passes: watch::Receiver<Passes>) {
    let (mut near_reads, mut near_writes) = near.into_split();
    let (mut far_reads, mut far_writes) = far.into_split();
    let state = passes.clone();
    let down = async {
        let mut buffer = vec![0; PART];
        while let Ok(read @ 1..) = far_reads.read(&mut buffer).await {
            let passes = *state.borrow();
            if passes == Passes::All && near_writes.write_all(&buffer[..read]).await.is_err() {
                return;
            }
        }
    };
    tokio::select! {
        _ = tokio::io::copy(&mut near_reads, &mut far_writes) => {}
        () = down => {}
        _ = passes.wait_for(|passes| *passes == Passes::Nothing) => {}
    }
}

fn builder(address: SocketAddr, user: &str) -> Builder {
    Client::builder(format!("bin://{address}"))
        .user(user)
        .password(user)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_outlives_a_loss_with_much_under_way() {
    let broker = lab::start().await;
    let (set, passes) = watch::channel(Passes::All);
    let alice = builder(network(broker.local_addr(), passes).await, "alice");
    let alice = alice
        .link(Duration::from_secs(60))
        .connect()
        .await
        .expect("alice");
    let token = alice.token("/robot/token").await.expect("anybody may look");
    let guard = token.grab().await.expect("it is free");
    let robot = alice.channel("/robot/arm").await.expect("anybody may");
    let mut events = robot.events();
    let bob = builder(broker.local_addr(), "bob").connect().await.expect("bob");
    let chat = bob.channel("/chat").await.expect("anybody may");
    let mut said = chat.events();
    let _member = alice.channel("/chat").await.expect("anybody may");

    set.send(Passes::Up).expect("it is looked at");
    let saying = tokio::spawn({
        let alice = alice.clone();
        async move {
            for part in 0..PARTS {
                let mut say = Parcel::new(Family::Message, "say")
                    .context(Path::parse("/chat").expect("a path"))
                    .content(Value::Binary(vec![part; PART].into()));
                // What the hub keeps for her is another matter.
                say.echo = Some(false);
                alice.send(say).await.expect("it waits for the next connection");
            }
        }
    });
    let mut heard = 0;
    // Until nothing comes any more: as much as may be under way, or all.
    while let Ok(event) = timeout(Duration::from_secs(1), said.next()).await {
        heard += u8::from(matches!(event, Some(Event::Message(_))));
        if heard == PARTS {
            break;
        }
    }
    assert!(heard >= 32, "{heard} parts came");
    set.send(Passes::Nothing).expect("it is looked at");
    let ends = async {
        loop {
            match events.next().await.expect("the channel stays") {
                Event::LinkDown => set.send(Passes::All).expect("it is looked at"),
                Event::Resumed => return true,
                Event::Rejoined => return false,
                _ => {}
            }
        }
    };
    assert!(
        timeout(PATIENCE, ends).await.expect("in time"),
        "the link was begun anew"
    );
    let rest = async {
        while heard < PARTS {
            if let Some(Event::Message(parcel)) = said.next().await {
                assert_eq!(
                    parcel.value().as_binary().and_then(|part| part.first()),
                    Some(&heard)
                );
                heard += 1;
            }
        }
    };
    timeout(PATIENCE, rest)
        .await
        .expect("all come, once and in order");
    saying.await.expect("no panic");
    assert!(guard.release().await.is_ok(), "it was hers all the time");
    drop((alice, bob));
    broker.stop().await;
}

/// A client whose attempts hang knows in time that its link is over: what it drives is nobody's any more.
#[tokio::test]
async fn a_link_ends_with_its_grace_though_an_attempt_hangs() {
    let broker = lab::start().await;
    let network = FaultyNetwork::to(broker.local_addr(), |_| Fault::default()).await;
    let client = Client::builder(format!("bin://{}", network.address))
        .user("alice")
        .password("alice")
        .link(Duration::from_millis(500))
        .heartbeat(Duration::from_millis(100))
        .connect()
        .await
        .expect("alice");
    let mut state = client.state();
    network.freeze(true);
    let over = state.wait_for(|link| matches!(link, LinkState::Trying { .. }));
    // One attempt that hangs takes 10 s.
    let over = timeout(Duration::from_secs(9), over).await;
    over.expect("in time").expect("a state");
}
