//! Real weights to integer masses, so that every flow is exact and feasibility is never in doubt.

use crate::error::{OtError, bad};

/// Largest relative difference allowed between the totals of the two sides.
pub const MAX_SUM_DIFFERENCE: f64 = 1e-9;

/// Totals below this are refused: their atoms lie where numbers lose digits.
const SMALLEST_TOTAL: f64 = 1e-250;

/// Integer masses of both sides with one common total.
#[derive(Clone, Debug)]
pub struct Masses {
    /// Mass of each row, in quanta.
    pub rows: Vec<i64>,
    /// Mass of each column, in quanta; same total as the rows.
    pub cols: Vec<i64>,
    /// Share of the total in one quantum.
    pub unit: f64,
    /// Total weight of the rows, and of the plan.
    pub total_rows: f64,
    /// Total weight of the columns.
    pub total_cols: f64,
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
    let (sum_a, sum_b) = (a.map(accurate_sum), b.map(accurate_sum));
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
    Ok(Masses { rows, cols, unit: 1.0 / quanta as f64, total_rows: total_a, total_cols: total_b, uniform })
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

/// Sum with Neumaier's compensation: the error does not grow with the number of terms.
pub fn accurate_sum(values: &[f64]) -> f64 {
    let mut sum = Compensated::default();
    for &value in values {
        sum.add(value);
    }
    sum.value()
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
        let (sum_a, sum_b) = (accurate_sum(&a), accurate_sum(&b));
        let a: Vec<f64> = a.iter().map(|w| w / sum_a).collect();
        let b: Vec<f64> = b.iter().map(|w| w / sum_b).collect();
        let masses = integer_masses(Some(&a), Some(&b), 7, 11).unwrap();
        assert_eq!(masses.rows.iter().sum::<i64>(), masses.cols.iter().sum::<i64>());
        for (weight, mass) in a.iter().zip(&masses.rows).chain(b.iter().zip(&masses.cols)) {
            assert!((weight - *mass as f64 * masses.unit).abs() < 1e-16);
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
