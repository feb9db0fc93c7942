//! Chooses the method for a problem and runs it.

use crate::certificate::{Potentials, tighten};
use crate::coarse_to_fine;
use crate::cost::{Cost, Metric};
use crate::error::OtError;
use crate::masses::{Masses, integer_masses};
use crate::one_dim;
use crate::points::Points;
use crate::scan::Workers;
use crate::solution::{Solution, conclude};
use crate::watch::Watch;

/// Exact transport between two weighted point sets, `x` of shape `(n, dim)` and `y` of shape `(m, dim)`.
///
/// # Errors
/// `BadInput` for arguments that break a rule, `NotOptimal` without a certified plan, `Interrupted` when asked to.
pub fn between_points(
    x: &[f64],
    y: &[f64],
    dim: usize,
    metric: Metric,
    weights: (Option<&[f64]>, Option<&[f64]>),
    workers: &Workers,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Solution, OtError> {
    let points = Points::new(x, y, dim, metric)?;
    if dim > 1 {
        return with_cost(&points, weights, workers, go_on);
    }
    let (a, b) = weights;
    let masses = integer_masses(a, b, points.rows(), points.cols())?;
    let (x, y) = points.scaled();
    let line = one_dim::solve(x, y, &masses, |x, y| match metric {
        Metric::SqEuclidean => (x - y) * (x - y),
        Metric::Euclidean | Metric::CityBlock => (x - y).abs(),
    });
    let potentials = Potentials { alpha: line.alpha, beta: line.beta };
    conclude(&points, line.arcs, potentials, a, b, &masses)
}

/// Exact transport for any cost.
///
/// # Errors
/// As for [`between_points`].
pub fn with_cost(
    cost: &dyn Cost,
    weights: (Option<&[f64]>, Option<&[f64]>),
    workers: &Workers,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Solution, OtError> {
    let (a, b) = weights;
    let masses = integer_masses(a, b, cost.rows(), cost.cols())?;
    let pivots = 1_000_000 + 2_000 * (cost.rows() + cost.cols()) as u64;
    let (arcs, potentials) = solve_core(cost, &masses, workers, &mut Watch::new(go_on, pivots))?;
    conclude(cost, arcs, potentials, a, b, &masses)
}

type Arcs = Vec<(usize, usize, i64)>;

/// Solves for the atoms that have mass, and gives the others potentials that fit.
fn solve_core(
    cost: &dyn Cost,
    masses: &Masses,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<(Arcs, Potentials), OtError> {
    let heavy = |side: &[i64]| -> Vec<usize> { (0..side.len()).filter(|&i| side[i] > 0).collect() };
    let (rows, cols) = (heavy(&masses.rows), heavy(&masses.cols));
    if rows.len() == cost.rows() && cols.len() == cost.cols() {
        let best = coarse_to_fine::solve(cost, &masses.rows, &masses.cols, workers, watch)?;
        return Ok((best.arcs, Potentials { alpha: best.u, beta: best.v }));
    }
    let part = cost.subset(&rows, &cols);
    let row_masses: Vec<i64> = rows.iter().map(|&i| masses.rows[i]).collect();
    let col_masses: Vec<i64> = cols.iter().map(|&j| masses.cols[j]).collect();
    let best = coarse_to_fine::solve(&*part, &row_masses, &col_masses, workers, watch)?;
    let arcs = best.arcs.iter().map(|&(i, j, mass)| (rows[i], cols[j], mass)).collect();
    let mut beta = vec![f64::INFINITY; cost.cols()];
    let mut row_costs = vec![0.0; cost.cols()];
    for (&i, &u) in rows.iter().zip(&best.u) {
        cost.fill_row(i, &mut row_costs);
        for (beta, c) in beta.iter_mut().zip(&row_costs) {
            *beta = beta.min(c - u);
        }
    }
    for (&j, &v) in cols.iter().zip(&best.v) {
        beta[j] = v;
    }
    Ok((arcs, tighten(cost, beta)))
}
