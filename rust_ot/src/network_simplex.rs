//! Network simplex over a full table of costs: the tree does the moves, whole blocks of rows are priced at once.

use crate::candidates::Candidates;
use crate::error::OtError;
use crate::simd::{LeastSum, run};
use crate::tree::Tree;
use crate::watch::Watch;

/// How negative a reduced cost must be to count: more than rounding can make it.
#[derive(Clone, Copy, Debug)]
pub struct Tolerance {
    floor: f64,
    growth: f64,
    pivots_left: u64,
}

impl Tolerance {
    /// A tolerance of some dozen units in the last place of numbers as large as `size`.
    #[must_use]
    pub fn new(size: f64, nodes: usize) -> Self {
        Self { floor: Self::SHARE * size, growth: 1.0, pivots_left: 200 * nodes as u64 + 10_000 }
    }

    /// A tolerance for given potentials.
    pub fn of_potentials<'a>(potentials: impl Iterator<Item = &'a f64> + Clone) -> Self {
        Self::new(typical_size(potentials.clone()), potentials.count())
    }

    const SHARE: f64 = 7.2e-15;

    /// Takes over the size of the potentials after they were computed again.
    pub fn adapt(&mut self, tree: &Tree) {
        self.floor = Self::SHARE * self.growth * typical_size(tree.pi[..tree.pi.len() - 1].iter());
    }

    /// Counts a pivot. A search that goes on for very long is turning in rounding errors: it gets more tolerance, and
    /// the certificate decides whether the outcome is good enough.
    pub fn count_pivot(&mut self, tree: &Tree) {
        self.pivots_left -= 1;
        if self.pivots_left == 0 {
            self.pivots_left = 20 * tree.pi.len() as u64 + 1_000;
            self.growth *= 4.0;
            self.adapt(tree);
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
        reduced < -(self.floor + Self::SHARE * (cost.abs() + u.abs() + v.abs()))
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

/// Improves a tree until it is optimal for the table; `big` bounds every absolute cost.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(table: Table<'_>, mut tree: Tree, big: f64, watch: &mut Watch<'_>) -> Result<Tree, OtError> {
    let rows = table.costs.len() / table.cols;
    let mut tolerance = Tolerance::new(big, tree.pi.len());
    watch.ask()?;
    let cols = table.cols;
    let block = rows.div_ceil(BLOCKS).max(1);
    let mut candidates = Candidates::default();
    let mut row = 0;
    loop {
        let (mut clean, mut pivots) = (0, 0u64);
        while clean < rows {
            let end = (row + block).min(rows);
            for i in row..end {
                if let Some((reduced, j)) = price_row(table, i, &tree, tolerance) {
                    candidates.add(reduced, i * cols + j);
                }
            }
            let enter = |arc: usize, tree: &mut Tree, tolerance: &Tolerance| {
                tree.pivot(arc / cols, arc % cols, table.costs[arc], tolerance)
            };
            let entered = candidates.enter(&mut tree, &mut tolerance, watch, enter)?;
            pivots += entered;
            clean = if entered > 0 { 0 } else { clean + end - row };
            row = if end == rows { 0 } else { end };
        }
        if pivots == 0 {
            return Ok(tree);
        }
        tree.recentre();
        tolerance.adapt(&tree);
    }
}

/// Blocks that the table is priced in.
const BLOCKS: usize = 4;

/// The most negative arc of a row, if it is negative beyond rounding.
fn price_row(table: Table<'_>, row: usize, tree: &Tree, tolerance: Tolerance) -> Option<(f64, usize)> {
    let (u, minus_v) = (tree.row_potentials()[row], tree.col_potentials_negated());
    let costs = &table.costs[row * table.cols..(row + 1) * table.cols];
    let (low, j) = run(LeastSum(costs, minus_v));
    if !tolerance.may_be_negative(low - u) {
        return None;
    }
    if tolerance.is_negative(low - u, costs[j], u, minus_v[j]) {
        return Some((low - u, j));
    }
    // The lowest arc is rounding: look for another that is not.
    let others = costs.iter().zip(minus_v).enumerate();
    others
        .map(|(j, (&c, &v))| (c - u + v, j, c, v))
        .find(|&(r, _, c, v)| tolerance.is_negative(r, c, u, v))
        .map(|x| (x.0, x.1))
}
