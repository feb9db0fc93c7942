//! Network simplex over a list of arcs.

use crate::candidates::Candidates;
use crate::error::OtError;
use crate::network_simplex::Tolerance;
use crate::tree::Tree;
use crate::watch::Watch;

/// Arcs with their costs.
#[derive(Clone, Debug, Default)]
pub struct ArcList {
    rows: Vec<u32>,
    /// Node numbers of the columns.
    heads: Vec<u32>,
    costs: Vec<f64>,
}

impl ArcList {
    /// Adds the arc from a row to a column, given as node number (number of rows plus column).
    #[inline]
    pub fn push(&mut self, row: u32, head: u32, cost: f64) {
        self.rows.push(row);
        self.heads.push(head);
        self.costs.push(cost);
    }

    /// Number of arcs.
    #[must_use]
    pub fn len(&self) -> usize {
        self.costs.len()
    }

    /// Whether there is no arc.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.costs.is_empty()
    }

    /// Row, column node and cost of an arc.
    #[must_use]
    pub fn get(&self, arc: usize) -> (u32, u32, f64) {
        (self.rows[arc], self.heads[arc], self.costs[arc])
    }

    /// The most negative reduced cost among some arcs.
    #[inline]
    fn cheapest(&self, range: std::ops::Range<usize>, pi: &[f64]) -> (f64, usize) {
        let mut best = (0.0, usize::MAX);
        let arcs = self.rows[range.clone()].iter().zip(&self.heads[range.clone()]).zip(&self.costs[range.clone()]);
        for (arc, ((&row, &head), &cost)) in arcs.enumerate() {
            let reduced = cost - pi[row as usize] + pi[head as usize];
            if reduced < best.0 {
                best = (reduced, range.start + arc);
            }
        }
        best
    }
}

/// Improves the tree until no arc of the list has a negative reduced cost.
///
/// The arcs are priced in blocks. A block gives its most negative arcs, and each of them enters the tree unless those
/// before it have changed its reduced cost too much; then the potentials are computed again.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(arcs: &ArcList, tree: &mut Tree, tolerance: &mut Tolerance, watch: &mut Watch<'_>) -> Result<(), OtError> {
    let n = tree.row_potentials().len();
    let count = arcs.len();
    let block = count.div_ceil(BLOCKS).max(1);
    let mut candidates = Candidates::default();
    let mut place = 0;
    loop {
        let (mut clean, mut pivots) = (0, 0u64);
        while clean < count {
            let end = (place + block).min(count);
            for start in (place..end).step_by(NEIGHBOURS) {
                let (reduced, arc) = arcs.cheapest(start..(start + NEIGHBOURS).min(end), &tree.pi);
                if tolerance.may_be_negative(reduced) {
                    candidates.add(reduced, arc);
                }
            }
            let enter = |arc: usize, tree: &mut Tree, tolerance: &Tolerance| {
                let (row, head, cost) = arcs.get(arc);
                tree.pivot(row as usize, head as usize - n, cost, tolerance)
            };
            let entered = candidates.enter(tree, tolerance, watch, enter)?;
            pivots += entered;
            clean = if entered > 0 { 0 } else { clean + end - place };
            place = if end == count { 0 } else { end };
        }
        if pivots == 0 {
            return Ok(());
        }
        tree.recentre();
        tolerance.adapt(&tree.pi);
    }
}

/// Blocks that the list is priced in, and arcs of which at most one is a candidate.
const BLOCKS: usize = 4;
const NEIGHBOURS: usize = 32;
