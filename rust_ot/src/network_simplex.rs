//! Network simplex over a full table of costs: the tree does the moves, whole blocks of rows are priced at once.

use crate::error::OtError;
use crate::mass::Mass;
use crate::simd::{LeastSum, run};
use crate::threaded_tree::ThreadedTree;
use crate::watch::Watch;

/// How negative a reduced cost must be to count: more than rounding can make it.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    /// As a share of the numbers that a reduced cost is made of, and of typical potentials.
    share: f64,
    typical_share: f64,
    floor: f64,
    pivots_left: u64,
}

impl Tolerance {
    /// A tolerance of some dozen units in the last place of numbers as large as `size`.
    #[must_use]
    pub fn new(size: f64, nodes: usize) -> Self {
        Self {
            share: Self::SHARE,
            typical_share: Self::SHARE,
            floor: Self::SHARE * size,
            pivots_left: 200 * nodes as u64 + 10_000,
        }
    }

    /// A tolerance for given potentials.
    pub fn of_potentials<'a>(potentials: impl Iterator<Item = &'a f64> + Clone) -> Self {
        Self::new(typical_size(potentials.clone()), potentials.count())
    }

    /// A tolerance of two units in the last place of a reduced cost's own numbers: just more than its rounding.
    #[must_use]
    pub fn fine(nodes: usize) -> Self {
        Self { share: Self::FINE_SHARE, typical_share: 0.0, ..Self::new(0.0, nodes) }
    }

    const SHARE: f64 = 7.2e-15;
    const FINE_SHARE: f64 = 2.0 * f64::EPSILON;

    /// Takes over the size of the potentials, the last of which is the root's, after they were computed again.
    pub fn adapt(&mut self, pi: &[f64]) {
        self.floor = self.typical_share * typical_size(pi[..pi.len() - 1].iter());
    }

    /// Counts a pivot. A search that goes on for very long is turning in rounding errors: it gets more tolerance, and
    /// the certificate decides whether the outcome is good enough.
    pub fn count_pivot(&mut self, pi: &[f64]) {
        self.pivots_left -= 1;
        if self.pivots_left == 0 {
            self.pivots_left = 20 * pi.len() as u64 + 1_000;
            self.typical_share = (4.0 * self.typical_share).max(Self::FINE_SHARE);
            self.adapt(pi);
        }
    }

    /// Whether a reduced cost, or one above it, can be negative beyond rounding for any numbers it is made of.
    #[must_use]
    pub fn may_be_negative(&self, reduced: f64) -> bool {
        reduced < -self.floor
    }

    /// Whether a reduced cost made of these three numbers is negative beyond rounding.
    #[inline(always)]
    #[must_use]
    pub fn is_negative(&self, reduced: f64, cost: f64, u: f64, v: f64) -> bool {
        reduced < -(self.floor + self.share * (cost.abs() + u.abs() + v.abs()))
    }
}

/// A size that nine tenths of the numbers do not exceed; zero for none.
pub fn typical_size<'a>(numbers: impl Iterator<Item = &'a f64>) -> f64 {
    let mut sizes: Vec<f64> = numbers.map(|x| x.abs()).collect();
    let place = sizes.len() * 9 / 10;
    if sizes.is_empty() { 0.0 } else { *sizes.select_nth_unstable_by(place, f64::total_cmp).1 }
}

/// A table of costs, row by row.
#[derive(Clone, Copy, Debug)]
pub struct Table<'a> {
    /// The costs.
    pub costs: &'a [f64],
    /// Number of columns.
    pub cols: usize,
}

/// Improves a tree until it is optimal for the table up to the tolerance; potentials are counted from node `origin`, or
/// from a typical one.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve<M: Mass>(
    table: Table<'_>,
    mut tree: ThreadedTree<M>,
    mut tolerance: Tolerance,
    origin: Option<usize>,
    watch: &mut Watch<'_>,
) -> Result<ThreadedTree<M>, OtError> {
    let rows = table.costs.len() / table.cols;
    watch.ask()?;
    let block = ((1.5 * (table.costs.len() as f64).sqrt() / table.cols as f64).ceil() as usize).clamp(1, rows);
    let mut row = 0;
    loop {
        let mut clean = 0;
        let mut pivots = 0u64;
        while clean < rows {
            let end = (row + block).min(rows);
            match price_rows(table, row..end, &tree, tolerance) {
                Some((i, j, cost)) => {
                    watch.step()?;
                    tree.pivot(i, j, cost);
                    tolerance.count_pivot(&tree.pi);
                    clean = 0;
                    pivots += 1;
                }
                None => clean += end - row,
            }
            row = if end == rows { 0 } else { end };
        }
        if pivots == 0 {
            return Ok(tree);
        }
        match origin {
            Some(node) => tree.refresh_from(node),
            None => tree.refresh_potentials(),
        }
        tolerance.adapt(&tree.pi);
    }
}

/// The most negative arc of the rows, if it is negative beyond rounding.
fn price_rows<M: Mass>(
    table: Table<'_>,
    rows: std::ops::Range<usize>,
    tree: &ThreadedTree<M>,
    tolerance: Tolerance,
) -> Option<(usize, usize, f64)> {
    let (u, minus_v) = (tree.row_potentials(), tree.col_potentials_negated());
    let mut best = (0.0, usize::MAX, usize::MAX);
    for i in rows.clone() {
        let (low, j) = run(LeastSum(&table.costs[i * table.cols..(i + 1) * table.cols], minus_v));
        if low - u[i] < best.0 {
            best = (low - u[i], i, j);
        }
    }
    let (reduced, i, j) = best;
    if i == usize::MAX || !tolerance.may_be_negative(reduced) {
        return None;
    }
    let cost = table.costs[i * table.cols + j];
    if tolerance.is_negative(reduced, cost, u[i], minus_v[j]) {
        return Some((i, j, cost));
    }
    // The lowest arc is rounding: look for another that is not.
    for i in rows {
        for (j, &cost) in table.costs[i * table.cols..(i + 1) * table.cols].iter().enumerate() {
            if tolerance.is_negative(cost - u[i] + minus_v[j], cost, u[i], minus_v[j]) {
                return Some((i, j, cost));
            }
        }
    }
    None
}
