//! The basis of the network simplex over a full table: a spanning tree whose potentials are always up to date.
//!
//! The tree is the one of [`crate::tree`], with a preorder of its nodes besides: a pivot shifts the potentials of a whole
//! subtree at once. Where pricing is quick, as over a table of moderate size, the best arc of the moment is worth that.

use crate::mass::Mass;
use crate::precise::{Pair, two_sum};
use crate::tree::NONE;

/// A spanning tree with flows, costs and potentials. Nodes: rows `0..n`, columns `n..n+m`, then the root.
#[derive(Clone, Debug)]
pub struct ThreadedTree<M = i64> {
    n: usize,
    m: usize,
    parent: Vec<u32>,
    next: Vec<u32>,
    prev: Vec<u32>,
    last: Vec<u32>,
    size: Vec<u32>,
    flow: Vec<M>,
    cost: Vec<f64>,
    /// `u` for rows and `-v` for columns: the reduced cost of an arc is `cost - pi[row] + pi[column]`.
    pub pi: Vec<f64>,
    stem: Vec<u32>,
}

impl<M: Mass> ThreadedTree<M> {
    /// The star of artificial arcs, each of cost `big`.
    #[must_use]
    pub fn star(rows: &[M], cols: &[M], big: f64) -> Self {
        let (n, m) = (rows.len(), cols.len());
        let nodes = n + m + 1;
        let root = n + m;
        let mut pi = vec![big; n];
        pi.resize(n + m, -big);
        pi.push(0.0);
        let mut flow = rows.to_vec();
        flow.extend_from_slice(cols);
        flow.push(M::ZERO);
        let mut parent = vec![root as u32; nodes];
        parent[root] = NONE;
        let mut size = vec![1; nodes];
        size[root] = nodes as u32;
        let mut last: Vec<u32> = (0..nodes as u32).collect();
        last[root] = root as u32 - 1;
        Self {
            n,
            m,
            parent,
            next: (0..nodes).map(|v| if v == root { 0 } else { v as u32 + 1 }).collect(),
            prev: (0..nodes).map(|v| if v == 0 { root as u32 } else { v as u32 - 1 }).collect(),
            last,
            size,
            flow,
            cost: vec![big; nodes],
            pi,
            stem: Vec::new(),
        }
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

    /// Brings the arc `row -> column` into the tree; its reduced cost must be negative.
    pub fn pivot(&mut self, row: usize, col: usize, cost: f64) {
        let (tail, head) = (row as u32, (self.n + col) as u32);
        let reduced = cost - self.pi[row] + self.pi[self.n + col];
        let (join, leaving, on_tail_side, amount) = self.ratio_test(tail, head);
        self.push_flow(tail, head, join, amount);
        let (inner, outer, shift) = if on_tail_side { (tail, head, reduced) } else { (head, tail, -reduced) };
        self.shift_potentials(leaving, shift);
        self.detach(leaving);
        self.reroot(inner, leaving);
        self.attach(inner, outer);
        self.flow[inner as usize] = amount;
        self.cost[inner as usize] = cost;
    }

    /// Walks both ends up to where they meet; finds the arc that empties first, the last such on the cycle.
    fn ratio_test(&self, tail: u32, head: u32) -> (u32, u32, bool, M) {
        let (mut a, mut b) = (tail, head);
        let (mut amount, mut leaving, mut on_tail_side) = (M::MAX, NONE, true);
        let n = self.n as u32;
        let mut head_amount = M::MAX;
        let mut head_leaving = NONE;
        while a != b {
            if self.size[a as usize] < self.size[b as usize] {
                if a < n && self.flow[a as usize] < amount {
                    amount = self.flow[a as usize];
                    leaving = a;
                }
                a = self.parent[a as usize];
            } else {
                if b >= n && self.flow[b as usize] <= head_amount {
                    head_amount = self.flow[b as usize];
                    head_leaving = b;
                }
                b = self.parent[b as usize];
            }
        }
        if head_leaving != NONE && head_amount <= amount {
            amount = head_amount;
            leaving = head_leaving;
            on_tail_side = false;
        }
        (a, leaving, on_tail_side, amount)
    }

    fn push_flow(&mut self, tail: u32, head: u32, join: u32, amount: M) {
        if amount == M::ZERO {
            return;
        }
        let n = self.n as u32;
        let mut node = tail;
        while node != join {
            self.flow[node as usize] += if node < n { -amount } else { amount };
            node = self.parent[node as usize];
        }
        node = head;
        while node != join {
            self.flow[node as usize] += if node < n { amount } else { -amount };
            node = self.parent[node as usize];
        }
    }

    /// Adds `shift` to the subtree of `top`, or takes it from all the other nodes when they are fewer.
    fn shift_potentials(&mut self, top: u32, shift: f64) {
        let after = self.next[self.last[top as usize] as usize];
        let (first, end, shift) = if 2 * self.size[top as usize] as usize <= self.pi.len() {
            (top, after, shift)
        } else {
            (after, top, -shift)
        };
        let mut node = first;
        loop {
            self.pi[node as usize] += shift;
            node = self.next[node as usize];
            if node == end {
                break;
            }
        }
    }

    /// Cuts the subtree of `top` out of the preorder and out of its ancestors' counts.
    fn detach(&mut self, top: u32) {
        let (before, last) = (self.prev[top as usize], self.last[top as usize]);
        let after = self.next[last as usize];
        self.next[before as usize] = after;
        self.prev[after as usize] = before;
        let size = self.size[top as usize];
        let mut node = self.parent[top as usize];
        let mut was_last = true;
        while node != NONE {
            self.size[node as usize] -= size;
            was_last = was_last && self.last[node as usize] == last;
            if was_last {
                self.last[node as usize] = before;
            }
            node = self.parent[node as usize];
        }
    }

    /// Makes `inner` the top of the detached subtree of `top`, turning the arcs between them round.
    fn reroot(&mut self, inner: u32, top: u32) {
        if inner == top {
            return;
        }
        self.stem.clear();
        let mut node = inner;
        loop {
            self.stem.push(node);
            if node == top {
                break;
            }
            node = self.parent[node as usize];
        }
        let total = self.size[top as usize];
        // The new preorder lists what each stem node had below it, less the next stem node's part, from the bottom up.
        let mut tail = self.last[inner as usize];
        let mut child_size = self.size[inner as usize];
        let mut child_last = tail;
        let mut child_before = self.prev[inner as usize];
        let mut child_after = self.next[tail as usize];
        for t in 1..self.stem.len() {
            let node = self.stem[t] as usize;
            let (node_size, node_last, node_before) = (self.size[node], self.last[node], self.prev[node]);
            let node_after = if node_last == child_last { child_after } else { self.next[node_last as usize] };
            let own_last = if node_last == child_last {
                child_before
            } else {
                self.next[child_before as usize] = child_after;
                self.prev[child_after as usize] = child_before;
                node_last
            };
            self.size[node] = total - child_size;
            self.next[tail as usize] = node as u32;
            self.prev[node] = tail;
            tail = own_last;
            (child_size, child_last, child_before, child_after) = (node_size, node_last, node_before, node_after);
        }
        self.finish_stem(tail, total);
    }

    /// Turns the parents, flows and costs along the stem and sets the ends of the new subtrees.
    fn finish_stem(&mut self, tail: u32, total: u32) {
        for t in (1..self.stem.len()).rev() {
            let (below, above) = (self.stem[t - 1] as usize, self.stem[t] as usize);
            self.parent[above] = below as u32;
            self.flow[above] = self.flow[below];
            self.cost[above] = self.cost[below];
            self.last[above] = tail;
        }
        let inner = self.stem[0] as usize;
        self.last[inner] = tail;
        self.size[inner] = total;
    }

    /// Hangs the detached subtree of `inner` under `outer`.
    fn attach(&mut self, inner: u32, outer: u32) {
        let (last, after) = (self.last[inner as usize], self.next[outer as usize]);
        self.parent[inner as usize] = outer;
        self.next[outer as usize] = inner;
        self.prev[inner as usize] = outer;
        self.next[last as usize] = after;
        self.prev[after as usize] = last;
        let size = self.size[inner as usize];
        let mut node = outer;
        let mut was_last = true;
        while node != NONE {
            self.size[node as usize] += size;
            was_last = was_last && self.last[node as usize] == outer;
            if was_last {
                self.last[node as usize] = last;
            }
            node = self.parent[node as usize];
        }
    }

    /// Computes all the potentials again from the costs on the tree, which removes the drift of many pivots.
    ///
    /// They are counted from a typical node, so that a few far points do not cost the others their last digits.
    pub fn refresh_potentials(&mut self) {
        let root = self.n + self.m;
        let mut values = self.pi[..root].to_vec();
        let (_, &mut middle, _) = values.select_nth_unstable_by(root / 2, f64::total_cmp);
        self.pi[root] -= middle;
        let mut node = self.next[root] as usize;
        while node != root {
            let above = self.pi[self.parent[node] as usize];
            self.pi[node] = if node < self.n { above + self.cost[node] } else { above - self.cost[node] };
            node = self.next[node] as usize;
        }
    }

    /// Computes all the potentials again, counted from one node and in doubled precision: each is right to half a unit in
    /// its last place, however long its way from that node is.
    pub fn refresh_from(&mut self, node: usize) {
        let root = self.n + self.m;
        let mut rest = vec![f64::NAN; root + 1];
        let mut below = node;
        (self.pi[node], rest[node]) = (0.0, 0.0);
        while below != root {
            let up = self.parent[below] as usize;
            let cost = if below < self.n { -self.cost[below] } else { self.cost[below] };
            (self.pi[up], rest[up]) = longer((self.pi[below], rest[below]), cost);
            below = up;
        }
        let mut node = self.next[root] as usize;
        while node != root {
            if rest[node].is_nan() {
                let up = self.parent[node] as usize;
                let cost = if node < self.n { self.cost[node] } else { -self.cost[node] };
                (self.pi[node], rest[node]) = longer((self.pi[up], rest[up]), cost);
            }
            node = self.next[node] as usize;
        }
    }

    /// The arcs of the tree that carry mass: `(row, column, mass)`, in order of their lower node.
    pub fn arcs(&self) -> impl Iterator<Item = (usize, usize, M)> + '_ {
        let root = (self.n + self.m) as u32;
        (0..self.n + self.m).filter(move |&v| self.parent[v] != root && self.flow[v] > M::ZERO).map(|v| {
            let up = self.parent[v] as usize;
            if v < self.n { (v, up - self.n, self.flow[v]) } else { (up, v - self.n, self.flow[v]) }
        })
    }
}

/// A potential in two parts, one arc further on.
fn longer((value, rest): Pair, cost: f64) -> Pair {
    let (sum, left) = two_sum(value, cost);
    two_sum(sum, left + rest)
}

#[cfg(test)]
mod tests;
