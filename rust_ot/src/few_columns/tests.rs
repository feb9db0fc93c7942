//! The search between few columns against plain loops and the simplex over the whole table.

use super::*;
use crate::network_simplex::{self, Table, Tolerance};
use crate::threaded_tree::ThreadedTree;

fn numbers(salt: u32, len: usize) -> impl Iterator<Item = u32> {
    (0..len as u32).map(move |k| (k + 131 * salt).wrapping_mul(2_654_435_761) >> 9)
}

#[test]
fn the_two_best_columns_are_those_of_a_sorted_row() {
    for (n, m) in [(1, 1), (3, 2), (8, 5), (37, 4), (64, 32)] {
        let costs: Vec<f64> = numbers(n as u32, n * m).map(|x| f64::from(x % 13)).collect();
        let v: Vec<f64> = numbers(7, m).map(|x| f64::from(x % 5)).collect();
        let choice = movers::choose(Columns { costs: &costs, rows: n }, &v);
        for i in 0..n {
            let mut values: Vec<(f64, usize)> = (0..m).map(|j| (costs[j * n + i] - v[j], j)).collect();
            values.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            assert_eq!((choice.least[i], choice.best[i] as usize), values[0]);
            let second = values.get(1).copied().unwrap_or((f64::INFINITY, 0));
            assert_eq!(choice.second[i], second.0);
            // Of equal second bests any may be named.
            assert!(m == 1 || costs[choice.next[i] as usize * n + i] - v[choice.next[i] as usize] == second.0);
            assert!(m == 1 || choice.next[i] != choice.best[i]);
        }
    }
}

/// Ties, ties within rounding, and masses from one quantum to many.
#[test]
fn plans_are_as_cheap_as_those_of_the_simplex() {
    for salt in 0..300u32 {
        let (n, m) = ([40, 130, 700][salt as usize % 3], 2 + (salt as usize / 3) % 9);
        let steps = [3, 1000, 4_000_000][salt as usize % 7 % 3];
        let costs: Vec<f64> = numbers(salt, n * m).map(|x| f64::from(x % steps) / f64::from(steps)).collect();
        let largest = [1, 40, 1_000_000][salt as usize % 5 % 3];
        let rows: Vec<i64> = numbers(salt + 1, n).map(|x| 1 + i64::from(x % largest)).collect();
        let total: i64 = rows.iter().sum();
        let mut cols: Vec<i64> = (0..m as i64).map(|j| (total * (j + 1) / (m * m) as i64).max(1)).collect();
        cols[0] += total - cols.iter().sum::<i64>();
        assert!(cols[0] > 0);
        let mut go_on = || true;
        let mut watch = Watch::new(&mut go_on, u64::MAX);
        let found = solve(Columns { costs: &costs, rows: n }, &rows, &cols, PATHS_A_NODE, &mut watch).unwrap().unwrap();

        let (mut left, mut right) = (rows.clone(), cols.clone());
        let mut cost = 0.0;
        for &(i, j, mass) in &found.arcs {
            left[i] -= mass;
            right[j] -= mass;
            cost += costs[j * n + i] * mass as f64 / total as f64;
        }
        assert!(left.iter().chain(&right).all(|&rest| rest == 0), "{salt}: masses");
        assert!(found.arcs.len() < n + m, "{salt}: a cycle");
        let turned: Vec<f64> = (0..n * m).map(|k| costs[k % m * n + k / m]).collect();
        let star = ThreadedTree::star(&rows, &cols, 1.01);
        let tolerance = Tolerance::new(1.0, n + m);
        let tree =
            network_simplex::solve(Table { costs: &turned, cols: m }, star, tolerance, None, &mut watch).unwrap();
        let least: f64 = tree.arcs().map(|(i, j, mass)| costs[j * n + i] * mass as f64 / total as f64).sum();
        assert!((cost - least).abs() < 1e-13, "{salt}: {cost} instead of {least}");
    }
}
