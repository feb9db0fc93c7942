//! Costs as distances between points, computed whenever they are asked for.

use crate::cost::{Cost, Metric};
use crate::error::{OtError, bad};
use crate::masses::{exponent_of, times_power_of_two};
use crate::merge::Groups;
use crate::scan::{blocks, rows_between_questions};
use crate::simd::{LANES, LeastSum, run, vectorized};
use crate::watch::Watch;

/// Above this cost and with exponents below this one, squares and results are far from the ends of the range.
const SAFE_COST: f64 = 1e-100;
const SAFE_EXPONENT: i32 = 500;

/// What coordinates lose is below 2^-1074, and nothing beside a cost above this one.
const BLURRED: f64 = 1e-270;

/// Largest share of the mean squared distance at which a point still stands for its nearest.
const NEAR: f64 = 0.25;

/// Two sets of points; costs are direct differences in `f64`, never expanded squares.
#[derive(Clone, Debug)]
pub struct Points {
    x: Vec<f64>,
    y: Vec<f64>,
    /// The columns again, in blocks of [`LANES`] points with one coordinate after the other.
    blocks: Vec<f64>,
    dim: usize,
    metric: Metric,
    shift: i32,
    bound: f64,
    /// Whether coordinates are so small beside others that digits of theirs were lost.
    blurred: bool,
}

impl Points {
    /// Checks and scales the points by a power of two, which is exact unless digits vanish beside far points, see
    /// [`Cost::resolution`]; `x` is `(n, dim)`, `y` is `(m, dim)`.
    ///
    /// # Errors
    /// `BadInput` for an empty set or a coordinate that is not finite.
    pub fn new(x: &[f64], y: &[f64], dim: usize, metric: Metric) -> Result<Self, OtError> {
        check_points("x", x, dim)?;
        check_points("y", y, dim)?;
        let mut reach = vec![(f64::INFINITY, f64::NEG_INFINITY); dim];
        for point in x.chunks_exact(dim).chain(y.chunks_exact(dim)) {
            for (&value, (low, high)) in point.iter().zip(&mut reach) {
                *low = low.min(value);
                *high = high.max(value);
            }
        }
        // Coordinates that all points share play no part, however large they are.
        let kept: Vec<usize> = (0..dim).filter(|&k| reach[k].0 < reach[k].1).collect();
        let Some(shift) = kept.iter().map(|&k| width_exponent(reach[k]) + 1).max() else {
            let zeros = |values: &[f64]| vec![0.0; values.len() / dim];
            return Ok(Self::assemble(zeros(x), zeros(y), 1, metric, 0, 0.0));
        };
        let scaled = |v: f64| times_power_of_two(v, -shift);
        let whole = |(k, &v): (usize, &f64)| {
            let (low, high) = reach[k % dim];
            low == high || times_power_of_two(scaled(v), shift) == v
        };
        let blurred = !(x.iter().enumerate().all(whole) && y.iter().enumerate().all(whole));
        let scale = |values: &[f64]| -> Vec<f64> {
            values.chunks_exact(dim).flat_map(|point| kept.iter().map(|&k| scaled(point[k]))).collect()
        };
        // The root of a square is exact on a line, except where the square vanishes.
        let metric = if kept.len() == 1 && metric == Metric::Euclidean { Metric::CityBlock } else { metric };
        let (low, high): (Vec<f64>, Vec<f64>) = kept.iter().map(|&k| (scaled(reach[k].0), scaled(reach[k].1))).unzip();
        let bound = distance(&high, &low, metric);
        Ok(Self { blurred, ..Self::assemble(scale(x), scale(y), kept.len(), metric, shift, bound) })
    }

    fn assemble(x: Vec<f64>, y: Vec<f64>, dim: usize, metric: Metric, shift: i32, bound: f64) -> Self {
        let m = y.len() / dim;
        let mut blocks = vec![0.0; m.div_ceil(LANES) * LANES * dim];
        for (j, point) in y.chunks_exact(dim).enumerate() {
            for (k, &value) in point.iter().enumerate() {
                blocks[j / LANES * LANES * dim + k * LANES + j % LANES] = value;
            }
        }
        Self { x, y, blocks, dim, metric, shift, bound, blurred: false }
    }

    /// Coordinates that play a part, at least one.
    #[must_use]
    pub fn dim(&self) -> usize {
        self.dim
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

/// The exponent of a width or the one above, though the width may be beyond the range of numbers.
fn width_exponent((low, high): (f64, f64)) -> i32 {
    let half = high / 2.0 - low / 2.0;
    if half < f64::MIN_POSITIVE { exponent_of(high - low) } else { exponent_of(half) + 1 }
}

/// Refuses an empty set and coordinates that are not finite.
pub(crate) fn check_points(name: &str, points: &[f64], dim: usize) -> Result<(), OtError> {
    if dim == 0 || points.is_empty() {
        return Err(bad(format!("{name} is empty: give at least one point with one coordinate")));
    }
    if let Some(place) = points.iter().position(|v| !v.is_finite()) {
        let (row, column) = (place / dim, place % dim);
        return Err(bad(format!("{name}[{row}, {column}] is {}: coordinates must be finite", points[place])));
    }
    Ok(())
}

/// Sums in the order of the coordinates, as [`fill`] does, so that both give the same bits.
#[inline(always)]
fn distance(x: &[f64], y: &[f64], metric: Metric) -> f64 {
    let mut sum = 0.0;
    for (a, b) in x.iter().zip(y) {
        let t = a - b;
        sum += if metric == Metric::CityBlock { t.abs() } else { t * t };
    }
    if metric == Metric::Euclidean { sum.sqrt() } else { sum }
}

/// Distances of one point from blocks of points.
#[inline(always)]
fn fill<const ABSOLUTE: bool, const ROOT: bool>(x: &[f64], blocks: &[f64], out: &mut [f64]) {
    for (out, block) in out.chunks_mut(LANES).zip(blocks.chunks_exact(LANES * x.len())) {
        let mut sums = [0.0; LANES];
        let (coordinates, _) = block.as_chunks::<LANES>();
        for (&a, coordinates) in x.iter().zip(coordinates) {
            for lane in 0..LANES {
                let t = a - coordinates[lane];
                sums[lane] += if ABSOLUTE { t.abs() } else { t * t };
            }
        }
        if ROOT {
            for sum in &mut sums {
                *sum = sum.sqrt();
            }
        }
        if let Ok(out) = <&mut [f64; LANES]>::try_from(&mut *out) {
            *out = sums;
        } else {
            out.copy_from_slice(&sums[..out.len()]);
        }
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
        let (x, blocks) = (self.row(row), &self.blocks[..]);
        vectorized!(match self.metric {
            Metric::Euclidean => fill::<false, true>(x, blocks, out),
            Metric::SqEuclidean => fill::<false, false>(x, blocks, out),
            Metric::CityBlock => fill::<true, false>(x, blocks, out),
        });
    }

    fn by_columns(&self) -> Vec<f64> {
        let turned = Self::assemble(self.y.clone(), self.x.clone(), self.dim, self.metric, self.shift, self.bound);
        let mut costs = vec![0.0; self.rows() * self.cols()];
        for (col, out) in costs.chunks_exact_mut(self.rows()).enumerate() {
            turned.fill_row(col, out);
        }
        costs
    }

    fn subset(&self, rows: &[usize], cols: &[usize]) -> Box<dyn Cost + '_> {
        let x = rows.iter().flat_map(|&i| self.row(i)).copied().collect();
        let y = cols.iter().flat_map(|&j| self.col(j)).copied().collect();
        Box::new(Self::assemble(x, y, self.dim, self.metric, self.shift, self.bound))
    }

    fn nearest(
        &self,
        rows: bool,
        points: &[usize],
        among: &[usize],
        watch: &mut Watch<'_>,
    ) -> Result<Option<Vec<u32>>, OtError> {
        let side = if rows { &self.x } else { &self.y };
        let pick = |places: &[usize]| -> Vec<f64> {
            places.iter().flat_map(|&i| &side[i * self.dim..(i + 1) * self.dim]).copied().collect()
        };
        let pairs = Self::assemble(pick(points), pick(among), self.dim, Metric::SqEuclidean, self.shift, self.bound);
        let (mut row, zeros) = (vec![0.0; among.len()], vec![0.0; among.len()]);
        let (mut nearest, mut near, mut any) = (Vec::with_capacity(points.len()), 0.0, 0.0);
        for some in blocks(points.len(), rows_between_questions(among.len())) {
            watch.ask()?;
            for i in some {
                pairs.fill_row(i, &mut row);
                let (least, place) = run(LeastSum(&row, &zeros));
                nearest.push(place as u32);
                near += least;
                any += row[i % row.len()];
            }
        }
        Ok((near <= NEAR * any).then_some(nearest))
    }

    fn groups(&self, rows: bool) -> Option<Groups> {
        Groups::of_points(if rows { &self.x } else { &self.y }, self.dim)
    }

    fn bound(&self) -> f64 {
        self.bound
    }

    fn floor(&self) -> f64 {
        0.0
    }

    fn resolution(&self) -> f64 {
        if self.blurred { BLURRED } else { 0.0 }
    }

    fn unscale(&self, row: usize, col: usize, scaled: f64) -> f64 {
        if scaled > SAFE_COST && self.exponent().abs() < SAFE_EXPONENT {
            return times_power_of_two(scaled, self.exponent());
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_that_all_points_share_are_left_out() {
        let points =
            Points::new(&[1e300, 3.0, 7.0, 1e300, 3.0, 9.0], &[1e300, 3.0, 4.0], 3, Metric::Euclidean).unwrap();
        assert_eq!((points.dim(), points.unscaled(0, 0), points.unscaled(1, 0)), (1, 3.0, 5.0));
        let same = Points::new(&[2.0, 5.0], &[2.0, 5.0, 2.0, 5.0], 2, Metric::Euclidean).unwrap();
        assert_eq!((same.dim(), same.rows(), same.cols(), same.unscaled(0, 1)), (1, 1, 2, 0.0));
    }

    #[test]
    fn the_least_width_is_a_width() {
        for (low, high) in [(0.0, 5e-324), (-5e-324, 5e-324), (1e-310, 3e-310), (0.0, 1.7e308), (-1.7e308, 1.7e308)] {
            let points = Points::new(&[low], &[high], 1, Metric::Euclidean).unwrap();
            assert!((0.25..=1.0).contains(&points.at(0, 0)) && points.at(0, 0) <= points.bound());
            assert_eq!(points.unscaled(0, 0), high - low);
        }
    }
}
