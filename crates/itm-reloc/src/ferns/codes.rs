//! Codes of many keyframes, packed so that they are compared quickly.

/// The ferns' codes of keyframes, a row each.
///
/// A row is a plane of bits for each test of a fern; bit `i` of plane `t` is the outcome of test `t` of fern `i`, and the bits
/// beyond the last fern are 0. Two codes differ where any of their planes do, so that a word of each plane compares 64
/// ferns.
///
/// That takes the same time whatever the codes are: 0.2 ms for 10,000 keyframes of 1000 ferns x 4 tests on the machine where
/// lists of keyframes by code, as in the paper, took 3.1 ms, because most views share some codes with most keyframes, and codes
/// packed one after the other, four bits each, 0.37 ms.
#[derive(Clone, Debug)]
pub(super) struct CodeTable {
    tests: usize,
    /// 64-bit words in a plane.
    words: usize,
    /// Bits of a plane's last word that belong to ferns.
    last_word: u64,
    /// The rows one after the other.
    rows: Vec<u64>,
}

impl CodeTable {
    /// An empty table for a number of ferns, at least 1, each of 1 to 8 tests.
    pub(super) fn new(ferns: usize, tests: usize) -> Self {
        debug_assert!(ferns >= 1 && (1..=8).contains(&tests));
        let words = ferns.div_ceil(64);
        Self { tests, words, last_word: u64::MAX >> (64 * words - ferns), rows: Vec::new() }
    }

    /// Words in a row.
    pub(super) fn row_len(&self) -> usize {
        self.tests * self.words
    }

    /// Packs the outcomes of all tests, fern after fern.
    pub(super) fn row(&self, outcomes: impl Iterator<Item = bool>) -> Vec<u64> {
        let mut row = vec![0; self.row_len()];
        for (index, outcome) in outcomes.enumerate() {
            let (fern, test) = (index / self.tests, index % self.tests);
            row[test * self.words + fern / 64] |= u64::from(outcome) << (fern % 64);
        }
        row
    }

    /// A bit for each fern, of those that all of `known` is true for: whether each test's pixel is known, fern after fern.
    pub(super) fn mask(&self, known: impl Iterator<Item = bool>) -> Vec<u64> {
        let mut mask = vec![u64::MAX; self.words];
        mask[self.words - 1] = self.last_word;
        for (index, _) in known.enumerate().filter(|(_, known)| !known) {
            let fern = index / self.tests;
            mask[fern / 64] &= !(1 << (fern % 64));
        }
        mask
    }

    /// Whether words are a row of this table: of its length, and 0 where there is no fern.
    pub(super) fn is_row(&self, row: &[u64]) -> bool {
        row.len() == self.row_len() && row.chunks(self.words).all(|plane| plane[self.words - 1] & !self.last_word == 0)
    }

    /// Adds a row at the end.
    pub(super) fn push(&mut self, row: &[u64]) {
        debug_assert!(self.is_row(row));
        self.rows.extend_from_slice(row);
    }

    /// Keeps the rows whose index `keep` is true for, in their order.
    pub(super) fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        let row_len = self.row_len();
        let mut index = 0;
        self.rows.retain(|_| {
            let kept = keep(index / row_len);
            index += 1;
            kept
        });
    }

    /// The rows in their order.
    pub(super) fn rows(&self) -> impl Iterator<Item = &[u64]> {
        self.rows.chunks_exact(self.row_len())
    }

    /// Number of ferns, of those in a [`CodeTable::mask`], whose codes differ between two rows.
    pub(super) fn differing(&self, one: &[u64], other: &[u64], mask: &[u64]) -> u32 {
        let mut found = 0;
        compare_rows(self.tests, mask, one, other, |_, differing| found = differing);
        found
    }

    /// Calls `each` with every row's index and the number of ferns, of those in a [`CodeTable::mask`], whose codes differ from those
    /// of `row`, in the rows' order.
    pub(super) fn compare(&self, row: &[u64], mask: &[u64], each: impl FnMut(usize, u32)) {
        compare_rows(self.tests, mask, &self.rows, row, each);
    }
}

fn compare_rows(tests: usize, mask: &[u64], rows: &[u64], row: &[u64], each: impl FnMut(usize, u32)) {
    // A loop for each number of tests: with the number known, planes are joined in registers.
    match tests {
        1 => compare_planes::<1>(mask, rows, row, each),
        2 => compare_planes::<2>(mask, rows, row, each),
        3 => compare_planes::<3>(mask, rows, row, each),
        4 => compare_planes::<4>(mask, rows, row, each),
        5 => compare_planes::<5>(mask, rows, row, each),
        6 => compare_planes::<6>(mask, rows, row, each),
        7 => compare_planes::<7>(mask, rows, row, each),
        _ => compare_planes::<8>(mask, rows, row, each),
    }
}

fn compare_planes<const TESTS: usize>(mask: &[u64], rows: &[u64], row: &[u64], mut each: impl FnMut(usize, u32)) {
    fn planes<const TESTS: usize>(words: usize, row: &[u64]) -> [&[u64]; TESTS] {
        std::array::from_fn(|test| &row[test * words..][..words])
    }
    let words = mask.len();
    let ours = planes::<TESTS>(words, row);
    for (index, row) in rows.chunks_exact(TESTS * words).enumerate() {
        let theirs = planes::<TESTS>(words, row);
        let mut differing = 0;
        for word in 0..words {
            let mut differs = 0;
            for test in 0..TESTS {
                differs |= ours[test][word] ^ theirs[test][word];
            }
            differing += (differs & mask[word]).count_ones();
        }
        each(index, differing);
    }
}
