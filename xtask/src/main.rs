//! The project tasks of MOM: `cargo xtask lab`, `cargo xtask console`, `cargo xtask ci`, `cargo xtask test`, `cargo
//! xtask shuttle`, `cargo xtask tidy`, `cargo xtask mutants`, `cargo xtask instructions`, `cargo xtask bench-peers`,
//! `cargo xtask experiments`, `cargo xtask advisories`, `cargo xtask dist`.
//!
//! Everything that CI demands can be run here by the same commands, so that nothing is found only after a push.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program for people at a terminal"
)]

mod advisories;
mod ci;
mod clients;
mod command;
mod console;
mod counts;
mod dist;
mod experiments;
mod instructions;
mod javascript;
mod long;
mod measuring;
mod mutants;
mod needs;
mod node;
mod npm;
mod peers;
mod shuttle;
mod simulate;
mod test;
mod tidy;
mod verdict;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context as _, Result};
use clap::{Args, Parser, Subcommand};

/// The project's own checks and tasks.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

const EXAMPLES: &str = "Examples:
  cargo xtask lab --install                   install what is missing, build the console, start a lab with it
  cargo xtask lab -- --two-arms               a lab with other options
  cargo xtask test --install                  install what the tests need, then run all of them
  cargo xtask test -- -p mom-hub grab         the tests of one package whose name contains `grab`
  cargo xtask test -- -p mom-hub -- --nocapture
  cargo xtask shuttle --orders 20000 --seed 7 the broker's threads in more orders, and in other ones
  cargo xtask simulate --minutes 10           hub, devices and operators on a bad network, in virtual time
  cargo xtask long --minutes 30               more random logs and load than CI has time for
  cargo xtask mutants --package mom-hub       whether the hub's own tests notice faults; takes an hour
  cargo xtask tidy                            the checks that the compiler does not make
  cargo xtask bench-peers                     MOM beside other brokers, into docs/benchmarks.md
  cargo xtask bench-peers --quick --peers nats,redis
  cargo xtask experiments --only reach        what the papers measured, again, into docs/experiments.md
  cargo xtask measuring                       lints and tests of the measurements, which are a workspace of their own
  cargo xtask instructions                    what the hot path costs, held to benches/instructions.toml
  cargo xtask pack python                     the client in Python as a wheel, into target/packages
  cargo xtask advisories                      known vulnerabilities of what we depend upon
  cargo xtask dist                            what is installed: programs, packages, checksums, into target/dist
  cargo xtask ci                              everything that must hold before a change lands";

#[derive(Subcommand)]
enum Task {
    /// Start a lab with the console: `cargo xtask console`, then `cargo run --release -- lab`.
    #[command(after_help = EXAMPLES)]
    Lab(LabArgs),
    /// Build the console, which the programs have that are built after it; nothing is done if it is newer than its sources.
    Console(InstallArgs),
    /// Run all tests and doctests; the last line is `N passed, N failed`.
    #[command(after_help = EXAMPLES)]
    Test(TestArgs),
    /// Try the broker's threads in many orders of their steps.
    Shuttle(ShuttleArgs),
    /// Let worlds of a hub, devices and operators live in virtual time, seed after seed. See `--help` of what it runs: `-- --help`.
    Simulate {
        /// Its options, such as `--minutes 10 --seed 7`.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        options: Vec<String>,
    },
    /// Random logs by the thousand, then minutes of random load beside a canary.
    Long {
        /// How long the load lasts.
        #[arg(long, default_value_t = 10)]
        minutes: u64,
    },
    /// Change the code of packages in many ways, and see whether their own tests notice.
    #[command(after_help = EXAMPLES)]
    Mutants(MutantsArgs),
    /// Check what the compiler does not: sizes, orphans, codes, imports, leftovers, links, names.
    Tidy,
    /// Measure MOM beside nats, redis, mosquitto, zenoh and prosody; gets them first. See `-- --help` for more.
    #[command(after_help = EXAMPLES)]
    BenchPeers(PeersArgs),
    /// Measure TLS and WebSocket beside those of nats and mosquitto; gets them first. See `-- --help` for more.
    BenchDoors(PeersArgs),
    /// Run the papers' experiments again, into docs/experiments.md. See `-- --help` for more.
    #[command(after_help = EXAMPLES)]
    Experiments(ExperimentsArgs),
    /// Check the measurements below `benches`: format, lints, tests.
    Measuring {
        /// Store that they pass.
        #[arg(long)]
        write: bool,
    },
    /// Count what the hot path costs in instructions, and hold it to the stored counts.
    Instructions {
        /// Install valgrind if it is missing.
        #[command(flatten)]
        install: InstallArgs,
        /// Store what is counted now.
        #[arg(long)]
        write: bool,
    },
    /// Write the client of a language as a package, into target/packages.
    Pack {
        /// Its language: python, javascript or rust.
        language: String,
        #[command(flatten)]
        install: InstallArgs,
    },
    /// Build what is installed: stripped programs with man pages and completions, as an archive and as a package for
    /// Debian, with checksums.
    Dist(DistArgs),
    /// Look for known vulnerabilities in what we depend upon; downloads the list of them, and says so where it cannot.
    Advisories,
    /// Format, lints, docs, tidy, licences, tests: all that must hold before a change lands.
    Ci(InstallArgs),
}

#[derive(Args)]
struct LabArgs {
    #[command(flatten)]
    install: InstallArgs,
    /// Options of `mom lab`, such as `--two-arms` or `--listen 127.0.0.1:0`.
    #[arg(last = true, value_name = "OPTIONS OF THE LAB")]
    lab: Vec<String>,
}

#[derive(Args)]
struct TestArgs {
    #[command(flatten)]
    install: InstallArgs,
    /// Arguments for `cargo test`, such as `-p mom-hub` or a part of a test's name.
    #[arg(last = true, value_name = "ARGS TO CARGO TEST")]
    cargo_test: Vec<String>,
}

#[derive(Args)]
struct ShuttleArgs {
    /// Orders tried of each test in either way; 400 if not said.
    #[arg(long)]
    orders: Option<u64>,
    /// Another choice of orders; without it they are the same ones each time.
    #[arg(long)]
    seed: Option<u64>,
}

#[derive(Args)]
struct MutantsArgs {
    #[command(flatten)]
    install: InstallArgs,
    /// A package to try; may be repeated.
    #[arg(long = "package", short, value_name = "PACKAGE", default_values = mutants::PACKAGES)]
    packages: Vec<String>,
    /// How many mutants of each package; those of struct fields come on top.
    #[arg(long, default_value_t = 220)]
    count: usize,
    /// Another sample; the list of those that may live is complete for the default.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Mutants built and tested at once.
    #[arg(long, default_value_t = 2)]
    jobs: usize,
}

#[derive(Args)]
#[command(disable_help_flag = true)]
struct PeersArgs {
    /// Take the peers that are there, and install none.
    #[arg(long)]
    no_install: bool,
    /// Arguments for the measurement: --quick, --only, --peers, --runs, --no-write, --against, --help.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
    measure: Vec<String>,
}

#[derive(Args)]
#[command(disable_help_flag = true)]
struct ExperimentsArgs {
    /// Arguments for the experiments: --seed, --only, --quick, --no-write, --help.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGS")]
    experiment: Vec<String>,
}

#[derive(Args)]
struct DistArgs {
    /// Pack the programs in this folder, instead of building them as they are shipped.
    #[arg(long, value_name = "FOLDER")]
    programs: Option<PathBuf>,
    /// Where to, instead of target/dist: a folder that is empty, or not there yet.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Compress little, for a try.
    #[arg(long)]
    fast: bool,
    #[command(flatten)]
    install: InstallArgs,
}

#[derive(Args, Clone, Copy)]
struct InstallArgs {
    /// Install what is missing with the system's ordinary package clients.
    #[arg(long)]
    install: bool,
}

fn main() -> ExitCode {
    match run(Cli::parse().task) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(task: Task) -> Result<ExitCode> {
    let root = workspace_root()?;
    // What is needed and installed is named from there.
    std::env::set_current_dir(&root).with_context(|| format!("{} cannot be entered", root.display()))?;
    match task {
        Task::Lab(args) => {
            build_console(&root, args.install, "cargo xtask lab")
                .context("no console; the lab runs without it, too, by `cargo run --release -- lab`")?;
            Ok(exit_code(console::lab(&root, &args.lab)?))
        }
        Task::Console(install) => {
            build_console(&root, install, "cargo xtask console").map(|()| ExitCode::SUCCESS)
        }
        Task::Test(args) => {
            needs::ensure_all(needs::FOR_ALL_TESTS, args.install.install, "cargo xtask test")?;
            let counts = test::run(&root, &args.cargo_test)?;
            counts.show_failures();
            println!("{counts}");
            Ok(exit_code(counts.is_success()))
        }
        Task::Shuttle(args) => Ok(exit_code(shuttle::run(&root, args.orders, args.seed)?)),
        Task::Simulate { options } => Ok(exit_code(simulate::run(&root, &options)?)),
        Task::Long { minutes } => Ok(exit_code(long::run(&root, minutes)?)),
        Task::Mutants(args) => {
            needs::ensure(needs::FOR_MUTANTS, args.install.install, "cargo xtask mutants")?;
            let sample = mutants::Sample {
                packages: &args.packages,
                count: args.count,
                seed: args.seed,
                jobs: args.jobs,
            };
            Ok(exit_code(mutants::run(&root, &sample)?))
        }
        Task::BenchPeers(args) => bench(&root, "bench-peers", &args),
        Task::BenchDoors(args) => bench(&root, "bench-doors", &args),
        Task::Experiments(args) => Ok(exit_code(experiments::run(&root, &args.experiment)?)),
        Task::Instructions { install, write } => {
            needs::ensure(
                needs::FOR_INSTRUCTIONS,
                install.install,
                "cargo xtask instructions",
            )?;
            Ok(exit_code(instructions::run(&root, write)?))
        }
        Task::Measuring { write } => {
            needs::ensure_all(needs::FOR_ALL_TESTS, false, "cargo xtask measuring")?;
            Ok(exit_code(measuring::run(&root, write)?))
        }
        Task::Pack { language, install } => {
            needs::ensure(needs::FOR_CLIENTS, install.install, "cargo xtask pack")?;
            clients::pack(&root, &language)?;
            Ok(ExitCode::SUCCESS)
        }
        Task::Dist(args) => {
            needs::ensure(needs::FOR_DIST, args.install.install, "cargo xtask dist")?;
            if args.programs.is_none() {
                // The programs that are packed have it.
                build_console(&root, args.install, "cargo xtask dist")?;
            }
            let (programs, out) = (args.programs.as_deref(), args.out.as_deref());
            dist::run(&root, programs, out, args.fast)?;
            Ok(ExitCode::SUCCESS)
        }
        Task::Advisories => Ok(exit_code(advisories::run(&root)?)),
        Task::Tidy => Ok(exit_code(tidy::run(&root)?)),
        Task::Ci(args) => {
            needs::ensure_all(needs::FOR_ALL_OF_CI, args.install, "cargo xtask ci")?;
            Ok(exit_code(ci::run(&root)?))
        }
    }
}

fn bench(root: &Path, program: &str, args: &PeersArgs) -> Result<ExitCode> {
    peers::run(root, program, args.no_install, &args.measure).map(exit_code)
}

fn build_console(root: &Path, install: InstallArgs, task: &str) -> Result<()> {
    needs::ensure(needs::FOR_CONSOLE, install.install, task)?;
    console::build(root)
}

fn exit_code(success: bool) -> ExitCode {
    if success {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    }
}

/// The folder of the workspace: cargo says where this package is, and without cargo it is looked for upwards.
fn workspace_root() -> Result<PathBuf> {
    if let Some(package) = std::env::var_os("CARGO_MANIFEST_DIR")
        && let Some(root) = Path::new(&package).parent()
        && is_workspace_root(root)
    {
        return Ok(root.to_path_buf());
    }
    let here = std::env::current_dir().context("the current folder cannot be read")?;
    here.ancestors()
        .find(|folder| is_workspace_root(folder))
        .map(Path::to_path_buf)
        .context("no workspace here: run `cargo xtask` inside a checkout of MOM")
}

fn is_workspace_root(folder: &Path) -> bool {
    folder.join("xtask/Cargo.toml").is_file() && folder.join("Cargo.toml").is_file()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory as _;
        Cli::command().debug_assert();
    }

    #[test]
    fn what_follows_two_dashes_goes_to_cargo_test_with_its_own_dashes() {
        let cli = Cli::try_parse_from([
            "x",
            "test",
            "--install",
            "--",
            "-p",
            "mom-hub",
            "--",
            "--nocapture",
        ])
        .unwrap();
        let Task::Test(args) = cli.task else {
            panic!("not the test task")
        };
        assert!(args.install.install);
        assert_eq!(args.cargo_test, ["-p", "mom-hub", "--", "--nocapture"]);
    }

    #[test]
    fn what_follows_two_dashes_goes_to_the_lab() {
        let cli = Cli::try_parse_from([
            "x",
            "lab",
            "--install",
            "--",
            "--two-arms",
            "--listen",
            "127.0.0.1:0",
        ]);
        let Task::Lab(args) = cli.unwrap().task else {
            panic!("not the lab")
        };
        assert!(args.install.install);
        assert_eq!(args.lab, ["--two-arms", "--listen", "127.0.0.1:0"]);
    }

    #[test]
    fn what_follows_bench_peers_goes_to_the_measurement() {
        let cli =
            Cli::try_parse_from(["x", "bench-peers", "--no-install", "--quick", "--peers", "nats"]).unwrap();
        let Task::BenchPeers(args) = cli.task else {
            panic!("not the comparison")
        };
        assert!(args.no_install);
        assert_eq!(args.measure, ["--quick", "--peers", "nats"]);
    }

    #[test]
    fn what_follows_experiments_goes_to_them() {
        let cli = Cli::try_parse_from(["x", "experiments", "--seed", "7", "--only", "reach"]).unwrap();
        let Task::Experiments(args) = cli.task else {
            panic!("not the experiments")
        };
        assert_eq!(args.experiment, ["--seed", "7", "--only", "reach"]);
    }

    #[test]
    fn the_workspace_is_found_from_inside() {
        assert!(workspace_root().unwrap().join("mom-proto/Cargo.toml").is_file());
    }
}
