//! What the machine has.

use std::fs::read_to_string;

/// The bytes of memory that this process may use: the machine's, or those of its control group if that has fewer. None
/// where the system does not say.
pub fn machine_memory() -> Option<usize> {
    let machine = read_to_string("/proc/meminfo").ok().and_then(|text| total(&text));
    // Version 2, which has one group for all resources; inside a container it is the root of what is seen.
    let group = read_to_string("/proc/self/cgroup").ok();
    let group = group
        .as_deref()
        .and_then(|text| text.lines().find_map(|line| line.strip_prefix("0::")));
    let group = group.and_then(|path| {
        let file = format!("/sys/fs/cgroup{}/memory.max", path.trim_end_matches('/'));
        read_to_string(file).ok()?.trim().parse().ok()
    });
    [machine, group].into_iter().flatten().min()
}

fn total(meminfo: &str) -> Option<usize> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: usize = line.split_whitespace().next()?.parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_read_in_bytes() {
        assert_eq!(
            total("MemTotal:        4030000 kB\nMemFree: 1 kB\n"),
            Some(4_126_720_000)
        );
        assert_eq!(total("MemFree: 1 kB\n"), None);
    }
}
