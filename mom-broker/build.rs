//! Has cargo embed the console anew when it has been built, or is gone; the build itself needs neither Node nor a network.

use std::path::Path;

fn main() {
    // While there is none, its folder is looked at as a whole: a path that does not exist would have this package built each time.
    let watched = ["../console/dist", "../console"];
    let there = watched.into_iter().find(|path| Path::new(path).exists());
    println!("cargo::rerun-if-changed=build.rs");
    if let Some(path) = there {
        println!("cargo::rerun-if-changed={path}");
    }
}
