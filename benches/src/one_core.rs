//! Which core the system runs things on.
#![expect(
    unsafe_code,
    reason = "sched_setaffinity has no safe wrapper among our libraries"
)]

use std::io;

use crate::{Error, Hub};

/// Keeps this process and those of hubs on one core as long as it lives.
///
/// Whether the system wakes a thread on the core of its waker or on an idle one makes one round trip three
/// times as long as another; on one core all are alike, and only the work is left to be compared.
pub(crate) struct OneCore {
    processes: Vec<u32>,
    before: Cores,
}

impl OneCore {
    pub(crate) fn new(hubs: &[&Hub]) -> Result<OneCore, Error> {
        let others = hubs.iter().filter_map(|hub| hub.process.as_ref());
        let processes: Vec<u32> = others
            .map(|process| process.id())
            .chain([std::process::id()])
            .collect();
        let failed = || Error::io("the cores of this process");
        let before = Cores::of_this_thread().map_err(failed())?;
        let one_core = OneCore { processes, before };
        one_core.set(&before.first()).map_err(failed())?;
        Ok(one_core)
    }

    fn set(&self, cores: &Cores) -> io::Result<()> {
        for process in &self.processes {
            for thread in std::fs::read_dir(format!("/proc/{process}/task"))? {
                let name = thread?.file_name();
                if let Some(thread) = name.to_str().and_then(|name| name.parse().ok()) {
                    cores.give_to(thread)?;
                }
            }
        }
        Ok(())
    }
}

impl Drop for OneCore {
    fn drop(&mut self) {
        // A hub that is gone needs no cores, and a measurement that went on would tell by its figures.
        let _ = self.set(&self.before);
    }
}

#[derive(Clone, Copy)]
struct Cores(libc::cpu_set_t);

impl Cores {
    fn none() -> Cores {
        // SAFETY: a set of bits, for which all zeros is the empty set.
        Cores(unsafe { std::mem::zeroed() })
    }

    fn of_this_thread() -> io::Result<Cores> {
        let mut cores = Cores::none();
        // SAFETY: the kernel writes at most the given size into a value that outlives the call.
        let result = unsafe { libc::sched_getaffinity(0, size_of::<libc::cpu_set_t>(), &raw mut cores.0) };
        match result {
            0 => Ok(cores),
            _ => Err(io::Error::last_os_error()),
        }
    }

    /// The first of them alone.
    fn first(&self) -> Cores {
        let mut first = Cores::none();
        let most = 8 * size_of::<libc::cpu_set_t>();
        // SAFETY: both look at bits inside the set only.
        unsafe {
            if let Some(core) = (0..most).find(|core| libc::CPU_ISSET(*core, &self.0)) {
                libc::CPU_SET(core, &mut first.0);
            }
        }
        first
    }

    fn give_to(&self, thread: libc::pid_t) -> io::Result<()> {
        // SAFETY: the kernel reads the given size from a value that outlives the call.
        let result =
            unsafe { libc::sched_setaffinity(thread, size_of::<libc::cpu_set_t>(), &raw const self.0) };
        match (result, io::Error::last_os_error()) {
            (0, _) => Ok(()),
            // It ended since it was listed.
            (_, error) if error.raw_os_error() == Some(libc::ESRCH) => Ok(()),
            (_, error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_core_is_left_and_all_come_back() {
        let count = || {
            let cores = Cores::of_this_thread().unwrap();
            // SAFETY: counts bits inside the set.
            unsafe { libc::CPU_COUNT(&cores.0) }
        };
        let before = count();
        let one_core = OneCore::new(&[]).unwrap();
        assert_eq!(count(), 1);
        drop(one_core);
        assert_eq!(count(), before);
    }
}
