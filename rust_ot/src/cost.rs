//! Costs: what moving one unit of mass between two points costs.

use crate::error::OtError;
use crate::merge::Groups;
use crate::watch::Watch;

/// What moving one unit of mass between two points costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Length of the difference.
    Euclidean,
    /// Its square.
    SqEuclidean,
    /// Sum of the absolute differences.
    CityBlock,
}

/// The cost of every pair, in units of `2^exponent` so that the largest is near one.
pub trait Cost: Sync {
    /// Number of rows (points of the first set).
    fn rows(&self) -> usize;
    /// Number of columns (points of the second set).
    fn cols(&self) -> usize;
    /// Cost of one pair, scaled.
    fn at(&self, row: usize, col: usize) -> f64;
    /// Costs of one row, scaled, into `out`; the same bits as [`Cost::at`].
    fn fill_row(&self, row: usize, out: &mut [f64]);
    /// Costs of all pairs, scaled, column by column.
    fn by_columns(&self) -> Vec<f64> {
        let (n, mut costs) = (self.rows(), vec![0.0; self.rows() * self.cols()]);
        let mut row_costs = vec![0.0; self.cols()];
        for row in 0..n {
            self.fill_row(row, &mut row_costs);
            for (j, &cost) in row_costs.iter().enumerate() {
                costs[j * n + row] = cost;
            }
        }
        costs
    }
    /// The same costs for some of the rows and columns.
    fn subset(&self, rows: &[usize], cols: &[usize]) -> Box<dyn Cost + '_>;
    /// For each of some points of one side, the place in `among` of the nearest point of that side; `None` where
    /// points have no places.
    ///
    /// # Errors
    /// `Interrupted` or `NotOptimal`, from the watch.
    fn nearest(
        &self,
        rows: bool,
        points: &[usize],
        among: &[usize],
        watch: &mut Watch<'_>,
    ) -> Result<Option<Vec<u32>>, OtError> {
        let _ = (rows, points, among, watch);
        Ok(None)
    }
    /// Which rows, or which columns, are the same point; `None` where all are distinct, or where points have no places.
    fn groups(&self, rows: bool) -> Option<Groups> {
        let _ = rows;
        None
    }
    /// Whether all pairs are at hand rather than computed when asked for.
    fn is_stored(&self) -> bool {
        false
    }
    /// A bound on the absolute cost of every pair, scaled.
    fn bound(&self) -> f64;
    /// A bound below the cost of every pair, scaled.
    fn floor(&self) -> f64;
    /// A scaled cost below which digits may be missing, where numbers given are too small for the unit; zero if none is.
    fn resolution(&self) -> f64 {
        0.0
    }
    /// Cost of one pair in the caller's units, from the scaled one.
    fn unscale(&self, row: usize, col: usize, scaled: f64) -> f64;
    /// Cost of one pair in the caller's units.
    fn unscaled(&self, row: usize, col: usize) -> f64 {
        self.unscale(row, col, self.at(row, col))
    }
    /// Exponent of the unit of the scaled costs.
    fn exponent(&self) -> i32;
}
