//! The answer in the caller's units, and the last checks it has to pass.

use crate::certificate::{Excuse, GAP, Potentials, Priced, certify};
use crate::cost::Cost;
use crate::error::{OtError, bad};
use crate::mass::Mass;
use crate::masses::{Compensated, Masses, Weights, exponent_of, times_power_of_two};

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

/// Masses times prices, for the masses of a plan as shares of the total.
fn total<M: Mass>(arcs: &[(usize, usize, M)], prices: &[f64], masses: &Masses<M>) -> f64 {
    let (mut sum, mut rest) = (Compensated::default(), 0.0);
    let scale = times_power_of_two(1.0, -exponent_of(masses.quanta.to_f64()));
    for (arc, price) in arcs.iter().zip(prices) {
        let (near, left) = arc.2.parts();
        let mass = near * scale;
        let product = mass * price;
        sum.add(product);
        rest += f64::mul_add(mass, *price, -product) + left * scale * price;
    }
    sum.add(rest);
    // Once for all: rounded one by one, masses would leave little of a sum in which costs of both signs cancel.
    sum.value() * (masses.unit / scale)
}

/// Whether a plan moves all masses of both sides, and nothing else: what is missing costs nothing.
fn moves_all<M: Mass>(arcs: &[(usize, usize, M)], masses: &Masses<M>) -> bool {
    let (mut rows, mut cols) = (masses.rows.clone(), masses.cols.clone());
    for &(i, j, mass) in arcs {
        rows[i] -= mass;
        cols[j] -= mass;
    }
    arcs.iter().all(|arc| arc.2 > M::ZERO) && rows.iter().chain(&cols).all(|&mass| mass == M::ZERO)
}

/// Certifies a plan and brings everything back to the caller's units.
///
/// # Errors
/// `NotOptimal` when the certificate fails, `BadInput` when the answer lies outside the range of numbers.
pub fn conclude<M: Mass>(
    cost: &dyn Cost,
    arcs: &mut [(usize, usize, M)],
    potentials: &Potentials,
    weights: Weights<'_>,
    masses: &Masses<M>,
    excuse: Excuse,
) -> Result<Solution, OtError> {
    if !moves_all(arcs, masses) {
        return Err(OtError::NotOptimal("the plan leaves mass behind: rescale the costs".to_owned()));
    }
    arcs.sort_unstable();
    let prices: Vec<f64> = arcs.iter().map(|&(i, j, _)| cost.at(i, j)).collect();
    let primal = total(arcs, &prices, masses);
    let plan = Priced { arcs, prices: &prices, primal };
    let gap = certify(plan, potentials, weights, masses, cost.bound() - cost.floor(), excuse)?;
    let paid: Vec<f64> = arcs.iter().zip(&prices).map(|(arc, &price)| cost.unscale(arc.0, arc.1, price)).collect();
    let moved = prices.iter().chain(&paid).any(|&price| price != 0.0);
    let total = total(arcs, &paid, masses) * masses.total_rows;
    let smallest = primal != 0.0 && total.abs() < f64::MIN_POSITIVE;
    let rescaled =
        |side: &[f64]| -> Vec<f64> { side.iter().map(|&v| times_power_of_two(v, cost.exponent())).collect() };
    let (alpha, beta) = (rescaled(&potentials.alpha), rescaled(&potentials.beta));
    let all_finite = alpha.iter().chain(&beta).all(|v| v.is_finite());
    // Where squares vanish, costs that the plan is made of are not those that the caller pays.
    let vanished = (times_power_of_two(primal, cost.exponent()) * masses.total_rows - total).abs() > GAP * total.abs();
    let blurred = primal.abs() < cost.resolution();
    if !total.is_finite() || !all_finite || blurred || (moved && (smallest || vanished)) {
        return Err(bad(format!(
            "the cost ({primal:e} times 2^{}) lies outside the range of numbers: rescale the points or costs",
            cost.exponent()
        )));
    }
    Ok(Solution {
        cost: total,
        rows: arcs.iter().map(|arc| arc.0 as i64).collect(),
        cols: arcs.iter().map(|arc| arc.1 as i64).collect(),
        mass: arcs.iter().map(|arc| arc.2.to_f64() * masses.unit * masses.total_rows).collect(),
        alpha,
        beta,
        gap: times_power_of_two(gap, cost.exponent()) * masses.total_rows,
    })
}
