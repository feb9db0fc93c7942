//! Many rows against few columns: mass moves along shortest paths between the columns.
//!
//! Every row first goes to its best column, by potentials that nearly balance the columns. Columns with too much then send mass to
//! columns with too little; a step from column `j` to `k` moves the row that loses least by it. There are only as many
//! nodes as columns.
//!
//! Of the paths of one length, the one of fewest steps is taken (Edmonds and Karp): otherwise two ways that cost the
//! same could hand the last quantum of a split row back and forth until all the mass has gone that way.

use crate::coarse::{balanced, sample};
use crate::error::OtError;
use crate::forest::remove_cycles;
use crate::simd::vectorized;
use crate::watch::Watch;

use balance::Start;
use movers::Movers;
use places::Places;

mod balance;
mod movers;
mod places;

/// A reduced cost below this share of the numbers that it is made of is rounding: the step is free. Potentials stay
/// feasible to this share, because a free step leaves them as they are.
const ROUNDING: f64 = 8.0 * f64::EPSILON;
/// Paths for each row and column before giving up; less than one is usual.
pub const PATHS_A_NODE: usize = 8;
/// The potentials to start from are those of one row in so many.
const SHARE: usize = 8;
/// Rows up to which the start is zero.
const COLD_ROWS: usize = 64;

/// A table of costs, column by column.
#[derive(Clone, Copy, Debug)]
pub struct Columns<'a> {
    /// The costs.
    pub costs: &'a [f64],
    /// Number of rows.
    pub rows: usize,
}

impl Columns<'_> {
    #[inline]
    fn at(&self, row: usize, col: usize) -> f64 {
        self.costs[col * self.rows + row]
    }
}

/// An optimal plan and its potentials.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// `(row, column, mass)`, row by row.
    pub arcs: Vec<(usize, usize, i64)>,
    /// Potentials of the rows, feasible for every pair.
    pub u: Vec<f64>,
    /// Potentials of the columns.
    pub v: Vec<f64>,
}

/// Solves a table with few columns; `None` when more than `paths_a_node` paths for each row and column do not suffice:
/// mass that goes in small steps only, as it may where many ways cost the same.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(
    table: Columns<'_>,
    rows: &[i64],
    cols: &[i64],
    paths_a_node: usize,
    watch: &mut Watch<'_>,
) -> Result<Option<Optimum>, OtError> {
    let start = start(table, rows, cols, paths_a_node, watch)?;
    let Some((mut places, v)) = search(table, rows, start, paths_a_node, watch)? else {
        return Ok(None);
    };
    remove_cycles(places.splits_mut(), cols.len());
    let mut u = vec![f64::INFINITY; rows.len()];
    for (costs, &v) in table.costs.chunks_exact(table.rows).zip(&v) {
        vectorized!(crate::simd::lower_to_difference(&mut u, costs, v));
    }
    Ok(Some(Optimum { arcs: places.arcs(), u, v }))
}

/// Where the rows go in an optimal plan, and the potentials of the columns.
fn search<'a>(
    table: Columns<'_>,
    rows: &'a [i64],
    start: Start,
    paths_a_node: usize,
    watch: &mut Watch<'_>,
) -> Result<Option<(Places<'a>, Vec<f64>)>, OtError> {
    watch.ask()?;
    let m = start.v.len();
    let mut search = Search::new(table, rows, start);
    let mut paths = Paths::new(m);
    let mut paths_left = paths_a_node * (rows.len() + m);
    while search.improve(&mut paths) {
        watch.step()?;
        if paths_left == 0 {
            return Ok(None);
        }
        paths_left -= 1;
    }
    Ok(Some((search.places, search.v)))
}

/// Potentials that nearly balance the columns, from those of a part of the rows.
fn start(
    table: Columns<'_>,
    rows: &[i64],
    cols: &[i64],
    paths_a_node: usize,
    watch: &mut Watch<'_>,
) -> Result<Start, OtError> {
    if rows.len() <= COLD_ROWS {
        return Ok(balance::start(table, rows, cols, vec![0.0; cols.len()]));
    }
    let some = sample(rows.len(), SHARE);
    let columns = table.costs.chunks_exact(table.rows);
    let costs: Vec<f64> = columns.flat_map(|column| some.iter().map(|&i| column[i])).collect();
    let (some_rows, some_cols) = balanced(some.iter().map(|&i| rows[i]).collect(), cols.to_vec());
    let part = Columns { costs: &costs, rows: some.len() };
    let coarse = start(part, &some_rows, &some_cols, paths_a_node, watch)?;
    let v = if coarse.serves_finer(&some_rows) {
        coarse.v
    } else {
        let v = coarse.v.clone();
        search(part, &some_rows, coarse, paths_a_node, watch)?.map_or(v, |found| found.1)
    };
    Ok(balance::start(table, rows, cols, v))
}

/// Shortest ways from the columns with too much.
struct Paths {
    distance: Vec<f64>,
    steps: Vec<usize>,
    before: Vec<usize>,
    settled: Vec<bool>,
    /// The row that takes the last step; [`NOBODY`] while the distance is a lower bound.
    mover: Vec<u32>,
}

const NOWHERE: usize = usize::MAX;
/// "No row".
const NOBODY: u32 = u32::MAX;

impl Paths {
    fn new(m: usize) -> Self {
        Self {
            distance: vec![0.0; m],
            steps: vec![0; m],
            before: vec![0; m],
            settled: vec![false; m],
            mover: vec![0; m],
        }
    }

    fn start(&mut self, excess: &[i64]) {
        for (distance, &excess) in self.distance.iter_mut().zip(excess) {
            *distance = if excess > 0 { 0.0 } else { f64::INFINITY };
        }
        self.steps.fill(0);
        self.before.fill(NOWHERE);
        self.settled.fill(false);
    }

    /// The open column that is reached most cheaply, in fewest steps.
    fn nearest(&self) -> Option<usize> {
        let open = (0..self.distance.len()).filter(|&j| !self.settled[j] && self.distance[j] < f64::INFINITY);
        let key = |j: usize| (self.distance[j], self.steps[j]);
        open.reduce(|a, b| if key(b) < key(a) { b } else { a })
    }

    /// Takes a step from `j` to `k` where it is a shorter way.
    #[inline]
    fn relax(&mut self, j: usize, k: usize, (length, row): (f64, u32)) {
        let (length, steps) = (self.distance[j] + length, self.steps[j] + 1);
        if (length, steps) < (self.distance[k], self.steps[k]) {
            (self.distance[k], self.steps[k]) = (length, steps);
            (self.before[k], self.mover[k]) = (j, row);
        }
    }
}

/// The state of the search.
struct Search<'t, 'a> {
    table: Columns<'t>,
    places: Places<'a>,
    excess: Vec<i64>,
    v: Vec<f64>,
    movers: Movers,
}

impl<'t, 'a> Search<'t, 'a> {
    fn new(table: Columns<'t>, rows: &'a [i64], start: Start) -> Self {
        let Start { v, choice, excess } = start;
        let movers = Movers::new(table, &choice, &v);
        Self { table, places: Places::new(rows, v.len(), choice.best), excess, v, movers }
    }
}

impl Search<'_, '_> {
    /// Sends mass along one shortest path; false when no column has too much.
    fn improve(&mut self, paths: &mut Paths) -> bool {
        let m = self.v.len();
        paths.start(&self.excess);
        let target = loop {
            let Some(j) = paths.nearest() else {
                return false;
            };
            if paths.mover[j] == NOBODY && paths.before[j] != NOWHERE {
                self.refine(j, paths);
                continue;
            }
            if self.excess[j] < 0 {
                break j;
            }
            paths.settled[j] = true;
            for k in 0..m {
                if !paths.settled[k] {
                    paths.relax(j, k, self.step_length(j, k));
                }
            }
        };
        let length = paths.distance[target];
        for j in 0..m {
            self.v[j] += paths.distance[j].min(length);
        }
        self.send(target, paths);
        true
    }

    /// Finds the row of the last step to a column whose distance is a lower bound, and the distance again.
    fn refine(&mut self, k: usize, paths: &mut Paths) {
        self.movers.extend(paths.before[k] * self.v.len() + k, self.table, &self.places);
        paths.distance[k] = f64::INFINITY;
        paths.before[k] = NOWHERE;
        for j in 0..self.v.len() {
            if paths.settled[j] {
                paths.relax(j, k, self.step_length(j, k));
            }
        }
    }

    /// Reduced cost of the step from column `j` to `k`, and the row that loses least by it; [`NOBODY`] and a lower bound
    /// where that row is not known yet.
    #[inline]
    fn step_length(&self, j: usize, k: usize) -> (f64, u32) {
        let step = self.movers.step(j * self.v.len() + k);
        let (from, to) = (self.v[j], self.v[k]);
        let reduced = step.loss + (from - to);
        let rounding = ROUNDING * (step.size + from.abs() + to.abs());
        (if reduced > rounding { reduced } else { 0.0 }, step.row)
    }

    /// Moves as much as the path to `target` allows.
    fn send(&mut self, target: usize, paths: &Paths) {
        let mut amount = -self.excess[target];
        let mut k = target;
        while paths.before[k] != NOWHERE {
            let j = paths.before[k];
            amount = amount.min(self.places.flow(paths.mover[k], j));
            k = j;
        }
        amount = amount.min(self.excess[k]);
        self.excess[k] -= amount;
        self.excess[target] += amount;
        k = target;
        while paths.before[k] != NOWHERE {
            let (j, row) = (paths.before[k], paths.mover[k]);
            let arrives = self.places.flow(row, k) == 0;
            self.places.shift(row, j, k, amount);
            if self.places.flow(row, j) == 0 {
                self.movers.leave(row, j, self.table, &self.places);
            }
            if arrives {
                self.movers.arrive(row, k, self.table);
            }
            k = j;
        }
    }
}

#[cfg(test)]
mod tests;
