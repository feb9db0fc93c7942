//! Points that are given several times: solved as one point of their common mass, and told apart again in the plan.
//!
//! Equal points have equal costs to every other, bit by bit. So potentials that are feasible for one of them are feasible
//! for all, and an optimal plan for the distinct points is optimal however it is shared among equal ones.

/// Which of the distinct points each point is.
#[derive(Clone, Debug)]
pub struct Groups {
    /// The first of each group of equal points.
    pub first: Vec<usize>,
    /// The group of every point.
    pub of: Vec<u32>,
}

impl Groups {
    /// Groups of equal points, `(len, dim)`; `None` where all are distinct.
    #[must_use]
    pub fn of_points(points: &[f64], dim: usize) -> Option<Self> {
        // Distinct first coordinates, as most data have, need no look at the others.
        let first_coordinates = points.iter().step_by(dim).copied().collect::<Vec<f64>>();
        if dim > 1 && Self::of_keys(&first_coordinates, 1, true).first.len() == first_coordinates.len() {
            return None;
        }
        let groups = Self::of_keys(points, dim, false);
        (groups.first.len() < groups.of.len()).then_some(groups)
    }

    /// Groups of equal keys; at the first pair of equal ones it stops where that is all that is asked.
    fn of_keys(points: &[f64], dim: usize, only_whether: bool) -> Self {
        let len = points.len() / dim;
        let mask = (2 * len).next_power_of_two() - 1;
        let mut table = vec![EMPTY; mask + 1];
        let mut groups = Self { first: Vec::new(), of: Vec::with_capacity(len) };
        for (place, point) in points.chunks_exact(dim).enumerate() {
            let mut slot = hash(point) & mask;
            let group = loop {
                let group = table[slot];
                if group == EMPTY {
                    table[slot] = groups.first.len() as u32;
                    groups.first.push(place);
                    break table[slot];
                }
                let first = groups.first[group as usize] * dim;
                if points[first..first + dim] == *point {
                    if only_whether {
                        return groups;
                    }
                    break group;
                }
                slot = (slot + 1) & mask;
            };
            groups.of.push(group);
        }
        groups
    }

    /// Every point for itself.
    #[must_use]
    pub fn single(len: usize) -> Self {
        Self { first: (0..len).collect(), of: (0..len as u32).collect() }
    }

    /// Masses of the groups.
    #[must_use]
    pub fn gather(&self, masses: &[i64]) -> Vec<i64> {
        let mut sums = vec![0; self.first.len()];
        for (&group, mass) in self.of.iter().zip(masses) {
            sums[group as usize] += mass;
        }
        sums
    }

    /// The numbers of the groups for their points.
    #[must_use]
    pub fn spread(&self, numbers: &[f64]) -> Vec<f64> {
        self.of.iter().map(|&group| numbers[group as usize]).collect()
    }

    /// The points of each group that have mass, one group after the other, and where each group starts.
    fn members(&self, masses: &[i64]) -> (Vec<usize>, Vec<usize>) {
        let mut starts = vec![0; self.first.len() + 1];
        let heavy = || self.of.iter().enumerate().filter(|&(i, _)| masses[i] > 0);
        heavy().for_each(|(_, &group)| starts[group as usize + 1] += 1);
        (1..starts.len()).for_each(|k| starts[k] += starts[k - 1]);
        let mut next = starts.clone();
        let mut members = vec![0; starts[self.first.len()]];
        for (i, &group) in heavy() {
            members[next[group as usize]] = i;
            next[group as usize] += 1;
        }
        (members, starts)
    }
}

const EMPTY: u32 = u32::MAX;

/// Mixes the bits of a point; zero has one sign.
fn hash(point: &[f64]) -> usize {
    let mixed = point.iter().fold(0u64, |mixed, value| {
        ((mixed.rotate_left(23) ^ (value + 0.0).to_bits()).wrapping_mul(0x9e37_79b9_7f4a_7c15)) ^ (mixed >> 29)
    });
    (mixed >> 32) as usize
}

type Arcs = Vec<(usize, usize, i64)>;

/// Shares the masses of a plan between groups among their points, each in its turn.
///
/// Without a cycle between the groups, there is none between the points: a point more is an arc more.
#[must_use]
pub fn split(arcs: Arcs, (rows, row_masses): (&Groups, &[i64]), (cols, col_masses): (&Groups, &[i64])) -> Arcs {
    let arcs = share(arcs, rows, row_masses);
    let turned = |arcs: Arcs| arcs.into_iter().map(|(i, j, mass)| (j, i, mass)).collect();
    turned(share(turned(arcs), cols, col_masses))
}

/// Shares the masses of each first group among its points.
fn share(arcs: Arcs, groups: &Groups, masses: &[i64]) -> Arcs {
    let (members, mut next) = groups.members(masses);
    let mut left = masses.to_vec();
    let mut shared = Vec::with_capacity(arcs.len() + members.len());
    for (group, other, mut mass) in arcs {
        while mass > 0 {
            let point = members[next[group]];
            let amount = mass.min(left[point]);
            shared.push((point, other, amount));
            (mass, left[point]) = (mass - amount, left[point] - amount);
            if left[point] == 0 {
                next[group] += 1;
            }
        }
    }
    shared
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_those_of_a_plain_search() {
        for (dim, kinds) in [(1, 3), (2, 4), (3, 1), (5, 2), (2, 1000)] {
            let points: Vec<f64> = (0..60 * dim as u32)
                .map(|k| f64::from(k.wrapping_mul(2_654_435_761) >> 7 & 0xffff) % f64::from(kinds) - 1.0)
                .map(|x| if x == 0.0 { -0.0 } else { x })
                .collect();
            let row = |i: usize| &points[i * dim..(i + 1) * dim];
            let expected: Vec<usize> = (0..60).map(|i| (0..60).find(|&k| row(k) == row(i)).unwrap_or(i)).collect();
            let groups = Groups::of_points(&points, dim).unwrap_or_else(|| Groups::single(60));
            let found: Vec<usize> = groups.of.iter().map(|&group| groups.first[group as usize]).collect();
            assert_eq!(found, expected, "{dim} coordinates of {kinds} values");
        }
    }

    #[test]
    fn zeros_of_both_signs_are_one_point() {
        assert_eq!(Groups::of_points(&[0.0, 1.0, -0.0, 1.0], 2).unwrap().first, [0]);
        assert!(Groups::of_points(&[0.0, 1.0, 0.0, 2.0], 2).is_none());
    }

    #[test]
    fn shared_plans_keep_the_masses_of_all_points() {
        let rows = Groups { first: vec![0, 1], of: vec![0, 1, 0, 0] };
        let cols = Groups { first: vec![0, 2], of: vec![0, 0, 1] };
        let (a, b) = (vec![3, 5, 0, 4], vec![6, 2, 4]);
        let arcs = split(vec![(0, 0, 7), (1, 0, 1), (1, 1, 4)], (&rows, &a), (&cols, &b));
        let (mut left, mut right) = (a.clone(), b.clone());
        for &(i, j, mass) in &arcs {
            assert!(mass > 0);
            left[i] -= mass;
            right[j] -= mass;
        }
        assert!(left.iter().chain(&right).all(|&rest| rest == 0));
        assert!(arcs.len() < a.len() + b.len());
    }
}
