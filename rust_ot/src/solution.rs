//! The answer in the caller's units, and the last checks it has to pass.

use crate::certificate::{Potentials, certify};
use crate::cost::Cost;
use crate::error::{OtError, bad};
use crate::masses::{Compensated, Masses, times_power_of_two};

/// An optimal plan with its proof.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Total cost of the plan.
    pub cost: f64,
    /// Rows of the arcs that carry mass.
    pub rows: Vec<i64>,
    /// Columns of the arcs that carry mass.
    pub cols: Vec<i64>,
    /// Their masses.
    pub mass: Vec<f64>,
    /// Potentials of the rows.
    pub alpha: Vec<f64>,
    /// Potentials of the columns.
    pub beta: Vec<f64>,
    /// Cost of the plan minus the value of the potentials: zero up to rounding.
    pub gap: f64,
}

/// Shares of one side in its total; `None` stands for equal weights.
fn shares(weights: Option<&[f64]>, len: usize, total: f64) -> impl Iterator<Item = f64> + '_ {
    (0..len).map(move |i| weights.map_or(1.0 / len as f64, |w| w[i] / total))
}

/// Certifies a plan and brings everything back to the caller's units.
///
/// # Errors
/// `NotOptimal` when the certificate fails, `BadInput` when the answer lies outside the range of numbers.
pub fn conclude(
    cost: &dyn Cost,
    mut arcs: Vec<(usize, usize, i64)>,
    mut potentials: Potentials,
    a: Option<&[f64]>,
    b: Option<&[f64]>,
    masses: &Masses,
) -> Result<Solution, OtError> {
    arcs.sort_unstable();
    let (mut scaled, mut total) = (Compensated::default(), Compensated::default());
    let mut moved = false;
    for &(i, j, flow) in &arcs {
        let mass = flow as f64 * masses.unit;
        let price = cost.at(i, j);
        scaled.add(mass * price);
        total.add(mass * cost.unscale(i, j, price));
        moved |= price != 0.0;
    }
    let (n, m) = (cost.rows(), cost.cols());
    let primal = scaled.value();
    let (of_rows, of_cols) = (shares(a, n, masses.total_rows), shares(b, m, masses.total_cols));
    let gap = certify(primal, &potentials, of_rows, of_cols, masses.unit)?;
    let total = total.value() * masses.total_rows;
    let smallest = primal != 0.0 && total.abs() < f64::MIN_POSITIVE;
    if cost.exponent() != 0 {
        let rescale = |v: &mut f64| *v = times_power_of_two(*v, cost.exponent());
        potentials.alpha.iter_mut().chain(&mut potentials.beta).for_each(rescale);
    }
    let all_finite = potentials.alpha.iter().chain(&potentials.beta).all(|v| v.is_finite());
    if !total.is_finite() || !all_finite || (moved && smallest) {
        return Err(bad(format!(
            "the cost ({primal:e} times 2^{}) lies outside the range of numbers: rescale the points or costs",
            cost.exponent()
        )));
    }
    Ok(Solution {
        cost: total,
        rows: arcs.iter().map(|arc| arc.0 as i64).collect(),
        cols: arcs.iter().map(|arc| arc.1 as i64).collect(),
        mass: arcs.iter().map(|arc| arc.2 as f64 * masses.unit * masses.total_rows).collect(),
        alpha: potentials.alpha,
        beta: potentials.beta,
        gap: times_power_of_two(gap, cost.exponent()) * masses.total_rows,
    })
}
