//! Makes an optimal plan basic: its arcs with mass form no cycle.

/// Pushes mass round the cycles of a plan (row by row, `cols` columns) until none is left.
///
/// The plan must be optimal: then every way round a cycle costs nothing.
pub fn remove_cycles(flow: &mut [i64], cols: usize) {
    let split: Vec<usize> = (0..flow.len() / cols).filter(|&i| targets(flow, cols, i).nth(1).is_some()).collect();
    // Nodes: the columns, then the rows with several columns; rows with one column are on no cycle.
    let mut links: Vec<Vec<usize>> = vec![Vec::new(); cols + split.len()];
    let place = |a: usize, b: usize| if a < cols { split[b - cols] * cols + a } else { split[a - cols] * cols + b };
    for (k, &row) in split.iter().enumerate() {
        let node = cols + k;
        for col in targets(flow, cols, row).collect::<Vec<_>>() {
            if flow[row * cols + col] == 0 {
                continue;
            }
            if let Some(path) = path_between(&links, node, col) {
                let steps: Vec<(usize, usize)> = path.windows(2).map(|pair| (pair[0], pair[1])).collect();
                let amount = steps.iter().step_by(2).map(|&(a, b)| flow[place(a, b)]).min().unwrap_or(0);
                flow[row * cols + col] += amount;
                for (number, &(a, b)) in steps.iter().enumerate() {
                    flow[place(a, b)] += if number % 2 == 0 { -amount } else { amount };
                    if flow[place(a, b)] == 0 {
                        links[a].retain(|&other| other != b);
                        links[b].retain(|&other| other != a);
                    }
                }
            }
            links[node].push(col);
            links[col].push(node);
        }
    }
}

fn targets(flow: &[i64], cols: usize, row: usize) -> impl Iterator<Item = usize> + '_ {
    let row_flow = &flow[row * cols..(row + 1) * cols];
    row_flow.iter().enumerate().filter(|&(_, &flow)| flow > 0).map(|(col, _)| col)
}

/// The nodes from `start` to `end` in a forest, both included.
fn path_between(links: &[Vec<usize>], start: usize, end: usize) -> Option<Vec<usize>> {
    let mut before = vec![usize::MAX; links.len()];
    before[start] = start;
    let mut stack = vec![start];
    while let Some(node) = stack.pop() {
        if node == end {
            let mut path = vec![end];
            let mut node = end;
            while node != start {
                node = before[node];
                path.push(node);
            }
            path.reverse();
            return Some(path);
        }
        for &next in &links[node] {
            if before[next] == usize::MAX {
                before[next] = node;
                stack.push(next);
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn margins_stay_and_few_arcs_are_left() {
        for salt in 0..200u64 {
            let (rows, cols) = (9, 4);
            let mut flow: Vec<i64> =
                (0..rows * cols).map(|k| ((k as u64 + 3 * salt).wrapping_mul(2_654_435_761) >> 7) as i64 % 5).collect();
            let margins = |flow: &[i64]| -> Vec<i64> {
                let row_sums = flow.chunks(cols).map(|row| row.iter().sum());
                row_sums.chain((0..cols).map(|j| flow.iter().skip(j).step_by(cols).sum())).collect()
            };
            let before = margins(&flow);
            remove_cycles(&mut flow, cols);
            assert_eq!(margins(&flow), before);
            assert!(flow.iter().all(|&f| f >= 0));
            assert!(flow.iter().filter(|&&f| f > 0).count() < rows + cols);
        }
    }
}
