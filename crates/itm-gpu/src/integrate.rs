//! Stage `integrate`: fuses depth, and colour, into the visible blocks (Curless & Levoy 1996; Newcombe et al. 2011,
//! section 3.3; the report, section 3.3).

use std::sync::OnceLock;

use itm_core::voxel::DistanceKind;
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
    /// What a voxel that claims to be near a surface loses of its weight each time it is seen to be empty.
    pub empty_loss: u16,
    /// Whether observations count by their noise, where the view says how much.
    pub weighted: bool,
}

/// The stage's pipelines, compiled when first needed.
#[derive(Debug)]
pub struct Integrate {
    device: Device,
    /// By whether distances are floats, colour is fused, observations have weights of their own, and confidence is kept: a
    /// bit each.
    variants: [OnceLock<Pipeline>; 16],
}

impl Integrate {
    /// Prepares the stage.
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), variants: Default::default() }
    }

    fn variant(&self, features: [(&'static str, bool); 4]) -> &Pipeline {
        let index: usize = features.iter().zip(0..).map(|((_, on), bit)| usize::from(*on) << bit).sum();
        let names: Vec<_> = features.iter().filter(|(_, on)| *on).map(|(name, _)| *name).collect();
        self.variants[index].get_or_init(|| Pipeline::new(&self.device, &integrate::PASS, &names, &[]))
    }

    /// Records the stage for a view from a pose; colour is fused where both view and map have it. A map with confidence asks
    /// for a view with observation weights, and has none of its own from one without.
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
        let kind = map.layout().kind;
        let colour = view.colour().filter(|_| kind.colour);
        let observations = view.observations();
        let confidence = kind.confidence && observations.is_some();
        let weighted = options.weighted && observations.is_some();
        let observations = observations.filter(|_| confidence || weighted);
        let pipeline = self.variant([
            ("f32", kind.distance == DistanceKind::F32),
            ("colour", colour.is_some()),
            ("weighted", weighted),
            ("confidence", confidence),
        ]);
        for (distances, page) in map.distances().iter().zip(0..) {
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
                    empty_loss: options.empty_loss.into(),
                    unused_a: 0,
                    unused_b: [0; 2],
                },
                counters: &map.counters,
                visible: &map.visible,
                keys: &map.keys,
                depth: observations.is_none().then(|| view.depth()),
                observations,
                distances,
                image: colour,
                colours: map.colours().get(page as usize),
                confidences: map.confidences().get(page as usize),
            };
            recorder.dispatch(pipeline, &bindings, Groups::Indirect(&map.indirect, indirect::VISIBLE));
        }
    }
}
