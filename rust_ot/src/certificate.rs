//! The proof that a plan is optimal: feasible potentials, and the gap between the plan's cost and theirs.

use crate::error::OtError;
use crate::masses::Compensated;
use crate::network_simplex::typical_size;

/// Potentials that satisfy `alpha[i] + beta[j] <= cost[i, j]` for every pair, in scaled units.
#[derive(Clone, Debug)]
pub struct Potentials {
    /// One for each row.
    pub alpha: Vec<f64>,
    /// One for each column.
    pub beta: Vec<f64>,
}

/// Largest gap that is rounding and no error: relative to the cost, and to the numbers the dual value is made of.
const GAP_OF_COST: f64 = 1e-11;
const GAP_OF_POTENTIALS: f64 = 1e-13;
/// Reduced costs that the search may leave, relative to typical potentials.
const GAP_OF_PRICING: f64 = 1e-14;

/// The primal value minus the value of the potentials, for shares of the total mass and scaled costs; `unit` is the
/// share of one quantum.
///
/// # Errors
/// `NotOptimal` when the gap is more than rounding.
pub fn certify(
    primal: f64,
    potentials: &Potentials,
    a: impl Iterator<Item = f64>,
    b: impl Iterator<Item = f64>,
    unit: f64,
) -> Result<f64, OtError> {
    let (mut dual, mut size, mut rounding) = (Compensated::default(), 0.0, 0.0);
    let half = |potentials: &[f64]| 0.5 * potentials.len() as f64;
    let rows = a.zip(&potentials.alpha).map(|(share, p)| (share, p, half(&potentials.alpha)));
    let cols = b.zip(&potentials.beta).map(|(share, p)| (share, p, half(&potentials.beta)));
    for (share, p, points) in rows.chain(cols) {
        dual.add(share * p);
        size += (share * p).abs();
        // A mass is its weight rounded to a whole quantum. The rounding of every point of its side, half a quantum
        // each at most, is in the total that makes it a share.
        rounding += p.abs() * unit * (1.0 + points * share);
    }
    let gap = primal - dual.value();
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
