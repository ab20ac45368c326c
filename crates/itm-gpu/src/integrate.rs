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
    /// Largest weight.
    pub max_weight: u16,
    /// Whether voxels at the largest weight are left as they are.
    pub stop_at_max_weight: bool,
    /// Share of the truncation band in which colour is fused.
    pub colour_band: f32,
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Integrate {
    depth: Pipeline,
    depth_and_colour: Pipeline,
}

impl Integrate {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            depth: Pipeline::plain(device, &integrate::PASS),
            depth_and_colour: Pipeline::new(device, &integrate::PASS, &["colour"], &[]),
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
        let pipeline = if colour.is_some() { &self.depth_and_colour } else { &self.depth };
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
                depth: view.depth(),
                distances,
                image: colour,
                colours: map.colours.get(page as usize),
            };
            recorder.dispatch(pipeline, &bindings, Groups::Indirect(&map.indirect, indirect::VISIBLE));
        }
    }
}
