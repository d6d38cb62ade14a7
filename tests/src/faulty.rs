//! A network that fails: between a client and a hub, connections are cut, frozen, slowed and sliced as a test says.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::sleep;

/// What becomes of one connection.
#[derive(Clone, Copy, Debug, Default)]
pub struct Fault {
    /// How it ends.
    pub end: End,
    /// Bytes that pass at once; 0 = as they come.
    pub slice: usize,
    /// How long each of these waits.
    pub delay: Duration,
}

/// How a connection ends.
#[derive(Clone, Copy, Debug, Default)]
pub enum End {
    /// As its ends wish.
    #[default]
    Whole,
    /// Both ends are reset after so many bytes, of both directions together.
    Reset(u64),
    /// Both ends hear of its end after so many bytes, as if the other had closed.
    Closed(u64),
    /// After so many bytes nothing passes any more, and neither end hears why.
    Frozen(u64),
}

/// A port from which connections go to a hub, each with its fault.
#[derive(Debug)]
pub struct FaultyNetwork {
    /// Where to connect.
    pub address: SocketAddr,
    cut: Arc<AtomicU64>,
    came: Arc<AtomicU64>,
    /// All connections through it end when it changes.
    severed: watch::Sender<u64>,
    /// Nothing passes through those that are there when it changes.
    stalled: watch::Sender<u64>,
    /// Nothing passes while it is set.
    frozen: watch::Sender<bool>,
    accepting: JoinHandle<()>,
}

impl FaultyNetwork {
    /// In front of this hub; `fault` says what becomes of the nth connection, from 0.
    ///
    /// # Panics
    /// If there is no port.
    pub async fn to(hub: SocketAddr, mut fault: impl FnMut(u64) -> Fault + Send + 'static) -> FaultyNetwork {
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.expect("a port");
        let address = listener.local_addr().expect("it has one");
        let cut = Arc::new(AtomicU64::new(0));
        let (severed, stalled) = (watch::Sender::new(0), watch::Sender::new(0));
        let frozen = watch::Sender::new(false);
        let (count, sever) = (Arc::clone(&cut), severed.clone());
        let (stall, freeze) = (stalled.clone(), frozen.clone());
        let came = Arc::<AtomicU64>::default();
        let all = Arc::clone(&came);
        let accepting = tokio::spawn(async move {
            for number in 0.. {
                let Ok((near, _)) = listener.accept().await else {
                    return;
                };
                all.fetch_add(1, Ordering::Relaxed);
                let (fault, count, mut severed) = (fault(number), Arc::clone(&count), sever.subscribe());
                let (mut stalled, frozen) = (stall.subscribe(), freeze.subscribe());
                tokio::spawn(async move {
                    let Ok(far) = TcpStream::connect(hub).await else {
                        return;
                    };
                    let carried = async {
                        tokio::select! {
                            ended = carry(&near, &far, fault, &frozen) => ended,
                            _ = stalled.changed() => std::future::pending().await,
                        }
                    };
                    let ended = tokio::select! {
                        ended = carried => ended,
                        _ = severed.changed() => Ok(true),
                    };
                    if !matches!(ended, Ok(false)) {
                        count.fetch_add(1, Ordering::Relaxed);
                    }
                    if !matches!(fault.end, End::Closed(_)) {
                        let _ = (near.set_zero_linger(), far.set_zero_linger());
                    }
                });
            }
        });
        FaultyNetwork {
            address,
            cut,
            came,
            severed,
            stalled,
            frozen,
            accepting,
        }
    }

    /// How many connections it has ended.
    pub fn cut(&self) -> u64 {
        self.cut.load(Ordering::Relaxed)
    }

    /// How many connections have come.
    pub fn came(&self) -> u64 {
        self.came.load(Ordering::Relaxed)
    }

    /// Lets nothing pass any more through the connections that are there now, and neither end hears why.
    pub fn stall(&self) {
        self.stalled.send_modify(|times| *times += 1);
    }

    /// From now on nothing passes, through connections that come too, and neither end hears why; or all passes again.
    pub fn freeze(&self, frozen: bool) {
        self.frozen.send_replace(frozen);
    }

    /// Ends all connections that go through it now.
    pub fn sever(&self) {
        self.severed.send_modify(|times| *times += 1);
    }
}

impl Drop for FaultyNetwork {
    fn drop(&mut self) {
        self.accepting.abort();
    }
}

/// Carries bytes until the fault comes (true) or an end closes.
async fn carry(
    near: &TcpStream,
    far: &TcpStream,
    fault: Fault,
    frozen: &watch::Receiver<bool>,
) -> io::Result<bool> {
    near.set_nodelay(true)?;
    far.set_nodelay(true)?;
    let passed = AtomicU64::new(0);
    let most = match fault.end {
        End::Whole => u64::MAX,
        End::Reset(most) | End::Closed(most) | End::Frozen(most) => most,
    };
    let cut = tokio::select! {
        cut = pass(near, far, &passed, most, fault, frozen.clone()) => cut?,
        cut = pass(far, near, &passed, most, fault, frozen.clone()) => cut?,
    };
    if cut && matches!(fault.end, End::Frozen(_)) {
        std::future::pending::<()>().await;
    }
    Ok(cut)
}

async fn pass(
    from: &TcpStream,
    to: &TcpStream,
    passed: &AtomicU64,
    most: u64,
    fault: Fault,
    mut frozen: watch::Receiver<bool>,
) -> io::Result<bool> {
    let mut bytes = [0; 16 * 1024];
    let slice = if fault.slice == 0 {
        bytes.len()
    } else {
        fault.slice
    };
    loop {
        let before = passed.load(Ordering::Relaxed);
        let left = usize::try_from(most.saturating_sub(before)).unwrap_or(usize::MAX);
        if left == 0 {
            return Ok(true);
        }
        let wanted = bytes.len().min(slice).min(left);
        from.readable().await?;
        // A network that is gone thaws no more.
        let _ = frozen.wait_for(|frozen| !frozen).await;
        // The other direction may have come to the end of what passes meanwhile.
        let read = match from.try_read(&mut bytes[..wanted]) {
            Ok(0) => return Ok(false),
            Ok(read) => read,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => continue,
            Err(error) => return Err(error),
        };
        passed.fetch_add(read as u64, Ordering::Relaxed);
        if !fault.delay.is_zero() {
            sleep(fault.delay).await; // tidy: a slow network is what this makes
        }
        let mut rest = &bytes[..read];
        while !rest.is_empty() {
            to.writable().await?;
            match to.try_write(rest) {
                Ok(written) => rest = &rest[written..],
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
        }
    }
}
