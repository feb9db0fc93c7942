//! Chooses the method by the shape of a problem; large ones start from the potentials of a coarse one.

use crate::assignment::{self, Assignment};
use crate::coarse::{self, Share};
use crate::cost::Cost;
use crate::error::OtError;
use crate::few_columns::{self, Columns};
use crate::network_simplex::{self, Table, Tolerance};
use crate::scan::Workers;
use crate::simd::{LeastSum, run};
use crate::sparse_assignment;
use crate::sparse_transport;
use crate::stored::Stored;
use crate::threaded_tree::ThreadedTree;
use crate::tree::Tree;
use crate::watch::Watch;

/// Pairs up to which the full table is solved at once, and those up to which it is kept.
pub const DENSE_PAIRS: usize = 700_000;
pub const STORED_PAIRS: usize = 1_100_000;
/// How many times more points the other side must have to count as many.
const MANY_TO_FEW: usize = 4;
/// A side with so few points is never halved.
pub const SMALL_SIDE: usize = 32;
/// A side with so few points is few beside half its square or more; what paths take grows with its square for every
/// point of the other, and the whole table is kept, of so many pairs at most.
const FEW_SIDE: usize = 256;
const FEW_PAIRS: usize = 1 << 26;
/// Pairs up to which an assignment starts without potentials.
pub const COLD_PAIRS: usize = 40_000;
/// The same for assignments.
pub const ASSIGNMENT_PAIRS: usize = 1_100_000;

/// An optimal plan and potentials that are feasible for every pair.
#[derive(Clone, Debug)]
pub struct Optimum<M = i64> {
    /// `(row, column, mass)`.
    pub arcs: Vec<(usize, usize, M)>,
    /// Potentials of the rows.
    pub u: Vec<f64>,
    /// Potentials of the columns.
    pub v: Vec<f64>,
}

impl Optimum {
    /// The plan and the potentials of a tree.
    #[must_use]
    pub fn of_tree(tree: &Tree) -> Self {
        Self {
            arcs: tree.arcs().collect(),
            u: tree.row_potentials().to_vec(),
            v: tree.col_potentials_negated().iter().map(|v| -v).collect(),
        }
    }
}

impl<M> Optimum<M> {
    /// Makes the potentials feasible for the whole table: those of the rows become the least `cost - v`.
    pub fn tighten(&mut self, costs: &[f64]) {
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
    if many >= MANY_TO_FEW * few && (few <= SMALL_SIDE || (!cost.is_stored() && is_few(few, many))) {
        return solve_few(cost, rows, cols, few_columns::PATHS_A_NODE, watch);
    }
    if pairs <= DENSE_PAIRS {
        return solve_table(cost, rows, cols, watch);
    }
    let stored;
    let cost = if pairs <= STORED_PAIRS && !cost.is_stored() {
        stored = Stored::new(cost);
        &stored
    } else {
        cost
    };
    let (some_rows, coarse) = coarse::optimum(cost, (rows, cols), 2, Share::Region, workers, watch)?;
    let minus_v = coarse::extend_to_columns(cost, &some_rows, &coarse.u, watch)?;
    sparse_transport::solve(cost, rows, cols, &minus_v, workers, watch)
}

/// Whether paths between the points of the smaller side are the shortest way, where costs are those of distances.
fn is_few(few: usize, many: usize) -> bool {
    few <= FEW_SIDE && 2 * many >= few * few && few * many <= FEW_PAIRS
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
        // Regions leave less to do on the short lists, but their masses are not equal any more.
        let share = if n * n > ASSIGNMENT_PAIRS { Share::Region } else { Share::Own };
        let (some_rows, coarse) = coarse::optimum(cost, (&masses, &masses), 2, share, workers, watch)?;
        Some(coarse::extend_to_columns(cost, &some_rows, &coarse.u, watch)?)
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

/// The whole table, row by row.
pub fn table(cost: &dyn Cost) -> Vec<f64> {
    let mut costs = vec![0.0; cost.rows() * cost.cols()];
    for (row, out) in costs.chunks_exact_mut(cost.cols()).enumerate() {
        cost.fill_row(row, out);
    }
    costs
}

/// Fills the whole table and solves it.
fn solve_table(cost: &dyn Cost, rows: &[i64], cols: &[i64], watch: &mut Watch<'_>) -> Result<Optimum, OtError> {
    let (costs, m) = (table(cost), cols.len());
    let star = ThreadedTree::star(rows, cols, sparse_transport::artificial_cost(cost));
    let tolerance = Tolerance::new(cost.bound(), rows.len() + m + 1);
    let tree = network_simplex::solve(Table { costs: &costs, cols: m }, star, tolerance, None, watch)?;
    let v = tree.col_potentials_negated().iter().map(|v| -v).collect();
    let mut best = Optimum { arcs: tree.arcs().collect(), u: Vec::new(), v };
    count_from_heaviest(&mut best.v, cols);
    best.tighten(&costs);
    Ok(best)
}

/// Few points against many; by the simplex when `paths_a_node` paths do not suffice.
fn solve_few(
    cost: &dyn Cost,
    rows: &[i64],
    cols: &[i64],
    paths_a_node: usize,
    watch: &mut Watch<'_>,
) -> Result<Optimum, OtError> {
    let upright = cols.len() <= rows.len();
    let costs = if upright { cost.by_columns() } else { table(cost) };
    let (long, short) = if upright { (rows, cols) } else { (cols, rows) };
    let columns = Columns { costs: &costs, rows: long.len() };
    let Some(found) = few_columns::solve(columns, long, short, paths_a_node, watch)? else {
        drop(costs);
        return solve_table(cost, rows, cols, watch);
    };
    let few_columns::Optimum { mut arcs, u, v } = found;
    if upright {
        return Ok(Optimum { arcs, u, v });
    }
    arcs.iter_mut().for_each(|(i, j, _)| std::mem::swap(i, j));
    Ok(Optimum { arcs, u: v, v: u })
}

/// Shifts the potentials of one side so that its heaviest point has none, and what most of the mass pays is not a small
/// difference of large numbers.
fn count_from_heaviest(potentials: &mut [f64], masses: &[i64]) {
    let heaviest = masses.iter().zip(potentials.iter()).max_by_key(|(mass, _)| **mass).map_or(0.0, |(_, &p)| p);
    potentials.iter_mut().for_each(|p| *p -= heaviest);
}

#[cfg(test)]
mod tests;
