//! Real weights to integer masses, so that every flow is exact and feasibility is never in doubt.

use crate::error::{OtError, bad};
use crate::mass::Mass;
use crate::precise::{Pair, less_product, quotient, two_sum};
use ethnum::{AsI256, I256};

/// Largest relative difference allowed between the totals of the two sides.
pub const MAX_SUM_DIFFERENCE: f64 = 1e-9;

/// Totals below this are refused: their atoms lie where numbers lose digits.
const SMALLEST_TOTAL: f64 = 1e-250;

/// Weights of the rows and of the columns; `None` stands for equal weights.
pub type Weights<'a> = (Option<&'a [f64]>, Option<&'a [f64]>);

/// Integer masses of both sides with one common total.
#[derive(Clone, Debug)]
pub struct Masses<M = i64> {
    /// Mass of each row, in quanta.
    pub rows: Vec<M>,
    /// Mass of each column, in quanta; same total as the rows.
    pub cols: Vec<M>,
    /// That total.
    pub quanta: M,
    /// Share of the total in one quantum.
    pub unit: f64,
    /// Total weight of the rows, and of the plan.
    pub total_rows: f64,
    /// Total weights of the rows and of the columns, to twice the digits of a float.
    pub totals: (Pair, Pair),
    /// Every atom of either side weighs the same as its neighbours.
    pub uniform: bool,
}

/// Turns checked weights into integer masses of equal totals; `None` stands for equal weights.
///
/// # Errors
/// `BadInput` for a weight that is NaN, infinite or negative, a side without mass, or totals that differ.
pub fn integer_masses(a: Option<&[f64]>, b: Option<&[f64]>, n: usize, m: usize) -> Result<Masses, OtError> {
    if let Some(a) = a {
        check_weights("a", a, n)?;
    }
    if let Some(b) = b {
        check_weights("b", b, m)?;
    }
    let totals = (a.map_or((n as f64, 0.0), sum_in_parts), b.map_or((m as f64, 0.0), sum_in_parts));
    let (sum_a, sum_b) = (a.map(|_| totals.0.0), b.map(|_| totals.1.0));
    let total_a = sum_a.or(sum_b).unwrap_or(1.0);
    let total_b = sum_b.unwrap_or(total_a);
    if !total_a.is_finite() || !total_b.is_finite() {
        return Err(bad("the weights sum to infinity: scale them down".to_owned()));
    }
    if total_a.min(total_b) < SMALLEST_TOTAL {
        return Err(bad(format!("the weights sum to {:e}: scale them up", total_a.min(total_b))));
    }
    if (total_a - total_b).abs() > MAX_SUM_DIFFERENCE * total_a.max(total_b) {
        return Err(bad(format!(
            "the weights must have one total (to {MAX_SUM_DIFFERENCE:e} relative): a sums to {total_a} and b to \
             {total_b}; divide each by its sum"
        )));
    }
    let uniform = a.is_none_or(all_equal) && b.is_none_or(all_equal);
    let (rows, cols, quanta) = if uniform {
        let common = gcd(n as u64, m as u64);
        let (row, col) = (m as u64 / common, n as u64 / common);
        (vec![row as i64; n], vec![col as i64; m], row * n as u64)
    } else {
        let ones_a = vec![1.0; if a.is_none() { n } else { 0 }];
        let ones_b = vec![1.0; if b.is_none() { m } else { 0 }];
        let mut rows = fixed_point(a.unwrap_or(&ones_a));
        let mut cols = fixed_point(b.unwrap_or(&ones_b));
        // The side with more points stays as it is.
        let (kept, shared) = if n >= m { (&rows, &mut cols) } else { (&cols, &mut rows) };
        let quanta = kept.iter().sum::<u64>();
        *shared = apportion(shared, quanta);
        (as_signed(&rows), as_signed(&cols), quanta)
    };
    let quanta = quanta as i64;
    Ok(Masses { rows, cols, quanta, unit: 1.0 / quanta as f64, total_rows: total_a, totals, uniform })
}

/// The same masses in quanta of 2^-250 of the total: what float64 weights of seventy decades hold, exactly. The columns
/// take the total of the rows in proportion.
#[must_use]
pub fn fine_masses((a, b): Weights<'_>, coarse: &Masses) -> Masses<I256> {
    let (n, m) = (coarse.rows.len(), coarse.cols.len());
    let lift = 250 - exponent_of(coarse.total_rows);
    let (rows, cols) = match (a, b) {
        (Some(a), b) if !coarse.uniform => {
            let rows = finest(a, lift);
            let quanta = sum(&rows);
            let cols = b.map_or_else(|| equal_shares(m, quanta), |b| in_proportion(finest(b, lift), quanta));
            (rows, cols)
        }
        (None, Some(b)) if !coarse.uniform => {
            let cols = finest(b, lift);
            (equal_shares(n, sum(&cols)), cols)
        }
        _ => (widened(&coarse.rows), widened(&coarse.cols)),
    };
    let quanta = sum(&rows);
    Masses {
        rows,
        cols,
        quanta,
        unit: 1.0 / quanta.to_f64(),
        total_rows: coarse.total_rows,
        totals: coarse.totals,
        uniform: coarse.uniform,
    }
}

fn widened(masses: &[i64]) -> Vec<I256> {
    masses.iter().map(|&mass| I256::from(mass)).collect()
}

fn sum(masses: &[I256]) -> I256 {
    masses.iter().fold(I256::ZERO, |sum, &mass| sum + mass)
}

/// Weights times `2^lift` as integers; only bits below a quantum are lost.
fn finest(weights: &[f64], lift: i32) -> Vec<I256> {
    let whole = |weight: f64| {
        let exponent = exponent_of(weight);
        let mantissa = I256::from(times_power_of_two(weight, 52 - exponent) as i64);
        let shift = exponent - 52 + lift;
        if shift >= 0 { mantissa << shift } else { mantissa >> (-shift).min(63) }
    };
    weights.iter().map(|&weight| if weight == 0.0 { I256::ZERO } else { whole(weight) }).collect()
}

/// Masses with another total near their own, each changed in proportion to some 25 digits; the heaviest takes the rest.
fn in_proportion(mut masses: Vec<I256>, total: I256) -> Vec<I256> {
    let whole = sum(&masses);
    let change = (total - whole).to_f64() / whole.to_f64();
    for mass in &mut masses {
        *mass += (mass.to_f64() * change).as_i256();
    }
    let rest = total - sum(&masses);
    if let Some(heaviest) = masses.iter_mut().max() {
        *heaviest += rest;
    }
    masses
}

fn equal_shares(len: usize, total: I256) -> Vec<I256> {
    let share = total / I256::from(len as u64);
    let mut shares = vec![share; len];
    shares[0] = total - share * I256::from(len as u64 - 1);
    shares
}

/// Sum with Neumaier's compensation, whose error does not grow with the number of terms, as the float and what it leaves.
fn sum_in_parts(values: &[f64]) -> Pair {
    let mut sum = Compensated::default();
    values.iter().for_each(|&value| sum.add(value));
    two_sum(sum.sum, sum.rest)
}

/// The sum of potentials times what the masses of a side have beyond the shares of its weights, in quanta.
#[must_use]
pub fn excess<M: Mass>(masses: &[M], weights: &[f64], total: Pair, quanta: M, potentials: &[f64]) -> f64 {
    let beyond = beyond_weights(weights, total, quanta);
    masses.iter().zip(potentials).enumerate().map(|(place, (&mass, p))| beyond(place, mass) * p).sum()
}

/// Quanta below which most of a mass may be rounding: with twice as many, a millionth of it is.
const LIGHT: f64 = 1_048_576.0;

/// The sum of what light masses have beyond the shares of their weights, or below them, in quanta.
#[must_use]
pub fn rounded_away<M: Mass>(masses: &[M], weights: &[f64], total: Pair, quanta: M) -> f64 {
    let beyond = beyond_weights(weights, total, quanta);
    let light = masses.iter().enumerate().filter(|(_, mass)| mass.to_f64() < LIGHT);
    light.map(|(place, &mass)| beyond(place, mass).abs()).sum()
}

/// What the mass at a place has beyond the share of its weight, in quanta.
fn beyond_weights<M: Mass>(weights: &[f64], total: Pair, quanta: M) -> impl Fn(usize, M) -> f64 {
    // Totals near one, so that nothing leaves the range of numbers on the way.
    let factor = times_power_of_two(1.0, -exponent_of(total.0));
    let per_weight = quotient(quanta.parts(), (total.0 * factor, total.1 * factor));
    move |place, mass| less_product(mass.parts(), weights[place] * factor, per_weight)
}

fn check_weights(name: &str, weights: &[f64], len: usize) -> Result<(), OtError> {
    if weights.len() != len {
        return Err(bad(format!("{name} has {} weights for {len} points: give one weight a point", weights.len())));
    }
    for (index, &weight) in weights.iter().enumerate() {
        if !weight.is_finite() {
            return Err(bad(format!("{name}[{index}] is {weight}: weights must be finite")));
        }
        if weight < 0.0 {
            return Err(bad(format!("{name}[{index}] is {weight}: weights must not be negative")));
        }
    }
    if weights.iter().all(|&weight| weight == 0.0) {
        return Err(bad(format!("{name} has no mass: all its {len} weights are zero")));
    }
    Ok(())
}

fn all_equal(weights: &[f64]) -> bool {
    weights.iter().all(|&weight| weight == weights[0])
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn as_signed(masses: &[u64]) -> Vec<i64> {
    masses.iter().map(|&mass| mass as i64).collect()
}

/// A running sum with Neumaier's compensation.
#[derive(Clone, Copy, Debug, Default)]
pub struct Compensated {
    sum: f64,
    rest: f64,
}

impl Compensated {
    /// Adds one term.
    #[inline]
    pub fn add(&mut self, value: f64) {
        let next = self.sum + value;
        self.rest += if self.sum.abs() >= value.abs() { (self.sum - next) + value } else { (value - next) + self.sum };
        self.sum = next;
    }

    /// The sum so far.
    #[must_use]
    pub fn value(&self) -> f64 {
        self.sum + self.rest
    }
}

/// `value * 2^exponent` without overflow on the way; `exponent` may be as large as 3000 either way.
#[must_use]
pub fn times_power_of_two(value: f64, exponent: i32) -> f64 {
    if exponent.abs() <= 1000 {
        return value * power_of_two(exponent);
    }
    let first = exponent / 3;
    let second = (exponent - first) / 2;
    let third = exponent - first - second;
    value * power_of_two(first) * power_of_two(second) * power_of_two(third)
}

/// `2^exponent` for exponents of normal numbers.
fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((exponent + 1023) as u64) << 52)
}

/// The exponent `e` with `2^e <= |value| < 2^(e+1)`; `value` must be finite and not zero.
#[must_use]
pub fn exponent_of(value: f64) -> i32 {
    let field = |x: f64| ((x.to_bits() >> 52) & 0x7ff) as i32;
    if field(value) == 0 { field(value * 2f64.powi(64)) - 1023 - 64 } else { field(value) - 1023 }
}

/// Weights as integers whose total is near 2^61; weights below 2^-62 of the total vanish.
fn fixed_point(weights: &[f64]) -> Vec<u64> {
    let largest = weights.iter().fold(0.0_f64, |a, &b| a.max(b));
    let shift = -exponent_of(largest);
    let scaled = |w: f64| times_power_of_two(w, shift);
    let sum: f64 = weights.iter().map(|&w| scaled(w)).sum();
    let lift = 2f64.powi(61 - exponent_of(sum));
    weights.iter().map(|&w| (scaled(w) * lift).round() as u64).collect()
}

/// Shares `total` in proportion to `parts`, exactly, by largest remainders (first index first on ties).
fn apportion(parts: &[u64], total: u64) -> Vec<u64> {
    let whole = parts.iter().map(|&p| u128::from(p)).sum::<u128>();
    if whole == u128::from(total) {
        return parts.to_vec();
    }
    let product = |p: u64| u128::from(p) * u128::from(total);
    let mut shares: Vec<u64> = parts.iter().map(|&p| (product(p) / whole) as u64).collect();
    let left = (total - shares.iter().sum::<u64>()) as usize;
    let mut order: Vec<usize> = (0..parts.len()).collect();
    order.sort_by_cached_key(|&i| std::cmp::Reverse(product(parts[i]) % whole));
    for &i in &order[..left] {
        shares[i] += 1;
    }
    shares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_agree_and_shares_are_close() {
        let a: Vec<f64> = (1..=7).map(|i| 1.0 / f64::from(i)).collect();
        let b: Vec<f64> = (1..=11).map(|i| f64::from(i).sqrt()).collect();
        let (sum_a, sum_b) = (sum_in_parts(&a).0, sum_in_parts(&b).0);
        let a: Vec<f64> = a.iter().map(|w| w / sum_a).collect();
        let b: Vec<f64> = b.iter().map(|w| w / sum_b).collect();
        let masses = integer_masses(Some(&a), Some(&b), 7, 11).unwrap();
        assert_eq!(masses.rows.iter().sum::<i64>(), masses.cols.iter().sum::<i64>());
        for (weight, mass) in a.iter().zip(&masses.rows).chain(b.iter().zip(&masses.cols)) {
            assert!((weight - *mass as f64 * masses.unit).abs() < 1e-16);
        }
    }

    #[test]
    fn fine_masses_are_the_weights_in_proportion() {
        let a = [0.999_999_999_999_995_3, 3.2e-15, 1.1e-15, 2.9e-16, 1e-60];
        let b = [0.2; 5];
        let masses = fine_masses((Some(&a), Some(&b)), &integer_masses(Some(&a), Some(&b), 5, 5).unwrap());
        assert_eq!(sum(&masses.rows), sum(&masses.cols));
        let sides = [(&masses.rows, &a, masses.totals.0), (&masses.cols, &b, masses.totals.1)];
        for (side, weights, total) in sides {
            for k in 0..5 {
                let of_one = std::array::from_fn::<f64, 5, _>(|i| f64::from(u8::from(i == k)));
                let excess = excess(side, weights, total, masses.quanta, &of_one) * masses.unit;
                assert!(excess.abs() <= 1e-25 * weights[k], "{excess:e} of {}", weights[k]);
            }
        }
    }

    #[test]
    fn equal_weights_give_the_smallest_integers() {
        let masses = integer_masses(None, None, 4, 6).unwrap();
        assert_eq!((masses.rows[0], masses.cols[0], masses.uniform), (3, 2, true));
    }

    #[test]
    fn exponents_and_powers_of_two_hold_at_the_ends_of_the_range() {
        for value in [5e-324, 1e-310, 1e-300, 0.75, 1.0, 3.0, 1.7e308] {
            let e = exponent_of(value);
            let mantissa = times_power_of_two(value, -e);
            assert!((1.0..2.0).contains(&mantissa), "{value} gave {mantissa}");
            assert_eq!(times_power_of_two(mantissa, e), value);
        }
    }
}
