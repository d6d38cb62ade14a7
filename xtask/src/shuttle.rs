//! `cargo xtask shuttle`: the tests that try the broker's threads in many orders of their steps.
//!
//! They are unit tests of the packages whose threads meet, built once more with the feature `shuttle`: it swaps the locks
//! of `mom-system`, and reaches nothing below that.

use std::path::Path;
use std::process::Command;

use anyhow::Result;

use crate::command::{cargo, line, shows};

/// Part of the names of all of them, and of no other test.
const NAME: &str = "interleaved";

/// The packages that have some.
const PACKAGES: &[&str] = &["mom-store", "mom-broker"];

/// Builds and runs them; whether all orders went well. `orders` and `seed` as the tests have them if not said.
pub(crate) fn run(root: &Path, orders: Option<u64>, seed: Option<u64>) -> Result<bool> {
    let mut tests = command(root);
    for (name, number) in [("MOM_ORDERS", orders), ("MOM_SEED", seed)] {
        if let Some(number) = number {
            tests.env(name, number.to_string());
        }
    }
    println!("$ {}", line(&tests));
    shows(&mut tests)
}

fn command(root: &Path) -> Command {
    let mut tests = cargo(root);
    tests.args(["test", "--locked", "--lib"]);
    for package in PACKAGES {
        let feature = format!("{package}/shuttle");
        tests.args(["--package", package, "--features", &feature]);
    }
    tests.arg(NAME);
    tests
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_package_is_built_with_its_feature() {
        let command = line(&command(Path::new(".")));
        for package in PACKAGES {
            let words = format!("--package {package} --features {package}/shuttle");
            assert!(command.contains(&words), "{command}");
        }
        assert!(command.ends_with(NAME), "{command}");
    }
}
