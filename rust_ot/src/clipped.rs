//! Costs clipped from above, where some are so far beyond what a plan pays that the potentials lose the digits that decide.
//!
//! Take any plan, let `p` be its largest price, `c` a bound below all costs and `k` the points of the smaller side. What
//! an optimal plan for the clipped costs moves in another way goes round in cycles of at most `k` pairs of each plan. If
//! one of its pairs were clipped at more than `p + (k - 1) (p - c)`, the cycle through it would be cheaper the other way
//! round. So it pays no clipped cost, and it costs what it costs by the true ones. Its potentials are nowhere above the
//! clipped costs, hence not above the true ones either: they prove it optimal for those.

use crate::cost::Cost;
use crate::error::OtError;
use crate::merge::Groups;
use crate::watch::Watch;

/// Another cost, but at most `limit`.
pub struct Clipped<'a> {
    of: Of<'a>,
    limit: f64,
}

enum Of<'a> {
    Lent(&'a dyn Cost),
    Own(Box<dyn Cost + 'a>),
}

impl<'a> Clipped<'a> {
    /// Clips a cost at a limit in its scaled units.
    #[must_use]
    pub fn new(cost: &'a dyn Cost, limit: f64) -> Self {
        Self { of: Of::Lent(cost), limit }
    }

    fn of(&self) -> &dyn Cost {
        match &self.of {
            Of::Lent(cost) => *cost,
            Of::Own(cost) => &**cost,
        }
    }
}

/// The largest scaled cost that a plan pays.
#[must_use]
pub fn largest_price<M>(cost: &dyn Cost, arcs: &[(usize, usize, M)]) -> f64 {
    arcs.iter().map(|&(i, j, _)| cost.at(i, j)).fold(f64::NEG_INFINITY, f64::max)
}

/// Where to clip when there is a plan whose largest price is `price`.
#[must_use]
pub fn limit(cost: &dyn Cost, price: f64) -> f64 {
    price + cost.rows().min(cost.cols()) as f64 * (price - cost.floor())
}

impl Cost for Clipped<'_> {
    fn rows(&self) -> usize {
        self.of().rows()
    }

    fn cols(&self) -> usize {
        self.of().cols()
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        self.of().at(row, col).min(self.limit)
    }

    fn fill_row(&self, row: usize, out: &mut [f64]) {
        self.of().fill_row(row, out);
        out.iter_mut().for_each(|cost| *cost = cost.min(self.limit));
    }

    fn by_columns(&self) -> Vec<f64> {
        let mut costs = self.of().by_columns();
        costs.iter_mut().for_each(|cost| *cost = cost.min(self.limit));
        costs
    }

    fn subset(&self, rows: &[usize], cols: &[usize]) -> Box<dyn Cost + '_> {
        Box::new(Clipped { of: Of::Own(self.of().subset(rows, cols)), limit: self.limit })
    }

    fn nearest(
        &self,
        rows: bool,
        points: &[usize],
        among: &[usize],
        watch: &mut Watch<'_>,
    ) -> Result<Option<Vec<u32>>, OtError> {
        self.of().nearest(rows, points, among, watch)
    }

    fn groups(&self, rows: bool) -> Option<Groups> {
        self.of().groups(rows)
    }

    fn is_stored(&self) -> bool {
        self.of().is_stored()
    }

    fn bound(&self) -> f64 {
        self.limit.max(-self.floor())
    }

    fn floor(&self) -> f64 {
        self.of().floor()
    }

    fn unscale(&self, row: usize, col: usize, scaled: f64) -> f64 {
        self.of().unscale(row, col, scaled)
    }

    fn exponent(&self) -> i32 {
        self.of().exponent()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix::Matrix;

    #[test]
    fn every_view_is_clipped() {
        let costs = [-1.0, 5.0, 0.5, 0.25, 3.0, 0.75];
        let matrix = Matrix::new(&costs, 3).unwrap();
        let clipped = Clipped::new(&matrix, 0.125);
        let expected = costs.map(|cost| (cost / 4.0_f64).min(0.125));
        let mut row = [0.0; 3];
        for i in 0..2 {
            clipped.fill_row(i, &mut row);
            assert_eq!(row, expected[3 * i..3 * i + 3]);
            assert!((0..3).all(|j| clipped.at(i, j) == row[j] && clipped.by_columns()[2 * j + i] == row[j]));
            assert_eq!(clipped.subset(&[i], &[2]).at(0, 0), row[2]);
        }
        assert_eq!((clipped.floor(), clipped.bound()), (-0.25, 0.25));
        assert_eq!(limit(&matrix, 0.5), 0.5 + 2.0 * 0.75);
    }
}
