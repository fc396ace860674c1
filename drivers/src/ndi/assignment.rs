//! The assignment problem: the pairs of rows and columns with the minimum sum of costs.
//!
//! With squared distances as costs, a motion that all points share does not change the optimal pairing: it
//! adds the same amount to every pairing. The method is that of Kuhn and Munkres, with one shortest
//! augmenting path per row; rows whose column is free, as most are, cost one pass over the columns. 63
//! markers of a person over a slow line take 0.1 ms a frame; 255 placed at random in a cube of 60 cm in
//! every frame, the worst case found, take 16 to 32 ms, while their reply takes 34 ms on the fastest line.

/// A column and its state in the current search.
#[derive(Debug, Clone, Copy, Default)]
struct Column {
    /// The row assigned to it, counted from 1; 0 when free.
    row: usize,
    potential: f64,
    /// The minimum reduced cost of reaching it, and the column before it on that path.
    min_cost: f64,
    from: usize,
    visited: bool,
}

/// Solver with reusable memory.
#[derive(Debug)]
pub(super) struct Assignment {
    potentials: Vec<f64>,
    columns: Vec<Column>,
}

impl Assignment {
    /// Makes a solver that does not allocate for up to this many rows and columns.
    pub(super) fn new(rows_max: usize, columns_max: usize) -> Self {
        Self {
            potentials: Vec::with_capacity(rows_max + 1),
            columns: Vec::with_capacity(columns_max + rows_max + 1),
        }
    }

    /// Assigns rows to columns. `cost` is infinite for pairs that are not allowed; a row without a column costs
    /// `unassigned_cost`.
    pub(super) fn solve(
        &mut self,
        n_rows: usize,
        n_columns: usize,
        unassigned_cost: f64,
        cost: impl Fn(usize, usize) -> f64,
    ) {
        self.potentials.clear();
        self.potentials.resize(n_rows + 1, 0.0);
        // Column 0 is the root of a search; after the given columns each row has a private one.
        self.columns.clear();
        self.columns.resize(1 + n_columns + n_rows, Column::default());
        for row in 1..=n_rows {
            self.augment(row, &|row, column| {
                if column <= n_columns {
                    cost(row - 1, column - 1)
                } else if column == n_columns + row {
                    unassigned_cost
                } else {
                    f64::INFINITY
                }
            });
        }
        self.columns.truncate(1 + n_columns);
    }

    /// Row and column of every pair, in the order of columns.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (usize, usize)> {
        let columns = self.columns.iter().skip(1).enumerate();
        columns.filter(|(_, column)| column.row > 0).map(|(index, column)| (column.row - 1, index))
    }

    /// Assigns a column to this row along the shortest augmenting path, reassigning other rows where cheaper.
    fn augment(&mut self, row: usize, cost: &dyn Fn(usize, usize) -> f64) {
        let Self { potentials, columns } = self;
        for column in columns.iter_mut() {
            (column.min_cost, column.visited) = (f64::INFINITY, false);
        }
        columns[0].row = row;
        let mut current = 0;
        loop {
            columns[current].visited = true;
            let row = columns[current].row;
            let (mut step, mut next) = (f64::INFINITY, 0);
            for (index, column) in columns.iter_mut().enumerate().skip(1) {
                if column.visited {
                    continue;
                }
                let reduced = cost(row, index) - potentials[row] - column.potential;
                if reduced < column.min_cost {
                    (column.min_cost, column.from) = (reduced, current);
                }
                if column.min_cost < step {
                    (step, next) = (column.min_cost, index);
                }
            }
            for column in columns.iter_mut() {
                if column.visited {
                    potentials[column.row] += step;
                    column.potential -= step;
                } else {
                    column.min_cost -= step;
                }
            }
            current = next;
            // A free column always exists: the row's private one.
            if columns[current].row == 0 {
                break;
            }
        }
        while current != 0 {
            let from = columns[current].from;
            columns[current].row = columns[from].row;
            current = from;
        }
    }
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    /// The minimum sum of costs, by exhaustive search.
    fn least_cost(row: usize, costs: &[Vec<f64>], alone: f64, taken: &mut Vec<bool>) -> f64 {
        let Some(of_row) = costs.get(row) else { return 0.0 };
        let mut best = alone + least_cost(row + 1, costs, alone, taken);
        for (column, cost) in of_row.iter().enumerate() {
            if !taken[column] && cost.is_finite() {
                taken[column] = true;
                best = best.min(cost + least_cost(row + 1, costs, alone, taken));
                taken[column] = false;
            }
        }
        best
    }

    #[test]
    fn the_sum_of_costs_is_minimal() {
        let mut random = Random::new(0x5EED);
        let mut assignment = Assignment::new(5, 6);
        for _ in 0..2000 {
            let (n_rows, n_columns) = (random.below(6), random.below(7));
            let mut cost =
                || if random.one_in(4) { f64::INFINITY } else { random.below(50) as f64 };
            let costs: Vec<Vec<f64>> =
                (0..n_rows).map(|_| (0..n_columns).map(|_| cost()).collect()).collect();
            let alone = 30.0;
            assignment.solve(n_rows, n_columns, alone, |row, column| costs[row][column]);
            let pairs: Vec<_> = assignment.pairs().collect();
            let sum: f64 = pairs.iter().map(|(row, column)| costs[*row][*column]).sum();
            let sum = sum + alone * (n_rows - pairs.len()) as f64;
            assert_eq!(sum, least_cost(0, &costs, alone, &mut vec![false; n_columns]), "{costs:?}");
            let mut rows: Vec<_> = pairs.iter().map(|(row, _)| *row).collect();
            rows.sort_unstable();
            rows.dedup();
            assert_eq!(rows.len(), pairs.len(), "a row has one column");
        }
    }
}
