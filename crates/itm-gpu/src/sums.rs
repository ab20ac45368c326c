//! What the error terms' stages sum up over an image, and how the sums come back: rows of numbers, one an invocation, are
//! added up in a fixed order and read together, so that an evaluation waits once.

use itm_shaders::reduce;

use crate::recorder::{Groups, Pipeline};
use crate::{Device, Error, Recorder};

/// Sums of the depth term (stage `icp`): the normal equations of a weighted least-squares problem in six unknowns,
/// translation, then rotation, both about a pivot and in the world's directions: a point p moves to
/// `pivot + exp(twist) (p - pivot)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthSums {
    /// JᵀWJ, row by row.
    pub hessian: [[f64; 6]; 6],
    /// JᵀWr.
    pub gradient: [f64; 6],
    /// Sum of the pairs' weighted robust errors (half of r² where that is small), in square metres.
    pub cost: f64,
    /// Sum of the pairs' weights.
    pub weights: f64,
    /// Sum of the weights of pixels whose partner is too far away.
    pub apart: f64,
    /// Sum of the pairs' r², in square metres.
    pub squares: f64,
    /// Pairs.
    pub count: u32,
    /// Pixels with a depth that counts, whether they found a partner or not.
    pub valid: u32,
    /// Pixels that lie too far in front of the surface that the model shows there.
    pub in_front: u32,
    /// Pixels that lie too far behind it.
    pub behind: u32,
    /// Sum of the weights of pixels where the model shows nothing.
    pub unseen: f64,
}

/// Sums of the colour term (stage `photometric`), in eight unknowns: six as in [`DepthSums`], then the gain and the offset
/// that the points' colours go through.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PhotometricSums {
    /// JᵀWJ, row by row.
    pub hessian: [[f64; 8]; 8],
    /// JᵀWr.
    pub gradient: [f64; 8],
    /// Sum of the weighted robust errors of points that are seen (half of r² where that is small); colours are 0 to 1.
    pub cost: f64,
    /// Sum of the weights of points that are seen.
    pub weights: f64,
    /// Sum of the weights of points that are not.
    pub unseen: f64,
    /// Sum of r² over points whose colour is not too far off.
    pub squares: f64,
    /// Points whose colour is not too far off.
    pub count: u32,
    /// Points.
    pub valid: u32,
}

/// Takes numbers from a row in order.
struct Row<'a>(std::slice::Iter<'a, f32>);

impl Row<'_> {
    fn take(&mut self) -> f64 {
        f64::from(*self.0.next().expect("a row has as many numbers as its shader writes"))
    }

    fn count(&mut self) -> u32 {
        self.take() as u32
    }

    fn equations<const N: usize>(&mut self) -> ([[f64; N]; N], [f64; N]) {
        let mut hessian = [[0.0; N]; N];
        for (row, column) in (0..N).flat_map(|row| (row..N).map(move |column| (row, column))) {
            let value = self.take();
            hessian[row][column] = value;
            hessian[column][row] = value;
        }
        (hessian, std::array::from_fn(|_| self.take()))
    }
}

impl DepthSums {
    /// Numbers in a row of `icp/sums`.
    pub(crate) const COLUMNS: u32 = 36;

    pub(crate) fn new(sums: &[f32]) -> Self {
        let mut row = Row(sums.iter());
        let (hessian, gradient) = row.equations();
        let [cost, weights, apart, squares] = std::array::from_fn(|_| row.take());
        let [count, valid, in_front, behind] = std::array::from_fn(|_| row.count());
        let unseen = row.take();
        Self { hessian, gradient, cost, weights, apart, squares, count, valid, in_front, behind, unseen }
    }
}

impl PhotometricSums {
    /// Numbers in a row of `photometric/sums`.
    pub(crate) const COLUMNS: u32 = 50;

    pub(crate) fn new(sums: &[f32]) -> Self {
        let mut row = Row(sums.iter());
        let (hessian, gradient) = row.equations();
        let [cost, weights, unseen, squares] = std::array::from_fn(|_| row.take());
        let [count, valid] = std::array::from_fn(|_| row.count());
        Self { hessian, gradient, cost, weights, unseen, squares, count, valid }
    }
}

/// Terms that one evaluation can have.
const TERMS: usize = 3;
/// Sums that are read together: of one evaluation's terms, or of one term at so many poses.
pub(crate) const SLOTS: usize = 16;
/// Numbers that a term's sums have room for.
const SLOT: u32 = 64;

/// How an image's pixels are shared out among invocations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shares {
    lanes: u32,
    pixels: u32,
}

impl Shares {
    pub(crate) fn new(device: &Device) -> Self {
        // A processor likes few long rows of work; a GPU many short ones.
        let (lanes, pixels) = if device.capabilities().software { (8, 128) } else { (64, 16) };
        Self { lanes, pixels }
    }

    pub(crate) fn constants(self) -> [(&'static str, f64); 2] {
        [("LANES", f64::from(self.lanes)), ("PIXELS", f64::from(self.pixels))]
    }

    /// Workgroups for so many pixels, and rows that they write.
    pub(crate) fn of(self, pixels: u32) -> (u32, u32) {
        let groups = pixels.div_ceil(self.lanes * self.pixels).max(1);
        (groups, groups * self.lanes)
    }
}

/// Adds up the rows of up to three terms, or of one at up to [`SLOTS`] poses, and reads the results with one wait.
#[derive(Debug)]
pub(crate) struct Reduce {
    device: Device,
    pipeline: Pipeline,
    /// A slot's rows go into one of these in turn; it is free again once they are added up.
    partial: [wgpu::Buffer; TERMS],
    result: wgpu::Buffer,
    staging: wgpu::Buffer,
}

impl Reduce {
    pub(crate) fn new(device: &Device) -> Self {
        let bytes = SLOTS as u64 * u64::from(SLOT) * 4;
        Self {
            device: device.clone(),
            pipeline: Pipeline::plain(device, &reduce::PASS),
            partial: std::array::from_fn(|_| device.storage("partial sums", 16)),
            result: device.storage("sums", bytes),
            staging: device.staging("sums", bytes),
        }
    }

    /// Room for a term's rows.
    pub(crate) fn partial(&mut self, slot: usize, rows: u32, columns: u32) -> &wgpu::Buffer {
        let bytes = u64::from(rows) * u64::from(columns) * 4;
        let partial = &mut self.partial[slot % TERMS];
        self.device.ensure(partial, "partial sums", bytes);
        partial
    }

    pub(crate) fn record(&self, recorder: &mut Recorder, slot: usize, rows: u32, columns: u32) {
        let params = reduce::Params { rows, columns, to: slot as u32 * SLOT, unused: 0 };
        let bindings = reduce::Bindings { params, partial_sums: &self.partial[slot % TERMS], sums: &self.result };
        recorder.dispatch(&self.pipeline, &bindings, Groups::Count([1, 1, 1]));
    }

    /// Submits what was recorded and reads the sums of the first slots. Waits.
    pub(crate) fn read(&self, mut recorder: Recorder, slots: usize) -> Result<Vec<Vec<f32>>, Error> {
        let bytes = slots as u64 * u64::from(SLOT) * 4;
        recorder.copy(&self.result, &self.staging, bytes);
        let _untimed = recorder.submit();
        let values = self.device.read_staging::<f32>(&self.staging, bytes)?;
        Ok(values.chunks_exact(SLOT as usize).map(<[f32]>::to_vec).collect())
    }
}
