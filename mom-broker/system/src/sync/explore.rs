//! Runs a test in many interleavings of its threads.

use shuttle::scheduler::{PctScheduler, RandomScheduler, Scheduler};

/// Interleavings tried of each test with either scheduler, unless `MOM_ORDERS` says otherwise.
const ORDERS: usize = 400;

/// Preemptions at chosen points; few faults need more.
const SWITCHES: usize = 4;

/// Runs a test in many interleavings: some switch threads all the time, others seldom.
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
    // The hub needs more stack than shuttle's threads have by default.
    config.stack_size = 1 << 19;
    config.silence_warnings = true;
    shuttle::Runner::new(scheduler, config).run(test);
}
