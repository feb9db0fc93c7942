//! Potentials at which the best column of every row already shares the mass nearly as it should be.
//!
//! The mass that a column attracts grows with its potential, as fast as rows lie near its borders. Newton's method on
//! that count needs the borders only; it is a start for the search, which does not rely on it.

use super::Columns;
use super::movers::{Choice, choose, near};

/// Parts of a Newton step that are tried in turn.
const SHARES: [f64; 3] = [1.0, 0.4, 0.15];
/// Newton steps on each level.
const STEPS: usize = 12;
/// Rows in surplus, for each column, that the search moves as quickly.
const ROWS_A_COLUMN: f64 = 1.0;
/// Rows in surplus, for each column, at which potentials still serve a finer level.
const ROWS_A_COARSE_COLUMN: f64 = 2.0;

/// Potentials of the columns, and what the rows do at them.
pub struct Start {
    /// The potentials.
    pub v: Vec<f64>,
    /// The best column of every row.
    pub choice: Choice,
    /// The mass that each column gets beyond what it should.
    pub excess: Vec<i64>,
}

impl Start {
    fn new(table: Columns<'_>, rows: &[i64], cols: &[i64], v: Vec<f64>) -> Self {
        let choice = choose(table, &v);
        let mut excess: Vec<i64> = cols.iter().map(|mass| -mass).collect();
        for (&j, mass) in choice.best.iter().zip(rows) {
            excess[j as usize] += mass;
        }
        Self { v, choice, excess }
    }

    /// Rows that have to move, if they were of mean mass.
    fn surplus_rows(&self, rows: &[i64]) -> f64 {
        let surplus: i64 = self.excess.iter().filter(|&&e| e > 0).sum();
        surplus as f64 * rows.len() as f64 / rows.iter().sum::<i64>() as f64
    }

    /// Whether the potentials are good enough for a table with more rows.
    pub fn serves_finer(&self, rows: &[i64]) -> bool {
        self.surplus_rows(rows) <= ROWS_A_COARSE_COLUMN * self.v.len() as f64
    }

    /// The change of the potentials after which the columns would be balanced, were the rows spread evenly.
    fn newton_step(&self, rows: &[i64]) -> Option<Vec<f64>> {
        let (m, width) = (self.v.len(), near(&self.choice));
        if width <= 0.0 || !width.is_finite() {
            return None;
        }
        // Mass that changes sides for a change of two potentials against each other: a Laplacian.
        let slope = |mass: f64| mass / (2.0 * width);
        let mut matrix = vec![0.0; m * m];
        // As if every column had one more row near its borders: it pins the common shift and lonely columns.
        let mean = rows.iter().sum::<i64>() as f64 / rows.len() as f64;
        (0..m).for_each(|j| matrix[j * m + j] = slope(mean));
        for (i, mass) in rows.iter().enumerate() {
            if self.choice.second[i] - self.choice.least[i] < width {
                let (j, k) = (self.choice.best[i] as usize, self.choice.next[i] as usize);
                let slope = slope(*mass as f64);
                matrix[j * m + j] += slope;
                matrix[k * m + k] += slope;
                matrix[j * m + k] -= slope;
                matrix[k * m + j] -= slope;
            }
        }
        let excess = self.excess.iter().map(|&e| -e as f64).collect();
        solve_laplacian(matrix, excess)
    }
}

/// Improves potentials until the columns are nearly balanced, as far as it goes.
pub fn start(table: Columns<'_>, rows: &[i64], cols: &[i64], v: Vec<f64>) -> Start {
    let mut now = Start::new(table, rows, cols, v);
    for _ in 0..STEPS {
        let surplus = now.surplus_rows(rows);
        if surplus <= ROWS_A_COLUMN * cols.len() as f64 {
            break;
        }
        let Some(step) = now.newton_step(rows) else { break };
        let along = |share: f64| {
            let v = now.v.iter().zip(&step).map(|(v, step)| v + share * step).collect();
            Start::new(table, rows, cols, v)
        };
        let better = SHARES.iter().map(|&share| along(share)).find(|next| next.surplus_rows(rows) < surplus);
        let Some(better) = better else { break };
        now = better;
    }
    now
}

/// Solves for a vector of sum zero, by Cholesky elimination; columns without borders stay as they are.
fn solve_laplacian(mut matrix: Vec<f64>, mut x: Vec<f64>) -> Option<Vec<f64>> {
    let m = x.len();
    for j in 0..m {
        let pivot = matrix[j * m + j];
        for i in j + 1..m {
            let factor = matrix[i * m + j] / pivot;
            if factor != 0.0 {
                for k in j..m {
                    matrix[i * m + k] -= factor * matrix[j * m + k];
                }
                x[i] -= factor * x[j];
            }
        }
    }
    for j in (0..m).rev() {
        for k in j + 1..m {
            x[j] -= matrix[j * m + k] * x[k];
        }
        x[j] /= matrix[j * m + j];
    }
    x.iter().all(|x| x.is_finite()).then_some(x)
}
