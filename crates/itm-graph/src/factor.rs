//! Cholesky factors of sparse symmetric matrices of 6x6 blocks, by the multifrontal method (Duff and Reid 1983, *The
//! Multifrontal Solution of Indefinite Sparse Symmetric Linear Equations*; Liu 1992, *The Multifrontal Method for Sparse
//! Matrix Solution*).
//!
//! Columns that share their rows below the diagonal are eliminated together, in a dense matrix of those rows: a front.
//! What a front leaves for the rows below it is added to its parent's. So most work is in a few dense products, which faer
//! does well; its own sparse factor adds the products of every earlier front one by one, which are small for graphs as
//! sparse as these.
//!
//! One thread, whatever else the process does with faer: the order of all sums is that of the matrix.

use std::ops::Range;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::triangular;
use faer::linalg::matmul::triangular::BlockStructure::{Rectangular, TriangularLower};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::reborrow::{Reborrow, ReborrowMut};
use faer::{Accum, MatMut, Par};
use nalgebra::Matrix6;

use crate::sparse::{BlockMatrix, DOF, Pattern, TooLarge};

/// Neighbouring fronts become one if at most this share of its numbers are zeros, by the most columns (of blocks) that
/// it may have then: larger products are faster by more than the zeros cost.
const MERGE: [(usize, f64); 5] = [(3, 1.0), (6, 0.5), (12, 0.25), (24, 0.1), (usize::MAX, 0.03)];

/// Block columns that are eliminated together.
struct Front {
    columns: Range<usize>,
    /// Block rows below the columns, ascending.
    rows: Vec<usize>,
    /// Where in the front that the rows go to each of them lies.
    in_parent: Vec<usize>,
    children: Vec<usize>,
    /// Where the numbers of its columns lie among those of the factor; the diagonal block and below, by scalar columns.
    values: Range<usize>,
    /// Where what it leaves for its rows lies in the memory for that, while it is needed.
    update: Range<usize>,
}

impl Front {
    /// Scalar columns and rows below them.
    fn shape(&self) -> (usize, usize) {
        (self.columns.len() * DOF, self.rows.len() * DOF)
    }
}

/// What the factor of a matrix looks like.
pub(crate) struct Fronts {
    /// Children before their parents.
    fronts: Vec<Front>,
    /// For each block of the matrix below the diagonal, its row in the front of its column.
    in_front: Vec<usize>,
    /// Numbers in the factor, and at most at a time in what fronts leave for others.
    values: usize,
    updates: usize,
    /// Multiplications and additions for a factor.
    operations: f64,
}

impl Fronts {
    /// The fronts of a matrix with these rows in its columns of the factor, `columns`, and in its own, from `starts` in
    /// `rows`. Columns follow their children in the elimination tree at once.
    pub(crate) fn new(columns: Vec<Vec<usize>>, starts: &[usize], rows: &[usize]) -> Self {
        let mut fronts = merged(columns);
        let mut front_of = Vec::new();
        for (at, front) in fronts.iter().enumerate() {
            front_of.resize(front.columns.end, at);
        }
        let mut in_front = vec![0; rows.len()];
        let mut place = vec![0; front_of.len()];
        let mut values = 0;
        let mut updates = Updates::default();
        for at in 0..fronts.len() {
            let front = &mut fronts[at];
            for (i, row) in front.columns.clone().chain(front.rows.iter().copied()).enumerate() {
                place[row] = i;
            }
            for k in starts[front.columns.start]..starts[front.columns.end] {
                in_front[k] = place[rows[k]];
            }
            let (width, height) = front.shape();
            front.values = values..values + width * (width + height);
            values = front.values.end;
            front.update = updates.take(height * height);
            let parent = front.rows.first().map(|row| front_of[*row]);
            for child in front.children.clone() {
                let in_parent = fronts[child].rows.iter().map(|row| place[*row]).collect();
                fronts[child].in_parent = in_parent;
                updates.free(&fronts[child].update);
            }
            if let Some(parent) = parent {
                fronts[parent].children.push(at);
            }
        }
        let operations = |front: &Front| {
            let (width, height) = front.shape();
            (0..width).map(|column| ((width + height - column) as f64).powi(2)).sum::<f64>()
        };
        let operations = fronts.iter().map(operations).sum();
        Self { fronts, in_front, values, updates: updates.most, operations }
    }

    /// Operations for a factor, for each of its numbers.
    pub(crate) fn operations_by_number(&self) -> f64 {
        self.operations / (self.values as f64).max(1.0)
    }
}

/// Fronts of columns that follow each other, given each column's rows below the diagonal.
fn merged(columns: Vec<Vec<usize>>) -> Vec<Front> {
    // Columns that differ by nothing first, so that these are not torn apart by merging others.
    let mut groups: Vec<(Range<usize>, Vec<usize>)> = Vec::new();
    for (column, rows) in columns.into_iter().enumerate() {
        match groups.last_mut() {
            Some((columns, last)) if last.first() == Some(&column) && last.len() == rows.len() + 1 => {
                columns.end = column + 1;
                *last = rows;
            }
            _ => groups.push((column..column + 1, rows)),
        }
    }
    // With the number of blocks that are zero.
    let mut fronts: Vec<(Front, usize)> = Vec::new();
    for (mut columns, rows) in groups {
        let mut zeros = 0;
        while let Some((child, child_zeros)) = fronts.last() {
            if child.rows.first() != Some(&columns.start) {
                break;
            }
            let child_columns = child.columns.len();
            let width = child_columns + columns.len();
            let new_zeros = child_zeros + zeros + child_columns * (columns.len() + rows.len() - child.rows.len());
            let blocks = width * (width + 1) / 2 + width * rows.len();
            if !MERGE.iter().any(|(most, share)| width <= *most && new_zeros as f64 <= share * blocks as f64) {
                break;
            }
            (columns, zeros) = (child.columns.start..columns.end, new_zeros);
            fronts.pop();
        }
        let (in_parent, children) = (Vec::new(), Vec::new());
        fronts.push((Front { columns, rows, in_parent, children, values: 0..0, update: 0..0 }, zeros));
    }
    fronts.into_iter().map(|(front, _)| front).collect()
}

/// Hands out memory in an order that is known before, the first that is free.
#[derive(Default)]
struct Updates {
    /// Ascending.
    taken: Vec<Range<usize>>,
    most: usize,
}

impl Updates {
    fn take(&mut self, length: usize) -> Range<usize> {
        if length == 0 {
            return 0..0;
        }
        let (mut at, mut start) = (0, 0);
        while let Some(taken) = self.taken.get(at).filter(|taken| taken.start - start < length) {
            (at, start) = (at + 1, taken.end);
        }
        self.taken.insert(at, start..start + length);
        self.most = self.most.max(start + length);
        start..start + length
    }

    fn free(&mut self, range: &Range<usize>) {
        self.taken.retain(|taken| taken != range);
    }
}

/// The Cholesky factor `L Lᵀ` of a [`BlockMatrix`], and the memory to find it again.
pub(crate) struct Factor {
    values: Vec<f64>,
    updates: Vec<f64>,
    /// Numbers of a front's rows, when solving.
    below: Vec<f64>,
    memory: MemBuffer,
    found: bool,
}

impl Factor {
    /// Memory for factors of a pattern.
    pub(crate) fn new(pattern: &Pattern) -> Result<Self, TooLarge> {
        let fronts = &pattern.fronts;
        let (mut width, mut height) = (0, 0);
        for front in &fronts.fronts {
            let (w, h) = front.shape();
            (width, height) = (width.max(w), height.max(h));
        }
        let scratch = cholesky_in_place_scratch::<f64>(width, Par::Seq, Default::default());
        Ok(Self {
            values: zeros(fronts.values)?,
            updates: zeros(fronts.updates)?,
            below: zeros(height)?,
            memory: MemBuffer::try_new(scratch).map_err(|_| TooLarge)?,
            found: false,
        })
    }

    /// Factorises a matrix with `added` on its diagonal. Whether it was positive definite; if not, there is no factor.
    pub(crate) fn factorise(&mut self, pattern: &Pattern, matrix: &BlockMatrix, added: &[f64]) -> bool {
        let Fronts { fronts, in_front, .. } = &pattern.fronts;
        self.found = fronts.iter().all(|front| {
            let (width, height) = front.shape();
            let rows = width + height;
            let values = &mut self.values[front.values.clone()];
            clear_lower(values, rows);
            for (at, column) in front.columns.clone().enumerate() {
                put(values, rows, [at, at], &matrix.diagonals[column]);
                let blocks = pattern.starts[column]..pattern.starts[column + 1];
                for (row, block) in in_front[blocks.clone()].iter().zip(&matrix.blocks[blocks]) {
                    put(values, rows, [*row, at], block);
                }
            }
            let scalars = front.columns.start * DOF..front.columns.end * DOF;
            for (at, added) in added.get(scalars).into_iter().flatten().enumerate() {
                values[at * (rows + 1)] += added;
            }
            clear_lower(&mut self.updates[front.update.clone()], height);
            for child in &front.children {
                let child = &fronts[*child];
                let (update, left) = apart(&mut self.updates, &front.update, &child.update);
                add_child(child, left, values, update, front);
            }

            let (mut diagonal, mut below) =
                MatMut::from_column_major_slice_mut(values, rows, width).split_at_row_mut(width);
            let stack = MemStack::new(&mut self.memory);
            if cholesky_in_place(diagonal.rb_mut(), Default::default(), Par::Seq, stack, Default::default()).is_err() {
                return false;
            }
            solve_lower_triangular_in_place(diagonal.rb(), below.rb_mut().transpose_mut(), Par::Seq);
            triangular::matmul(
                MatMut::from_column_major_slice_mut(&mut self.updates[front.update.clone()], height, height),
                TriangularLower,
                Accum::Add,
                below.rb(),
                Rectangular,
                below.rb().transpose(),
                Rectangular,
                -1.0,
                Par::Seq,
            );
            true
        });
        self.found
    }

    /// Whether there is a factor, of the matrix that was factorised last.
    pub(crate) fn is_found(&self) -> bool {
        self.found
    }

    /// Replaces columns of right-hand sides, one after the other in `columns`, by the solutions.
    pub(crate) fn solve(&mut self, pattern: &Pattern, columns: &mut [f64]) {
        // Most fronts are so small that calls of faer's, made for large matrices, take longer than what they do.
        let fronts = &pattern.fronts.fronts;
        for front in fronts {
            let (width, height) = front.shape();
            let factor = &self.values[front.values.clone()];
            let below = &mut self.below[..height];
            for x in columns.chunks_exact_mut(pattern.size()) {
                below.fill(0.0);
                let own = &mut x[front.columns.start * DOF..][..width];
                for (j, column) in factor.chunks_exact(width + height).enumerate() {
                    let (diagonal, rest) = column.split_at(width);
                    own[j] /= diagonal[j];
                    let solved = own[j];
                    subtract(&mut own[j + 1..], solved, &diagonal[j + 1..]);
                    subtract(below, solved, rest);
                }
                for (row, known) in front.rows.iter().zip(below.as_chunks::<DOF>().0) {
                    for (x, known) in x[row * DOF..][..DOF].iter_mut().zip(known) {
                        *x += known;
                    }
                }
            }
        }
        for front in fronts.iter().rev() {
            let (width, height) = front.shape();
            let factor = &self.values[front.values.clone()];
            let below = &mut self.below[..height];
            for x in columns.chunks_exact_mut(pattern.size()) {
                for (row, known) in front.rows.iter().zip(below.as_chunks_mut::<DOF>().0) {
                    known.copy_from_slice(&x[row * DOF..][..DOF]);
                }
                let own = &mut x[front.columns.start * DOF..][..width];
                for (j, column) in factor.chunks_exact(width + height).enumerate().rev() {
                    let (diagonal, rest) = column.split_at(width);
                    let known = dot(&diagonal[j + 1..], &own[j + 1..]) + dot(rest, below);
                    own[j] = (own[j] - known) / diagonal[j];
                }
            }
        }
    }
}

/// `a -= x b`.
fn subtract(a: &mut [f64], x: f64, b: &[f64]) {
    for (a, b) in a.iter_mut().zip(b) {
        *a -= x * b;
    }
}

/// The product of two vectors, in eight sums, which an adder works on at once.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

fn zeros(length: usize) -> Result<Vec<f64>, TooLarge> {
    // Pages that the system hands out as zeros need not be written, but there is only a way to try for others.
    Vec::<f64>::new().try_reserve_exact(length).map_err(|_| TooLarge)?;
    Ok(vec![0.0; length])
}

/// Makes columns of `rows` scalars each zero from their diagonal block on.
fn clear_lower(values: &mut [f64], rows: usize) {
    if rows > 0 {
        for (at, column) in values.chunks_exact_mut(rows).enumerate() {
            column[at / DOF * DOF..].fill(0.0);
        }
    }
}

/// Writes a block into columns of `rows` scalars each, at a block row and column.
fn put(values: &mut [f64], rows: usize, [row, column]: [usize; 2], block: &Matrix6<f64>) {
    for (j, from) in block.as_slice().chunks_exact(DOF).enumerate() {
        let start = (column * DOF + j) * rows + row * DOF;
        values[start..start + DOF].copy_from_slice(from);
    }
}

/// Two ranges that do not overlap, the first to write to.
fn apart<'a>(all: &'a mut [f64], write: &Range<usize>, read: &Range<usize>) -> (&'a mut [f64], &'a [f64]) {
    if write.start < read.start || write.is_empty() {
        let (low, high) = all.split_at_mut(read.start);
        (&mut low[write.start.min(read.start)..write.end.min(read.start)], &high[..read.len()])
    } else {
        let (low, high) = all.split_at_mut(write.start);
        (&mut high[..write.len()], &low[read.clone()])
    }
}

/// Adds what a child `left` to its parent's columns and to what the parent leaves in turn.
fn add_child(child: &Front, left: &[f64], values: &mut [f64], update: &mut [f64], parent: &Front) {
    let (width, height) = parent.shape();
    let child_rows = child.rows.len() * DOF;
    for (j, column) in child.in_parent.iter().enumerate() {
        let within = *column < parent.columns.len();
        let (first, column, rows) = if within {
            (0, *column, width + height)
        } else {
            (parent.columns.len(), column - parent.columns.len(), height)
        };
        let into = if within { &mut *values } else { &mut *update };
        for k in 0..DOF {
            let from = &left[(j * DOF + k) * child_rows..][..child_rows];
            let into = &mut into[(column * DOF + k) * rows..][..rows];
            let (from, into) = (from.as_chunks::<DOF>().0, into.as_chunks_mut::<DOF>().0);
            for (row, from) in child.in_parent[j..].iter().zip(&from[j..]) {
                for (sum, x) in into[row - first].iter_mut().zip(from) {
                    *sum += x;
                }
            }
        }
    }
}
