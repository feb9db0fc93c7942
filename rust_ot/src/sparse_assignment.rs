//! Equal numbers of equal masses over short lists of arcs: shortest augmenting paths that touch few nodes.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::assignment::{Assignment, FREE};
use crate::cost::Cost;
use crate::error::OtError;
use crate::network_simplex::Tolerance;
use crate::scan::{self, Pass, Workers};
use crate::watch::Watch;

/// Arcs of least reduced cost that each row starts with, and missing arcs that a pass may add to a row.
const SHORTLIST: usize = 24;
const ADDED: usize = 10;
/// Passes over all pairs before giving up; a handful is usual.
const MAX_PASSES: usize = 30;

/// Optimal assignment for a square cost, from good potentials of the columns; `None` when this way leads nowhere.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(
    cost: &dyn Cost,
    minus_v: &[f64],
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Option<Assignment>, OtError> {
    let pass = scan::shortlist(cost, minus_v, SHORTLIST, workers, watch)?;
    let mut arcs = columns_and_costs(&pass);
    for (col, &(row, c)) in pass.col_best.iter().enumerate() {
        let listed = &mut arcs[row as usize];
        if !listed.iter().any(|arc| arc.0 as usize == col) {
            listed.push((col as u32, c));
        }
    }
    let mut matcher = Matcher::new(minus_v.iter().map(|v| -v).collect(), pass.typical_reach());
    for _ in 0..MAX_PASSES {
        matcher.add(&arcs);
        let all = matcher.complete(watch)?;
        if !all {
            matcher.push *= 2.0;
        }
        matcher.refresh();
        let (u, minus_v) = (&matcher.state.u, matcher.state.v.iter().map(|v| -v).collect::<Vec<f64>>());
        let tolerance = Tolerance::of_potentials(u.iter().chain(&minus_v));
        let negative = |reduced, row: usize, col: usize, c| tolerance.is_negative(reduced, c, u[row], minus_v[col]);
        let pass = scan::violated(cost, u, &minus_v, ADDED, negative, workers, watch)?;
        arcs = columns_and_costs(&pass);
        if all && arcs.iter().all(Vec::is_empty) {
            for (u, low) in matcher.state.u.iter_mut().zip(&pass.row_minimum) {
                *u = u.min(*low);
            }
            return Ok(Some(matcher.state));
        }
    }
    Ok(None)
}

fn columns_and_costs(pass: &Pass) -> Vec<Vec<(u32, f64)>> {
    pass.arcs.iter().map(|found| found.iter().map(|&(_, col, c)| (col, c)).collect()).collect()
}

/// An assignment under construction; `u` and `v` never exceed the cost of a listed arc.
#[derive(Clone, Debug)]
struct Matcher {
    starts: Vec<usize>,
    heads: Vec<u32>,
    costs: Vec<f64>,
    row_of: Vec<u32>,
    state: Assignment,
    distance: Vec<f64>,
    before: Vec<u32>,
    reached: Vec<u32>,
    settled: Vec<u32>,
    tight: Vec<u32>,
    heap: BinaryHeap<Reverse<(u64, u32)>>,
    push: f64,
}

impl Matcher {
    /// Nothing assigned yet; `v` are potentials of the columns, `push` is of the size of a reduced cost.
    fn new(v: Vec<f64>, push: f64) -> Self {
        let n = v.len();
        Self {
            starts: vec![0; n + 1],
            heads: Vec::new(),
            costs: Vec::new(),
            row_of: vec![FREE; n],
            state: Assignment { col_of: vec![FREE; n], u: vec![0.0; n], v },
            distance: vec![f64::INFINITY; n],
            before: vec![0; n],
            reached: Vec::new(),
            settled: Vec::new(),
            tight: Vec::new(),
            heap: BinaryHeap::new(),
            push,
        }
    }

    /// Adds arcs `(column, cost)` to the rows, and frees the rows whose column is no longer their best.
    fn add(&mut self, new: &[Vec<(u32, f64)>]) {
        let n = self.row_of.len();
        let total = self.heads.len() + new.iter().map(Vec::len).sum::<usize>();
        let (mut heads, mut costs) = (Vec::with_capacity(total), Vec::with_capacity(total));
        let mut starts = Vec::with_capacity(n + 1);
        for (row, new) in new.iter().enumerate() {
            starts.push(heads.len());
            let old = self.starts[row]..self.starts[row + 1];
            heads.extend_from_slice(&self.heads[old.clone()]);
            costs.extend_from_slice(&self.costs[old]);
            heads.extend(new.iter().map(|arc| arc.0));
            costs.extend(new.iter().map(|arc| arc.1));
        }
        starts.push(heads.len());
        (self.starts, self.heads, self.costs) = (starts, heads, costs);
        for row in (0..n).filter(|&row| !new[row].is_empty()) {
            let col = self.state.col_of[row];
            let (mut least, mut own) = (f64::INFINITY, f64::INFINITY);
            for (j, c) in self.row_arcs(row) {
                let value = c - self.state.v[j];
                least = least.min(value);
                own = if j == col as usize { value } else { own };
            }
            if col != FREE && least < own {
                self.state.col_of[row] = FREE;
                self.row_of[col as usize] = FREE;
            }
            self.state.u[row] = least;
        }
    }

    /// Computes the potentials of the assigned rows again from their columns, which removes drift.
    fn refresh(&mut self) {
        for row in 0..self.row_of.len() {
            let col = self.state.col_of[row] as usize;
            let own = self.row_arcs(row).find(|&(j, _)| j == col);
            if let Some((_, c)) = own {
                self.state.u[row] = c - self.state.v[col];
            }
        }
    }

    fn row_arcs(&self, row: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[row]..self.starts[row + 1];
        self.heads[range.clone()].iter().map(|&j| j as usize).zip(self.costs[range].iter().copied())
    }

    /// Assigns the rows as far as the listed arcs allow it, and tells whether that is all of them.
    ///
    /// Rows whose arcs all lead to columns that others need more get potentials that ask for further arcs.
    fn complete(&mut self, watch: &mut Watch<'_>) -> Result<bool, OtError> {
        self.compete();
        let mut all = true;
        for row in 0..self.row_of.len() {
            if self.state.col_of[row] == FREE && !self.augment(row, watch)? {
                all = false;
            }
        }
        Ok(all)
    }

    /// Free rows bid for their best column, by what it is worth to them above the second best.
    fn compete(&mut self) {
        let n = self.row_of.len();
        let mut queue: Vec<u32> = (0..n as u32).rev().filter(|&i| self.state.col_of[i as usize] == FREE).collect();
        let mut bids_left = 2 * queue.len();
        while let Some(i) = queue.pop() {
            let (mut least, mut second, mut best) = (f64::INFINITY, f64::INFINITY, 0);
            for (j, c) in self.row_arcs(i as usize) {
                let value = c - self.state.v[j];
                if value < least {
                    (second, least, best) = (least, value, j);
                } else if value < second {
                    second = value;
                }
            }
            let owner = self.row_of[best];
            let raise = second - least;
            self.state.u[i as usize] = least;
            if raise > 0.0 && raise.is_finite() {
                if owner != FREE && bids_left == 0 {
                    continue;
                }
                self.state.v[best] -= raise;
                self.state.u[i as usize] = second;
            } else if owner != FREE {
                continue;
            }
            self.row_of[best] = i;
            self.state.col_of[i as usize] = best as u32;
            if owner != FREE {
                self.state.col_of[owner as usize] = FREE;
                bids_left -= 1;
                queue.push(owner);
            }
        }
    }

    /// Finds the shortest path from a free row to a free column, and turns the assignment round along it.
    ///
    /// Without a path the potentials of all that was reached move by `push` instead.
    fn augment(&mut self, start: usize, watch: &mut Watch<'_>) -> Result<bool, OtError> {
        for &j in &self.reached {
            self.distance[j as usize] = f64::INFINITY;
        }
        self.reached.clear();
        self.settled.clear();
        self.heap.clear();
        self.tight.clear();
        let (mut row, mut so_far) = (start, 0.0);
        let end = loop {
            watch.step()?;
            self.relax(row, so_far);
            let Some((j, distance)) = self.nearest(so_far) else {
                self.shift_potentials(start, so_far + self.push);
                return Ok(false);
            };
            so_far = distance;
            if self.row_of[j] == FREE {
                break j;
            }
            self.settled.push(j as u32);
            row = self.row_of[j] as usize;
        };
        self.shift_potentials(start, so_far);
        let mut j = end;
        loop {
            let i = self.before[j] as usize;
            let next = self.state.col_of[i];
            self.row_of[j] = i as u32;
            self.state.col_of[i] = j as u32;
            if i == start {
                return Ok(true);
            }
            j = next as usize;
        }
    }

    /// Makes the way to all columns at less than `length` tight.
    fn shift_potentials(&mut self, start: usize, length: f64) {
        for &j in &self.settled {
            let gain = length - self.distance[j as usize];
            self.state.v[j as usize] -= gain;
            self.state.u[self.row_of[j as usize] as usize] += gain;
        }
        self.state.u[start] += length;
    }

    /// Lowers the distances of the columns that a row reaches.
    fn relax(&mut self, row: usize, so_far: f64) {
        let range = self.starts[row]..self.starts[row + 1];
        let base = so_far - self.state.u[row];
        for (&head, &cost) in self.heads[range.clone()].iter().zip(&self.costs[range]) {
            let j = head as usize;
            let new = (base + (cost - self.state.v[j])).max(so_far);
            let old = self.distance[j];
            if new < old {
                if old == f64::INFINITY {
                    self.reached.push(head);
                }
                self.distance[j] = new;
                self.before[j] = row as u32;
                if new <= so_far {
                    self.tight.push(head);
                } else {
                    self.heap.push(Reverse((new.to_bits(), head)));
                }
            }
        }
    }

    /// Takes the nearest column that is not settled, and its distance; distances are not negative.
    fn nearest(&mut self, so_far: f64) -> Option<(usize, f64)> {
        if let Some(j) = self.tight.pop() {
            return Some((j as usize, so_far));
        }
        while let Some(Reverse((bits, j))) = self.heap.pop() {
            let distance = f64::from_bits(bits);
            // An entry is out of date when a shorter way was found after it.
            if distance <= self.distance[j as usize] {
                return Some((j as usize, distance));
            }
        }
        None
    }
}
