//! Many rows against few columns: mass moves along shortest paths between the columns.
//!
//! Every row first goes to its best column. Columns with too much then send mass to columns with too little; a step
//! from column `j` to `k` moves the row that loses least by it. There are only as many nodes as columns.
//!
//! Of the paths of one length, the one of fewest steps is taken (Edmonds and Karp): otherwise two ways that cost the
//! same could hand the last quantum of a split row back and forth until all the mass has gone that way.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::error::OtError;
use crate::forest::remove_cycles;
use crate::network_simplex::Table;
use crate::watch::Watch;

/// A reduced cost below this share of the numbers that it is made of is rounding: the step is free. Potentials stay
/// feasible to this share, because a free step leaves them as they are.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

/// Rows by what they lose when they change from one column to another; the loss is stored as ordered bits.
type Movers = BinaryHeap<Reverse<(u64, u32)>>;

/// The row that loses least by a change from one column to another.
#[derive(Clone, Copy)]
struct Step {
    /// What it loses, before potentials; infinite without a row.
    loss: f64,
    /// Size of the two costs.
    size: f64,
    row: u32,
}

const NO_STEP: Step = Step { loss: f64::INFINITY, size: 0.0, row: u32::MAX };

/// The state of the search.
struct Search<'a> {
    table: Table<'a>,
    flow: Vec<i64>,
    excess: Vec<i64>,
    v: Vec<f64>,
    movers: Vec<Movers>,
    /// The best mover of each pair of columns.
    steps: Vec<Step>,
}

/// An optimal plan and the potentials of the columns.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// Flow of every pair, row by row.
    pub flow: Vec<i64>,
    /// Potentials of the columns.
    pub v: Vec<f64>,
}

/// Paths for each row and column before giving up; less than one is usual.
const PATHS_A_NODE: usize = 8;

/// Solves a table with few columns, from potentials `v` of the columns; `None` when mass goes in small steps only, as it
/// may where many ways cost the same.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(
    table: Table<'_>,
    rows: &[i64],
    cols: &[i64],
    v: Vec<f64>,
    watch: &mut Watch<'_>,
) -> Result<Option<Optimum>, OtError> {
    watch.ask()?;
    let m = table.cols;
    let mut flow = vec![0; table.costs.len()];
    let mut excess: Vec<i64> = cols.iter().map(|b| -b).collect();
    let least =
        |costs: &[f64]| (1..m).fold(0, |best, j| if costs[j] - v[j] < costs[best] - v[best] { j } else { best });
    let best: Vec<usize> = table.costs.chunks_exact(m).map(least).collect();
    let mut counts = vec![0; m];
    best.iter().for_each(|&j| counts[j] += 1);
    let mut losses: Vec<Vec<Reverse<(u64, u32)>>> =
        (0..m * m).map(|pair| Vec::with_capacity(counts[pair / m])).collect();
    for ((i, costs), &best) in table.costs.chunks_exact(m).enumerate().zip(&best) {
        flow[i * m + best] = rows[i];
        excess[best] += rows[i];
        for (k, (losses, cost)) in losses[best * m..(best + 1) * m].iter_mut().zip(costs).enumerate() {
            if k != best {
                losses.push(Reverse((ordered(cost - costs[best]), i as u32)));
            }
        }
    }
    let movers = losses.into_iter().map(BinaryHeap::from).collect();
    let mut search = Search { table, flow, excess, v, movers, steps: vec![NO_STEP; m * m] };
    (0..m * m).for_each(|pair| search.find_step(pair));
    let mut paths = Paths::new(m);
    let mut paths_left = PATHS_A_NODE * (rows.len() + m);
    while search.improve(&mut paths) {
        watch.step()?;
        paths_left -= 1;
        if paths_left == 0 {
            return Ok(None);
        }
    }
    remove_cycles(&mut search.flow, m);
    Ok(Some(Optimum { flow: search.flow, v: search.v }))
}

/// Bits that sort as the numbers do.
fn ordered(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

/// Shortest ways from the columns with too much.
struct Paths {
    distance: Vec<f64>,
    steps: Vec<usize>,
    before: Vec<usize>,
    settled: Vec<bool>,
    mover: Vec<u32>,
}

impl Paths {
    /// The open column that is reached most cheaply, in fewest steps.
    fn nearest(&self) -> Option<usize> {
        let open = (0..self.distance.len()).filter(|&j| !self.settled[j] && self.distance[j] < f64::INFINITY);
        let key = |j: usize| (self.distance[j], self.steps[j]);
        open.reduce(|a, b| if key(b) < key(a) { b } else { a })
    }

    fn new(m: usize) -> Self {
        Self {
            distance: vec![0.0; m],
            steps: vec![0; m],
            before: vec![0; m],
            settled: vec![false; m],
            mover: vec![0; m],
        }
    }
}

const NOWHERE: usize = usize::MAX;

impl Search<'_> {
    /// Sends mass along one shortest path; false when no column has too much.
    fn improve(&mut self, paths: &mut Paths) -> bool {
        let m = self.table.cols;
        for j in 0..m {
            paths.distance[j] = if self.excess[j] > 0 { 0.0 } else { f64::INFINITY };
            paths.steps[j] = 0;
            paths.before[j] = NOWHERE;
            paths.settled[j] = false;
        }
        let target = loop {
            let Some(j) = paths.nearest() else {
                return false;
            };
            if self.excess[j] < 0 {
                break j;
            }
            paths.settled[j] = true;
            for k in 0..m {
                if !paths.settled[k]
                    && let Some((length, row)) = self.step_length(j, k)
                {
                    let (length, steps) = (paths.distance[j] + length, paths.steps[j] + 1);
                    if (length, steps) < (paths.distance[k], paths.steps[k]) {
                        (paths.distance[k], paths.steps[k]) = (length, steps);
                        (paths.before[k], paths.mover[k]) = (j, row);
                    }
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

    /// Reduced cost of the step from column `j` to `k`, by the row that loses least by it.
    fn step_length(&self, j: usize, k: usize) -> Option<(f64, u32)> {
        let step = self.steps[j * self.table.cols + k];
        if step.row == u32::MAX {
            return None;
        }
        let (from, to) = (self.v[j], self.v[k]);
        let reduced = step.loss + (from - to);
        let rounding = ROUNDING * (step.size + from.abs() + to.abs());
        Some((if reduced > rounding { reduced } else { 0.0 }, step.row))
    }

    /// Finds the best mover of a pair of columns again.
    fn find_step(&mut self, pair: usize) {
        let m = self.table.cols;
        let (j, k) = (pair / m, pair % m);
        self.steps[pair] = NO_STEP;
        while let Some(&Reverse((_, row))) = self.movers[pair].peek() {
            let place = row as usize * m;
            if self.flow[place + j] > 0 {
                let (from, to) = (self.table.costs[place + j], self.table.costs[place + k]);
                self.steps[pair] = Step { loss: to - from, size: from.abs() + to.abs(), row };
                return;
            }
            self.movers[pair].pop();
        }
    }

    /// Moves as much as the path to `target` allows.
    fn send(&mut self, target: usize, paths: &Paths) {
        let m = self.table.cols;
        let mut amount = -self.excess[target];
        let mut k = target;
        while paths.before[k] != NOWHERE {
            let j = paths.before[k];
            amount = amount.min(self.flow[paths.mover[k] as usize * m + j]);
            k = j;
        }
        amount = amount.min(self.excess[k]);
        self.excess[k] -= amount;
        self.excess[target] += amount;
        k = target;
        while paths.before[k] != NOWHERE {
            let (j, row) = (paths.before[k], paths.mover[k] as usize);
            self.flow[row * m + j] -= amount;
            if self.flow[row * m + j] == 0 {
                for pair in j * m..(j + 1) * m {
                    if self.steps[pair].row == row as u32 {
                        self.find_step(pair);
                    }
                }
            }
            if self.flow[row * m + k] == 0 {
                self.arrive(row, k);
            }
            self.flow[row * m + k] += amount;
            k = j;
        }
    }

    /// Lets a row that now has mass in column `j` move on from there.
    fn arrive(&mut self, row: usize, j: usize) {
        let m = self.table.cols;
        let costs = &self.table.costs[row * m..(row + 1) * m];
        for k in (0..m).filter(|&k| k != j) {
            let loss = costs[k] - costs[j];
            self.movers[j * m + k].push(Reverse((ordered(loss), row as u32)));
            let step = &mut self.steps[j * m + k];
            if loss < step.loss || (loss == step.loss && (row as u32) < step.row) {
                *step = Step { loss, size: costs[j].abs() + costs[k].abs(), row: row as u32 };
            }
        }
    }
}
