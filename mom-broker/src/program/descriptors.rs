//! The descriptors that this process may open, and the connections that are configured.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// What a broker opens besides connections: listeners, databases, logs, the files that it reads again.
const OWN: u64 = 64;

/// Makes room for this many connections as far as the system allows, and warns where it does not.
pub(super) fn make_room(connections: usize) {
    let wanted = u64::try_from(connections).unwrap_or(u64::MAX).saturating_add(OWN);
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let enough = |limit: Option<u64>| limit.is_none_or(|limit| limit >= wanted);
    if enough(current) {
        return;
    }
    // What a process may raise by itself is only a habit of shells.
    let raised = maximum.map_or(wanted, |maximum| maximum.min(wanted));
    let new = Rlimit {
        current: Some(raised),
        maximum,
    };
    let current = setrlimit(Resource::Nofile, new).map_or(current, |()| Some(raised));
    if !enough(current) {
        let descriptors = current.unwrap_or_default();
        tracing::warn!(
            connections,
            descriptors,
            "the configured connections exceed this process's limit of open files: further connections will wait unanswered, and files cannot be reloaded; configure at most {}, or raise the limit (LimitNOFILE of systemd, ulimit -n)",
            descriptors.saturating_sub(OWN)
        );
    }
}
