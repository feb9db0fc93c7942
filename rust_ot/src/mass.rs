//! What the simplex over a table needs of masses: whole numbers of quanta, of 64 bits or of 256.

use std::fmt::Debug;
use std::ops::{AddAssign, Neg, SubAssign};

use ethnum::{AsI256, I256};

/// A whole number of quanta.
pub trait Mass: Copy + Ord + Debug + AddAssign + SubAssign + Neg<Output = Self> {
    /// No mass.
    const ZERO: Self;
    /// More than any mass.
    const MAX: Self;

    /// The nearest float and what it leaves, exact to twice the digits of a float.
    fn parts(self) -> (f64, f64);

    /// The nearest float.
    fn to_f64(self) -> f64 {
        self.parts().0
    }
}

impl Mass for i64 {
    const ZERO: Self = 0;
    const MAX: Self = Self::MAX;

    #[inline]
    fn parts(self) -> (f64, f64) {
        let near = self as f64;
        (near, (self - near as Self) as f64)
    }

    #[inline]
    fn to_f64(self) -> f64 {
        self as f64
    }
}

impl Mass for I256 {
    const ZERO: Self = Self::ZERO;
    const MAX: Self = Self::MAX;

    fn parts(self) -> (f64, f64) {
        let near = self.as_f64();
        (near, (self - near.as_i256()).as_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_to_the_mass() {
        for mass in [0_i64, 1, -7, (1 << 53) + 1, (1 << 61) - 1, -(1 << 61) - 3] {
            let (near, rest) = mass.parts();
            assert_eq!(near as i128 + rest as i128, i128::from(mass));
            let wide: I256 = I256::from(mass) << 100;
            let (near, rest) = wide.parts();
            assert_eq!(near.as_i256() + rest.as_i256(), wide);
        }
    }
}
