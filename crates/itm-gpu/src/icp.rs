//! Stage `icp`: the sums of the depth term, point-to-plane with projective association (Newcombe et al. 2011, section 3.5;
//! the report, sections 3.1.1 and 3.1.3). The optimisation is itm-slam's.

use itm_core::{DepthWeight, Se3};
use itm_shaders::icp;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::sums::{DepthSums, Reduce, Shares};
use crate::{Device, RaycastImage, Recorder, View};

/// What counts in the depth term, and how much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthTerm {
    /// Points further apart than this many metres are no pair.
    pub max_distance_m: f32,
    /// Points further than this many metres from the model's plane are no pair either.
    pub max_plane_distance_m: f32,
    /// Residuals up to this many metres count squared, larger ones linearly (Huber 1964, *Robust Estimation of a Location
    /// Parameter*); infinite where all count squared.
    pub huber_m: f32,
    /// How a pixel's weight follows its depth.
    pub weight: DepthWeight,
    /// Depth range (metres) that [`DepthWeight::Linear`] refers to.
    pub depth_range_m: [f32; 2],
    /// Observations of a surface point from which on it counts fully, fewer counting proportionally less; 0 where all
    /// count alike.
    pub full_confidence: f32,
    /// Surface points with fewer observations than this are no partners.
    pub least_confidence: f32,
    /// Every so manyth pixel along both axes is used.
    pub stride: u32,
}

impl DepthTerm {
    /// All pairs up to a distance count alike.
    pub const fn plain(max_distance_m: f32) -> Self {
        Self {
            max_distance_m,
            max_plane_distance_m: f32::MAX,
            huber_m: f32::MAX,
            weight: DepthWeight::None,
            depth_range_m: [0.0, 1.0],
            full_confidence: 0.0,
            least_confidence: 0.0,
            stride: 1,
        }
    }
}

pub(crate) fn weight_kind(weight: DepthWeight) -> u32 {
    match weight {
        DepthWeight::None => 0,
        DepthWeight::Linear => 1,
        DepthWeight::Noise => 2,
    }
}

/// The stage's pipeline.
#[derive(Debug)]
pub struct Icp {
    sums: Pipeline,
    shares: Shares,
}

impl Icp {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        let shares = Shares::new(device);
        Self { sums: Pipeline::new(device, &icp::sums::PASS, &[], &shares.constants()), shares }
    }

    /// Records the sums for one level of a view, taken to be at `world_from_camera`, against the surface in `model`, which
    /// was cast from `world_from_model`. The pivot is the model camera's centre.
    #[expect(clippy::too_many_arguments, reason = "a view and a model, each with its pose, and where the sums go")]
    pub(crate) fn record(
        &self,
        recorder: &mut Recorder,
        view: &View,
        level: usize,
        world_from_camera: &Se3,
        model: &RaycastImage,
        world_from_model: &Se3,
        term: &DepthTerm,
        (reduce, slot): (&mut Reduce, usize),
    ) {
        recorder.stage("icp");
        let camera = view.level_camera(level);
        let stride = term.stride.max(1);
        let (groups, rows) = self.shares.of(camera.width.div_ceil(stride) * camera.height.div_ceil(stride));
        let bindings = icp::sums::Bindings {
            params: icp::sums::Params {
                depth_camera: camera_params(camera, term.depth_range_m),
                model_camera: camera_params(model.camera(), [0.0, 0.0]),
                world_from_camera: world_from_camera.to_mat4().to_cols_array_2d(),
                model_camera_from_world: world_from_model.inverse().to_mat4().to_cols_array_2d(),
                pivot: world_from_model.translation.as_vec3().to_array(),
                max_distance: term.max_distance_m.min(1e18),
                max_plane_distance: term.max_plane_distance_m,
                // Its square must be finite.
                huber: term.huber_m.clamp(1e-9, 1e18),
                depth_weight: weight_kind(term.weight),
                full_confidence: term.full_confidence,
                least_confidence: term.least_confidence,
                stride,
                rows,
                unused: 0,
            },
            depth: view.level_depth(level),
            points: &model.points,
            normals: &model.normals,
            partial_sums: reduce.partial(slot, rows, DepthSums::COLUMNS),
        };
        recorder.dispatch(&self.sums, &bindings, Groups::Count([groups, 1, 1]));
        reduce.record(recorder, slot, rows, DepthSums::COLUMNS);
    }
}
