//! Arcs that may enter the tree, the most negative first.

use crate::error::OtError;
use crate::network_simplex::Tolerance;
use crate::tree::Tree;
use crate::watch::Watch;

/// Candidates that are tried, and how many may fail one after the other, before the potentials are computed again:
/// that takes about as long as a few hundred trials.
const TRIED: usize = 200;
const FAILED: usize = 40;

/// Reduced costs at the last refresh of the tree, and names of arcs.
#[derive(Clone, Debug, Default)]
pub struct Candidates(Vec<(f64, usize)>);

impl Candidates {
    /// Adds an arc.
    #[inline]
    pub fn add(&mut self, reduced: f64, arc: usize) {
        self.0.push((reduced, arc));
    }

    /// Lets the most negative arcs enter by `pivot`, which tells whether an arc did, refreshes the tree, and forgets
    /// all candidates. Gives the number of arcs that entered.
    ///
    /// # Errors
    /// `Interrupted` or `NotOptimal`, from the watch.
    pub fn enter(
        &mut self,
        tree: &mut Tree,
        tolerance: &mut Tolerance,
        watch: &mut Watch<'_>,
        mut pivot: impl FnMut(usize, &mut Tree, &Tolerance) -> bool,
    ) -> Result<u64, OtError> {
        let order = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        if self.0.len() > TRIED {
            self.0.select_nth_unstable_by(TRIED - 1, order);
            self.0.truncate(TRIED);
        }
        self.0.sort_unstable_by(order);
        let (mut entered, mut failed) = (0, 0);
        for &(_, arc) in &self.0 {
            if pivot(arc, tree, tolerance) {
                watch.step()?;
                tolerance.count_pivot(&tree.pi);
                (entered, failed) = (entered + 1, 0);
            } else {
                failed += 1;
                if failed > FAILED {
                    break;
                }
            }
        }
        self.0.clear();
        if entered > 0 {
            tree.refresh();
        }
        Ok(entered)
    }
}
