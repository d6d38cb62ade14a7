//! What the hub decides, in detail: `cargo bench --manifest-path benches/Cargo.toml --bench hub`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use mom_benches::decisions::{Admissions, Decisions};

/// Makes some decisions and says how many.
type Turn = fn(&mut Decisions) -> u64;

const MEMBERS: [u64; 3] = [1, 100, 1000];

fn decide(criterion: &mut Criterion) {
    let turns: [(&str, Turn); 3] = [
        ("leave and join", Decisions::leave_join),
        ("grab and release", Decisions::grab_release),
        ("send by way of the hub", Decisions::send),
    ];
    for (name, turn) in turns {
        let mut group = criterion.benchmark_group(name);
        for members in MEMBERS {
            let mut decisions = Decisions::new(members).expect("an open hub lets all in");
            group.throughput(Throughput::Elements(turn(&mut decisions)));
            group.bench_function(BenchmarkId::from_parameter(members), |bencher| {
                bencher.iter(|| turn(&mut decisions));
            });
        }
    }
}

fn admit(criterion: &mut Criterion) {
    for (name, addressed) in [("admit, to all", false), ("admit, to one by name", true)] {
        let mut group = criterion.benchmark_group(name);
        group.throughput(Throughput::Elements(1));
        for members in MEMBERS {
            let mut admissions = Admissions::new(members, addressed).expect("an open channel admits");
            group.bench_function(BenchmarkId::from_parameter(members), |bencher| {
                bencher.iter(|| admissions.admit());
            });
        }
    }
}

criterion_group!(hub, decide, admit);
criterion_main!(hub);
