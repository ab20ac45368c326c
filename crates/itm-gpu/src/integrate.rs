//! Stage `integrate`: fuses depth, and colour, into the visible blocks (Curless & Levoy 1996; Newcombe et al. 2011,
//! section 3.3; the report, section 3.3).

use itm_core::{Calibration, Se3};
use itm_shaders::integrate;

use crate::map::{camera_params, indirect};
use crate::recorder::{Groups, Pipeline};
use crate::{BlockMap, Device, Recorder, View};

/// How observations are fused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntegrateOptions {
    /// Largest weight. Where the view has weights by noise, an observation adds up to
    /// [`itm_core::voxel::BEST_OBSERVATION`] to it.
    pub max_weight: u16,
    /// Whether voxels at the largest weight are left as they are.
    pub stop_at_max_weight: bool,
    /// Share of the truncation band in which colour is fused.
    pub colour_band: f32,
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Integrate {
    /// By whether colour is fused, and whether observations have weights of their own.
    variants: [[Pipeline; 2]; 2],
}

impl Integrate {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            variants: [[&[][..], &["weighted"]], [&["colour"], &["colour", "weighted"]]]
                .map(|row| row.map(|features| Pipeline::new(device, &integrate::PASS, features, &[]))),
        }
    }

    /// Records the stage for a view from a pose; colour is fused where both view and map have it.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        view: &View,
        calibration: &Calibration,
        world_from_camera: &Se3,
        options: &IntegrateOptions,
    ) {
        recorder.stage("integrate");
        let camera_from_world = world_from_camera.inverse();
        let colour = view.colour().filter(|_| map.layout().colour);
        let observations = view.observations();
        let pipeline = &self.variants[usize::from(colour.is_some())][usize::from(observations.is_some())];
        for (distances, page) in map.distances.iter().zip(0..) {
            let bindings = integrate::Bindings {
                params: integrate::Params {
                    depth_camera: camera_params(&calibration.depth, [0.0, 0.0]),
                    colour_camera: camera_params(&calibration.colour, [0.0, 0.0]),
                    camera_from_world: camera_from_world.to_mat4().to_cols_array_2d(),
                    colour_from_world: (calibration.colour_from_depth * camera_from_world).to_mat4().to_cols_array_2d(),
                    map: map.params(),
                    page,
                    max_weight: options.max_weight.into(),
                    stop_at_max_weight: options.stop_at_max_weight.into(),
                    colour_band: options.colour_band,
                },
                counters: &map.counters,
                visible: &map.visible,
                keys: &map.keys,
                depth: observations.is_none().then(|| view.depth()),
                observations,
                distances,
                image: colour,
                colours: map.colours.get(page as usize),
            };
            recorder.dispatch(pipeline, &bindings, Groups::Indirect(&map.indirect, indirect::VISIBLE));
        }
    }
}
