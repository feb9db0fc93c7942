//! Potentials for a large problem from one with fewer points.

use crate::coarse_to_fine::{Optimum, SMALL_SIDE, solve};
use crate::cost::Cost;
use crate::error::OtError;
use crate::scan::{Workers, blocks, rows_between_questions};
use crate::simd::{lower_to_difference, vectorized};
use crate::watch::Watch;

/// What masses the points of a coarse problem have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Share {
    /// Their own.
    Own,
    /// Their own and those of the points nearest to them, so that the mass of every region stays what it is; their own
    /// where points have no places, or where the nearest is hardly nearer than any other.
    Region,
}

/// The optimum for one in `every` of the rows and of the columns, and which rows they are.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn optimum(
    cost: &dyn Cost,
    (rows, cols): (&[i64], &[i64]),
    every: usize,
    share: Share,
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<(Vec<usize>, Optimum), OtError> {
    let (some_rows, some_cols) = (sample(rows.len(), every), sample(cols.len(), every));
    let part = cost.subset(&some_rows, &some_cols);
    let masses = if share == Share::Region {
        let regions = gathered(cost, true, rows, &some_rows, watch)?;
        regions.zip(gathered(cost, false, cols, &some_cols, watch)?)
    } else {
        None
    };
    let (row_masses, col_masses) = masses.unwrap_or_else(|| {
        let pick = |masses: &[i64], kept: &[usize]| kept.iter().map(|&i| masses[i]).collect::<Vec<i64>>();
        balanced(pick(rows, &some_rows), pick(cols, &some_cols))
    });
    let coarse = solve(&*part, &row_masses, &col_masses, workers, watch)?;
    Ok((some_rows, coarse))
}

/// Negated potentials of all columns from the potentials of some rows: the least `cost - u`.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn extend_to_columns(
    cost: &dyn Cost,
    some_rows: &[usize],
    u: &[f64],
    watch: &mut Watch<'_>,
) -> Result<Vec<f64>, OtError> {
    let mut v = vec![f64::INFINITY; cost.cols()];
    let mut row_costs = vec![0.0; cost.cols()];
    for block in blocks(some_rows.len(), rows_between_questions(cost.cols())) {
        watch.ask()?;
        for (&i, &u) in some_rows[block.clone()].iter().zip(&u[block]) {
            cost.fill_row(i, &mut row_costs);
            vectorized!(lower_to_difference(&mut v, &row_costs, u));
        }
    }
    v.iter_mut().for_each(|v| *v = -*v);
    Ok(v)
}

/// The masses of the kept points with those of the points nearest to them.
fn gathered(
    cost: &dyn Cost,
    of_rows: bool,
    masses: &[i64],
    kept: &[usize],
    watch: &mut Watch<'_>,
) -> Result<Option<Vec<i64>>, OtError> {
    let mut is_kept = vec![false; masses.len()];
    kept.iter().for_each(|&i| is_kept[i] = true);
    let others: Vec<usize> = (0..masses.len()).filter(|&i| !is_kept[i]).collect();
    let Some(nearest) = cost.nearest(of_rows, &others, kept, watch)? else { return Ok(None) };
    let mut sums: Vec<i64> = kept.iter().map(|&i| masses[i]).collect();
    for (&i, &place) in others.iter().zip(&nearest) {
        sums[place as usize] += masses[i];
    }
    Ok(Some(sums))
}

/// Masses of equal totals, in finer quanta, so that every column keeps some mass.
#[must_use]
pub fn balanced(mut rows: Vec<i64>, cols: Vec<i64>) -> (Vec<i64>, Vec<i64>) {
    let total: i64 = rows.iter().sum();
    if total == cols.iter().sum::<i64>() {
        return (rows, cols);
    }
    let finer = (1i64 << 61) / total;
    rows.iter_mut().for_each(|mass| *mass *= finer.max(1));
    let cols = rebalance(cols, rows.iter().sum());
    (rows, cols)
}

/// One in `every` of `0..len`, spread at random but the same every time.
#[must_use]
pub fn sample(len: usize, every: usize) -> Vec<usize> {
    let mut state = len as u64 ^ 0x9e37_79b9_7f4a_7c15;
    let mut order: Vec<usize> = (0..len).collect();
    let half = if len <= SMALL_SIDE { len } else { len.div_ceil(every) };
    for k in 0..half {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let other = k + ((state >> 33) as usize) % (len - k);
        order.swap(k, other);
    }
    order.truncate(half);
    order.sort_unstable();
    order
}

/// Scales masses to a much larger total, each at least one.
fn rebalance(mut masses: Vec<i64>, total: i64) -> Vec<i64> {
    let sum: i128 = masses.iter().map(|&x| i128::from(x)).sum();
    for mass in &mut masses {
        *mass = ((i128::from(*mass) * i128::from(total) / sum) as i64).max(1);
    }
    let excess = masses.iter().sum::<i64>() - total;
    if let Some(largest) = masses.iter_mut().max() {
        *largest -= excess;
    }
    masses
}
