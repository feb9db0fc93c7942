//! Chooses the method for a problem and runs it.

use crate::certificate::{Potentials, tighten};
use crate::cost::{Cost, Metric, Points};
use crate::error::OtError;
use crate::masses::{Masses, integer_masses};
use crate::network_simplex::{self, Table};
use crate::one_dim;
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
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Solution, OtError> {
    let points = Points::new(x, y, dim, metric)?;
    if dim > 1 {
        return with_cost(&points, weights, go_on);
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
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Solution, OtError> {
    let (a, b) = weights;
    let masses = integer_masses(a, b, cost.rows(), cost.cols())?;
    let core = Core::new(&masses);
    let pivots = 1_000_000 + 2_000 * (cost.rows() + cost.cols()) as u64;
    let (arcs, potentials) = solve_table(cost, &core, &mut Watch::new(go_on, pivots))?;
    conclude(cost, arcs, potentials, a, b, &masses)
}

/// The atoms that have mass.
struct Core {
    rows: Vec<usize>,
    cols: Vec<usize>,
    row_masses: Vec<i64>,
    col_masses: Vec<i64>,
}

impl Core {
    fn new(masses: &Masses) -> Self {
        let heavy = |side: &[i64]| -> Vec<usize> { (0..side.len()).filter(|&i| side[i] > 0).collect() };
        let (rows, cols) = (heavy(&masses.rows), heavy(&masses.cols));
        let row_masses = rows.iter().map(|&i| masses.rows[i]).collect();
        let col_masses = cols.iter().map(|&j| masses.cols[j]).collect();
        Self { rows, cols, row_masses, col_masses }
    }
}

type Arcs = Vec<(usize, usize, i64)>;

fn solve_table(cost: &dyn Cost, core: &Core, watch: &mut Watch<'_>) -> Result<(Arcs, Potentials), OtError> {
    let (n, m) = (core.rows.len(), core.cols.len());
    let mut costs = Vec::with_capacity(n * m);
    let mut row = vec![0.0; cost.cols()];
    for &i in &core.rows {
        cost.fill_row(i, &mut row);
        costs.extend(core.cols.iter().map(|&j| row[j]));
    }
    let table = Table { costs: &costs, cols: m };
    let tree = network_simplex::solve(table, &core.row_masses, &core.col_masses, cost.bound(), watch)?;
    let arcs = tree.arcs().map(|(i, j, mass)| (core.rows[i], core.cols[j], mass)).collect();
    let u: Vec<f64> = tree.row_potentials().to_vec();
    let v: Vec<f64> = tree.col_potentials_negated().iter().map(|v| -v).collect();
    Ok((arcs, tighten(cost, extend(cost, core, &u, &v))))
}

/// Potentials of all columns from those of the columns with mass.
fn extend(cost: &dyn Cost, core: &Core, u: &[f64], v: &[f64]) -> Vec<f64> {
    let mut beta = vec![f64::INFINITY; cost.cols()];
    for (&j, &v) in core.cols.iter().zip(v) {
        beta[j] = v;
    }
    if core.cols.len() < cost.cols() {
        let mut row = vec![0.0; cost.cols()];
        let empty: Vec<usize> = (0..cost.cols()).filter(|&j| beta[j] == f64::INFINITY).collect();
        for (&i, &u) in core.rows.iter().zip(u) {
            cost.fill_row(i, &mut row);
            for &j in &empty {
                beta[j] = beta[j].min(row[j] - u);
            }
        }
    }
    beta
}
