//! Few points against many: the search along paths, and the simplex where that gives up.

use super::*;
use crate::few_columns::{Columns, PATHS_A_NODE};
use crate::matrix::Matrix;

/// Costs with many ties, and masses of equal totals.
fn problem(salt: u32, n: usize, m: usize) -> (Vec<f64>, Vec<i64>, Vec<i64>) {
    let number = |k: usize| (k as u32 + 77 * salt).wrapping_mul(2_654_435_761) >> 11;
    let costs = (0..n * m).map(|k| f64::from(number(k) % 7)).collect();
    let rows: Vec<i64> = (0..n).map(|i| i64::from(1 + number(1000 + i) % 50)).collect();
    let mut cols: Vec<i64> = (0..m).map(|j| i64::from(1 + number(5000 + j) % 9)).collect();
    cols[0] += rows.iter().sum::<i64>() - cols.iter().sum::<i64>();
    (costs, rows, cols)
}

fn total(best: &Optimum, cost: &dyn Cost) -> f64 {
    best.arcs.iter().map(|&(i, j, mass)| mass as f64 * cost.at(i, j)).sum()
}

#[test]
fn the_simplex_takes_over_where_paths_do_not_suffice() {
    for salt in 0..30 {
        for (n, m) in [(120, 5), (5, 120)] {
            let (long, short) = (n.max(m), n.min(m));
            let (costs, long_masses, short_masses) = problem(salt, long, short);
            let (rows, cols) = if n > m { (&long_masses, &short_masses) } else { (&short_masses, &long_masses) };
            let matrix = Matrix::new(&costs, m).unwrap();
            let columns = if n > m { matrix.by_columns() } else { table(&matrix) };
            let mut go_on = || true;
            let mut watch = Watch::new(&mut go_on, u64::MAX);
            let table = Columns { costs: &columns, rows: long };
            let given_up = few_columns::solve(table, &long_masses, &short_masses, 0, &mut watch).unwrap();
            assert!(given_up.is_none(), "{salt}: no path was needed");
            let by_simplex = solve_few(&matrix, rows, cols, 0, &mut watch).unwrap();
            let by_paths = solve_few(&matrix, rows, cols, PATHS_A_NODE, &mut watch).unwrap();
            assert!((total(&by_simplex, &matrix) - total(&by_paths, &matrix)).abs() < 1e-10, "{salt}: {n} x {m}");
        }
    }
}

#[test]
fn few_are_as_many_as_paths_are_good_for() {
    assert!(is_few(33, 545) && !is_few(33, 544));
    assert!(is_few(256, 32_768) && !is_few(257, 1 << 18));
    assert!(!is_few(256, (FEW_PAIRS / 256) + 1));
    for salt in 0..4 {
        let (long, short) = (1200, 48);
        let (costs, rows, cols) = problem(salt, long, short);
        let matrix = Matrix::new(&costs, short).unwrap();
        let mut go_on = || true;
        let mut watch = Watch::new(&mut go_on, u64::MAX);
        let by_paths = solve_few(&matrix, &rows, &cols, PATHS_A_NODE, &mut watch).unwrap();
        let by_simplex = solve_table(&matrix, &rows, &cols, &mut watch).unwrap();
        assert!((total(&by_simplex, &matrix) - total(&by_paths, &matrix)).abs() < 1e-10, "{salt}");
        let chosen = solve(&matrix, &rows, &cols, &Workers::new(1).unwrap(), &mut watch).unwrap();
        assert!((total(&chosen, &matrix) - total(&by_paths, &matrix)).abs() < 1e-10, "{salt}");
    }
}
