//! The row that loses least by a move from one column to another, for every pair of columns.
//!
//! Only rows near the border of two columns are listed, in a heap; all others are known to lose at least a bound. A
//! search that gets as far as the bound has the list extended.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use pulp::{Simd, WithSimd};

use super::places::Places;
use super::{Columns, NOBODY};
use crate::simd::{lanes, run};

/// Rows by what they lose; the loss is stored as ordered bits.
type List = BinaryHeap<Reverse<(u64, u32)>>;

/// One row in so many is near a border.
const NEAR_SHARE: usize = 8;
/// Rows whose distance from the border tells that of all.
const SAMPLE: usize = 128;
/// Rows that an extended list gains at least.
const MORE: usize = 16;

/// The best column of every row.
pub struct Choice {
    /// The column.
    pub best: Vec<u32>,
    /// Its `cost - v`, and that of the second best.
    pub least: Vec<f64>,
    pub second: Vec<f64>,
    /// The second best column.
    pub next: Vec<u32>,
}

/// The column of least `cost - v` for every row, the first of equals, and the second best.
pub fn choose(table: Columns<'_>, v: &[f64]) -> Choice {
    let n = table.rows;
    let mut choice =
        Choice { best: vec![0; n], next: vec![0; n], least: vec![f64::INFINITY; n], second: vec![f64::INFINITY; n] };
    run(Choose { table, v, choice: &mut choice });
    choice
}

/// Fills a choice, with as many rows side by side as a vector has lanes.
struct Choose<'a> {
    table: Columns<'a>,
    v: &'a [f64],
    choice: &'a mut Choice,
}

impl WithSimd for Choose<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { table, v, choice } = self;
        let columns: Vec<(&[S::f64s], &[f64])> = table.costs.chunks_exact(table.rows).map(S::as_simd_f64s).collect();
        let (least, _) = S::as_mut_simd_f64s(&mut choice.least);
        let (second, _) = S::as_mut_simd_f64s(&mut choice.second);
        let places = choice.best.chunks_exact_mut(S::F64_LANES).zip(choice.next.chunks_exact_mut(S::F64_LANES));
        for (k, ((least, second), (best, next))) in least.iter_mut().zip(second).zip(places).enumerate() {
            let (mut low, mut high) = (*least, *second);
            let (mut best_column, mut next_column) = (simd.splat_f64s(0.0), simd.splat_f64s(0.0));
            for (j, ((costs, _), &v)) in columns.iter().zip(v).enumerate() {
                let (value, column) = (simd.sub_f64s(costs[k], simd.splat_f64s(v)), simd.splat_f64s(j as f64));
                let (wins, places) = (simd.less_than_f64s(value, low), simd.less_than_f64s(value, high));
                high = simd.select_f64s(places, simd.select_f64s(wins, low, value), high);
                next_column = simd.select_f64s(places, simd.select_f64s(wins, best_column, column), next_column);
                low = simd.select_f64s(wins, value, low);
                best_column = simd.select_f64s(wins, column, best_column);
            }
            (*least, *second) = (low, high);
            let columns = lanes::<S>(&best_column).iter().zip(lanes::<S>(&next_column));
            for ((best, next), (&first, &second)) in best.iter_mut().zip(next).zip(columns) {
                (*best, *next) = (first as u32, second as u32);
            }
        }
        for row in table.rows / S::F64_LANES * S::F64_LANES..table.rows {
            let (mut least, mut second) = ((f64::INFINITY, 0), (f64::INFINITY, 0));
            for ((_, rest), (&v, j)) in columns.iter().zip(v.iter().zip(0u32..)) {
                let value = rest[row % S::F64_LANES] - v;
                if value < least.0 {
                    (second, least) = (least, (value, j));
                } else if value < second.0 {
                    second = (value, j);
                }
            }
            (choice.least[row], choice.best[row]) = least;
            (choice.second[row], choice.next[row]) = second;
        }
    }
}

/// The best move between two columns.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// What the row loses, before potentials; infinite where no row can move, a bound where the row is not known.
    pub loss: f64,
    /// Size of the two costs.
    pub size: f64,
    /// The row, or [`NOBODY`].
    pub row: u32,
}

/// The moves between all pairs of columns; a pair is `from * cols + to`.
pub struct Movers {
    cols: usize,
    lists: Vec<List>,
    /// Rows that are not listed lose at least so much (up to rounding).
    bounds: Vec<f64>,
    steps: Vec<Step>,
    extensions: Vec<u32>,
}

impl Movers {
    /// Lists the rows near the borders.
    pub fn new(table: Columns<'_>, choice: &Choice, v: &[f64]) -> Self {
        let m = v.len();
        let width = near(choice);
        let bounds = (0..m * m).map(|pair| width + (v[pair % m] - v[pair / m])).collect();
        let mut lists: Vec<Vec<Reverse<(u64, u32)>>> = vec![Vec::new(); m * m];
        for (i, (&least, &second)) in choice.least.iter().zip(&choice.second).enumerate() {
            if second - least < width {
                let j = choice.best[i] as usize;
                let own = table.at(i, j);
                for k in (0..m).filter(|&k| k != j) {
                    let cost = table.at(i, k);
                    if cost - v[k] - least < width {
                        lists[j * m + k].push(Reverse((ordered(cost - own), i as u32)));
                    }
                }
            }
        }
        let lists = lists.into_iter().map(BinaryHeap::from).collect();
        let none = Step { loss: f64::INFINITY, size: 0.0, row: NOBODY };
        let mut movers = Self { cols: m, lists, bounds, steps: vec![none; m * m], extensions: vec![0; m * m] };
        for pair in (0..m * m).filter(|pair| pair % m != pair / m) {
            movers.show_best(pair, table);
        }
        movers
    }

    /// The best move of a pair.
    #[inline]
    pub fn step(&self, pair: usize) -> Step {
        self.steps[pair]
    }

    /// Takes a row that has no mass left in column `j` off the moves from there.
    pub fn leave(&mut self, row: u32, j: usize, table: Columns<'_>, places: &Places<'_>) {
        let m = self.cols;
        for pair in j * m..(j + 1) * m {
            if self.steps[pair].row == row {
                self.find_best(pair, table, places);
            }
        }
    }

    /// Lets a row that now has mass in column `j` move on from there.
    pub fn arrive(&mut self, row: u32, j: usize, table: Columns<'_>) {
        let m = self.cols;
        let own = table.at(row as usize, j);
        for k in (0..m).filter(|&k| k != j) {
            let (pair, cost) = (j * m + k, table.at(row as usize, k));
            let loss = cost - own;
            if loss < self.bounds[pair] {
                self.lists[pair].push(Reverse((ordered(loss), row)));
                let step = &mut self.steps[pair];
                if (loss, row) < (step.loss, step.row) {
                    *step = Step { loss, size: cost.abs() + own.abs(), row };
                }
            }
        }
    }

    /// Lists more rows of a pair; each time four times as many.
    pub fn extend(&mut self, pair: usize, table: Columns<'_>, places: &Places<'_>) {
        let m = self.cols;
        let (j, k) = (pair / m, pair % m);
        let loss = |row: u32| ordered(table.at(row as usize, k) - table.at(row as usize, j));
        let mut losses: Vec<Reverse<(u64, u32)>> = places.rows_in(j).map(|row| Reverse((loss(row), row))).collect();
        let count = (self.lists[pair].len() + MORE) << (2 * self.extensions[pair]).min(30);
        self.extensions[pair] += 1;
        self.bounds[pair] = f64::INFINITY;
        if losses.len() > count {
            let (_, &mut Reverse((_, first_out)), _) = losses.select_nth_unstable_by_key(count, |&Reverse(key)| key);
            self.bounds[pair] = table.at(first_out as usize, k) - table.at(first_out as usize, j);
            losses.truncate(count);
        }
        self.lists[pair] = BinaryHeap::from(losses);
        self.show_best(pair, table);
    }

    /// Drops the rows that have left from the head of a list.
    fn find_best(&mut self, pair: usize, table: Columns<'_>, places: &Places<'_>) {
        let from = pair / self.cols;
        while let Some(&Reverse((_, row))) = self.lists[pair].peek() {
            if places.flow(row, from) > 0 {
                break;
            }
            self.lists[pair].pop();
        }
        self.show_best(pair, table);
    }

    /// The head of a list is the best move, as far as rows are listed.
    fn show_best(&mut self, pair: usize, table: Columns<'_>) {
        let (j, k) = (pair / self.cols, pair % self.cols);
        self.steps[pair] = match self.lists[pair].peek() {
            Some(&Reverse((_, row))) => {
                let (from, to) = (table.at(row as usize, j), table.at(row as usize, k));
                Step { loss: to - from, size: from.abs() + to.abs(), row }
            }
            None => Step { loss: self.bounds[pair], size: 0.0, row: NOBODY },
        };
    }
}

/// The distance from the border that one row in [`NEAR_SHARE`] does not exceed.
pub fn near(choice: &Choice) -> f64 {
    let stride = choice.least.len().div_ceil(SAMPLE);
    let mut gaps: Vec<f64> =
        choice.second.iter().zip(&choice.least).step_by(stride).map(|(second, least)| second - least).collect();
    let place = gaps.len() / NEAR_SHARE;
    *gaps.select_nth_unstable_by(place, f64::total_cmp).1
}

/// Bits that sort as the numbers do.
fn ordered(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}
