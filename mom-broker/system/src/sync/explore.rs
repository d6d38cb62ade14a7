//! Runs a test in many orders of its threads' steps.

use shuttle::scheduler::{PctScheduler, RandomScheduler, Scheduler};

/// Orders tried of each test in either way, unless `MOM_ORDERS` says otherwise.
const ORDERS: usize = 400;

/// Switches at places that matter; more than that few faults need.
const SWITCHES: usize = 4;

/// Runs a test in many orders: such that switch all the time, and such that switch seldom.
///
/// They are the same ones each time, unless `MOM_SEED` says otherwise.
pub fn explore(test: fn()) {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse().ok());
    let orders = number("MOM_ORDERS").map_or(ORDERS, |orders: u64| usize::try_from(orders).unwrap_or(ORDERS));
    let seed = number("MOM_SEED").unwrap_or(0x4d_4f4d);
    run(RandomScheduler::new_from_seed(seed, orders), test);
    run(PctScheduler::new_from_seed(seed, SWITCHES, orders), test);
}

fn run(scheduler: impl Scheduler + 'static, test: fn()) {
    let mut config = shuttle::Config::new();
    // The hub decides with more of it than shuttle's threads have by themselves.
    config.stack_size = 1 << 19;
    config.silence_warnings = true;
    shuttle::Runner::new(scheduler, config).run(test);
}
