//! Chooses the method for a problem and runs it.

use crate::careful;
use crate::certificate::{Excuse, Potentials};
use crate::clipped::{self, Clipped, largest_price};
use crate::coarse_to_fine::{self, Optimum};
use crate::cost::{Cost, Metric};
use crate::error::OtError;
use crate::line::{self, Line};
use crate::mass::Mass;
use crate::masses::{Masses, Weights, fine_masses, integer_masses};
use crate::merge::{Groups, split};
use crate::one_dim::{self, LinePlan};
use crate::points::{Points, check_points};
use crate::precise::{Pair, square, two_sum};
use crate::scan::Workers;
use crate::solution::{Solution, conclude};
use crate::watch::Watch;

/// Pairs up to which a plan that is not proven is looked for again with more care: a table of 32 MB.
const CAREFUL_PAIRS: usize = 4_000_000;

/// Exact transport between two weighted point sets, `x` of shape `(n, dim)` and `y` of shape `(m, dim)`.
///
/// # Errors
/// `BadInput` for arguments that break a rule, `NotOptimal` without a certified plan, `Interrupted` when asked to.
pub fn between_points(
    x: &[f64],
    y: &[f64],
    dim: usize,
    metric: Metric,
    weights: Weights<'_>,
    workers: &Workers,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Solution, OtError> {
    let points = Points::new(x, y, dim, metric)?;
    if points.dim() > 1 {
        return with_cost(&points, weights, workers, go_on);
    }
    let (x, y) = points.scaled();
    on_a_line(&points, (x, y), weights, go_on, |x, y| {
        let (near, rest) = two_sum(x, -y);
        match metric {
            Metric::SqEuclidean => square((near, rest)),
            Metric::Euclidean | Metric::CityBlock if near < 0.0 => (-near, -rest),
            Metric::Euclidean | Metric::CityBlock => (near, rest),
        }
    })
}

/// Exact transport between numbers that are at most about one apart, at the cost `|x - y|^order`, `order >= 1`.
///
/// # Errors
/// As for [`between_points`].
pub fn between_numbers(
    x: &[f64],
    y: &[f64],
    order: f64,
    weights: Weights<'_>,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Solution, OtError> {
    check_points("x", x, 1)?;
    check_points("y", y, 1)?;
    let line = Line::new(x, y, order);
    on_a_line(&line, line.numbers(), weights, go_on, |x, y| (line::price(x, y, order), 0.0))
}

/// Solves a cost that is a convex function of the difference of numbers.
fn on_a_line(
    cost: &dyn Cost,
    (x, y): (&[f64], &[f64]),
    weights: Weights<'_>,
    go_on: &mut dyn FnMut() -> bool,
    price: impl Fn(f64, f64) -> Pair,
) -> Result<Solution, OtError> {
    let masses = integer_masses(weights.0, weights.1, cost.rows(), cost.cols())?;
    let watch = &mut Watch::new(go_on, u64::MAX);
    let line = one_dim::solve(x, y, &masses, &price, watch)?;
    match conclude_line(cost, line, weights, &masses, Excuse::Nothing) {
        Err(OtError::NotOptimal(_)) => {
            let masses = fine_masses(weights, &masses);
            let line = one_dim::solve(x, y, &masses, &price, watch)?;
            conclude_line(cost, line, weights, &masses, Excuse::Order)
        }
        answer => answer,
    }
}

fn conclude_line<M: Mass>(
    cost: &dyn Cost,
    mut line: LinePlan<M>,
    weights: Weights<'_>,
    masses: &Masses<M>,
    excuse: Excuse,
) -> Result<Solution, OtError> {
    let potentials = Potentials { alpha: line.alpha, beta: line.beta, exact: false };
    conclude(cost, &mut line.arcs, &potentials, weights, masses, excuse)
}

/// How much narrower the costs must become for another attempt to be worth it, and how many attempts there are.
const NARROWER: f64 = 0.25;
const ATTEMPTS: usize = 6;

/// Exact transport for any cost.
///
/// # Errors
/// As for [`between_points`].
pub fn with_cost(
    cost: &dyn Cost,
    weights: Weights<'_>,
    workers: &Workers,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Solution, OtError> {
    let masses = integer_masses(weights.0, weights.1, cost.rows(), cost.cols())?;
    let pivots = 1_000_000 + 2_000 * (cost.rows() + cost.cols()) as u64;
    let watch = &mut Watch::new(go_on, pivots);
    let mut limit = cost.bound();
    let mut plan = solve_distinct(cost, limit, &masses, workers, watch)?;
    let mut attempts = 1;
    loop {
        match conclude(cost, &mut plan.0, &plan.1, weights, &masses, Excuse::Nothing) {
            Err(OtError::NotOptimal(_)) => {}
            answer => return answer,
        }
        let price = largest_price(cost, &plan.0);
        if price <= cost.floor() {
            // No plan pays less; potentials that are all alike say so.
            let alike = |cost: &dyn Cost, _: &[i64], _: &[i64]| {
                Ok(Optimum { arcs: Vec::new(), u: vec![price; cost.rows()], v: vec![0.0; cost.cols()] })
            };
            let (_, mut potentials) = solve_heavy(cost, &masses.rows, &masses.cols, alike)?;
            potentials.exact = true;
            match conclude(cost, &mut plan.0, &potentials, weights, &masses, Excuse::Nothing) {
                Err(OtError::NotOptimal(_)) => break,
                answer => return answer,
            }
        }
        let next = clipped::limit(cost, price);
        if attempts == ATTEMPTS || next >= NARROWER * limit {
            break;
        }
        (limit, attempts) = (next, attempts + 1);
        match solve_distinct(cost, limit, &masses, workers, watch) {
            Err(OtError::NotOptimal(_)) => break,
            answer => plan = answer?,
        }
    }
    if cost.rows() * cost.cols() <= CAREFUL_PAIRS {
        match with_care(cost, limit, weights, &fine_masses(weights, &masses), watch) {
            Err(OtError::NotOptimal(_)) => {}
            answer => return answer,
        }
    }
    conclude(cost, &mut plan.0, &plan.1, weights, &masses, Excuse::Rounding)
}

fn with_care<M: Mass>(
    cost: &dyn Cost,
    mut limit: f64,
    weights: Weights<'_>,
    masses: &Masses<M>,
    watch: &mut Watch<'_>,
) -> Result<Solution, OtError> {
    let mut attempts = 1;
    loop {
        let solve =
            |cost: &dyn Cost, rows: &[M], cols: &[M]| careful::solve(&Clipped::new(cost, limit), rows, cols, watch);
        let (mut arcs, mut potentials) = solve_heavy(cost, &masses.rows, &masses.cols, solve)?;
        potentials.exact = true;
        match conclude(cost, &mut arcs, &potentials, weights, masses, Excuse::Nothing) {
            Err(OtError::NotOptimal(_)) => {}
            answer => return answer,
        }
        // Light points, which coarser masses left out, may pay more than the limit allows.
        let price = largest_price(cost, &arcs);
        let next = clipped::limit(cost, price);
        if attempts == ATTEMPTS || (price <= limit && next >= NARROWER * limit) {
            return conclude(cost, &mut arcs, &potentials, weights, masses, Excuse::Rounding);
        }
        (limit, attempts) = (next, attempts + 1);
    }
}

type Arcs<M> = Vec<(usize, usize, M)>;

/// Pairs of distinct points, as a share of all, from which on it does not pay to merge equal points; less where all
/// masses are equal, which only single points are.
const WORTH_MERGING: f64 = 0.8;
const WORTH_MERGING_EQUAL: f64 = 0.3;

/// Solves with equal points as one where there are many, and costs clipped at a limit.
fn solve_distinct(
    cost: &dyn Cost,
    limit: f64,
    masses: &Masses,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<(Arcs<i64>, Potentials), OtError> {
    // Points without mass, whose weight may have been too light for any, get potentials of the true costs.
    let solve = |cost: &dyn Cost, rows: &[i64], cols: &[i64]| {
        if limit < cost.bound() {
            return coarse_to_fine::solve(&Clipped::new(cost, limit), rows, cols, workers, watch);
        }
        coarse_to_fine::solve(cost, rows, cols, workers, watch)
    };
    let (n, m) = (cost.rows(), cost.cols());
    let (rows, cols) = (cost.groups(true), cost.groups(false));
    let len = |groups: &Option<Groups>, all: usize| groups.as_ref().map_or(all, |groups| groups.first.len());
    let share = (len(&rows, n) as f64 / n as f64) * (len(&cols, m) as f64 / m as f64);
    let worth = if n == m && masses.uniform { WORTH_MERGING_EQUAL } else { WORTH_MERGING };
    if share > worth {
        return solve_heavy(cost, &masses.rows, &masses.cols, solve);
    }
    let (rows, cols) = (rows.unwrap_or_else(|| Groups::single(n)), cols.unwrap_or_else(|| Groups::single(m)));
    let part = cost.subset(&rows.first, &cols.first);
    let merged = (rows.gather(&masses.rows), cols.gather(&masses.cols));
    let (arcs, best) = solve_heavy(&*part, &merged.0, &merged.1, solve)?;
    let arcs = split(arcs, (&rows, &masses.rows), (&cols, &masses.cols));
    Ok((arcs, Potentials { alpha: rows.spread(&best.alpha), beta: cols.spread(&best.beta), exact: false }))
}

/// Solves for the atoms that have mass, and gives the others potentials that fit.
fn solve_heavy<M: Mass>(
    cost: &dyn Cost,
    row_masses: &[M],
    col_masses: &[M],
    solve: impl FnOnce(&dyn Cost, &[M], &[M]) -> Result<Optimum<M>, OtError>,
) -> Result<(Arcs<M>, Potentials), OtError> {
    let heavy = |side: &[M]| -> Vec<usize> { (0..side.len()).filter(|&i| side[i] > M::ZERO).collect() };
    let (rows, cols) = (heavy(row_masses), heavy(col_masses));
    if rows.len() == cost.rows() && cols.len() == cost.cols() {
        let best = solve(cost, row_masses, col_masses)?;
        return Ok((best.arcs, Potentials { alpha: best.u, beta: best.v, exact: false }));
    }
    let part = cost.subset(&rows, &cols);
    let row_masses: Vec<M> = rows.iter().map(|&i| row_masses[i]).collect();
    let col_masses: Vec<M> = cols.iter().map(|&j| col_masses[j]).collect();
    let best = solve(&*part, &row_masses, &col_masses)?;
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
    Ok((arcs, Potentials { alpha, beta, exact: false }))
}
