//! Costs given as a matrix.

use crate::cost::Cost;
use crate::error::{OtError, bad};
use crate::masses::{exponent_of, times_power_of_two};

/// A given cost matrix, row by row.
#[derive(Clone, Debug)]
pub struct Matrix<'a> {
    costs: &'a [f64],
    cols: usize,
    shift: i32,
    factor: f64,
    bound: f64,
    floor: f64,
}

impl<'a> Matrix<'a> {
    /// Checks the matrix; any finite costs are allowed, negative ones too.
    ///
    /// # Errors
    /// `BadInput` for an empty matrix or a cost that is not finite.
    pub fn new(costs: &'a [f64], cols: usize) -> Result<Self, OtError> {
        if cols == 0 || costs.is_empty() {
            return Err(bad("cost is empty: give at least one row and one column".to_owned()));
        }
        if let Some(place) = costs.iter().position(|v| !v.is_finite()) {
            let (row, col) = (place / cols, place % cols);
            return Err(bad(format!("cost[{row}, {col}] is {}: costs must be finite", costs[place])));
        }
        let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
        let largest = costs.iter().fold(0.0, |largest: f64, v| largest.max(v.abs()));
        let shift = if largest > 0.0 { exponent_of(largest).max(-1021) } else { 0 };
        let factor = times_power_of_two(1.0, -shift);
        Ok(Self { costs, cols, shift, factor, bound: largest * factor, floor: least * factor })
    }
}

impl Cost for Matrix<'_> {
    fn rows(&self) -> usize {
        self.costs.len() / self.cols
    }

    fn cols(&self) -> usize {
        self.cols
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        self.costs[row * self.cols + col] * self.factor
    }

    fn fill_row(&self, row: usize, out: &mut [f64]) {
        let costs = &self.costs[row * self.cols..(row + 1) * self.cols];
        for (value, cost) in out.iter_mut().zip(costs) {
            *value = cost * self.factor;
        }
    }

    fn subset(&self, rows: &[usize], cols: &[usize]) -> Box<dyn Cost + '_> {
        let costs = rows.iter().flat_map(|&i| cols.iter().map(move |&j| self.at(i, j))).collect();
        Box::new(Part { costs, cols: cols.len(), bound: self.bound, floor: self.floor, shift: self.shift })
    }

    fn is_stored(&self) -> bool {
        true
    }

    fn bound(&self) -> f64 {
        self.bound
    }

    fn floor(&self) -> f64 {
        self.floor
    }

    fn unscale(&self, row: usize, col: usize, _scaled: f64) -> f64 {
        self.costs[row * self.cols + col]
    }

    fn exponent(&self) -> i32 {
        self.shift
    }
}

/// Some rows and columns of a matrix, scaled.
#[derive(Clone, Debug)]
struct Part {
    costs: Vec<f64>,
    cols: usize,
    bound: f64,
    floor: f64,
    shift: i32,
}

impl Cost for Part {
    fn rows(&self) -> usize {
        self.costs.len() / self.cols
    }

    fn cols(&self) -> usize {
        self.cols
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        self.costs[row * self.cols + col]
    }

    fn fill_row(&self, row: usize, out: &mut [f64]) {
        out.copy_from_slice(&self.costs[row * self.cols..(row + 1) * self.cols]);
    }

    fn subset(&self, rows: &[usize], cols: &[usize]) -> Box<dyn Cost + '_> {
        let costs = rows.iter().flat_map(|&i| cols.iter().map(move |&j| self.at(i, j))).collect();
        Box::new(Self { costs, cols: cols.len(), ..*self })
    }

    fn is_stored(&self) -> bool {
        true
    }

    fn bound(&self) -> f64 {
        self.bound
    }

    fn floor(&self) -> f64 {
        self.floor
    }

    fn unscale(&self, _row: usize, _col: usize, scaled: f64) -> f64 {
        times_power_of_two(scaled, self.shift)
    }

    fn exponent(&self) -> i32 {
        self.shift
    }
}
