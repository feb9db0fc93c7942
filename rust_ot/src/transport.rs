//! Chooses the method for a problem and runs it.

use crate::certificate::Potentials;
use crate::coarse_to_fine;
use crate::cost::{Cost, Metric};
use crate::error::OtError;
use crate::masses::{Masses, integer_masses};
use crate::merge::{Groups, split};
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
    let (arcs, potentials) = solve_distinct(cost, &masses, workers, &mut Watch::new(go_on, pivots))?;
    conclude(cost, arcs, potentials, a, b, &masses)
}

type Arcs = Vec<(usize, usize, i64)>;

/// Pairs of distinct points, as a share of all, from which on it does not pay to merge equal points; less where all
/// masses are equal, which only single points are.
const WORTH_MERGING: f64 = 0.8;
const WORTH_MERGING_EQUAL: f64 = 0.3;

/// Solves with equal points as one where there are many.
fn solve_distinct(
    cost: &dyn Cost,
    masses: &Masses,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<(Arcs, Potentials), OtError> {
    let (n, m) = (cost.rows(), cost.cols());
    let (rows, cols) = (cost.groups(true), cost.groups(false));
    let len = |groups: &Option<Groups>, all: usize| groups.as_ref().map_or(all, |groups| groups.first.len());
    let share = (len(&rows, n) as f64 / n as f64) * (len(&cols, m) as f64 / m as f64);
    let worth = if n == m && masses.uniform { WORTH_MERGING_EQUAL } else { WORTH_MERGING };
    if share > worth {
        return solve_core(cost, (&masses.rows, &masses.cols), workers, watch);
    }
    let (rows, cols) = (rows.unwrap_or_else(|| Groups::single(n)), cols.unwrap_or_else(|| Groups::single(m)));
    let part = cost.subset(&rows.first, &cols.first);
    let merged = (rows.gather(&masses.rows), cols.gather(&masses.cols));
    let (arcs, best) = solve_core(&*part, (&merged.0, &merged.1), workers, watch)?;
    let arcs = split(arcs, (&rows, &masses.rows), (&cols, &masses.cols));
    Ok((arcs, Potentials { alpha: rows.spread(&best.alpha), beta: cols.spread(&best.beta) }))
}

/// Solves for the atoms that have mass, and gives the others potentials that fit.
fn solve_core(
    cost: &dyn Cost,
    (row_masses, col_masses): (&[i64], &[i64]),
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<(Arcs, Potentials), OtError> {
    let heavy = |side: &[i64]| -> Vec<usize> { (0..side.len()).filter(|&i| side[i] > 0).collect() };
    let (rows, cols) = (heavy(row_masses), heavy(col_masses));
    if rows.len() == cost.rows() && cols.len() == cost.cols() {
        let best = coarse_to_fine::solve(cost, row_masses, col_masses, workers, watch)?;
        return Ok((best.arcs, Potentials { alpha: best.u, beta: best.v }));
    }
    let part = cost.subset(&rows, &cols);
    let row_masses: Vec<i64> = rows.iter().map(|&i| row_masses[i]).collect();
    let col_masses: Vec<i64> = cols.iter().map(|&j| col_masses[j]).collect();
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
    // Those of rows with mass stay: computed again, they would take on the rounding of any column's potential.
    let mut alpha = vec![f64::NAN; cost.rows()];
    for (&i, &u) in rows.iter().zip(&best.u) {
        alpha[i] = u;
    }
    for (i, alpha) in alpha.iter_mut().enumerate().filter(|(_, alpha)| alpha.is_nan()) {
        cost.fill_row(i, &mut row_costs);
        *alpha = row_costs.iter().zip(&beta).fold(f64::INFINITY, |least, (c, b)| least.min(c - b));
    }
    Ok((arcs, Potentials { alpha, beta }))
}
