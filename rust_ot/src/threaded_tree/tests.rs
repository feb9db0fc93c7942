//! The tree's own invariants, checked after every change.

use super::*;

impl ThreadedTree {
    /// Whether links, counts, flows and potentials agree.
    fn is_sound(&self, rows: &[i64], cols: &[i64]) -> bool {
        let nodes = self.parent.len();
        let root = nodes - 1;
        let mut order = vec![root];
        let mut node = self.next[root] as usize;
        while node != root && order.len() <= nodes {
            order.push(node);
            node = self.next[node] as usize;
        }
        if order.len() != nodes {
            return false;
        }
        let mut size = vec![1u32; nodes];
        let mut balance: Vec<i64> = rows.iter().copied().chain(cols.iter().map(|c| -c)).collect();
        balance.push(0);
        for (place, &v) in order.iter().enumerate().rev() {
            if self.size[v] != size[v] || self.last[v] as usize != order[place + size[v] as usize - 1] {
                return false;
            }
            if v != root {
                let up = self.parent[v] as usize;
                size[up] += size[v];
                let sent = if v < self.n { self.flow[v] } else { -self.flow[v] };
                balance[v] -= sent;
                balance[up] += sent;
                if self.flow[v] < 0 || (v >= self.n && self.flow[v] == 0) {
                    return false;
                }
            }
        }
        balance.iter().all(|&b| b == 0)
    }
}

#[test]
fn links_flows_and_counts_stay_sound_over_many_pivots() {
    let rows: Vec<i64> = (0..23).map(|i| 1 + i % 4).collect();
    let cols: Vec<i64> = vec![rows.iter().sum::<i64>() / 14; 14];
    let mut cols = cols;
    cols[0] += rows.iter().sum::<i64>() - cols.iter().sum::<i64>();
    let mut tree = ThreadedTree::star(&rows, &cols, 10.0);
    let mut state = 12345u64;
    for _ in 0..3000 {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let (i, j) = ((state >> 33) as usize % rows.len(), (state >> 50) as usize % cols.len());
        let cost = f64::from((state >> 20) as u32 % 1000) / 100.0;
        let in_tree = tree.parent[i] as usize == rows.len() + j || tree.parent[rows.len() + j] as usize == i;
        if !in_tree {
            tree.pivot(i, j, cost);
            assert!(tree.is_sound(&rows, &cols));
            let drifted = tree.pi.clone();
            tree.refresh_potentials();
            let offset = drifted[0] - tree.pi[0];
            assert!(tree.pi.iter().zip(&drifted).all(|(new, old)| (new + offset - old).abs() < 1e-9));
        }
    }
}
