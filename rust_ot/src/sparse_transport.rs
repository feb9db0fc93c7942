//! Large problems of any masses: a simplex over short lists of arcs, and passes over all pairs until no arc is missing.
//! The last pass, which finds nothing, is the proof.
//!
//! Mass that the short lists cannot place yet rests on artificial arcs. These cost little at first, so that the
//! potentials stay near those of the coarse problem, and more after each pass, up to what no plan would pay.

use crate::arcs::{self, ArcList};
use crate::coarse_to_fine::Optimum;
use crate::cost::Cost;
use crate::error::OtError;
use crate::network_simplex::Tolerance;
use crate::scan::{self, Pass, Workers};
use crate::tree::Tree;
use crate::watch::Watch;

/// Arcs of least reduced cost that each row starts with.
const SHORTLIST: usize = 24;
/// Missing arcs that a pass may add to a row.
const ADDED: usize = 12;
/// First penalty of the artificial arcs, as a share of the reach of the short lists, and its growth.
const FIRST_PENALTY: f64 = 0.25;
/// The first penalty is no less than this share of the last, also where all short lists are ties.
const LEAST_PENALTY: f64 = 1e-4;
const PENALTY_GROWTH: f64 = 4.0;

/// Solves the problem for positive masses of equal totals, from good negated potentials of the columns.
///
/// # Errors
/// `Interrupted` or `NotOptimal`, from the watch.
pub fn solve(
    cost: &dyn Cost,
    rows: &[i64],
    cols: &[i64],
    minus_v: &[f64],
    workers: &Workers,
    watch: &mut Watch<'_>,
) -> Result<Optimum, OtError> {
    let n = rows.len();
    let pass = scan::shortlist(cost, minus_v, SHORTLIST, workers, watch)?;
    let mut list = ArcList::default();
    add(&mut list, &pass, n);
    for (col, &(row, c)) in pass.col_best.iter().enumerate() {
        if !pass.arcs[row as usize].iter().any(|arc| arc.1 as usize == col) {
            list.push(row, (n + col) as u32, c);
        }
    }
    let (reach, most) = (pass.typical_reach(), artificial_cost(cost));
    let mut penalty = (FIRST_PENALTY * reach).max(LEAST_PENALTY * most).min(most);
    let mut tree = greedy_start(rows, cols, &pass, minus_v, penalty);
    drop(pass);
    let mut tolerance = Tolerance::new(cost.bound(), n + cols.len());
    loop {
        arcs::solve(&list, &mut tree, &mut tolerance, watch)?;
        let resting = penalty < most && tree.artificial_mass() > 0;
        if !resting || penalty >= reach {
            let (u, minus_v) = (tree.row_potentials(), tree.col_potentials_negated());
            let negative = |reduced, row: usize, col: usize, c| tolerance.is_negative(reduced, c, u[row], minus_v[col]);
            let pass = scan::violated(cost, u, minus_v, ADDED, negative, workers, watch)?;
            let before = list.len();
            add(&mut list, &pass, n);
            if !resting && list.len() == before {
                let mut optimum = Optimum::of_tree(&tree);
                for (u, low) in optimum.u.iter_mut().zip(&pass.row_minimum) {
                    *u = u.min(*low);
                }
                return Ok(optimum);
            }
        }
        if resting {
            let next = (PENALTY_GROWTH * penalty).min(most);
            tree.raise_artificial(next - penalty);
            penalty = next;
            tolerance = Tolerance::new(cost.bound(), n + cols.len());
        }
    }
}

/// Adds the arcs that a pass found to a list.
fn add(list: &mut ArcList, pass: &Pass, n: usize) {
    for (row, found) in pass.arcs.iter().enumerate() {
        for &(_, col, c) in found {
            list.push(row as u32, n as u32 + col, c);
        }
    }
}

/// What an artificial arc must cost more than the potentials of its node for no plan to use it.
///
/// A pair of them must cost more than any real arc. Costs differ by at most `bound - floor`, and so do potentials of the
/// columns that are least differences of costs and others; reduced costs reach the sum of both.
#[must_use]
pub fn artificial_cost(cost: &dyn Cost) -> f64 {
    1.01 * (cost.bound() - cost.floor().min(0.0)).max(f64::MIN_POSITIVE)
}

/// Ships along the cheapest arcs of the shortlist, cheapest first; artificial arcs carry the rest.
fn greedy_start(rows: &[i64], cols: &[i64], pass: &Pass, minus_v: &[f64], penalty: f64) -> Tree {
    let mut order: Vec<(f64, u32, u32, f64)> = Vec::new();
    for (row, found) in pass.arcs.iter().enumerate() {
        let low = pass.row_minimum[row];
        order.extend(found.iter().map(|&(reduced, col, c)| (reduced - low, row as u32, col, c)));
    }
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut left, mut open) = (rows.to_vec(), cols.to_vec());
    let mut forest = Vec::new();
    for (_, i, j, c) in order {
        let flow = left[i as usize].min(open[j as usize]);
        if flow > 0 {
            left[i as usize] -= flow;
            open[j as usize] -= flow;
            forest.push((i, j, c, flow));
        }
    }
    let artificial: Vec<f64> =
        pass.row_minimum.iter().map(|u| u + penalty).chain(minus_v.iter().map(|v| penalty - v)).collect();
    Tree::from_forest(rows, cols, &forest, &artificial)
}
