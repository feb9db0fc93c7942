//! Arithmetic on pairs of floats, a number and what it leaves: about twice the digits of one.
//!
//! Reference: D. E. Knuth, The Art of Computer Programming, volume 2, section 4.2.2; T. J. Dekker, A floating-point
//! technique for extending the available precision, Numerische Mathematik 18, 1971.

/// A number as the nearest float and what it leaves.
pub type Pair = (f64, f64);

/// The rounded sum and its rounding error, exactly.
#[inline]
#[must_use]
pub fn two_sum(a: f64, b: f64) -> Pair {
    let sum = a + b;
    let second = sum - a;
    (sum, (a - (sum - second)) + (b - second))
}

/// The difference of two pairs.
#[inline]
#[must_use]
pub fn difference(a: Pair, b: Pair) -> Pair {
    let (near, rest) = two_sum(a.0, -b.0);
    two_sum(near, rest + (a.1 - b.1))
}

/// The square of a pair.
#[inline]
#[must_use]
pub fn square(a: Pair) -> Pair {
    let near = a.0 * a.0;
    two_sum(near, f64::mul_add(a.0, a.0, -near) + 2.0 * a.0 * a.1)
}

/// The quotient of two pairs, to about twice the digits of a float.
#[must_use]
pub fn quotient(a: Pair, b: Pair) -> Pair {
    let near = a.0 / b.0;
    (near, (f64::mul_add(-near, b.0, a.0) + a.1 - near * b.1) / b.0)
}

/// `a` less the product of a float and a pair, where the two nearly agree.
#[inline]
#[must_use]
pub fn less_product(a: Pair, factor: f64, b: Pair) -> f64 {
    let product = factor * b.0;
    (a.0 - product) + (a.1 - (f64::mul_add(factor, b.0, -product) + factor * b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_and_quotients_keep_what_rounding_drops() {
        assert_eq!(two_sum(1.0, 1e-20), (1.0, 1e-20));
        assert_eq!(two_sum(1e-20, -3.0), (-3.0, 1e-20));
        for (a, b) in [(1.0, 3.0), (2f64.powi(61), 0.7), (5.0, 1.0 + f64::EPSILON)] {
            let ratio = quotient((a, 0.0), (b, 0.0));
            assert!(less_product((a, 0.0), b, ratio).abs() <= a * 2f64.powi(-100), "{a} / {b}");
        }
    }
}
