//! How many files this process and its children may have open.
#![expect(unsafe_code, reason = "setrlimit has no safe wrapper among our libraries")]

/// Raises the bound to what the system allows at most; gives it, or 0 where it is not known.
pub(crate) fn raise() -> u64 {
    let mut limit = libc::rlimit {
        rlim_cur: 0,
        rlim_max: 0,
    };
    // SAFETY: both calls read or write one value that outlives them.
    unsafe {
        if libc::getrlimit(libc::RLIMIT_NOFILE, &raw mut limit) != 0 {
            return 0;
        }
        limit.rlim_cur = limit.rlim_max;
        match libc::setrlimit(libc::RLIMIT_NOFILE, &raw const limit) {
            0 => limit.rlim_cur,
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_bound_is_known() {
        assert!(super::raise() > 0);
    }
}
