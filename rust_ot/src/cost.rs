//! Costs: a given matrix, or distances between points computed when asked for.

use crate::error::{OtError, bad};
use crate::masses::{exponent_of, times_power_of_two};

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
    /// Costs of one row, scaled, into `out`.
    fn fill_row(&self, row: usize, out: &mut [f64]);
    /// A bound on the absolute cost of every pair, scaled.
    fn bound(&self) -> f64;
    /// Cost of one pair in the caller's units.
    fn unscaled(&self, row: usize, col: usize) -> f64;
    /// Exponent of the unit of the scaled costs.
    fn exponent(&self) -> i32;
}

/// Two sets of points; costs are direct differences in `f64`, never expanded squares.
#[derive(Clone, Debug)]
pub struct Points {
    x: Vec<f64>,
    y: Vec<f64>,
    dim: usize,
    metric: Metric,
    shift: i32,
    bound: f64,
}

impl Points {
    /// Checks and scales the points by a power of two, which is exact; `x` is `(n, dim)`, `y` is `(m, dim)`.
    ///
    /// # Errors
    /// `BadInput` for an empty set or a coordinate that is not finite.
    pub fn new(x: &[f64], y: &[f64], dim: usize, metric: Metric) -> Result<Self, OtError> {
        let largest = largest_coordinate("x", x, dim)?.max(largest_coordinate("y", y, dim)?);
        let shift = if largest > 0.0 { exponent_of(largest) + 1 } else { 0 };
        let scale = |values: &[f64]| -> Vec<f64> { values.iter().map(|&v| times_power_of_two(v, -shift)).collect() };
        let (x, y) = (scale(x), scale(y));
        let mut reach = vec![(f64::INFINITY, f64::NEG_INFINITY); dim];
        for point in x.chunks_exact(dim).chain(y.chunks_exact(dim)) {
            for (&value, (low, high)) in point.iter().zip(&mut reach) {
                *low = low.min(value);
                *high = high.max(value);
            }
        }
        let zero = vec![0.0; dim];
        let sides: Vec<f64> = reach.iter().map(|(low, high)| high - low).collect();
        Ok(Self { x, y, dim, metric, shift, bound: distance(&sides, &zero, metric) })
    }

    /// The scaled coordinates of both sets.
    #[must_use]
    pub fn scaled(&self) -> (&[f64], &[f64]) {
        (&self.x, &self.y)
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.x[row * self.dim..(row + 1) * self.dim]
    }

    fn col(&self, col: usize) -> &[f64] {
        &self.y[col * self.dim..(col + 1) * self.dim]
    }
}

/// Checks a set of points and gives its largest absolute coordinate.
pub(crate) fn largest_coordinate(name: &str, points: &[f64], dim: usize) -> Result<f64, OtError> {
    if dim == 0 || points.is_empty() {
        return Err(bad(format!("{name} is empty: give at least one point with one coordinate")));
    }
    if let Some(place) = points.iter().position(|v| !v.is_finite()) {
        let (row, column) = (place / dim, place % dim);
        return Err(bad(format!("{name}[{row}, {column}] is {}: coordinates must be finite", points[place])));
    }
    Ok(points.iter().fold(0.0, |largest: f64, v| largest.max(v.abs())))
}

#[inline(always)]
fn distance(x: &[f64], y: &[f64], metric: Metric) -> f64 {
    let differences = x.iter().zip(y).map(|(a, b)| a - b);
    match metric {
        Metric::Euclidean => differences.map(|t| t * t).sum::<f64>().sqrt(),
        Metric::SqEuclidean => differences.map(|t| t * t).sum(),
        Metric::CityBlock => differences.map(f64::abs).sum(),
    }
}

impl Cost for Points {
    fn rows(&self) -> usize {
        self.x.len() / self.dim
    }

    fn cols(&self) -> usize {
        self.y.len() / self.dim
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        distance(self.row(row), self.col(col), self.metric)
    }

    fn fill_row(&self, row: usize, out: &mut [f64]) {
        let x = self.row(row);
        for (value, y) in out.iter_mut().zip(self.y.chunks_exact(self.dim)) {
            *value = distance(x, y, self.metric);
        }
    }

    fn bound(&self) -> f64 {
        self.bound
    }

    fn unscaled(&self, row: usize, col: usize) -> f64 {
        let (x, y) = (self.row(row), self.col(col));
        let largest = x.iter().zip(y).fold(0.0_f64, |largest, (a, b)| largest.max((a - b).abs()));
        if largest == 0.0 {
            return 0.0;
        }
        // A second exact scaling keeps squares of very small differences from vanishing.
        let shift = exponent_of(largest);
        let lift = |values: &[f64]| -> Vec<f64> { values.iter().map(|&v| times_power_of_two(v, -shift)).collect() };
        let value = distance(&lift(x), &lift(y), self.metric);
        let power = if self.metric == Metric::SqEuclidean { 2 } else { 1 };
        times_power_of_two(value, power * (shift + self.shift))
    }

    fn exponent(&self) -> i32 {
        if self.metric == Metric::SqEuclidean { 2 * self.shift } else { self.shift }
    }
}

/// A given cost matrix, row by row.
#[derive(Clone, Debug)]
pub struct Matrix<'a> {
    costs: &'a [f64],
    cols: usize,
    shift: i32,
    factor: f64,
    bound: f64,
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
        let largest = costs.iter().fold(0.0, |largest: f64, v| largest.max(v.abs()));
        let shift = if largest > 0.0 { exponent_of(largest).max(-1021) } else { 0 };
        let factor = times_power_of_two(1.0, -shift);
        Ok(Self { costs, cols, shift, factor, bound: largest * factor })
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
        self.unscaled(row, col) * self.factor
    }

    fn fill_row(&self, row: usize, out: &mut [f64]) {
        let costs = &self.costs[row * self.cols..(row + 1) * self.cols];
        for (value, cost) in out.iter_mut().zip(costs) {
            *value = cost * self.factor;
        }
    }

    fn bound(&self) -> f64 {
        self.bound
    }

    fn unscaled(&self, row: usize, col: usize) -> f64 {
        self.costs[row * self.cols + col]
    }

    fn exponent(&self) -> i32 {
        self.shift
    }
}
