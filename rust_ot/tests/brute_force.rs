//! Small problems against all permutations, and what every answer must satisfy.

use proptest::prelude::*;
use rust_ot::cost::{Cost, Metric};
use rust_ot::line::Line;
use rust_ot::matrix::Matrix;
use rust_ot::points::Points;
use rust_ot::scan::Workers;
use rust_ot::{OtError, Solution, between_numbers, between_points, with_cost};

fn least_assignment(costs: &[f64], n: usize) -> f64 {
    fn descend(costs: &[f64], n: usize, row: usize, used: u32) -> f64 {
        if row == n {
            return 0.0;
        }
        let free = (0..n).filter(|j| used & (1 << j) == 0);
        free.map(|j| costs[row * n + j] + descend(costs, n, row + 1, used | (1 << j))).fold(f64::INFINITY, f64::min)
    }
    descend(costs, n, 0, 0)
}

/// Least cost over all ways to ship whole units, one unit at a time.
fn least_shipment(costs: &[f64], supply: &mut [u32], demand: &mut [u32]) -> f64 {
    let Some(row) = supply.iter().position(|&s| s > 0) else { return 0.0 };
    let mut best = f64::INFINITY;
    for col in 0..demand.len() {
        if demand[col] == 0 {
            continue;
        }
        supply[row] -= 1;
        demand[col] -= 1;
        best = best.min(costs[row * demand.len() + col] + least_shipment(costs, supply, demand));
        supply[row] += 1;
        demand[col] += 1;
    }
    best
}

fn check(solution: &Solution, cost: &dyn Cost, a: &[f64], b: &[f64]) -> Result<(), TestCaseError> {
    let (n, m) = (cost.rows(), cost.cols());
    let (mut row_sums, mut col_sums) = (vec![0.0; n], vec![0.0; m]);
    for ((&i, &j), &mass) in solution.rows.iter().zip(&solution.cols).zip(&solution.mass) {
        let (i, j) = (i as usize, j as usize);
        row_sums[i] += mass;
        col_sums[j] += mass;
        let slack = cost.unscaled(i, j) - solution.alpha[i] - solution.beta[j];
        prop_assert!(mass > 0.0);
        prop_assert!(slack.abs() < 1e-10, "arc ({i}, {j}) with mass has slack {slack}");
    }
    for i in 0..n {
        for j in 0..m {
            let slack = cost.unscaled(i, j) - solution.alpha[i] - solution.beta[j];
            prop_assert!(slack > -1e-10, "potentials of ({i}, {j}) exceed the cost by {}", -slack);
        }
    }
    for (sum, weight) in row_sums.iter().zip(a).chain(col_sums.iter().zip(b)) {
        prop_assert!((sum - weight).abs() < 1e-12, "margin {sum} instead of {weight}");
    }
    prop_assert!(solution.rows.len() < n + m);
    Ok(())
}

fn points(n: std::ops::Range<usize>, dim: usize) -> impl Strategy<Value = Vec<f64>> {
    let coordinate = prop_oneof![(-3i32..4).prop_map(f64::from), -5.0..5.0f64];
    proptest::collection::vec(coordinate, n.start * dim..n.end * dim).prop_map(move |mut v| {
        v.truncate(v.len() / dim * dim);
        v
    })
}

proptest! {
    #[test]
    fn equal_masses_reach_the_best_permutation(costs in (1usize..=7).prop_flat_map(|n| {
        let cost = prop_oneof![(-2i32..3).prop_map(f64::from), -1.0..1.0f64];
        proptest::collection::vec(cost, n * n)
    })) {
        let n = costs.len().isqrt();
        let matrix = Matrix::new(&costs, n).unwrap();
        let solution = with_cost(&matrix, (None, None), &Workers::new(1).unwrap(), &mut || true).unwrap();
        let expected = least_assignment(&costs, n) / n as f64;
        prop_assert!((solution.cost - expected).abs() < 1e-13);
        let weights = vec![1.0 / n as f64; n];
        check(&solution, &matrix, &weights, &weights)?;
    }

    #[test]
    fn whole_masses_reach_the_best_shipment(
        supply in proptest::collection::vec(0u32..3, 1..4),
        split in proptest::collection::vec(0usize..4, 6),
        costs in proptest::collection::vec(-3.0..3.0f64, 12),
    ) {
        let units: u32 = supply.iter().sum();
        prop_assume!(units > 0);
        let mut demand = vec![0u32; 4];
        for k in 0..units as usize {
            demand[split[k % split.len()]] += 1;
        }
        let real = |v: &[u32]| -> Vec<f64> { v.iter().map(|&x| f64::from(x)).collect() };
        let (a, b) = (real(&supply), real(&demand));
        let costs = &costs[..supply.len() * 4];
        let matrix = Matrix::new(costs, 4).unwrap();
        let solution = with_cost(&matrix, (Some(&a), Some(&b)), &Workers::new(1).unwrap(), &mut || true).unwrap();
        let expected = least_shipment(costs, &mut supply.clone(), &mut demand);
        prop_assert!((solution.cost - expected).abs() < 1e-12);
        check(&solution, &matrix, &a, &b)?;
    }

    #[test]
    fn forbidden_pairs_of_any_cost_leave_the_best_shipment(
        supply in proptest::collection::vec(1u32..3, 3),
        costs in proptest::collection::vec((0u8..8, any::<bool>()), 9),
        exponent in 4i32..300,
    ) {
        // What each row has may stay in its own column, so that a plan without forbidden pairs exists.
        let priced = |forbidden: f64| -> Vec<f64> {
            let price = |(k, &(cost, free)): (usize, &(u8, bool))| {
                if free || k % 4 == 0 { f64::from(cost) / 8.0 } else { forbidden }
            };
            costs.iter().enumerate().map(price).collect()
        };
        let weights: Vec<f64> = supply.iter().map(|&units| f64::from(units)).collect();
        let expected = least_shipment(&priced(1e3), &mut supply.clone(), &mut supply.clone());
        let costs = priced(10f64.powi(exponent));
        let matrix = Matrix::new(&costs, 3).unwrap();
        let weights = (Some(&weights[..]), Some(&weights[..]));
        let solution = with_cost(&matrix, weights, &Workers::new(1).unwrap(), &mut || true).unwrap();
        prop_assert!((solution.cost - expected).abs() < 1e-12, "{} instead of {expected}", solution.cost);
        prop_assert!(solution.gap.abs() <= 1e-12 * solution.cost);
    }

    #[test]
    fn every_answer_carries_its_proof(
        x in points(1..30, 2), y in points(1..30, 2), seed in 0u32..1000, kind in 0..3usize,
    ) {
        let metric = [Metric::Euclidean, Metric::SqEuclidean, Metric::CityBlock][kind];
        let weights = |len: usize, salt: u32| -> Vec<f64> {
            let raw: Vec<f64> = (0..len as u32).map(|i| f64::from((i + 7 * salt + seed) * 7919 % 13)).collect();
            let total: f64 = raw.iter().sum();
            if total == 0.0 { vec![1.0 / len as f64; len] } else { raw.iter().map(|w| w / total).collect() }
        };
        let (a, b) = (weights(x.len() / 2, 1), weights(y.len() / 2, 2));
        let solution = between_points(&x, &y, 2, metric, (Some(&a), Some(&b)), &Workers::new(1).unwrap(), &mut || true).unwrap();
        check(&solution, &Points::new(&x, &y, 2, metric).unwrap(), &a, &b)?;
    }

    #[test]
    fn on_a_line_sorting_and_simplex_agree(x in points(1..40, 1), y in points(1..40, 1), squared: bool) {
        let metric = if squared { Metric::SqEuclidean } else { Metric::Euclidean };
        let cost = Points::new(&x, &y, 1, metric).unwrap();
        let by_sorting = between_points(&x, &y, 1, metric, (None, None), &Workers::new(1).unwrap(), &mut || true).unwrap();
        let by_simplex = with_cost(&cost, (None, None), &Workers::new(1).unwrap(), &mut || true).unwrap();
        prop_assert!((by_sorting.cost - by_simplex.cost).abs() < 1e-12);
        check(&by_sorting, &cost, &vec![1.0 / x.len() as f64; x.len()], &vec![1.0 / y.len() as f64; y.len()])?;
    }

    #[test]
    fn every_order_on_a_line_is_sorting(x in points(1..20, 1), y in points(1..20, 1), order in 1.0..5.0f64) {
        let unit = |values: &[f64]| -> Vec<f64> { values.iter().map(|v| v / 16.0).collect() };
        let (x, y) = (unit(&x), unit(&y));
        let cost = Line::new(&x, &y, order);
        let by_sorting = between_numbers(&x, &y, order, (None, None), &mut || true).unwrap();
        let by_simplex = with_cost(&cost, (None, None), &Workers::new(1).unwrap(), &mut || true).unwrap();
        prop_assert!((by_sorting.cost - by_simplex.cost).abs() < 1e-13);
        check(&by_sorting, &cost, &vec![1.0 / x.len() as f64; x.len()], &vec![1.0 / y.len() as f64; y.len()])?;
    }
}

#[test]
fn a_caller_can_stop_a_long_search() {
    let side = 400;
    let costs: Vec<f64> = (0..side * side).map(|k| f64::from((k as u32).wrapping_mul(2_654_435_761) >> 8)).collect();
    let matrix = Matrix::new(&costs, side).unwrap();
    let weights: Vec<f64> = (1..=side).map(|i| i as f64).collect();
    let result = with_cost(&matrix, (Some(&weights), None), &Workers::new(1).unwrap(), &mut || false);
    assert_eq!(result.unwrap_err(), OtError::Interrupted);
}

#[test]
fn threads_and_methods_give_one_answer() {
    let coordinates = |salt: u32, len: u32| -> Vec<f64> {
        (0..len).map(|k| f64::from((k + salt).wrapping_mul(2_654_435_761) >> 12) / 1e6).collect()
    };
    let (x, y) = (coordinates(1, 3 * 1300), coordinates(77_777, 3 * 1300));
    let weights: Vec<f64> = (1..=1300).map(|i| 1.0 + f64::from(i % 7)).collect();
    for weights in [None, Some(&weights[..])] {
        let solve = |threads: usize| {
            let workers = Workers::new(threads).unwrap();
            between_points(&x, &y, 3, Metric::Euclidean, (weights, weights), &workers, &mut || true).unwrap()
        };
        let (one, three) = (solve(1), solve(3));
        assert_eq!(one.cost.to_bits(), three.cost.to_bits());
        assert_eq!(
            (&one.alpha, &one.beta, &one.rows, &one.cols),
            (&three.alpha, &three.beta, &three.rows, &three.cols)
        );
        let points = Points::new(&x, &y, 3, Metric::Euclidean).unwrap();
        let total = weights.map_or(1.0, |w| w.iter().sum());
        let a = weights.map_or(vec![1.0 / 1300.0; 1300], <[f64]>::to_vec);
        assert!(one.gap.abs() < 1e-10 * total * one.cost);
        check(&one, &points, &a, &a).unwrap();
    }
}
