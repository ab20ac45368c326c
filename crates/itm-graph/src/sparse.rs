//! Sparse symmetric matrices of 6x6 blocks.

use nalgebra::{Matrix6, Vector6};

use crate::factor::Fronts;
use crate::order::nested_dissection;

/// Rows of a block.
pub(crate) const DOF: usize = 6;

/// A matrix that memory has no room for.
#[derive(Debug)]
pub(crate) struct TooLarge;

/// Which blocks of a symmetric matrix are there, in an order of columns that keeps its factor sparse, and what its
/// factor looks like. Found once, for any number of matrices of that pattern.
pub(crate) struct Pattern {
    /// Block columns of the lower triangle without the diagonal: where each starts, and its rows, ascending.
    pub(crate) starts: Vec<usize>,
    pub(crate) rows: Vec<usize>,
    /// For each variable, its block column.
    column_of: Vec<usize>,
    pub(crate) fronts: Fronts,
}

/// Where the block of two variables lies in a [`Pattern`].
#[derive(Clone, Copy)]
pub(crate) struct Place {
    at: usize,
    /// Whether the block is stored as its transpose.
    transposed: bool,
}

impl Pattern {
    /// The pattern of a matrix over `variables` with all diagonal blocks and the blocks of `pairs`, each of two
    /// different variables.
    pub(crate) fn new(variables: usize, pairs: &[[usize; 2]]) -> Result<Self, TooLarge> {
        let mut column_of = nested_dissection(variables, pairs);
        let (columns, new_of) = postordered(factor_columns(&below_diagonal(&column_of, pairs)));
        for column in &mut column_of {
            *column = new_of[*column];
        }
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for below in below_diagonal(&column_of, pairs) {
            rows.extend(below);
            starts.push(rows.len());
        }
        let fronts = Fronts::new(columns, &starts, &rows);
        Ok(Self { starts, rows, column_of, fronts })
    }

    /// Where the block of two variables lies, if it is there.
    pub(crate) fn place(&self, row: usize, column: usize) -> Option<Place> {
        let (a, b) = (self.column_of[row], self.column_of[column]);
        let start = self.starts[a.min(b)];
        let at = start + self.rows[start..self.starts[a.min(b) + 1]].binary_search(&a.max(b)).ok()?;
        Some(Place { at, transposed: a < b })
    }

    /// The scalar row of a variable's first coordinate.
    pub(crate) fn row(&self, variable: usize) -> usize {
        self.column_of[variable] * DOF
    }

    /// Number of scalar rows.
    pub(crate) fn size(&self) -> usize {
        self.column_of.len() * DOF
    }
}

/// For each block column, the rows below the diagonal, ascending.
fn below_diagonal(column_of: &[usize], pairs: &[[usize; 2]]) -> Vec<Vec<usize>> {
    let mut below = vec![Vec::new(); column_of.len()];
    for pair in pairs {
        let [a, b] = pair.map(|variable| column_of[variable]);
        below[a.min(b)].push(a.max(b));
    }
    for rows in &mut below {
        rows.sort_unstable();
        rows.dedup();
    }
    below
}

/// For each block column, the rows below the diagonal of the factor, given those of the matrix.
fn factor_columns(below: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let mut columns: Vec<Vec<usize>> = Vec::with_capacity(below.len());
    let mut children = vec![Vec::new(); below.len()];
    // For each row the last column that has it.
    let mut seen = vec![usize::MAX; below.len()];
    for (column, below) in below.iter().enumerate() {
        let mut rows = Vec::new();
        seen[column] = column;
        // What a child leaves goes to its rows, the first of which is this column.
        let inherited = children[column].iter().flat_map(|child: &usize| &columns[*child]);
        for row in below.iter().chain(inherited) {
            if seen[*row] != column {
                seen[*row] = column;
                rows.push(*row);
            }
        }
        if let Some(parent) = rows.iter().min() {
            children[*parent].push(column);
        }
        columns.push(rows);
    }
    columns
}

/// The columns of a factor so reordered that each follows its children in the elimination tree at once, which leaves the
/// factor as sparse as it is; and for each its new place.
fn postordered(columns: Vec<Vec<usize>>) -> (Vec<Vec<usize>>, Vec<usize>) {
    let parents: Vec<Option<usize>> = columns.iter().map(|rows| rows.iter().min().copied()).collect();
    let mut children = vec![Vec::new(); columns.len()];
    let mut open = Vec::new();
    for (column, parent) in parents.iter().enumerate() {
        parent.map_or(&mut open, |parent| &mut children[parent]).push(column);
    }
    // From the last column to the first: the child with the most rows stands next to its parent, where it may become one
    // front with it.
    let mut order = Vec::with_capacity(columns.len());
    while let Some(column) = open.pop() {
        order.push(column);
        children[column].sort_by_key(|child| columns[*child].len());
        open.append(&mut children[column]);
    }
    order.reverse();
    let mut new_of = vec![0; columns.len()];
    for (new, old) in order.iter().enumerate() {
        new_of[*old] = new;
    }
    let renamed = order.iter().map(|old| {
        let mut rows: Vec<usize> = columns[*old].iter().map(|row| new_of[*row]).collect();
        rows.sort_unstable();
        rows
    });
    (renamed.collect(), new_of)
}

/// The numbers of a symmetric matrix of some [`Pattern`].
pub(crate) struct BlockMatrix {
    pub(crate) diagonals: Vec<Matrix6<f64>>,
    /// Below the diagonal.
    pub(crate) blocks: Vec<Matrix6<f64>>,
}

impl BlockMatrix {
    pub(crate) fn zeros(pattern: &Pattern) -> Self {
        let zeros = |length| vec![Matrix6::zeros(); length];
        Self { diagonals: zeros(pattern.column_of.len()), blocks: zeros(pattern.rows.len()) }
    }

    pub(crate) fn clear(&mut self) {
        self.diagonals.fill(Matrix6::zeros());
        self.blocks.fill(Matrix6::zeros());
    }

    /// Adds to the diagonal block of a variable.
    pub(crate) fn add_diagonal(&mut self, pattern: &Pattern, variable: usize, block: &Matrix6<f64>) {
        self.diagonals[pattern.column_of[variable]] += block;
    }

    /// Adds to the block of two variables at a [`Place`], `block` having the rows of the first.
    pub(crate) fn add(&mut self, place: Place, block: &Matrix6<f64>) {
        if place.transposed {
            self.blocks[place.at] += block.transpose();
        } else {
            self.blocks[place.at] += block;
        }
    }

    /// The scalar diagonal.
    pub(crate) fn diagonal(&self) -> Vec<f64> {
        self.diagonals.iter().flat_map(|block| (0..DOF).map(|i| block[(i, i)])).collect()
    }

    /// Its product with a vector.
    pub(crate) fn times(&self, pattern: &Pattern, x: &[f64]) -> Vec<f64> {
        let part = |i: usize| Vector6::from_column_slice(&x[i * DOF..(i + 1) * DOF]);
        let mut product = vec![0.0; x.len()];
        let mut add = |i: usize, sum: Vector6<f64>| {
            for (p, s) in product[i * DOF..(i + 1) * DOF].iter_mut().zip(sum.iter()) {
                *p += s;
            }
        };
        for (j, diagonal) in self.diagonals.iter().enumerate() {
            let x = part(j);
            let mut sum = diagonal * x;
            for k in pattern.starts[j]..pattern.starts[j + 1] {
                let i = pattern.rows[k];
                sum += self.blocks[k].tr_mul(&part(i));
                add(i, self.blocks[k] * x);
            }
            add(j, sum);
        }
        product
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factor::Factor;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solutions_are_those_of_the_dense_matrix(
            variables in 1..30usize,
            pairs in prop::collection::vec((0..30usize, 0..30usize), 0..90),
            numbers in prop::collection::vec(-1.0..1.0f64, 97),
        ) {
            let pairs: Vec<_> = pairs
                .iter()
                .map(|(a, b)| [a % variables, b % variables])
                .filter(|[a, b]| a != b)
                .collect();
            let pattern = Pattern::new(variables, &pairs).unwrap();
            let mut matrix = BlockMatrix::zeros(&pattern);
            let mut dense = DMatrix::<f64>::zeros(pattern.size(), pattern.size());
            for (k, [a, b]) in pairs.iter().enumerate() {
                let block = Matrix6::from_fn(|r, c| numbers[(31 * k + 6 * r + c) % numbers.len()]);
                matrix.add(pattern.place(*a, *b).unwrap(), &block);
                let (row, column) = (pattern.row(*a), pattern.row(*b));
                let mut upper = dense.view_mut((row, column), (DOF, DOF));
                upper += block;
                let mut lower = dense.view_mut((column, row), (DOF, DOF));
                lower += block.transpose();
            }
            for variable in 0..variables {
                let block = Matrix6::identity() * 600.0 + Matrix6::from_element(1.0);
                matrix.add_diagonal(&pattern, variable, &block);
                let mut view = dense.view_mut((pattern.row(variable), pattern.row(variable)), (DOF, DOF));
                view += block;
            }
            let added: Vec<f64> = (0..pattern.size()).map(|i| i as f64).collect();
            dense += DMatrix::from_diagonal(&DVector::from_vec(added.clone()));
            let mut factor = Factor::new(&pattern).unwrap();
            prop_assert!(factor.factorise(&pattern, &matrix, &added));
            let expected = DMatrix::from_fn(pattern.size(), 2, |i, j| numbers[(i + 50 * j) % numbers.len()]);
            let without = &dense - DMatrix::from_diagonal(&DVector::from_vec(added.clone()));
            let product = DVector::from_vec(matrix.times(&pattern, expected.column(0).as_slice()));
            prop_assert!((product - without * expected.column(0)).amax() < 1e-9);
            let mut columns = (&dense * &expected).as_slice().to_vec();
            factor.solve(&pattern, &mut columns);
            let found = DMatrix::from_vec(pattern.size(), 2, columns);
            prop_assert!((found - expected).amax() < 1e-10);
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_has_no_factor() {
        let pattern = Pattern::new(3, &[[0, 1]]).unwrap();
        let matrix = BlockMatrix::zeros(&pattern);
        let mut factor = Factor::new(&pattern).unwrap();
        assert!(!factor.factorise(&pattern, &matrix, &[]));
        assert!(factor.factorise(&pattern, &matrix, &[1.0; 18]));
        assert!(!factor.factorise(&pattern, &matrix, &[f64::NAN; 18]));
        assert!(pattern.place(0, 2).is_none());
    }
}
