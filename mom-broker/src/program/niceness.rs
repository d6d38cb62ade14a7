//! How much of the processor the system lets this process have beside others: a stop waits for the processes that run before it.

use rustix::process::{Resource, getpriority_process, getrlimit, setpriority_process};

/// What was asked for, and what the process has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Niceness {
    wanted: i32,
    has: i32,
}

/// Asks for this niceness, 0 for none, or for the lowest that the system allows; of a lower one that it has already
/// nothing is given up. Threads take it from the one that starts them, so this comes before them.
pub(super) fn ask(wanted: i32) -> Niceness {
    let now = || getpriority_process(None).unwrap_or_default();
    // What is allowed to everybody is a limit in the unit of 20 − niceness.
    let limit = getrlimit(Resource::Nice).current.unwrap_or(40);
    let allowed = 20 - i32::try_from(limit.min(40)).unwrap_or(40);
    for niceness in [wanted, wanted.max(allowed)] {
        if wanted == 0 || niceness >= now() || setpriority_process(None, niceness).is_ok() {
            break;
        }
    }
    Niceness { wanted, has: now() }
}

impl Niceness {
    /// Says in the log what the process has.
    pub(super) fn tell(self) {
        let Niceness { wanted, has } = self;
        if has <= wanted {
            return tracing::info!(
                niceness = has,
                "the broker has priority over programs of a higher niceness"
            );
        }
        tracing::info!(
            niceness = has,
            wanted,
            "the system does not allow this broker a lower niceness, so a stop may be delayed by other programs on this machine; start it as a service \
             (Nice=-10 of systemd), or allow it: LimitNICE=-10, CAP_SYS_NICE, or a line `nice -10` in limits.conf"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_given_up() {
        // In a thread of its own: it keeps what it has been given.
        let asked = std::thread::spawn(|| {
            let before = getpriority_process(None).expect("it has one");
            let same = ask(before + 5);
            let lower = ask(before - 1);
            (before, same, lower)
        });
        let (before, same, lower) = asked.join().expect("it asks");
        assert_eq!(same.has, before);
        assert!(lower.has == before - 1 || lower.has == before, "{lower:?}");
    }
}
