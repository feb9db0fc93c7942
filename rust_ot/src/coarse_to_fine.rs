//! Large problems: potentials from half of the points, a short list of arcs, and passes over all pairs until no arc
//! is missing. The last pass, which finds nothing, is the proof.

use crate::arcs::{self, ArcList};
use crate::assignment::{self, Assignment};
use crate::cost::Cost;
use crate::error::OtError;
use crate::few_columns;
use crate::network_simplex::{self, Table, Tolerance};
use crate::scan::{self, Workers};
use crate::simd::{LeastSum, lower_to_difference, run, vectorized};
use crate::sparse_assignment;
use crate::tree::Tree;
use crate::watch::Watch;

/// Pairs up to which the full table is solved at once.
pub const DENSE_PAIRS: usize = 1_100_000;
/// How many times more points the other side must have to count as many.
const MANY_TO_FEW: usize = 4;
/// The coarse problem of few points against many takes one in so many.
const FEW_SHARE: usize = 16;
/// Length of the long side up to which few points against many start without potentials.
const COLD_LONG_SIDE: usize = 64;
/// A side with so few points is never halved.
const SMALL_SIDE: usize = 32;
/// Pairs up to which an assignment starts without potentials.
pub const COLD_PAIRS: usize = 40_000;
/// The same for assignments.
pub const ASSIGNMENT_PAIRS: usize = 1_100_000;
/// Arcs of least reduced cost that each row starts with.
const SHORTLIST: usize = 24;
/// Missing arcs that a pass may add to a row.
const ADDED: usize = 12;

/// An optimal plan and potentials that are feasible for every pair.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// `(row, column, mass)`.
    pub arcs: Vec<(usize, usize, i64)>,
    /// Potentials of the rows.
    pub u: Vec<f64>,
    /// Potentials of the columns.
    pub v: Vec<f64>,
}

impl Optimum {
    fn of_tree(tree: &Tree) -> Self {
        Self {
            arcs: tree.arcs().collect(),
            u: tree.row_potentials().to_vec(),
            v: tree.col_potentials_negated().iter().map(|v| -v).collect(),
        }
    }

    /// Makes the potentials feasible for the whole table: those of the rows become the least `cost - v`.
    fn tighten(&mut self, costs: &[f64]) {
        let minus_v: Vec<f64> = self.v.iter().map(|v| -v).collect();
        self.u = costs.chunks_exact(minus_v.len()).map(|row| run(LeastSum(row, &minus_v)).0).collect();
    }
}

/// Solves the problem for positive masses of equal totals.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(
    cost: &dyn Cost,
    rows: &[i64],
    cols: &[i64],
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Optimum, OtError> {
    let square = rows.len() == cols.len() && rows.iter().chain(cols).all(|&mass| mass == rows[0]);
    if square && let Some(best) = solve_square(cost, rows[0], rows.len(), workers, watch)? {
        return Ok(best);
    }
    let pairs = rows.len() * cols.len();
    let (few, many) = (rows.len().min(cols.len()), rows.len().max(cols.len()));
    if few <= SMALL_SIDE && many >= MANY_TO_FEW * few {
        return solve_few(cost, rows, cols, workers, watch);
    }
    if pairs <= DENSE_PAIRS {
        return solve_table(cost, rows, cols, watch);
    }
    let v = coarse_potentials(cost, rows, cols, workers, watch)?;
    let minus_v: Vec<f64> = v.iter().map(|v| -v).collect();
    solve_sparse(cost, rows, cols, &minus_v, workers, watch)
}

/// Equal numbers of equal masses.
fn solve_square(
    cost: &dyn Cost,
    mass: i64,
    n: usize,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Option<Optimum>, OtError> {
    let minus_v = if n * n <= COLD_PAIRS {
        None
    } else {
        let masses = vec![mass; n];
        let v = coarse_potentials(cost, &masses, &masses, workers, watch)?;
        Some(v.iter().map(|v| -v).collect::<Vec<f64>>())
    };
    let optimum = |best: Assignment| Optimum {
        arcs: best.col_of.iter().enumerate().map(|(i, &j)| (i, j as usize, mass)).collect(),
        u: best.u,
        v: best.v,
    };
    let best = match minus_v {
        Some(minus_v) if n * n > ASSIGNMENT_PAIRS => sparse_assignment::solve(cost, &minus_v, workers, watch)?,
        minus_v => {
            let costs = table(cost);
            let mut best = optimum(assignment::solve(Table { costs: &costs, cols: n }, minus_v, watch)?);
            best.tighten(&costs);
            return Ok(Some(best));
        }
    };
    Ok(best.map(optimum))
}

fn table(cost: &dyn Cost) -> Vec<f64> {
    let mut costs = vec![0.0; cost.rows() * cost.cols()];
    for (row, out) in costs.chunks_exact_mut(cost.cols()).enumerate() {
        cost.fill_row(row, out);
    }
    costs
}

/// Fills the whole table and solves it.
fn solve_table(cost: &dyn Cost, rows: &[i64], cols: &[i64], watch: &mut Watch<'_>) -> Result<Optimum, OtError> {
    let (costs, m) = (table(cost), cols.len());
    let star = Tree::star(rows, cols, artificial_cost(cost));
    let tree = network_simplex::solve(Table { costs: &costs, cols: m }, star, cost.bound(), watch)?;
    let mut best = Optimum::of_tree(&tree);
    best.tighten(&costs);
    Ok(best)
}

/// Few points against many.
fn solve_few(
    cost: &dyn Cost,
    rows: &[i64],
    cols: &[i64],
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Optimum, OtError> {
    let (n, m) = (rows.len(), cols.len());
    let upright = m <= n;
    let (long, short) = if upright { (n, m) } else { (m, n) };
    let costs = if upright { table(cost) } else { transposed(&table(cost), m) };
    let start = if long <= COLD_LONG_SIDE {
        vec![0.0; short]
    } else {
        let coarse = coarse_optimum(cost, rows, cols, FEW_SHARE, workers, watch)?.1;
        if upright { coarse.v } else { coarse.u }
    };
    let (long_masses, short_masses) = if upright { (rows, cols) } else { (cols, rows) };
    let found = few_columns::solve(Table { costs: &costs, cols: short }, long_masses, short_masses, start, watch)?;
    let slack = |costs: &[f64]| costs.iter().zip(&found.v).fold(f64::INFINITY, |low, (c, v)| low.min(c - v));
    let long_potentials: Vec<f64> = costs.chunks_exact(short).map(slack).collect();
    let loaded = found.flow.iter().enumerate().filter(|&(_, &flow)| flow > 0);
    let arcs = loaded.map(|(place, &flow)| {
        let (i, j) = (place / short, place % short);
        if upright { (i, j, flow) } else { (j, i, flow) }
    });
    let arcs = arcs.collect();
    Ok(if upright {
        Optimum { arcs, u: long_potentials, v: found.v }
    } else {
        Optimum { arcs, u: found.v, v: long_potentials }
    })
}

fn transposed(costs: &[f64], cols: usize) -> Vec<f64> {
    let rows = costs.len() / cols;
    (0..cols).flat_map(|j| (0..rows).map(move |i| costs[i * cols + j])).collect()
}

/// What an artificial arc costs more than the potentials of its node.
fn artificial_cost(cost: &dyn Cost) -> f64 {
    1.01 * cost.bound().max(f64::MIN_POSITIVE)
}

/// The optimum of one in `share` of the rows and of the columns, and which rows they are.
fn coarse_optimum(
    cost: &dyn Cost,
    rows: &[i64],
    cols: &[i64],
    share: usize,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<(Vec<usize>, Optimum), OtError> {
    let (half_rows, half_cols) = (sample(rows.len(), share), sample(cols.len(), share));
    let part = cost.subset(&half_rows, &half_cols);
    let mut row_masses: Vec<i64> = half_rows.iter().map(|&i| rows[i]).collect();
    let mut col_masses: Vec<i64> = half_cols.iter().map(|&j| cols[j]).collect();
    let total: i64 = row_masses.iter().sum();
    if total != col_masses.iter().sum::<i64>() {
        // In finer quanta, so that every column keeps some mass.
        let finer = (1i64 << 61) / total;
        row_masses.iter_mut().for_each(|mass| *mass *= finer.max(1));
        col_masses = rebalance(col_masses, row_masses.iter().sum());
    }
    let coarse = solve(&*part, &row_masses, &col_masses, workers, watch)?;
    Ok((half_rows, coarse))
}

/// Potentials of all columns from the optimum of half of the rows and half of the columns.
fn coarse_potentials(
    cost: &dyn Cost,
    rows: &[i64],
    cols: &[i64],
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Vec<f64>, OtError> {
    let (half_rows, coarse) = coarse_optimum(cost, rows, cols, 2, workers, watch)?;
    let mut v = vec![f64::INFINITY; cols.len()];
    let mut row_costs = vec![0.0; cols.len()];
    for (&i, &u) in half_rows.iter().zip(&coarse.u) {
        cost.fill_row(i, &mut row_costs);
        vectorized!(lower_to_difference(&mut v, &row_costs, u));
    }
    Ok(v)
}

/// One in `share` of `0..len`, spread at random but the same every time.
fn sample(len: usize, share: usize) -> Vec<usize> {
    let mut state = len as u64 ^ 0x9e37_79b9_7f4a_7c15;
    let mut order: Vec<usize> = (0..len).collect();
    let half = if len <= SMALL_SIDE { len } else { len.div_ceil(share) };
    for k in 0..half {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let other = k + ((state >> 33) as usize) % (len - k);
        order.swap(k, other);
    }
    order.truncate(half);
    order.sort_unstable();
    order
}

/// Scales masses to a much larger total, each at least one.
fn rebalance(mut masses: Vec<i64>, total: i64) -> Vec<i64> {
    let sum: i128 = masses.iter().map(|&x| i128::from(x)).sum();
    for mass in &mut masses {
        *mass = ((i128::from(*mass) * i128::from(total) / sum) as i64).max(1);
    }
    let excess = masses.iter().sum::<i64>() - total;
    if let Some(largest) = masses.iter_mut().max() {
        *largest -= excess;
    }
    masses
}

fn solve_sparse(
    cost: &dyn Cost,
    rows: &[i64],
    cols: &[i64],
    minus_v: &[f64],
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Optimum, OtError> {
    let n = rows.len();
    watch.ask()?;
    let pass = scan::shortlist(cost, minus_v, SHORTLIST, workers);
    let mut list = ArcList::default();
    for (row, found) in pass.arcs.iter().enumerate() {
        for &(_, col, c) in found {
            list.push(row as u32, n as u32 + col, c);
        }
    }
    for (col, &(row, c)) in pass.col_best.iter().enumerate() {
        if !pass.arcs[row as usize].iter().any(|arc| arc.1 as usize == col) {
            list.push(row, (n + col) as u32, c);
        }
    }
    let mut tree = greedy_start(rows, cols, &pass, minus_v, artificial_cost(cost));
    drop(pass);
    let mut tolerance = Tolerance::new(cost.bound(), n + cols.len());
    loop {
        arcs::solve(&list, &mut tree, &mut tolerance, watch)?;
        watch.ask()?;
        let (u, minus_v) = (tree.row_potentials(), tree.col_potentials_negated());
        let negative = |reduced, row: usize, col: usize, c| tolerance.is_negative(reduced, c, u[row], minus_v[col]);
        let pass = scan::violated(cost, u, minus_v, ADDED, negative, workers);
        let before = list.len();
        for (row, found) in pass.arcs.iter().enumerate() {
            for &(_, col, c) in found {
                list.push(row as u32, n as u32 + col, c);
            }
        }
        if list.len() == before {
            let mut optimum = Optimum::of_tree(&tree);
            for (u, low) in optimum.u.iter_mut().zip(&pass.row_minimum) {
                *u = u.min(*low);
            }
            return Ok(optimum);
        }
    }
}

/// Ships along the cheapest arcs of the shortlist, cheapest first; artificial arcs carry the rest.
fn greedy_start(rows: &[i64], cols: &[i64], pass: &scan::Pass, minus_v: &[f64], penalty: f64) -> Tree {
    let mut order: Vec<(f64, u32, u32, f64)> = Vec::new();
    for (row, found) in pass.arcs.iter().enumerate() {
        let low = pass.row_minimum[row];
        order.extend(found.iter().map(|&(reduced, col, c)| (reduced - low, row as u32, col, c)));
    }
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut left, mut open) = (rows.to_vec(), cols.to_vec());
    let mut forest = Vec::new();
    for (_, i, j, c) in order {
        let flow = left[i as usize].min(open[j as usize]);
        if flow > 0 {
            left[i as usize] -= flow;
            open[j as usize] -= flow;
            forest.push((i, j, c, flow));
        }
    }
    let artificial: Vec<f64> =
        pass.row_minimum.iter().map(|u| u + penalty).chain(minus_v.iter().map(|v| penalty - v)).collect();
    Tree::from_forest(rows, cols, &forest, &artificial)
}
