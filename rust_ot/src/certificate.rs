//! The proof that a plan is optimal: feasible potentials, and the gap between the plan's cost and theirs.

use crate::error::OtError;
use crate::mass::Mass;
use crate::masses::{Masses, Weights, excess, rounded_away};
use crate::precise::two_sum;

/// Potentials that satisfy `alpha[i] + beta[j] <= cost[i, j]` for every pair, in scaled units.
#[derive(Clone, Debug)]
pub struct Potentials {
    /// One for each row.
    pub alpha: Vec<f64>,
    /// One for each column.
    pub beta: Vec<f64>,
    /// Whether no pair's exceed its cost even by their own rounding.
    pub exact: bool,
}

/// What the rounding of potentials may leave unproven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Excuse {
    /// Nothing, as there will be another attempt.
    Nothing,
    /// What is small beside the cost, or beside what the rounding of the weights can change.
    Rounding,
    /// All of it: the order of the points on a line proves the plan.
    Order,
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

/// What rounding leaves may be this share of the cost. Beyond it digits of the potentials decide that are not there, and
/// plans that differ pass for equally good.
const DOUBT: f64 = 1e-6;

/// The arcs of a plan with their scaled costs, and the sum of masses times these, masses being shares of the total.
#[derive(Clone, Copy, Debug)]
pub struct Priced<'a, M> {
    /// `(row, column, mass)`.
    pub arcs: &'a [(usize, usize, M)],
    /// The cost of each.
    pub prices: &'a [f64],
    /// What the plan costs.
    pub primal: f64,
}

/// The primal value minus the value of the potentials, for shares of the total mass and scaled costs that are at most
/// `reach` apart; weights that are `None` are equal.
///
/// The two values are nearly equal, and may be far larger than the cost of light points that is to be proven. So the gap is
/// not their difference, but the sum of what it consists of: mass times reduced cost on the arcs of the plan, and
/// potential times what each mass was rounded by.
///
/// Where that is more than [`GAP`], rounding may be the excuse for so many [`ROUNDINGS`]. And where potentials may exceed
/// costs by their own rounding, that is in doubt too. Both may come to [`DOUBT`] of the cost; or to as many units in the
/// last place of the total mass times the largest price: clouds that coincide but for the rounding of their weights cost
/// no more than that, whatever the plan.
///
/// Potentials tell what a small change of masses costs as long as the plan has masses to change. Those of so few quanta
/// that most of their weight may be rounding are not among these: what becomes of them may cost whatever any pair costs,
/// and counts as unproven.
///
/// # Errors
/// `NotOptimal` when the gap is more than it may be.
pub fn certify<M: Mass>(
    Priced { arcs, prices, primal }: Priced<'_, M>,
    potentials: &Potentials,
    (a, b): Weights<'_>,
    masses: &Masses<M>,
    reach: f64,
    excuse: Excuse,
) -> Result<f64, OtError> {
    let Potentials { alpha, beta, exact } = potentials;
    let (mut quanta, mut light) = (loss(arcs, prices, alpha, beta), 0.0);
    if !masses.uniform {
        let (rows, cols) = masses.totals;
        for (side, weights, total, potentials) in [(&masses.rows, a, rows, alpha), (&masses.cols, b, cols, beta)] {
            let equal = vec![1.0; if weights.is_none() { side.len() } else { 0 }];
            quanta += excess(side, weights.unwrap_or(&equal), total, masses.quanta, potentials);
            light += rounded_away(side, weights.unwrap_or(&equal), total, masses.quanta);
        }
    }
    let gap = quanta * masses.unit;
    let left = gap.abs() + light * masses.unit * reach;
    let paid: f64 = arcs.iter().zip(prices).map(|(arc, price)| arc.2.to_f64() * masses.unit * price.abs()).sum();
    let farthest = prices.iter().fold(0.0, |most: f64, price| most.max(price.abs()));
    let small = (DOUBT * paid).max(ROUNDINGS * f64::EPSILON * farthest);
    let proven = left <= GAP * primal.abs();
    // Nearly always so wherever potentials are counted from: sizes need not be sorted.
    if proven && f64::EPSILON * places(potentials, masses).map(|(p, share)| share * p.abs()).sum::<f64>() <= small {
        return Ok(gap);
    }
    let unit = f64::EPSILON * least_size(potentials, masses);
    let doubt = if *exact { 0.0 } else { unit };
    let accepted = match excuse {
        Excuse::Nothing => proven && doubt <= small,
        Excuse::Rounding => (proven || left <= ROUNDINGS * unit) && (proven && *exact || left + doubt <= small),
        Excuse::Order => proven || left <= ROUNDINGS * unit,
    };
    if accepted {
        return Ok(gap);
    }
    let unproven = left + doubt;
    Err(OtError::NotOptimal(format!(
        "the plan costs {primal:e} but the potentials leave {unproven:e} of it unproven (total mass 1, costs near 1): more \
         than {GAP:e} of the cost, or than rounding may leave ({small:e}); costs or weights of too many sizes decide here: \
         leave out points of weights or distances that play no part, or solve groups of points that are far apart on their \
         own"
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

/// Where potentials lie on one scale, those of the columns negated, and the shares of mass there.
fn places<M: Mass>(potentials: &Potentials, masses: &Masses<M>) -> impl Iterator<Item = (f64, f64)> {
    let share = |mass: &M| mass.to_f64() * masses.unit;
    let rows = masses.rows.iter().zip(&potentials.alpha).map(move |(mass, &p)| (p, share(mass)));
    rows.chain(masses.cols.iter().zip(&potentials.beta).map(move |(mass, &p)| (-p, share(mass))))
}

/// The sum of mass times absolute potential, potentials being counted from where that is least: a weighted median.
fn least_size<M: Mass>(potentials: &Potentials, masses: &Masses<M>) -> f64 {
    let mut places: Vec<(f64, f64)> = places(potentials, masses).collect();
    places.sort_unstable_by(|x, y| x.0.total_cmp(&y.0));
    let mut below = 0.0;
    let median = places.iter().find(|(_, share)| {
        below += share;
        below >= 1.0
    });
    let median = median.or(places.last()).map_or(0.0, |place| place.0);
    places.iter().map(|(place, share)| share * (place - median).abs()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::masses::integer_masses;

    /// The gap of two equal masses that stay where they are, as far as potentials of some size tell.
    fn gap(price: f64, size: f64, exact: bool, excuse: Excuse) -> Option<f64> {
        let masses = integer_masses(None, None, 2, 2).unwrap();
        let potentials = Potentials { alpha: vec![size, 0.0], beta: vec![price - size, 0.0], exact };
        let plan = Priced { arcs: &[(0, 0, 1), (1, 1, 1)], prices: &[price, 0.0], primal: price / 2.0 };
        certify(plan, &potentials, (None, None), &masses, 2.0, excuse).ok()
    }

    #[test]
    fn rounding_excuses_what_is_small_beside_the_cost() {
        // A ten-millionth of 0.1 is lost in the last place of 2^24, all of it in that of 2^53.
        for (size, excused) in [(2f64.powi(24), true), (2f64.powi(53), false)] {
            for exact in [false, true] {
                assert_eq!(gap(0.1, size, exact, Excuse::Nothing), None, "{size}");
                assert_eq!(gap(0.1, size, exact, Excuse::Rounding).is_some(), excused, "{size}");
                assert!(gap(0.1, size, exact, Excuse::Order).is_some(), "{size}");
            }
        }
    }

    #[test]
    fn potentials_that_lack_the_digits_prove_nothing() {
        // All numbers are floats, so that no gap is left; but other pairs may be exceeded by a unit of 2^40, if rounded.
        let (price, size) = (2f64.powi(-10), 2f64.powi(40));
        for (exact, accepted) in [(true, Some(0.0)), (false, None)] {
            assert_eq!(gap(price, size, exact, Excuse::Nothing), accepted);
            assert_eq!(gap(price, size, exact, Excuse::Rounding), accepted);
        }
    }
}
