//! Powers of the distance between numbers: with any order from one up, a convex cost on a line.

use crate::cost::Cost;

/// Two sets of numbers that are at most about one apart, and the order.
#[derive(Clone, Debug)]
pub struct Line {
    x: Vec<f64>,
    y: Vec<f64>,
    order: f64,
    bound: f64,
}

impl Line {
    /// The cost `|x[i] - y[j]|^order`.
    #[must_use]
    pub fn new(x: &[f64], y: &[f64], order: f64) -> Self {
        let all = || x.iter().chain(y).copied();
        let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
        Self { x: x.to_vec(), y: y.to_vec(), order, bound: price(high, low, order) }
    }

    /// The numbers of both sets.
    #[must_use]
    pub fn numbers(&self) -> (&[f64], &[f64]) {
        (&self.x, &self.y)
    }
}

/// The cost of one pair.
#[must_use]
pub fn price(x: f64, y: f64, order: f64) -> f64 {
    (x - y).abs().powf(order)
}

impl Cost for Line {
    fn rows(&self) -> usize {
        self.x.len()
    }

    fn cols(&self) -> usize {
        self.y.len()
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        price(self.x[row], self.y[col], self.order)
    }

    fn fill_row(&self, row: usize, out: &mut [f64]) {
        for (out, &y) in out.iter_mut().zip(&self.y) {
            *out = price(self.x[row], y, self.order);
        }
    }

    fn subset(&self, rows: &[usize], cols: &[usize]) -> Box<dyn Cost + '_> {
        let pick = |values: &[f64], places: &[usize]| places.iter().map(|&i| values[i]).collect();
        Box::new(Self { x: pick(&self.x, rows), y: pick(&self.y, cols), ..*self })
    }

    fn bound(&self) -> f64 {
        self.bound
    }

    fn floor(&self) -> f64 {
        0.0
    }

    fn unscale(&self, _row: usize, _col: usize, scaled: f64) -> f64 {
        scaled
    }

    fn exponent(&self) -> i32 {
        0
    }
}
