//! Exact transport on a line, by sorting: for a convex cost the monotone plan is optimal.

use crate::masses::Masses;

/// The monotone plan and potentials that are tight along it.
#[derive(Clone, Debug)]
pub struct LinePlan {
    /// `(row, column, mass)` of the arcs with mass.
    pub arcs: Vec<(usize, usize, i64)>,
    /// Potentials of the rows.
    pub alpha: Vec<f64>,
    /// Potentials of the columns.
    pub beta: Vec<f64>,
}

/// Solves `x`, `y` on a line for a cost that is a convex function of the difference.
///
/// Sorted, such costs have the Monge property, so potentials tight along a staircase of pairs are feasible for all
/// pairs, and the staircase that follows the cumulated masses carries the optimal plan.
#[must_use]
pub fn solve(x: &[f64], y: &[f64], masses: &Masses, cost: impl Fn(f64, f64) -> f64) -> LinePlan {
    let order_x = sorted(x);
    let order_y = sorted(y);
    let (n, m) = (x.len(), y.len());
    let mut plan = LinePlan { arcs: Vec::with_capacity(n + m), alpha: vec![0.0; n], beta: vec![0.0; m] };
    let (mut s, mut t) = (0, 0);
    let (mut left, mut open) = (masses.rows[order_x[0]], masses.cols[order_y[0]]);
    plan.alpha[order_x[0]] = 0.0;
    plan.beta[order_y[0]] = cost(x[order_x[0]], y[order_y[0]]);
    loop {
        let (i, j) = (order_x[s], order_y[t]);
        let mass = left.min(open);
        if mass > 0 {
            plan.arcs.push((i, j, mass));
        }
        left -= mass;
        open -= mass;
        // Go on along the side that is used up; at a tie the row first, unless it is the last.
        if s + 1 < n && (left == 0 || t + 1 == m) {
            s += 1;
            left = masses.rows[order_x[s]];
            plan.alpha[order_x[s]] = cost(x[order_x[s]], y[j]) - plan.beta[j];
        } else if t + 1 < m {
            t += 1;
            open = masses.cols[order_y[t]];
            plan.beta[order_y[t]] = cost(x[i], y[order_y[t]]) - plan.alpha[i];
        } else {
            return plan;
        }
    }
}

fn sorted(values: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    order
}
