//! Rays against a mesh of 100,000 triangles, on every path that this machine has: `cargo bench -p tilecast-bench`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use tilecast_bench::rays::{AllClosest, AllOccluded, hierarchy, incoherent, primary, torus};
use tilecast_core::bvh::simd::Isa;

fn traversal(criterion: &mut Criterion) {
    let mesh = hierarchy(&torus(100_000));
    for (kind, rays) in [("primary", primary(128)), ("incoherent", incoherent(1 << 14))] {
        let mut group = criterion.benchmark_group(kind);
        group.throughput(Throughput::Elements(rays.len() as u64));
        for isa in Isa::available() {
            for (way, many) in [("", false), ("/many", true)] {
                group.bench_function(format!("closest/{}{way}", isa.name()), |bencher| {
                    bencher.iter(|| isa.dispatch(AllClosest(&mesh, black_box(&rays), many)));
                });
                group.bench_function(format!("any/{}{way}", isa.name()), |bencher| {
                    bencher.iter(|| isa.dispatch(AllOccluded(&mesh, black_box(&rays), many)));
                });
            }
        }
        group.finish();
    }
}

criterion_group!(benches, traversal);
criterion_main!(benches);
