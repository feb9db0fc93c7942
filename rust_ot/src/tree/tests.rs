//! The tree's own invariants, checked after every change.

use super::*;

impl Tree {
    /// Whether counts and flows agree, and potentials with the shifts on the arcs that have changed.
    fn is_sound(&self, rows: &[i64], cols: &[i64]) -> bool {
        let root = self.n + self.m;
        let mut size = vec![0u32; root + 1];
        let mut balance: Vec<i64> = rows.iter().copied().chain(cols.iter().map(|c| -c)).collect();
        balance.push(0);
        for v in 0..=root {
            let (mut up, mut steps) = (v, 0);
            while up != NONE as usize {
                size[up] += 1;
                up = self.nodes[up].parent as usize;
                steps += 1;
                if steps > root + 1 {
                    return false;
                }
            }
        }
        for (v, at) in self.nodes[..root].iter().enumerate() {
            let (up, is_row) = (at.parent as usize, v < self.n);
            let sent = if is_row { at.flow } else { -at.flow };
            balance[v] -= sent;
            balance[up] += sent;
            if at.flow < 0 || (!is_row && at.flow == 0) {
                return false;
            }
            let below = if is_row { self.pi[up] + at.cost } else { self.pi[up] - at.cost };
            if (below - self.pi[v] - at.shift).abs() > 1e-9 {
                return false;
            }
        }
        balance.iter().all(|&b| b == 0) && self.nodes.iter().zip(&size).all(|(at, &size)| at.size == size)
    }
}

#[test]
fn a_forest_becomes_a_sound_tree() {
    let (rows, cols) = (vec![3, 4, 2, 5], vec![3, 2, 6, 3]);
    let arcs = [(0, 0, 1.0, 3), (1, 1, 2.0, 2), (1, 2, 0.5, 2), (3, 2, 1.5, 4)];
    let tree = Tree::from_forest(&rows, &cols, &arcs, &[9.0; 8]);
    assert!(tree.is_sound(&rows, &cols));
    for &(i, j, cost, _) in &arcs {
        assert!((cost - tree.pi[i as usize] + tree.pi[4 + j as usize]).abs() < 1e-12);
    }
    assert_eq!(tree.artificial_mass(), 3);
}

#[test]
fn flows_counts_and_shifts_stay_sound_over_many_pivots() {
    let rows: Vec<i64> = (0..23).map(|i| 1 + i % 4).collect();
    let mut cols: Vec<i64> = vec![rows.iter().sum::<i64>() / 14; 14];
    cols[0] += rows.iter().sum::<i64>() - cols.iter().sum::<i64>();
    let mut tree = Tree::star(&rows, &cols, 10.0);
    let tolerance = Tolerance::new(1.0, 37);
    let mut state = 12345u64;
    let (mut entered, mut refused) = (0, 0);
    for step in 0..6000 {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let (i, j) = ((state >> 33) as usize % rows.len(), (state >> 50) as usize % cols.len());
        // Costs that change keep the search going.
        let cost = f64::from((state >> 20) as u32 % 1000) / 100.0;
        let mut fresh = tree.clone();
        fresh.refresh();
        let reduced = cost - fresh.pi[i] + fresh.pi[rows.len() + j];
        if reduced.abs() < 1e-9 {
            continue;
        }
        let enters = tree.pivot(i, j, cost, &tolerance);
        assert_eq!(enters, reduced < 0.0);
        assert!(tree.is_sound(&rows, &cols));
        entered += usize::from(enters);
        refused += usize::from(!enters);
        if step % 50 == 0 {
            tree.refresh();
            assert!(tree.is_sound(&rows, &cols) && tree.nodes.iter().all(|at| at.shift == 0.0));
        }
    }
    assert!(entered > 100 && refused > 100, "{entered} entered, {refused} did not");
}

#[test]
fn the_potentials_can_count_from_any_node() {
    let (rows, cols) = (vec![3, 4], vec![2, 5]);
    let mut tree = Tree::from_forest(&rows, &cols, &[(0, 0, 1.0, 2), (1, 1, 2.0, 4)], &[9.0; 4]);
    let apart = tree.pi[0] - tree.pi[3];
    tree.raise_artificial(1.0);
    tree.recentre();
    assert!(tree.is_sound(&rows, &cols));
    assert!((tree.pi[0] - tree.pi[3] - apart - 2.0).abs() < 1e-12);
}
