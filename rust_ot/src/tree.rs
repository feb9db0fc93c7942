//! The basis of the network simplex: a spanning tree over rows, columns and one root.
//!
//! Arcs go from rows to columns and have no upper bound, so the arcs outside the tree carry nothing and are not
//! stored. An arc of the tree is stored at its lower node: a row sends its flow up, a column takes it from above.
//! The tree stays strongly feasible (an empty arc always points to the root), which excludes cycling.
//!
//! A pivot touches the nodes of its cycle and no others: potentials stay as they were until [`Tree::refresh`]. What an
//! arc of the tree would have to shift the nodes below it by is stored with it, so that the reduced cost of any arc
//! is known from the ways of its ends up to where they meet.

use crate::network_simplex::Tolerance;

/// "No node".
pub const NONE: u32 = u32::MAX;

/// A node and the arc to its parent.
#[derive(Clone, Copy, Debug)]
struct Node {
    parent: u32,
    /// Nodes of its subtree.
    size: u32,
    flow: i64,
    cost: f64,
    /// How much more than its parent's its potential has to change; zero for the arcs of the last refresh.
    shift: f64,
}

/// A spanning tree with flows, costs and potentials. Nodes: rows `0..n`, columns `n..n+m`, then the root.
#[derive(Clone, Debug)]
pub struct Tree {
    n: usize,
    m: usize,
    nodes: Vec<Node>,
    /// `u` for rows and `-v` for columns, as of the last refresh: the reduced cost of an arc is
    /// `cost - pi[row] + pi[column]`.
    pub pi: Vec<f64>,
    /// Nodes on the way to one whose potential is known, and the refresh at which each node was done.
    way: Vec<u32>,
    order: Vec<u32>,
    last_order: Vec<u32>,
    done: Vec<u32>,
    refreshes: u32,
}

/// The cycle that an arc closes: where its ends meet, the arc that empties first, and the flow that it allows.
struct Cycle {
    join: u32,
    leaving: u32,
    on_tail_side: bool,
    amount: i64,
}

impl Tree {
    /// The star of artificial arcs, each of cost `big`.
    #[must_use]
    pub fn star(rows: &[i64], cols: &[i64], big: f64) -> Self {
        let (n, m) = (rows.len(), cols.len());
        let root = n + m;
        let leaf = |&flow: &i64| Node { parent: root as u32, size: 1, flow, cost: big, shift: 0.0 };
        let mut nodes: Vec<Node> = rows.iter().chain(cols).map(leaf).collect();
        nodes.push(Node { parent: NONE, size: root as u32 + 1, flow: 0, cost: 0.0, shift: 0.0 });
        let mut pi = vec![big; n];
        pi.resize(n + m, -big);
        pi.push(0.0);
        Self {
            n,
            m,
            nodes,
            pi,
            way: Vec::new(),
            order: (0..root as u32).collect(),
            last_order: Vec::new(),
            done: vec![0; root + 1],
            refreshes: 0,
        }
    }

    /// A tree from a forest of arcs with flow, completed by artificial arcs.
    ///
    /// At most one node of each part of the forest may have mass that its arcs (`row, column, cost, flow`) leave
    /// over; that node hangs under the root. `artificial` holds the cost of the artificial arc of every node.
    #[must_use]
    pub fn from_forest(rows: &[i64], cols: &[i64], arcs: &[(u32, u32, f64, i64)], artificial: &[f64]) -> Self {
        let mut tree = Self::star(rows, cols, 0.0);
        let (n, nodes) = (rows.len(), rows.len() + cols.len());
        let mut left: Vec<i64> = rows.iter().chain(cols).copied().collect();
        let mut starts = vec![0u32; nodes + 1];
        for &(i, j, _, flow) in arcs {
            for v in [i as usize, n + j as usize] {
                starts[v + 1] += 1;
                left[v] -= flow;
            }
        }
        for v in 0..nodes {
            starts[v + 1] += starts[v];
        }
        let mut fill = starts.clone();
        let mut neighbours = vec![(0u32, 0u32); 2 * arcs.len()];
        for (k, &(i, j, ..)) in arcs.iter().enumerate() {
            for (v, w) in [(i, n as u32 + j), (n as u32 + j, i)] {
                neighbours[fill[v as usize] as usize] = (w, k as u32);
                fill[v as usize] += 1;
            }
        }
        let mut order = Vec::with_capacity(nodes);
        let mut seen = vec![false; nodes];
        let mut stack = Vec::new();
        // Nodes with mass left hang under the root; a part without such a node hangs by any of its rows.
        let tops = (0..nodes).filter(|&v| left[v] > 0).chain(0..n).collect::<Vec<_>>();
        for top in tops {
            if seen[top] {
                continue;
            }
            seen[top] = true;
            (tree.nodes[top].cost, tree.nodes[top].flow) = (artificial[top], left[top]);
            stack.push(top);
            while let Some(v) = stack.pop() {
                order.push(v);
                for &(w, k) in &neighbours[starts[v] as usize..starts[v + 1] as usize] {
                    let w = w as usize;
                    if !seen[w] {
                        seen[w] = true;
                        let (_, _, cost, flow) = arcs[k as usize];
                        tree.nodes[w] = Node { parent: v as u32, size: 1, flow, cost, shift: 0.0 };
                        stack.push(w);
                    }
                }
            }
        }
        for &v in order.iter().rev() {
            let (parent, size) = (tree.nodes[v].parent as usize, tree.nodes[v].size);
            if parent != nodes {
                tree.nodes[parent].size += size;
            }
        }
        tree.refresh();
        tree
    }

    /// Makes the artificial arcs of the tree dearer, and computes the potentials again.
    pub fn raise_artificial(&mut self, by: f64) {
        let root = self.n + self.m;
        for node in &mut self.nodes[..root] {
            if node.parent as usize == root {
                node.cost += by;
            }
        }
        self.refresh();
    }

    /// Potentials of the rows.
    #[must_use]
    pub fn row_potentials(&self) -> &[f64] {
        &self.pi[..self.n]
    }

    /// Negated potentials of the columns.
    #[must_use]
    pub fn col_potentials_negated(&self) -> &[f64] {
        &self.pi[self.n..self.n + self.m]
    }

    /// Brings the arc `row -> column` into the tree if its reduced cost is negative, and tells whether it was.
    pub fn pivot(&mut self, row: usize, col: usize, cost: f64, tolerance: &Tolerance) -> bool {
        let (tail, head) = (row as u32, (self.n + col) as u32);
        let (u, minus_v) = (self.pi[row], self.pi[self.n + col]);
        // What the arc would shift its tail by, had nothing changed since the last refresh.
        let shift = cost - u + minus_v;
        let (cycle, ways) = self.cycle(tail, head);
        if !tolerance.is_negative(shift + ways, cost, u, minus_v) {
            return false;
        }
        let Cycle { leaving, on_tail_side, amount, .. } = cycle;
        let (inner, outer, shift) = if on_tail_side { (tail, head, shift) } else { (head, tail, -shift) };
        self.push_flow(tail, head, &cycle);
        self.rehang(inner, leaving, Node { parent: outer, size: 0, flow: amount, cost, shift });
        true
    }

    /// Walks both ends up to where they meet; finds the arc that empties first, the last such on the cycle, and how
    /// much more the potential of the head than that of the tail has changed since the last refresh.
    fn cycle(&self, tail: u32, head: u32) -> (Cycle, f64) {
        let (mut a, mut b) = (tail, head);
        let (mut amount, mut leaving) = (i64::MAX, NONE);
        let (mut head_amount, mut head_leaving) = (i64::MAX, NONE);
        let (mut tail_way, mut head_way) = (0.0, 0.0);
        let n = self.n as u32;
        let (mut at_a, mut at_b) = (&self.nodes[a as usize], &self.nodes[b as usize]);
        while a != b {
            if at_a.size < at_b.size {
                if a < n && at_a.flow < amount {
                    (amount, leaving) = (at_a.flow, a);
                }
                tail_way += at_a.shift;
                a = at_a.parent;
                at_a = &self.nodes[a as usize];
            } else {
                if b >= n && at_b.flow <= head_amount {
                    (head_amount, head_leaving) = (at_b.flow, b);
                }
                head_way += at_b.shift;
                b = at_b.parent;
                at_b = &self.nodes[b as usize];
            }
        }
        let on_tail_side = head_leaving == NONE || head_amount > amount;
        if !on_tail_side {
            (amount, leaving) = (head_amount, head_leaving);
        }
        (Cycle { join: a, leaving, on_tail_side, amount }, head_way - tail_way)
    }

    /// Sends the flow round the cycle, and moves the leaving subtree from the counts of its side to the other's.
    fn push_flow(&mut self, tail: u32, head: u32, cycle: &Cycle) {
        let moved = self.nodes[cycle.leaving as usize].size;
        let n = self.n as u32;
        for (start, loses, rows_gain) in
            [(tail, cycle.on_tail_side, -cycle.amount), (head, !cycle.on_tail_side, cycle.amount)]
        {
            let mut node = start;
            // On the losing side the counts change above the leaving arc, on the other one from the start.
            let mut change = if loses { 0 } else { moved };
            while node != cycle.join {
                let at = &mut self.nodes[node as usize];
                at.flow += if node < n { rows_gain } else { -rows_gain };
                at.size = at.size.wrapping_add(change);
                if node == cycle.leaving {
                    change = moved.wrapping_neg();
                }
                node = at.parent;
            }
        }
    }

    /// Makes `inner` the top of the subtree of `leaving`, under the parent and with the arc that `top` names.
    fn rehang(&mut self, inner: u32, leaving: u32, mut top: Node) {
        let total = self.nodes[leaving as usize].size;
        let (mut node, mut below) = (inner, 0);
        loop {
            let old = self.nodes[node as usize];
            self.nodes[node as usize] = Node { size: total - below, ..top };
            if node == leaving {
                return;
            }
            // The arc upwards becomes the arc downwards.
            top = Node { parent: node, size: 0, flow: old.flow, cost: old.cost, shift: -old.shift };
            below = old.size;
            node = old.parent;
        }
    }

    /// Computes all the potentials again from the costs on the tree.
    pub fn refresh(&mut self) {
        self.refreshes += 1;
        let (root, now) = (self.n + self.m, self.refreshes);
        self.done[root] = now;
        std::mem::swap(&mut self.order, &mut self.last_order);
        self.order.clear();
        // In the order of the last refresh most parents come before their children.
        for k in 0..root {
            let start = self.last_order[k];
            if self.done[start as usize] == now {
                continue;
            }
            let mut node = start;
            loop {
                let parent = self.nodes[node as usize].parent;
                if self.done[parent as usize] == now {
                    break;
                }
                self.way.push(node);
                node = parent;
            }
            loop {
                let at = &mut self.nodes[node as usize];
                let above = self.pi[at.parent as usize];
                at.shift = 0.0;
                self.pi[node as usize] = if (node as usize) < self.n { above + at.cost } else { above - at.cost };
                self.done[node as usize] = now;
                self.order.push(node);
                let Some(below) = self.way.pop() else { break };
                node = below;
            }
        }
    }

    /// Counts the potentials from a typical node, so that a few far points do not cost the others their last digits.
    pub fn recentre(&mut self) {
        let root = self.n + self.m;
        let mut values = self.pi[..root].to_vec();
        let (_, &mut middle, _) = values.select_nth_unstable_by(root / 2, f64::total_cmp);
        self.pi[root] -= middle;
        self.refresh();
    }

    /// Mass still on artificial arcs.
    #[must_use]
    pub fn artificial_mass(&self) -> i64 {
        let root = (self.n + self.m) as u32;
        self.nodes[..self.n].iter().filter(|node| node.parent == root).map(|node| node.flow).sum()
    }

    /// The arcs of the tree that carry mass: `(row, column, mass)`, in order of their lower node.
    pub fn arcs(&self) -> impl Iterator<Item = (usize, usize, i64)> + '_ {
        let root = self.n + self.m;
        self.nodes[..root].iter().enumerate().filter(move |(_, at)| at.parent as usize != root && at.flow > 0).map(
            |(v, at)| {
                let up = at.parent as usize;
                if v < self.n { (v, up - self.n, at.flow) } else { (up, v - self.n, at.flow) }
            },
        )
    }
}

#[cfg(test)]
mod tests;
