//! Times of the solvers; `cargo bench -p rust_ot`.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use rust_ot::between_points;
use rust_ot::cost::Metric;
use rust_ot::scan::Workers;

/// Numbers in 0..1 from a fixed sequence.
fn numbers(len: usize, mut state: u64) -> Vec<f64> {
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    (0..len).map(|_| next()).collect()
}

fn solve(c: &mut Criterion) {
    let workers = Workers::new(1).expect("one thread");
    for (name, weighted) in [("equal", false), ("weighted", true)] {
        let mut group = c.benchmark_group(name);
        group.sample_size(10);
        for (n, m, d) in
            [(100, 100, 6), (300, 300, 6), (1000, 1000, 6), (1000, 1000, 30), (2000, 10, 6), (2000, 2000, 6)]
        {
            let (x, y) = (numbers(n * d, 1), numbers(m * d, 2));
            let mut weights = (numbers(n, 3), numbers(m, 4));
            let total: f64 = weights.0.iter().sum::<f64>() / weights.1.iter().sum::<f64>();
            weights.1.iter_mut().for_each(|w| *w *= total);
            let weights = if weighted { (Some(&weights.0[..]), Some(&weights.1[..])) } else { (None, None) };
            group.bench_function(BenchmarkId::from_parameter(format!("{n}x{m}x{d}")), |bencher| {
                bencher.iter(|| between_points(&x, &y, d, Metric::Euclidean, weights, &workers, &mut || true));
            });
        }
    }
}

criterion_group!(benches, solve);
criterion_main!(benches);
