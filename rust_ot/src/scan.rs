//! Passes over all pairs: the cheapest arcs of every row, and the search for arcs that a solution missed.

use std::ops::Range;

use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use crate::cost::Cost;
use crate::error::{OtError, bad};
use crate::simd::{ColumnBest, Improve, Sum, run};
use crate::watch::Watch;

/// Pairs that are compared at once.
const CHUNK: usize = 64;

/// Columns between the first choices of neighbouring rows, a prime.
const TIE_STRIDE: usize = 7919;

/// A candidate arc: reduced cost, column, cost.
pub type Candidate = (f64, u32, f64);

/// What a pass over the rows found.
#[derive(Clone, Debug)]
pub struct Pass {
    /// Least `cost - v` of each row.
    pub row_minimum: Vec<f64>,
    /// Arcs of each row.
    pub arcs: Vec<Vec<Candidate>>,
    /// For each column the row with the least reduced cost, with the cost of that arc; empty when not asked for.
    pub col_best: Vec<(u32, f64)>,
}

impl Pass {
    /// Mean reduced cost of the last arc of each row.
    #[must_use]
    pub fn typical_reach(&self) -> f64 {
        let rows = self.arcs.iter().zip(&self.row_minimum);
        let reach = rows.map(|(arcs, low)| arcs.last().map_or(0.0, |arc| arc.0 - low));
        (reach.sum::<f64>() / self.arcs.len() as f64).max(f64::MIN_POSITIVE)
    }
}

/// Scratch memory of one thread.
struct Scratch {
    costs: Vec<f64>,
    reduced: Vec<f64>,
    chunk_minimum: Vec<f64>,
    found: Vec<Candidate>,
    width: f64,
}

impl Scratch {
    fn new(cols: usize) -> Self {
        Self {
            costs: vec![0.0; cols],
            reduced: vec![0.0; cols],
            chunk_minimum: vec![0.0; cols.div_ceil(CHUNK)],
            found: Vec::new(),
            width: 0.0,
        }
    }

    /// Computes the reduced costs of a row and gives the least.
    fn load(&mut self, cost: &dyn Cost, row: usize, minus_v: &[f64]) -> f64 {
        cost.fill_row(row, &mut self.costs);
        run(Reduce { costs: &self.costs, minus_v, reduced: &mut self.reduced, chunk_minimum: &mut self.chunk_minimum })
    }

    /// The columns whose reduced cost lies below a limit.
    fn collect(&mut self, limit: f64) {
        self.found.clear();
        for (chunk, &low) in self.chunk_minimum.iter().enumerate() {
            if low < limit {
                let end = ((chunk + 1) * CHUNK).min(self.reduced.len());
                for j in chunk * CHUNK..end {
                    if self.reduced[j] < limit {
                        self.found.push((self.reduced[j], j as u32, self.costs[j]));
                    }
                }
            }
        }
    }

    /// Keeps the `count` least candidates, sorted.
    ///
    /// Ties go by the distance after a column that differs from row to row, so that rows with the same costs do not
    /// all keep the same columns.
    fn keep(&mut self, count: usize, row: usize) {
        let cols = self.reduced.len();
        let first = row * TIE_STRIDE % cols;
        let turn = |col: u32| (col as usize + cols - first) % cols;
        let order = |a: &Candidate, b: &Candidate| a.0.total_cmp(&b.0).then_with(|| turn(a.1).cmp(&turn(b.1)));
        if self.found.len() > count {
            self.found.select_nth_unstable_by(count - 1, order);
            self.found.truncate(count);
        }
        self.found.sort_unstable_by(order);
    }

    /// The `count` cheapest columns of the loaded row.
    fn cheapest(&mut self, low: f64, count: usize, row: usize) {
        let count = count.min(self.reduced.len());
        if self.width <= 0.0 {
            self.width = low.abs().max(f64::MIN_POSITIVE) * 1e-3;
        }
        loop {
            let limit = if low + self.width > low { low + self.width } else { f64::INFINITY };
            self.collect(limit);
            // Costs that someone changes meanwhile may be none: then there are no more.
            if self.found.len() >= count || limit == f64::INFINITY {
                break;
            }
            self.width *= 1.6;
        }
        if self.found.len() > 4 * count {
            self.width *= 0.7;
        }
        self.keep(count, row);
    }
}

/// `reduced = costs + minus_v`, the least of each chunk, and the least of all.
struct Reduce<'a> {
    costs: &'a [f64],
    minus_v: &'a [f64],
    reduced: &'a mut [f64],
    chunk_minimum: &'a mut [f64],
}

impl WithSimd for Reduce<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let mut least = f64::INFINITY;
        let chunks = self.costs.chunks(CHUNK).zip(self.minus_v.chunks(CHUNK)).zip(self.reduced.chunks_mut(CHUNK));
        for (((c, v), r), chunk_minimum) in chunks.zip(self.chunk_minimum) {
            *chunk_minimum = Sum(c, v, r).run(simd);
            least = if *chunk_minimum < least { *chunk_minimum } else { least };
        }
        least
    }
}

/// Rows that one task handles.
const ROWS_A_TASK: usize = 64;

/// Pairs between two questions whether to go on: a fraction of a second, also in hundreds of dimensions.
const PAIRS_BETWEEN_QUESTIONS: usize = 1 << 24;

/// The threads that share the passes over all pairs; the results do not depend on their number.
#[derive(Debug)]
pub struct Workers(Option<rayon::ThreadPool>);

impl Workers {
    /// So many threads; one means the caller's own.
    ///
    /// # Errors
    /// `BadInput` for zero threads, or more than the system gives.
    pub fn new(threads: usize) -> Result<Self, OtError> {
        match threads {
            0 => Err(bad("threads is 0: give at least one".to_owned())),
            1 => Ok(Self(None)),
            _ => match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
                Ok(pool) => Ok(Self(Some(pool))),
                Err(error) => Err(bad(format!("threads is {threads}: the system does not give as many ({error})"))),
            },
        }
    }

    /// Runs `task` over blocks of the rows of a cost and joins the parts in order, as soon as they are there: each holds
    /// numbers for all columns.
    ///
    /// # Errors
    /// `Interrupted` or `NotOptimal`, from the watch, which is asked now and then.
    fn over_rows<T: Send>(
        &self,
        cost: &dyn Cost,
        watch: &mut Watch<'_>,
        task: impl Fn(Range<usize>) -> T + Sync,
        mut join: impl FnMut(T),
    ) -> Result<(), OtError> {
        let threads = self.0.as_ref().map_or(1, rayon::ThreadPool::current_num_threads);
        for rows in blocks(cost.rows(), threads * rows_between_questions(cost.cols())) {
            watch.ask()?;
            let Some(pool) = &self.0 else {
                join(task(rows));
                continue;
            };
            let size = ROWS_A_TASK.max(rows.len().div_ceil(8 * threads));
            let some: Vec<Range<usize>> = blocks(rows.len(), size).collect();
            let task = |part: &Range<usize>| task(rows.start + part.start..rows.start + part.end);
            pool.install(|| some.par_iter().map(task).collect::<Vec<T>>()).into_iter().for_each(&mut join);
        }
        Ok(())
    }
}

/// Rows of so many columns that are gone through between two questions whether to go on.
#[must_use]
pub fn rows_between_questions(cols: usize) -> usize {
    (PAIRS_BETWEEN_QUESTIONS / cols).max(ROWS_A_TASK)
}

/// So many numbers from zero on, in blocks of `size`.
pub fn blocks(len: usize, size: usize) -> impl Iterator<Item = Range<usize>> {
    (0..len).step_by(size).map(move |start| start..(start + size).min(len))
}

/// The `count` arcs of least reduced cost of every row, and the best row of every column.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn shortlist(
    cost: &dyn Cost,
    minus_v: &[f64],
    count: usize,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Pass, OtError> {
    let m = cost.cols();
    let task = |rows: Range<usize>| {
        let mut scratch = Scratch::new(m);
        let mut best = ColumnBest::new(m);
        let (mut minima, mut arcs) = (Vec::with_capacity(rows.len()), Vec::with_capacity(rows.len()));
        for row in rows {
            let low = scratch.load(cost, row, minus_v);
            scratch.cheapest(low, count, row);
            minima.push(low);
            arcs.push(scratch.found.clone());
            run(Improve { best: &mut best, reduced: &scratch.reduced, costs: &scratch.costs, low, row: row as f64 });
        }
        (minima, arcs, best)
    };
    let mut pass = Pass { row_minimum: Vec::new(), arcs: Vec::new(), col_best: vec![(0, 0.0); m] };
    let mut slack = vec![f64::INFINITY; m];
    workers.over_rows(cost, watch, task, |(minima, arcs, best)| {
        pass.row_minimum.extend(minima);
        pass.arcs.extend(arcs);
        for (j, slack) in slack.iter_mut().enumerate() {
            if best.slack[j] < *slack {
                *slack = best.slack[j];
                pass.col_best[j] = (best.row[j] as u32, best.cost[j]);
            }
        }
    })?;
    Ok(pass)
}

/// The most negative arcs of every row, at most `count` each; `negative` judges `(reduced, row, column, cost)`.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn violated(
    cost: &dyn Cost,
    u: &[f64],
    minus_v: &[f64],
    count: usize,
    negative: impl Fn(f64, usize, usize, f64) -> bool + Sync,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Pass, OtError> {
    let task = |rows: Range<usize>| {
        let mut scratch = Scratch::new(cost.cols());
        let (mut minima, mut arcs) = (Vec::with_capacity(rows.len()), Vec::with_capacity(rows.len()));
        for row in rows {
            let low = scratch.load(cost, row, minus_v);
            minima.push(low);
            scratch.found.clear();
            if low < u[row] {
                scratch.collect(u[row]);
                scratch.found.retain(|&(r, col, c)| negative(r - u[row], row, col as usize, c));
                scratch.keep(count, row);
            }
            arcs.push(scratch.found.clone());
        }
        (minima, arcs)
    };
    let mut pass = Pass { row_minimum: Vec::new(), arcs: Vec::new(), col_best: Vec::new() };
    workers.over_rows(cost, watch, task, |(minima, arcs)| {
        pass.row_minimum.extend(minima);
        pass.arcs.extend(arcs);
    })?;
    Ok(pass)
}
