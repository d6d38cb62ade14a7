//! What the codecs read and write, in detail: `cargo bench --manifest-path benches/Cargo.toml --bench codec`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use mom_benches::codecs::{Coding, SIZES};
use mom_proto::codec::Form;

fn codec(criterion: &mut Criterion) {
    for form in Form::ALL {
        for content in SIZES {
            let mut coding = Coding::new(form, content).expect("a parcel that every form can hold");
            let mut group = criterion.benchmark_group(form.word());
            let bytes = |size: usize| Throughput::Bytes(size as u64);
            group.throughput(bytes(coding.size()));
            group.bench_function(BenchmarkId::new("encode", content), |bencher| {
                bencher.iter(|| coding.encode());
            });
            let read = coding.decode_many().expect("what was encoded is decoded");
            group.throughput(bytes(read));
            group.bench_function(BenchmarkId::new("decode", content), |bencher| {
                bencher.iter(|| coding.decode_many());
            });
        }
    }
}

criterion_group!(benches, codec);
criterion_main!(benches);
