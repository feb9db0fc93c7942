//! A cost whose pairs are all computed once and kept.

use crate::cost::Cost;
use crate::error::OtError;
use crate::watch::Watch;

/// The pairs of another cost.
pub struct Stored<'a> {
    of: Of<'a>,
    costs: Vec<f64>,
}

enum Of<'a> {
    Lent(&'a dyn Cost),
    Own(Box<dyn Cost + 'a>),
}

impl Of<'_> {
    fn get(&self) -> &dyn Cost {
        match self {
            Of::Lent(cost) => *cost,
            Of::Own(cost) => &**cost,
        }
    }
}

impl<'a> Stored<'a> {
    /// Computes all pairs of a cost.
    #[must_use]
    pub fn new(cost: &'a dyn Cost) -> Self {
        let mut costs = vec![0.0; cost.rows() * cost.cols()];
        for (row, out) in costs.chunks_exact_mut(cost.cols()).enumerate() {
            cost.fill_row(row, out);
        }
        Self { of: Of::Lent(cost), costs }
    }
}

impl Cost for Stored<'_> {
    fn rows(&self) -> usize {
        self.of.get().rows()
    }

    fn cols(&self) -> usize {
        self.of.get().cols()
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        self.costs[row * self.cols() + col]
    }

    fn fill_row(&self, row: usize, out: &mut [f64]) {
        out.copy_from_slice(&self.costs[row * self.cols()..(row + 1) * self.cols()]);
    }

    fn subset(&self, rows: &[usize], cols: &[usize]) -> Box<dyn Cost + '_> {
        let costs = rows.iter().flat_map(|&i| cols.iter().map(move |&j| self.at(i, j))).collect();
        Box::new(Stored { of: Of::Own(self.of.get().subset(rows, cols)), costs })
    }

    fn nearest(
        &self,
        rows: bool,
        points: &[usize],
        among: &[usize],
        watch: &mut Watch<'_>,
    ) -> Result<Option<Vec<u32>>, OtError> {
        self.of.get().nearest(rows, points, among, watch)
    }

    fn is_stored(&self) -> bool {
        true
    }

    fn bound(&self) -> f64 {
        self.of.get().bound()
    }

    fn floor(&self) -> f64 {
        self.of.get().floor()
    }

    fn unscale(&self, row: usize, col: usize, scaled: f64) -> f64 {
        self.of.get().unscale(row, col, scaled)
    }

    fn exponent(&self) -> i32 {
        self.of.get().exponent()
    }
}
