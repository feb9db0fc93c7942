//! The proof that a plan is optimal: feasible potentials, and the gap between the plan's cost and theirs.

use crate::cost::Cost;
use crate::error::OtError;
use crate::masses::{Compensated, Masses};
use crate::network_simplex::typical_size;
use crate::simd::{LeastSum, run};

/// Potentials that satisfy `alpha[i] + beta[j] <= cost[i, j]` for every pair, in scaled units.
#[derive(Clone, Debug)]
pub struct Potentials {
    /// One for each row.
    pub alpha: Vec<f64>,
    /// One for each column.
    pub beta: Vec<f64>,
}

/// Makes potentials feasible over all pairs: `alpha[i]` becomes the least `cost[i, j] - beta[j]`.
pub fn tighten(cost: &dyn Cost, beta: Vec<f64>) -> Potentials {
    let mut row = vec![0.0; cost.cols()];
    let minus_beta: Vec<f64> = beta.iter().map(|b| -b).collect();
    let alpha = (0..cost.rows())
        .map(|i| {
            cost.fill_row(i, &mut row);
            run(LeastSum(&row, &minus_beta)).0
        })
        .collect();
    Potentials { alpha, beta }
}

/// Largest gap that is rounding and no error: relative to the cost, and to the numbers the dual value is made of.
const GAP_OF_COST: f64 = 1e-11;
const GAP_OF_POTENTIALS: f64 = 1e-13;
/// Reduced costs that the search may leave, relative to typical potentials.
const GAP_OF_PRICING: f64 = 1e-14;

/// The primal value minus the value of the potentials, for shares of the total mass and scaled costs.
///
/// # Errors
/// `NotOptimal` when the gap is more than rounding.
pub fn certify(
    primal: f64,
    potentials: &Potentials,
    a: impl Iterator<Item = f64>,
    b: impl Iterator<Item = f64>,
    masses: &Masses,
) -> Result<f64, OtError> {
    let (mut dual, mut size, mut rounding) = (Compensated::default(), 0.0, 0.0);
    for (share, p) in a.zip(&potentials.alpha).chain(b.zip(&potentials.beta)) {
        dual.add(share * p);
        size += (share * p).abs();
        rounding += p.abs() * masses.unit;
    }
    let gap = primal - dual.value();
    // Shares are whole quanta, so the plan itself is exact to a quantum at each point only.
    let pricing = GAP_OF_PRICING * typical_size(potentials.alpha.iter().chain(&potentials.beta));
    let allowed = GAP_OF_COST * primal.abs() + GAP_OF_POTENTIALS * size + rounding + pricing;
    if gap.abs() <= allowed {
        return Ok(gap);
    }
    Err(OtError::NotOptimal(format!(
        "the plan costs {primal:e} but the potentials prove only {:e} (total mass 1, costs near 1): a gap of {gap:e} is \
         more than rounding ({allowed:e}); rescale the points or merge near-duplicates",
        dual.value()
    )))
}
