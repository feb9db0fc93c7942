//! The same bits at every width of vector instructions.

use std::cell::Cell;

use pulp::Arch;

use crate::cost::Metric;
use crate::scan::Workers;
use crate::{Solution, between_points};

thread_local! {
    static LEVEL: Cell<Option<Arch>> = const { Cell::new(None) };
}

/// The level that a test has chosen for its thread, otherwise the widest.
pub(crate) fn arch() -> Arch {
    LEVEL.get().unwrap_or_default()
}

/// All levels that the processor has.
fn levels() -> Vec<Arch> {
    #[allow(unused_mut)]
    let mut levels = vec![Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(pulp::x86::V3::try_new().map(Arch::V3));
        levels.extend(pulp::x86::V4::try_new().map(Arch::V4));
    }
    levels
}

fn bits(solution: &Solution) -> Vec<u64> {
    let numbers = [&solution.mass, &solution.alpha, &solution.beta].into_iter().flatten().map(|v| v.to_bits());
    let places = solution.rows.iter().chain(&solution.cols).map(|&place| place as u64);
    numbers.chain(places).chain([solution.cost.to_bits(), solution.gap.to_bits()]).collect()
}

/// Every method, with sizes that are no multiples of a vector.
#[test]
fn solutions_have_the_same_bits_at_every_level() {
    let numbers = |salt: u32, len: usize| -> Vec<f64> {
        (0..len as u32).map(|k| f64::from((k + salt).wrapping_mul(2_654_435_761) >> 12) / 1e6).collect()
    };
    for (n, m, dim) in [(37, 37, 3), (61, 45, 2), (333, 333, 5), (701, 9, 6), (1151, 1103, 2), (1131, 1131, 3)] {
        let (x, y) = (numbers(1, n * dim), numbers(77_777, m * dim));
        for metric in [Metric::Euclidean, Metric::CityBlock] {
            let weights: Vec<f64> = (1..=n).map(|i| 1.0 + (i % 7) as f64).collect();
            let total: f64 = weights.iter().sum();
            let others = vec![total / m as f64; m];
            for weights in [(None, None), (Some(&weights[..]), Some(&others[..]))] {
                let solve = |level| {
                    LEVEL.set(Some(level));
                    let workers = Workers::new(1).unwrap();
                    let solution = between_points(&x, &y, dim, metric, weights, &workers, &mut || true).unwrap();
                    LEVEL.set(None);
                    bits(&solution)
                };
                let all: Vec<Vec<u64>> = levels().into_iter().map(solve).collect();
                assert!(all.iter().all(|other| *other == all[0]), "{n} x {m}, {dim} coordinates, {metric:?}");
            }
        }
    }
}
