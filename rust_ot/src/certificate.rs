//! The proof that a plan is optimal: feasible potentials, and the gap between the plan's cost and theirs.

use crate::error::OtError;
use crate::mass::Mass;
use crate::masses::{Masses, Weights, excess};
use crate::precise::two_sum;

/// Potentials that satisfy `alpha[i] + beta[j] <= cost[i, j]` for every pair, in scaled units.
#[derive(Clone, Debug)]
pub struct Potentials {
    /// One for each row.
    pub alpha: Vec<f64>,
    /// One for each column.
    pub beta: Vec<f64>,
}

/// Largest gap of any plan, relative to its cost.
pub const GAP: f64 = 1e-12;

/// Where the cost is a small difference of what its dual value is made of, rounding of those numbers may leave more: so
/// many units in their last place, weighted with their masses.
///
/// With `s = sum of mass * (|alpha| + |beta|)` over the plan, a plan of the careful way is right up to
/// * half a unit of `s`: potentials, tight in doubled precision, are rounded once;
/// * a unit: where the sum exceeds a cost by that rounding, one potential is lowered until it does not;
/// * four units: pairs stay out whose reduced cost is less than two units of `|cost| + |alpha| + |beta|`, which is
///   at most `2 (|alpha| + |beta|)` where the pair is as good as tight;
/// * a unit: costs of pairs on a line are rounded twice, where the potentials are not;
/// * a unit and a half: the potentials are written from another origin than that at which `s` is least.
const ROUNDINGS: f64 = 8.0;

/// The primal value minus the value of the potentials, for shares of the total mass and scaled costs. `prices` are the
/// costs of the arcs, `primal` is the sum of masses times prices as shares; weights that are `None` are equal.
///
/// The two values are nearly equal, and may be far larger than the cost of light points that is to be proven. So the gap is
/// not their difference, but the sum of what it consists of: mass times reduced cost on the arcs of the plan, and
/// potential times what each mass was rounded by. Unless this is the last attempt, no rounding is excused.
///
/// # Errors
/// `NotOptimal` when the gap is more than it may be.
pub fn certify<M: Mass>(
    arcs: &[(usize, usize, M)],
    prices: &[f64],
    primal: f64,
    potentials: &Potentials,
    (a, b): Weights<'_>,
    masses: &Masses<M>,
    last: bool,
) -> Result<f64, OtError> {
    let Potentials { alpha, beta } = potentials;
    let mut quanta = loss(arcs, prices, alpha, beta);
    if !masses.uniform {
        let (rows, cols) = masses.totals;
        for (side, weights, total, potentials) in [(&masses.rows, a, rows, alpha), (&masses.cols, b, cols, beta)] {
            let equal = vec![1.0; if weights.is_none() { side.len() } else { 0 }];
            quanta += excess(side, weights.unwrap_or(&equal), total, masses.quanta, potentials);
        }
    }
    let gap = quanta * masses.unit;
    if gap.abs() <= GAP * primal.abs() {
        return Ok(gap);
    }
    let allowed = if last { ROUNDINGS } else { 0.0 } * f64::EPSILON * least_size(potentials, masses);
    if gap.abs() <= allowed {
        return Ok(gap);
    }
    Err(OtError::NotOptimal(format!(
        "the plan costs {primal:e} but the potentials leave {gap:e} of it unproven (total mass 1, costs near 1): more than \
         {GAP:e} of the cost, and than rounding ({allowed:e}); costs or weights of too many sizes decide here: leave \
         out points of weights or distances that play no part, or solve groups of points that are far apart on their own"
    )))
}

/// Quanta times what they cost more than the potentials of their ends, which is zero on a tight arc.
fn loss<M: Mass>(arcs: &[(usize, usize, M)], prices: &[f64], alpha: &[f64], beta: &[f64]) -> f64 {
    let mut loss = 0.0;
    for (&(i, j, mass), price) in arcs.iter().zip(prices) {
        let (near, rest) = two_sum(*price, -alpha[i]);
        loss += mass.to_f64() * ((near - beta[j]) + rest);
    }
    loss
}

/// The sum of mass times absolute potential, potentials being counted from where that is least: a weighted median.
fn least_size<M: Mass>(potentials: &Potentials, masses: &Masses<M>) -> f64 {
    let share = |mass: &M| mass.to_f64() * masses.unit;
    let rows = masses.rows.iter().zip(&potentials.alpha).map(|(mass, &p)| (p, share(mass)));
    let cols = masses.cols.iter().zip(&potentials.beta).map(|(mass, &p)| (-p, share(mass)));
    let mut places: Vec<(f64, f64)> = rows.chain(cols).collect();
    places.sort_unstable_by(|x, y| x.0.total_cmp(&y.0));
    let mut below = 0.0;
    let median = places.iter().find(|(_, share)| {
        below += share;
        below >= 1.0
    });
    let median = median.or(places.last()).map_or(0.0, |place| place.0);
    places.iter().map(|(place, share)| share * (place - median).abs()).sum()
}
