//! Where the mass of each row is.

/// The columns that each row sends its mass to: one for most rows.
#[derive(Clone, Debug)]
pub struct Places<'a> {
    rows: &'a [i64],
    cols: usize,
    /// The column of a whole row; from `cols` on, which of `splits` tells it.
    place: Vec<u32>,
    /// Masses in every column, one split row after the other.
    splits: Vec<i64>,
    unused: Vec<u32>,
}

impl<'a> Places<'a> {
    /// Every row whole in a column.
    pub fn new(rows: &'a [i64], cols: usize, place: Vec<u32>) -> Self {
        Self { rows, cols, place, splits: Vec::new(), unused: Vec::new() }
    }

    fn split(&self, row: usize) -> Option<usize> {
        let place = self.place[row] as usize;
        (place >= self.cols).then(|| (place - self.cols) * self.cols)
    }

    /// Mass of a row in a column.
    #[inline]
    pub fn flow(&self, row: u32, col: usize) -> i64 {
        match self.split(row as usize) {
            Some(start) => self.splits[start + col],
            None if self.place[row as usize] as usize == col => self.rows[row as usize],
            None => 0,
        }
    }

    /// The rows that have mass in a column.
    pub fn rows_in(&self, col: usize) -> impl Iterator<Item = u32> + '_ {
        let here = move |&(_, &place): &(usize, &u32)| {
            let place = place as usize;
            place == col || (place >= self.cols && self.splits[(place - self.cols) * self.cols + col] > 0)
        };
        self.place.iter().enumerate().filter(here).map(|(row, _)| row as u32)
    }

    /// Moves some of the mass that a row has in one column to another.
    pub fn shift(&mut self, row: u32, from: usize, to: usize, amount: i64) {
        let (row, all) = (row as usize, self.rows[row as usize]);
        let start = match self.split(row) {
            Some(start) => start,
            None if amount == all => {
                self.place[row] = to as u32;
                return;
            }
            None => {
                let start = self.unused.pop().map_or(self.splits.len(), |start| start as usize);
                if start == self.splits.len() {
                    self.splits.resize(start + self.cols, 0);
                }
                self.splits[start + from] = all;
                self.place[row] = (self.cols + start / self.cols) as u32;
                start
            }
        };
        self.splits[start + from] -= amount;
        self.splits[start + to] += amount;
        if self.splits[start + to] == all {
            self.splits[start + to] = 0;
            self.place[row] = to as u32;
            self.unused.push(start as u32);
        }
    }

    /// Masses of the split rows in all columns, for moves that keep the sums of both.
    pub fn splits_mut(&mut self) -> &mut [i64] {
        &mut self.splits
    }

    /// `(row, column, mass)` wherever there is mass, row by row.
    pub fn arcs(&self) -> Vec<(usize, usize, i64)> {
        let mut arcs = Vec::with_capacity(self.rows.len() + self.cols);
        for (row, &mass) in self.rows.iter().enumerate() {
            match self.split(row) {
                None => arcs.push((row, self.place[row] as usize, mass)),
                Some(start) => {
                    let flows = self.splits[start..start + self.cols].iter().enumerate();
                    arcs.extend(flows.filter(|&(_, &flow)| flow > 0).map(|(col, &flow)| (row, col, flow)));
                }
            }
        }
        arcs
    }
}
