//! Exact transport on a line, by sorting: for a convex cost the monotone plan is optimal.

use crate::error::OtError;
use crate::mass::Mass;
use crate::masses::Masses;
use crate::precise::{Pair, difference};
use crate::watch::Watch;

/// The monotone plan and potentials that are tight along it.
#[derive(Clone, Debug)]
pub struct LinePlan<M> {
    /// `(row, column, mass)` of the arcs with mass.
    pub arcs: Vec<(usize, usize, M)>,
    /// Potentials of the rows.
    pub alpha: Vec<f64>,
    /// Potentials of the columns.
    pub beta: Vec<f64>,
}

/// Solves `x`, `y` on a line for a cost that is a convex function of the difference.
///
/// Sorted, such costs have the Monge property, so potentials tight along a staircase of pairs are feasible for all
/// pairs, and the staircase that follows the cumulated masses carries the optimal plan. Costs and potentials are pairs
/// of floats, so that each potential is right to half a unit in its last place however long the staircase is; they are
/// counted from the heaviest point.
///
/// # Errors
/// `Interrupted`, from the watch.
pub fn solve<M: Mass>(
    x: &[f64],
    y: &[f64],
    masses: &Masses<M>,
    cost: impl Fn(f64, f64) -> Pair,
    watch: &mut Watch<'_>,
) -> Result<LinePlan<M>, OtError> {
    let order_x = sorted(x, watch)?;
    let order_y = sorted(y, watch)?;
    let (n, m) = (x.len(), y.len());
    let mut arcs = Vec::with_capacity(n + m);
    let (mut alpha, mut beta) = (vec![(0.0, 0.0); n], vec![(0.0, 0.0); m]);
    let (mut s, mut t) = (0, 0);
    let (mut left, mut open) = (masses.rows[order_x[0]], masses.cols[order_y[0]]);
    beta[order_y[0]] = cost(x[order_x[0]], y[order_y[0]]);
    loop {
        watch.step()?;
        let (i, j) = (order_x[s], order_y[t]);
        let mass = left.min(open);
        if mass > M::ZERO {
            arcs.push((i, j, mass));
        }
        left -= mass;
        open -= mass;
        // Go on along the side that is used up; at a tie the row first, unless it is the last.
        if s + 1 < n && (left == M::ZERO || t + 1 == m) {
            s += 1;
            left = masses.rows[order_x[s]];
            alpha[order_x[s]] = difference(cost(x[order_x[s]], y[j]), beta[j]);
        } else if t + 1 < m {
            t += 1;
            open = masses.cols[order_y[t]];
            beta[order_y[t]] = difference(cost(x[i], y[order_y[t]]), alpha[i]);
        } else {
            break;
        }
    }
    let zero = origin(masses, &alpha, &beta);
    let alpha = alpha.iter().map(|&p| difference(p, zero).0).collect();
    let beta = beta.iter().map(|&p| difference(p, (-zero.0, -zero.1)).0).collect();
    Ok(LinePlan { arcs, alpha, beta })
}

/// The potential of the rows at which the heaviest point of either side has none.
fn origin<M: Mass>(masses: &Masses<M>, alpha: &[Pair], beta: &[Pair]) -> Pair {
    let negated = beta.iter().map(|p| (-p.0, -p.1));
    let all = masses.rows.iter().zip(alpha.iter().copied()).chain(masses.cols.iter().zip(negated));
    all.max_by_key(|(mass, _)| **mass).map_or((0.0, 0.0), |(_, potential)| potential)
}

fn sorted(values: &[f64], watch: &mut Watch<'_>) -> Result<Vec<usize>, OtError> {
    watch.ask()?;
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    Ok(order)
}
