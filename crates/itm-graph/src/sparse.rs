//! Sparse symmetric matrices of 6x6 blocks, and their Cholesky factor by faer.
//!
//! One thread, whatever else the process does with faer: the order of all sums is that of the matrix.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{FaerError, SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
use nalgebra::Matrix6;

/// Rows of a block.
pub(crate) const DOF: usize = 6;

/// Which blocks of a symmetric matrix are there, in an order of columns that keeps its factor sparse, and what its
/// factor looks like. Found once, for any number of matrices of that pattern.
pub(crate) struct Pattern {
    /// Scalar columns of the upper triangle: where each starts, and its rows.
    column_starts: Vec<usize>,
    rows: Vec<usize>,
    /// For each block column, the block rows above the diagonal, ascending.
    above: Vec<Vec<usize>>,
    /// For each variable, its block column.
    column_of: Vec<usize>,
    factor: SymbolicCholesky<usize>,
}

/// Where the block of two variables lies in a [`Pattern`].
#[derive(Clone, Copy)]
pub(crate) struct Place {
    column: usize,
    /// Number of blocks above it in its column.
    depth: usize,
    /// Whether the block is stored as its transpose.
    transposed: bool,
}

impl Pattern {
    /// The pattern of a matrix over `variables` with all diagonal blocks and the blocks of `pairs`, each of two
    /// different variables.
    pub(crate) fn new(variables: usize, pairs: &[[usize; 2]]) -> Result<Self, FaerError> {
        // Ordering the graph of blocks instead of that of scalars finds the same kind of order 36 times faster.
        let identity: Vec<usize> = (0..variables).collect();
        let column_of = minimum_degree(&above_diagonal(&identity, pairs))?;
        let above = above_diagonal(&column_of, pairs);
        let (column_starts, rows) = expand(&above);
        let matrix =
            SymbolicSparseColMatRef::new_checked(variables * DOF, variables * DOF, &column_starts, None, &rows);
        let parameters = CholeskySymbolicParams::default();
        let factor = factorize_symbolic_cholesky(matrix, Side::Upper, SymmetricOrdering::Identity, parameters)?;
        Ok(Self { column_starts, rows, above, column_of, factor })
    }

    /// Where the block of two variables lies, if it is there.
    pub(crate) fn place(&self, row: usize, column: usize) -> Option<Place> {
        let (a, b) = (self.column_of[row], self.column_of[column]);
        let depth = self.above[a.max(b)].binary_search(&a.min(b)).ok()?;
        Some(Place { column: a.max(b), depth, transposed: a > b })
    }

    /// The scalar row of a variable's first coordinate.
    pub(crate) fn row(&self, variable: usize) -> usize {
        self.column_of[variable] * DOF
    }

    /// Number of scalar rows.
    pub(crate) fn size(&self) -> usize {
        self.column_of.len() * DOF
    }

    fn matrix<'a>(&'a self, values: &'a [f64]) -> SparseColMatRef<'a, usize, f64> {
        let size = self.size();
        let pattern = SymbolicSparseColMatRef::new_checked(size, size, &self.column_starts, None, &self.rows);
        SparseColMatRef::new(pattern, values)
    }
}

/// For each block column, the rows above the diagonal, ascending.
fn above_diagonal(column_of: &[usize], pairs: &[[usize; 2]]) -> Vec<Vec<usize>> {
    let mut above = vec![Vec::new(); column_of.len()];
    for pair in pairs {
        let [a, b] = pair.map(|variable| column_of[variable]);
        above[a.max(b)].push(a.min(b));
    }
    for rows in &mut above {
        rows.sort_unstable();
        rows.dedup();
    }
    above
}

/// For each variable its place in an elimination order by approximate minimum degree (Amestoy, Davis and Duff 1996).
fn minimum_degree(above: &[Vec<usize>]) -> Result<Vec<usize>, FaerError> {
    let n = above.len();
    let mut starts = vec![0];
    let mut rows = Vec::new();
    for (column, above) in above.iter().enumerate() {
        rows.extend_from_slice(above);
        rows.push(column);
        starts.push(rows.len());
    }
    let graph = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
    let (mut order, mut place) = (vec![0; n], vec![0; n]);
    let mut memory =
        MemBuffer::try_new(amd::order_scratch::<usize>(n, rows.len())).map_err(|_| FaerError::OutOfMemory)?;
    amd::order(&mut order, &mut place, graph, amd::Control::default(), MemStack::new(&mut memory))?;
    Ok(place)
}

/// The scalar columns of an upper triangle of blocks.
fn expand(above: &[Vec<usize>]) -> (Vec<usize>, Vec<usize>) {
    let mut starts = vec![0];
    let mut rows = Vec::new();
    for (column, above) in above.iter().enumerate() {
        for i in 0..DOF {
            rows.extend(above.iter().flat_map(|row| row * DOF..(row + 1) * DOF));
            rows.extend(column * DOF..=column * DOF + i);
            starts.push(rows.len());
        }
    }
    (starts, rows)
}

/// The numbers of a symmetric matrix of some [`Pattern`].
pub(crate) struct BlockMatrix {
    values: Vec<f64>,
}

impl BlockMatrix {
    pub(crate) fn zeros(pattern: &Pattern) -> Self {
        Self { values: vec![0.0; pattern.rows.len()] }
    }

    pub(crate) fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds to the diagonal block of a variable.
    pub(crate) fn add_diagonal(&mut self, pattern: &Pattern, variable: usize, block: &Matrix6<f64>) {
        let column = pattern.column_of[variable];
        for j in 0..DOF {
            let end = pattern.column_starts[column * DOF + j + 1];
            for (value, b) in self.values[end - j - 1..end].iter_mut().zip(block.column(j).iter()) {
                *value += b;
            }
        }
    }

    /// Adds to the block of two variables at a [`Place`], `block` having the rows of the first.
    pub(crate) fn add(&mut self, pattern: &Pattern, place: Place, block: &Matrix6<f64>) {
        let block = if place.transposed { block.transpose() } else { *block };
        for j in 0..DOF {
            let start = pattern.column_starts[place.column * DOF + j] + place.depth * DOF;
            for (value, b) in self.values[start..start + DOF].iter_mut().zip(block.column(j).iter()) {
                *value += b;
            }
        }
    }

    /// The scalar diagonal.
    pub(crate) fn diagonal(&self, pattern: &Pattern) -> Vec<f64> {
        pattern.column_starts[1..].iter().map(|end| self.values[end - 1]).collect()
    }
}

/// The Cholesky factor `L Lᵀ` of a [`BlockMatrix`], and the memory to find it again.
pub(crate) struct Factor {
    /// The matrix that was factorised last.
    matrix: Vec<f64>,
    values: Vec<f64>,
    memory: MemBuffer,
}

impl Factor {
    /// Memory for factors of a pattern, and for solving with up to `columns` right-hand sides at once.
    pub(crate) fn new(pattern: &Pattern, columns: usize) -> Result<Self, FaerError> {
        let scratch = pattern
            .factor
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default())
            .or(pattern.factor.solve_in_place_scratch::<f64>(columns, Par::Seq));
        Ok(Self {
            matrix: vec![0.0; pattern.rows.len()],
            values: vec![0.0; pattern.factor.len_val()],
            memory: MemBuffer::try_new(scratch).map_err(|_| FaerError::OutOfMemory)?,
        })
    }

    /// Factorises a matrix with `added` on its diagonal. Whether it was positive definite; if not, there is no factor.
    pub(crate) fn factorise(&mut self, pattern: &Pattern, matrix: &BlockMatrix, added: &[f64]) -> bool {
        self.matrix.copy_from_slice(&matrix.values);
        for (end, added) in pattern.column_starts[1..].iter().zip(added) {
            self.matrix[end - 1] += added;
        }
        let factor = pattern.factor.factorize_numeric_llt(
            &mut self.values,
            pattern.matrix(&self.matrix),
            Side::Upper,
            LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut self.memory),
            Default::default(),
        );
        factor.is_ok()
    }

    /// Replaces columns of right-hand sides, one after the other in `columns`, by the solutions.
    pub(crate) fn solve(&mut self, pattern: &Pattern, columns: &mut [f64]) {
        let size = pattern.size();
        let count = columns.len() / size;
        LltRef::new(&pattern.factor, &self.values).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(columns, size, count),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
                matrix.add(&pattern, pattern.place(*a, *b).unwrap(), &block);
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
            let mut factor = Factor::new(&pattern, 2).unwrap();
            prop_assert!(factor.factorise(&pattern, &matrix, &added));
            let expected = DMatrix::from_fn(pattern.size(), 2, |i, j| numbers[(i + 50 * j) % numbers.len()]);
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
        let mut factor = Factor::new(&pattern, 1).unwrap();
        assert!(!factor.factorise(&pattern, &matrix, &[]));
        assert!(factor.factorise(&pattern, &matrix, &[1.0; 18]));
        assert!(!factor.factorise(&pattern, &matrix, &[f64::NAN; 18]));
        assert!(pattern.place(0, 2).is_none());
    }
}
