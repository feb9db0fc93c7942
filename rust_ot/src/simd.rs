//! Loops over rows of costs with the widest vector instructions that the processor has.
//!
//! Each loop fixes the order of its operations in lanes of its own, so the bits do not depend on the processor.

use pulp::{Simd, WithSimd, bytemuck};

/// The widest vector instructions of the processor.
#[cfg(not(test))]
#[inline(always)]
pub(crate) fn arch() -> pulp::Arch {
    pulp::Arch::new()
}

#[cfg(test)]
pub(crate) use levels::arch;

#[cfg(test)]
mod levels;

/// A token that is not `Copy`: a closure that consumes it is compiled as one function with the caller's instructions.
pub(crate) struct Once;

/// Evaluates an expression with the widest vector instructions of the processor.
macro_rules! vectorized {
    ($body:expr) => {{
        let once = $crate::simd::Once;
        $crate::simd::arch().dispatch(
            #[inline(always)]
            || {
                let _consumed = once;
                $body
            },
        )
    }};
}
pub(crate) use vectorized;

/// Points whose distances are computed together.
pub(crate) const LANES: usize = 16;

/// The least number of each lane and the step at which it came, as a float, which vectorises like the number.
#[derive(Clone, Copy)]
struct Least<S: Simd> {
    value: S::f64s,
    step: S::f64s,
}

impl<S: Simd> Least<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        Self { value: simd.splat_f64s(f64::INFINITY), step: simd.splat_f64s(0.0) }
    }

    #[inline(always)]
    fn take(&mut self, simd: S, value: S::f64s, step: S::f64s) {
        let better = simd.less_than_f64s(value, self.value);
        self.value = simd.select_f64s(better, value, self.value);
        self.step = simd.select_f64s(better, step, self.step);
    }

    /// The least number and its place, the first of equals.
    #[inline(always)]
    fn finish(self, simd: S) -> (f64, usize) {
        let width = S::F64_LANES;
        let lane = S::as_simd_f64s(&LANE_NUMBERS).0[0];
        let places = simd.add_f64s(simd.mul_f64s(self.step, simd.splat_f64s(width as f64)), lane);
        let least = simd.splat_f64s(simd.reduce_min_f64s(self.value));
        let is_least = simd.equal_f64s(self.value, least);
        let place = simd.reduce_min_f64s(simd.select_f64s(is_least, places, simd.splat_f64s(f64::INFINITY))) as usize;
        // From its place, because a zero may have either sign.
        (lanes::<S>(&self.value)[place % width], place)
    }
}

const LANE_NUMBERS: [f64; 8] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// The numbers of a vector.
#[inline(always)]
pub(crate) fn lanes<S: Simd>(vector: &S::f64s) -> &[f64] {
    bytemuck::cast_slice(std::slice::from_ref(vector))
}

/// The better of two finds, the first on ties.
#[inline(always)]
fn better_of(a: (f64, usize), b: (f64, usize)) -> (f64, usize) {
    if b.0 < a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a }
}

/// Least `a + b` and its place.
pub(crate) struct LeastSum<'a>(pub &'a [f64], pub &'a [f64]);

impl WithSimd for LeastSum<'_> {
    type Output = (f64, usize);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (f64, usize) {
        let ((a, a_rest), (b, b_rest)) = (S::as_simd_f64s(self.0), S::as_simd_f64s(self.1));
        let (mut even, mut odd) = (Least::new(simd), Least::new(simd));
        let mut step = simd.splat_f64s(0.0);
        let one = simd.splat_f64s(1.0);
        let ((a2, a1), (b2, b1)) = (a.as_chunks::<2>(), b.as_chunks::<2>());
        for (a, b) in a2.iter().zip(b2) {
            even.take(simd, simd.add_f64s(a[0], b[0]), step);
            step = simd.add_f64s(step, one);
            odd.take(simd, simd.add_f64s(a[1], b[1]), step);
            step = simd.add_f64s(step, one);
        }
        for (&a, &b) in a1.iter().zip(b1) {
            even.take(simd, simd.add_f64s(a, b), step);
        }
        let mut best = better_of(even.finish(simd), odd.finish(simd));
        for (k, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
            best = better_of(best, (a + b, self.0.len() - a_rest.len() + k));
        }
        best
    }
}

/// The least and second least `a + b`, and the place of the least.
pub(crate) struct TwoLeastSums<'a>(pub &'a [f64], pub &'a [f64]);

impl WithSimd for TwoLeastSums<'_> {
    type Output = (f64, f64, usize);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (f64, f64, usize) {
        let ((a, a_rest), (b, b_rest)) = (S::as_simd_f64s(self.0), S::as_simd_f64s(self.1));
        let mut least = Least::new(simd);
        let mut second = least.value;
        let mut step = simd.splat_f64s(0.0);
        for (&a, &b) in a.iter().zip(b) {
            let value = simd.add_f64s(a, b);
            let loser = simd.max_f64s(value, least.value);
            second = simd.min_f64s(loser, second);
            least.take(simd, value, step);
            step = simd.add_f64s(step, simd.splat_f64s(1.0));
        }
        let (mut first, mut place) = least.finish(simd);
        // The winners of the other lanes are candidates for the second place too.
        let winner = place % S::F64_LANES;
        let others =
            lanes::<S>(&least.value).iter().enumerate().filter(|&(lane, _)| place == usize::MAX || lane != winner);
        let mut next = others.map(|(_, &value)| value).fold(f64::INFINITY, f64::min);
        next = lanes::<S>(&second).iter().fold(next, |low, &value| low.min(value));
        for (k, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
            let value = a + b;
            if value < first {
                (next, first, place) = (first, value, self.0.len() - a_rest.len() + k);
            } else if value < next {
                next = value;
            }
        }
        (first, next, place)
    }
}

/// `distance[j] = min(distance[j], a[j] + b[j] + offset)` where the distance is not infinite, with `row` as origin
/// where it is new; gives the least distance and its place.
pub(crate) struct Relax<'a> {
    pub a: &'a [f64],
    pub b: &'a [f64],
    pub offset: f64,
    pub row: f64,
    pub distance: &'a mut [f64],
    pub origin: &'a mut [f64],
}

impl WithSimd for Relax<'_> {
    type Output = (f64, usize);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (f64, usize) {
        let len = self.a.len();
        let ((a, a_rest), (b, b_rest)) = (S::as_simd_f64s(self.a), S::as_simd_f64s(self.b));
        let (distance, distance_rest) = S::as_mut_simd_f64s(self.distance);
        let (origin, origin_rest) = S::as_mut_simd_f64s(self.origin);
        let (offset, row) = (simd.splat_f64s(self.offset), simd.splat_f64s(self.row));
        let (infinity, one) = (simd.splat_f64s(f64::INFINITY), simd.splat_f64s(1.0));
        let mut least = Least::new(simd);
        let mut step = simd.splat_f64s(0.0);
        for ((&a, &b), (distance, origin)) in a.iter().zip(b).zip(distance.iter_mut().zip(origin)) {
            let new = simd.add_f64s(simd.add_f64s(a, b), offset);
            let open = simd.less_than_f64s(*distance, infinity);
            let better = simd.and_m64s(simd.less_than_f64s(new, *distance), open);
            *distance = simd.select_f64s(better, new, *distance);
            *origin = simd.select_f64s(better, row, *origin);
            least.take(simd, *distance, step);
            step = simd.add_f64s(step, one);
        }
        let mut best = least.finish(simd);
        let place = len - a_rest.len();
        for k in 0..a_rest.len() {
            let new = a_rest[k] + b_rest[k] + self.offset;
            if new < distance_rest[k] && distance_rest[k] < f64::INFINITY {
                (distance_rest[k], origin_rest[k]) = (new, self.row);
            }
            best = better_of(best, (distance_rest[k], place + k));
        }
        best
    }
}

/// `out = a + b`, and the least of it.
pub(crate) struct Sum<'a>(pub &'a [f64], pub &'a [f64], pub &'a mut [f64]);

impl Sum<'_> {
    #[inline(always)]
    pub fn run<S: Simd>(self, simd: S) -> f64 {
        let ((a, a_rest), (b, b_rest)) = (S::as_simd_f64s(self.0), S::as_simd_f64s(self.1));
        let (out, out_rest) = S::as_mut_simd_f64s(self.2);
        let mut low = simd.splat_f64s(f64::INFINITY);
        for ((&a, &b), out) in a.iter().zip(b).zip(out) {
            *out = simd.add_f64s(a, b);
            low = simd.min_f64s(*out, low);
        }
        let mut least = simd.reduce_min_f64s(low);
        for ((a, b), out) in a_rest.iter().zip(b_rest).zip(out_rest) {
            *out = a + b;
            least = if *out < least { *out } else { least };
        }
        least
    }
}

/// The best row of each column; rows as floats, which vectorise like the rest.
pub(crate) struct ColumnBest {
    pub slack: Vec<f64>,
    pub row: Vec<f64>,
    pub cost: Vec<f64>,
}

impl ColumnBest {
    pub fn new(cols: usize) -> Self {
        Self { slack: vec![f64::INFINITY; cols], row: vec![0.0; cols], cost: vec![0.0; cols] }
    }
}

/// Takes a row into the best of each column: its slack is `reduced - low`.
pub(crate) struct Improve<'a> {
    pub best: &'a mut ColumnBest,
    pub reduced: &'a [f64],
    pub costs: &'a [f64],
    pub low: f64,
    pub row: f64,
}

impl WithSimd for Improve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (slack, slack_rest) = S::as_mut_simd_f64s(&mut self.best.slack);
        let (rows, row_rest) = S::as_mut_simd_f64s(&mut self.best.row);
        let (costs, cost_rest) = S::as_mut_simd_f64s(&mut self.best.cost);
        let ((r, r_rest), (c, c_rest)) = (S::as_simd_f64s(self.reduced), S::as_simd_f64s(self.costs));
        let (low, row) = (simd.splat_f64s(self.low), simd.splat_f64s(self.row));
        for ((slack, (best_row, best_cost)), (&r, &c)) in
            slack.iter_mut().zip(rows.iter_mut().zip(costs)).zip(r.iter().zip(c))
        {
            let value = simd.sub_f64s(r, low);
            let better = simd.less_than_f64s(value, *slack);
            *slack = simd.select_f64s(better, value, *slack);
            *best_row = simd.select_f64s(better, row, *best_row);
            *best_cost = simd.select_f64s(better, c, *best_cost);
        }
        for (k, (r, c)) in r_rest.iter().zip(c_rest).enumerate() {
            if r - self.low < slack_rest[k] {
                (slack_rest[k], row_rest[k], cost_rest[k]) = (r - self.low, self.row, *c);
            }
        }
    }
}

/// Runs a loop with the widest vector instructions of the processor.
#[inline]
pub(crate) fn run<K: WithSimd>(kernel: K) -> K::Output {
    arch().dispatch(kernel)
}

/// `least[j] = min(least[j], a[j] - b)`.
#[inline(always)]
pub(crate) fn lower_to_difference(least: &mut [f64], a: &[f64], b: f64) {
    for (least, a) in least.iter_mut().zip(a) {
        let value = a - b;
        *least = if value < *least { value } else { *least };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_sums_are_those_of_a_plain_loop() {
        for len in [1, 2, 7, 15, 16, 17, 40, 100] {
            for salt in 0..50u32 {
                let a: Vec<f64> = (0..len).map(|i| f64::from((i * 37 + salt * 11) % 19)).collect();
                let b: Vec<f64> = (0..len).map(|i| f64::from((i * 5 + salt * 3) % 7)).collect();
                let mut sums: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a + b).collect();
                let place = (0..sums.len()).fold(0, |p, j| if sums[j] < sums[p] { j } else { p });
                assert_eq!(run(LeastSum(&a, &b)), (sums[place], place));
                let (first, second, at) = run(TwoLeastSums(&a, &b));
                assert_eq!((first, at), (sums[place], place));
                sums.sort_by(f64::total_cmp);
                assert_eq!(second, sums.get(1).copied().unwrap_or(f64::INFINITY));
            }
        }
    }
}
