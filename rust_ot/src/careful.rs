//! A second way, for the rare problem whose first plan is not proven to the last digits: points with hardly any mass pay
//! most of the cost, or costs are of very different sizes.
//!
//! It differs in four things. Masses come in quanta so fine that weights are exact. A reduced cost counts as soon as it
//! is beyond its own rounding, not that of typical ones. Potentials are counted from the heaviest point, in doubled
//! precision. And where rounding makes them exceed a cost, the potential of the lighter point gives way.

use crate::coarse_to_fine::{Optimum, table};
use crate::cost::Cost;
use crate::error::OtError;
use crate::mass::Mass;
use crate::network_simplex::{self, Table, Tolerance};
use crate::precise::two_sum;
use crate::sparse_transport::artificial_cost;
use crate::threaded_tree::ThreadedTree;
use crate::watch::Watch;

/// Solves the problem for positive masses of equal totals.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve<M: Mass>(cost: &dyn Cost, rows: &[M], cols: &[M], watch: &mut Watch<'_>) -> Result<Optimum<M>, OtError> {
    let (costs, n, m) = (table(cost), rows.len(), cols.len());
    let heaviest = rows.iter().chain(cols).enumerate().max_by_key(|(_, mass)| **mass).map_or(0, |(node, _)| node);
    let star = ThreadedTree::star(rows, cols, artificial_cost(cost));
    let tolerance = Tolerance::fine(n + m + 1);
    let tree = network_simplex::solve(Table { costs: &costs, cols: m }, star, tolerance, Some(heaviest), watch)?;
    let mut best = Optimum {
        arcs: tree.arcs().collect(),
        u: tree.row_potentials().to_vec(),
        v: tree.col_potentials_negated().iter().map(|v| -v).collect(),
    };
    fit(&costs, (rows, &mut best.u), (cols, &mut best.v));
    Ok(best)
}

/// Lowers potentials until no pair's exceed its cost, in exact arithmetic; of two points, that of the lighter.
fn fit<M: Mass>(costs: &[f64], (rows, u): (&[M], &mut [f64]), (cols, v): (&[M], &mut [f64])) {
    for ((costs, mass), u) in costs.chunks_exact(cols.len()).zip(rows).zip(u.iter_mut()) {
        for (j, &cost) in costs.iter().enumerate().filter(|&(j, _)| *mass <= cols[j]) {
            *u = u.min(difference_below(cost, v[j]));
        }
    }
    for (costs, &u) in costs.chunks_exact(cols.len()).zip(u.iter()) {
        for (v, &cost) in v.iter_mut().zip(costs) {
            *v = v.min(difference_below(cost, u));
        }
    }
}

/// The largest float that is not above the difference.
fn difference_below(a: f64, b: f64) -> f64 {
    let (near, rest) = two_sum(a, -b);
    if rest < 0.0 { near.next_down() } else { near }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lighter_point_gives_way() {
        let costs = [0.1, 1.0 / 3.0, 0.7, 1e-20];
        let (mut u, mut v) = (vec![0.1 + 1e-17, 0.5], vec![1e-18, 0.3]);
        let heavy = (u[0], v[0]);
        fit(&costs, (&[9_i64, 1], &mut u), (&[8_i64, 2], &mut v));
        for (place, cost) in costs.iter().enumerate() {
            let (near, rest) = two_sum(*cost, -u[place / 2]);
            assert!((near - v[place % 2]) + rest >= 0.0, "pair {place}");
        }
        assert_eq!(u[0], heavy.0);
        assert!(v[0] < heavy.1 && v[1] < 0.3 && u[1] < 0.5);
    }
}
