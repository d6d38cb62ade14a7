//! A packet relay: carries IP packets between two TUN devices as a link of a certain rate, delay and loss would.
//!
//! The kernels at both ends speak TCP with each other, so congestion control, retransmission and acknowledgements
//! are theirs; a relay that ended TCP would hide all of it. The kernel's own emulator (netem) is not everywhere.
#![expect(
    unsafe_code,
    reason = "TUN devices and waiting on two of them have no safe wrapper among our libraries"
)]

use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Write as _};
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::line::{Line, Passed, Shape};

/// How long the thread may sleep: so long takes its end.
const NAP: Duration = Duration::from_millis(50);
/// A device's packets: its MTU, and more than that.
const PACKET: usize = 2048;

/// A running relay; it ends when this is dropped.
#[derive(Debug)]
pub struct PacketRelay {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    start: Instant,
    /// From the first device to the second, and back.
    lines: [Mutex<Line>; 2],
    over: AtomicBool,
}

impl PacketRelay {
    /// Carries packets between two TUN devices: `there` is the way from the first to the second.
    ///
    /// # Errors
    /// Where no thread can be had.
    pub fn start(devices: [File; 2], there: Shape, back: Shape, seed: u64) -> io::Result<PacketRelay> {
        let shared = Arc::new(Shared {
            start: Instant::now(),
            lines: [
                Mutex::new(Line::new(there, seed)),
                Mutex::new(Line::new(back, seed.wrapping_add(1))),
            ],
            over: AtomicBool::new(false),
        });
        let carrying = Arc::clone(&shared);
        let thread = thread::Builder::new().name("packet-relay".to_owned());
        let thread = thread.spawn(move || carrying.carry(devices))?;
        Ok(PacketRelay {
            shared,
            thread: Some(thread),
        })
    }

    /// Changes the way from the first device to the second.
    pub fn reshape(&self, there: Shape) {
        self.line(0).reshape(there, self.shared.start.elapsed());
    }

    /// What has passed on the way from the first device to the second since the last call.
    pub fn take_passed(&self) -> Passed {
        self.line(0).take_passed()
    }

    fn line(&self, at: usize) -> MutexGuard<'_, Line> {
        lock(&self.shared.lines[at])
    }
}

impl Drop for PacketRelay {
    fn drop(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn carry(&self, mut devices: [File; 2]) {
        be_punctual();
        let mut buffer = [0; PACKET];
        while !self.over.load(Ordering::Relaxed) {
            let mut due = None;
            for from in [0, 1] {
                let mut line = lock(&self.lines[from]);
                // All that is there, before anything is waited for: a device's own queue is not a part of the model.
                while let Ok(length) = devices[from].read(&mut buffer) {
                    line.offer(buffer[..length].to_vec(), self.start.elapsed());
                }
                while let Some(packet) = line.arrived(self.start.elapsed()) {
                    // A device that takes none has lost it, as a network card would.
                    let _ = devices[1 - from].write(&packet);
                }
                due = [due, line.due()].into_iter().flatten().min();
            }
            let wait = due.map_or(NAP, |due| due.saturating_sub(self.start.elapsed()).min(NAP));
            wait_for_either(&devices, wait);
        }
    }
}

/// Opens the TUN device of this name in the network namespace of this thread.
///
/// # Errors
/// Where that is not allowed, or there is none.
pub(super) fn open_tun(name: &str) -> io::Result<File> {
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags(libc::O_NONBLOCK)
        .open("/dev/net/tun")?;
    // SAFETY: all fields of `ifreq` may be zero.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    for (to, from) in request
        .ifr_name
        .iter_mut()
        .zip(name.bytes().take(libc::IFNAMSIZ - 1))
    {
        *to = from.cast_signed();
    }
    request.ifr_ifru.ifru_flags = i16::try_from(libc::IFF_TUN | libc::IFF_NO_PI).unwrap_or_default();
    // SAFETY: the descriptor is open, and the kernel reads and writes an `ifreq` that outlives the call.
    match unsafe { libc::ioctl(file.as_raw_fd(), libc::TUNSETIFF, &raw mut request) } {
        0 => Ok(file),
        _ => Err(io::Error::last_os_error()),
    }
}

fn wait_for_either(devices: &[File; 2], time: Duration) {
    let mut ready = [0, 1].map(|at: usize| libc::pollfd {
        fd: devices[at].as_raw_fd(),
        events: libc::POLLIN,
        revents: 0,
    });
    let time = libc::timespec {
        tv_sec: 0,
        tv_nsec: time.subsec_nanos().into(),
    };
    // SAFETY: two descriptors that are open, and a time, all of which outlive the call.
    unsafe { libc::ppoll(ready.as_mut_ptr(), 2, &raw const time, std::ptr::null()) };
}

/// Timers of this thread are exact to a microsecond, and where that is allowed it goes before others.
fn be_punctual() {
    // SAFETY: both change nothing but how this thread is scheduled.
    unsafe {
        libc::prctl(libc::PR_SET_TIMERSLACK, 1_000_u64, 0, 0, 0);
        libc::setpriority(libc::PRIO_PROCESS, 0, -15);
    }
}

fn lock(line: &Mutex<Line>) -> MutexGuard<'_, Line> {
    line.lock().unwrap_or_else(PoisonError::into_inner)
}
