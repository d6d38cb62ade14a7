//! The conditions of a run, as far as figures depend on them.

/// The machine in a few words: cores, processor, system.
pub fn describe() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let read = |path| std::fs::read_to_string(path).unwrap_or_default();
    let model = read("/proc/cpuinfo")
        .lines()
        .find(|line| line.starts_with("model name"))
        .and_then(|line| line.split_once(": "))
        .map_or_else(
            || std::env::consts::ARCH.to_owned(),
            |(_, model)| model.to_owned(),
        );
    let kernel = read("/proc/sys/kernel/osrelease");
    // Only the version: what follows it names a builder.
    let version = kernel.split(['-', '\n']).next().unwrap_or_default();
    format!("{cores} cores, {model}, {} {version}", std::env::consts::OS)
}

/// How many threads ran or wanted to in the last minute, beside which nothing here is fast; none where the system
/// does not say.
pub fn load() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split(' ').next()?.parse().ok()
}
