//! Stage `icp`: the sums of point-to-plane ICP (Newcombe et al. 2011, section 3.5). The optimisation is itm-slam's.

use itm_core::Se3;
use itm_shaders::icp;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::{Device, Error, RaycastImage, Recorder, View};

/// The normal equations of a least-squares problem in six unknowns: translation, then rotation, both about a pivot and
/// in the world's directions: a point p moves to `pivot + exp(twist) (p - pivot)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalEquations {
    /// JᵀJ, row by row.
    pub hessian: [[f64; 6]; 6],
    /// Jᵀr.
    pub gradient: [f64; 6],
    /// Sum of r² in square metres.
    pub squares: f64,
    /// Pairs that took part.
    pub count: u32,
    /// Pixels with a depth, whether they found a partner or not.
    pub valid: u32,
}

/// The sums, row by row: the upper triangle of JᵀJ, Jᵀr, the squares, the two counts.
const COLUMNS: u64 = 32;

impl NormalEquations {
    fn new(sums: &[f32]) -> Self {
        let mut hessian = [[0.0; 6]; 6];
        let mut next = sums.iter().map(|v| f64::from(*v));
        let mut take = || next.next().expect("30 sums");
        for (row, column) in (0..6).flat_map(|row| (row..6).map(move |column| (row, column))) {
            let value = take();
            hessian[row][column] = value;
            hessian[column][row] = value;
        }
        let gradient = std::array::from_fn(|_| take());
        let squares = take();
        Self { hessian, gradient, squares, count: take() as u32, valid: take() as u32 }
    }
}

/// The stage's pipelines and the memory of its sums.
#[derive(Debug)]
pub struct Icp {
    device: Device,
    sums: Pipeline,
    reduce: Pipeline,
    lanes: u32,
    pixels: u32,
    partial_sums: wgpu::Buffer,
    result: wgpu::Buffer,
    staging: wgpu::Buffer,
}

impl Icp {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        // A processor likes few long rows of work; a GPU many short ones.
        let (lanes, pixels) = if device.capabilities().software { (8, 128) } else { (64, 16) };
        let constants = [("LANES", f64::from(lanes)), ("PIXELS", f64::from(pixels))];
        Self {
            device: device.clone(),
            sums: Pipeline::new(device, &icp::sums::PASS, &[], &constants),
            reduce: Pipeline::plain(device, &icp::reduce::PASS),
            lanes,
            pixels,
            partial_sums: device.storage("icp partial sums", 16),
            result: device.storage("icp sums", COLUMNS * 4),
            staging: device.staging("icp sums", COLUMNS * 4),
        }
    }

    /// The sums for one level of a view, taken to be at `world_from_camera`, against the surface in `model`, which was
    /// cast from `world_from_model`. Points further than `max_distance_m` apart are no pair. The pivot is the model
    /// camera's centre. Waits.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn evaluate(
        &mut self,
        view: &View,
        level: usize,
        world_from_camera: &Se3,
        model: &RaycastImage,
        world_from_model: &Se3,
        max_distance_m: f32,
    ) -> Result<NormalEquations, Error> {
        let camera = view.level_camera(level);
        let pixels = camera.pixels() as u32;
        let groups = pixels.div_ceil(self.lanes * self.pixels);
        let rows = groups * self.lanes;
        self.device.ensure(&mut self.partial_sums, "icp partial sums", u64::from(rows) * COLUMNS * 4);
        let mut recorder = Recorder::new(&self.device);
        recorder.stage("icp");
        let bindings = icp::sums::Bindings {
            params: icp::sums::Params {
                depth_camera: camera_params(camera, [0.0, 0.0]),
                model_camera: camera_params(model.camera(), [0.0, 0.0]),
                world_from_camera: world_from_camera.to_mat4().to_cols_array_2d(),
                model_camera_from_world: world_from_model.inverse().to_mat4().to_cols_array_2d(),
                pivot: world_from_model.translation.as_vec3().to_array(),
                max_distance: max_distance_m,
                rows,
                unused_a: 0,
                unused_b: [0; 2],
            },
            depth: view.level_depth(level),
            points: &model.points,
            normals: &model.normals,
            partial_sums: &self.partial_sums,
        };
        recorder.dispatch(&self.sums, &bindings, Groups::Count([groups, 1, 1]));
        let bindings = icp::reduce::Bindings {
            params: icp::reduce::Params { rows },
            partial_sums: &self.partial_sums,
            sums: &self.result,
        };
        recorder.dispatch(&self.reduce, &bindings, Groups::Count([1, 1, 1]));
        recorder.copy(&self.result, &self.staging, COLUMNS * 4);
        let _untimed = recorder.submit();
        Ok(NormalEquations::new(&self.device.read_staging::<f32>(&self.staging, COLUMNS * 4)?))
    }
}
