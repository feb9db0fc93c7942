//! Equal numbers of equal masses, full table: shortest augmenting paths with whole rows relaxed at once.
//!
//! Reference: R. Jonker and A. Volgenant, A shortest augmenting path algorithm for dense and sparse linear assignment
//! problems, Computing 38, 1987.

use crate::error::OtError;
use crate::network_simplex::Table;
use crate::simd::{ColumnBest, Improve, Relax, TwoLeastSums, run};
use crate::watch::Watch;

/// "Nobody".
pub const FREE: u32 = u32::MAX;

/// An optimal assignment and its potentials.
#[derive(Clone, Debug)]
pub struct Assignment {
    /// Column of each row.
    pub col_of: Vec<u32>,
    /// Potentials of the rows.
    pub u: Vec<f64>,
    /// Potentials of the columns.
    pub v: Vec<f64>,
}

/// Solves the assignment problem of a square table, from good potentials of the columns where there are some.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(table: Table<'_>, minus_v: Option<Vec<f64>>, watch: &mut Watch<'_>) -> Result<Assignment, OtError> {
    let n = table.cols;
    watch.ask()?;
    let mut state = State::new(n);
    match minus_v {
        Some(minus_v) => state.minus_v = minus_v,
        None => state.column_minima(table),
    }
    state.compete(table);
    let free: Vec<usize> = (0..n).filter(|&i| state.col_of[i] == FREE).collect();
    let mut path = Path::new(n);
    for row in free {
        state.augment(table, row, &mut path, watch)?;
    }
    let u = (0..n).map(|i| table.costs[i * n + state.col_of[i] as usize] + state.minus_v[state.col_of[i] as usize]);
    Ok(Assignment { u: u.collect(), v: state.minus_v.iter().map(|v| -v).collect(), col_of: state.col_of })
}

struct State {
    n: usize,
    col_of: Vec<u32>,
    row_of: Vec<u32>,
    minus_v: Vec<f64>,
}

/// Distances along the search for one augmenting path.
struct Path {
    /// Distance of each column; infinite once it is settled.
    open: Vec<f64>,
    /// Row before each column, as a float so that its update vectorises.
    before: Vec<f64>,
    settled: Vec<(u32, f64)>,
}

impl Path {
    fn new(n: usize) -> Self {
        Self { open: vec![0.0; n], before: vec![0.0; n], settled: Vec::with_capacity(n) }
    }
}

impl State {
    fn new(n: usize) -> Self {
        Self { n, col_of: vec![FREE; n], row_of: vec![FREE; n], minus_v: vec![f64::NEG_INFINITY; n] }
    }

    /// Potentials of the columns: the least cost; each such row takes the first such column.
    fn column_minima(&mut self, table: Table<'_>) {
        let mut best = ColumnBest::new(self.n);
        for (row, costs) in table.costs.chunks_exact(self.n).enumerate() {
            run(Improve { best: &mut best, reduced: costs, costs, low: 0.0, row: row as f64 });
        }
        for j in (0..self.n).rev() {
            self.minus_v[j] = -best.cost[j];
            let i = best.row[j] as usize;
            if self.col_of[i] == FREE {
                self.col_of[i] = j as u32;
                self.row_of[j] = i as u32;
            }
        }
    }

    /// Free rows bid for their best column, by what it is worth to them above the second best.
    fn compete(&mut self, table: Table<'_>) {
        let mut queue: Vec<u32> = (0..self.n as u32).rev().filter(|&i| self.col_of[i as usize] == FREE).collect();
        let mut later = Vec::new();
        let mut bids_left = BIDS_A_ROW * self.n;
        for _ in 0..BID_ROUNDS {
            while let Some(i) = queue.pop() {
                let costs = &table.costs[i as usize * self.n..(i as usize + 1) * self.n];
                let (least, second, best) = run(TwoLeastSums(costs, &self.minus_v));
                let (raise, owner) = (second - least, self.row_of[best]);
                if raise > 0.0 && raise.is_finite() {
                    self.minus_v[best] += raise;
                } else if owner != FREE {
                    later.push(i);
                    continue;
                }
                self.row_of[best] = i;
                self.col_of[i as usize] = best as u32;
                if owner != FREE {
                    self.col_of[owner as usize] = FREE;
                    if bids_left > 0 && raise > 0.0 {
                        bids_left -= 1;
                        queue.push(owner);
                    } else {
                        later.push(owner);
                    }
                }
            }
            later.reverse();
            std::mem::swap(&mut queue, &mut later);
        }
    }

    /// Finds the shortest path from a free row to a free column, and turns the assignment round along it.
    fn augment(
        &mut self,
        table: Table<'_>,
        start: usize,
        path: &mut Path,
        watch: &mut Watch<'_>,
    ) -> Result<(), OtError> {
        let n = self.n;
        path.settled.clear();
        path.open.fill(f64::MAX);
        let (mut row, mut offset) = (start, 0.0);
        let (end, length) = loop {
            watch.step()?;
            let costs = &table.costs[row * n..(row + 1) * n];
            let (distance, j) = run(Relax {
                a: costs,
                b: &self.minus_v,
                offset,
                row: row as f64,
                distance: &mut path.open,
                origin: &mut path.before,
            });
            if self.row_of[j] == FREE {
                break (j, distance);
            }
            path.open[j] = f64::INFINITY;
            path.settled.push((j as u32, distance));
            row = self.row_of[j] as usize;
            // Distances count from the reduced cost of the row's own column, which is tight.
            offset = distance - (table.costs[row * n + j] + self.minus_v[j]);
        };
        for &(j, distance) in &path.settled {
            self.minus_v[j as usize] += length - distance;
        }
        let mut j = end;
        loop {
            let i = path.before[j] as usize;
            let next = self.col_of[i];
            self.row_of[j] = i as u32;
            self.col_of[i] = j as u32;
            if i == start {
                return Ok(());
            }
            j = next as usize;
        }
    }
}

const BID_ROUNDS: usize = 2;
const BIDS_A_ROW: usize = 4;
